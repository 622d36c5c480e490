"""Means of estimates that differ by more than their errors: flights of a vehicle, vehicles of a type.

Every function works on many groups at once, so that a fleet of thousands of vehicles costs a few passes
over its rows.
"""
