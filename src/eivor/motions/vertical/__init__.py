"""Vertical motion."""
