"""What is minimised and held: a job on one level of fidelity as a function of unconstrained vectors."""
