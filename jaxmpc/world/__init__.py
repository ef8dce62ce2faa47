"""What the robot meets: heart motion, tissue, sensing, damping and delay."""
