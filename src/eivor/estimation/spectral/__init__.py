"""Estimators that weight two equations of a sampled motion by their spectra, near the Cramer-Rao bound."""
