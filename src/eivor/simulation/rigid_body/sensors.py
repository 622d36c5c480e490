"""Sensors: noise, a filter, a delay, and the stamps at which they are logged.

A sensor is read at every step of the simulation: the true value and its noise go through the filter, and come
out late. That is what the controller gets; of the same values the log holds those at the sensor's own rate.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from eivor.errors import ParameterError
from eivor.motions.rigid_body.coefficients import Value
from eivor.shapes import Float, Int
from eivor.signals.noise import MeasurementNoise, WhiteNoise
from eivor.simulation.rigid_body.delay_line import DelayLine

#: Stamps never err by more than this part of their period.
LARGEST_JITTER = 0.45


@dataclass(frozen=True, slots=True)
class Sensor:
    """How a quantity is measured, alike on each axis.

    Parameters
    ----------
    noise : MeasurementNoise
        Of the readings, before the filter.
    bias : float
        Constant error, in the unit of the quantity.
    rate_hz : float
        At which it is logged [Hz]; every reading where zero.
    cutoff_hz : float
        Of the filter, a low-pass of the second order with Butterworth's damping [Hz]; none where zero.
    delay_s : float
        By which readings are late [s], rounded to steps of the simulation.
    offset_s : float
        Time of the first one that is logged [s], rounded likewise.
    averaged_s : float
        What is logged are means over so much time that ends with their stamps [s], rounded likewise; the
        controller gets readings as they are.
    jitter_s : float
        Standard deviation of the stamps' error [s].

    Raises
    ------
    ParameterError
        When a number is out of its range.
    """

    noise: MeasurementNoise = field(default_factory=lambda: WhiteNoise(0.0))
    bias: float = 0.0
    rate_hz: float = 0.0
    cutoff_hz: float = 0.0
    delay_s: float = 0.0
    offset_s: float = 0.0
    averaged_s: float = 0.0
    jitter_s: float = 0.0

    def __post_init__(self) -> None:
        for name, most in (
            ("rate_hz", 1e5),
            ("cutoff_hz", 1e5),
            ("delay_s", 1.0),
            ("offset_s", 1.0),
            ("averaged_s", 1.0),
            ("jitter_s", 1.0),
        ):
            if not 0.0 <= getattr(self, name) <= most:
                raise ParameterError(
                    f"{name} between 0 and {most:g}", f"{getattr(self, name)}", "Correct the sensor."
                )
        if not np.isfinite(self.bias):
            raise ParameterError("a finite bias", f"{self.bias}", "Correct the sensor.")

    @property
    def lateness_s(self) -> float:
        """Delay of slow signals: its own and its filter's [s]."""
        return self.delay_s + (np.sqrt(2.0) / (2.0 * np.pi * self.cutoff_hz) if self.cutoff_hz else 0.0)

    def errors(self, count: int, axes: int, rng: np.random.Generator) -> Float[np.ndarray, "count axes"]:
        """What is added to the true values before the filter, one row for each step."""
        return self.bias + np.column_stack([self.noise.sample(count, rng) for _ in range(axes)])

    def readings(
        self, raw: Float[np.ndarray, "count axes"], step_s: float
    ) -> Float[np.ndarray, "count axes"]:
        """What comes out of filter and delay; both have seen the first value for ever."""
        late = round(self.delay_s / step_s)
        filtered = raw
        if self.cutoff_hz:
            from scipy.signal import lfilter, lfilter_zi

            b, a = low_pass(self.cutoff_hz, step_s)
            filtered = lfilter(b, a, raw, axis=0, zi=np.outer(lfilter_zi(b, a), raw[0]))[0]
        rows = np.maximum(np.arange(raw.shape[0]) - late, 0)
        return filtered[rows]

    def averages(
        self, readings: Float[np.ndarray, "count axes"], step_s: float
    ) -> Float[np.ndarray, "count axes"]:
        """What is logged of the readings: means over those of the last steps, of as many as there are."""
        steps = round(self.averaged_s / step_s)
        if steps < 2:
            return readings
        total = np.cumsum(np.vstack([np.zeros((1, readings.shape[1])), readings]), axis=0)
        last = np.arange(1, readings.shape[0] + 1)
        first = np.maximum(last - steps, 0)
        return (total[last] - total[first]) / (last - first)[:, None]

    def rows(self, count: int, step_s: float) -> Int[np.ndarray, " rows"]:
        """Which steps are logged."""
        first = round(self.offset_s / step_s)
        if not self.rate_hz:
            return np.arange(first, count)
        number = int((count - first) * step_s * self.rate_hz) + 1
        rows = first + np.rint(np.arange(number) / (self.rate_hz * step_s)).astype(np.int64)
        return np.unique(rows[rows < count])

    def stamps(
        self, rows: Int[np.ndarray, " rows"], step_s: float, rng: np.random.Generator
    ) -> Float[np.ndarray, " rows"]:
        """Stamps of the steps that are logged [s], with their error."""
        error = self.jitter_s * rng.standard_normal(rows.size)
        most = LARGEST_JITTER * (float(np.diff(rows).min()) if rows.size > 1 else 1.0) * step_s
        return rows * step_s + np.clip(error, -most, most)


def low_pass(cutoff_hz: float, step_s: float) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    """Numerator and denominator of the filter at a rate; see `Sensor`.

    Raises
    ------
    ParameterError
        When the cut-off is not below half the rate.
    """
    from scipy.signal import butter

    if not cutoff_hz < 0.5 / step_s:
        raise ParameterError(
            "a filter whose cut-off lies below half the simulation's rate",
            f"{cutoff_hz:g} Hz at {1.0 / step_s:g} Hz",
            "Lower it, or raise the rate.",
        )
    b, a = butter(2, cutoff_hz, fs=1.0 / step_s)
    return np.asarray(b), np.asarray(a)


class LiveFilter:
    """A sensor's filter and delay while a flight goes on, on components; the same numbers as `readings`.

    Parameters
    ----------
    numerator, denominator : sequence of 3 components, or None
        Of the filter; None for none.
    late : int or ndarray of int, shape (flights,)
        Steps by which readings are late.
    """

    def __init__(
        self,
        filtered: tuple[tuple[Value, ...], tuple[Value, ...]] | None,
        late: int | Int[np.ndarray, " flights"],
    ) -> None:
        self._filter = filtered
        self._late = DelayLine(late)
        self._state: list[tuple[Value, Value]] | None = None

    def read(self, raw: list[Value]) -> list[Value]:
        """Reading that the controller gets, one component for each axis."""
        if self._filter is None:
            return self._late.pass_on(raw)
        (b0, b1, b2), (a1, a2) = self._filter
        if self._state is None:
            self._state = [((1.0 - b0) * x, (b2 - a2) * x) for x in raw]
        read, state = [], []
        for x, (first, second) in zip(raw, self._state, strict=True):
            y = b0 * x + first
            read.append(y)
            state.append((b1 * x - a1 * y + second, b2 * x - a2 * y))
        self._state = state
        return self._late.pass_on(read)
