"""The gradient tuner beside its rivals on the same objective: `python -m benchmarks.rivals -o DIR`."""
