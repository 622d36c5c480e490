"""Confidence sets: intervals, unions of them, regions, and the tests they invert."""
