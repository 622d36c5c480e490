"""Diagnostics and findings of a flight's identification; the keys are documented in docs/diagnostics.md."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from eivor.estimation.diagnose import Diagnostics, diagnose
from eivor.estimation.estimate import Estimate
from eivor.flights.prepare import PreparedFlight
from eivor.inference.diagnostics.leverage import SegmentLeverage, segment_leverage
from eivor.inference.diagnostics.residual_memory import residual_memory
from eivor.models.spectral import BinRows
from eivor.models.vertical_flights import VerticalFlights
from eivor.signals.recording import Finding

#: Parameters in which an autopilot keeps its own idea of the hover input.
HOVER_PARAMETERS = ("MPC_THR_HOVER", "MOT_THST_HOVER")
#: The report points out a logged hover parameter that is off by more than this share.
HOVER_DISAGREEMENT = 0.15
#: Share of a flight with a saturated actuator that deserves a finding.
SATURATED_SHARE = 0.01
#: Runs from which each is left out by itself; fewer are cut into tenths.
FEWEST_RUNS = 3


def diagnostics(
    prepared: tuple[PreparedFlight, ...], problem: VerticalFlights | None, estimate: Estimate | None
) -> dict[str, float]:
    """Numbers behind the verdict."""
    flying = [flight for flight in prepared if flight.flight.runs]
    found = {
        "flights": float(len(flying)),
        "runs": float(sum(len(flight.flight.runs) for flight in flying)),
        "airborne_s": sum(float(f.airborne.mask.sum()) * f.flight.signals.step_s for f in prepared),
        "used_s": sum(float(f.used.sum()) * f.flight.signals.step_s for f in prepared),
        "command_rate_hz": min(flight.rates_hz["command"] for flight in prepared),
        "velocity_rate_hz": min(flight.rates_hz["velocity"] for flight in prepared),
        "acceleration_rate_hz": min(flight.rates_hz["acceleration"] for flight in prepared),
    }
    if flying:
        inputs = np.concatenate(
            [f.flight.signals.family(f.flight.input)[f.used].mean(axis=1) for f in flying]
        )
        found["mean_input"] = float(inputs.mean())
        found["input_variation"] = float(inputs.std() / abs(inputs.mean())) if inputs.mean() else 0.0
    if problem is not None and estimate is not None:
        found.update(_of_estimate(problem, estimate))
    return found


def _of_estimate(problem: VerticalFlights, estimate: Estimate) -> dict[str, float]:
    best = estimate.best
    J, p_value = best.inference.over_identification
    found = {
        f"first_stage_F_{name}": float(F)
        for name, F in zip(estimate.names, best.inference.first_stage, strict=True)
    }
    found.update(
        over_identification_J=J,
        over_identification_p_value=p_value,
        instrument_rank=float(best.inference.rank),
        residual_variance=best.inference.residual_variance,
        condition=best.solution.condition,
    )
    rows = problem.samples(best.lag_s, best.delay_s)
    residual = rows.response - rows.regressors @ best.theta
    found["durbin_watson"] = (
        float(np.sum(np.diff(residual) ** 2) / np.sum(residual**2)) if residual.any() else 2.0
    )
    centred = rows.response - rows.response.mean()
    power = float(centred @ centred)
    found["r_squared"] = 1.0 - float(residual @ residual) / power if power > 0.0 else float("nan")
    memory = residual_memory(residual)
    found["residual_memory"] = memory.memory if memory is not None else float("nan")
    found["residual_memory_std_error"] = memory.order_error if memory is not None else float("nan")
    return found | _of_record(estimate)


def _of_record(estimate: Estimate) -> dict[str, float]:
    """Least squares beside the estimate, constancy over the record, leverage of single runs."""
    record, nothing = diagnose(estimate), float("nan")
    against, constant, leverage = record.endogeneity, record.constancy, run_leverage(record)
    friction = estimate.names.index("viscous_friction")
    found = {
        "least_squares_viscous_friction": nothing,
        "least_squares_p_value": nothing,
        "constancy_p_value": nothing,
        "constancy_break": nothing,
        "constancy_change_viscous_friction": nothing,
        "leverage_viscous_friction": nothing,
        "leverage_segment": nothing,
        "leverage_segments": 0.0,
    }
    if against is not None:
        value = estimate.parameters["viscous_friction"] - against.difference[friction]
        found |= {"least_squares_viscous_friction": float(value), "least_squares_p_value": against.p_value}
    if constant is not None:
        found |= {
            "constancy_p_value": constant.p_value,
            "constancy_break": constant.break_at,
            "constancy_change_viscous_friction": float(constant.change[friction]),
        }
    if leverage is not None:
        found |= {
            "leverage_viscous_friction": float(leverage.largest[friction]),
            "leverage_segment": float(leverage.most[friction] + 1),
            "leverage_segments": float(leverage.shift.shape[0]),
        }
    return found


def run_leverage(record: Diagnostics) -> SegmentLeverage | None:
    """Leverage of every run of a record with three or more; else of its tenths."""
    solved = record.solved
    rows = solved.problem.rows()
    if not isinstance(rows.layout, BinRows) or len(rows.layout.runs) < FEWEST_RUNS:
        return record.leverage
    equation = solved.inference.equation
    jacobian = np.column_stack([rows.regressors, *solved.nuisance_columns.T])
    starts = np.cumsum([0, *(2 * run.count for run in rows.layout.runs)])
    runs = [slice(*ends) for ends in pairwise(starts.tolist())]
    return segment_leverage(
        np.stack([equation.test[run].T @ equation.residual[run] for run in runs]),
        np.stack([equation.test[run].T @ jacobian[run] for run in runs]),
        np.array([record.estimate.std_error(name) for name in record.names]),
    )


def findings(prepared: tuple[PreparedFlight, ...], hover: float) -> tuple[Finding, ...]:
    """Findings of every log and flight, and a logged hover parameter that disagrees."""
    found: list[Finding] = []
    for flight in prepared:
        name = flight.recording.name
        prefix = f"{name}: " if len(prepared) > 1 else ""
        found.extend(Finding(f.name, prefix + f.message) for f in flight.findings)
        if not flight.airborne.mask.any():
            found.append(Finding("never_takes_off", f"{name} never takes off (by {flight.airborne.rule})."))
        elif not flight.flight.runs:
            found.append(Finding("no_usable_run", f"{name} has no usable run of three seconds."))
        found.extend(_saturation(flight, prefix))
    for name in HOVER_PARAMETERS:
        logged = prepared[0].recording.parameters.get(name)
        if logged and np.isfinite(hover) and abs(hover / logged - 1.0) > HOVER_DISAGREEMENT:
            found.append(
                Finding(
                    "hover_parameter",
                    f"The log's own {name} is {logged:.3g}, but this vehicle hovered at {hover:.3g}.",
                )
            )
    return tuple(found)


def _saturation(flight: PreparedFlight, prefix: str) -> list[Finding]:
    channels = flight.recording.family(flight.flight.input)
    samples = sum(channel.values.size for channel in channels)
    saturated = sum(channel.quality.saturated for channel in channels)
    if not samples or saturated < SATURATED_SHARE * samples:
        return []
    share = saturated / samples
    return [Finding("saturation", f"{prefix}The input stood at its limit for {share:.1%} of its samples.")]
