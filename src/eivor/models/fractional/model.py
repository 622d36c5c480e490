"""Fractional difference equations: sum_i a_i Delta^alpha_i y = sum_j b_j Delta^beta_j u.

The first coefficient of the output is one. An equation can always be written so that its first order is
known: Delta^-alpha of both sides turns Delta^alpha y = b u into y = b Delta^-alpha u.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from eivor import checks
from eivor.errors import NonFiniteError, ParameterError, ShapeError
from eivor.models.column import Column, check_columns
from eivor.models.equation import Parameter
from eivor.models.fractional.filtered_signals import FilteredSignals
from eivor.models.fractional.operator import FractionalDifference, FractionalOperator
from eivor.models.fractional.problem import ChannelTerm, FractionalProblem, sought
from eivor.models.fractional.side import Side
from eivor.models.fractional.terms import FractionalTerm, UnknownOrder, terms_of
from eivor.shapes import Complex, Float
from eivor.signals.causal_filter import filtered, reciprocal
from eivor.signals.signals import Signals

#: Smallest sum of the coefficients of y(k), as a share of the largest, that y(k) can be solved for.
LEAST_OWN_COEFFICIENT = 1e-12
Series = Float[np.ndarray, " n"]
#: Coefficients and unknown orders by name, as `Estimate.parameters` gives them.
Parameters = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class FractionalDifferenceModel:
    """A fractional difference equation with noise on its output and its input.

    Parameters
    ----------
    output, input : tuple of float, UnknownOrder or FractionalTerm
        Terms of each side. The first of the output has the coefficient one and a known order; the others
        have the parameters ``output_coefficient_2``, ..., the input's ``input_coefficient_1``, ...
    operator : FractionalOperator
        What an order means: `FractionalDifference` of samples (default), or `FractionalDerivative` by time.
    output_channel, input_channel : str
        Channels of the record. Default: ``output`` and ``input``.

    Raises
    ------
    ParameterError
        When an order is out of range, two terms of a side and lag are of one order or might be, the first
        order of the output is unknown, or one name has two ranges.
    UsageError
        When an argument is of another type.
    """

    output: tuple[float | UnknownOrder | FractionalTerm, ...]
    input: tuple[float | UnknownOrder | FractionalTerm, ...]
    operator: FractionalOperator = field(default_factory=FractionalDifference)
    output_channel: str = "output"
    input_channel: str = "input"

    def __post_init__(self) -> None:
        for side in ("output", "input"):
            object.__setattr__(self, side, terms_of(side, getattr(self, side)))
        remedy = "Leave it out, or give FractionalDerivative()."
        checks.kind("operator", self.operator, FractionalOperator, "an operator", remedy)
        checks.text("output_channel", self.output_channel)
        checks.text("input_channel", self.input_channel)
        leading = self._outputs[0].order
        if isinstance(leading, UnknownOrder):
            raise ParameterError(
                "a known order of the first term of the output",
                f"the unknown '{leading.name}'",
                "Put a term of known order first, or take Delta^-order of both sides.",
            )
        ranges = {order.name: order for order in self._sought_twice()}
        for order in self._sought_twice():
            if order != ranges[order.name]:
                raise ParameterError(
                    f"one range of the order '{order.name}'", "two", "Use one UnknownOrder in both terms."
                )
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
        return tuple(dict.fromkeys(self._sought_twice()))

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
            One whole record that was at rest before it began, with the channels of output and input, and
            the noises of those that are not exact.
        instruments : tuple of Column
            Such as ``ev.lags("input", 0, 10)``. Lags of the input share noise with its differences of any
            order that is not whole, so that they are for compensated methods: `generalized_iv`.
        divided_by_output_at : mapping of str to float, optional
            Parameters, guessed or from a former estimate, at which both sides are divided by the output's
            side, a filter that the equation does not feel. The noise of y is then nearly white in the
            residual, instead of the larger the quicker it changes: with white noise on slow signals, a
            matter of much smaller errors. How good the guess is bears on these errors, and on nothing else.

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
        for channel in (self.output_channel, self.input_channel):
            signals.channel(channel)
        both_sides = np.ones(1)
        if divided_by_output_at is not None:
            both_sides = self._solved_for_output(
                divided_by_output_at, signals.sample_count, rate_hz=signals.rate_hz
            )
        every = (*self._outputs, *self._inputs)
        known = frozenset(float(term.order) for term in every if not isinstance(term.order, UnknownOrder))
        return FractionalProblem(
            FilteredSignals(signals, self.operator, known, both_sides),
            ChannelTerm(self.output_channel, self._outputs[0]),
            tuple(self._terms()),
            instruments,
            tuple(sought(order) for order in self.unknown_orders),
        )

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
        checks.whole("count", count)
        if count < 1:
            raise ParameterError("one sample or more", f"{count}", "Give the length of the response.")
        inverse = self._solved_for_output(parameters, count, rate_hz=rate_hz)
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
            raise ParameterError(
                f"frequencies above zero and up to {0.5 * rate_hz:g} Hz, half the rate",
                f"{frequencies}",
                "Leave the others out, or give the rate of the record: rate_hz=...",
            )
        back = np.exp(-2j * np.pi * frequencies / rate_hz)
        return np.asarray(over.response(back) / under.response(back))

    @property
    def _outputs(self) -> tuple[FractionalTerm, ...]:
        return terms_of("output", self.output)

    @property
    def _inputs(self) -> tuple[FractionalTerm, ...]:
        return terms_of("input", self.input)

    def _sought_twice(self) -> list[UnknownOrder]:
        """Unknown orders, as often as they are named."""
        every = (*self._outputs, *self._inputs)
        return [term.order for term in every if isinstance(term.order, UnknownOrder)]

    def _terms(self) -> Iterator[tuple[Parameter, ChannelTerm]]:
        """Right side of the equation solved for the first term of the output."""
        for number, term in enumerate(self._outputs[1:], start=2):
            yield Parameter(f"output_coefficient_{number}"), ChannelTerm(self.output_channel, term, -1.0)
        for number, term in enumerate(self._inputs, start=1):
            yield Parameter(f"input_coefficient_{number}"), ChannelTerm(self.input_channel, term)

    def _solved_for_output(self, parameters: Parameters, count: int, *, rate_hz: float) -> Series:
        """Weights of the filter that undoes the output's side.

        Raises
        ------
        ParameterError
            See `impulse_response`.
        """
        left = self._side("output", parameters, rate_hz)
        own = left.weights(count)
        if abs(own[0]) <= LEAST_OWN_COEFFICIENT * max(abs(coefficient) for coefficient, _, _ in left.terms):
            raise ParameterError(
                "an equation that can be solved for the newest output",
                f"a coefficient of {own[0]:.3g} before y(k)",
                "Give the output a term without a lag, and coefficients that do not cancel.",
            )
        growing = left.growing_modes
        if growing:
            raise ParameterError(
                "a stable equation",
                f"one with {growing} growing mode{'s' if growing > 1 else ''}",
                "Check the signs of the coefficients, and that orders are below two.",
            )
        return reciprocal(own)

    def _side(self, side: str, parameters: Parameters, rate_hz: float) -> Side:
        """One side of the equation at some values of its parameters.

        Raises
        ------
        ParameterError
            When one is missing or not finite, or the rate is not positive.
        """
        checks.mapping("parameters", parameters, checks.NUMBERS, "numbers")
        checks.number("rate_hz", rate_hz)
        missing = [one.name for one in self.parameters if not np.isfinite(parameters.get(one.name, np.nan))]
        if missing:
            raise ParameterError(
                f"finite values of {', '.join(one.name for one in self.parameters)}",
                f"none of {', '.join(missing)}",
                "Give estimate.parameters, or all of them by name.",
            )
        if not (np.isfinite(rate_hz) and rate_hz > 0.0):
            raise ParameterError("a positive rate in Hz", f"rate_hz={rate_hz}", "Give that of the record.")
        terms = self._outputs if side == "output" else self._inputs
        coefficients = [
            float(parameters[f"{side}_coefficient_{number}"]) if side == "input" or number > 1 else 1.0
            for number in range(1, len(terms) + 1)
        ]
        return Side(
            tuple(
                (coefficient, term.order_at(parameters), term.lag)
                for coefficient, term in zip(coefficients, terms, strict=True)
            ),
            self.operator,
            1.0 / rate_hz,
        )
