"""Confidence sets as unions of intervals, and their search."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import pairwise
from math import copysign, frexp, inf, isfinite, isnan, ldexp, sqrt

import numpy as np
import scipy

from eivor import checks
from eivor.errors import ParameterError
from eivor.tools import Bool, Float


@dataclass(frozen=True, slots=True)
class ConfidenceSet:
    """Union of disjoint closed intervals of the real line.

    Raises
    ------
    ParameterError
        When an end is NaN, or the pieces are not in order.
    """

    #: Lower and upper end of each piece, in ascending order and apart from each other; -inf and inf are
    #: allowed as outermost ends. No piece is the empty set.
    intervals: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        checks.items("intervals", self.intervals, tuple, "pairs of numbers")
        for interval in self.intervals:
            checks.items("an interval", interval, checks.NUMBERS, "two numbers")
            if len(interval) != 2:
                raise ParameterError("intervals of two ends", f"{interval}", "Give a lower and an upper end.")
        ends = [end for interval in self.intervals for end in interval]
        ordered = all(low <= high for low, high in self.intervals)
        separated = all(lower[1] < upper[0] for lower, upper in pairwise(self.intervals))
        infinite_inside = inf in ends[:-1] or -inf in ends[1:]
        if any(isnan(end) for end in ends) or infinite_inside or not (ordered and separated):
            expected = "intervals in ascending order and apart from each other"
            remedy = "Use ConfidenceSet.union(intervals), which sorts and joins them."
            raise ParameterError(expected, f"{list(self.intervals)}", remedy)

    @classmethod
    def empty(cls) -> ConfidenceSet:
        """No value at all."""
        return cls()

    @classmethod
    def whole_line(cls) -> ConfidenceSet:
        """Every value."""
        return cls(((-inf, inf),))

    @classmethod
    def union(cls, intervals: Iterable[tuple[float, float]]) -> ConfidenceSet:
        """Union of closed intervals in any order, those that touch or overlap joined."""
        joined: list[tuple[float, float]] = []
        for low, high in sorted(intervals):
            if joined and low <= joined[-1][1]:
                joined[-1] = (joined[-1][0], max(joined[-1][1], high))
            else:
                joined.append((low, high))
        return cls(tuple(joined))

    @classmethod
    def from_quadratic(cls, a: float, b: float, c: float) -> ConfidenceSet:
        """Solutions of ``a x^2 + b x + c <= 0``, of finite coefficients (else a `ParameterError`).

        Roots beyond the range of numbers count as infinite.
        """
        if not (isfinite(a) and isfinite(b) and isfinite(c)):
            remedy = "Check the data for overflow."
            raise ParameterError("finite coefficients of a quadratic", f"{a}, {b}, {c}", remedy)
        largest = frexp(max(abs(a), abs(b), abs(c)))[1]
        a, b, c = (ldexp(item, -largest) for item in (a, b, c))  # no product overflows
        half = 0.0 - 0.5 * b
        square = half * half - a * c
        if square < 0.0 or a == half == 0.0:
            return cls.whole_line() if c <= 0.0 else cls.empty()
        # the root that does not cancel, and the other one by their product
        larger = half + copysign(sqrt(square) if a * c else abs(half), half)
        roots = larger / a if a else copysign(inf, larger), c / larger if larger else 0.0
        low, high = min(roots), max(roots)
        if a >= 0.0:
            return cls(((low, high),)) if low < inf and high > -inf else cls.empty()
        outside = ((-inf, low), (high, inf))
        return cls.union((lower, upper) for lower, upper in outside if lower < upper)

    @classmethod
    def from_membership(
        cls, contains: Callable[[Float[np.ndarray, " k"]], Bool[np.ndarray, " k"]], roots: Iterable[float]
    ) -> ConfidenceSet:
        """Set whose membership can change at `roots` only, which are in any order, finite or not.

        What it contains is asked once, for all roots, a value between each two neighbours and one beyond each
        outermost. Roots belong to it where a neighbouring stretch does, since it is closed, or by themselves.
        """
        ends = sorted({float(root) for root in roots if isfinite(root)})
        if not ends:
            return cls.whole_line() if contains(np.zeros(1))[0] else cls.empty()
        margin = max(1.0, abs(ends[0]), abs(ends[-1]))
        edges = [-inf, *ends, inf]
        midpoints = [low + 0.5 * (high - low) for low, high in pairwise(ends)]
        probes = [ends[0] - margin, *midpoints, ends[-1] + margin]
        stretches = [*zip(ends, ends, strict=True), *pairwise(edges)]
        belongs = contains(np.array([*ends, *probes]))
        return cls.union(piece for piece, inside in zip(stretches, belongs, strict=True) if inside)

    @property
    def is_empty(self) -> bool:
        """Whether no value belongs to the set."""
        return not self.intervals

    @property
    def is_bounded(self) -> bool:
        """Whether both ends are finite; the empty set is bounded."""
        return self.is_empty or (isfinite(self.intervals[0][0]) and isfinite(self.intervals[-1][1]))

    @property
    def hull(self) -> tuple[float, float]:
        """Lowest and highest value; (nan, nan) of the empty set."""
        if self.is_empty:
            return float("nan"), float("nan")
        return self.intervals[0][0], self.intervals[-1][1]

    @property
    def length(self) -> float:
        """Total length of the pieces."""
        return sum((high - low for low, high in self.intervals), start=0.0)

    def contains(self, value: float) -> bool:
        """Whether `value` belongs to the set."""
        checks.number("value", value)
        return any(low <= value <= high for low, high in self.intervals)

    def scaled(self, factor: float) -> ConfidenceSet:
        """Set of the values times a finite `factor` other than zero, as of a parameter in another unit."""
        if factor == 0.0 or not isfinite(factor):
            remedy = "Give the ratio of the units."
            raise ParameterError("a finite factor other than zero", f"{factor}", remedy)
        pairs = ((low * factor, high * factor) for low, high in self.intervals)
        return ConfidenceSet.union((min(pair), max(pair)) for pair in pairs)

    def __str__(self) -> str:
        if self.is_empty:
            return "empty"
        if self == self.whole_line():
            return "the whole line"
        return " or ".join(_text(low, high) for low, high in self.intervals)


def _text(low: float, high: float) -> str:
    if low == high:
        return f"{{{low:.5g}}}"
    left = "(-inf" if low == -inf else f"[{low:.5g}"
    right = "inf)" if high == inf else f"{high:.5g}]"
    return f"{left}, {right}"


#: Relative half-step of numerical derivatives, in half-widths.
DIFFERENCE = 1e-3
#: Where the search for an end stops, in half-widths of the delta method.
TOLERANCE = 1e-9

Function = Callable[[Float[np.ndarray, " n"]], float]


def gradient_of(
    function: Function, values: Float[np.ndarray, " n"], scale: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Gradient by central differences, each over `DIFFERENCE` times a scale; zero where the scale is."""
    gradient = np.zeros(values.size)
    for i in np.flatnonzero(scale):
        step = DIFFERENCE * scale[i] * np.eye(values.size)[i]
        gradient[i] = (function(values + step) - function(values - step)) / (2.0 * DIFFERENCE * scale[i])
    return gradient


def profile_interval(
    function: Function,
    values: Float[np.ndarray, " n"],
    covariance: Float[np.ndarray, "n n"],
    half_widths: float,
) -> tuple[float, float]:
    """Least and greatest value of a function over the ellipsoid of `half_widths` standard errors."""
    L = principal_axes(covariance, half_widths)
    centre = function(values)
    slope = L.T @ gradient_of(function, values, half_widths * np.sqrt(np.diag(covariance)))
    size = float(np.linalg.norm(slope))
    # A function may bend across its slope: each axis is a start of its own.
    starts = [sign * unit for unit in np.eye(values.size) for sign in (-1.0, 1.0)]
    if size > 0.0:
        starts += [-slope / size, slope / size]
    scale = max(abs(function(values + L @ w) - centre) for w in starts)
    if scale == 0.0:
        return centre, centre
    ends = []
    for sign in (-1.0, 1.0):

        def objective(w: Float[np.ndarray, " n"], sign: float = sign) -> float:
            inside = w / max(1.0, float(np.linalg.norm(w)))  # a search may try what lies outside
            return -sign * (function(values + L @ inside) - centre) / scale

        candidates = list(starts)
        for start in starts:
            # Strictly inside, where the boundary is no obstacle to the first line search.
            optimum = scipy.optimize.minimize(
                objective,
                0.9 * start,
                method="SLSQP",
                constraints={"type": "ineq", "fun": lambda w: 1.0 - w @ w, "jac": lambda w: -2.0 * w},
                options={"ftol": TOLERANCE, "maxiter": 200},
            )
            candidates.append(optimum.x / max(1.0, float(np.linalg.norm(optimum.x))))
        ends.append(function(values + L @ min(candidates, key=objective)))
    return min(*ends, centre), max(*ends, centre)


def principal_axes(covariance: Float[np.ndarray, "n n"], half_widths: float) -> Float[np.ndarray, "n n"]:
    """Vectors (columns) from the middle of the ellipsoid of `half_widths` standard errors to its ends."""
    eigenvalues, vectors = np.linalg.eigh(covariance)
    return np.asarray(half_widths * vectors * np.sqrt(np.maximum(eigenvalues, 0.0)))
