"""Export targets by name."""

from __future__ import annotations

from eivor.errors import UsageError, did_you_mean
from eivor.exports.autopilots import AUTOPILOTS
from eivor.exports.fitted import Target
from eivor.exports.models import DRAWN_MODELS, MODELS
from eivor.exports.simulators import DRAWN, SIMULATORS
from eivor.exports.vehicle import ExportOfDraws

#: Files of draws by their word on the command line.
RANDOMISATIONS: dict[str, ExportOfDraws] = DRAWN | DRAWN_MODELS
TARGETS: dict[str, Target] = {target.name: target for target in (*AUTOPILOTS, *MODELS, *SIMULATORS)}


def motions_for(target: str) -> tuple[str, ...]:
    """Names of the motions that a target takes, the preferred one first."""
    if target in {item.name for item in MODELS}:
        return ("vertical", "rigid-body", "rates")
    is_autopilot = target in {item.name for item in AUTOPILOTS}
    return ("vertical",) if is_autopilot else ("rigid-body", "vertical")


def randomisation_by_name(name: str) -> ExportOfDraws:
    """Randomisation of a word."""
    if name not in RANDOMISATIONS:
        known = ", ".join(RANDOMISATIONS)
        remedy = did_you_mean(name, RANDOMISATIONS, "Name one of them, or none for a table.")
        raise UsageError(f"draws for {known}", f"'{name}'", remedy)
    return RANDOMISATIONS[name]


def target_by_name(name: str) -> Target:
    """Target of a word."""
    if name not in TARGETS:
        known = ", ".join(TARGETS)
        remedy = "It takes draws: --draws 1000." if name in RANDOMISATIONS else "Name one of them."
        raise UsageError(f"a target out of {known}", f"'{name}'", did_you_mean(name, TARGETS, remedy))
    return TARGETS[name]
