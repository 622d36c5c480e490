"""Turning of a multirotor about its body axes, by the controller's torque setpoints."""
