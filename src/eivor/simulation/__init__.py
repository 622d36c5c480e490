"""Simulation of flights."""
