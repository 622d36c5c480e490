"""Turning rates."""
