"""The Crazyflie's logs on a microSD card."""
