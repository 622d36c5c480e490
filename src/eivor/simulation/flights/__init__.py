"""Flights with known truth: trajectories, wind, sensors, closed loop."""
