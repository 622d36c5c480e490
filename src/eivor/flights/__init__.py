"""Flights: from a recording to a result with a verdict."""
