"""The closed loop at one sample, controller and world together: what every engine runs, as arithmetic on scalars."""
