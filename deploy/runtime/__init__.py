"""The law as straight-line functions of the artifact's constants."""
