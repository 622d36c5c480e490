"""Motor outputs of ArduPilot: pulse widths as shares of the motors' range, and the thrust they stand for.

A pulse width is turned into a share of the motor's range by MOT_PWM_MIN and MOT_PWM_MAX, or by RC3_MIN and
RC3_MAX where those are zero; the range in use is MOT_SPIN_MIN to MOT_SPIN_MAX of it. With the share x of
that, e = MOT_THST_EXPO and the voltage's ratio V (MOTB.BatVolt), the thrust is

    ((1 - e) x V + e (x V)^2) / L,   L = (1 - e) V + e V^2,

the thrust linearisation of AP_Motors, inverted. Motors are the outputs whose SERVOn_FUNCTION is a motor's, or
the first four of older firmware.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eivor.shapes import Float

#: Numbers of SERVOn_FUNCTION: motors 1 to 8, and 9 to 12.
MOTOR_FUNCTIONS = {**{33 + n: 1 + n for n in range(8)}, **{82 + n: 9 + n for n in range(4)}}
#: Outputs that RCOU has.
OUTPUTS = 14
#: The autopilot's own values where a parameter is not logged.
SPIN_MIN, SPIN_MAX, CURVE = 0.15, 0.95, 0.65
#: How far a line through both thrusts may be from the diagonal: in slope, and in its height where the log is.
SLOPE_WITHIN, OFFSET_WITHIN = 0.1, 0.05
#: Throttles below are those of the ground; fewer messages, or less spread, say nothing.
LEAST_THROTTLE, LEAST_COUNT, LEAST_SPREAD = 0.1, 50, 0.01


@dataclass(frozen=True, slots=True)
class MotorRange:
    """Range of the motors' pulse widths, and the curve of their thrust.

    Parameters
    ----------
    low, high : float
        Pulse widths [us].
    names : str
        The parameters that say so.
    spin_min, spin_max : float
        Shares of the range that are in use.
    curve : float
        Share of the square in the thrust.
    """

    low: float
    high: float
    names: str
    spin_min: float
    spin_max: float
    curve: float

    def share(self, widths: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """Shares of the range in use, from zero to one."""
        actuator = (widths - self.low) / (self.high - self.low)
        return np.asarray(np.clip((actuator - self.spin_min) / (self.spin_max - self.spin_min), 0.0, 1.0))

    def thrust(
        self, share: Float[np.ndarray, "*shape"], voltage: Float[np.ndarray, "*shape"]
    ) -> Float[np.ndarray, "*shape"]:
        """Share of the full thrust at a share of the range and a ratio of the voltage."""
        state = share * voltage
        lift = (1.0 - self.curve) * voltage + self.curve * voltage**2
        return np.asarray(((1.0 - self.curve) * state + self.curve * state**2) / lift)


def motor_columns(parameters: Mapping[str, float]) -> dict[int, int]:
    """Output of each motor, both from 1 on.

    Parameters
    ----------
    parameters : mapping of str to float
        Of the log.
    """
    told = {
        MOTOR_FUNCTIONS[function]: output
        for output in range(1, OUTPUTS + 1)
        if (function := int(parameters.get(f"SERVO{output}_FUNCTION", 0.0))) in MOTOR_FUNCTIONS
    }
    return dict(sorted(told.items())) or {motor: motor for motor in range(1, 5)}


def motor_range(parameters: Mapping[str, float]) -> MotorRange | None:
    """Range of the motors; None where no parameter tells it.

    Parameters
    ----------
    parameters : mapping of str to float
        Of the log.
    """
    for names in (("MOT_PWM_MIN", "MOT_PWM_MAX"), ("RC3_MIN", "RC3_MAX")):
        low, high = (parameters.get(name, 0.0) for name in names)
        if 0.0 < low < high:
            break
    else:
        return None
    spin_min = parameters.get("MOT_SPIN_MIN", SPIN_MIN)
    spin_max = parameters.get("MOT_SPIN_MAX", SPIN_MAX)
    curve = min(max(parameters.get("MOT_THST_EXPO", CURVE), -1.0), 1.0)
    if not 0.0 <= spin_min < spin_max <= 1.0:
        return None
    return MotorRange(low, high, " and ".join(names), spin_min, spin_max, curve)


def disagreement(
    throttle: Float[np.ndarray, " n"], thrust: Float[np.ndarray, " n"], known: MotorRange
) -> str:
    """Sentence on pulse widths that do not fit the throttle; empty where they do, or nothing can be told.

    Parameters
    ----------
    throttle : ndarray, shape (n,)
        Share of the full thrust that is asked for, at each message of the outputs.
    thrust : ndarray, shape (n,)
        Mean thrust of the motors by their pulse widths.
    known : MotorRange
        With which it was computed.

    Notes
    -----
    The slope is the median over pairs that are half of all sorted throttles apart: moments at which motors
    are at their bounds, as in an upset, do not move it.
    """
    flown = np.isfinite(throttle) & np.isfinite(thrust) & (throttle > LEAST_THROTTLE)
    asked, given = throttle[flown], thrust[flown]
    if asked.size < LEAST_COUNT or asked.std() < LEAST_SPREAD:
        return ""
    order = np.argsort(asked, kind="stable")
    asked, given = asked[order], given[order]
    half = asked.size // 2
    apart = asked[half:] - asked[: asked.size - half] > 0.5 * LEAST_SPREAD
    if apart.sum() < LEAST_COUNT // 2:
        return ""
    rises = (given[half:] - given[: asked.size - half])[apart]
    slope = float(np.median(rises / (asked[half:] - asked[: asked.size - half])[apart]))
    offset = float(np.median(given - asked))
    if abs(slope - 1.0) <= SLOPE_WITHIN and abs(offset) <= OFFSET_WITHIN:
        return ""
    return (
        f"The thrust by the motors' pulse widths is {slope:.2f} times the throttle's changes, and "
        f"{offset:+.2f} off it: the range {known.low:g} to {known.high:g} us ({known.names}), MOT_SPIN_MIN, "
        "MOT_SPIN_MAX or MOT_THST_EXPO are not those of the flight."
    )
