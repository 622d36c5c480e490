"""Recordings and signals: what was logged, and the same on one uniform grid."""
