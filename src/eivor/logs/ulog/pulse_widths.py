"""Motor outputs in microseconds, as shares of the range that parameters give.

PX4 turns a share s of a motor's full signal into the pulse width min + s (max - min). Of output n the range
is PWM_MAIN_MINn to PWM_MAIN_MAXn, or PWM_AUX_...; older firmware has PWM_MAIN_MIN, PWM_AUX_MIN or PWM_MIN for
all outputs, and -1 for an output without a range of its own. PWM_MAIN_FUNCn says which motor an output is of
(101 is the first), where the firmware knows. A pulse below the range belongs to a motor that is disarmed.
Outputs by DShot are counts from 0 to 1999, and no pulse widths.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eivor.logs.ulog.topics import FIRST_MOTOR_FUNCTION, MAX_ACTUATORS, PULSES_TOPIC
from eivor.shapes import Float
from eivor.signals.recording import Finding

#: Groups of outputs, by what their parameters begin with.
GROUPS = ("PWM_MAIN", "PWM_AUX")
#: What pulse widths of motors can be, running or disarmed [us].
WIDTHS = (700.0, 2300.0)
#: Values of PWM_MAIN_TIM0 and the like that mean DShot.
DSHOT_RATES = range(-5, -1)


@dataclass(frozen=True, slots=True)
class PulseRange:
    """Range of an output.

    Parameters
    ----------
    low, high : float
        Pulse widths of a motor that idles, and at full signal [us].
    names : tuple of str
        The parameters that say so.
    """

    low: float
    high: float
    names: tuple[str, str]

    def share(self, widths: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Shares of the full signal, from zero to one; NaN stays."""
        return np.asarray(np.clip((widths - self.low) / (self.high - self.low), 0.0, 1.0))


def are_pulses(columns: Sequence[Float[np.ndarray, " n"]], parameters: Mapping[str, float]) -> bool:
    """Whether outputs are pulse widths: all in their range, but for zeros, and none of them by DShot."""
    values = np.concatenate(columns) if columns else np.empty(0)
    values = values[np.isfinite(values) & (values != 0.0)]
    if not values.size or values.min() < WIDTHS[0] or values.max() > WIDTHS[1]:
        return False
    timers = [f"{group}_TIM{number}" for group in GROUPS for number in range(MAX_ACTUATORS)]
    by_dshot = any(int(parameters.get(name, 0.0)) in DSHOT_RATES for name in timers)
    return not (by_dshot or parameters.get("DSHOT_CONFIG", 0.0) > 0.0)


def as_shares(
    widths: Mapping[int, Float[np.ndarray, " n"]], parameters: Mapping[str, float]
) -> tuple[dict[int, Float[np.ndarray, " n"]], Finding]:
    """Outputs of motors as shares, in the order of the motors, and what to say of it.

    Parameters
    ----------
    widths : mapping of int to ndarray
        Pulse widths of the outputs that move [us], by their place from 0 on.
    parameters : mapping of str to float
        Of the log.

    Returns
    -------
    dict, Finding
        The pulse widths themselves where a range is not known.
    """
    group, motors = motor_outputs(list(widths), parameters)
    ranges = {place: pulse_range(group, place, parameters) for place in motors}
    known = {place: one for place, one in ranges.items() if one is not None}
    if len(known) < len(ranges):
        sentence = (
            f"{PULSES_TOPIC} holds pulse widths in microseconds, and no parameter tells their range "
            f"({group}_MIN1 and {group}_MAX1, or PWM_MIN and PWM_MAX): they stay as they are, and no input "
            "map fits an offset."
        )
        return dict(widths), Finding("pulse_range_unknown", sentence)
    told = dict.fromkeys((one.low, one.high) for one in known.values())
    first = {ends: next(one for one in known.values() if (one.low, one.high) == ends) for ends in told}
    in_words = [f"{one.low:g} to {one.high:g} ({' and '.join(one.names)})" for one in first.values()]
    sentence = (
        f"{PULSES_TOPIC} holds pulse widths in microseconds: they are read as shares of the range "
        f"{', '.join(in_words)}."
    )
    return {place: one.share(widths[place]) for place, one in known.items()}, Finding(
        "pulse_widths", sentence
    )


def motor_outputs(places: Sequence[int], parameters: Mapping[str, float]) -> tuple[str, dict[int, int]]:
    """Group that outputs are of, and the motor of each, from 1 on; of all in order where nothing tells.

    Parameters
    ----------
    places : sequence of int
        Outputs that move, from 0 on.
    parameters : mapping of str to float
        Of the log.
    """
    for group in GROUPS:
        function = {place: int(parameters.get(f"{group}_FUNC{place + 1}", 0.0)) for place in places}
        motors = {
            place: which - FIRST_MOTOR_FUNCTION + 1
            for place, which in function.items()
            if FIRST_MOTOR_FUNCTION <= which < FIRST_MOTOR_FUNCTION + MAX_ACTUATORS
        }
        if motors:
            return group, dict(sorted(motors.items(), key=lambda item: item[1]))
    return GROUPS[0], {place: number for number, place in enumerate(places, start=1)}


def pulse_range(group: str, place: int, parameters: Mapping[str, float]) -> PulseRange | None:
    """Range of an output, from 0 on; None where no parameter tells it."""
    ends = [_told(group, end, place, parameters) for end in ("MIN", "MAX")]
    low, high = ends
    if low is None or high is None or not low[1] < high[1]:
        return None
    return PulseRange(low[1], high[1], (low[0], high[0]))


def _told(group: str, end: str, place: int, parameters: Mapping[str, float]) -> tuple[str, float] | None:
    """The parameter in force for one end of the range."""
    for name in (f"{group}_{end}{place + 1}", f"{group}_{end}", f"PWM_{end}"):
        if WIDTHS[0] <= parameters.get(name, -1.0) <= WIDTHS[1]:
            return name, parameters[name]
    return None
