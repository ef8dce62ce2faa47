"""Motion of the heart's surface: a table of harmonics, rhythms, or the user's own recording."""
