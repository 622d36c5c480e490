"""What a flight tells, what is true of it, and in which groups it is judged."""

from __future__ import annotations

from eivor.motions.rigid_body.dynamics import EffectiveParameters
from eivor.motions.rigid_body.vehicle import ALONG, COUPLING, DAMPING, DRAG, GAIN, LIFT, THRUST

LAG = "effective_lag"
GROUPS = {
    "torque gains": tuple(item.name for item in GAIN),
    "gyroscopic ratios": tuple(item.name for item in COUPLING),
    "rate damping": tuple(item.name for item in DAMPING),
    "lag": (LAG,),
    "thrust gain": (THRUST.name,),
    "vertical drag": (DRAG[ALONG.index("z")].name,),
    "horizontal drag": tuple(item.name for item in DRAG if not item.name.endswith("z")),
    "translational lift": (LIFT.name,),
}
#: A ratio nearer to zero than this is compared absolutely.
NEARLY_ZERO = 0.1


def truth_of(parameters: EffectiveParameters) -> dict[str, float]:
    """True value of every quantity that is judged."""
    selected = (
        *zip(GROUPS["torque gains"], parameters.torque_gains, strict=True),
        *zip(GROUPS["gyroscopic ratios"], parameters.gyroscopic_ratios, strict=True),
        *zip(GROUPS["rate damping"], parameters.rate_damping, strict=True),
        *zip((item.name for item in DRAG), parameters.drag, strict=True),
    )
    return {
        **dict(selected),
        THRUST.name: parameters.thrust_gain,
        LIFT.name: parameters.translational_lift,
        LAG: parameters.lag_up + parameters.delay,
    }


def unit_of_error(name: str, truth: float) -> float:
    """What errors of a quantity are told in: the truth, or one for a ratio that is nearly zero."""
    return 1.0 if name in GROUPS["gyroscopic ratios"] and abs(truth) < NEARLY_ZERO else abs(truth)
