"""What stands between the controller and the bus: limits applied, then checked again by other means."""
