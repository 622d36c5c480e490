"""Fleets: many logs, one row for each flight, and what the rows tell together."""
