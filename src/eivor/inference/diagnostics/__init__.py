"""Diagnostics of residuals, instruments and excitation."""
