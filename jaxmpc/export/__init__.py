"""What the robot side gets from the simulator: golden traces, and the simulated law over a recorded flight."""
