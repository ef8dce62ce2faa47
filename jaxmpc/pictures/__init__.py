"""Figures and films, made without a display."""
