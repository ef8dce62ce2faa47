"""What came out of a sweep, on the terminal and as files."""
