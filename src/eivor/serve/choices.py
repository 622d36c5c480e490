"""What the page may ask for, with words for people, out of the tables that say what there is."""

from __future__ import annotations

import inspect

from eivor.estimation.methods import TABLE
from eivor.exports.targets import TARGETS
from eivor.fleets.logs_found import FURTHER_ENDINGS
from eivor.logs.bags.files import ENDINGS as BAG_ENDINGS
from eivor.logs.bags.files import METADATA
from eivor.logs.channel_map import shipped_maps
from eivor.logs.formats import readable_formats
from eivor.logs.ulog.csv_names import TOPIC_TABLE, ULOG_ENDINGS
from eivor.motions import motion_by_name, motion_names
from eivor.motions.rigid_body.vehicle_file import load_vehicle, shipped_vehicles
from eivor.planning.written.formats import WRITTEN
from eivor.serve.sent_files import MOST_FILES


def choices() -> dict[str, object]:
    """Models, methods, maps, vehicles, targets of exports, kinds of plans, and what logs are in folders."""
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
        "folders": _folders(),
    }


def _folders() -> dict[str, object]:
    """By which names files of a folder are told to be logs, or one log together."""
    endings = {end for one in readable_formats() for end in one.endings}
    return {
        "endings": sorted({*endings, *FURTHER_ENDINGS, ".csv"}),
        "bags": BAG_ENDINGS,
        "metadata": METADATA,
        "tables": TOPIC_TABLE,
        "beside": ULOG_ENDINGS,
        "most": MOST_FILES,
    }


def _named(name: str, words: str) -> dict[str, object]:
    return {"name": name, "words": words}


def _first_line(made: object) -> str:
    return (inspect.getdoc(made) or "").partition("\n")[0].rstrip(".")
