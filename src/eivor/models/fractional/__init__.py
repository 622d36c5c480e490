"""Fractional difference equations: their columns, what noise these share, regressions, simulation."""
