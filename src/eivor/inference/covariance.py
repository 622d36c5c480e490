"""Covariances by name, kernels of long-run ones, and joint draws of estimates."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from operator import methodcaller
from typing import ClassVar, final

import msgspec
import numpy as np
import scipy

from eivor import checks
from eivor.errors import EstimationError, UsageError
from eivor.inference.distributions import normal_quantile, t_quantile, t_tail
from eivor.inference.estimating_equation import EstimatingEquation, singular_sensitivity
from eivor.tools import Float

Vector = Float[np.ndarray, " n"]
Block = Float[np.ndarray, "_ n"]
Matrix = Float[np.ndarray, "n n"]

#: Below this argument the quadratic spectral kernel is its series, 1 - z^2/10.
SMALL_ARGUMENT = 1e-3


class Kernel(ABC):
    """Weights of autocovariances."""

    name: ClassVar[str]  # what results call it
    ends: ClassVar[bool] = True  # whether the kernel is zero from x = 1 on

    @abstractmethod
    def weights(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """k(x) at x >= 0."""

    def span(self, bandwidth: float) -> float:
        """S of a bandwidth in lags."""
        return bandwidth + 1.0 if self.ends else bandwidth


@dataclass(frozen=True, slots=True)
class Bartlett(Kernel):
    """1 - x (Newey and West 1987)."""

    name = "bartlett"

    def weights(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        return np.maximum(1.0 - x, 0.0)


@dataclass(frozen=True, slots=True)
class Parzen(Kernel):
    """1 - 6 x^2 + 6 x^3 up to 1/2, 2 (1 - x)^3 up to 1 (Gallant 1987)."""

    name = "parzen"

    def weights(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        near = 1.0 - 6.0 * x**2 * (1.0 - x)
        return np.where(x <= 0.5, near, 2.0 * np.maximum(1.0 - x, 0.0) ** 3)


@dataclass(frozen=True, slots=True)
class QuadraticSpectral(Kernel):
    """3/z^2 (sin z / z - cos z) with z = 6 pi x / 5 (Andrews 1991); it has no end."""

    name = "quadratic_spectral"
    ends = False

    def weights(self, x: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        z = 1.2 * np.pi * x
        safe = np.where(z < SMALL_ARGUMENT, 1.0, z)
        far = 3.0 / safe**2 * (np.sin(safe) / safe - np.cos(safe))
        return np.where(z < SMALL_ARGUMENT, 1.0 - z**2 / 10.0, far)


def kernel_sum_covariance(blocks: Iterable[Block], count: int, kernel: Kernel, bandwidth: float) -> Matrix:
    """Covariance of the sum of autocorrelated scores, sum_l k(l/S) sum_t s_t s_{t-l}'."""
    span = kernel.span(bandwidth)
    if kernel.ends:
        return _from_blocks(blocks, kernel, min(int(np.ceil(span)) - 1, count - 1), span)
    return _from_spectrum(np.concatenate(list(blocks)), kernel, span)


def _from_blocks(blocks: Iterable[Block], kernel: Kernel, lags: int, span: float) -> Matrix:
    weights = kernel.weights(np.arange(lags + 1) / span)
    total, previous = np.zeros(()), None
    for block in blocks:
        previous = block[:0] if previous is None else previous
        joined, overlap = np.concatenate([previous, block]), previous.shape[0]
        total = total + block.T @ block
        for lag in range(1, min(lags, joined.shape[0] - 1) + 1):
            # Pairs whose later score is in this block.
            first = max(overlap, lag)
            cross = joined[first:].T @ joined[first - lag : joined.shape[0] - lag]
            total += weights[lag] * (cross + cross.T)
        previous = joined[max(joined.shape[0] - lags, 0) :]
    if previous is None:
        raise UsageError("scores", "none", "Give a longer record.")
    return total


def _from_spectrum(scores: Float[np.ndarray, "samples n"], kernel: Kernel, span: float) -> Matrix:
    """All lags by FFT, padded so that they do not wrap around."""
    if span <= 0.0:
        return scores.T @ scores
    count, length = len(scores), scipy.fft.next_fast_len(2 * len(scores), real=True)
    lags = np.arange(length)
    weights = kernel.weights(np.minimum(lags, length - lags) / span)
    spectrum = scipy.fft.rfft(scores, n=length, axis=0) * scipy.fft.rfft(weights)[:, None]
    return scores.T @ scipy.fft.irfft(spectrum, n=length, axis=0)[:count]


#: Andrews' (1991, his (6.2)) constants, and the exponent that goes with each: 1/(2q + 1).
ANDREWS = {Bartlett: (1.1447, 1), Parzen: (2.6614, 2), QuadraticSpectral: (1.3221, 2)}
#: Largest correlation of successive scores that Andrews' rule believes.
LARGEST_CORRELATION = 0.97

Blocks = Callable[[], Iterable[Block]]


class Bandwidth(ABC):
    """A way to choose the bandwidth."""

    @abstractmethod
    def lags(self, blocks: Blocks, count: int, kernel: Kernel, /) -> float:
        """Bandwidth in lags, for so many scores, which are given in blocks, anew in each call."""


@dataclass(frozen=True, slots=True)
class FixedBandwidth(Bandwidth):
    """Chosen by the user, in lags: zero or more."""

    bandwidth: float | int

    def __post_init__(self) -> None:
        checks.number("bandwidth", self.bandwidth)
        if not self.bandwidth >= 0.0:
            raise UsageError("a bandwidth of zero lags or more", f"{self.bandwidth}", "Zero sees no lag.")

    def lags(self, _blocks: Blocks, _count: int, _kernel: Kernel, /) -> float:
        return float(self.bandwidth)


@dataclass(frozen=True, slots=True)
class NeweyWestRule(Bandwidth):
    """4 (N/100)^(2/9), the rule of thumb that goes with Newey and West (1994)."""

    def lags(self, _blocks: Blocks, count: int, _kernel: Kernel, /) -> float:
        return float(newey_west_bandwidth(count))


@dataclass(frozen=True, slots=True)
class SquareRootRule(Bandwidth):
    """1.3 sqrt(N), which asks for fixed-b critical values (Lazarus, Lewis, Stock and Watson 2018)."""

    def lags(self, _blocks: Blocks, count: int, _kernel: Kernel, /) -> float:
        return 1.3 * float(np.sqrt(count)) - 1.0


@dataclass(frozen=True, slots=True)
class AndrewsRule(Bandwidth):
    """Andrews' (1991) plug-in rule: as if each score, of variance one, were a first-order autoregression."""

    def lags(self, blocks: Blocks, count: int, kernel: Kernel) -> float:
        power, products, last = 0.0, 0.0, None
        for block in blocks():
            joined = block if last is None else np.concatenate([last, block])
            products = products + (joined[1:] * joined[:-1]).sum(axis=0)
            power = power + (block**2).sum(axis=0)
            last = block[-1:]
        correlation = np.clip(
            np.divide(products, power, out=np.zeros_like(products), where=np.asarray(power) > 0.0),
            -LARGEST_CORRELATION,
            LARGEST_CORRELATION,
        )
        shape = (1.0 - correlation**2) ** 2 / (1.0 - correlation) ** 4  # spectrum at zero, squared
        constant, order = ANDREWS[type(kernel)]
        bend = 4.0 * correlation**2 / (1.0 - correlation) ** 4
        if order == 1:
            bend *= (1.0 - correlation) ** 2 / (1.0 + correlation) ** 2
        alpha = float((bend * shape).sum() / shape.sum())
        span = constant * (alpha * count) ** (1.0 / (2 * order + 1))
        return float(np.ceil(max(span - (1.0 if kernel.ends else 0.0), 0.0)))


def newey_west_bandwidth(count: int) -> int:
    """Rule of thumb for the number of lags, 4 (n/100)^(2/9)."""
    return int(4.0 * (count / 100.0) ** (2.0 / 9.0))


#: A larger variance carries no information, and its products overflow.
LARGEST_VARIANCE = 1e250


@dataclass(frozen=True)
class CovariancePart:
    """Covariance under one assumption on the residual, and the quantiles of its intervals."""

    name: str
    matrix: Matrix  # Covariance of the estimates
    degrees: float = math.inf  # Degrees of freedom of Student's t
    share: float = 1.0  # Share of the variance that the estimator is expected to see

    def variance(self, direction: Vector) -> float:
        """Variance of ``direction @ estimates``."""
        return max(float(direction @ self.matrix @ direction), 0.0)

    def half_width(self, direction: Vector, level: float, extra_variance: float = 0.0) -> float:
        """Half-width of the interval for ``direction @ estimates``."""
        if self.degrees <= 0.0:
            return math.inf
        return self.half_widths(level) * math.sqrt(self.variance(direction) + extra_variance)

    def half_widths(self, level: float) -> float:
        """Half-width of an interval over the root of its variance."""
        return t_quantile(level, self.degrees) / math.sqrt(self.share)

    def p_value(self, direction: Vector, value: float) -> float:
        """Of the hypothesis that ``direction @ estimates``, estimated as `value`, is zero."""
        std_error = math.sqrt(self.variance(direction) / self.share)
        return t_tail(value / std_error, self.degrees) if std_error else float(value == 0.0)


class JointCovariance(msgspec.Struct, frozen=True):
    """Covariances of one vector of estimates; intervals are the widest that one of them asks for."""

    parts: tuple[CovariancePart, ...]

    def part(self, name: str) -> CovariancePart:
        return self.parts[checks.index_of("a covariance", name, [part.name for part in self.parts])]

    def std_error(self, direction: Vector) -> float:
        """Largest of the standard errors of ``direction @ estimates``."""
        return math.sqrt(max(part.variance(direction) for part in self.parts))

    def half_width(self, direction: Vector, level: float = 0.95, extra_variance: float = 0.0) -> float:
        """Half-width of the interval for ``direction @ estimates``: the widest of the parts'."""
        return max(part.half_width(direction, level, extra_variance) for part in self.parts)

    def p_value(self, direction: Vector, value: float) -> float:
        """Of the hypothesis that ``direction @ estimates``, estimated as `value`, is zero."""
        return max(part.p_value(direction, value) for part in self.parts)

    @property
    def matrix(self) -> Matrix:
        """Correlations of the leading part, with the largest of the standard errors on the diagonal."""
        leading = self.parts[0].matrix
        variances = [np.maximum(part.matrix.diagonal(), 0.0) for part in self.parts]
        largest, std_errors = np.sqrt(np.max(variances, axis=0)), np.sqrt(variances[0])
        scale = np.divide(largest, std_errors, out=np.zeros(std_errors.size), where=std_errors > 0.0)
        return leading * np.outer(scale, scale)


def sandwich(M: Matrix, meat: Matrix) -> Matrix:
    """M^-1 meat M^-T without an explicit inverse."""
    # units apart by many powers of ten (a gain per squared rotor speed) must not pass for collinearity
    columns, lapack = column_scale(M), scipy.linalg.lapack
    scaled = M * columns
    rows = column_scale(scaled.T)[:, None]
    factor, pivots, half, singular = lapack.dgesv(rows * scaled, rows * meat * rows.T)
    if singular:
        raise singular_sensitivity()
    covariance: Matrix = lapack.dgetrs(factor, pivots, half.T)[0]
    with np.errstate(over="ignore", invalid="ignore"):
        result: Matrix = columns[:, None] * columns * (0.5 * (covariance + covariance.T))
    if not bool((np.abs(result) <= LARGEST_VARIANCE).all()):
        raise singular_sensitivity()
    return result


def unit_scale(squares: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """One over the square roots of squares; one where these are zero."""
    return 1.0 / np.sqrt(np.where(squares > 0.0, squares, 1.0))


def column_scale(matrix: Float[np.ndarray, "m n"]) -> Vector:
    """Factors that bring every column to unit length."""
    return unit_scale(np.einsum("ij,ij->j", matrix, matrix))


@dataclass(frozen=True, slots=True)
class JointEstimate:
    """A vector of estimates with its covariance."""

    values: Vector
    covariance: JointCovariance


#: Number of cosine averages of the autocorrelation-robust covariance.
COSINE_AVERAGES = 8
#: Largest angle from the middle of a group: x^6/720 and x^7/5040 are below the rounding of sums.
LARGEST_ANGLE = 1e-2
#: Signs and factorials of the series, cosine and sine in turns.
SIGNS, FACTORIALS = (1, -1, -1, 1, 1, -1), np.array([1.0, 1.0, 2.0, 6.0, 24.0, 120.0])
#: Groups of fewer scores save nothing.
SHORTEST_GROUP = 8
#: Longest record [samples] that is transformed as a whole.
SHORT_RECORD = 4_000


def cosine_covariance(scores: Iterable[Block], count: int, averages: int = COSINE_AVERAGES) -> Matrix:
    """Covariance of the sum of autocorrelated scores. Performs no checks."""
    moments, middles, sums, start = [], [], [], 0
    step = np.pi * np.arange(1, averages + 1)[:, None] / count
    for block in scores:
        samples = block.shape[0]
        if samples == count and count <= SHORT_RECORD:
            L = cosine_averages(block, averages)
            return L.T @ L / averages
        longest = min(int(2.0 * LARGEST_ANGLE / step[-1, 0]), samples)
        length = 1 << max(longest.bit_length() - 1, 0)  # a block is a power of two as well: no rest
        groups = samples // length if length >= SHORTEST_GROUP else 0
        grouped = groups * length
        if groups:
            moments.append(block[:grouped].T.reshape(-1, groups, length) @ _powers(float(step[0, 0]), length))
            middles.append(start + 0.5 * length + length * np.arange(groups))
        if grouped < samples:
            sums.append(np.cos(step * (start + 0.5 + np.arange(grouped, samples))) @ block[grouped:])
        start += samples
    if moments:
        grouped, middle = np.concatenate(moments, axis=1), step * np.concatenate(middles)
        waves, order = (np.cos(middle), np.sin(middle)), np.arange(1, averages + 1)[:, None]
        series = (order**k * (waves[k % 2] @ grouped[:, :, k].T) for k in range(len(SIGNS)))
        sums += [sign * term for sign, term in zip(SIGNS, series, strict=True)]
    if not sums:
        raise ValueError("no block of scores")
    total = np.asarray(sum(sums))
    return (2.0 / averages) * total.T @ total


def cosine_averages(
    scores: Float[np.ndarray, "samples *shape"], averages: int
) -> Float[np.ndarray, "averages *shape"]:
    """sqrt(count) L_j of scores that are all at hand."""
    return np.asarray(scipy.fft.dct(scores, axis=0)[1 : averages + 1]) / np.sqrt(2.0)


def long_run_mean_variance(series: Float[np.ndarray, " samples"]) -> float:
    """Variance of the mean of an autocorrelated series, by the same cosine averages."""
    return float(cosine_covariance([series[:, None]], series.size)[0, 0]) / series.size**2


@lru_cache(maxsize=8)
def _powers(step: float, length: int) -> Float[np.ndarray, "length powers"]:
    """x^k / k! at the samples of a group, for angles x from its middle."""
    offset = np.arange(length) - 0.5 * (length - 1)
    return np.vander(step * offset, len(SIGNS), increasing=True) / FACTORIALS


#: Fewest flights of a pool whose covariance is clustered by flight as well.
CLUSTERED_FROM = 10


class CovarianceEstimator(ABC):
    """A way to estimate the covariance of a sum of scores."""

    @abstractmethod
    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        """Covariances of the estimates, the leading one first; none when the rows cannot identify."""

    def joint(self, equation: EstimatingEquation) -> JointCovariance:
        """Covariance of the joint vector; a `UsageError` where too few flights are to be clustered."""
        parts = self.parts(equation)
        if not parts:
            remedy = "Choose another covariance."
            raise UsageError(f"rows that {type(self).__name__} can use", "too few flights", remedy)
        # estimates that were moved have a bias as well: mean square errors
        if equation.move is not None:
            square = np.outer(equation.move, equation.move)
            parts = tuple(replace(part, matrix=part.matrix + square) for part in parts)
        return JointCovariance(parts)


def _part(
    name: str, equation: EstimatingEquation, meat: Matrix, degrees: float = math.inf, share: float = 1.0
) -> CovariancePart:
    matrix = sandwich(equation.slope, meat + equation.prior_covariance)
    return CovariancePart(name, matrix, degrees, share)


def check_covariance_estimator(estimator: object) -> None:
    """Refuse what is no estimator of covariances."""
    remedy = "Make one: ev.covariances.Classical()."
    checks.kind("covariance", estimator, CovarianceEstimator, "one of eivor.covariances", remedy)


@dataclass(frozen=True, slots=True)
class Classical(CovarianceEstimator):
    """V = s^2 P'P: residuals are white, all of one variance, and independent of the test functions.

    Those of compensated equations are not: there the instruments share noise with the residual, and this
    covariance is too small.
    """

    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        unknowns = equation.unknowns
        power, count, products = 0.0, 0, np.zeros((unknowns, unknowns))
        for rows in equation.blocks():
            products += rows.test_functions.T @ rows.test_functions
            power += float(rows.residual @ rows.residual)
            count += rows.residual.size
        variance = power / max(count - unknowns, 1)
        return (_part("classical", equation, variance * products),)


@dataclass(frozen=True, slots=True)
class HeteroskedasticityRobust(CovarianceEstimator):
    """V = sum s_t s_t' (White 1980): scores are uncorrelated, their variance may change."""

    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        products: Matrix = np.zeros_like(equation.slope)
        for rows in equation.blocks():
            products += rows.scores.T @ rows.scores
        return (_part("heteroskedasticity_robust", equation, products),)


@dataclass(frozen=True, slots=True)
class EqualWeightedCosines(CovarianceEstimator):
    """V from equal-weighted cosine averages of the scores (Lazarus, Lewis, Stock and Watson 2018).

    The number of averages B, one at least, is that of degrees of freedom. The default of 8 sees correlation
    up to about an eighth of the record's length; more give shorter intervals that see less. A record has no
    more of them than scores beyond its unknowns; without any of those, intervals have no bound.
    """

    averages: int = COSINE_AVERAGES

    def __post_init__(self) -> None:
        checks.counted("averages", self.averages, 1, "one cosine average or more", "Eight are the default.")

    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        scores = (rows.scores for rows in equation.blocks())
        count, unknowns = equation.sample_count, equation.unknowns
        averages = max(min(self.averages, count - unknowns), 1)
        meat = cosine_covariance(scores, count, averages)
        degrees = float(averages) if count > unknowns else 0.0
        return (_part("equal_weighted_cosines", equation, meat, degrees),)


@dataclass(frozen=True, slots=True)
class ClusteredByFlight(CovarianceEstimator):
    """V from the sums of each of ten flights or more: any dependence within a flight, none between."""

    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        sums: dict[int, Vector] = {}
        for rows in equation.blocks():
            for flight in np.unique(rows.flight_of_row):
                mask = rows.flight_of_row == flight
                total = rows.test_functions[mask].T @ rows.residual[mask]
                if rows.constant is not None:
                    total = total + int(mask.sum()) * rows.constant
                sums[int(flight)] = sums.get(int(flight), 0.0) + total
        flights = len(sums)
        if flights < CLUSTERED_FROM:
            return ()
        stacked = np.stack(list(sums.values()))
        stacked -= stacked.mean(axis=0)
        meat = stacked.T @ stacked * flights / (flights - 1)
        return (_part("clustered", equation, meat, float(flights - 1)),)


@dataclass(frozen=True, slots=True)
class Widest(CovarianceEstimator):
    """Several covariances; an interval is the widest that one asks for. Correlations are the first's."""

    estimators: tuple[CovarianceEstimator, ...]

    def __post_init__(self) -> None:
        checks.items("estimators", self.estimators, CovarianceEstimator, "covariances")
        if not self.estimators:
            raise UsageError("one covariance or more", "none", "Name those that are to be compared.")

    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        return tuple(part for estimator in self.estimators for part in estimator.parts(equation))


#: Default: what covers in autocorrelated and heteroskedastic errors alike.
DEFAULT = EqualWeightedCosines()
#: Of a flight: as the default, never narrower than white residuals ask for, and clustered in large pools.
FLIGHT_DEFAULT = Widest((EqualWeightedCosines(), Classical(), ClusteredByFlight()))

__all__ = [
    "AndrewsRule",
    "Bandwidth",
    "Bartlett",
    "Classical",
    "ClusteredByFlight",
    "CovarianceEstimator",
    "EqualWeightedCosines",
    "FixedBandwidth",
    "HeteroskedasticityRobust",
    "Kernel",
    "KernelRobust",
    "NeweyWestRule",
    "Parzen",
    "QuadraticSpectral",
    "SquareRootRule",
    "Widest",
]

#: Covariances that a study file may name.
TABLE: Mapping[str, Callable[[], CovarianceEstimator]] = {
    "equal_weighted_cosines": lambda: DEFAULT,
    "classical": Classical,
    "heteroskedasticity_robust": HeteroskedasticityRobust,
    "newey_west": lambda: KernelRobust(Bartlett(), NeweyWestRule(), fixed_b=False),
    "andrews": lambda: KernelRobust(QuadraticSpectral(), AndrewsRule(), fixed_b=False),
    "bartlett_fixed_b": lambda: KernelRobust(Bartlett(), SquareRootRule()),
    "widest": lambda: FLIGHT_DEFAULT,
}


def __dir__() -> list[str]:
    """Names that the module offers, and not those that it uses."""
    return __all__


#: Leverages above this count as this.
LARGEST_LEVERAGE = 0.9
#: Level at which quantiles of Student's t are held against normal ones.
ROW_COVARIANCE_LEVEL = 0.95


@final
@dataclass(frozen=True, slots=True)
class ByRow(CovarianceEstimator):
    """V = sum p_t p_t' e_t^2 / (1 - h_t)^2 over rows, bins of spectra among them, with t on few rows."""

    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:
        P, e = equation.rows.test_functions, equation.rows.residual
        leverage = np.einsum("tj,jt->t", P, np.linalg.lstsq(P.T @ P, P.T, rcond=None)[0])
        scores = P * (e / (1.0 - np.minimum(leverage, LARGEST_LEVERAGE)))[:, None]
        matrix = sandwich(equation.slope, scores.T @ scores + equation.prior_covariance)
        weights = np.linalg.lstsq(equation.slope, P.T, rcond=None)[0] ** 2
        fourth = (weights**2).sum(axis=1)
        rows = np.divide(weights.sum(axis=1) ** 2, fourth, out=np.ones(fourth.size), where=fourth > 0.0)
        expansion = np.array([t_quantile(ROW_COVARIANCE_LEVEL, nu) for nu in rows.tolist()])
        expansion /= normal_quantile(ROW_COVARIANCE_LEVEL)
        return (CovariancePart("by_row", matrix * np.outer(expansion, expansion)),)


#: Of a flight with columns that live in few bins: as that of others, and never narrower than row by row.
FEW_ROWS_DEFAULT = Widest((*FLIGHT_DEFAULT.estimators, ByRow()))

#: Points of a quadrature, and where a kernel without an end is cut off.
POINTS = 4001
FURTHEST = 100.0


@lru_cache(maxsize=256)
def fixed_b_reference(kernel: Kernel, b: float) -> tuple[float, float]:
    """Degrees and share of Student's t over a root, at a share b = S/N of the record, 0 < b <= 1."""
    end = min(1.0 / b, 1.0 if kernel.ends else FURTHEST)
    x = np.linspace(0.0, end, POINTS)
    k = kernel.weights(x)
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (k[1:] + k[:-1]) * np.diff(x))])
    mean = 2.0 * b * float(np.trapezoid((1.0 - b * x) * k, x))
    square = 2.0 * b * float(np.trapezoid((1.0 - b * x) * k**2, x))
    r = np.append(b * x[b * x < 0.5], 0.5)
    h = b * (np.interp(r / b, x, integral) + np.interp((1.0 - r) / b, x, integral))
    share = 1.0 - mean
    spread = square - 2.0 * (2.0 * float(np.trapezoid(h**2, r))) + mean**2
    return share**2 / spread, share


@dataclass(frozen=True, slots=True)
class KernelRobust(CovarianceEstimator):
    """V = sum_l k(l/S) sum_t s_t s_{t-l}' (Newey and West 1987; Andrews 1991).

    Critical values allow for the bandwidth (Kiefer and Vogelsang 2005) where `fixed_b`. Else they are normal
    ones, which are too small unless the bandwidth is a small share of the record.
    """

    kernel: Kernel = field(default_factory=Bartlett)  # Weights of the lags
    bandwidth: Bandwidth = field(default_factory=NeweyWestRule)  # How many lags
    fixed_b: bool = True

    def __post_init__(self) -> None:
        checks.kind("kernel", self.kernel, Kernel, "a kernel", "Make one: ev.covariances.Bartlett().")
        remedy = "Make one: ev.covariances.FixedBandwidth(9)."
        checks.kind("bandwidth", self.bandwidth, Bandwidth, "a bandwidth", remedy)
        checks.flag("fixed_b", self.fixed_b)

    def parts(self, equation: EstimatingEquation) -> tuple[CovariancePart, ...]:

        def scaled() -> Iterator[Block]:
            return (rows.scores @ equation.root for rows in equation.blocks())

        count = equation.sample_count
        # Beyond the record's length there is no lag to count, and a longer span would only shrink the sum.
        lags = min(self.bandwidth.lags(scaled, count, self.kernel), count - 1.0)
        meat = kernel_sum_covariance((rows.scores for rows in equation.blocks()), count, self.kernel, lags)
        reference = (math.inf, 1.0)
        if self.fixed_b and lags > 0.0:
            reference = fixed_b_reference(self.kernel, self.kernel.span(lags) / count)
        return (_part(self.kernel.name, equation, meat, *reference),)


#: Level of the interval that chooses an estimate's part.
JOINT_DRAWS_LEVEL = 0.95
#: Student's t with fewer degrees has no variance, hence no correlations.
FEWEST_DEGREES = 2.0
#: Strata at the least: of fewer the order of the draws would not identify their correlations.
STRATA = 16384


def joint_draws(
    values: Vector, covariance: JointCovariance, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "count n"]:
    """Draw vectors around the estimates."""
    laws = []
    for direction in np.eye(values.size):  # of each estimate the part whose interval is the widest
        part = max(covariance.parts, key=methodcaller("half_width", direction, JOINT_DRAWS_LEVEL))
        laws.append((part.degrees, math.sqrt(part.variance(direction) / part.share)))
    degrees, scales = np.array(laws).T
    if not np.all(np.isfinite(scales)) or np.any(degrees <= FEWEST_DEGREES):
        expected = f"estimates with finite variances, of more than {FEWEST_DEGREES:g} degrees of freedom"
        received = f"{degrees.min():.3g} degrees and a largest standard error of {scales.max():.3g}"
        raise EstimationError(expected, received, "Fly longer, or pool several flights.")
    strata = max(count, STRATA)
    # square root of the nearest matrix without negative eigenvalues, its diagonal one again
    eigenvalues, vectors = np.linalg.eigh(_score_correlations(covariance, degrees))
    root = vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    root /= np.linalg.norm(root, axis=1, keepdims=True)
    scores = rng.standard_normal((strata, values.size)) @ root.T
    for nu in np.unique(degrees[np.isfinite(degrees)]):
        scores[:, degrees == nu] *= np.sqrt(nu / rng.chisquare(nu, strata))[:, None]
    shares = (scores.argsort(axis=0).argsort(axis=0)[:count] + rng.random((count, values.size))) / strata
    quantiles = [
        scipy.special.ndtri(column) if math.isinf(degree) else scipy.special.stdtrit(degree, column)
        for column, degree in zip(shares.T, degrees, strict=True)
    ]
    return values + scales * np.stack(quantiles, axis=1)


def _score_correlations(covariance: JointCovariance, degrees: Vector) -> Matrix:
    """Correlations of the normal scores, with which the draws have those of the covariance."""
    matrix = covariance.matrix
    scale = np.sqrt(np.diag(matrix))
    size = np.outer(scale, scale)
    correlations = np.divide(matrix, size, out=np.zeros_like(matrix), where=size > 0.0)
    factors = np.array([_attenuation(degree) for degree in degrees])
    separated = degrees[:, None] != degrees
    correlations = np.where(separated, correlations / np.outer(factors, factors), correlations)
    np.fill_diagonal(correlations, 1.0)
    return np.clip(correlations, -1.0, 1.0)


def _attenuation(degrees: float) -> float:
    """Mean over root mean square of the factor that turns a normal score into Student's t."""
    if math.isinf(degrees):
        return 1.0
    half = 0.5 * degrees
    mean = math.exp(scipy.special.gammaln(half - 0.5) - scipy.special.gammaln(half)) * math.sqrt(half)
    return mean * math.sqrt((degrees - 2.0) / degrees)
