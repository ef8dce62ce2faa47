"""From many random points to one controller: descent, space mapping, fronts."""
