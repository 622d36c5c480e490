"""Small studies that several tests run, and a patient task."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from eivor.lab.experiments import DifferenceEquation
from eivor.lab.study import TABLE_FILE, MethodChoice, Study
from eivor.process_pool import abandoned
from eivor.signals.noise import WhiteNoise
from eivor.simulation.excitation import Excitation


@dataclass(frozen=True)
class Coin(Excitation):
    """+-1, independent."""

    def sample(self, count, step_s, rng):
        del step_s
        return rng.choice([-1.0, 1.0], count)


@dataclass(frozen=True)
class Patient:
    """A task in many parts, that is over at once for the first item."""

    folder: Path

    def __call__(self, item):
        end = time.monotonic() + 600.0
        while item and not abandoned() and time.monotonic() < end:
            time.sleep(0.01)
        (self.folder / str(item)).touch()
        return item


EQUATION = DifferenceEquation(
    (0.5,), (2.0,), Coin(), samples=200, noise={"output": WhiteNoise(0.5), "input": WhiteNoise(0.3)}
)

METHODS = (
    MethodChoice("least_squares"),
    MethodChoice("extended_iv", (1, 5)),
    # weighted, so that trials are computed one by one
    MethodChoice("generalized_iv", (0, 5), weighting="two_stage", known_noise=("input",)),
)


def small_study(runs=60, **changes):
    parts: dict[str, object] = {"name": "small", "experiment": EQUATION, "methods": METHODS, "seed": 7}
    return Study(**(parts | {"runs": runs} | changes))


def content(folder):
    """Every file of trials in a folder, by name."""
    shards = {path.name: path.read_bytes() for path in sorted((folder / "shards").iterdir())}
    return shards | {TABLE_FILE: (folder / TABLE_FILE).read_bytes()}
