"""Small studies that several tests run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from eivor.lab.experiments import DifferenceEquation
from eivor.lab.study import TABLE_FILE, MethodChoice, Study
from eivor.signals.noise import WhiteNoise
from eivor.simulation.excitation import Excitation


@dataclass(frozen=True)
class Coin(Excitation):
    """+-1, independent."""

    def sample(self, count: int, step_s: float, rng: np.random.Generator) -> np.ndarray:
        del step_s
        return rng.choice([-1.0, 1.0], count)


EQUATION = DifferenceEquation(
    (0.5,), (2.0,), Coin(), samples=200, noise={"output": WhiteNoise(0.5), "input": WhiteNoise(0.3)}
)
METHODS = (
    MethodChoice("least_squares"),
    MethodChoice("extended_iv", (1, 5)),
    MethodChoice("generalized_iv", (0, 5), known_noise=("input",)),
)


def small_study(runs: int = 60, **changes: object) -> Study:
    parts: dict[str, object] = {"name": "small", "experiment": EQUATION, "methods": METHODS, "seed": 7}
    return Study(**(parts | {"runs": runs} | changes))


def content(folder: Path) -> dict[str, bytes]:
    """Every file of trials in a folder, by name."""
    shards = {path.name: path.read_bytes() for path in sorted((folder / "shards").iterdir())}
    return shards | {TABLE_FILE: (folder / TABLE_FILE).read_bytes()}
