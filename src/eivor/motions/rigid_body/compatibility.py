"""Compatibility of sensors by kinematics, as in flight-path reconstruction (Klein and Morelli, ch. 10)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from eivor.errors import EstimationError
from eivor.estimation.estimate import Estimate
from eivor.estimation.methods import identify, least_squares
from eivor.flights.grid import Grid, common_grid, on_grid, upward
from eivor.flights.quantity import NAN
from eivor.inference.covariance import EqualWeightedCosines
from eivor.inference.distributions import t_quantile
from eivor.logs.common import low_pass_delay_s
from eivor.models.regression import regression
from eivor.motions.rigid_body import dynamics
from eivor.signals.filters import time_derivative
from eivor.signals.recording import Channel, Frame, Recording
from eivor.tools import Bool, Complex, Float

RATES, FORCES = (
    tuple(f"{name}_{axis}" for axis in "xyz") for name in ("angular_rate", "specific_force_body")
)
#: Band in which sensors are compared [Hz]: above drift, below most vibration.
BAND_HZ = (0.2, 6.0)
#: Stretches of so long are compared [s], half as long apart; fewer say nothing.
STRETCH_S, FEWEST = 4.0, 6
#: Largest offset of two clocks that is looked for [s], and the step of the search.
LARGEST_OFFSET_S, OFFSET_STEP_S = 0.1, 5e-4
LEAST_STEP_S, LONGEST_STEP_S = 0.002, 0.01
#: Axes that a turn about each mixes.
PAIRS = ((1, 2), (2, 0), (0, 1))
#: Coherence from which an axis is compared.
COHERENT = 0.5
#: Standard errors of an offset that is corrected, and its least size [s].
SURE, LEAST_OFFSET_S = 3.0, 0.002


@dataclass(frozen=True)
class Calibration:
    """One number of a comparison of sensors."""

    what: str
    value: float
    interval: tuple[float, float]
    unit: str


@dataclass(frozen=True)
class Comparison:
    """Spectra of stretches of a sensor and of what kinematics makes of the others, for each axis."""

    sensor: str
    kinematic: str
    unit: str
    frequency: Float[np.ndarray, " bins"]  # [Hz]
    measured: Complex[np.ndarray, "stretches 3 bins"]
    derived: Complex[np.ndarray, "stretches 3 bins"]
    means: Float[np.ndarray, "stretches 3"]  # Of measured less derived

    @cached_property
    def coherent(self) -> Bool[np.ndarray, " 3"]:
        """Axes that moved enough to be compared."""
        aligned = self.measured * self._turn(self._offset(np.ones(3, dtype=bool), slice(None)))
        cross = np.abs((aligned * self.derived.conj()).sum(axis=(0, 2))) ** 2
        power = (np.abs(self.measured) ** 2).sum(axis=(0, 2)) * (np.abs(self.derived) ** 2).sum(axis=(0, 2))
        return np.asarray(cross >= COHERENT * power) & (power > 0.0)

    def _turn(self, offset_s: float) -> Complex[np.ndarray, " bins"]:
        return np.exp(2j * np.pi * self.frequency * offset_s)

    def _offset(self, axes: Bool[np.ndarray, " 3"], stretches: slice | Sequence[int]) -> float:
        """Time by which the sensor is behind, of the largest correlation [s]."""
        weights = 1.0 / np.maximum((np.abs(self.derived) ** 2).sum(axis=(0, 2)), 1e-300)
        cross_spectra = self.measured[stretches] * self.derived[stretches].conj() * weights[:, None]
        cross = cross_spectra[:, axes].sum(axis=(0, 1))
        offsets = np.arange(-LARGEST_OFFSET_S, LARGEST_OFFSET_S + OFFSET_STEP_S, OFFSET_STEP_S)
        values = (np.exp(2j * np.pi * np.outer(offsets, self.frequency)) @ cross).real
        best = int(np.clip(np.argmax(values), 1, offsets.size - 2))
        left, middle, right = values[best - 1 : best + 2]
        bend = left - 2.0 * middle + right
        return float(offsets[best] + (0.5 * (left - right) / bend * OFFSET_STEP_S if bend < 0.0 else 0.0))

    def _gains(self, offset_s: float, stretches: slice | Sequence[int]) -> Float[np.ndarray, "3 3"]:
        """Least squares of the sensor's axes by the derived ones, of those that are coherent."""
        axes = np.flatnonzero(self.coherent)
        X = self.derived[stretches][:, axes]
        Y = self.measured[stretches] * self._turn(offset_s)
        cross = np.einsum("sif,sjf->ij", Y[:, axes], X.conj()).real
        matrix = np.eye(3)
        matrix[np.ix_(axes, axes)] = cross @ np.linalg.pinv(np.einsum("sif,sjf->ij", X, X.conj()).real)
        return matrix

    def numbers(self, stretches: slice | Sequence[int] = slice(None)) -> Float[np.ndarray, " k"]:
        """Offset, three scales by either regression, three biases, three turns between the axes."""
        offset = self._offset(self.coherent, stretches)
        matrix = self._gains(offset, stretches)
        scales = np.diag(matrix)
        aligned, derived = self.measured[stretches] * self._turn(offset), self.derived[stretches]
        power = np.maximum((np.abs(aligned) ** 2).sum(axis=(0, 2)), 1e-300)
        reverse = power / np.maximum((aligned * derived.conj()).real.sum(axis=(0, 2)), 1e-9 * power)
        turns = [0.5 * (matrix[b, a] / scales[a] - matrix[a, b] / scales[b]) for a, b in PAIRS]
        return np.array([offset, *scales, *reverse, *np.median(self.means[stretches], axis=0), *turns])

    @cached_property
    def estimates(self) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
        """The numbers and their jackknife standard errors, by pairs of neighbouring stretches."""
        count = len(self.measured)
        subsets = [np.delete(np.arange(count), [at, at + 1]).tolist() for at in range(0, count - 1, 2)]
        runs = np.stack([self.numbers(stretches) for stretches in subsets])
        spread = (len(runs) - 1) / len(runs) * ((runs - runs.mean(axis=0)) ** 2).sum(axis=0)
        return self.numbers(), np.sqrt(spread)

    def offset_s(self, filter_s: float) -> float:
        """Offset of the clocks beyond the delay of a filter, where it is sure [s]; else zero."""
        if self.searched_in_vain or not self.coherent.any():
            return 0.0
        value, error = self.estimates[0][0] - filter_s, self.estimates[1][0]
        return float(value) if abs(value) > max(SURE * error, LEAST_OFFSET_S) else 0.0

    @property
    def searched_in_vain(self) -> bool:
        """Whether the offset is an end of the search, which is no measurement."""
        offset = self._offset(self.coherent, slice(None)) if self.coherent.any() else 0.0
        return abs(offset) > LARGEST_OFFSET_S - 2.0 * OFFSET_STEP_S

    def table(self) -> Iterator[Calibration]:
        """Calibrations of the axes that moved."""
        values, errors = self.estimates
        quantile = t_quantile(0.95, len(self.measured) // 2 - 1)
        coherent = self.coherent

        def number(label: str, index: int, unit: str, scale: float = 1.0) -> Calibration:
            value, half_width = scale * float(values[index]), scale * quantile * float(errors[index])
            return Calibration(label, value, (value - half_width, value + half_width), unit)

        if coherent.any():
            yield number(f"{self.sensor} behind the {self.kinematic}", 0, "ms", 1e3)
        for axis in np.flatnonzero(coherent).tolist():
            # noise of what kinematics makes attenuates the first, noise of the sensor raises the second
            label = f"{self.sensor}, scale along {'xyz'[axis]}"
            lower, upper = (number(label, start + axis, "") for start in (1, 4))
            value = float(np.sqrt(max(lower.value * upper.value, 0.0)))
            yield replace(lower, value=value, interval=(lower.interval[0], upper.interval[1]))
        for axis in range(3):
            yield number(f"{self.sensor}, bias along {'xyz'[axis]}", 7 + axis, self.unit)
        for axis in range(3):
            if coherent[(axis + 1) % 3] and coherent[(axis + 2) % 3]:
                label = f"{self.sensor}, turned about {'xyz'[axis]} against the {self.kinematic}"
                yield number(label, 10 + axis, "deg", float(np.rad2deg(1.0)))


def comparisons(log: Recording, spans_s: Sequence[tuple[float, float]]) -> Iterator[Comparison]:
    """Gyroscope against attitude, and accelerometer against velocity, in the air; those that are logged."""
    log = upward(log)
    for words, needed in (
        (("gyroscope", "attitude", "rad/s"), (*RATES, *dynamics.ATTITUDE)),
        (("accelerometer", "velocity", "m/s²"), (*FORCES, *dynamics.ATTITUDE, *dynamics.VELOCITY)),
    ):
        if logged(log, needed):
            yield from _comparison(words, [log.channels[name] for name in needed], spans_s)


def logged(log: Recording, names: Iterable[str]) -> bool:
    """Whether all of these have values."""
    return all(name in log.channels and np.isfinite(log.channels[name].values).any() for name in names)


def _on_common_grid(
    channels: Sequence[Channel], step_s: float
) -> tuple[Grid, Float[np.ndarray, "k n"], Bool[np.ndarray, " n"]]:
    """Channels on one grid, and the mask of samples with data of all."""
    grid = common_grid(channels, channels, step_s)
    pairs = [on_grid(channel, grid) for channel in channels]
    return grid, np.stack([values for values, _ in pairs]), np.all([mask for _, mask in pairs], axis=0)


def _comparison(
    words: tuple[str, str, str], channels: Sequence[Channel], spans_s: Sequence[tuple[float, float]]
) -> Iterator[Comparison]:
    rate_hz = min(channel.rate_hz for channel in channels)
    step_s = float(np.clip(1.0 / max(rate_hz, 1e-9), LEAST_STEP_S, LONGEST_STEP_S))
    if not rate_hz > 3.0 * BAND_HZ[1]:
        return
    grid, series, valid = _on_common_grid(channels, step_s)
    measured, attitude, velocity = series[:3], series[3:7], series[7:]
    attitude = dynamics.continuous(attitude)
    size = np.sqrt((attitude**2).sum(axis=0))
    attitude = attitude / np.where(size > 0.0, size, 1.0)
    if len(velocity):
        derived = dynamics.felt(dynamics.rotation(*attitude), velocity, grid.step_s)
    else:
        change = np.stack([time_derivative(part, grid.step_s) for part in attitude])
        derived = 2.0 * dynamics.vector_part(attitude, change)
    time, length = grid.time_s, round(STRETCH_S / grid.step_s)
    frequency = np.fft.rfftfreq(length, grid.step_s)
    band = (frequency >= BAND_HZ[0]) & (frequency <= BAND_HZ[1])
    spectra, means = [], []
    for begin in range(0, grid.count - length + 1, length // 2):
        part = slice(begin, begin + length)
        inside = any(low <= time[begin] and time[begin + length - 1] <= high for low, high in spans_s)
        if not inside or not valid[part].all():
            continue
        pair = np.stack([measured[:, part], derived[:, part]])
        means.append((pair[0] - pair[1]).mean(axis=1))
        level = pair - pair.mean(axis=2, keepdims=True)
        spectra.append(np.fft.rfft(level * np.hanning(length))[..., band])
    if len(spectra) >= FEWEST:
        stacked = np.stack(spectra)
        yield Comparison(*words, frequency[band], stacked[:, 0], stacked[:, 1], np.stack(means))


def with_one_clock(
    log: Recording, spans_s: Sequence[tuple[float, float]], cutoff_hz: float | None = None
) -> tuple[Recording, tuple[str, ...]]:
    """The log with attitude, velocity and position on the gyroscope's clock where they are surely off it."""
    # the equations have the low-pass of the vehicle file, less what a reader has taken out
    rate = log.channels.get(RATES[0])
    filter_s = low_pass_delay_s(cutoff_hz) - rate.delay_s if cutoff_hz and rate else 0.0
    compared = next((item for item in comparisons(log, spans_s) if item.sensor == "gyroscope"), None)
    offset = compared.offset_s(filter_s) if compared else 0.0
    if not offset:
        sentence = (
            f"At no offset of clocks within {LARGEST_OFFSET_S:g} s does the attitude turn as the gyroscope "
            "says: check its four parts, their signs, and the stamps of both."
        )
        return log, (sentence,) if compared and compared.searched_in_vain else ()

    def moved(names: Sequence[str]) -> Recording:
        channels = {
            name: replace(item, time_s=item.time_s + offset, delay_s=item.delay_s - offset)
            for name, item in log.channels.items()
            if name in names
        }
        return replace(log, channels={**log.channels, **channels})

    # most estimators make the velocity with the attitude; the accelerometer shows which do not
    alike = moved((*dynamics.ATTITUDE, *dynamics.VELOCITY, *dynamics.POSITION))
    alone = moved(dynamics.ATTITUDE)
    made = (item for log in (alike, alone) for item in comparisons(log, spans_s))
    forces = [item for item in made if item.sensor == "accelerometer"]
    left = [(np.abs(item.measured - item.derived) ** 2).sum(axis=(1, 2)) for item in forces]
    gained = np.log(left[0] / left[1]) if len(left) == 2 and left[0].size == left[1].size else np.zeros(2)
    separate = gained.mean() > SURE * gained.std(ddof=1) / np.sqrt(gained.size)
    what = "it, without the velocity, is" if separate else "attitude, velocity and position are"
    sentence = (
        f"The attitude is {1e3 * abs(offset):.1f} ms {'ahead of' if offset > 0.0 else 'behind'} the "
        f"gyroscope: {what} put on its clock."
    )
    return alone if separate else alike, (sentence,)


#: Over which the slope of a position is its velocity, and the longest step of such a position [s].
SLOPE_S, LONGEST_POSITION_STEP_S = 0.12, 0.04


def with_velocity(log: Recording) -> Recording:
    """The log with slopes of its position as velocity, where none is logged."""
    positions = [log.channels[name] for name in dynamics.POSITION if name in log.channels]
    if any(name in log.channels for name in dynamics.VELOCITY) or len(positions) < 3:
        return log
    slopes = {}
    for name, item in zip(dynamics.VELOCITY, positions, strict=True):
        known = np.isfinite(item.values)
        t, x = item.time_s[known] - item.time_s[0], item.values[known]
        step_s = float(np.median(np.diff(t))) if x.size > 1 else np.inf
        if step_s > LONGEST_POSITION_STEP_S:
            return log
        size = 2 * max(round(0.5 * SLOPE_S / step_s), 1) + 1
        means = [scipy.ndimage.uniform_filter1d(y, size, mode="nearest") for y in (t, x, t * t, t * x)]
        slope = (means[3] - means[0] * means[1]) / (means[2] - means[0] ** 2)
        slopes[name] = Channel(name, item.time_s[known], slope, "m/s")
    return replace(log, channels={**log.channels, **slopes})


# -- Wind --

#: A tube measures air from ahead: so fast [m/s], and within 30 degrees of the body's x.
AIRSPEED, LEAST_AHEAD, LEAST_COSINE = "airspeed", 3.0, 0.87
#: Step of the comparison, and the least time of such air [s]; times that it is chosen by the last estimate.
WIND_STEP_S, LEAST_AIR_S, REPEATS = 0.1, 10.0, 4
#: Standard deviation of the nose's direction from which errors of the attitude matter little [rad].
LEAST_TURN = 0.2
#: Of gusts a flight holds few independent ones: so many cosine averages.
AVERAGES = 4
#: A wind whose interval reaches further to either side is not known [m/s].
KNOWN_WITHIN = 3.0
WIND, SCALE = ("wind_x", "wind_y"), "scale"
MEASURED_AIR = (*dynamics.ATTITUDE, *dynamics.VELOCITY, AIRSPEED)


def wind_of(log: Recording, spans_s: Iterable[tuple[float, float]]) -> Estimate | None:
    """Wind of a log, z up, by airspeed = scale (velocity less wind) along the nose; None if not known."""
    if not logged(log, MEASURED_AIR):
        return None
    grid, series, valid = _on_common_grid([log.channels[name] for name in MEASURED_AIR], WIND_STEP_S)
    nose = np.stack([row[0] for row in dynamics.rotation(*dynamics.continuous(series[:4]))])
    velocity, measured, time_s = series[4:7], series[7], grid.time_s
    valid &= np.any([(time_s >= low) & (time_s <= high) for low, high in spans_s], axis=0)
    scale, wind, used, estimate = 1.0, np.zeros(3), valid & (measured > LEAST_AHEAD), None
    for _ in range(REPEATS):
        # by changes from the last estimate, so that the wind is a parameter
        ahead = (nose * (velocity - wind[:, None])).sum(axis=0)
        columns, response = np.stack([*(-scale * nose[:2]), ahead]), measured - scale * wind @ nose
        turning = np.linalg.norm(nose[:2, used].std(axis=1)) if used.any() else 0.0
        if used.sum() * grid.step_s < LEAST_AIR_S or turning < LEAST_TURN:
            return None
        try:
            rows = regression(response[used], columns[:, used].T, names=(*WIND, SCALE))
            estimate = identify(rows, least_squares()).with_covariance(EqualWeightedCosines(AVERAGES))
        except EstimationError:  # the nose points nowhere else
            return None
        wind[:2], scale = estimate.theta[:2], float(estimate.theta[2])
        air = velocity - wind[:, None]
        used = valid & (
            (nose * air).sum(axis=0) > np.maximum(LEAST_AHEAD, LEAST_COSINE * np.linalg.norm(air, axis=0))
        )
    widest = max(high - low for low, high in map(estimate.interval, WIND)) if estimate else np.inf
    return estimate if widest <= 2.0 * KNOWN_WITHIN else None


def wind_table(log: Recording, spans_s: Sequence[tuple[float, float]]) -> Iterator[Calibration]:
    """Wind, towards which the air moves, and the sensor's scale; NaN of what is not known."""
    if not logged(log, MEASURED_AIR):
        return
    known, down = wind_of(upward(log), spans_s), log.frame is Frame.NED
    # where z is down, x points north, and y, which is turned up, to the west
    east, north = ((WIND[1], -1.0), (WIND[0], 1.0)) if down else ((WIND[0], 1.0), (WIND[1], 1.0))
    for label, (name, sign), unit in (
        ("wind to the east", east, "m/s"),
        ("wind to the north", north, "m/s"),
        ("airspeed, scale", (SCALE, 1.0), ""),
    ):
        value, low, high = NAN, NAN, NAN
        if known is not None:
            value = sign * known.parameters[name]
            low, high = sorted(sign * end for end in known.interval(name))
        yield Calibration(label, value, (low, high), unit)


def in_still_air(log: Recording, spans_s: Sequence[tuple[float, float]]) -> tuple[Recording, tuple[str, ...]]:
    """A log, z up, whose world moves with the wind, where airspeed determines it."""
    if not logged(log, MEASURED_AIR):
        return log, ()
    known = wind_of(log, spans_s)
    if known is None:
        note = "The airspeed does not determine the wind, since the vehicle hardly turned: air is at rest."
        return log, (note,)
    channels = dict(log.channels)
    for stem, power in (("velocity", 0), ("position", 1)):
        for axis, speed_along in zip("xy", known.theta, strict=False):
            item = channels.get(f"{stem}_{axis}")
            if item is not None:
                channels[item.name] = replace(item, values=item.values - speed_along * item.time_s**power)
    speed = float(np.hypot(*known.theta[:2]))
    text = f"A wind of {speed:.2g} m/s, by the airspeed, is taken out of velocity and position."
    return replace(log, channels=channels), (text,)
