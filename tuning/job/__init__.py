"""A tuning job: its spec, goals, scenarios, and the result that it comes to."""
