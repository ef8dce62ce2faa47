"""Force sensors behind one protocol: Barrett's on CAN, JR3's through comedi."""
