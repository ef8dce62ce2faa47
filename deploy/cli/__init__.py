"""Command lines of the robot's verbs; they need numpy and python-can alone."""
