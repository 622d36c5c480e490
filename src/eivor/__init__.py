"""Eivor: the parameters of moving machines from noisy recordings."""
