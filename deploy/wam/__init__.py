"""The arm on its bus: properties of its pucks, start-up, and the traffic of one cycle."""
