"""What is minimised and held: a job as a function of unconstrained vectors."""
