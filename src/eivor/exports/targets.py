"""Export targets by name."""

from __future__ import annotations

from eivor import checks
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
    checks.index_of("draws", name, RANDOMISATIONS, "Name one of them, or none for a table.")
    return RANDOMISATIONS[name]


def target_by_name(name: str) -> Target:
    """Target of a word."""
    remedy = "It takes draws: --draws 1000." if name in RANDOMISATIONS else "Name one of them."
    checks.index_of("a target", name, TARGETS, remedy)
    return TARGETS[name]
