"""Files in and out: TOML with every mistake at its line, sealed npz, and the error that names key, value and remedy."""
