"""Separable problems: parameters, nuisances, bounds, priors and instruments."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar, cast

import numpy as np

from eivor import checks
from eivor.errors import ParameterError
from eivor.models.regression import LinearProblem, Parameter, Regression
from eivor.models.spectral import SpectralRegression
from eivor.signals.filters import first_order_lag
from eivor.signals.signals import Signals
from eivor.tools import Float, Int

#: Successive first-order lags of each reference: how many, and their time constant [s].
REFERENCE_LAGS = {
    "reference_position_z": (4, 0.4),
    "reference_velocity_z": (1, 0.2),
    "reference_acceleration_z": (1, 0.2),
    "feedback_reference_velocity_z": (1, 0.2),
    "pilot_throttle": (4, 0.4),
}
DEFAULT_LAGS = (1, 0.2)
LONE_LAGS = (6, 0.2)


class InstrumentRule(ABC):
    """Which columns serve as instruments."""

    @property
    @abstractmethod
    def label(self) -> str:
        """How reports call the choice."""

    @abstractmethod
    def columns(self, signals: Signals, command: Float[np.ndarray, " n"], /) -> Float[np.ndarray, "n p"]:
        """Columns on the grid of one flight; its command, neither lagged nor delayed, is upwards."""


@dataclass(frozen=True, slots=True)
class LaggedReferences(InstrumentRule):
    """Each reference and successive first-order lags of it."""

    channels: tuple[str, ...]  # References to use, all present in the signals
    lags: tuple[int, float] | None = None  # [s]

    @property
    def label(self) -> str:
        return ", ".join(self.channels)

    def columns(self, signals: Signals, _command: Float[np.ndarray, " n"], /) -> Float[np.ndarray, "n p"]:
        results: list[np.ndarray] = []
        for name in self.channels:
            default = REFERENCE_LAGS.get(name, DEFAULT_LAGS) if len(self.channels) > 1 else LONE_LAGS
            count, lag_s = default if self.lags is None else self.lags
            results.append(signals.channel(name))
            for _ in range(count):
                results.append(first_order_lag(results[-1], step_s=signals.step_s, lag_s=lag_s))
        return np.array(results).reshape(-1, signals.sample_count).T  # each column in one piece


@dataclass(frozen=True, slots=True)
class LaggedInputs(InstrumentRule):
    """Past mapped commands, the paper's (21): u(k - first) ... u(k - last)."""

    first: int = 1
    last: int = 15

    @property
    def label(self) -> str:
        return f"input lagged by {self.first} to {self.last} samples"

    def columns(self, _signals: Signals, command: Float[np.ndarray, " n"], /) -> Float[np.ndarray, "n p"]:
        """Lagged commands; before the record they are at rest."""
        lags = range(self.first, self.last + 1)
        known = np.concatenate([np.full(self.last, command[0]), command])
        return np.column_stack([known[self.last - lag :][: command.size] for lag in lags])


@dataclass(frozen=True, slots=True)
class NoInstruments(InstrumentRule):
    """For direct methods."""

    label = "none"

    def columns(self, signals: Signals, _command: Float[np.ndarray, " n"], /) -> Float[np.ndarray, "n p"]:
        return np.empty((signals.sample_count, 0))


Number = TypeVar("Number", float, np.ndarray)

#: The value of every nuisance, by name; and at many points.
Values = Mapping[str, float]
ManyValues = Mapping[str, Float[np.ndarray, " points"]]

#: Tolerances from an end within which a search stands at it.
AT_END = 10.0
#: Half-step of numerical derivatives, as a share of the value or of the grid's span.
DIFFERENCE = 1e-3


@dataclass(frozen=True, slots=True)
class Prior:
    """What is known of a nuisance before the data are seen: a measurement of it, with a normal error.

    Raises
    ------
    ParameterError
        When the standard error is not positive, or a number is not finite.
    UsageError
        When one of them is no number.
    """

    mean: float  # In the nuisance's unit
    std: float  # Its standard error

    def __post_init__(self) -> None:
        checks.number("mean", self.mean)
        checks.number("std", self.std)
        if not (np.isfinite(self.mean) and np.isfinite(self.std) and self.std > 0.0):
            expected = "a finite mean and a positive standard error"
            raise ParameterError(expected, f"{self.mean} and {self.std}", "Give both.")

    def misfit(self, value: Number) -> Number:
        """Squared distance of a value, or of each of an array, from the mean, in standard errors."""
        return ((value - self.mean) / self.std) ** 2


@dataclass(frozen=True, slots=True)
class Bounds:
    """Least and largest value of a nuisance, of which nothing else is known: a uniform prior.

    Raises
    ------
    ParameterError
        When the least is above the largest, or one is not finite.
    UsageError
        When one of them is no number.
    """

    low: float  # In the nuisance's unit
    high: float  # The same as `low` when the value is known

    def __post_init__(self) -> None:
        checks.number("low", self.low)
        checks.number("high", self.high)
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low <= self.high):
            remedy = "Give both."
            raise ParameterError("finite bounds, the lower one first", f"{self.low} and {self.high}", remedy)


@dataclass(frozen=True, eq=False)
class Nuisance:
    """A parameter that moves columns, and where it is looked for."""

    parameter: Parameter  # Name and unit
    #: Values to begin a search at, increasing; one of a value that is known
    grid: Float[np.ndarray, " values"]
    prior: Prior | None = None  # Of its sum with those that it is known with
    known_with: tuple[str, ...] = ()
    #: Nuisance of which it takes a part: data determine their sum, and hardly how it is split.
    part_of: str = ""
    tolerance: float = 1e-6  # Accuracy of the search, in the parameter's unit
    resolution: float = 0.0

    def __post_init__(self) -> None:
        if not (self.grid.size and np.isfinite(self.grid).all() and (np.diff(self.grid) > 0.0).all()):
            expected = f"one or more finite values of {self.name}, increasing"
            raise ParameterError(expected, f"{self.grid}", "Sort them.")
        if not self.tolerance > 0.0:
            remedy = "Give a small number."
            raise ParameterError(f"a positive tolerance of {self.name}", f"{self.tolerance}", remedy)

    @property
    def name(self) -> str:
        return self.parameter.name

    @property
    def searched(self) -> bool:
        """Whether there is more than one value to choose from."""
        return self.grid.size > 1

    @property
    def first(self) -> float:
        """Least value of the grid: the value of a nuisance that is known."""
        return float(self.grid[0])

    def misfit(self, nuisance_values: Values) -> float:
        """Squared distance of its value from its prior, in standard errors."""
        return 0.0 if self.prior is None else self.prior.misfit(self.with_others(nuisance_values))

    def with_others(self, numbers: Mapping[str, Number]) -> Number:
        """Sum of its value and of those that share its prior."""
        return numbers[self.name] + sum(numbers[name] for name in self.known_with)

    def information(self, names: Sequence[str], nuisance_values: Values) -> Float[np.ndarray, "k q"]:
        """Rows of prior information, by the nuisances that are searched for, over standard errors."""
        value, rest = nuisance_values[self.name], nuisance_values.get(self.part_of, 0.0)
        summed = {self.name, *self.known_with}
        if self.prior is not None:
            return np.array([[(name in summed) / self.prior.std for name in names]])
        if self.part_of not in names or not value + rest > 0.0:
            return np.empty((0, len(names)))
        total = value + rest
        std = float(np.hypot(total / np.sqrt(12.0), value - 0.5 * total))
        share = {self.name: rest / total, self.part_of: -value / total}
        return np.array([[share.get(name, 0.0) / std for name in names]])

    def at_end(self, value: float) -> bool:
        """Whether a value is the least or the largest of the grid, as well as a search knows it."""
        return min(value - self.first, float(self.grid[-1]) - value) <= AT_END * self.tolerance

    @property
    def positive(self) -> bool:
        """Whether every value is above zero, so that ratios of values say more than differences."""
        return self.first > 0.0

    def places_of(self, values: Float[np.ndarray, "*k"]) -> Float[np.ndarray, "*k"]:
        """Places of values on a scale on which criteria are smooth."""
        return np.log(values) if self.positive else values

    def values_at(self, places: Float[np.ndarray, "*k"]) -> Float[np.ndarray, "*k"]:
        """Values at places of that scale."""
        return np.exp(places) if self.positive else places

    def known_at(self, value: float) -> Nuisance:
        """Return the same nuisance with one value, which is not searched for."""
        return replace(self, grid=np.array([value]), prior=None, known_with=())

    def around(self, value: float) -> tuple[float, float]:
        """Values below and above one, for a numerical derivative."""
        if self.positive:
            return (1.0 - DIFFERENCE) * value, max((1.0 + DIFFERENCE) * value, self.resolution)
        low, high = float(self.grid[0]), float(self.grid[-1])
        step = DIFFERENCE * (high - low)
        return max(value - step, low), min(value + step, high)

    def derivative(self, function: Callable[[Values], Number], nuisance_values: Values) -> Number:
        """Derivative of a function of all nuisances by this one, by a central difference, see `around`."""
        low, high = self.around(nuisance_values[self.name])
        below, above = (function({**nuisance_values, self.name: value}) for value in (low, high))
        return (above - below) / (high - low)


@dataclass(frozen=True, slots=True)
class SampledState:
    """A state whose derivative was measured as well, so that bins have two candidates for one response."""

    index: int
    state_density: float
    response_density: float
    driven_density: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class WarmStart:
    """An estimate of nearly the same columns, whose residuals determine the weights of rows."""

    theta: Float[np.ndarray, " n"]
    nuisances: Values  # Every nuisance's value


#: Places of the columns that move in a run, and their real rows at each point.
MovingColumns = tuple[Int[np.ndarray, " m"], Float[np.ndarray, "points m rows"]]


class Interpolation(ABC):
    """Columns at any values of the nuisances as sums of those at some."""

    points: list[dict[str, float]]  # Where columns are made

    @abstractmethod
    def weights(self, values: ManyValues) -> Float[np.ndarray, "points nodes"]:
        """Weights of the columns at each of `points`."""


def values_of(points: Sequence[Values]) -> ManyValues:
    """Values at some points, by nuisance."""
    return {name: np.array([point[name] for point in points]) for name in points[0]}


class SeparableProblem(ABC):
    """A regression for each value of the nuisances."""

    nuisances: tuple[Nuisance, ...]
    warm_start: WarmStart | None = None

    def with_nuisances(self, nuisances: tuple[Nuisance, ...]) -> SeparableProblem:
        """Return the same problem, a dataclass, with other grids or priors of its nuisances."""
        return replace(cast("Any", self), nuisances=nuisances)

    @abstractmethod
    def rows(self, nuisance_values: Values) -> Regression:
        """Rows in time."""

    @abstractmethod
    def bins(self, nuisance_values: Values) -> SpectralRegression:
        """Rows in frequency, one block for each run."""

    @property
    def still(self) -> int:
        """Number of leading columns that are the same at all values of the nuisances."""
        return 0

    @property
    def costly(self) -> bool:
        """Whether columns at other values take longer to make than an elaborate search to choose them."""
        return False

    @property
    def interpolation(self) -> Interpolation | None:
        """How columns at all values follow from those at some; by default they do not."""
        return None

    def moving_columns(self, points: Sequence[Values]) -> Iterator[MovingColumns]:
        """Moving columns of each run, at many values of the nuisances."""
        rows, start = [self.bins(point) for point in points], 0
        for run in rows[0].layout.runs:
            X = np.stack([bins.regressors[start : start + run.count, self.still :].T for bins in rows])
            index = np.flatnonzero(X.any(axis=(0, 2)))
            yield self.still + index, np.concatenate([X[:, index].real, X[:, index].imag], axis=2)
            start += run.count

    def sampled_state(self, _nuisance_values: Values, /) -> SampledState | None:
        """The state whose derivative the candidates for the response are; by default there is none."""
        return None

    @property
    def few_rows(self) -> bool:
        """Whether some column lives in few bins, so that its variance has to be reported row by row."""
        return False

    @property
    def first_values(self) -> dict[str, float]:
        """Every nuisance at the least value of its grid."""
        return {nuisance.name: nuisance.first for nuisance in self.nuisances}


@dataclass(frozen=True)
class GivenBins(SeparableProblem):
    """Rows in frequency that no nuisance moves."""

    given: SpectralRegression
    nuisances = ()

    def rows(self, _nuisance_values: Values) -> Regression:
        ones = np.ones(len(self.given.responses))
        return self.given.whitened(0.5 * ones, ones, self.given.layout.stacked(self.given.instruments))

    def bins(self, _nuisance_values: Values) -> SpectralRegression:
        return self.given


class LinearisableProblem(SeparableProblem):
    """A separable problem that is, beside any point, a linear problem of all its unknowns."""

    @abstractmethod
    def regression(self, nuisance_values: Values) -> LinearProblem:
        """Problem of the linear parameters at values of the nuisances."""

    @abstractmethod
    def linearised(self, nuisance_values: Values, theta: Float[np.ndarray, " n"]) -> LinearProblem:
        """Problem of the linear parameters and of the changes of the nuisances, beside a point."""

    def rows(self, nuisance_values: Values) -> Regression:
        return self.regression(nuisance_values).rows()
