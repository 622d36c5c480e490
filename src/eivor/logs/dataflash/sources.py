"""Where each canonical channel is in a DataFlash log, by the columns' names in firmware 3.3 to 4.6.

Axes are z down, north-east-down and forward-right-down; heights and climbs of CTUN and PSCZ are up.

* Velocity and position are those of the estimator that flies (`eivor.logs.dataflash.estimators`).
* `RATE.AOut` is the throttle after the vertical controller, a share of the thrust: the autopilot linearises
  the motors behind it (MOT_THST_EXPO). Up to 3.3 it is in thousandths, `CTUN.ThrOut` too, and volts are in
  hundredths. Climb rates of CTUN are whole cm/s throughout.
* PSCD.DPD, DVD and DAD are the shaped trajectory, which does not answer the vehicle (PSCZ.DVZ, DAZ in 4.0).
  PSCD.TPD adds the offset of the terrain, PSCZ.TPZ is the position target of 4.0, CTUN.DAlt that of older
  firmware. PSCD.TVD, PSCZ.TVZ and CTUN.DCRt have the position loop's answer in them: feedback.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from eivor.logs.dataflash.messages import Messages
from eivor.logs.dataflash.origin import ORIGIN_MESSAGES
from eivor.logs.units import UNITS

#: What each estimator's first core is logged as, the preferred one first.
ESTIMATORS = ("XKF1", "NKF1", "EKF1")
#: Messages that the position controller writes while it is in force.
CONTROLLERS = ("PSCD", "PSCZ")


@dataclass(frozen=True, slots=True)
class Source:
    """One place where a channel may be.

    Parameters
    ----------
    message, column : str
        Names in the log.
    factor : float
        What one of the logged unit is in the channel's; negative where it points the other way.
    old_factor : float
        Times this where the column holds whole numbers, or the log counts milliseconds (up to 3.3).
    zero_is_absent : bool
        True when zeros throughout mean that nothing measures it.
    needs_height_loop : bool
        True for a height target that is zero or follows the vehicle where no loop holds the height.
    """

    message: str
    column: str
    factor: float = 1.0
    old_factor: float = 1.0
    zero_is_absent: bool = False
    needs_height_loop: bool = False

    @property
    def estimated(self) -> bool:
        """Whether an estimator makes the values."""
        return self.message in ESTIMATORS

    @property
    def is_setpoint(self) -> bool:
        """Whether it is in force only while it is logged."""
        return self.message in CONTROLLERS

    def factor_in(self, table: Messages) -> float:
        """Return what one of the column's unit is in the channel's, by the firmware that wrote a log.

        Parameters
        ----------
        table : Messages
            Of this source.
        """
        is_old = table.clock == "TimeMS" or table.layout.fields[self.column].is_whole
        return self.factor * (self.old_factor if is_old else 1.0)

    @property
    def label(self) -> str:
        """The source in the log's own words."""
        return f"{'-' if self.factor < 0.0 else ''}{self.message}.{self.column}"


_DEG = UNITS["deg"][1]


def _estimates(column: str) -> tuple[Source, ...]:
    return tuple(Source(message, column) for message in ESTIMATORS)


#: Sources of each channel, the preferred one first.
CHANNEL_SOURCES: Mapping[str, tuple[Source, ...]] = {
    "position_x": _estimates("PN"),
    "position_y": _estimates("PE"),
    "position_z": _estimates("PD"),
    "velocity_x": _estimates("VN"),
    "velocity_y": _estimates("VE"),
    "velocity_z": _estimates("VD"),
    **{f"specific_force_body_{axis}": (Source("IMU", f"Acc{axis.upper()}"),) for axis in "xyz"},
    **{
        f"angular_rate_{axis}": (Source("IMU", f"Gyr{axis.upper()}"), Source("RATE", letter, _DEG))
        for axis, letter in zip("xyz", "RPY", strict=True)
    },
    "input": (
        Source("RATE", "AOut", old_factor=1e-3),
        Source("CTUN", "ThO", old_factor=1e-3),
        Source("CTUN", "ThrOut", old_factor=1e-3),
    ),
    "reference_position_z": (
        Source("PSCD", "DPD"),
        Source("PSCD", "TPD"),
        Source("PSCZ", "TPZ", -1.0),
        Source("CTUN", "DAlt", -1.0, needs_height_loop=True),
    ),
    "reference_velocity_z": (
        Source("PSCD", "DVD", zero_is_absent=True),
        Source("PSCZ", "DVZ", -1.0, zero_is_absent=True),
    ),
    "reference_acceleration_z": (
        Source("PSCD", "DAD", zero_is_absent=True),
        Source("PSCZ", "DAZ", -1.0, zero_is_absent=True),
    ),
    "feedback_reference_velocity_z": (
        Source("PSCD", "TVD"),
        Source("PSCZ", "TVZ", -1.0),
        Source("CTUN", "DCRt", -1.0, old_factor=1e-2, needs_height_loop=True),
    ),
    **{
        f"torque_setpoint_{axis}": (Source("RATE", f"{letter}Out", old_factor=1.0 / 4500.0),)
        for axis, letter in zip("xyz", "RPY", strict=True)
    },
    "hover_thrust_estimate": (
        Source("CTUN", "ThH", old_factor=1e-3, zero_is_absent=True),
        Source("CTUN", "ThrHov", old_factor=1e-3, zero_is_absent=True),
    ),
    "air_temperature": (Source("BARO", "Temp", zero_is_absent=True),),
    "battery_voltage": (
        Source("BAT", "Volt", zero_is_absent=True),
        Source("CURR", "Volt", old_factor=1e-2, zero_is_absent=True),
    ),
}

#: Channels whose source is the one that was logged most often, when much more often.
CHOSEN_BY_RATE = tuple(f"angular_rate_{axis}" for axis in "xyz")

#: Angles of the attitude in ATT [deg], turned about one after the other from the last to the first.
ATTITUDE = ("Roll", "Pitch", "Yaw")
#: Setpoints of attitude [deg] and of rates [deg/s], by axis: message, column; and of who makes them by mode.
ATTITUDE_SETPOINTS = {f"{angle}": f"Des{angle.capitalize()}" for angle in ("roll", "pitch", "yaw")}
RATE_SETPOINTS = {axis: f"{letter}Des" for axis, letter in zip("xyz", "RPY", strict=True)}

#: Modes of copters by number. A pilot flies in stabilize, acro, altitude hold, loiter, drift, sport, position
#: hold and flow hold; in stabilize and acro the throttle is the stick's.
PILOT_MODES = (0, 1, 2, 5, 11, 13, 16, 22)
OPEN_LOOP_MODES = (0, 1)
#: Sticks set the attitude in stabilize and altitude hold, rates in acro.
ATTITUDE_MODES = (0, 2)
RATE_MODES = (1,)
#: In system identification sticks set throttle and attitude as in stabilize, while the sweep is on an axis up
#: to this one; sweeps of position and velocity, behind it, have a loop for all.
SWEEP_MODE = 25
LAST_STICK_AXIS = 13
#: Modes without a loop that holds the height: stabilize, acro, drift and flip.
WITHOUT_HEIGHT_MODES = (0, 1, 11, 14)

#: Events: disarmed and landed, and what ends either.
LANDED_EVENTS = {11: 1.0, 18: 1.0, 28: 0.0}

#: Messages that say what holds until the next of them.
STATES = frozenset({"MODE", "EV", "ARM", "SIDS", "MSG", "VER", "PARM"})
#: Messages that are looked at.
NEEDED = frozenset(
    {source.message for sources in CHANNEL_SOURCES.values() for source in sources}
    | {"NKF6", "XKF6", "EKF6", "NKF4", "XKF4", "XKFS", "ATT", "RCOU", "RCIN", "MOTB", "ESC"}
    | {"MODE", "EV", "ARM", "MSG", "VER", "PARM", "SIDD", "SIDS", "FMTU", "UNIT", "MULT"}
    | ORIGIN_MESSAGES
)

_ATTITUDE = ("ATT.Roll, .Pitch and .Yaw",)
#: What was looked for, by channel, in the words of a message.
LOOKED_FOR: Mapping[str, tuple[str, ...]] = {
    **{name: tuple(source.label for source in sources) for name, sources in CHANNEL_SOURCES.items()},
    "input": (
        *(source.label for source in CHANNEL_SOURCES["input"]),
        "RCOU.C1 to .C4 through the thrust curve",
    ),
    "air_density": ("BARO.Press and .Temp",),
    **{f"attitude_{part}": _ATTITUDE for part in "wxyz"},
    **{
        f"{kind}reference_{angle}": (f"ATT.{column} {mode}",)
        for angle, column in ATTITUDE_SETPOINTS.items()
        for kind, mode in (("", "where sticks set the attitude"), ("feedback_", "where a loop does"))
    },
    **{
        f"{kind}reference_angular_rate_{axis}": (f"RATE.{column} {mode}",)
        for axis, column in RATE_SETPOINTS.items()
        for kind, mode in (("", "in acro mode"), ("feedback_", "in other modes"))
    },
    **{f"injected_torque_{axis}": ("SIDD.Targ of a sweep into the mixer",) for axis in "xyz"},
    "injected_throttle": ("SIDD.Targ of a sweep into the throttle",),
    "pilot_throttle": ("RCIN.C3",),
    "pilot_in_control": ("MODE.ModeNum",),
    "pilot_sets_attitude": ("MODE.ModeNum",),
    "input_open_loop": ("MODE.ModeNum",),
    "landed": ("EV.Id", "ARM.ArmState"),
    "actuator_output_1": ("RCOU.C1 to .C14",),
    "rotor_speed_1": ("ESC.RPM by .Instance",),
}
