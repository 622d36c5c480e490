"""Diagnostics and findings of a flight's identification; the keys are documented in docs/diagnostics.md."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from eivor.estimation.diagnose import Diagnostics, diagnose
from eivor.estimation.estimate import Estimate
from eivor.estimation.evidence import periodicity
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import NAN
from eivor.flights.shown import Trace
from eivor.flights.words import Words
from eivor.inference.diagnostics.constancy import Constancy
from eivor.inference.diagnostics.endogeneity import Endogeneity
from eivor.inference.diagnostics.leverage import SegmentLeverage, segment_leverage
from eivor.inference.diagnostics.over_identification import OverIdentification
from eivor.inference.diagnostics.periodicity import Periodicity, Swing, blocks_of, strongest_swings
from eivor.inference.diagnostics.residual_memory import ResidualMemory, residual_memory
from eivor.models.spectral import BinRows
from eivor.signals.recording import Finding

#: Share of a flight with a saturated actuator that deserves a finding.
SATURATED_SHARE = 0.01
#: Blocks of time of the residual that is looked at for swings.
SWING_BLOCKS = 128
#: Runs from which each is left out by itself; fewer are cut into tenths.
FEWEST_RUNS = 3


def flight_diagnostics(prepared: tuple[PreparedFlight, ...]) -> dict[str, float]:
    """What was logged and used."""
    flying = [flight for flight in prepared if flight.runs]
    found = {
        "flights": float(len(flying)),
        "runs": float(sum(len(flight.runs) for flight in flying)),
        "airborne_s": sum(float(f.active.mask.sum()) * f.signals.step_s for f in prepared),
        "used_s": sum(flight.used_s for flight in prepared),
    }
    for role in prepared[0].rates_hz:
        found[f"{role}_rate_hz"] = min(flight.rates_hz[role] for flight in prepared)
    if flying:
        inputs = np.concatenate([flight.used_input.mean(axis=1) for flight in flying])
        found["mean_input"] = float(inputs.mean())
        found["input_variation"] = float(inputs.std() / abs(inputs.mean())) if inputs.mean() else 0.0
    return found


@dataclass(frozen=True)
class FitDiagnostics:
    """Diagnostics of a flight's estimate: what reports, documents and verdicts read alike.

    Parameters
    ----------
    first_stage : mapping of str to float
        Conditional first-stage F of each joint parameter; NaN without instruments.
    rank : int
        Independent instruments; 0 without.
    agreement : OverIdentification or None
        Whether the instruments agree; None without any.
    endogeneity : Endogeneity or None
        Least squares beside the estimate.
    constancy : Constancy or None
        Whether the parameters stay the same.
    periodicity : Periodicity or None
        Whether the parameters, or the residual of each axis in time, swing; None for several flights.
    leverage : SegmentLeverage or None
        Of every run where there are three or more, else of tenths.
    memory : ResidualMemory or None
        Of the residual in time, before any whitening.
    residual_variance, condition, durbin_watson, r_squared : float
        Of the weighted rows, of the equations, and of the residual in time.
    """

    first_stage: Mapping[str, float]
    rank: int
    agreement: OverIdentification | None
    endogeneity: Endogeneity | None
    constancy: Constancy | None
    periodicity: Periodicity | None
    leverage: SegmentLeverage | None
    memory: ResidualMemory | None
    residual_variance: float
    condition: float
    durbin_watson: float
    r_squared: float


def fit_diagnostics(traces: tuple[Trace, ...], estimate: Estimate) -> FitDiagnostics:
    """Diagnostics of an estimate and of its residual in time, of several axes one after the other."""
    record, inference = diagnose(estimate), estimate.best.inference
    measured = np.concatenate([trace.measured for trace in traces])
    residual = measured - np.concatenate([trace.predicted for trace in traces])
    centred = np.concatenate([trace.measured - trace.measured.mean() for trace in traces])
    power, left = float(centred @ centred), float(residual @ residual)
    return FitDiagnostics(
        first_stage=dict(zip(estimate.names, (float(F) for F in inference.first_stage), strict=True)),
        rank=inference.rank,
        agreement=record.over_identification,
        endogeneity=record.endogeneity,
        constancy=record.constancy,
        periodicity=periodicity(record.evidence, left_over_swings(record, traces)),
        leverage=run_leverage(record),
        memory=residual_memory(residual),
        residual_variance=inference.residual_variance,
        condition=estimate.condition,
        durbin_watson=float(np.sum(np.diff(residual) ** 2)) / left if left > 0.0 else 2.0,
        r_squared=1.0 - left / power if power > 0.0 else NAN,
    )


def fit_numbers(found: FitDiagnostics, estimate: Estimate, headline: tuple[str, ...]) -> dict[str, float]:
    """The same as numbers by name; `headline` names the parameters that are looked at more closely."""
    places = {name: estimate.names.index(name) for name in headline if name in estimate.names}
    agreement, memory = found.agreement, found.memory
    return {
        **{f"first_stage_F_{name}": F for name, F in found.first_stage.items()},
        "over_identification_J": 0.0 if agreement is None else agreement.J,
        "over_identification_p_value": 1.0 if agreement is None else agreement.p_value,
        "instrument_rank": float(found.rank),
        "residual_variance": found.residual_variance,
        "condition": found.condition,
        "durbin_watson": found.durbin_watson,
        "r_squared": found.r_squared,
        "residual_memory": NAN if memory is None else memory.memory,
        "residual_memory_std_error": NAN if memory is None else memory.order_error,
        **_of_least_squares(found.endogeneity, estimate, places),
        **_of_constancy(found.constancy, places),
        **_of_periodicity(found.periodicity, estimate.names),
        **_of_leverage(found.leverage, places),
    }


def _of_least_squares(
    against: Endogeneity | None, estimate: Estimate, places: dict[str, int]
) -> dict[str, float]:
    values = {
        name: NAN if against is None else float(estimate.parameters[name] - against.difference[place])
        for name, place in places.items()
    }
    found = {f"least_squares_{name}": value for name, value in values.items()}
    return found | {"least_squares_p_value": NAN if against is None else against.p_value}


def _of_constancy(constant: Constancy | None, places: dict[str, int]) -> dict[str, float]:
    found = {
        "constancy_p_value": NAN if constant is None else constant.p_value,
        "constancy_break": NAN if constant is None else constant.break_at,
    }
    for name, place in places.items():
        found[f"constancy_change_{name}"] = NAN if constant is None else float(constant.change[place])
    return found


def _of_periodicity(swinging: Periodicity | None, names: tuple[str, ...]) -> dict[str, float]:
    found = {"periodicity_p_value": NAN if swinging is None else swinging.p_value}
    for place, name in enumerate(names):
        found |= _of_swing(name, None if swinging is None else swinging.parameters[place])
    left_over = () if swinging is None else swinging.left_over
    return found | _of_swing("residual", min(left_over, key=lambda one: one.p_value, default=None))


def _of_swing(name: str, one: Swing | None) -> dict[str, float]:
    return {
        f"periodicity_{name}_p_value": NAN if one is None else one.p_value,
        f"periodicity_{name}_period_s": NAN if one is None else one.period,
        f"periodicity_{name}_amplitude": NAN if one is None else one.amplitude,
    }


def _of_leverage(leverage: SegmentLeverage | None, places: dict[str, int]) -> dict[str, float]:
    found = {
        f"leverage_{name}": NAN if leverage is None else float(leverage.largest[place])
        for name, place in places.items()
    }
    first = next(iter(places.values()), 0)
    found["leverage_segment"] = NAN if leverage is None else float(leverage.most[first] + 1)
    found["leverage_segments"] = 0.0 if leverage is None else float(leverage.shift.shape[0])
    return found


def left_over_swings(record: Diagnostics, traces: tuple[Trace, ...]) -> tuple[Swing, ...]:
    """Swings of the residual of each axis, before any whitening; none but of rows in frequency."""
    layout = record.evidence.solved.rows.layout
    if not isinstance(layout, BinRows) or not record.evidence.in_one_flight:
        return ()
    found: list[Swing] = []
    # A log without velocity, for one, tells some axes only: those have traces.
    for axis, trace in zip(sorted({run.axis for run in layout.runs}), traces, strict=True):
        runs = [run for run in layout.runs if run.axis == axis]
        places = [
            run.start + (np.arange(run.length) if run.counted is None else np.flatnonzero(run.counted))
            for run in runs
        ]
        residual, times = trace.measured - trace.predicted, runs[0].step_s * np.concatenate(places)
        blocks = blocks_of(residual, times, runs[0].step_s, SWING_BLOCKS)
        found += strongest_swings(blocks, ((trace.axis, trace.unit),), 1.0 / residual.size)
    return tuple(found)


def run_leverage(record: Diagnostics) -> SegmentLeverage | None:
    """Leverage of every run of a record with three or more; else of its tenths."""
    solved = record.evidence.solved
    rows = solved.rows
    if not isinstance(rows.layout, BinRows) or len(rows.layout.runs) < FEWEST_RUNS:
        return record.leverage
    equation, jacobian = record.estimate.best.equation, solved.jacobian
    starts = np.cumsum([0, *(2 * run.count for run in rows.layout.runs)])
    ends = tuple(pairwise(starts.tolist()))
    runs = [slice(*one) for one in ends]
    return segment_leverage(
        np.stack([equation.test_functions[run].T @ equation.residual[run] for run in runs]),
        np.stack([equation.test_functions[run].T @ jacobian[run] for run in runs]),
        record.evidence.subject.std_errors,
        ends,
    )


def flight_findings(prepared: tuple[PreparedFlight, ...], words: Words) -> tuple[Finding, ...]:
    """Findings of every log and flight."""
    found: list[Finding] = []
    for flight in prepared:
        name = flight.recording.name
        prefix = f"{name}: " if len(prepared) > 1 else ""
        found.extend(Finding(f.name, prefix + f.message) for f in flight.findings)
        if not flight.active.mask.any():
            sentence = f"{name} never {words.begins} (by {flight.active.rule})."
            found.append(Finding("never_takes_off", sentence))
        elif not flight.runs:
            found.append(
                Finding("no_usable_run", f"{name} has no three seconds in usable runs of a second or more.")
            )
        found.extend(_saturation(flight, prefix))
    return tuple(found)


def fitted_noise_findings(estimate: Estimate) -> tuple[Finding, ...]:
    """Noises that were fitted together with the parameters, if the method fits any."""
    if not estimate.noises:
        return ()
    told = "; ".join(noise.sentence for noise in estimate.noises)
    return (Finding("fitted_noise", f"Noises that fit what the estimate leaves: {told}."),)


def _saturation(flight: PreparedFlight, prefix: str) -> list[Finding]:
    channels = flight.recording.family(flight.input.name)
    samples = sum(channel.values.size for channel in channels)
    saturated = sum(channel.quality.saturated for channel in channels)
    if not samples or saturated < SATURATED_SHARE * samples:
        return []
    share = saturated / samples
    return [Finding("saturation", f"{prefix}The input stood at its limit for {share:.1%} of its samples.")]
