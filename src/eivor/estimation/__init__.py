"""Estimation methods for separable regression problems."""
