"""The numbers that others published of three Crazyflie logs, found again by their own recipe."""
