"""The table of randomisations, by their words on the command line."""

from __future__ import annotations

from eivor.errors import UsageError, did_you_mean
from eivor.exports.simulators.isaac_lab_draws import IsaacLabDraws
from eivor.exports.simulators.mujoco_draws import MujocoDraws
from eivor.exports.simulators.randomisation import Randomisation
from eivor.exports.simulators.rotorpy_draws import RotorpyDraws

RANDOMISATIONS: dict[str, Randomisation] = {
    one.name: one for one in (RotorpyDraws(), MujocoDraws(), IsaacLabDraws())
}


def randomisation_by_name(name: str) -> Randomisation:
    """Randomisation of a word.

    Raises
    ------
    UsageError
        When there is none.
    """
    if name not in RANDOMISATIONS:
        known = ", ".join(RANDOMISATIONS)
        remedy = did_you_mean(name, RANDOMISATIONS, "Name one of them, or none for a table.")
        raise UsageError(f"draws for {known}", f"'{name}'", remedy)
    return RANDOMISATIONS[name]
