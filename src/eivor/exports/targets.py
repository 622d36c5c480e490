"""Export targets by name."""

from __future__ import annotations

from eivor.errors import UsageError, did_you_mean
from eivor.exports.autopilots import ArduPilotParameters, Px4Parameters, StateSpaceDocument
from eivor.exports.fitted import Target
from eivor.exports.simulators import (
    DroneModelsParameters,
    GazeboModel,
    IsaacLabDraws,
    MujocoDraws,
    MujocoModel,
    PybulletVehicle,
    RotorpyDraws,
    RotorpyVehicle,
    SihParameters,
)
from eivor.exports.vehicle import Randomisation

# -- Randomisations --

RANDOMISATIONS: dict[str, Randomisation] = {
    item.name: item for item in (RotorpyDraws(), MujocoDraws(), IsaacLabDraws())
}


def randomisation_by_name(name: str) -> Randomisation:
    """Randomisation of a word."""
    if name not in RANDOMISATIONS:
        known = ", ".join(RANDOMISATIONS)
        remedy = did_you_mean(name, RANDOMISATIONS, "Name one of them, or none for a table.")
        raise UsageError(f"draws for {known}", f"'{name}'", remedy)
    return RANDOMISATIONS[name]


# -- Targets --

TARGETS: dict[str, Target] = {
    target.name: target
    for target in (
        Px4Parameters(),
        ArduPilotParameters(),
        StateSpaceDocument(),
        SihParameters(),
        RotorpyVehicle(),
        MujocoModel(),
        PybulletVehicle(),
        GazeboModel(),
        DroneModelsParameters(),
    )
}


def target_by_name(name: str) -> Target:
    """Target of a word."""
    if name not in TARGETS:
        known = ", ".join(TARGETS)
        remedy = "It takes draws: --draws 1000." if name in RANDOMISATIONS else "Name one of them."
        raise UsageError(f"a target out of {known}", f"'{name}'", did_you_mean(name, TARGETS, remedy))
    return TARGETS[name]
