"""The arm on its bus: what its pucks say about themselves, start-up, and the traffic of one cycle."""
