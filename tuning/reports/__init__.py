"""What a run leaves in its folder: tables, figures, one offline page."""
