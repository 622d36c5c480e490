"""The motions that are identified, by name; other packages add theirs by entry points."""

from __future__ import annotations

import os
from functools import cache
from importlib import import_module
from typing import Any

from eivor import checks
from eivor.errors import UsageError
from eivor.flights.motion import Motion
from eivor.flights.quantity import QuantitySpec
from eivor.motions.declaration import load_machine, machine_of, shipped_machines
from eivor.signals.channels import declare_channels
from eivor.strict_toml import ENDING, TomlTable

#: Group of the entry points of other packages.
GROUP = "eivor.motions"
_OWN = {
    "vertical": "eivor.motions.vertical.motion:Vertical",
    "rates": "eivor.motions.rates.motion:Rates",
    "rigid-body": "eivor.motions.rigid_body.motion:RigidBody",
}
DEFAULT = "vertical"
#: What is identified of a log where nothing is named, in the order of results.
USUAL_MOTIONS = ("vertical", "rates")


def motion_names() -> tuple[str, ...]:
    """Every motion that there is: Eivor's own, then those of other packages."""
    return tuple(dict.fromkeys((*_OWN, *sorted(_added()))))


def motion_by_name(name: str | os.PathLike[str]) -> Motion[Any]:
    """Motion of a name, Eivor's own first. The channels that it adds are canonical from then on.

    Parameters
    ----------
    name : str or path
        "vertical", "rates", "rigid-body", the name of a motion that another package brings or of a machine
        that comes with Eivor, or a machine's TOML file.

    Raises
    ------
    UsageError
        When there is none of that name, or another package's cannot be loaded, or adds a channel whose name
        is that of another one.
    InputError
        When a machine's file has something wrong in it.
    """
    name = str(name) if isinstance(name, os.PathLike) else name
    checks.text("name", name)
    known = name in _OWN or name in motion_names()  # what is installed is searched for other names only
    if name.endswith(ENDING) or (not known and name in shipped_machines()):
        return load_machine(name)
    return loaded_motion(name)


def motion_of_model(model_name: str, vehicle: Any = None) -> Motion[Any]:
    """Motion that a JSON document names by its model, with the vehicle or the machine that it holds."""
    if isinstance(vehicle, dict) and isinstance(vehicle.get("machine"), dict):
        return machine_of(TomlTable(vehicle["machine"], "the machine of the result"))
    for name in motion_names():
        motion = motion_by_name(name)
        if motion.words.model == model_name:
            support = motion.abilities.vehicle
            return motion if support is None else support.restore(vehicle)
    expected = f"a model of one of the motions {', '.join(motion_names())}"
    raise UsageError(expected, f"'{model_name}'", "Install the package that brings its motion.")


def name_of_model(model_name: str) -> str:
    """Name of the motion of a model; the model's own where no motion is known to have it."""
    return {loaded_motion(name).words.model: name for name in _OWN}.get(model_name, model_name)


@cache
def loaded_motion(name: str) -> Motion[Any]:
    """Motion of a name, loaded once."""
    if name in _OWN:
        module, _, attribute = _OWN[name].partition(":")
        own_motion: Motion[Any] = getattr(import_module(module), attribute)()
        return own_motion
    if name not in (added := _added()):
        remedy = "Name one of them with --model, or a machine with --machine."
        checks.index_of("a motion", name, motion_names(), remedy)  # refuses
    motion = _loaded(added[name])
    declare_channels(*motion.channels.added)
    return motion


def wording_of(quantity: str) -> QuantitySpec | None:
    """Specification of a quantity of that name in Eivor's own motions; None without."""
    wordings = (motion_by_name(name).quantities.get(quantity) for name in _OWN)
    return next((wording for wording in wordings if wording is not None), None)


def _added() -> dict[str, Any]:
    from importlib.metadata import entry_points  # with what reads mail, which few names need

    return {point.name: point for point in entry_points(group=GROUP)}


def _loaded(point: Any) -> Motion[Any]:
    try:
        kind = point.load()
    except Exception as error:
        expected = f"a motion '{point.name}' that can be loaded from {point.value}"
        received = f"{type(error).__name__}: {error}"
        raise UsageError(expected, received, "Mend or update the package that brings it.") from error
    motion = kind() if isinstance(kind, type) and issubclass(kind, Motion) else kind
    if isinstance(motion, Motion) and motion.name == point.name:
        return motion
    received = f"one that is called '{motion.name}'" if isinstance(motion, Motion) else f"{kind!r}"
    remedy = "Mend the package that brings it: see docs/motions.md."
    raise UsageError(f"a motion called '{point.name}' at {point.value}", received, remedy)
