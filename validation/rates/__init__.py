"""Turning about the body axes, from setpoints that are logged more slowly than they are issued."""
