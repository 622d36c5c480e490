"""Fractional difference equations: terms, operators, model and regression."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from eivor import checks
from eivor.errors import (
    DataError,
    MissingNoiseError,
    NonFiniteError,
    ParameterError,
    ShapeError,
    TooFewSamplesError,
    UsageError,
)
from eivor.models.regression import Column, LinearProblem, Parameter, Regression, check_columns
from eivor.models.separable import LinearisableProblem, Nuisance, Values
from eivor.models.spectral import SpectralRegression
from eivor.signals.filters import cascaded, filtered, reciprocal
from eivor.signals.noise import fractional_weights, order_slope
from eivor.signals.signals import Signals
from eivor.tools import Complex, Float


class FractionalOperator(ABC):
    """A causal filter for each order, the identity at zero; the record is zero before it starts."""

    @abstractmethod
    def differences(self, order: float, step_s: float, /) -> tuple[tuple[float, float, int], ...]:
        """Terms c Delta^(order + n) of samples `step_s` apart [s]: c, its derivative by the order, and n."""

    @property
    def finer(self) -> FractionalOperator | None:
        """Operator with an error of one order more in the step; None where the step is not in it."""
        return None

    def weights(self, order: float, count: int, step_s: float) -> Float[np.ndarray, " count"]:
        """Weights w_0 ... w_{count-1} of the filter."""
        terms = self.differences(order, step_s)
        return np.asarray(sum(c * fractional_weights(order + n, count) for c, _, n in terms))

    def slope(self, order: float, count: int, step_s: float) -> Float[np.ndarray, " count"]:
        """Derivatives of the weights by the order."""
        total = np.zeros(count)
        for c, by_order, n in self.differences(order, step_s):
            total += c * order_slope(order + n, count) + by_order * fractional_weights(order + n, count)
        return total

    def response(
        self, order: float, back: Complex[np.ndarray, " k"], step_s: float
    ) -> Complex[np.ndarray, " k"]:
        """sum_j w_j z^-j where z^-1 has the values `back`, the principal value."""
        change = 1.0 - back
        return np.asarray(sum(c * change ** (order + n) for c, _, n in self.differences(order, step_s)))


@dataclass(frozen=True, slots=True)
class FractionalDifference(FractionalOperator):
    """Grunwald-Letnikov's difference of samples, Delta^order = (1 - z^-1)^order: the step is not in it."""

    def differences(self, _order: float, _step_s: float, /) -> tuple[tuple[float, float, int], ...]:
        return ((1.0, 0.0, 0),)


@dataclass(frozen=True, slots=True)
class FractionalDerivative(FractionalOperator):
    """Derivative by time, (Delta^order + order/2 Delta^(order+1)) / step^order: per second to the order.

    Delta^order / step^order alone is the derivative at a time order/2 steps ago and has an error of the
    first order of the step. The second term takes it away, which leaves one of the second order.
    """

    #: First terms of (-log(1 - Delta) / step)^order: an error of their number's order in the step
    terms: int = 2

    @property
    def finer(self) -> FractionalOperator:
        return FractionalDerivative(self.terms + 1)

    def differences(self, order: float, step_s: float, /) -> tuple[tuple[float, float, int], ...]:
        scale = step_s**-order
        terms = [(scale, -np.log(step_s) * scale, 0)]
        for n in range(1, self.terms):  # J. C. P. Miller's recurrence for a power of a series
            c = by_order = 0.0
            for k in range(1, n + 1):
                coefficient, slope, _ = terms[n - k]
                factor = (k * order - n + k) / (n * (k + 1.0))
                c += factor * coefficient
                by_order += factor * slope + k / (n * (k + 1.0)) * coefficient
            terms.append((c, by_order, n))
        return tuple(terms)


#: Points of the unit circle, from so near to one on, at which the equation's roots are counted.
CIRCLE_POINTS = 20_000
NEAREST_ANGLE = 1e-9


@dataclass(frozen=True, slots=True)
class Side:
    """sum_i c_i z^-lag_i operator^order_i."""

    terms: tuple[tuple[float, float, int], ...]  # Coefficient, order and lag of each term
    operator: FractionalOperator
    step_s: float  # Time between samples [s]

    def weights(self, count: int) -> Float[np.ndarray, " count"]:
        total: Float[np.ndarray, " count"] = np.zeros(count)
        for coefficient, order, lag in self.terms:
            weights = self.operator.weights(order, count, self.step_s)
            total[lag:] += coefficient * weights[: max(count - lag, 0)]
        return total

    def response(self, back: Complex[np.ndarray, " k"]) -> Complex[np.ndarray, " k"]:
        """Value where z^-1 has the values `back`."""
        total: Complex[np.ndarray, " k"] = np.zeros(back.size, dtype=np.complex128)
        for coefficient, order, lag in self.terms:
            total += coefficient * back**lag * self.operator.response(order, back, self.step_s)
        return total

    @property
    def growing_modes(self) -> int:
        """Roots inside the unit circle of z^-1: each is a mode of the output that grows."""
        lowest = min(order for _, order, _ in self.terms)
        angles = np.geomspace(NEAREST_ANGLE, np.pi, CIRCLE_POINTS)
        back = np.exp(-1j * angles)
        phase = np.unwrap(np.angle(self.response(back) / (1.0 - back) ** lowest))
        # From one back to one below the real axis is the mirror image: twice the half circle.
        return abs(round(float(phase[-1] - phase[0]) / np.pi))


LARGEST_ORDER = 3.0


@dataclass(frozen=True, slots=True)
class UnknownOrder:
    """An order that is estimated; the same name in several terms is one unknown.

    Raises
    ------
    ParameterError
        When the range is empty, or reaches beyond that.
    UsageError
        When the name is no text or empty, or a number is none.
    """

    name: str  # How results call it
    low: float  # Between what it is looked for, within -3 and 3
    high: float

    def __post_init__(self) -> None:
        checks.text("name", self.name)
        checks.number("low", self.low)
        checks.number("high", self.high)
        if not self.name:
            raise UsageError("a name for an unknown order", "''", 'Call it "order", for example.')
        if not -LARGEST_ORDER <= self.low < self.high <= LARGEST_ORDER:
            raise ParameterError(
                f"a range of orders between -{LARGEST_ORDER:g} and {LARGEST_ORDER:g}, the lower end first",
                f"{self.low} and {self.high} for '{self.name}'",
                "Differentiate or integrate the channel by whole orders first.",
            )


#: An order, known or sought.
Order = float | UnknownOrder


def order_at(order: Order, orders: Mapping[str, float]) -> float:
    """Order, which a mapping has where it is sought."""
    return orders[order.name] if isinstance(order, UnknownOrder) else float(order)


@dataclass(frozen=True, slots=True)
class FractionalPart:
    """``gain * operator^order channel[k - lag]``, or its derivative by the order. Performs no checks."""

    channel: str
    order: Order = 0.0
    lag: int = 0
    gain: float = 1.0  # Constant, noise-free factor
    by_order: bool = False  # True for the derivative by the order

    def at(self, orders: Mapping[str, float]) -> FractionalPart:
        return replace(self, order=order_at(self.order, orders))


#: A column: the sum of its parts, of known orders.
FractionalColumn = tuple[FractionalPart, ...]


def channels_of(columns: Sequence[FractionalColumn]) -> list[str]:
    """Channels that columns are made of."""
    return sorted({part.channel for column in columns for part in column})


@dataclass(frozen=True, slots=True)
class FractionalTerm:
    """One term of the equation: a channel behind an operator of some order, some samples ago.

    Raises
    ------
    ParameterError
        When a known order is out of range.
    UsageError
        When the lag is no whole number or negative, or the order is of another type.
    """

    order: Order  # Of the difference, between -3 and 3; below zero it is a sum
    lag: int = 0  # Samples back, zero or more

    def __post_init__(self) -> None:
        checks.counted("lag", self.lag, 0, "a lag of zero or more samples", "Only past samples have a part.")
        if isinstance(self.order, UnknownOrder):
            return
        checks.number("order", self.order)
        if not (np.isfinite(self.order) and abs(self.order) <= LARGEST_ORDER):
            expected = f"an order between -{LARGEST_ORDER:g} and {LARGEST_ORDER:g}"
            remedy = "Differentiate or integrate the channel by whole orders first."
            raise ParameterError(expected, f"{self.order}", remedy)

    @property
    def range(self) -> tuple[float, float]:
        """Least and largest order that it may have."""
        order = self.order
        return (order.low, order.high) if isinstance(order, UnknownOrder) else (float(order), float(order))


def terms_of(name: str, parts: object) -> tuple[FractionalTerm, ...]:
    """Terms from a sequence of them, of orders, or of both."""
    kinds = (FractionalTerm, UnknownOrder, *checks.NUMBERS)
    if not isinstance(parts, tuple | list) or not parts or not all(isinstance(item, kinds) for item in parts):
        expected = f"one term or more for {name}: orders, unknown orders, or FractionalTerm(order, lag)"
        raise UsageError(expected, checks.described(parts), "Give (0.0, 0.5), for example.")
    terms = tuple(item if isinstance(item, FractionalTerm) else FractionalTerm(item) for item in parts)
    for entry, other in combinations(terms, 2):
        # one column where lags are the same and an order is in both: two ranges may touch
        (low, high), (smallest, largest) = entry.range, other.range
        overlap, both_ranges = min(high, largest) - max(low, smallest), low < high and smallest < largest
        if entry.lag == other.lag and (overlap > 0.0 if both_ranges else overlap >= 0.0):
            expected = f"terms of different orders or lags for {name}, in ranges that do not meet"
            received = f"orders {_span(entry)} and {_span(other)} at lag {entry.lag}"
            remedy = "Where orders are equal their columns are one: leave a term out, or narrow the range."
            raise ParameterError(expected, received, remedy)
    return terms


def _span(term: FractionalTerm) -> str:
    low, high = term.range
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


#: Filtered series by channel, order, and whether they are the derivative by the order.
SeriesCache = dict[tuple[str, float, bool], Float[np.ndarray, " n"]]


@dataclass(frozen=True)
class FilteredSignals:
    """Channels filtered by the operators of one equation."""

    signals: Signals
    operator: FractionalOperator
    known_orders: frozenset[float] = frozenset()
    both_sides: Float[np.ndarray, " m"] = field(default_factory=lambda: np.ones(1))
    _series: SeriesCache = field(default_factory=dict, init=False, repr=False)
    _noises: SeriesCache = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self) -> None:
        valid, offset = self.signals.valid, self.signals.offset
        if not offset and (valid is None or bool(valid.all())):
            return
        received = (
            f"one that begins at sample {offset} of another" if offset else "samples that are not valid"
        )
        remedy = "A fractional difference has all samples before in it: cut the record where it was at rest."
        raise DataError("a whole record, every sample of which is valid", received, remedy)

    @property
    def count(self) -> int:
        return self.signals.sample_count

    def values(self, column: FractionalColumn, first: int) -> Float[np.ndarray, " rows"]:
        """Column of the samples from `first` on."""
        if self.count <= first:
            expected = f"more than {first} samples"
            raise TooFewSamplesError(expected, f"{self.count}", "Give a longer record or fewer lags.")
        total: Float[np.ndarray, " rows"] = np.zeros(self.count - first)
        for part in column:
            series = self._filtered(self._series, part, self.signals.channel)
            total += part.gain * series[first - part.lag : self.count - part.lag]
        return total

    def shared_noise(
        self, left: Sequence[Column], right: Sequence[FractionalColumn], first: int
    ) -> Float[np.ndarray, "left right"]:
        """Average covariance of the noises of plain columns with those of fractional ones, C of (29)."""
        covariance = np.zeros((len(left), len(right)))
        for channel in channels_of(right):
            selected = [i for i, column in enumerate(left) if column.channel == channel]
            if not selected:
                continue
            noises = self._noise_of(channel, right) * self._share_of_rows(first)[:, None]
            base = self._moving_average(channel)
            for i in selected:
                if left[i].gain_channel:
                    expected = f"instruments of '{channel}' without a gain of another channel"
                    received = f"{left[i].name} times '{left[i].gain_channel}'"
                    raise UsageError(expected, received, "Leave the gain out.")
                lag = left[i].lag
                weights = base[: max(self.count - lag, 0)]
                covariance[i] += left[i].gain * (weights @ noises[lag : lag + weights.size])
        return covariance

    def noise_covariance(
        self, columns: Sequence[FractionalColumn], first: int
    ) -> Float[np.ndarray, "columns columns"]:
        """Average covariance of the noises of columns among themselves."""
        total = np.zeros((len(columns), len(columns)))
        for channel in channels_of(columns):
            noises = self._noise_of(channel, columns)
            total += (noises * self._share_of_rows(first)[:, None]).T @ noises
        return 0.5 * (total + total.T)

    def _share_of_rows(self, first: int) -> Float[np.ndarray, " n"]:
        """Share of the rows that a noise sample of each age enters."""
        return np.minimum(1.0, (self.count - np.arange(self.count)) / (self.count - first))

    def _noise_of(self, channel: str, columns: Sequence[FractionalColumn]) -> Float[np.ndarray, "n columns"]:
        weights: Float[np.ndarray, "n columns"] = np.zeros((self.count, len(columns)))
        for index, column in enumerate(columns):
            for part in column:
                if part.channel == channel:
                    filtered = self._filtered(self._noises, part, self._moving_average)
                    series = filtered[: max(self.count - part.lag, 0)]
                    weights[part.lag : part.lag + series.size, index] += part.gain * series
        return weights

    def _moving_average(self, channel: str) -> Float[np.ndarray, " n"]:
        noise = self.signals.noise.get(channel)
        if noise is None:
            raise MissingNoiseError(
                f"a declared noise of channel '{channel}', which columns share",
                f"noise of {', '.join(sorted(self.signals.noise)) or 'no channel'}",
                "Declare it in Signals(noise=...), with std 0 if the channel is exact, or use a method that "
                "needs none: least_squares, or extended_iv with instruments of another channel.",
            )
        weights = noise.moving_average(self.count)
        return weights[: int(np.flatnonzero(weights).max(initial=0)) + 1]  # one weight of white noise

    def _filtered(
        self, cache: SeriesCache, part: FractionalPart, source: Callable[[str], Float[np.ndarray, " _"]]
    ) -> Float[np.ndarray, " _"]:
        """A channel, or its noise, filtered by the operator of a part; cached for known orders."""
        order = order_at(part.order, {})  # orders of parts are known
        key = (part.channel, order, part.by_order)
        if key in cache:
            return cache[key]
        if order == 0.0 and not part.by_order:
            result = cascaded(self.both_sides, source(part.channel))
        else:
            weights_of = self.operator.slope if part.by_order else self.operator.weights
            weights = weights_of(order, self.count, self.signals.step_s)
            result = cascaded(weights, self._filtered(cache, FractionalPart(part.channel), source))
        if order in {0.0, *self.known_orders}:
            cache[key] = result
        return result


@dataclass(frozen=True)
class FractionalRegression(LinearProblem):
    """Rows of a fractional difference equation whose orders are known."""

    filtered: FilteredSignals
    parameters: tuple[Parameter, ...]
    response: FractionalColumn
    regressors: tuple[FractionalColumn, ...]
    instrument_columns: tuple[Column, ...] = ()
    first: int = field(init=False)

    def __post_init__(self) -> None:
        parts = [part.lag for column in (self.response, *self.regressors) for part in column]
        object.__setattr__(self, "first", max([*parts, *(column.lag for column in self.instrument_columns)]))

    @property
    def instrument_count(self) -> int:
        return len(self.instrument_columns)

    @property
    def finer(self) -> FractionalRegression | None:  # type: ignore[override]
        operator = self.filtered.operator.finer
        return None if operator is None else replace(self, filtered=replace(self.filtered, operator=operator))

    @cached_property
    def _rows(self) -> Regression:
        Phi = np.column_stack([self.filtered.values(column, self.first) for column in self.regressors])
        signals = self.filtered.signals
        instruments = [column.values(signals, self.first) for column in self.instrument_columns]
        Psi = np.column_stack(instruments) if instruments else np.empty((Phi.shape[0], 0))
        response = self.filtered.values(self.response, self.first)
        return Regression(response, Phi, Psi, self.parameters, regressor_noise=self.declared_noise())

    def rows(self) -> Regression:
        return self._rows

    @cached_property
    def _columns(self) -> tuple[FractionalColumn, ...]:
        return (*self.regressors, self.response)

    @cached_property
    def _own_noise(self) -> Float[np.ndarray, "n_plus_1 n_plus_1"]:
        return self.filtered.noise_covariance(self._columns, self.first)

    def regressor_noise_covariance(self) -> Float[np.ndarray, "n_plus_1 n_plus_1"]:
        return self._own_noise

    def instrument_noise_covariance(self) -> Float[np.ndarray, "p n_plus_1"]:
        return self.filtered.shared_noise(self.instrument_columns, self._columns, self.first)

    def instruments_share_noise(self) -> bool:
        declared = self.filtered.signals.noise
        noisy = tuple(column for column in self.instrument_columns if column.channel in declared)
        return bool(np.any(self.filtered.shared_noise(noisy, self._columns, self.first)))


#: Values of an order at which its search begins.
GRID_POINTS = 11
#: Accuracy of the search, before the equations themselves say the rest.
ORDER_TOLERANCE = 1e-5


@dataclass(frozen=True)
class FractionalProblem(LinearisableProblem):
    """A fractional difference equation and a record of it."""

    filtered: FilteredSignals
    response: FractionalPart  # Left side, of a known order
    terms: tuple[tuple[Parameter, FractionalPart], ...]
    instruments: tuple[Column, ...] = ()  # May be empty
    nuisances: tuple[Nuisance, ...] = field(default=())  # Orders that are sought

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(parameter for parameter, _ in self.terms)

    def regression(self, nuisances: Values) -> FractionalRegression:
        columns = tuple((term.at(nuisances),) for _, term in self.terms)
        return FractionalRegression(
            self.filtered, self.parameters, (self.response,), columns, self.instruments
        )

    def linearised(self, nuisances: Values, theta: Float[np.ndarray, " n"]) -> FractionalRegression:
        base = self.regression(nuisances)
        orders, slopes = tuple(nuisance.parameter for nuisance in self.nuisances), []
        for parameter in orders:
            parts = (
                replace(term.at(nuisances), by_order=True, gain=value * term.gain)
                for value, (_, term) in zip(theta.tolist(), self.terms, strict=True)
                if isinstance(term.order, UnknownOrder) and term.order.name == parameter.name
            )
            slopes.append(tuple(parts))
        return replace(base, parameters=self.parameters + orders, regressors=(*base.regressors, *slopes))

    def bins(self, nuisances: Values) -> SpectralRegression:
        """Nothing: an operator's memory does not end with a run."""
        expected = "a method without spectral whitening for a fractional difference equation"
        remedy = "Use generalized_iv, or another method of the page on fractional equations."
        raise UsageError(expected, f"one that asks for its spectra at {dict(nuisances)}", remedy)


#: Smallest sum of the coefficients of y(k), as a share of the largest, that y(k) can be solved for.
LEAST_OWN_COEFFICIENT = 1e-12
Series = Float[np.ndarray, " n"]
#: Coefficients and unknown orders by name, as `Estimate.parameters` gives them.
Parameters = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class FractionalDifferenceModel:
    """A fractional difference equation with noise on its output and its input.

    Raises
    ------
    ParameterError
        When an order is out of range, or two terms of a side and lag are of one order or might be. When the
        first order of the output is unknown, or one name has two ranges.
    UsageError
        When an argument is of another type.
    """

    # Terms of each side. The first of the output has the coefficient one and a known order; the others have
    # the parameters `output_coefficient_2`, ..., the input's `input_coefficient_1`, ...
    output: tuple[float | UnknownOrder | FractionalTerm, ...]
    input: tuple[float | UnknownOrder | FractionalTerm, ...]
    # What an order means: `FractionalDifference` of samples, or `FractionalDerivative` by time
    operator: FractionalOperator = field(default_factory=FractionalDifference)

    def __post_init__(self) -> None:
        for side in ("output", "input"):
            object.__setattr__(self, side, terms_of(side, getattr(self, side)))
        remedy = "Leave it out, or give FractionalDerivative()."
        checks.kind("operator", self.operator, FractionalOperator, "an operator", remedy)
        leading = self._of_side("output")[0].order
        if isinstance(leading, UnknownOrder):
            expected = "a known order of the first term of the output"
            remedy = "Put a term of known order first, or take Delta^-order of both sides."
            raise ParameterError(expected, f"the unknown '{leading.name}'", remedy)
        ranges = {order.name: order for order in self._repeated_orders()}
        for order in self._repeated_orders():
            if order != ranges[order.name]:
                expected = f"one range of the order '{order.name}'"
                raise ParameterError(expected, "two", "Use one UnknownOrder in both terms.")
        clash = sorted({parameter.name for parameter, _ in self._terms()} & set(ranges))
        if clash:
            raise ParameterError("orders with names of their own", f"'{clash[0]}'", "Rename the order.")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Coefficients, then unknown orders."""
        return (
            *(parameter for parameter, _ in self._terms()),
            *(Parameter(order.name) for order in self.unknown_orders),
        )

    @property
    def unknown_orders(self) -> tuple[UnknownOrder, ...]:
        """Each order that is estimated, once."""
        return tuple(dict.fromkeys(self._repeated_orders()))

    def problem(
        self,
        signals: Signals,
        instruments: tuple[Column, ...] = (),
        *,
        divided_by_output_at: Parameters | None = None,
    ) -> FractionalProblem:
        """Pose the equation for `ev.identify`.

        Parameters
        ----------
        signals : Signals
            One whole record that was at rest before it began, with the channels `output` and `input`, and
            the noises of those that are not exact.
        instruments : tuple of Column
            Such as ``ev.lags("input", 0, 10)``. Lags of the input share noise with its differences of any
            order that is not whole, so that they are for compensated methods: `generalized_iv`.
        divided_by_output_at : mapping of str to float, optional
            Parameters, guessed or from a former estimate, at which both sides are divided by the output's
            side. This filter leaves the equation as it is. The noise of y is then nearly white in the
            residual, instead of amplified where it changes quickly. With white noise on slow signals, errors
            are much smaller. How good the guess is bears on these errors, and on nothing else.

        Returns
        -------
        FractionalProblem
            A regression for each value of the unknown orders.

        Raises
        ------
        DataError
            When a sample is not valid, or the record part of another one.
        MissingChannelError
            When a channel is absent.
        UsageError
            When an argument is of another type.
        """
        checks.kind("signals", signals, Signals, "Signals", "Make them: ev.Signals(rate_hz, channels).")
        check_columns("instruments", instruments)
        for channel in ("output", "input"):
            signals.channel(channel)
        both_sides = np.ones(1)
        if divided_by_output_at is not None:
            both_sides = self._output_filter(
                divided_by_output_at, signals.sample_count, rate_hz=signals.rate_hz
            )
        orders_of_terms = [term.order for term in self._every]
        known = frozenset(float(item) for item in orders_of_terms if not isinstance(item, UnknownOrder))
        orders = tuple(
            Nuisance(Parameter(o.name), np.linspace(o.low, o.high, GRID_POINTS), tolerance=ORDER_TOLERANCE)
            for o in self.unknown_orders
        )
        series = FilteredSignals(signals, self.operator, known, both_sides)
        first = self._of_side("output")[0]
        response = FractionalPart("output", first.order, first.lag)
        return FractionalProblem(series, response, tuple(self._terms()), instruments, orders)

    def impulse_response(self, parameters: Parameters, count: int, *, rate_hz: float = 1.0) -> Series:
        """Output of the equation, from rest, for the input 1, 0, 0, ...

        Parameters
        ----------
        parameters : mapping of str to float
            Coefficients and unknown orders, as ``estimate.parameters`` has them.
        count : int
            Samples.
        rate_hz : float
            Samples per second [Hz]; differences of samples do not depend on it.

        Returns
        -------
        ndarray, shape (count,)
            O(count log count).

        Raises
        ------
        ParameterError
            When a parameter is missing or not finite, the equation has no y(k) to solve for, or it is
            unstable: the response would grow without bound.
        """
        checks.counted("count", count, 1, "one sample or more", "Give the length of the response.")
        inverse = self._output_filter(parameters, count, rate_hz=rate_hz)
        return filtered(inverse, self._side("input", parameters, rate_hz).weights(count))

    def simulate(self, parameters: Parameters, driven: Series, *, rate_hz: float = 1.0) -> Series:
        """Output of the equation, from rest, for an input: the free run of a model.

        Parameters
        ----------
        parameters : mapping of str to float
            See `impulse_response`.
        driven : ndarray, shape (n,)
            Input.
        rate_hz : float
            Samples per second [Hz].

        Returns
        -------
        ndarray, shape (n,)
            O(n log n).

        Raises
        ------
        ParameterError
            See `impulse_response`.
        ShapeError, NonFiniteError, DataError
            When the input is no record of finite numbers.
        """
        series = checks.real_array("driven", driven)
        if series.ndim != 1 or not series.size:
            raise ShapeError("an input of shape (n,)", f"shape {series.shape}", "Give one channel.")
        if not np.isfinite(series).all():
            raise NonFiniteError("a finite input", "NaN or infinity in it", "Repair those samples.")
        return filtered(self.impulse_response(parameters, series.size, rate_hz=rate_hz), series)

    def frequency_response(
        self, parameters: Parameters, frequency_hz: Series, *, rate_hz: float = 1.0
    ) -> Complex[np.ndarray, " k"]:
        """Output over input of a long steady oscillation: an impedance, for a current and a voltage.

        Parameters
        ----------
        parameters : mapping of str to float
            See `impulse_response`.
        frequency_hz : ndarray, shape (k,)
            Above zero, up to half the rate [Hz].
        rate_hz : float
            Samples per second [Hz].

        Raises
        ------
        ParameterError
            When a frequency is out of range, or a parameter missing or not finite.
        ShapeError, DataError
            When the frequencies are no series of numbers.
        """
        over, under = (self._side(side, parameters, rate_hz) for side in ("input", "output"))
        frequencies = checks.real_array("frequency_hz", frequency_hz)
        if frequencies.ndim != 1:
            raise ShapeError("frequencies of shape (k,)", f"shape {frequencies.shape}", "Give a series.")
        if not ((frequencies > 0.0) & (frequencies <= 0.5 * rate_hz)).all():
            expected = f"frequencies above zero and up to {0.5 * rate_hz:g} Hz, half the rate"
            remedy = "Leave the others out, or give the rate of the record: rate_hz=..."
            raise ParameterError(expected, f"{frequencies}", remedy)
        back = np.exp(-2j * np.pi * frequencies / rate_hz)
        return np.asarray(over.response(back) / under.response(back))

    def _of_side(self, side: str) -> tuple[FractionalTerm, ...]:
        return terms_of(side, getattr(self, side))

    @property
    def _every(self) -> tuple[FractionalTerm, ...]:
        return (*self._of_side("output"), *self._of_side("input"))

    def _repeated_orders(self) -> list[UnknownOrder]:
        return [term.order for term in self._every if isinstance(term.order, UnknownOrder)]

    def _terms(self) -> Iterator[tuple[Parameter, FractionalPart]]:
        """Right side of the equation solved for the first term of the output."""
        for side, sign, first in (("output", -1.0, 2), ("input", 1.0, 1)):
            for number, term in enumerate(self._of_side(side)[first - 1 :], start=first):
                part = FractionalPart(side, term.order, term.lag, sign)
                yield Parameter(f"{side}_coefficient_{number}"), part

    def _output_filter(self, parameters: Parameters, count: int, *, rate_hz: float) -> Series:
        """Weights of the inverse filter of the output's side."""
        side = self._side("output", parameters, rate_hz)
        weights = side.weights(count)
        largest = max(abs(coefficient) for coefficient, _, _ in side.terms)
        if abs(weights[0]) <= LEAST_OWN_COEFFICIENT * largest:
            expected = "an equation that can be solved for the newest output"
            remedy = "Give the output a term without a lag, and coefficients that do not cancel."
            raise ParameterError(expected, f"a coefficient of {weights[0]:.3g} before y(k)", remedy)
        growing = side.growing_modes
        if growing:
            received = f"one with {growing} growing mode{'s' if growing > 1 else ''}"
            remedy = "Check the signs of the coefficients, and that orders are below two."
            raise ParameterError("a stable equation", received, remedy)
        return reciprocal(weights)

    def _side(self, side: str, parameters: Parameters, rate_hz: float) -> Side:
        checks.mapping("parameters", parameters, checks.NUMBERS, "numbers")
        checks.number("rate_hz", rate_hz)
        names = [parameter.name for parameter in self.parameters]
        missing = [name for name in names if not np.isfinite(parameters.get(name, np.nan))]
        if missing:
            expected = f"finite values of {', '.join(names)}"
            received = f"none of {', '.join(missing)}"
            raise ParameterError(expected, received, "Give estimate.parameters, or all of them by name.")
        if not (np.isfinite(rate_hz) and rate_hz > 0.0):
            raise ParameterError("a positive rate in Hz", f"rate_hz={rate_hz}", "Give that of the record.")
        coefficients = {**parameters, "output_coefficient_1": 1.0}
        parts = tuple(
            (float(coefficients[f"{side}_coefficient_{number}"]), order_at(term.order, parameters), term.lag)
            for number, term in enumerate(self._of_side(side), start=1)
        )
        return Side(parts, self.operator, 1.0 / rate_hz)
