"""Checks and rules of declared machines: standstill, references that answer, responses that disagree."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import chain
from operator import itemgetter
from typing import Any

import numpy as np

from eivor.errors import EstimationError, InstrumentError, TooFewSamplesError
from eivor.estimation.estimate import Estimate
from eivor.estimation.methods import identify, reference_iv
from eivor.estimation.weighting import residual_spectrum
from eivor.flights import verdict
from eivor.flights.lag_prior import EFFECTIVE_LAG
from eivor.flights.motion import Flights
from eivor.flights.prepared import Difference, SensorAgreement, estimated, sensor_agreement
from eivor.flights.quantity import Counts, QuantityEstimate
from eivor.inference.distributions import chi_square_tail
from eivor.inference.verdict import Cause, Status
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, LaggedRuns
from eivor.models.regression import Parameter
from eivor.models.separable import GivenBins
from eivor.models.spectral import SpectralRegression
from eivor.motions.equation import (
    LEAST_DIFFERENCE,
    OFFSET,
    AxisEquation,
    explained,
    has_two_responses,
    parsed,
    response_difference,
)
from eivor.signals.filters import first_order_lag
from eivor.signals.signals import Signals
from eivor.tools import Complex, Float, plain

# -- Lags and activity --

LAGS = (ACTUATOR_LAG.name, DELAY.name)


def narrower(remedy: str, inputs: verdict.VerdictInputs) -> str:
    """What to do about a wide interval: a term that is missed, and lags in several parts that fit."""
    lags, missed = inputs.robust.get(ACTUATOR_LAG.name), inputs.checks.missed
    if lags is not None and len(lags.intervals) > 1:
        ends = [[plain(1e3 * end, 3) for end in part if end < math.inf] for part in lags.intervals]
        parts = ", ".join(f"{' to '.join(part)} ms{' or more' * (len(part) < 2)}" for part in ends)
        advice = "narrow lag_ms to the part that fits the machine."
        remedy = f"Lags in {len(ends)} parts fit the log ({parts}): {advice} {remedy}"
    return remedy if missed is None else f"Declare a term with {missed.of}. {remedy}"


LAG_LIMIT = verdict.Limit(
    identified_within=0.02, identified=0.1, narrower=partial(narrower, "Move it in quicker steps.")
)

#: Less than this share of a log in use is refused; of the default rule, less than that is weak.
LEAST_ACTIVE, CLEARLY_ACTIVE = 0.2, 0.7


def active_share(flights: Flights) -> float:
    """Share of the logs that counts."""
    masks = [flight.active.counted for flight in flights if flight.active.counted is not None]
    return float(np.mean(np.concatenate(masks))) if masks else 1.0


def active_rule(condition: str) -> verdict.Rule:
    """Rule for a machine that is hardly in use; without a condition movement counts."""
    rule = condition or "movement"
    return verdict.Rule(
        (),
        lambda inputs: active_share(inputs.flights) < LEAST_ACTIVE,
        Status.REFUSED,
        lambda inputs: (
            f"The machine is in use for {active_share(inputs.flights):.0%} of the log only (by {rule}); "
            f"{LEAST_ACTIVE:.0%} are needed."
        ),
        "Move it for longer, cut the log with --window, or declare another [active].",
    )


STANDSTILL = verdict.Rule(
    (),
    lambda inputs: active_share(inputs.flights) < CLEARLY_ACTIVE,
    Status.WEAK,
    lambda inputs: (
        f"Standstill is {1.0 - active_share(inputs.flights):.0%} of the log. It is known by the measured "
        "speed, which disturbances move too: what is left favours some of them."
    ),
    "Keep it moving: plan references that turn at once.",
)


def _step_s(inputs: verdict.VerdictInputs) -> float:
    return 1.0 / max(min(inputs.command_rate_hz, inputs.response_rate_hz), 1e-9)


SLOW_SAMPLES = verdict.Rule(
    (*LAGS, EFFECTIVE_LAG),
    lambda inputs: inputs.value(EFFECTIVE_LAG) < 2.0 * _step_s(inputs),
    Status.WEAK,
    lambda inputs: (
        f"Samples are {1e3 * _step_s(inputs):.3g} ms apart, more than half the lag: how the command held "
        "between them moves it."
    ),
    "Log commands and states faster.",
)


# -- References that answer --

#: Lags [s] of a reference's past and future that residuals are compared with; p-values below this answer.
ANSWER_LAGS_S, ANSWER_P_VALUE = (0.06, 0.25, 1.0, 4.0), 1e-4
#: Columns of length one whose new part is shorter add nothing.
NOTHING_NEW = 1e-2


@dataclass(frozen=True, slots=True)
class MachineChecks(verdict.MotionChecks):
    """References that respond to disturbances, responses that disagree, and a term that is missed."""

    answers: Mapping[str, float]
    #: Quantities by each alone of two responses that disagree, by how they do.
    by_response: Mapping[str, Sequence[Mapping[str, float]]] = field(default_factory=dict)
    missed: MissedTerm | None = None

    @property
    def numbers(self) -> dict[str, float]:
        p_values = {f"{name}_answers_p_value": value for name, value in self.answers.items()}
        return p_values | {"missed_term_p_value": 1.0 if self.missed is None else self.missed.p_value}

    @property
    def report(self) -> tuple[tuple[str, str], ...]:
        return () if self.missed is None else (("left out", self.missed.sentence),)

    @property
    def answering(self) -> str:
        """References that answer, by name."""
        limit = ANSWER_P_VALUE / max(len(self.answers), 1)
        return ", ".join(name for name, value in self.answers.items() if value < limit)


ANSWERING = verdict.Rule(
    (),
    lambda inputs: inputs.instruments.exogenous and bool(inputs.checks.answering),
    Status.PROVISIONAL,
    lambda inputs: (
        f"What disturbs the machine predicts its reference ({inputs.checks.answering}, p-value "
        f"{min(inputs.checks.answers.values()):.1g}): a controller computes it, and it biases the numbers."
    ),
    "Log and declare what was set beforehand, such as the goal of the outermost loop.",
    Cause.INSTRUMENT,
)


@dataclass(frozen=True)
class ResidualTest:
    """Test that further instruments predict nothing of the residual of an estimate."""

    bins: SpectralRegression
    slopes: list[Complex[np.ndarray, " bins"]]  # By the nuisances that were searched
    power: Float[np.ndarray, " bins"]
    residual: Float[np.ndarray, " rows"]

    @classmethod
    def of(cls, problem: LaggedRuns, estimate: Estimate) -> ResidualTest:
        """Rows at the estimate, with its weights."""
        values, theta = estimate.nuisances, estimate.theta
        bins = problem.bins(values)
        blend, power = residual_spectrum(bins, bins.residuals(theta))
        searched = [item for item in problem.nuisances if item.searched]
        slopes = [item.derivative(lambda x: problem.bins(x).regressors @ theta, values) for item in searched]
        whitened = bins.whitened_rows(blend, power)
        return cls(bins, slopes, power, whitened[:, 0] - whitened[:, 1:] @ theta)

    def p_value(
        self, columns: Complex[np.ndarray, "bins k"], known: Complex[np.ndarray, "bins m"] | None = None
    ) -> float:
        """P-value of columns that add nothing to the instruments, and to known ones."""
        Q = self._instruments
        if known is not None:
            Q = _column_space(np.column_stack([self._rows(known), Q]))
        gained = self._rows(columns)
        gained -= Q @ (Q.T @ gained)
        X, projection = self._projection
        gained -= projection @ (X.T @ gained)
        if np.linalg.norm(gained) < NOTHING_NEW:
            return 1.0
        directions = _column_space(gained, 1e-3)
        share = float(((directions.T @ self.residual) ** 2).sum() / (self.residual @ self.residual or 1.0))
        return chi_square_tail(self.residual.size * self.bins.layout.independent * share, directions.shape[1])

    def _rows(self, columns: Complex[np.ndarray, "bins k"]) -> Float[np.ndarray, "rows k"]:
        stacked = self.bins.layout.stacked(columns / np.sqrt(self.power)[:, None])
        return stacked / np.maximum(np.linalg.norm(stacked, axis=0), np.finfo(np.float64).tiny)

    @cached_property
    def _instruments(self) -> Float[np.ndarray, "rows p"]:
        return _column_space(self._rows(self.bins.instruments))

    @cached_property
    def _projection(self) -> tuple[Float[np.ndarray, "rows n"], Float[np.ndarray, "rows n"]]:
        """Regressors, and what the estimate has removed from the residual."""
        X, Q = self._rows(np.column_stack([self.bins.regressors, *self.slopes])), self._instruments
        return X, np.linalg.pinv(Q @ (Q.T @ X)).T


def answers(test: ResidualTest, problem: LaggedRuns, flights: Flights) -> dict[str, float]:
    """P-values of tests that the future of a reference adds nothing to its past for the residual."""
    results = {}
    for name in flights[0].usable_references:
        past, future = zip(*(_past_and_future(flight.signals, name) for flight in flights), strict=True)
        results[name] = test.p_value(problem.spectra(future), problem.spectra(past))
    return results


def _past_and_future(signals: Signals, name: str) -> tuple[np.ndarray, np.ndarray]:
    """A reference with its lagged copies, of first and second order, and lagged copies in reversed time."""
    series, step_s = np.nan_to_num(signals.channel(name)), signals.step_s
    lags = [lag_s for lag_s in ANSWER_LAGS_S if lag_s >= 2.0 * step_s]

    def lagged(values: Float[np.ndarray, " n"], lag_s: float) -> Float[np.ndarray, " n"]:
        return first_order_lag(values, step_s=step_s, lag_s=lag_s)

    lagging = [lagged(series, lag_s) for lag_s in lags]
    twice = map(lagged, lagging, lags)
    leading = [lagged(series[::-1], lag_s)[::-1] for lag_s in lags]
    return np.array([series, *lagging, *twice]).T, np.array(leading).T


def _column_space(rows: Float[np.ndarray, "rows k"], tolerance: float = 1e-6) -> Float[np.ndarray, "rows n"]:
    """Orthonormal basis of the column space, without singular values below a share of the largest."""
    U, s, _ = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(U[:, s > tolerance * s[0]])


# -- Responses that disagree --


def response_agreement(problem: LaggedRuns, _flights: Flights = ()) -> SensorAgreement | None:
    """How two responses differ; None without two."""
    compared = response_difference(problem) if has_two_responses(problem) else None
    return sensor_agreement(compared, LEAST_DIFFERENCE)


def estimates_by_response(
    problem: LaggedRuns,
    axes: Sequence[AxisEquation],
    derive: Callable[[LaggedRuns, Estimate], Mapping[str, QuantityEstimate]],
) -> dict[str, Sequence[Mapping[str, float]]]:
    """Quantities by each of two responses of an equation alone, where these disagree, by how they do."""
    results: dict[str, Sequence[Mapping[str, float]]] = {}
    for number in problem.axes:
        columns = tuple(item for item in problem.columns if item.axis == number)
        of_axis = problem if len(problem.axes) == 1 else replace(problem, columns=columns)
        agreement, estimates = response_agreement(of_axis), list[Mapping[str, float]]()
        if agreement is None or not (agreement.significant or agreement.otherwise):
            continue
        for k in range(2):
            by_one = tuple(
                replace(item, responses=item.responses[:, [k]]) if item.axis == number else item
                for item in problem.columns
            )
            alone = replace(problem, columns=by_one)
            quantities = derive(alone, identify(alone, reference_iv()))
            estimates.append({name: item.value for name, item in quantities.items()})
        results[difference_sentence(axes[number].response, agreement)] = estimates
    return results


def difference_sentence(response: tuple[str, ...], agreement: SensorAgreement | None) -> str:
    """How two responses differ, in a line."""
    if agreement is None:
        return ""
    first, second = response if len(response) == 2 else ("the first", "the second")
    sentences = []
    for name, item in agreement.significant.items():
        times = 1e3 if name == OFFSET.name else 100.0
        value, width = f"{times * abs(item.value):.3g}", f"{times * item.half_width:.2g}"
        if name == OFFSET.name:
            late, early = (first, second) if item.value > 0.0 else (second, first)
            sentences.append(f"Of the responses {late} is {value} ± {width} ms behind {early}.")
        else:
            more, less = (second, first) if item.value > 0.0 else (first, second)
            sentences.append(f"Of the responses {more} reads {value} ± {width} % more than {less}.")
    alike = f"{first} and {second} {'disagree' if agreement.otherwise else 'agree'}"
    return " ".join(sentences) or alike


# -- Terms that an equation lacks --

#: Curves of a channel that are tried as further terms; those that bend at once are of what no actuator lags.
CURVES: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "{0} ** 2": np.square,
    "abs({0}) * {0}": lambda x: np.abs(x) * x,
    "sign({0})": np.sign,
}
#: A term is missed below this p-value, of all that are tried together.
MISSED = 1e-4


@dataclass(frozen=True, slots=True)
class MissedTerm:
    """A curve of a term that explains what an equation leaves, and the estimates with it."""

    of: str
    difference: Difference
    p_value: float
    values: Mapping[str, float]  # Parameters and nuisances

    @property
    def sentence(self) -> str:
        """The term in words, with its number."""
        number = f"{plain(self.difference.value, 3)} ± {plain(self.difference.half_width, 2)}"
        p_value = f"p-value {max(self.p_value, 1e-99):.1g}"
        return f"The equation lacks {number} times {self.of} ({p_value}): declare such a term."


def missed_term(
    test: ResidualTest, problem: LaggedRuns, estimate: Estimate, axes: Sequence[AxisEquation]
) -> MissedTerm | None:
    """The curve of a term, predicted by the instruments, that explains most of the residual, if any does."""
    values, count = estimate.nuisances, len(problem.parameters)
    candidates = list[tuple[float, str, np.ndarray, Any]]()
    for block, number in enumerate(problem.axes):
        signed = [(-1.0 if term.of.startswith("-") else 1.0, term) for term in axes[number].terms]
        terms = [(sign, replace(term, of=term.of.removeprefix("-"))) for sign, term in signed]
        terms = [(sign, term) for sign, term in terms if term.is_linear]
        at = [problem.parameters.index(term.parameter) for _, term in terms]
        measured, predicted = list[np.ndarray](), list[np.ndarray]()
        for item in problem.columns:
            if item.axis == number:
                measured.append(item.all_columns(values, count)[:, at] * [sign for sign, _ in terms])
                predicted.append(explained(item.instruments, item.runs, measured[-1]))
        for words, curve in CURVES.items():
            instruments = problem.spectra([curve(columns) for columns in predicted])
            for k, (_, term) in enumerate(terms, block * len(terms)):
                if not (term.behind and curve is np.sign):
                    instrument, regressor = instruments[:, [k]], (curve, measured, k)
                    candidates.append(
                        (test.p_value(instrument), words.format(term.of), instrument, regressor)
                    )
    if not candidates:
        return None
    p_value, of, instrument, (curve, measured, k) = min(candidates, key=itemgetter(0))
    if p_value * len(candidates) >= MISSED:
        return None
    searched = [item.parameter for item in problem.nuisances if item.searched]
    column = problem.spectra([curve(columns) for columns in measured])[:, [k]]
    extended = replace(
        test.bins,
        regressors=np.column_stack([column, test.bins.regressors, *test.slopes]),
        instruments=np.hstack([test.bins.instruments, instrument]),
        parameters=(Parameter(of, ""), *problem.parameters, *searched),
    )
    try:
        differences = dict(estimated(GivenBins(extended), {})[0].differences)
    except (EstimationError, InstrumentError, TooFewSamplesError):
        return None
    known, missed = {**values, **estimate.parameters}, differences.pop(of)
    # the slopes' coefficients are changes of nuisances
    changed = {name: item.value + values.get(name, 0.0) for name, item in differences.items()}
    return MissedTerm(of, missed, p_value, {**known, **changed})


# -- Systematic parts --


def parts(quantities: tuple[str, ...], derived: Mapping[str, str]) -> tuple[verdict.SystematicPart, ...]:
    """Rows of other estimates that intervals reach to: by each response, with a missed term, of each side."""

    def reaches(others: Callable[[verdict.VerdictInputs], Sequence[Mapping[str, float]]]) -> Any:
        def size(inputs: verdict.VerdictInputs, name: str) -> tuple[float, float]:
            value, expression = inputs.value(name), parsed(derived.get(name, name))
            alternatives = [_with_lag(values) for values in others(inputs)]
            known = [values for values in alternatives if {*expression.columns} <= values.keys()]
            shifts = [float(expression.evaluate(values)) - value for values in known]
            return -min([0.0, *shifts]), max([0.0, *shifts])

        return size

    alone = "Which is right is not known: intervals reach to the estimates by each alone."
    return (
        verdict.SystematicPart(
            quantities,
            Counts.ADDED,
            reaches(lambda inputs: [*chain(*inputs.checks.by_response.values())]),
            lambda inputs: " ".join([*inputs.checks.by_response, alone]),
        ),
        verdict.SystematicPart(
            quantities,
            Counts.ADDED,
            reaches(lambda inputs: () if inputs.checks.missed is None else (inputs.checks.missed.values,)),
            lambda inputs: f"{inputs.checks.missed.sentence} Intervals reach to the estimates with it.",
        ),
        verdict.SystematicPart(
            quantities,
            Counts.ADDED,
            reaches(lambda inputs: inputs.sides),
            "Parameters change during the record: intervals reach to their means before and after.",
        ),
    )


def _with_lag(values: Mapping[str, float]) -> Mapping[str, float]:
    return {**values, EFFECTIVE_LAG: sum(values.get(lag, 0.0) for lag in LAGS)}
