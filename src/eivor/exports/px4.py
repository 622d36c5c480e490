"""Parameters of PX4 in the file format of QGroundControl."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import final

import numpy as np

from eivor.exports.autopilot_parameters import Autopilot, chosen_parameters
from eivor.exports.comments import hash_comments
from eivor.exports.fitted import Exported, Fitted, Supplied
from eivor.exports.target import Target
from eivor.motions.vertical.curve_family import THR_MDL_FAC, AutopilotParameter

PX4 = Autopilot("PX4", AutopilotParameter("MPC_THR_HOVER", "PX4", 0.1, 0.8), THR_MDL_FAC, ("dataflash",))
#: MAVLink's type of a 32-bit float, and who is addressed: the vehicle and its autopilot.
REAL32, VEHICLE, COMPONENT = 9, 1, 1
HEADER = "# Vehicle-Id Component-Id Name Value Type"


@final
class Px4Parameters(Target):
    """Comments, a header, and lines of five fields with tabs between them."""

    name = "px4"
    words = "PX4 parameters (.params of QGroundControl): MPC_THR_HOVER, THR_MDL_FAC"
    ending = ".params"

    def export(self, fitted: Fitted, supplied: Supplied) -> Exported:
        """See `Target`."""
        supplied.check_only((), self.name, body=False)
        found = chosen_parameters(fitted, PX4)
        rows = {name: number.value for name, number in found.written}
        return Exported(qgroundcontrol(found.comments, rows), found.left_out)


def qgroundcontrol(comments: Iterable[str], values: Mapping[str, float]) -> str:
    """File of QGroundControl with parameters that are 32-bit floats."""
    rows = (f"{VEHICLE}\t{COMPONENT}\t{name}\t{single(value)}\t{REAL32}" for name, value in values.items())
    return "\n".join([*hash_comments(comments), "#", HEADER, *rows]) + "\n"


def single(value: float) -> str:
    """Fewest digits that give back the 32-bit float, without an exponent."""
    return np.format_float_positional(np.float32(value), trim="0")
