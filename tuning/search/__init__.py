"""From many random points to one controller: levels that propose, space mapping, descent, worst cases, fronts."""
