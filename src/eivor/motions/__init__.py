"""Motions: what they identify, of which channels, and by which equations."""
