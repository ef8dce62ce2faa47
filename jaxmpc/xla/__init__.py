"""What XLA needs of its users: programs compiled once and kept on disk, float64, fixed blocks on every device."""
