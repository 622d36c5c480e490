"""Disturbances and excitations."""
