"""What a result is worth: held-out scenarios, what limits it, exact sensitivities, where its residual comes from."""
