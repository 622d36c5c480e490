"""Rigid body."""
