"""Flights of one vehicle together: some parameters are shared, others belong to the flight."""
