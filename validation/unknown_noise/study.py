"""Records whose noises are not declared, and what is told of parameters and noises.

python -m validation.unknown_noise.study [SUITE.toml] [--runs N] [--page FILE.md]
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import eivor as ev
from eivor.estimation.linear import Method
from eivor.inference.verdict import Status
from eivor.lab.scenario_files import shipped_scenario
from eivor.signals.noise import FractionalNoise
from eivor.tools import Float
from validation.pages import markdown
from validation.studies import (
    Answer,
    GridStruct,
    Option,
    Requirement,
    StudyCommand,
    read_as,
    requirement_table,
)
from validation.suite_files import versions

PART = "unknown-noise"
VELOCITY = "velocity_z"
METHODS = ("generalized_iv_unknown_noise", "bias_eliminating_least_squares", "frisch_scheme", "spectral_giv")
#: The coverage that is asked of parameters, and of what is told of noises.
OF_PARAMETERS, OF_NOISES = (0.91, 0.99), (0.90, 0.99)
SUITE = Path(__file__).with_name("unknown_noise.toml")


class Case(GridStruct, frozen=True):
    """Records of one scenario, with the velocity's noise of one order; white noise has the order zero."""

    scenario: str
    samples: int
    order: float
    methods: tuple[str, ...]

    def scene(self) -> ev.Scenario:
        scenario = replace(shipped_scenario(self.scenario), samples=self.samples)
        noise = FractionalNoise(1.0, self.order) if self.order else ev.WhiteNoise(1.0)
        return replace(scenario, noise={**scenario.noise, VELOCITY: noise})

    def method(self, name: str) -> Method:
        """One of its methods; the generalized one is to find the order out where there is one."""
        if name == METHODS[0]:
            return ev.methods.generalized_iv_unknown_noise(orders=(VELOCITY,) if self.order else ())
        made = {
            METHODS[1]: ev.methods.bias_eliminating_least_squares,
            METHODS[2]: ev.methods.frisch_scheme,
            METHODS[3]: ev.methods.spectral_giv,
        }
        return made[name]()


@dataclass(frozen=True, slots=True)
class Told:
    """What one method says of one parameter over all records."""

    case: str  # Of what
    method: str
    parameter: str
    errors: Float[np.ndarray, " records"]  # Over the truth; an order's are plain
    held: np.ndarray  # Whether the interval holds the truth
    refused: int  # Records whose estimate is refused


class Suite(GridStruct, frozen=True):
    name: str
    runs: int
    seed: int
    cases: dict[str, Case]
    part: str = PART  # Of the page


def tried(of: str, case: Case, runs: int, seed: int) -> Iterator[Told]:
    scene, columns = case.scene(), ev.lags("input", 0, 10)
    results: dict[tuple[str, str], list[tuple[float, bool]]] = {}
    refused = dict.fromkeys(case.methods, 0)
    for number in range(runs):
        signals = ev.simulate(scene, np.random.default_rng([seed, number])).signals
        truth = {"viscous_friction": scene.viscous_friction, "input_gain": scene.input_gain}
        for channel in ("input", VELOCITY):
            truth[f"noise_variance_{channel}"] = signals.noise[channel].std ** 2
        truth[f"noise_order_{VELOCITY}"] = case.order
        problem = ev.VerticalMotion(intercept=False).regression(replace(signals, noise={}), columns)
        for method in case.methods:
            estimate = ev.identify(problem, case.method(method))
            refused[method] += estimate.status is Status.REFUSED
            for name in estimate.names:
                if name in truth:
                    low, high = estimate.interval(name)
                    error = (estimate.parameters[name] - truth[name]) / (
                        1.0 if "order" in name else truth[name]
                    )
                    results.setdefault((method, name), []).append((error, low <= truth[name] <= high))
            for noise in (item for item in estimate.noises if item.of == "input"):
                std = signals.noise["input"].std
                near = abs(noise.strength - std) <= 1.96 * noise.strength_error
                results.setdefault((method, "noise_std_input"), []).append((noise.strength / std - 1.0, near))
    for (method, name), pairs in results.items():
        errors, held = zip(*pairs, strict=True)
        yield Told(of, method, name, np.array(errors), np.array(held), refused[method])


def requirements(tolds: Iterable[Told]) -> list[Requirement]:
    judged = [item for item in tolds if item.refused < 0.5 * item.held.size]
    results = []
    for words, noises, (low, high) in (
        ("intervals of K and K_u hold", False, OF_PARAMETERS),
        ("intervals of noises hold", True, OF_NOISES),
    ):
        shares = [float(item.held.mean()) for item in judged if item.parameter.startswith("noise") is noises]
        if shares:
            measured = f"{min(shares):.3f} to {max(shares):.3f}"
            met = low <= min(shares) and max(shares) <= high
            results.append(Requirement(words, f"{low:.2f} to {high:.2f}", measured, met))
    white = [item for item in tolds if item.case == "white"]
    if white:
        share = min(item.refused / item.held.size for item in white)
        results.append(
            Requirement("a white input is refused", "at least 0.95", f"{share:.3f}", share >= 0.95)
        )
    return results


def tables(tolds: Sequence[Told], runs: int, seed: int) -> str:
    lines = [
        (
            item.case,
            item.method,
            item.parameter,
            *(
                f"{100.0 * value:.2g} %" if "order" not in item.parameter else f"{value:.2g}"
                for value in (item.errors.mean(), item.errors.std())
            ),
            f"{item.held.mean():.3f}",
            f"{item.refused / item.held.size:.2f}",
        )
        for item in tolds
    ]
    return "\n\n".join(
        (
            f"Made by `python -m validation.unknown_noise.study` with {versions()}: {runs} records of each "
            f"case, seed {seed}.",
            requirement_table(requirements(tolds)),
            markdown(("case", "method", "of", "bias", "scatter", "coverage", "refused"), lines),
        )
    )


def answer(chosen: argparse.Namespace) -> Answer:
    suite = read_as(Suite, chosen.suite)
    runs = suite.runs if chosen.runs is None else chosen.runs
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        selected = [
            item for name, case in suite.cases.items() for item in tried(name, case, runs, suite.seed)
        ]
    return tables(selected, runs, suite.seed), requirements(selected)


OPTIONS: dict[str, Option] = {
    "suite": {"type": Path, "nargs": "?", "default": SUITE, "help": "a suite file; default: the package's"},
    "--runs": {"type": int, "help": "instead of the suite's"},
}
main = StudyCommand(
    "validation.unknown_noise.study",
    __doc__,
    lambda chosen: read_as(Suite, chosen.suite).part,
    answer,
    OPTIONS,
).main

if __name__ == "__main__":
    sys.exit(main())
