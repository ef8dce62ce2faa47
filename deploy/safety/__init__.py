"""Safety layer between controller and bus: limits applied, then checked again by other means."""
