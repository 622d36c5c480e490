"""Flights: from a recording to signals, and the recipe that identifies them."""
