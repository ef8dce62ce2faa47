"""Parameter sweeps: grids and random samples of controllers, resumable to the bit."""
