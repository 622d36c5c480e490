"""One trial of the study: a record, with or without a change, and what the recursion says of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import eivor as ev
from eivor.lab.scenario_files import shipped_scenario
from validation.recursion.changed_record import changed_record

#: Length of a record, and the samples between which its parameter changes.
SAMPLES, CHANGES = 2500, (1250, 1300)
#: Lags of the input that are instruments.
LAGS = 10
#: What a parameter is multiplied by when it changes.
DROP = 0.8
SEED = 20261122


@dataclass(frozen=True, slots=True)
class Told:
    """What one record says."""

    scenario: str  # Name of a shipped one
    changed: str  # Parameter that drops, or "nothing"
    run: int  # Number of the record
    alarms: int  # Changes that were told where there was none
    delay: int | None  # Samples from the change to the first that was told after it; None for never
    covered: dict[str, bool]  # Whether the interval at the end holds the truth, and its half-width over it
    half_width: dict[str, float]


def trial(scenario: str, changed: str, run: int) -> Told:
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
    return Told(
        scenario,
        changed,
        run,
        sum(sample <= index for sample in selected) if drops else len(selected),
        after[0] if drops and after else None,
        {name: bool(low <= truth[name] <= high) for name, (low, high) in ends.items()},
        {name: 0.5 * (high - low) / truth[name] for name, (low, high) in ends.items()},
    )
