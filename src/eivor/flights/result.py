"""What `identify_flight` returns: numbers with intervals and verdicts, and everything behind them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from eivor.errors import EstimationError, UsageError
from eivor.estimation.estimate import Estimate
from eivor.estimation.parameter_sets import ParameterSets, parameter_sets
from eivor.flights.agreement import SensorAgreement
from eivor.flights.ahead import FIT, Ahead
from eivor.flights.diagnostics import FitDiagnostics
from eivor.flights.given_lag import GivenLag
from eivor.flights.implied import Implications
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.predicted import SimpleModel
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Quantity
from eivor.flights.shown import Trace, joined
from eivor.inference.diagnostics.strength import STRONG_FIRST_STAGE
from eivor.inference.sets.confidence_set import ConfidenceSet
from eivor.inference.verdict import Status, Verdict
from eivor.models.separable import SeparableProblem
from eivor.notebook import html_table
from eivor.shapes import Float
from eivor.signals.recording import Finding

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from eivor.estimation.pools.pooled import Pooled
    from eivor.exports.state_space import StateSpace


@dataclass(frozen=True, slots=True)
class FlightRow:
    """One flight's result beside that of a pool, or one method's beside the chosen one.

    Parameters
    ----------
    label : str
        Log or method.
    verdict : Status
        Overall verdict.
    quantities : mapping of str to Quantity
        The motion's `rows`, or all; empty when nothing was estimated.
    reasons : tuple of str
        Sentences.
    """

    label: str
    verdict: Status
    quantities: Mapping[str, Quantity]
    reasons: tuple[str, ...]


def pooled_traces(motion: Motion[Any], pool: Pooled) -> tuple[Trace, ...]:
    """Measured and predicted, each flight by its own parameters; one flight after the other."""
    made = [motion.traces(problem, pool.member(number)) for number, problem in enumerate(pool.problems)]
    return tuple(joined(traces) for traces in zip(*made, strict=True))


@dataclass(frozen=True)
class Unaided:
    """What flights tell by themselves, without what was given beside them.

    Parameters
    ----------
    problem : SeparableProblem
        Of all flights that have runs.
    estimate : Estimate
        Its solution.
    """

    problem: SeparableProblem
    estimate: Estimate


@dataclass(frozen=True)
class Fit:
    """What was estimated, and how.

    Parameters
    ----------
    problem : SeparableProblem
        Of all flights that have runs.
    estimate : Estimate
        Its solution.
    instruments : str
        Label of the instruments used.
    checks : FitDiagnostics
        What was checked of it.
    given_lag : GivenLag or None
        What was known of the lag from elsewhere, beside what the flight alone says.
    sets : mapping of str to ParameterSets
        95 % sets of the motion's headline parameters, where the method has them.
    sensors : SensorAgreement or None
        Whether two measurements of the response agree, as logged; None where there is but one.
    unaided : Unaided or None
        The same without what was known of the lag.
    pooled : Pooled or None
        Behind a pool some of whose parameters belong to the flight: there `problem` has all parameters in
        common, and `estimate` the mean of each that is not.
    profiles : mapping of str to ConfidenceSet
        95 % profile sets of such a pool, or of a flight of it: intervals of what instruments tell well.
    """

    problem: SeparableProblem
    estimate: Estimate
    instruments: str
    checks: FitDiagnostics
    given_lag: GivenLag | None = None
    sets: Mapping[str, ParameterSets] = field(default_factory=dict)
    sensors: SensorAgreement | None = None
    unaided: Unaided | None = None
    pooled: Pooled | None = None
    profiles: Mapping[str, ConfidenceSet] = field(default_factory=dict)

    @property
    def by_itself(self) -> Unaided:
        """What the flights tell without what was given beside them."""
        return Unaided(self.problem, self.estimate) if self.unaided is None else self.unaided

    def traces(self, motion: Motion[Any]) -> tuple[Trace, ...]:
        """Measured and predicted, each flight of a pool by its own parameters."""
        if self.pooled is None:
            return motion.traces(self.problem, self.estimate)
        return pooled_traces(motion, self.pooled)

    def _weak(self, sets: ParameterSets) -> bool:
        """Whether a conditional first-stage F of what is in a parameter's equations is below ten."""
        stages = self.checks.first_stage.items()
        return any(not F >= STRONG_FIRST_STAGE for name, F in stages if name not in sets.strange)

    @property
    def robust_sets(self) -> dict[str, ConfidenceSet]:
        """Sets of the parameters that are judged by them: instruments are weak, or the sets have no bounds.

        F is of one place, the estimate; where a set has no bounds, others fit as well.
        """
        judged = {
            name: own for name, own in self.sets.items() if self._weak(own) or not own.profile.is_bounded
        }
        return {name: own.robust for name, own in judged.items()}

    @property
    def by_sets(self) -> dict[str, ConfidenceSet]:
        """Sets whose hull is an interval, which of all others is the estimate plus and minus."""
        return {**self.profiles, **self.robust_sets}

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a parameter: the hull of its set where it is judged by one."""
        found = self.by_sets.get(name)
        if found is not None and level != 0.95:
            found = self._set(name, level)
        return self.estimate.interval(name, level) if found is None else found.hull

    def _set(self, name: str, level: float) -> ConfidenceSet | None:
        """The set that a parameter is judged by, of another level."""
        pooled = self.pooled
        if pooled is None:
            sets = parameter_sets(self.problem, self.estimate, name, level)
        else:
            if name in pooled.nuisance_names:
                return pooled.lag_set((name,), level)
            sets = pooled.whole_sets(name, level)
        if sets is None:
            return None
        return sets.robust if name in self.robust_sets else sets.profile


@dataclass(frozen=True)
class FlightEstimate:
    """Quantities of a motion from one flight or from a pool.

    Parameters
    ----------
    motion : Motion
        What was identified.
    options : FlightOptions
        What was asked for.
    prepared : tuple of PreparedFlight
        The flights.
    fit : Fit or None
        None when nothing could be estimated.
    verdict : Verdict
        The overall one, on the motion's headline.
    quantities : mapping of str to Quantity
        Every quantity of the motion; without a fit they are NaN and refused, but for what is known all the
        same.
    diagnostics : mapping of str to float
        Documented in docs/diagnostics.md.
    findings : tuple of Finding
        Named diagnostics of logs and flights.
    flights : tuple of FlightRow
        One for each flight of a pool, as it is alone.
    by_flight : tuple of FlightRow
        One for each flight of a pool some of whose parameters belong to the flight: what the pool says of
        it, every quantity.
    comparisons : tuple of FlightRow
        One for each method, when asked for.
    """

    motion: Motion[Any]
    options: FlightOptions
    prepared: tuple[PreparedFlight, ...]
    fit: Fit | None
    verdict: Verdict
    quantities: Mapping[str, Quantity]
    diagnostics: Mapping[str, float]
    findings: tuple[Finding, ...]
    flights: tuple[FlightRow, ...] = ()
    by_flight: tuple[FlightRow, ...] = ()
    comparisons: tuple[FlightRow, ...] = ()

    @property
    def estimate(self) -> Estimate | None:
        """The estimate; None when nothing could be estimated."""
        return None if self.fit is None else self.fit.estimate

    @cached_property
    def implications(self) -> Implications:
        """What follows from the estimate and from what was supplied; nothing from one that is refused."""
        if self.fit is None or self.verdict.status is Status.REFUSED:
            return Implications()
        return self.motion.implications(self.fit.estimate)

    @cached_property
    def simple_models(self) -> Mapping[str, SimpleModel]:
        """Models of the same flights that the estimate is held against, by name; none without an estimate."""
        return {} if self.fit is None else self.motion.simple_models(self.fit.problem, self.fit.estimate)

    @cached_property
    def ahead(self) -> Ahead | None:
        """Predictions of the flights themselves some tenths of a second ahead; None where there are none."""
        if self.fit is None:
            return None
        estimate = self.fit.estimate
        names = dict(zip(estimate.names, estimate.best.values.tolist(), strict=True))
        models = {FIT: SimpleModel("the fit", {**estimate.best.at, **names}), **self.simple_models}
        refused = (name for name, one in self.quantities.items() if one.verdict is Status.REFUSED)
        flying = tuple(flight.shortened for flight in self.prepared if flight.runs)
        return self.motion.ahead(flying, models, frozenset(refused))

    @property
    def instruments(self) -> str:
        """Label of the instruments used."""
        return "none" if self.fit is None else self.fit.instruments

    @property
    def method(self) -> str:
        """Name of the method used."""
        return self.options.method if self.fit is None else self.fit.estimate.method

    @property
    def parameters(self) -> dict[str, float]:
        """Value of every quantity."""
        return {name: quantity.value for name, quantity in self.quantities.items()}

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joint vector, in the order of `covariance`."""
        return self._fitted().estimate.names

    @property
    def covariance(self) -> Float[np.ndarray, "n n"]:
        """Covariance of the joint vector at the best delay."""
        return self._fitted().estimate.covariance

    @property
    def window_s(self) -> tuple[float, float] | None:
        """First and last second used [s]; None when there is none, or several logs are pooled."""
        if len(self.prepared) != 1 or not self.prepared[0].runs:
            return None
        return self.prepared[0].span_s

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a quantity.

        Raises
        ------
        UsageError
            For an unknown name, or another level than 0.95 for a derived quantity.
        EstimationError
            When nothing was estimated.
        """
        fit = self._fitted()
        if name in fit.estimate.names:
            quantity = self.quantities[name]
            return self.motion.wording[name].possible(quantity.widened(fit.interval(name, level)))
        if name not in self.quantities or level != 0.95:
            raise UsageError(
                f"a quantity out of {', '.join(self.quantities)} (derived ones at level 0.95)",
                f"'{name}' at level {level}",
                "Other levels are at hand for the joint vector: fit.names.",
            )
        return self.quantities[name].interval

    def summary(self) -> str:
        """Verdict, numbers and reasons as plain text."""
        lines = [f"{self.motion.words.title}, {self.method}: {self.verdict.status.value}"]
        lines.append(f"{'quantity':<18}{'value':>12}{'95 % interval':>26}  {'unit':<8}verdict")
        for name, quantity in self.quantities.items():
            lines.append(
                f"{name:<18}{quantity.value:>12.4g}{_bounds(quantity):>26}  "
                f"{quantity.unit:<8}{quantity.verdict.value}"
            )
        lines.extend(f"- {sentence}" for sentence in self.verdict.sentences)
        return "\n".join(lines)

    def __repr__(self) -> str:
        names = ", ".join(flight.recording.name for flight in self.prepared)
        told = "; ".join(
            f"{name} {quantity.value:.4g} {_bounds(quantity)}"
            for name, quantity in self.quantities.items()
            if name in self.motion.headline and self.fit is not None
        )
        return f"<FlightEstimate {self.motion.name} of {names!r}: {self.verdict.status.value}; {told}>"

    def _repr_html_(self) -> str:
        rows = [
            (name, f"{quantity.value:.4g}", _bounds(quantity), quantity.unit, quantity.verdict.value)
            for name, quantity in self.quantities.items()
        ]
        return html_table(
            f"{self.motion.words.title}, {self.method}: {self.verdict.status.value}",
            ("quantity", "value", "95 % interval", "unit", "verdict"),
            rows,
            " ".join(self.verdict.sentences),
        )

    def to_frame(self) -> pl.DataFrame:
        """Table of the quantities.

        Returns
        -------
        polars.DataFrame
            Columns `quantity`, `value`, `unit`, `std_error`, `low`, `high` (95 %) and `verdict`; null where
            there is no number, or no bound.
        """
        import polars as pl

        columns: dict[str, list[str] | list[float]] = {
            "quantity": list(self.quantities),
            "value": [quantity.value for quantity in self.quantities.values()],
            "unit": [quantity.unit for quantity in self.quantities.values()],
            "std_error": [quantity.std_error for quantity in self.quantities.values()],
            "low": [quantity.interval[0] for quantity in self.quantities.values()],
            "high": [quantity.interval[1] for quantity in self.quantities.values()],
            "verdict": [quantity.verdict.value for quantity in self.quantities.values()],
        }
        numbers = ("value", "std_error", "low", "high")
        frame = pl.DataFrame(columns)
        return frame.with_columns(pl.when(pl.col(name).is_finite()).then(pl.col(name)) for name in numbers)

    def to_json(self) -> str:
        """Text of the JSON document that ``eivor identify --json`` writes, see docs/json.md."""
        from eivor.report.json_document import json_document, json_text

        return json_text(json_document(self))

    def sample(
        self, n: int, seed: int = 0, *, delays: Literal["best", "all"] = "best"
    ) -> dict[str, Float[np.ndarray, " n"]]:
        """Draw joint sets of the parameters, see `eivor.SavedFit.sample`."""
        from eivor.report.read_fit import saved_fit

        return saved_fit(self).sample(n, seed, delays=delays)

    def to_statespace(self) -> StateSpace:
        """Arrays of the vertical motion about hover, see `eivor.SavedFit.to_statespace`."""
        from eivor.report.read_fit import saved_fit

        return saved_fit(self).to_statespace()

    def export(
        self,
        to: str,
        *,
        mass: tuple[float, float] | None = None,
        priors: Mapping[str, tuple[float, float]] | None = None,
        vehicle: str | Path | None = None,
        draws: int | None = None,
        seed: int = 0,
    ) -> str:
        """Content of a file for an autopilot, a controller or a simulator, see `eivor.SavedFit.export`."""
        from eivor.report.read_fit import saved_fit

        return saved_fit(self).export(to, mass=mass, priors=priors, vehicle=vehicle, draws=draws, seed=seed)

    def plot(self, axes: Axes | Mapping[str, Axes] | Iterable[Axes] | None = None) -> Figure:
        """Figure of the fit: response, residual, its autocorrelation, profile of the lag, excitation.

        Parameters
        ----------
        axes : mapping of str to Axes, or sequence of Axes, optional
            Where to draw: some of "fit", "residual", "autocorrelation", "profile" and "excitation" by name,
            or all in this order. Default: a figure of its own. See `eivor.report.flight_figure` for motions
            of several axes.

        Returns
        -------
        matplotlib.figure.Figure
            The one that the panels are in.

        Raises
        ------
        EstimationError
            When nothing was estimated.
        UsageError
            When `axes` do not fit the panels.
        """
        from eivor.report.flight_figure import flight_figure

        self._fitted()
        return flight_figure(self, axes)

    def _fitted(self) -> Fit:
        if self.fit is None:
            raise EstimationError(
                "a flight with an estimate",
                f"one without: {'; '.join(self.verdict.sentences)}",
                "See its verdict.",
            )
        return self.fit


def _bounds(quantity: Quantity) -> str:
    """Interval of a quantity; of what was chosen out of a few values those that fit."""
    if quantity.choice is not None:
        return " or ".join(f"{value:.4g}" for value in quantity.choice.fitting)
    low, high = quantity.interval
    return f"[{low:.4g}, {high:.4g}]"
