"""Fleets with known truth: vehicles that wear, break a propeller, and fly in the weather."""
