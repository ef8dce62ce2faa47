"""Wanted force at run time: where it comes from, and the stream that lets nothing jump."""
