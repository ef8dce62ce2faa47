"""Sweeps that go on where it is worth it: ever fewer rows on dearer experiments, or more rows around the front."""
