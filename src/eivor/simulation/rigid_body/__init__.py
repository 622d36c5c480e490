"""Flights of rigid bodies on rotors: integrators, controller, sensors, what a log of them holds."""
