"""Order and strength of a fractional noise, estimated from a record at rest by local Whittle.

The periodogram of Delta^order of white noise is, bin by bin and nearly independently, exponential around

    S(w) = std^2 g(w)^(2 order),   g(w) = |2 sin(w/2)|,  w in radians per sample

and the estimate maximises that likelihood over the lowest m frequencies (Robinson 1995, with g in place
of its limit w, so that a pure fractional noise leaves no bias at any m). It is consistent and normal for
orders from -3/4 to 1/2, the noises that start at zero with their record among them (Shimotsu and
Phillips 2004; at exactly 1/2 the lowest bins leak, and the estimate is some tenths of a standard error
low). The mean is not used: an accelerometer's bias does not matter, a drift does.

Standard errors are those of the likelihood, with nu = log g - mean(log g): 1 / (2 sqrt(sum nu^2)) for the
order, which tends to 1 / (2 sqrt(m)) for m far below the record's length and to sqrt(6 / (pi^2 n)) when m
takes every frequency.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from eivor import checks
from eivor.errors import NonFiniteError, ParameterError, ShapeError, TooFewSamplesError
from eivor.shapes import Float
from eivor.signals.noise import LARGEST_ORDER, LEAST_ORDER, FractionalNoise

#: Fewest frequencies from which an order is estimated.
LEAST_BANDWIDTH = 8
#: Share of the record's length, as an exponent, that the default number of frequencies has.
BANDWIDTH_EXPONENT = 0.65
#: Orders that are searched: twice what a measurement noise may have.
SEARCHED = (-1.0, 1.0)


@dataclass(frozen=True, slots=True)
class LongMemory:
    """Estimate of a fractional noise.

    Parameters
    ----------
    order, order_error : float
        Exponent of Delta and its standard error.
    std, std_error : float
        Standard deviation of the white noise before the operator, in the channel's unit, and its
        standard error (the order being estimated too).
    bandwidth : int
        Number of frequencies that were used.
    """

    order: float
    order_error: float
    std: float
    std_error: float
    bandwidth: int

    @property
    def memory(self) -> float:
        """Memory parameter d = -order of the literature."""
        return -self.order

    def order_interval(self, level: float = 0.95) -> tuple[float, float]:
        """Interval that covers the order with this probability.

        Raises
        ------
        ParameterError
            When the level is not between 0 and 1.
        """
        checks.number("level", level)
        if not 0.0 < level < 1.0:
            raise ParameterError("a level between 0 and 1", f"level={level}", "Give 0.95 for 95 %.")
        width = NormalDist().inv_cdf(0.5 + level / 2.0) * self.order_error
        return self.order - width, self.order + width

    def noise(self) -> FractionalNoise:
        """Noise to declare of the channel: the estimate, with an order that a noise can have."""
        return FractionalNoise(self.std, float(np.clip(self.order, LEAST_ORDER, LARGEST_ORDER)))


def estimate_long_memory(values: Float[np.ndarray, " n"], *, bandwidth: int | None = None) -> LongMemory:
    """Estimate order and strength of a fractional noise from a record at rest.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Uniformly sampled record of a machine that does not move.
    bandwidth : int, optional
        Number m of lowest frequencies, up to (n - 1) // 2. Default: n^0.65, which keeps away from what
        else shapes the spectrum at high frequencies. If the noise is fractional and nothing else, every
        frequency is best.

    Raises
    ------
    DataError, ShapeError
        When the values are no real numbers, or not those of one record.
    NonFiniteError
        When a value is not finite.
    TooFewSamplesError
        When the record has fewer than 8 frequencies.
    ParameterError
        When the bandwidth is out of range, or the record constant.

    Notes
    -----
    One FFT and a convex search: 1e6 samples take a quarter of a second.
    """
    values = checks.real_array("values", values)
    if values.ndim != 1:
        raise ShapeError("a record of shape (n,)", f"shape {values.shape}", "Give one channel at a time.")
    if bandwidth is not None:
        checks.whole("bandwidth", bandwidth)
    if not np.isfinite(values).all():
        raise NonFiniteError(
            "a record of finite values", "NaN or infinity in it", "Cut the record to a stretch without gaps."
        )
    most = (values.size - 1) // 2
    if most < LEAST_BANDWIDTH:
        raise TooFewSamplesError(
            f"{2 * LEAST_BANDWIDTH + 1} samples or more",
            f"{values.size}",
            "Record the machine at rest for longer.",
        )
    m = max(LEAST_BANDWIDTH, int(values.size**BANDWIDTH_EXPONENT)) if bandwidth is None else bandwidth
    if not LEAST_BANDWIDTH <= m <= most:
        raise ParameterError(
            f"a bandwidth from {LEAST_BANDWIDTH} to {most} frequencies", f"bandwidth={m}", "Choose another."
        )
    power = np.abs(np.fft.rfft(values - values.mean())[1 : m + 1]) ** 2 / values.size
    if not power.max() > (np.finfo(np.float64).eps * np.abs(values).max()) ** 2:
        raise ParameterError(
            "a record that varies", "a constant one", "Use one with the sensor's full resolution."
        )
    return _whittle(power, np.log(2.0 * np.sin(np.pi * np.arange(1, m + 1) / values.size)))


def _whittle(power: Float[np.ndarray, " m"], log_gain: Float[np.ndarray, " m"]) -> LongMemory:
    """Minimum of the concentrated likelihood, log mean(power g^(-2 order)) + 2 order mean(log g)."""
    nu = log_gain - log_gain.mean()
    log_power = np.log(np.maximum(power, np.finfo(np.float64).tiny))
    order = _root(log_power, nu)
    scaled = log_power - 2.0 * order * log_gain
    top = float(scaled.max())
    variance = float(np.exp(top)) * float(np.exp(scaled - top).mean())
    information = float(nu @ nu)
    relative = np.sqrt(1.0 / power.size + float(log_gain.mean()) ** 2 / information)
    std = float(np.sqrt(variance))
    return LongMemory(order, 0.5 / float(np.sqrt(information)), std, 0.5 * std * float(relative), power.size)


def _root(log_power: Float[np.ndarray, " m"], nu: Float[np.ndarray, " m"]) -> float:
    """Order at which the slope of the convex likelihood is zero: Newton's steps, kept in a bracket."""
    low, high = SEARCHED
    order = 0.0
    for _ in range(60):
        scaled = log_power - 2.0 * order * nu
        weights = np.exp(scaled - scaled.max())
        weights /= weights.sum()
        mean = float(weights @ nu)
        if mean > 0.0:
            low = order
        else:
            high = order
        step = mean / (2.0 * (float(weights @ nu**2) - mean**2))
        following = order + step
        if not low < following < high:
            following = 0.5 * (low + high)
        if abs(following - order) < 1e-12:
            break
        order = following
    return order
