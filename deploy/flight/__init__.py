"""Flight recordings: written while the arm moves, replayed afterwards."""
