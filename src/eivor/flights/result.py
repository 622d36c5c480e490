"""The result of a flight's identification."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from eivor import checks
from eivor.errors import EstimationError
from eivor.estimation.diagnose import Diagnostics, diagnose
from eivor.estimation.estimate import Estimate
from eivor.estimation.methods import by_name
from eivor.estimation.pool import Pooled
from eivor.estimation.profile_sets import ParameterSets, ProfileSets
from eivor.flights import quantity
from eivor.flights.lag_prior import LAG_SUMS, LagPrior
from eivor.flights.motion import FIT, Motion, MultiStepPrediction
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight, SensorAgreement
from eivor.flights.quantity import NAN, Quantity
from eivor.flights.verdict import MotionChecks
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.diagnostics import residuals
from eivor.inference.diagnostics.excitation import Periodicity, Swing, blocks_of, strongest_swings
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE, Endogeneity, OverIdentification
from eivor.inference.distributions import t_ratio
from eivor.inference.verdict import Reason, Status, Verdict, verdict
from eivor.models.separable import SeparableProblem
from eivor.models.spectral import BinRows
from eivor.signals.recording import Finding
from eivor.tools import Float

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.figure import Figure


#: Group of the entry points under which `eivor.report.outputs` registers what it makes of results.
OUTPUTS = "eivor.outputs"


@cache
def _outputs() -> Any:
    from importlib.metadata import entry_points  # takes long to import

    (registered,) = entry_points(group=OUTPUTS, name="flight")
    return registered.load()


# -- Diagnostics --

#: Share of a flight with a saturated actuator that deserves a finding.
SATURATED_SHARE = 0.01
#: Blocks of time of the residual that is looked at for swings.
SWING_BLOCKS = 128
#: Least number of runs for leaving out single ones; fewer are cut into tenths.
FEWEST_RUNS = 3


def flight_diagnostics(prepared: tuple[PreparedFlight, ...]) -> dict[str, float]:
    """Figures of what was logged and used."""
    used = [flight for flight in prepared if flight.runs]
    results = {
        "flights": float(len(used)),
        "runs": float(sum(len(flight.runs) for flight in used)),
        "airborne_s": sum(float(f.active.mask.sum()) * f.signals.step_s for f in prepared),
        "used_s": sum(flight.used_s for flight in prepared),
        **{f"{role}_rate_hz": min(f.rates_hz[role] for f in prepared) for role in prepared[0].rates_hz},
    }
    if used:
        inputs = np.concatenate([flight.used_input.mean(axis=1) for flight in used])
        mean = float(inputs.mean())
        results |= {"mean_input": mean, "input_variation": float(inputs.std() / abs(mean)) if mean else 0.0}
    return results


@dataclass(frozen=True)
class FitDiagnostics:
    """Diagnostics of a flight's estimate: what reports, documents and verdicts read alike."""

    first_stage: Mapping[str, float]  # Conditional first-stage F of each joint parameter
    rank: int
    agreement: OverIdentification | None
    endogeneity: Endogeneity | None
    constancy: residuals.Constancy | None
    periodicity: Periodicity | None
    leverage: residuals.SegmentLeverage | None
    memory: residuals.ResidualMemory | None
    #: Memory of each axis' residual, where there are several
    memory_by_axis: Mapping[str, residuals.ResidualMemory]
    durbin_watson: float
    r_squared: float


def fit_diagnostics(traces: tuple[quantity.Trace, ...], estimate: Estimate) -> FitDiagnostics:
    """Diagnostics of an estimate and of its residual in time, of several axes one after the other."""
    record = diagnose(estimate)
    measured = np.concatenate([trace.measured for trace in traces])
    residual = measured - np.concatenate([trace.predicted for trace in traces])
    centred = np.concatenate([trace.measured - trace.measured.mean() for trace in traces])
    power, residual_power = float(centred @ centred), float(residual @ residual)
    multiple = traces if len(traces) > 1 else ()
    by_axis = {trace.axis: residuals.residual_memory(trace.measured - trace.predicted) for trace in multiple}
    return FitDiagnostics(
        first_stage=dict(zip(estimate.names, map(float, estimate.first_stage), strict=True)),
        rank=estimate.rank,
        agreement=record.over_identification,
        endogeneity=record.endogeneity,
        constancy=record.constancy,
        periodicity=record.periodicity_with(left_over_swings(record, traces)),
        leverage=run_leverage(record),
        memory=residuals.residual_memory(residual),
        memory_by_axis={axis: memory for axis, memory in by_axis.items() if memory is not None},
        durbin_watson=float(np.sum(np.diff(residual) ** 2)) / residual_power if residual_power > 0.0 else 2.0,
        r_squared=1.0 - residual_power / power if power > 0.0 else NAN,
    )


def fit_numbers(checks: FitDiagnostics, estimate: Estimate, headline: tuple[str, ...]) -> dict[str, float]:
    """Diagnostics as numbers by name; `headline` names the parameters with detailed ones."""
    index = {name: estimate.names.index(name) for name in headline if name in estimate.names}
    agreement, memory, against = checks.agreement, checks.memory, checks.endogeneity
    by_axis = checks.memory_by_axis
    constant, swinging, leverage = checks.constancy, checks.periodicity, checks.leverage
    swings = {} if swinging is None else dict(zip(estimate.names, swinging.parameters, strict=False))
    left_over = () if swinging is None else swinging.left_over
    last = min(left_over, key=lambda item: item.p_value, default=None)
    numbers = {
        **{f"first_stage_F_{name}": F for name, F in checks.first_stage.items()},
        "over_identification_J": 0.0 if agreement is None else agreement.J,
        "over_identification_p_value": 1.0 if agreement is None else agreement.p_value,
        "instrument_rank": float(checks.rank),
        "residual_variance": estimate.equation.variance,
        "condition": estimate.condition,
        "durbin_watson": checks.durbin_watson,
        "r_squared": checks.r_squared,
        "residual_memory": NAN if memory is None else memory.memory,
        "residual_memory_std_error": NAN if memory is None else memory.order_error,
        **{f"residual_memory_{axis.replace(' ', '_')}": each.memory for axis, each in by_axis.items()},
    }
    for name, position in index.items():
        shift = NAN if against is None else against.difference[position]
        numbers[f"least_squares_{name}"] = float(estimate.parameters[name] - shift)
    numbers["least_squares_p_value"] = NAN if against is None else against.p_value
    numbers["constancy_p_value"] = NAN if constant is None else constant.p_value
    numbers["constancy_break"] = NAN if constant is None else constant.break_at
    for name, position in index.items():
        numbers[f"constancy_change_{name}"] = NAN if constant is None else float(constant.change[position])
    numbers["periodicity_p_value"] = NAN if swinging is None else swinging.p_value
    for name, swing in (*((name, swings.get(name)) for name in estimate.names), ("residual", last)):
        for part in ("p_value", "period", "amplitude"):
            unit = "_s" if part == "period" else ""
            numbers[f"periodicity_{name}_{part}{unit}"] = NAN if swing is None else getattr(swing, part)
    for name, position in index.items():
        numbers[f"leverage_{name}"] = NAN if leverage is None else float(leverage.largest[position])
    first = next(iter(index.values()), 0)
    numbers["leverage_segment"] = NAN if leverage is None else float(leverage.most[first] + 1)
    numbers["leverage_segments"] = 0.0 if leverage is None else float(leverage.shift.shape[0])
    return numbers


def left_over_swings(record: Diagnostics, traces: tuple[quantity.Trace, ...]) -> tuple[Swing, ...]:
    """Swings of the residual of each axis, before any whitening; none but of rows in frequency."""
    layout = record.estimate.rows.layout
    if not isinstance(layout, BinRows) or not record.in_one_flight:
        return ()
    swings: list[Swing] = []
    # A log without velocity, for one, determines some axes only: those have traces.
    for axis, trace in zip(sorted({run.axis for run in layout.runs}), traces, strict=True):
        runs = [run for run in layout.runs if run.axis == axis]
        masks = [np.ones(run.length) if run.counted is None else run.counted for run in runs]
        samples = [run.start + np.flatnonzero(counted) for run, counted in zip(runs, masks, strict=True)]
        residual, step_s = trace.measured - trace.predicted, runs[0].step_s
        blocks = blocks_of(residual, step_s * np.concatenate(samples), step_s, SWING_BLOCKS)
        swings += strongest_swings(blocks, ((trace.axis, trace.unit),), 1.0 / residual.size)
    return tuple(swings)


def run_leverage(record: Diagnostics) -> residuals.SegmentLeverage | None:
    """Leverage of every run of a record with three or more; else of its tenths."""
    solved, equation, layout = record.estimate, record.estimate.equation, record.estimate.rows.layout
    if not isinstance(layout, BinRows) or len(layout.runs) < FEWEST_RUNS:
        return record.leverage
    ends = tuple(pairwise(np.cumsum([0, *(2 * run.count for run in layout.runs)]).tolist()))
    tests = [(slice(*end), equation.test_functions[slice(*end)].T) for end in ends]
    scores = np.stack([functions @ equation.residual[run] for run, functions in tests])
    slopes = np.stack([functions @ solved.jacobian[run] for run, functions in tests])
    return residuals.segment_leverage(scores, slopes, record.subject.std_errors, ends)


def flight_findings(prepared: tuple[PreparedFlight, ...], words: quantity.Words) -> Iterator[Finding]:
    """Findings of every log and flight."""
    for flight in prepared:
        name = flight.recording.name
        prefix = f"{name}: " if len(prepared) > 1 else ""
        yield from (replace(finding, message=prefix + finding.message) for finding in flight.findings)
        if not flight.active.mask.any():
            yield Finding("never_takes_off", f"{name} never {words.begins} (by {flight.active.rule}).")
        elif not flight.runs:
            yield Finding("no_usable_run", f"{name} has no three seconds in usable runs of a second or more.")
        channels = flight.recording.family(flight.input.name)
        samples = sum(channel.values.size for channel in channels)
        saturated = sum(channel.quality.saturated for channel in channels)
        if samples and saturated >= SATURATED_SHARE * samples:
            limit = f"{prefix}The input stood at its limit for {saturated / samples:.1%} of its samples."
            yield Finding("saturation", limit)


class FlightRow(msgspec.Struct, frozen=True):
    """One flight's result beside that of a pool, or one method's beside the chosen one."""

    label: str  # Log or method
    verdict: Status
    quantities: Mapping[str, Quantity]  # The motion's `rows`, or all
    reasons: tuple[str, ...]


def pooled_traces(motion: Motion[Any], pool: Pooled) -> tuple[quantity.Trace, ...]:
    """Measured and predicted, each flight by its own parameters; one flight after the other."""
    made = [motion.traces(problem, pool.member(number)) for number, problem in enumerate(pool.problems)]
    return tuple(
        replace(
            traces[0],
            measured=np.concatenate([trace.measured for trace in traces]),
            predicted=np.concatenate([trace.predicted for trace in traces]),
            driven=np.concatenate([trace.driven for trace in traces]),
        )
        for traces in zip(*made, strict=True)
    )


@dataclass(frozen=True)
class Fit:
    """What was estimated, and how."""

    problem: SeparableProblem  # Of all flights that have runs; of a pool with all parameters in common
    estimate: Estimate  # Its solution; of a pool with the mean of each parameter that is not in common
    instruments: str  # Label
    checks: FitDiagnostics
    lag_prior: LagPrior | None = None  # What was known of the lag from elsewhere
    sets: Mapping[str, ParameterSets] = field(default_factory=dict)  # 95 %, of the motion's headline
    sensors: SensorAgreement | None = None  # Whether two measurements of the response agree, as logged
    #: Problem and estimate without the prior of the lag
    without_prior: tuple[SeparableProblem, Estimate] | None = None
    pooled: Pooled | None = None  # Behind a pool some of whose parameters belong to the flight
    #: 95 % profile sets of such a pool, or of a flight of it: intervals of what instruments identify well
    profiles: Mapping[str, ConfidenceSet] = field(default_factory=dict)
    motion_checks: MotionChecks = field(default_factory=MotionChecks)

    def traces(self, motion: Motion[Any]) -> tuple[quantity.Trace, ...]:
        """Measured and predicted, each flight of a pool by its own parameters."""
        pool = self.pooled
        return motion.traces(self.problem, self.estimate) if pool is None else pooled_traces(motion, pool)

    @property
    def robust_sets(self) -> dict[str, ConfidenceSet]:
        """Sets of parameters that are judged by them: instruments are weak, or the sets have no bounds."""
        stages = self.checks.first_stage.items()
        return {
            name: item.robust
            for name, item in self.sets.items()
            if any(not F >= STRONG_FIRST_STAGE for stage, F in stages if stage not in item.strange)
            or not item.profile.is_bounded
        }

    @property
    def by_sets(self) -> dict[str, ConfidenceSet]:
        """Sets whose hull is an interval, which of all others is the estimate plus and minus."""
        return {**self.profiles, **self.robust_sets}

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a parameter: the hull of its set where it is judged by one."""
        result, pooled, sums = self.by_sets.get(name), self.pooled, LAG_SUMS.get(name)
        if result is not None and level != 0.95:
            alone = ProfileSets(self.problem, self.estimate)
            if sums is not None:
                sets = alone.of_nuisances(sums, level) if pooled is None else pooled.lag_set(sums, level)
            else:
                sets = (alone.of_parameter if pooled is None else pooled.common_sets)(name, level)
            if isinstance(sets, ParameterSets):
                sets = sets.robust if name in self.robust_sets else sets.profile
            result = sets
        return self.estimate.interval(name, level) if result is None else result.hull

    def reaching(
        self, name: str, item: quantity.QuantityEstimate, level: float = 0.95
    ) -> tuple[float, float]:
        """Interval of a quantity as it is derived at a level; of a set with the errors of a fitted curve."""
        low, high = self.interval(name, level)
        if name in self.estimate.names:
            alone = 0.5 * float(np.diff(self.estimate.interval(name, level))[0])
            more = math.sqrt(max(item.half_width**2 - alone**2, 0.0))

            def moved(end: float, sign: float) -> float:
                size = abs(end - item.value)
                return end + sign * (math.hypot(size, more) - size) if math.isfinite(size) else end

            low, high = moved(low, -1.0), moved(high, 1.0)
        return low, high


TABLE_HEAD = ("quantity", "value", "95 % interval", "unit", "verdict")


@dataclass(frozen=True)
class FlightEstimate:
    """Quantities of a motion from one flight or from a pool."""

    motion: Motion[Any]  # What was identified
    options: FlightOptions  # What was requested
    prepared: tuple[PreparedFlight, ...]  # The flights
    fit: Fit | None  # None when nothing could be estimated
    verdict: Verdict  # The overall one, on the motion's headline
    #: Every quantity of the motion; without a fit NaN and refused, but for what is known all the same
    quantities: Mapping[str, Quantity]
    diagnostics: Mapping[str, float]  # See docs/diagnostics.md
    findings: tuple[Finding, ...]  # Named diagnostics of logs and flights
    flights: tuple[FlightRow, ...] = ()  # Each flight of a pool, as it is alone
    #: Each flight of a pool some of whose parameters belong to the flight: what the pool says of it
    by_flight: tuple[FlightRow, ...] = ()
    comparisons: tuple[FlightRow, ...] = ()  # Each method, when asked for

    @property
    def estimate(self) -> Estimate | None:
        """The estimate; None when nothing could be estimated."""
        return None if self.fit is None else self.fit.estimate

    @cached_property
    def implications(self) -> quantity.Implications:
        """What follows from the estimate and from what was supplied; nothing from one that is refused."""
        if self.fit is None or self.verdict.status is Status.REFUSED:
            return quantity.Implications()
        made = self.motion.abilities.implications(self.fit.estimate, self.quantities)
        return replace(made, numbers=tuple(map(self._judged, made.numbers)))

    def _judged(self, number: quantity.Implied) -> quantity.Implied:
        """A number that follows, with a verdict no better than those of the quantities that it rests on."""
        behind = [self.quantities[name].verdict for name in number.needs if name in self.quantities]
        reasons = [Reason(item, "") for item in (number.verdict, *behind)]
        return replace(number, verdict=verdict(reasons).status)

    @cached_property
    def figures(self) -> tuple[quantity.KeyFigure, ...]:
        """Key figures of the flights, as far as their channels are logged; they decide nothing."""
        flying, made = self._flying, self.motion.abilities.figures
        return tuple(made(flying, self.quantities, self.diagnostics)) if flying else ()

    @cached_property
    def simple_models(self) -> Mapping[str, quantity.SimpleModel]:
        """Models of the same flights that the estimate is held against, by name; none without an estimate."""
        simple_models, fit = self.motion.abilities.prediction.simple_models, self.fit
        return {} if fit is None else simple_models(fit.problem, fit.estimate)

    @cached_property
    def multi_step_prediction(self) -> MultiStepPrediction | None:
        """Predictions of the flights themselves some tenths of a second ahead; None where there are none."""
        multi_step = self.motion.abilities.prediction.multi_step
        if self.fit is None or multi_step is None:
            return None
        estimate = self.fit.estimate
        fitted = quantity.SimpleModel("the fit", {**estimate.nuisances, **estimate.parameters})
        models = {FIT: fitted, **self.simple_models}
        refused = (name for name, item in self.quantities.items() if item.verdict is Status.REFUSED)
        return multi_step(self._flying, models, frozenset(refused))

    @property
    def _flying(self) -> tuple[PreparedFlight, ...]:
        return tuple(flight.shortened for flight in self.prepared if flight.runs)

    @property
    def instruments(self) -> str:
        """Label of the instruments used."""
        return "none" if self.fit is None else self.fit.instruments

    @property
    def method(self) -> str:
        """Name of the method used."""
        return by_name(self.options.method).name if self.fit is None else self.fit.estimate.method

    @property
    def parameters(self) -> dict[str, float]:
        """Value of every quantity."""
        return {name: item.value for name, item in self.quantities.items()}

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
        return None if len(self.prepared) != 1 or not self.prepared[0].runs else self.prepared[0].span_s

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a quantity.

        Raises
        ------
        UsageError
            For an unknown name, or a level that is none.
        EstimationError
            When nothing was estimated.

        Notes
        -----
        Of a derived quantity, another level than 0.95 has Student's t of the degrees of freedom of that one.
        """
        fit = self._fitted()
        checks.level(level)
        checks.index_of("a quantity", name, self.quantities)
        item, spec = self.quantities[name], self.motion.quantities[name]
        if level == 0.95:
            return item.interval
        if spec.reciprocal_of:
            low, high = self.interval(spec.reciprocal_of, level)
            return (1.0 / high, 1.0 / low) if low > 0.0 or high < 0.0 else quantity.NO_INTERVAL
        derived = self.motion.derive(fit.problem, fit.estimate)[name]
        times = t_ratio(level, derived.half_width / derived.std_error if derived.std_error else NAN)
        low, high = (derived.value + times * (end - derived.value) for end in derived.interval)
        if name in fit.estimate.names or name in fit.by_sets:
            low, high = fit.reaching(name, replace(derived, interval=(low, high)), level)
        return spec.possible(item.widened((low, high)))

    def summary(self) -> str:
        """Verdict, numbers and reasons as plain text."""
        title, rows = self._table
        lines = ["{:<18}{:>12}{:>26}  {:<8}{}".format(*row) for row in (TABLE_HEAD, *rows)]
        return "\n".join([title, *lines, *(f"- {sentence}" for sentence in self.verdict.sentences)])

    def __repr__(self) -> str:
        names = ", ".join(flight.recording.name for flight in self.prepared)
        headline = self.motion.quantities.headline if self.fit is not None else ()
        text = "; ".join(" ".join(row[:3]) for row in self._table[1] if row[0] in headline)
        return f"<FlightEstimate {self.motion.name} of {names!r}: {self.verdict.status.value}; {text}>"

    def _repr_html_(self) -> str:
        return _outputs().card((self,))

    @property
    def _table(self) -> tuple[str, list[tuple[str, ...]]]:
        rows: list[tuple[str, ...]] = []
        for name, item in self.quantities.items():
            bounds = "[{:.4g}, {:.4g}]".format(*item.interval)
            rows.append((name, f"{item.value:.4g}", bounds, item.unit, item.verdict.value))
        return f"{self.motion.words.title}, {self.method}: {self.verdict.status.value}", rows

    def to_frame(self) -> pl.DataFrame:
        """Table of the quantities.

        Returns
        -------
        polars.DataFrame
            Columns `quantity`, `value`, `unit`, `std_error`, `low`, `high` (95 %) and `verdict`; null where
            there is no number, or no bound.
        """
        import polars as pl

        names = ("quantity", "value", "unit", "std_error", "low", "high", "verdict")
        rows = [
            (name, item.value, item.unit, item.std_error, *item.interval, item.verdict.value)
            for name, item in self.quantities.items()
        ]
        frame = pl.DataFrame(rows, names, orient="row")
        floats = pl.col("value", "std_error", "low", "high")
        return frame.with_columns(pl.when(floats.is_finite()).then(floats).name.keep())

    def to_json(self) -> str:
        """Text of the JSON document of this motion, see docs/json.md."""
        return _outputs().json(self)

    def sample(self, n: int, seed: int = 0) -> dict[str, Float[np.ndarray, " n"]]:
        """Draw joint sets of the parameters, see `eivor.SavedFit.sample`."""
        return _outputs().saved(self).sample(n, seed)

    def to_statespace(self, speed_m_s: float = 0.0) -> Any:
        """Arrays of the motion about hover or flight along x, see `eivor.SavedFit.to_statespace`."""
        return _outputs().saved(self).to_statespace(speed_m_s)

    def export(self, to: str, **choices: Any) -> str | bytes:
        """Content of a file for an autopilot, a controller or a simulator, see `eivor.SavedFit.export`."""
        return _outputs().saved(self).export(to, **choices)

    def plot(self) -> Figure:
        """Figure of the fit: response, residual, its autocorrelation, profiles, excitation.

        Returns
        -------
        matplotlib.figure.Figure
            See `eivor.report.flight_figures.flight_figure` for its panels.

        Raises
        ------
        EstimationError
            When nothing was estimated.
        """
        self._fitted()
        return _outputs().figure(self)

    def _fitted(self) -> Fit:
        if self.fit is None:
            received = f"one without: {' '.join(self.verdict.sentences).removesuffix('.')}"
            raise EstimationError("a flight with an estimate", received, "See its verdict.")
        return self.fit


@dataclass(frozen=True)
class LogEstimate:
    """Every motion that a flight, or a pool of flights, supports, each with its result."""

    motions: Mapping[str, FlightEstimate]  # By name: vertical, rates, rigid-body, then others; at least one
    left_out: Mapping[str, str] = field(default_factory=dict)  # Why the log does not support the others

    @property
    def first(self) -> FlightEstimate:
        """Result of the first motion."""
        return next(iter(self.motions.values()))

    @property
    def drawn(self) -> FlightEstimate:
        """Result of the first motion with an estimate, else of the first."""
        return next((result for result in self.motions.values() if result.fit is not None), self.first)

    @property
    def identified(self) -> tuple[str, ...]:
        """Names of the deciding quantities that are identified."""
        return self._of(Status.IDENTIFIED)

    @property
    def weak(self) -> tuple[str, ...]:
        """Names of those that are known roughly: weak or provisional."""
        return self._of(Status.WEAK, Status.PROVISIONAL)

    @property
    def refused(self) -> tuple[str, ...]:
        """Names of those that are refused."""
        return self._of(Status.REFUSED)

    @cached_property
    def deciding(self) -> dict[str, Quantity]:
        """Quantities of a need and of headlines, by name; by motion.name where several motions have it."""
        every = [
            (model, name, item)
            for model, result in self.motions.items()
            for name, item in result.quantities.items()
            if result.motion.quantities[name].need or result.motion.quantities[name].headline
        ]
        count = Counter(name for _, name, _ in every)
        return {name if count[name] == 1 else f"{model}.{name}": item for model, name, item in every}

    @property
    def status(self) -> Status:
        """The best that is known of a deciding quantity."""
        rough = Status.WEAK if self.weak else Status.REFUSED
        return Status.IDENTIFIED if self.identified else rough

    def meets(self, needs: Iterable[str] = ()) -> bool:
        """Whether all that is needed is identified; without needs, whether any `deciding` quantity is.

        Parameters
        ----------
        needs : iterable of str
            Words out of "hover", "lag", "gain", "friction" and "torque" (of roll and pitch), or names of
            quantities ("vertical.effective_lag" of one motion). A word is met by a motion that identifies
            every quantity that it has for it.
        """
        wanted = tuple(needs)
        return all(map(self._meets, wanted)) if wanted else bool(self.identified)

    def _meets(self, need: str) -> bool:
        for model, result in self.motions.items():
            specs, known = result.motion.quantities, result.quantities.items()
            of_need = [q for name, q in known if need in (name, f"{model}.{name}", specs[name].need)]
            if of_need and all(item.verdict is Status.IDENTIFIED for item in of_need):
                return True
        return False

    def _of(self, *statuses: Status) -> tuple[str, ...]:
        return tuple(name for name, item in self.deciding.items() if item.verdict in statuses)

    def summary(self) -> str:
        """Summaries of the motions, one below the other, and why others are left out."""
        omitted = (f"{name} is left out: {why}" for name, why in self.left_out.items())
        return "\n\n".join([*(result.summary() for result in self.motions.values()), *omitted])

    def __repr__(self) -> str:
        names = ", ".join(flight.recording.name for flight in self.first.prepared)
        return f"<LogEstimate {', '.join(self.motions)} of {names!r}: {', '.join(self.identified) or 'none'}>"

    def _repr_html_(self) -> str:
        return _outputs().card(tuple(self.motions.values()))

    def to_json(self) -> str:
        """Text of the JSON document that ``eivor identify --json`` writes, see docs/json.md."""
        return _outputs().json(self)

    def plot(self, model: str = "") -> Figure:
        """Figure of the fit of a motion, by default of the first that has one: `FlightEstimate.plot`."""
        if model:
            checks.index_of("a motion", model, self.motions)
        return (self.motions[model] if model else self.drawn).plot()
