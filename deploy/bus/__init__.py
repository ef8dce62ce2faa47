"""The CAN bus through python-can, and its log."""
