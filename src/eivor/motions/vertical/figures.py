"""Key figures of flights: numbers beside the quantities, which decide nothing."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from eivor.flights.grid import on_grid
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Counts, KeyFigure, Quantity, SystematicUncertainty, widened
from eivor.inference.covariance import COSINE_AVERAGES, long_run_mean_variance
from eivor.inference.distributions import normal_quantile, t_quantile
from eivor.inference.verdict import Status
from eivor.motions.vertical.model import CURVE_PARAMETERS, CurveFamily, curve_in_force, proposed
from eivor.motions.vertical.regression import HOVER_DRIFT, VOLTAGE, channel_on_grid
from eivor.motions.vertical.verdict import GAIN, HOVER, is_setpoint
from eivor.signals.channels import CurveSide
from eivor.signals.thrust_map import input_map

#: What the hover input of one vehicle differs by between flights: charge, payload, air; half of 95 %.
BETWEEN_FLIGHTS = 0.025
#: Highest thrust setpoint that an autopilot gives.
HIGHEST = "MPC_THR_MAX"
#: Families of commands of single motors, then of their speeds.
MOTORS = ("rotor_command", "actuator_output", "rotor_speed")
#: A command that is a smaller share of the largest drives nothing that lifts.
LEAST_MOTOR = 0.1
#: Vibration is above this [Hz]; the accelerometer is logged so many times quicker, in stretches of [s].
VIBRATION_HZ, QUICKER, STRETCH_S = 20.0, 4.0, 2.0
#: The supply is looked at in means of so many seconds, of flights with so many of them.
SUPPLY_S, LEAST_MEANS = 2.0, 15
#: Power of time that is charge, and no answer to a load.
CHARGE_POWER = 3


def key_figures(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Quantity], numbers: Mapping[str, float]
) -> Iterator[KeyFigure]:
    """Key figures of flights; those of single motors and sensors of one flight only."""
    yield from _of_hover(flights, quantities[HOVER], numbers)
    yield from _thrust_curve(flights, quantities, numbers)
    if len(flights) == 1:
        yield from _motors(flights[0])
        yield from _vibration(flights[0])
        yield from _supply(flights[0], quantities[HOVER])


def _of_hover(
    flights: tuple[PreparedFlight, ...], hover: Quantity, numbers: Mapping[str, float]
) -> Iterator[KeyFigure]:
    """Drift, the next flight, and the command that is left above hover."""
    if hover.verdict is Status.REFUSED:
        return
    change, half = numbers.get(HOVER_DRIFT, math.nan), numbers.get(f"{HOVER_DRIFT}_half_width", math.nan)
    if math.isfinite(half):
        clear = "The hover input moves: its value is that of the middle." if abs(change) > half else ""
        ends = 100.0 * (change - half), 100.0 * (change + half)
        yield KeyFigure(HOVER_DRIFT, "drift of the hover input", 100.0 * change, "%/min", ends, clear)
    size = BETWEEN_FLIGHTS * hover.value
    between = SystematicUncertainty(Counts.INDEPENDENT, size, size, "")
    wide, words = widened(hover.interval, hover.value, (between,)), "hover input of another flight"
    to_set = "Another charge of the battery, the same payload: the number to set."
    yield KeyFigure("hover_next_flight", words, hover.value, "", wide, to_set)
    first = flights[0]
    highest = first.recording.parameters.get(HIGHEST, 1.0) if is_setpoint(first) else 1.0
    if 0.0 < hover.interval[1] < highest and not first.input.measured:
        left = highest - hover.interval[1], highest - hover.interval[0]
        full = f"The highest command, {highest:.3g}, is {highest / hover.value:.3g} times that of hover."
        yield KeyFigure("thrust_margin", "command left above hover", highest - hover.value, "", left, full)


def _thrust_curve(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Quantity], numbers: Mapping[str, float]
) -> Iterator[KeyFigure]:
    """Exponent of thrust near hover by the gain, and the autopilot's parameter that it is."""
    gain, hover, exponent = quantities[GAIN], quantities[HOVER], numbers.get("thrust_exponent", math.nan)
    if gain.verdict is Status.REFUSED or hover.verdict is Status.REFUSED or not exponent > 0.0:
        return
    half = normal_quantile(0.95) * gain.std_error
    parts = [part for part in gain.systematic_uncertainties if part.counts is not Counts.AT_LEAST]
    ends = widened((gain.value - half, gain.value + half), gain.value, parts)
    low, high = (exponent * end / gain.value for end in ends)
    words = "thrust grows as the command to the power"
    yield KeyFigure("thrust_exponent", words, exponent, "", (low, high), "Near hover; 1 is a line.")
    side, family = flights[0].curve_side, CurveFamily(of_share=False)
    if side is CurveSide.UNKNOWN or flights[0].input.measured or not 0.0 < hover.value < 1.0:
        return
    in_force = curve_in_force([flight.recording.parameters for flight in flights])
    curve, about = (exponent, (low, high)), (hover.value, hover.interval)
    for parameter in CURVE_PARAMETERS:
        name, value = parameter.name, in_force.get(parameter.name, math.nan)
        before = value if side is CurveSide.BEFORE else None
        if parameter.takes(value):
            (share, ends), _ = proposed(parameter, family, curve, about, before)
            if parameter.takes(share):
                yield KeyFigure(name, f"{name}, which is {value:.2g}", share, "", ends)


def _motors(flight: PreparedFlight) -> Iterator[KeyFigure]:
    """Command, or else speed, of each motor over the mean of all."""
    for family in MOTORS:
        members = flight.recording.family(family)
        used = [on_grid(member, flight.grid)[0][flight.used] for member in members]
        means = np.array([item.mean() for item in used])
        lifting = np.flatnonzero(means > LEAST_MOTOR * means.max(initial=0.0))
        # pulse widths are no shares: where they begin is not known
        if lifting.size < 2 or (family != MOTORS[-1] and means.max() > 1.0):
            continue
        mean = float(means[lifting].mean())
        for number in lifting.tolist():
            share = float(means[number]) / mean
            left = (used[number] - share * np.mean([used[other] for other in lifting], axis=0)) / mean
            half = t_quantile(0.95, COSINE_AVERAGES) * math.sqrt(long_run_mean_variance(left))
            motor, ends = members[number].name.rpartition("_")[2], (share - half, share + half)
            words = f"{family.replace('_', ' ')}s over their mean"
            yield KeyFigure(f"motor_share_{motor}", words, share, "", ends)
        return


def _vibration(flight: PreparedFlight) -> Iterator[KeyFigure]:
    """Root mean square of the accelerometer above `VIBRATION_HZ`, and where its spectrum peaks."""
    axes = [flight.recording.channels.get(f"specific_force_body_{axis}") for axis in "xyz"]
    logged = [axis for axis in axes if axis is not None and axis.time_s.size]
    if len(logged) < 3 or any(not np.array_equal(axis.time_s, logged[0].time_s) for axis in logged):
        return
    rate, time = logged[0].rate_hz, logged[0].time_s
    if not rate >= QUICKER * VIBRATION_HZ:
        return
    values, length = np.stack([axis.values for axis in logged], axis=1), round(STRETCH_S * rate)
    starts = [
        first
        for run in flight.runs
        for begin, end in [np.searchsorted(time, flight.grid.time_s[[run.start, run.stop - 1]])]
        for first in range(begin, end - length, length)
    ]
    parts = np.array([values[first : first + length] for first in starts]).reshape(-1, length, 3)
    parts = parts[np.isfinite(parts).all(axis=(1, 2))]
    if len(parts) < 2:
        return
    taper = np.hanning(length)[:, None]
    spectra = np.abs(np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * taper, axis=1)) ** 2
    frequency = np.fft.rfftfreq(length, 1.0 / rate)
    # of one side, as a mean square of all axes in each stretch
    above = frequency > VIBRATION_HZ
    power = 2.0 * spectra.sum(axis=2)[:, above] / (length * float((taper**2).sum()))
    squares = power.sum(axis=1)
    half = t_quantile(0.95, len(squares) - 1) * float(squares.std(ddof=1)) / math.sqrt(len(squares))
    mean = float(squares.mean())
    ends = math.sqrt(max(mean - half, 0.0)), math.sqrt(mean + half)
    band = f"{VIBRATION_HZ:.0f} to {0.5 * rate:.0f} Hz, all axes, as logged."
    yield KeyFigure("vibration", "vibration of the accelerometer (rms)", math.sqrt(mean), "m/s^2", ends, band)
    peak = float(frequency[above][np.argmax(power.mean(axis=0))])
    folded = "What is quicker than half the logging rate is folded below it."
    yield KeyFigure("vibration_peak", "peak of the vibration", peak, "Hz", None, folded)


def _supply(flight: PreparedFlight, hover: Quantity) -> Iterator[KeyFigure]:
    """Drop of the voltage when the thrust grows by the weight."""
    volts, chosen = channel_on_grid(flight, VOLTAGE), input_map(flight.input_map)
    if volts is None or flight.input.measured or not hover.value > 0.0:
        return
    level = chosen(flight.signals.family(flight.input.name)).mean(axis=1)
    length = round(SUPPLY_S / flight.signals.step_s)
    columns = np.column_stack([volts, level / chosen(np.array([hover.value]))[0], flight.grid.time_s])
    means = [
        columns[first : first + length].mean(axis=0)
        for run in flight.runs
        for first in range(run.start, run.stop - length + 1, length)
    ]
    if len(means) < LEAST_MEANS:
        return
    voltage, load, time = np.array(means).T
    charge = np.vander((time - time.mean()) / float(np.ptp(time)), CHARGE_POWER + 1)
    series = np.column_stack([load, voltage])
    quick, answered = (series - charge @ np.linalg.lstsq(charge, series, rcond=None)[0]).T
    squares = float(quick @ quick)
    if not squares > 0.0:
        return
    slope = float(quick @ answered) / squares
    error = math.sqrt(long_run_mean_variance(quick * (answered - slope * quick))) * len(means) / squares
    half = t_quantile(0.95, COSINE_AVERAGES) * error
    words, ends = "battery sag by a thrust of the weight", (-slope - half, -slope + half)
    by = "The voltage falls by it when the thrust doubles from hover."
    yield KeyFigure("battery_sag", words, -slope, "V", ends, by)
