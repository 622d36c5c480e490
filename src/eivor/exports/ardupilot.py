"""Parameters of ArduPilot, one name and value in a line."""

from __future__ import annotations

from typing import final

from eivor.exports.autopilot_parameters import Autopilot, chosen_parameters
from eivor.exports.comments import hash_comments
from eivor.exports.fitted import Exported, Fitted, Supplied
from eivor.exports.px4 import single
from eivor.exports.target import Target
from eivor.motions.vertical.curve_family import MOT_THST_EXPO, AutopilotParameter

#: MOT_THST_HOVER is documented from 0.2 to 0.8, and the motors' library uses no more than 0.6875 of it.
ARDUPILOT = Autopilot(
    "ArduPilot", AutopilotParameter("MOT_THST_HOVER", "ArduPilot", 0.2, 0.6875), MOT_THST_EXPO, ("ulog",)
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
