"""Confidence regions: ellipses, Fieller intervals and general regions."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import inf

import numpy as np
import scipy
from numpy.typing import ArrayLike

from eivor import checks
from eivor.errors import ShapeError, UsageError
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.distributions import chi_square_quantile
from eivor.tools import Float

Point = Float[np.ndarray, " n_plus_1"]


#: Directions from the pivot, of the half circle, in which a shadow is scanned; fewer where each is a search.
SCAN_STEPS = 181
SEARCHED_STEPS = 61
#: Ends of a shadow are found to this angle [rad], seen from the pivot in units of the scale.
END_TOLERANCE = 1e-9
#: Points at which the least value of a statistic is looked for, and starts of its search.
SEARCH_POINTS = 512
SEARCH_STARTS = 4
#: Step of its numerical slope, and the share of the critical value up to which kinks are searched.
SEARCH_STEP = 1e-5
KINK_SHARE = 1.5

Points = Float[np.ndarray, "k n_plus_1"]


class RegionShape(ABC):
    """A region in homogeneous coordinates (x_0; x_1, ..., x_n), theta_j = x_j / x_0 in scaled units."""

    @abstractmethod
    def excess(self, points: Points) -> Float[np.ndarray, " k"]:
        """Statistic over its critical value at each point: at most one in the region."""

    @abstractmethod
    def along(self, base: Point, step: Point) -> ConfidenceSet:
        """Numbers s for which base + s step is in the region."""

    def members(self, base: Point, step: Point, ends: Iterable[float]) -> ConfidenceSet:
        """The same by the numbers at which a line may enter or leave the region."""
        return ConfidenceSet.from_membership(
            lambda values: self.excess(base + values[:, None] * step) <= 1.0, ends
        )

    def shadow(self, axis: int, size: int) -> ConfidenceSet:
        """Values of x_axis / x_0 (axis from 1 below the size) that some point has, by planes across it."""
        others = [i for i in range(1, size) if i != axis]
        if not others:
            return self.along(np.eye(size)[0], np.eye(size)[axis])

        def base(angle: float) -> Point:
            point = np.zeros(size)
            point[0], point[axis] = np.cos(angle), np.sin(angle)
            return point

        meets = _meeting(self, np.eye(size)[others])
        steps = SCAN_STEPS if len(others) == 1 else SEARCHED_STEPS
        angles = np.linspace(-0.5 * np.pi, 0.5 * np.pi, steps)
        seeds = np.arctan([x[axis] / x[0] for x in least_points(self, size) if x[0] != 0.0])
        angles = np.unique(np.concatenate([angles, seeds]))
        inside = [meets(base(angle)) for angle in angles[:-1]]
        inside.append(inside[0])  # both ends of the half circle are the same plane at infinity
        ends = [-inf] * inside[0]
        for low, high, in_low, in_high in zip(angles, angles[1:], inside, inside[1:], strict=False):
            if in_low != in_high:
                ends.append(np.tan(_end(lambda angle: meets(base(angle)), float(low), float(high), in_low)))
        ends += [inf] * inside[-1]
        return ConfidenceSet.union((float(a), float(b)) for a, b in zip(ends[::2], ends[1::2], strict=True))


@dataclass(frozen=True)
class RegionFrame:
    """Origin and units in which a region is computed."""

    pivot: Float[np.ndarray, " n"]  # A point near the region's middle, in the parameters' units
    scale: Float[np.ndarray, " n"]


@dataclass(frozen=True)
class ConfidenceRegion:
    """A joint confidence region."""

    names: tuple[str, ...]  # Parameters, in order
    frame: RegionFrame  # Origin and units of `shape`
    shape: RegionShape  # What belongs to the region

    def excess(self, theta: ArrayLike) -> float:
        """Statistic over its critical value: at most one for a member; refuses other shapes than (n,)."""
        values = checks.real_array("theta", theta)
        if values.shape != (len(self.names),):
            expected = f"one value for each of {', '.join(self.names)}"
            raise ShapeError(expected, f"shape {values.shape}", "Give them in this order.")
        point = np.append(1.0, (values - self.frame.pivot) / self.frame.scale)
        return float(self.shape.excess(point[None, :])[0])

    def contains(self, theta: ArrayLike) -> bool:
        """Whether a parameter vector belongs to the region; this is exact. See `excess`."""
        return self.excess(theta) <= 1.0

    def interval(self, name: str) -> ConfidenceSet:
        """Values of a parameter that some member of the region has: the region's shadow."""
        axis = checks.index_of("a parameter", name, self.names)
        shadow = self.shape.shadow(axis + 1, 1 + len(self.names))
        pivot, scale = float(self.frame.pivot[axis]), float(self.frame.scale[axis])
        return ConfidenceSet.union(
            (pivot + scale * low, pivot + scale * high) for low, high in shadow.intervals
        )


def least_points(shape: RegionShape, size: int) -> list[Point]:
    """Points at which the statistic has a local minimum, the least first."""
    spread = np.random.default_rng(0).standard_normal((SEARCH_POINTS, size))
    spread[0] = np.eye(size)[0]
    best = np.argsort(shape.excess(spread))[:SEARCH_STARTS]
    starts = [spread[0], *(spread[best] / np.linalg.norm(spread[best], axis=1, keepdims=True))]
    results = [_searched(shape, np.eye(size), start) for start in starts]
    return [point for point, _ in sorted(results, key=lambda pair: pair[1])]


def _meeting(shape: RegionShape, axes: Points) -> Callable[[Point], bool]:
    """Whether the plane through a point along some axes meets the region."""
    if len(axes) == 1:
        return lambda point: not shape.along(point, axes[0]).is_empty
    last = [np.zeros(len(axes))]

    def meets(point: Point) -> bool:
        span = np.vstack([point, axes])
        for start in (last[0], np.zeros(len(axes))):
            result, minimum = _searched(shape, span, np.concatenate([[1.0], start]))
            if minimum <= 1.0:
                last[0] = result[1:] / result[0] if result[0] != 0.0 else np.zeros(len(axes))
                return True
        return False

    return meets


def _searched(
    shape: RegionShape, span: Float[np.ndarray, "m n_plus_1"], start: Float[np.ndarray, " m"]
) -> tuple[Float[np.ndarray, " m"], float]:
    """Weights of the rows of `span` at which the statistic is least near a start, and its value there."""
    moves = SEARCH_STEP * np.vstack([np.eye(start.size), -np.eye(start.size)])

    def value_and_slope(weights: Float[np.ndarray, " m"]) -> tuple[float, Float[np.ndarray, " m"]]:
        values = shape.excess(np.vstack([weights, weights + moves]) @ span)
        return float(values[0]), (values[1 : start.size + 1] - values[start.size + 1 :]) / (2.0 * SEARCH_STEP)

    options = {"maxiter": 60, "gtol": 1e-6}
    solution = scipy.optimize.minimize(value_and_slope, start, jac=True, method="BFGS", options=options)
    if 1.0 < solution.fun < KINK_SHARE:
        solution = scipy.optimize.minimize(
            lambda weights: float(shape.excess((weights @ span)[None, :])[0]),
            solution.x,
            method="Nelder-Mead",
            options={"xatol": 1e-8, "fatol": 1e-10, "maxfev": 100 * start.size},
        )
    return solution.x, float(solution.fun)


def _end(meets: Callable[[float], bool], low: float, high: float, inside_low: bool) -> float:
    """Angle at which `meets` changes, on the inner side."""
    while high - low > END_TOLERANCE:
        middle = 0.5 * (low + high)
        if meets(middle) == inside_low:
            low = middle
        else:
            high = middle
    return low if inside_low else high


@dataclass(frozen=True)
class Ellipse:
    """Confidence ellipse of a pair. Performs no checks."""

    centre: Float[np.ndarray, " pair"]  # The pair's estimates, each in its own unit
    covariance: Float[np.ndarray, "pair pair"]  # Their covariance
    level: float = 0.95  # Confidence level
    degrees: float = math.inf  # Degrees of freedom of the covariance; infinite for a known one

    @property
    def squared_radius(self) -> float:
        """T^2: the largest squared distance, in standard errors, from the centre."""
        return hotelling_quantile(self.level, 2, self.degrees)

    @property
    def std_errors(self) -> Float[np.ndarray, "2"]:
        """Standard error of each of the pair."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> float:
        """Correlation of the pair; zero when one of them is exact."""
        shared = float(np.prod(self.std_errors))
        return min(max(float(self.covariance[0, 1]) / shared, -1.0), 1.0) if shared > 0.0 else 0.0

    @property
    def area(self) -> float:
        """Area, in the product of the two units."""
        shape = math.sqrt(max(1.0 - self.correlation**2, 0.0))
        return math.pi * self.squared_radius * float(np.prod(self.std_errors)) * shape

    def outline(self, points: int = 181) -> Float[np.ndarray, "points 2"]:
        """Points around the ellipse, the first one again as the last."""
        angle = np.linspace(0.0, 2.0 * np.pi, points)
        r = self.correlation
        # principal axes of the correlation matrix, whatever r: the diagonals of the unit square
        along, across = np.sqrt(0.5 * (1.0 + r)) * np.cos(angle), np.sqrt(0.5 * (1.0 - r)) * np.sin(angle)
        unit = np.column_stack([along - across, along + across])
        return np.asarray(self.centre + math.sqrt(self.squared_radius) * unit * self.std_errors)


def hotelling_quantile(level: float, dimension: int, degrees: float = math.inf) -> float:
    """Value that Hotelling's T^2 stays below with probability `level`."""
    checks.level(level)
    if not degrees >= dimension:
        expected = f"at least {dimension} degrees of freedom for {dimension} estimates together"
        raise UsageError(expected, f"{degrees:g}", "Use more cosine averages, or intervals one by one.")
    if math.isinf(degrees):
        return chi_square_quantile(level, dimension)
    second = degrees - dimension + 1.0
    return dimension * degrees / second * float(scipy.special.fdtri(dimension, second, level))


def fieller_set(
    pair: Float[np.ndarray, "2"], covariance: Float[np.ndarray, "2 2"], half_widths: float
) -> ConfidenceSet:
    """Values of the ratio that the estimates do not rule out."""
    size = np.maximum(np.abs(pair), np.sqrt(np.diag(covariance)) * half_widths)
    size = np.where(size > 0.0, size, 1.0)
    p, q = pair / size
    V = covariance * half_widths**2 / np.outer(size, size)
    ratios = ConfidenceSet.from_quadratic(
        float(q * q - V[1, 1]), float(-2.0 * (p * q - V[0, 1])), float(p * p - V[0, 0])
    )
    return ratios.scaled(float(size[0] / size[1]))
