"""PX4's simulator in hardware, SIH: parameters that make it fly as the vehicle does.

Of PX4's source: thrust of a motor is SIH_T_MAX times its signal, which lags by SIH_T_TAU, and drag is SIH_KDV
in every direction. Thrust goes linearly with the signal there, so THR_MDL_FAC is zero.
"""

from __future__ import annotations

from typing import final

from eivor.exports.fitted import Exported, Fitted, Supplied
from eivor.exports.px4 import PX4, qgroundcontrol
from eivor.exports.simulators.described import BODY, describe
from eivor.exports.simulators.quad_x import by_quarters, mean_distances
from eivor.exports.simulators.rotors import delay_comments
from eivor.exports.target import Target
from eivor.motions.vertical.model import GRAVITY

NAME = "SIH"
REMARKS = (
    "Thrust goes linearly with a motor's signal in SIH: THR_MDL_FAC is 0, for the simulation alone.",
    "SIH drags in every direction as along z.",
)


@final
class SihParameters(Target):
    """A file of QGroundControl for the simulation; not for the vehicle."""

    name = "sih"
    words = "PX4's simulator SIH (.params of QGroundControl): SIH_MASS, SIH_T_MAX, SIH_T_TAU, SIH_KDV, ..."
    ending = ".params"

    def export(self, fitted: Fitted, supplied: Supplied) -> Exported:
        """See `Target`."""
        made = describe(fitted, supplied, NAME, (*BODY, "largest_command"))
        by_quarters(made.vehicle, NAME)
        value = {name: float(column[0]) for name, column in made.values.items()}
        ahead, aside = mean_distances(made.vehicle)
        largest = value["thrust"] * float(made.thrust_map(made.values["largest_command"])[0])
        values = {
            "SIH_MASS": value["mass"],
            **{f"SIH_I{axes.upper()}": value[f"inertia_{axes}"] for axes in ("xx", "yy", "zz")},
            **dict.fromkeys(("SIH_IXY", "SIH_IXZ", "SIH_IYZ"), 0.0),
            "SIH_T_MAX": largest,
            "SIH_Q_MAX": value["torque_ratio"] * largest,
            "SIH_L_ROLL": value["arm_scale"] * aside,
            "SIH_L_PITCH": value["arm_scale"] * ahead,
            "SIH_T_TAU": value["actuator_lag"],
            **({"SIH_KDV": value["drag_z"]} if "drag_z" in value else {}),
            "THR_MDL_FAC": 0.0,
        }
        hover = value["mass"] * GRAVITY / (made.count * largest)
        remarks = [*REMARKS, *delay_comments(made, NAME)]
        beyond = PX4.hover.beyond((hover, (hover, hover)))
        if beyond:
            remarks.append(f"MPC_THR_HOVER is not written: {beyond}")
        else:
            values["MPC_THR_HOVER"] = hover
        return Exported(qgroundcontrol((*made.comments, *remarks), values), made.left_out)
