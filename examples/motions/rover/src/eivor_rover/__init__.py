"""The forward motion of a ground vehicle, v' = a u - c v - d sign(v) + b, as a motion of Eivor."""

import eivor as ev

Rover = ev.machine(
    "rover",
    channels={
        "forward_speed": "m/s",
        "forward_acceleration": {"unit": "m/s^2", "role": "response"},
        "drive_command": ev.input(),
        "reference_forward_speed": ev.reference("m/s"),
    },
    response=["forward_acceleration", "ddt(forward_speed)"],
    terms={
        "rolling_drag": "-forward_speed",
        "dry_friction": "-sign(forward_speed)",
        "drive_gain": ev.behind("drive_command", "drive"),
    },
    actuators={"drive": ev.actuator(lag_s=(0.002, 0.3), delay_s=(0.0, 0.2))},
    derived={"breakaway_command": "dry_friction / drive_gain", "time_constant": "1 / rolling_drag"},
    headline=["drive_gain", "dry_friction"],
)
