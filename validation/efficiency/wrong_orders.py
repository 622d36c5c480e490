"""What wrong orders of the noises do to the spectral methods, and the command that finds it out.

    python -m validation.efficiency.wrong_orders --kept FILE.jsonl [--size small|full]
        [--page docs/efficiency.md]

The noises of velocity and acceleration are fractional, and both methods take them as white: their orders are
held at zero, their strengths are fitted as ever. Every trial is kept in the file; a run that was interrupted
goes on.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

import eivor as ev
from eivor.errors import EstimationError
from eivor.estimation.sampled_motion import NoisePrior, SampledMotion, fitted_noise, sampled_problem
from eivor.estimation.spectral_equations import Pilot, consistent_estimate, pilot_at, solved_equations
from eivor.estimation.spectral_iv import maximum_likelihood, start_of
from eivor.inference.verdict import Reason
from eivor.lab.scenario_files import shipped_scenario
from validation.pages import markdown
from validation.studies import GridStruct, Group, KeptRun, KeptStudy, Requirement, alone
from validation.suite_files import versions

SEED = 20261122
#: Largest bias of spectral_giv that is asked for, over the parameter.
LARGEST_BIAS = 0.008
METHODS = ("whittle_ml", "spectral_giv")
#: Chance bounds of a mean: three standard errors.
STANDARD_ERRORS = 3.0


@dataclass(frozen=True, slots=True)
class Tried:
    scenario: str  # Name of a shipped one
    run: int  # Number of the record
    errors: dict[str, list[float]]  # Of K and K_u over their size, by method


def trial(name: str, samples: int, run: int) -> Tried:
    scenario = replace(shipped_scenario(name), samples=samples)
    signals = ev.simulate(scenario, np.random.default_rng([SEED, run])).signals
    problem = ev.VerticalMotion(intercept=False).regression(signals, ev.lags("input", 0, 10))
    sampled = sampled_problem(problem, "spectral_giv")
    start = start_of(sampled, consistent_estimate(sampled.problem))
    if isinstance(start, Reason):
        raise EstimationError("a start near generalized IV's", start.sentence, "Look at the record.")
    pilot = taken_as_white(start, sampled.input_variance)
    truth = np.array([scenario.viscous_friction, scenario.input_gain])
    motions = (
        maximum_likelihood(pilot).motion,
        solved_equations(pilot, sampled.input_variance, sampled.instrument).motion,
    )
    errors = [(np.array([motion.friction, motion.gain]) / truth - 1.0).tolist() for motion in motions]
    return Tried(name, run, dict(zip(METHODS, errors, strict=True)))


def taken_as_white(start: SampledMotion, input_variance: float) -> Pilot:
    free = pilot_at(start, input_variance)
    centre = replace(free.prior.centre, velocity_order=0.0, acceleration_order=0.0)
    prior = NoisePrior(centre, np.array([True, True, True, False, False, False]))
    residual = start.whole(np.array([free.transient]), start.nuisance_shapes(ramps=False))
    return Pilot(start, free.transient, fitted_noise(start, residual, centre, prior), prior)


class Grid(GridStruct, frozen=True):
    scenarios: tuple[str, ...]
    samples: int
    small: int  # Records of each by size of the study
    full: int


def groups(grid: Grid, size: str, _kept: Path) -> list[Group[tuple[str, int], Tried]]:
    return alone(
        {
            (name, run): partial(trial, name, grid.samples, run)
            for name in grid.scenarios
            for run in range(getattr(grid, size))
        }
    )


def errors_of(run: KeptRun[Grid, Tried], method: str) -> dict[str, np.ndarray]:
    """Errors of a method by scenario."""
    return {
        name: np.array([line.errors[method] for line in run.lines if line.scenario == name])
        for name in run.grid.scenarios
    }


def requirements(run: KeptRun[Grid, Tried]) -> Iterator[Requirement]:
    errors = errors_of(run, "spectral_giv")
    biases = {name: np.abs(each.mean(axis=0)) for name, each in errors.items()}
    chance = {name: each.std(axis=0) / np.sqrt(len(each)) for name, each in errors.items()}
    worst = max(biases, key=lambda name: float(biases[name].max()))
    yield Requirement(
        "spectral_giv, orders held at zero: bias over the parameter",
        f"at most {LARGEST_BIAS:.1%}",
        f"at most {biases[worst].max():.2%} ({worst})",
        all(bool(np.all(biases[name] <= LARGEST_BIAS + STANDARD_ERRORS * chance[name])) for name in biases),
    )


def tables(run: KeptRun[Grid, Tried]) -> Iterator[str]:
    records = f"{getattr(run.grid, run.size)} records of {run.grid.samples} samples of each scenario"
    yield f" with {versions()}: {records}, seed {SEED}. Each cell is K / K_u."
    header = ("scenario", *(f"{method}: {what}" for method in METHODS for what in ("bias", "scatter")))
    errors = [errors_of(run, method) for method in METHODS]
    yield markdown(header, [(name, *_cells([each[name] for each in errors])) for name in run.grid.scenarios])


def _cells(errors: list[np.ndarray]) -> Iterator[str]:
    for figure in (figure for each in errors for figure in (each.mean(axis=0), each.std(axis=0))):
        yield " / ".join(f"{100.0 * item:.2g} %" for item in figure)


STUDY = KeptStudy(
    "efficiency.wrong_orders",
    __doc__,
    "wrong-orders",
    Grid,
    Tried,
    ("scenario", "run"),
    groups,
    requirements,
    tables,
    file="wrong_orders.toml",
)
main = STUDY.main

if __name__ == "__main__":
    sys.exit(main())
