"""What wrong orders of the noises do to the spectral methods, and the command that finds it out.

    python -m validation.efficiency.wrong_orders --kept FILE.jsonl [--size small|full]
        [--page docs/efficiency.md]

The noises of velocity and acceleration are fractional, and both methods take them as white: their orders are
held at zero, their strengths are fitted as ever. Every trial is kept in the file; a run that was interrupted
goes on. The exit code is 0 when every requirement is met, 3 when one is not, 2 for an input of no use.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

import eivor as ev
from eivor.errors import EstimationError
from eivor.estimation.sampled_motion import NoisePrior, SampledMotion, fitted_noise, sampled_problem
from eivor.estimation.spectral_equations import Pilot, consistent_estimate, pilot_at, solved_equations
from eivor.estimation.spectral_iv import maximum_likelihood, start_of
from eivor.inference.verdict import Reason
from eivor.lab.experiments import markdown
from eivor.lab.scenario_files import shipped_scenario
from eivor.strict_toml import read_toml
from validation.studies import Answer, Requirement, completed, kept_command, requirement_table, versions

PART = "wrong-orders"
GRID = Path(__file__).with_name("wrong_orders.toml")
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


class RecordGrid(msgspec.Struct, forbid_unknown_fields=True):
    scenarios: list[str]
    samples: int
    small: int
    full: int


def answer(grid: Path, size: str, kept: Path) -> Answer:
    """Run what the file does not have yet, and judge all of it."""
    root = read_toml(grid, "grid of records").convert(RecordGrid)
    names, samples, runs = root.scenarios, root.samples, {"small": root.small, "full": root.full}[size]
    trials = {(name, run): partial(trial, name, samples, run) for name in names for run in range(runs)}
    tried = completed(kept, Tried, trials, lambda line: (line.scenario, line.run))
    results = {
        name: {
            method: np.array([line.errors[method] for line in tried if line.scenario == name])
            for method in METHODS
        }
        for name in names
    }
    requirement = _requirement({name: errors["spectral_giv"] for name, errors in results.items()})
    tables = (
        f"Made by `python -m validation.efficiency.wrong_orders` with {versions()}: {runs} records of "
        f"{samples} samples of each scenario, seed {SEED}. Each cell is K / K_u.",
        requirement_table([requirement]),
        markdown(
            ("scenario", *(f"{method}: {what}" for method in METHODS for what in ("bias", "scatter"))),
            list(_lines(results)),
        ),
    )
    return "\n\n".join(tables), (requirement,)


def _requirement(errors: dict[str, np.ndarray]) -> Requirement:
    biases = {name: np.abs(each.mean(axis=0)) for name, each in errors.items()}
    chance = {name: each.std(axis=0) / np.sqrt(len(each)) for name, each in errors.items()}
    worst = max(biases, key=lambda name: float(biases[name].max()))
    return Requirement(
        "spectral_giv, orders held at zero: bias over the parameter",
        f"at most {LARGEST_BIAS:.1%}",
        f"at most {biases[worst].max():.2%} ({worst})",
        all(
            bool(np.all(biases[biase] <= LARGEST_BIAS + STANDARD_ERRORS * chance[biase])) for biase in biases
        ),
    )


def _lines(dicts: dict[str, dict[str, np.ndarray]]) -> Iterator[tuple[str, ...]]:
    for name, errors in dicts.items():
        figures = (
            item for method in METHODS for item in (errors[method].mean(axis=0), errors[method].std(axis=0))
        )
        yield name, *(" / ".join(f"{100.0 * item:.2g} %" for item in each) for each in figures)


main = kept_command("validation.efficiency.wrong_orders", __doc__, GRID, PART, answer).main

if __name__ == "__main__":
    sys.exit(main())
