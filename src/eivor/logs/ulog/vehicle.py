"""What kind of vehicle a ULog is of, by PX4's own word or by the type that it tells ground stations."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eivor.logs.ulog.instances import Topic
from eivor.signals.recording import ROTARY_WING

#: vehicle_status.vehicle_type, how the vehicle moves at the time; 0 says nothing.
LOCOMOTION = {1: ROTARY_WING, 2: "fixed wing", 3: "rover", 4: "blimp"}
#: MAV_TYPE of what does not hover on rotors; types that are not here say nothing against it.
MAV_TYPES = {
    1.0: "fixed wing",
    7.0: "blimp",
    8.0: "balloon",
    9.0: "rocket",
    10.0: "rover",
    11.0: "boat",
    12.0: "submarine",
    16.0: "flapping wing",
    17.0: "kite",
}


def vehicle_of(topics: Mapping[str, Topic], parameters: Mapping[str, float]) -> str:
    """Kind of vehicle in words, empty when the log does not say.

    What flies on rotors at some time is one of rotary wings, whatever else it does: a convertible plane can
    be identified where it hovers.
    """
    status = topics.get("vehicle_status")
    told = status.fields.get("vehicle_type") if status is not None else None
    kinds = (
        [LOCOMOTION[kind] for kind in np.unique(told).tolist() if kind in LOCOMOTION]
        if told is not None
        else []
    )
    if kinds:
        return ROTARY_WING if ROTARY_WING in kinds else kinds[0]
    return MAV_TYPES.get(parameters.get("MAV_TYPE", 0.0), "")
