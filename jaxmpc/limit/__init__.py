"""The least residual that any linear law could reach, by convex optimisation: what a controller stands beside."""
