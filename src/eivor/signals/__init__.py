"""Signals and channels."""
