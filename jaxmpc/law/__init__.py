"""The control law as scalar arithmetic: it imports nothing, so robot and simulator run the same source."""
