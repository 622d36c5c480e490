"""What `identify_flight` returns: numbers with intervals and verdicts, and everything behind them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from eivor.errors import EstimationError, UsageError
from eivor.estimation.estimate import Estimate
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import PreparedFlight
from eivor.inference.verdict import Status, Verdict
from eivor.models.vertical_flights import VerticalFlights
from eivor.signals.recording import Finding

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class Quantity:
    """One result.

    Parameters
    ----------
    value : float
        NaN when it could not be estimated.
    unit : str
        SI unit.
    std_error : float
        At the best delay; NaN when there is none.
    interval : tuple of float
        95 %, a union over the delays that fit.
    verdict : Status
        How far it may be trusted.
    """

    value: float
    unit: str
    std_error: float
    interval: tuple[float, float]
    verdict: Status

    @property
    def half_width(self) -> float:
        """Half the interval's width."""
        return 0.5 * (self.interval[1] - self.interval[0])


@dataclass(frozen=True, slots=True)
class FlightRow:
    """One flight's own result beside a pool, or one method's beside the chosen one.

    Parameters
    ----------
    label : str
        Log or method.
    verdict : Status
        Overall verdict.
    quantities : mapping of str to Quantity
        viscous_friction, input_gain, effective_lag, hover_input; empty when nothing was estimated.
    reasons : tuple of str
        Sentences.
    """

    label: str
    verdict: Status
    quantities: Mapping[str, Quantity]
    reasons: tuple[str, ...]


@dataclass(frozen=True)
class FlightEstimate:
    """Vertical parameters of one flight or of a pool.

    Parameters
    ----------
    options : FlightOptions
        What was asked for.
    prepared : tuple of PreparedFlight
        The flights.
    problem : VerticalFlights or None
        What was estimated; None when no flight has a run.
    estimate : Estimate or None
        None when nothing could be estimated.
    instruments : str
        Label of the instruments used.
    verdict : Verdict
        On the viscous friction, which is the overall one.
    quantities : mapping of str to Quantity
        viscous_friction, input_gain, intercept, actuator_lag, delay, effective_lag, hover_input,
        time_constant.
    by_segment : ndarray, shape (runs,)
        Intercept of each run [m/s^2].
    diagnostics : mapping of str to float
        Documented in docs/diagnostics.md.
    findings : tuple of Finding
        Named diagnostics of logs and flights.
    flights : tuple of FlightRow
        One for each flight of a pool.
    comparisons : tuple of FlightRow
        One for each method, when asked for.
    """

    options: FlightOptions
    prepared: tuple[PreparedFlight, ...]
    problem: VerticalFlights | None
    estimate: Estimate | None
    instruments: str
    verdict: Verdict
    quantities: Mapping[str, Quantity]
    by_segment: Float[np.ndarray, " runs"]
    diagnostics: Mapping[str, float]
    findings: tuple[Finding, ...]
    flights: tuple[FlightRow, ...] = ()
    comparisons: tuple[FlightRow, ...] = ()

    @property
    def method(self) -> str:
        """Name of the method used."""
        return self.estimate.method if self.estimate is not None else self.options.method

    @property
    def parameters(self) -> dict[str, float]:
        """Value of every quantity."""
        return {name: quantity.value for name, quantity in self.quantities.items()}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joint vector, in the order of `covariance`."""
        return self._estimated().names

    @property
    def covariance(self) -> Float[np.ndarray, "n n"]:
        """Covariance of the joint vector at the best delay."""
        return self._estimated().covariance

    @property
    def window_s(self) -> tuple[float, float] | None:
        """First and last second used [s]; None when there is none, or several logs are pooled."""
        if len(self.prepared) != 1 or not self.prepared[0].flight.runs:
            return None
        flight = self.prepared[0].flight
        first, last = flight.runs[0].start, flight.runs[-1].stop - 1
        return (
            flight.signals.start_s + first * flight.signals.step_s,
            flight.signals.start_s + last * flight.signals.step_s,
        )

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a quantity.

        Raises
        ------
        UsageError
            For an unknown name, or another level than 0.95 for a derived quantity.
        EstimationError
            When nothing was estimated.
        """
        estimate = self._estimated()
        if name in estimate.names:
            return estimate.interval(name, level)
        if name not in self.quantities or level != 0.95:
            raise UsageError(
                f"a quantity out of {', '.join(self.quantities)} (derived ones at level 0.95)",
                f"'{name}' at level {level}",
                "Other levels are at hand for the joint vector: fit.names.",
            )
        return self.quantities[name].interval

    def summary(self) -> str:
        """Verdict, numbers and reasons as plain text."""
        lines = [f"Vertical motion, {self.method}: {self.verdict.status.value}"]
        lines.append(f"{'quantity':<18}{'value':>12}{'95 % interval':>26}  {'unit':<8}verdict")
        for name, quantity in self.quantities.items():
            low, high = quantity.interval
            lines.append(
                f"{name:<18}{quantity.value:>12.4g}{f'[{low:.4g}, {high:.4g}]':>26}  "
                f"{quantity.unit:<8}{quantity.verdict.value}"
            )
        lines.extend(f"- {sentence}" for sentence in self.verdict.sentences)
        return "\n".join(lines)

    def plot(self) -> Figure:
        """Figure of the fit: response, residual, lag profile, excitation.

        Raises
        ------
        EstimationError
            When nothing was estimated.
        """
        from eivor.report.flight_figure import flight_figure

        self._estimated()
        return flight_figure(self)

    def _estimated(self) -> Estimate:
        if self.estimate is None:
            raise EstimationError(
                "a flight with an estimate",
                f"one without: {'; '.join(self.verdict.sentences)}",
                "See its verdict.",
            )
        return self.estimate
