"""Planned flights against flights: how near vehicles that a plan does not know come to what it predicts."""
