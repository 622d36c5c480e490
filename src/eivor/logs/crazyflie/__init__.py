"""Crazyflie microSD logs."""
