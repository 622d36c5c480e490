"""The table of targets, by their words on the command line."""

from __future__ import annotations

from eivor.errors import UsageError, did_you_mean
from eivor.exports.ardupilot import ArduPilotParameters
from eivor.exports.px4 import Px4Parameters
from eivor.exports.randomisations import RANDOMISATIONS
from eivor.exports.simulators.drone_models import DroneModelsParameters
from eivor.exports.simulators.gazebo import GazeboModel
from eivor.exports.simulators.mujoco import MujocoModel
from eivor.exports.simulators.pybullet import PybulletVehicle
from eivor.exports.simulators.rotorpy import RotorpyVehicle
from eivor.exports.simulators.sih import SihParameters
from eivor.exports.state_space import StateSpaceDocument
from eivor.exports.target import Target

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
    """Target of a word.

    Raises
    ------
    UsageError
        When there is none.
    """
    if name not in TARGETS:
        known = ", ".join(TARGETS)
        remedy = "It takes draws: --draws 1000." if name in RANDOMISATIONS else "Name one of them."
        raise UsageError(f"a target out of {known}", f"'{name}'", did_you_mean(name, TARGETS, remedy))
    return TARGETS[name]
