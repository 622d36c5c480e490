"""Where autopilots have their rotors: places and spins of common frames, in the order of their commands.

Turned to forward, left, up; places are in arms, the distance from the centre to a rotor. Spins are +1 where
the reaction torque on the body points up: clockwise, seen from above. From the sources of the autopilots:
PX4's airframes (4001, 5001), ArduPilot's AP_MotorsMatrix (quad X and plus), Betaflight's mixer (QUADX,
QUADP), the Crazyflie's power_distribution_quadrotor.c.
"""

from __future__ import annotations

import math

CLOCKWISE, COUNTERCLOCKWISE = 1, -1

#: A place forward and left of the centre, and the spin there.
Rotor = tuple[float, float, int]

_SIDE = math.sqrt(0.5)
_FRONT_LEFT, _FRONT_RIGHT = (_SIDE, _SIDE), (_SIDE, -_SIDE)
_REAR_LEFT, _REAR_RIGHT = (-_SIDE, _SIDE), (-_SIDE, -_SIDE)
_FRONT, _REAR, _LEFT, _RIGHT = (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)

_ARDUPILOT_X = (
    (*_FRONT_RIGHT, COUNTERCLOCKWISE),
    (*_REAR_LEFT, COUNTERCLOCKWISE),
    (*_FRONT_LEFT, CLOCKWISE),
    (*_REAR_RIGHT, CLOCKWISE),
)
_ARDUPILOT_PLUS = (
    (*_RIGHT, COUNTERCLOCKWISE),
    (*_LEFT, COUNTERCLOCKWISE),
    (*_FRONT, CLOCKWISE),
    (*_REAR, CLOCKWISE),
)
#: Rotors by layout and numbering.
LAYOUTS: dict[str, dict[str, tuple[Rotor, ...]]] = {
    "quad-x": {
        "px4": _ARDUPILOT_X,
        "ardupilot": _ARDUPILOT_X,
        "betaflight": (
            (*_REAR_RIGHT, CLOCKWISE),
            (*_FRONT_RIGHT, COUNTERCLOCKWISE),
            (*_REAR_LEFT, COUNTERCLOCKWISE),
            (*_FRONT_LEFT, CLOCKWISE),
        ),
        "crazyflie": (
            (*_FRONT_RIGHT, COUNTERCLOCKWISE),
            (*_REAR_RIGHT, CLOCKWISE),
            (*_REAR_LEFT, COUNTERCLOCKWISE),
            (*_FRONT_LEFT, CLOCKWISE),
        ),
    },
    "quad-plus": {
        "px4": _ARDUPILOT_PLUS,
        "ardupilot": _ARDUPILOT_PLUS,
        "betaflight": (
            (*_REAR, CLOCKWISE),
            (*_RIGHT, COUNTERCLOCKWISE),
            (*_LEFT, COUNTERCLOCKWISE),
            (*_FRONT, CLOCKWISE),
        ),
    },
}
