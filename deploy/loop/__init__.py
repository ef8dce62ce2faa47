"""The 1 kHz loop: session, cycle, tasks, operator, real time, watchdog."""
