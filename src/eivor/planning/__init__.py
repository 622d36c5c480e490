"""Flights that would tell what another one could not: chosen by simulation, and written out to be flown."""
