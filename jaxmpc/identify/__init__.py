"""Friction and masses of the arm from a recording of its own motion."""
