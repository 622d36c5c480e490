"""Whether a fleet's table is the same whatever computes it and whatever is killed meanwhile."""
