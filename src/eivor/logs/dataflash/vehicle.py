"""What kind of vehicle a DataFlash log is of: by the firmware's name, or its number of a kind."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eivor.logs.dataflash.messages import Messages
from eivor.signals.recording import ROTARY_WING

#: What the firmware calls itself, in small letters ("APM:Copter V3.4.4", "ArduPlane V4.5.7").
FIRMWARES = {
    "copter": ROTARY_WING,
    "plane": "fixed wing",
    "rover": "rover",
    "sub": "submarine",
    "blimp": "blimp",
    "antennatracker": "tracking antenna",
}
#: VER.BU, the kind of firmware.
BUILDS = {
    1: "rover",
    2: ROTARY_WING,
    3: "fixed wing",
    4: "tracking antenna",
    7: "submarine",
    12: "blimp",
    13: ROTARY_WING,
}
_PREFIXES = ("ardu", "apm:", "")


def vehicle_of(tables: Mapping[str, Messages]) -> str:
    """Kind of vehicle in words, empty when the log does not say.

    Parameters
    ----------
    tables : mapping of str to Messages
        By name.
    """
    version = tables.get("VER")
    if version is not None and version.has("BU"):
        kinds = [BUILDS[kind] for kind in np.unique(version.values("BU")).tolist() if kind in BUILDS]
        if kinds:
            return kinds[0]
    told = tables.get("MSG")
    for text in told.texts("Message") if told is not None and told.has("Message") else []:
        words = text.lower().split(" v", 1)
        for prefix in _PREFIXES:
            name = words[0].removeprefix(prefix).strip()
            if len(words) == 2 and name in FIRMWARES:
                return FIRMWARES[name]
    return ""
