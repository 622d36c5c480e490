"""Checks and rules of declared machines: standstill, references that answer, responses that disagree."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.estimation.methods import identify, reference_iv
from eivor.estimation.weighting import residual_spectrum
from eivor.flights import verdict
from eivor.flights.lag_prior import EFFECTIVE_LAG
from eivor.flights.motion import Flights
from eivor.flights.prepared import SensorAgreement, sensor_agreement
from eivor.flights.quantity import Counts, QuantityEstimate
from eivor.inference.distributions import chi_square_tail
from eivor.inference.verdict import Cause, Status
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, LaggedRuns
from eivor.motions.equation import LEAST_DIFFERENCE, OFFSET, response_difference
from eivor.signals.filters import first_order_lag
from eivor.signals.signals import Signals
from eivor.tools import Complex, Float, plain

# -- Lags and activity --

LAGS = (ACTUATOR_LAG.name, DELAY.name)


def narrower(remedy: str, inputs: verdict.VerdictInputs) -> str:
    """What to do about a wide interval, with lags in several parts that fit."""
    lags = inputs.robust.get(ACTUATOR_LAG.name)
    if lags is None or len(lags.intervals) < 2:
        return remedy
    ends = [[plain(1e3 * end, 3) for end in part if end < math.inf] for part in lags.intervals]
    parts = ", ".join(f"{' to '.join(part)} ms{' or more' * (len(part) < 2)}" for part in ends)
    advice = "narrow lag_ms to the part that fits the machine."
    return f"Lags in {len(ends)} parts fit the log ({parts}): {advice} {remedy}"


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


@dataclass(frozen=True, slots=True)
class MachineChecks(verdict.MotionChecks):
    """P-values of the test for references that respond to disturbances, and estimates by each response."""

    answers: Mapping[str, float]
    #: How far below and above estimates by each response alone are
    by_response: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def numbers(self) -> dict[str, float]:
        return {f"{name}_answers_p_value": value for name, value in self.answers.items()}

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


def answers(problem: LaggedRuns, estimate: Estimate, flights: Flights) -> dict[str, float]:
    """P-values of tests that the future of a reference adds nothing to its past for the residual."""
    if not estimate.assembler.needs_instruments:
        return {}
    values, theta = estimate.nuisances, estimate.theta
    bins = problem.bins(values)
    blend, power = residual_spectrum(bins, bins.residuals(theta))

    def rows(columns: Complex[np.ndarray, "bins k"]) -> Float[np.ndarray, "rows k"]:
        stacked = bins.layout.stacked(columns / np.sqrt(power)[:, None])
        return stacked / np.maximum(np.linalg.norm(stacked, axis=0), np.finfo(np.float64).tiny)

    searched = [item for item in problem.nuisances if item.searched]
    slopes = [item.derivative(lambda x: problem.bins(x).regressors @ theta, values) for item in searched]
    whitened = bins.whitened_rows(blend, power)
    residual = whitened[:, 0] - whitened[:, 1:] @ theta
    X, instruments = rows(np.column_stack([bins.regressors, *slopes])), rows(bins.instruments)
    Q = _column_space(instruments)
    projection = np.linalg.pinv(Q @ (Q.T @ X)).T  # The estimate has removed this from the residual
    count, results = residual.size * bins.layout.independent, {}
    for name in flights[0].usable_references:
        past, future = zip(*(_past_and_future(flight.signals, name) for flight in flights), strict=True)
        explained = _column_space(np.column_stack([rows(problem.spectra(past)), instruments]))
        gained = rows(problem.spectra(future))
        gained -= explained @ (explained.T @ gained)
        gained -= projection @ (X.T @ gained)
        directions = _column_space(gained, 1e-3)
        share = float(((directions.T @ residual) ** 2).sum() / (residual @ residual or 1.0))
        results[name] = chi_square_tail(count * share, directions.shape[1])
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
    return sensor_agreement(response_difference(problem), LEAST_DIFFERENCE)


def shifts_by_response(
    problem: LaggedRuns,
    estimate: Estimate,
    derive: Callable[[LaggedRuns, Estimate], Mapping[str, QuantityEstimate]],
) -> dict[str, tuple[float, float]]:
    """How far quantities by each of two responses are below and above, where these disagree."""
    agreement, results = response_agreement(problem), []
    if agreement is None or not (agreement.significant or agreement.otherwise):
        return {}
    for k in range(2):
        columns = tuple(replace(item, responses=item.responses[:, [k]]) for item in problem.columns)
        alone = replace(problem, columns=columns)
        results.append(derive(alone, identify(alone, reference_iv())))
    shifts = {
        name: [item[name].value - known.value for item in results if name in item]
        for name, known in derive(problem, estimate).items()
    }
    return {name: (-min(0.0, *values), max(0.0, *values)) for name, values in shifts.items()}


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


def response_part(quantities: tuple[str, ...], response: tuple[str, ...]) -> verdict.SystematicPart:
    """Row of two responses that disagree: intervals reach to the estimates by each alone."""
    return verdict.SystematicPart(
        quantities,
        Counts.ADDED,
        lambda inputs, name: inputs.checks.by_response.get(name, (0.0, 0.0)),
        lambda inputs: (
            f"{difference_sentence(response, inputs.sensors)} Which is right is not known: intervals reach "
            "to the estimates by each alone."
        ),
    )
