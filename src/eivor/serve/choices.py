"""What the page may ask for, with words for people, out of the tables that say what there is."""

from __future__ import annotations

import inspect

from eivor.estimation.methods import TABLE
from eivor.exports.targets import TARGETS
from eivor.logs.channel_map import shipped_maps
from eivor.motions import motion_by_name, motion_names
from eivor.motions.rigid_body.vehicle_file import load_vehicle, shipped_vehicles
from eivor.planning.written.formats import WRITTEN


def choices() -> dict[str, list[dict[str, object]]]:
    """Models, methods, maps, vehicles, targets of exports and kinds of plans."""
    return {
        "models": [_named(name, motion_by_name(name).words.title) for name in motion_names()],
        "methods": [_named(name, _first_line(made)) for name, made in TABLE.items()],
        "maps": [_named(name, name) for name in shipped_maps()],
        "vehicles": [_named(name, load_vehicle(name).name) for name in shipped_vehicles()],
        "targets": [
            {**_named(name, one.words), "file": f"{name}{one.ending}"} for name, one in TARGETS.items()
        ],
        "plans": [
            {
                **_named(name, one.words),
                "file": one.file,
                "needs": [] if one.of_place is None else ["home"],
            }
            for name, one in WRITTEN.items()
        ],
    }


def _named(name: str, words: str) -> dict[str, object]:
    return {"name": name, "words": words}


def _first_line(made: object) -> str:
    return (inspect.getdoc(made) or "").partition("\n")[0].rstrip(".")
