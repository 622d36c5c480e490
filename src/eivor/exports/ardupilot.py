"""Parameters of ArduPilot, one name and value in a line."""

from __future__ import annotations

from typing import final

from eivor.exports.autopilot_parameters import Autopilot, Parameter, chosen_parameters
from eivor.exports.comments import hash_comments
from eivor.exports.fitted import Exported, Fitted, Supplied
from eivor.exports.px4 import single
from eivor.exports.target import Target

ARDUPILOT = Autopilot(
    "ArduPilot", Parameter("MOT_THST_HOVER", 0.2, 0.8), Parameter("MOT_THST_EXPO", -1.0, 1.0), ("ulog",)
)


@final
class ArduPilotParameters(Target):
    """Comments stand on lines of their own: older readers split lines at blanks."""

    name = "ardupilot"
    words = "ArduPilot parameters (.param): MOT_THST_HOVER, MOT_THST_EXPO"
    ending = ".param"

    def export(self, fitted: Fitted, supplied: Supplied) -> Exported:
        """See `Target`."""
        supplied.check_only((), self.name, body=False)
        found = chosen_parameters(fitted, ARDUPILOT)
        rows = [f"{name},{single(number.value)}" for name, number in found.written]
        return Exported("\n".join([*hash_comments(found.comments), *rows]) + "\n", found.left_out)
