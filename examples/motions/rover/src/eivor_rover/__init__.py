"""The forward motion of a ground vehicle, v' = a u - c v - d sign(v) + b, as a motion of Eivor."""

from eivor.motions.equation import AxisEquation, Channel, Machine, Ratio, Term

DRIVE = Term("drive_gain", "drive_command", "a", "m/s^2", behind=True)
DRAG = Term("rolling_drag", "-forward_speed", "c", "1/s")
FRICTION = Term("dry_friction", "-sign(forward_speed)", "d", "m/s^2")

Rover = Machine(
    name="rover",
    title="Rover",
    equation=("v' = a u - c v - d sign(v) + b", "v forward speed; tau u' + u = command(t - d)"),
    logged=(
        Channel("forward_speed", "m/s", "state"),
        Channel("forward_acceleration", "m/s^2", "response"),
        Channel("drive_command", "", "input"),
        Channel("reference_forward_speed", "m/s", "reference"),
    ),
    axes=(
        AxisEquation(
            "forward",
            "drive_command",
            ("forward_acceleration", "ddt(forward_speed)"),
            (DRAG, FRICTION, DRIVE),
            ("forward acceleration", "m/s²", "a u − c v − d sign(v)", "a u"),
            state=("forward_speed", "forward speed", "m/s"),
        ),
    ),
    derived=(
        Ratio("breakaway_command", "dry_friction", "drive_gain", "d/a"),
        Ratio("time_constant", 1.0, "rolling_drag", "1/c", "s"),
    ),
    headline=("drive_gain", "dry_friction"),
    move="Drive to and fro for 60 s with speeds that change every few seconds, on level ground.",
    log="Log speed, command and the speed that was requested, as reference_forward_speed, at 50 Hz or more.",
)
