"""The protocol of Barrett's pucks on CAN, as pure functions from frames to values and back."""
