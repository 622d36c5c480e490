"""Recursive identification on records with known truth, and the command that finds out how well it does.

    python -m validation.recursion.study --kept FILE.jsonl [--size small|full] [--page docs/efficiency.md]

runs the grid beside this file, keeps every trial in the file, and prints its table: false alarms and
coverage of records without a change, delays after a parameter drops by a fifth. A run that was interrupted
goes on.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

import eivor as ev
from eivor.lab.records import Scenario, simulate
from eivor.lab.scenario_files import shipped_scenario
from eivor.signals.signals import Signals
from validation.pages import markdown
from validation.studies import GridStruct, Group, KeptRun, KeptStudy, Requirement, alone
from validation.suite_files import versions


def changed_record(
    scenario: Scenario, rng: np.random.Generator, parameter: str, factor: float, sample: int
) -> Signals:
    """Measured signals of a scenario in open loop whose disturbance is in the equation."""
    record = simulate(scenario, rng)
    before, after = scenario, replace(scenario, **{parameter: factor * getattr(scenario, parameter)})
    true, measured = record.truth.channels, record.signals
    u, velocity = true["input"], true["velocity_z"].copy()
    for k in range(max(sample, 1), u.size):
        now = after if k > sample else before  # what held over the step to sample k
        decay, held, _ = now.of_step
        velocity[k] = decay * velocity[k - 1] + now.input_gain * held * u[k - 1]
    friction = np.full(u.size, before.viscous_friction)
    gain = np.full(u.size, before.input_gain)
    friction[sample:], gain[sample:] = after.viscous_friction, after.input_gain
    acceleration = gain * u - friction * velocity + true["disturbance"]
    channels = dict(measured.channels)
    for name, series in (("velocity_z", velocity), ("acceleration_z", acceleration)):
        channels[name] = measured.channels[name] - true[name] + series
    return Signals(measured.rate_hz, channels, noise=measured.noise)


#: Length of a record, and the samples between which its parameter changes.
SAMPLES, CHANGES = 2500, (1250, 1300)
#: Lags of the input that are instruments.
LAGS = 10
#: What a parameter is multiplied by when it changes.
DROP = 0.8
SEED = 20261122


@dataclass(frozen=True, slots=True)
class Detected:
    scenario: str  # Name of a shipped one
    changed: str  # Parameter that drops, or "nothing"
    run: int  # Number of the record
    alarms: int  # Changes that were told where there was none
    delay: int | None  # Samples from the change to the first that was told after it; None for never
    covered: dict[str, bool]  # Whether the interval at the end holds the truth, and its half-width over it
    half_width: dict[str, float]


def trial(scenario: str, changed: str, run: int) -> Detected:
    """Run one record; the same scenario and run have the same noises with and without a change."""
    given = replace(shipped_scenario(scenario), samples=SAMPLES)
    rng = np.random.default_rng([SEED, run])
    index = CHANGES[0] + run % (CHANGES[1] - CHANGES[0])
    truth = {"viscous_friction": given.viscous_friction, "input_gain": given.input_gain}
    drops = changed in truth
    if drops:
        truth[changed] *= DROP
        signals = changed_record(given, rng, changed, DROP, index)
    else:
        signals = ev.simulate(given, rng).signals
    recursion = ev.RecursiveIdentification(
        ev.VerticalMotion(intercept=False),
        ev.methods.generalized_iv(),
        ev.lags("input", 0, LAGS),
        detector=ev.ChangeDetector(),
    ).update(signals)
    selected = [change.sample + LAGS for change in recursion.changes]
    after = [sample - index for sample in selected if sample > index]
    estimate = recursion.estimate()
    ends = {name: estimate.interval(name) for name in truth}
    return Detected(
        scenario,
        changed,
        run,
        sum(sample <= index for sample in selected) if drops else len(selected),
        after[0] if drops and after else None,
        {name: bool(low <= truth[name] <= high) for name, (low, high) in ends.items()},
        {name: 0.5 * (high - low) / truth[name] for name, (low, high) in ends.items()},
    )


#: Asked: share of records of 2,500 samples with a false alarm, median delay [samples], coverage of intervals.
FALSE_ALARMS, DELAY, COVERAGE = 0.10, 150, (0.90, 0.99)
#: What the requirements are asked of.
SCENARIO, PARAMETER = "rich", "input_gain"
NAMES = {"nothing": "nothing", "input_gain": "K_u", "viscous_friction": "K"}
PARAMETERS = ("viscous_friction", "input_gain")
HEADER = (
    *("scenario", "what drops by a fifth", "records", "with a false alarm", "told within 1,200 samples"),
    *("delay: median, 90 %", "coverage of K / K_u", "half-width of K / K_u"),
)


class Records(GridStruct, frozen=True):
    scenario: str  # Name of a shipped one
    changed: Literal["nothing", "input_gain", "viscous_friction"]  # What drops
    small: int  # Number of records by size of the study
    full: int


class Grid(GridStruct, frozen=True):
    records: tuple[Records, ...]


def groups(grid: Grid, size: str, _kept: Path) -> list[Group[tuple[str, str, int], Detected]]:
    return alone(
        {
            (records.scenario, records.changed, run): partial(trial, records.scenario, records.changed, run)
            for records in grid.records
            for run in range(getattr(records, size))
        }
    )


def _of(lines: Sequence[Detected], scenario: str, changed: str) -> list[Detected]:
    return [item for item in lines if (item.scenario, item.changed) == (scenario, changed)]


def requirements(run: KeptRun[Grid, Detected]) -> Iterator[Requirement]:
    still = _of(run.lines, SCENARIO, "nothing")
    alarms = float(np.mean([item.alarms > 0 for item in still]))
    yield Requirement.at_most(
        f"{SCENARIO}: records of 2,500 samples with a false alarm", alarms, FALSE_ALARMS
    )
    delay = float(np.median(_delays(_of(run.lines, SCENARIO, PARAMETER))))
    what = f"{SCENARIO}: median delay after {NAMES[PARAMETER]} drops by a fifth"
    yield Requirement(what, f"at most {DELAY} samples", f"{delay:.0f}", delay <= DELAY)
    for name in PARAMETERS:
        covered = float(np.mean([item.covered[name] for item in still]))
        yield Requirement.within(f"{SCENARIO}: coverage of the intervals of {NAMES[name]}", covered, COVERAGE)


def _delays(lines: Sequence[Detected]) -> list[float]:
    return [float("inf") if item.delay is None else float(item.delay) for item in lines]


def tables(run: KeptRun[Grid, Detected]) -> Iterator[str]:
    kinds = dict.fromkeys((item.scenario, item.changed) for item in run.lines)
    yield f" with {versions()}: records of 2,500 samples, memory 200, seed {SEED}."
    yield markdown(HEADER, [_row(_of(run.lines, *kind)) for kind in kinds])


def _row(lines: Sequence[Detected]) -> tuple[str, ...]:
    first, delays = lines[0], _delays(lines)
    changed = first.changed != "nothing"
    middle, late = np.quantile(delays, [0.5, 0.9], method="inverted_cdf")
    return (
        first.scenario,
        NAMES[first.changed],
        f"{len(lines)}",
        f"{np.mean([item.alarms > 0 for item in lines]):.3f}",
        f"{np.mean(np.isfinite(delays)):.3f}" if changed else "-",
        f"{_samples(middle)}, {_samples(late)}" if changed else "-",
        " / ".join(f"{np.mean([item.covered[name] for item in lines]):.3f}" for name in PARAMETERS),
        " / ".join(
            f"{100.0 * np.median([item.half_width[name] for item in lines]):.1f} %" for name in PARAMETERS
        ),
    )


def _samples(delay: float) -> str:
    return f"{delay:.0f}" if np.isfinite(delay) else "never"


STUDY = KeptStudy(
    "recursion.study",
    __doc__,
    "recursion",
    Grid,
    Detected,
    ("scenario", "changed", "run"),
    groups,
    requirements,
    tables,
)
main = STUDY.main

if __name__ == "__main__":
    sys.exit(main())
