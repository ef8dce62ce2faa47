"""How the loop is run: by scan over time, in fixed blocks of controllers, on every device of the host."""
