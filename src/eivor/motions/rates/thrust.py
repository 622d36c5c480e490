"""Thrust by its setpoint: what the vertical motion makes of it, behind the lag that turning tells.

z'' + g = G u cos(tilt) - K z' + b, with tau u' + u = c(t - d) and c the collective thrust setpoint. An
equation of its own, and not a fourth beside those of turning: another loop issues the setpoint, which may be
slower, and other sensors answer it. In simulated flights whose height loop ran at 50 Hz a fourth one made
the test of all four fail, and the lag 1.5 to 6 ms too long.
"""

from __future__ import annotations

from eivor.flights.companion import Companion

THRUST = Companion(
    motion="vertical",
    quantity="input_gain",
    called="thrust_gain",
    input="input",
    input_map="linear",  # a setpoint of thrust, whatever map the rotors of the same log have
    needs={
        "thrust setpoint": ("input",),
        "accelerometer": ("specific_force_body_z", "specific_force_z", "acceleration_z"),
    },
)
