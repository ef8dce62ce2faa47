"""What a loop does to a spectrum: residual, effort and chatter of a controller without a time step."""
