"""What a flight of the vertical motion tells of a vehicle."""

from __future__ import annotations

from eivor.exports.fitted import Fitted, Number
from eivor.exports.simulators.parts import Part, Parts, itself, of_mass

#: Of the vertical motion, each with what is made of it.
GAIN, FRICTION, LAG, DELAY = "input_gain", "viscous_friction", "actuator_lag", "delay"


def vertical_parts(fitted: Fitted, given: dict[str, Number], count: int) -> Parts:
    """Thrust, drag along z, lag and delay.

    Parameters
    ----------
    fitted : Fitted
        Of the vertical motion.
    given : mapping of str to Number
        What the flight does not tell; the mass among it.
    count : int
        Number of rotors.
    """
    roots = {**given, **{name: one for name in (GAIN, FRICTION, LAG, DELAY) if (one := fitted.told(name))}}
    mass = given["mass"]
    told: dict[str, Part] = {}
    if GAIN in roots:
        each = of_mass(mass, roots[GAIN], 1.0 / count)
        told["thrust"] = Part(each, lambda c: c["mass"] * c[GAIN] / count)
    if FRICTION in roots:
        told["drag_z"] = Part(of_mass(mass, roots[FRICTION]), lambda c: c["mass"] * c[FRICTION])
    told |= {name: Part(roots[name], itself(name)) for name in (LAG, DELAY) if name in roots}
    made_of = {"thrust": GAIN, "drag_z": FRICTION, LAG: LAG, DELAY: DELAY}
    return Parts(told, {name: fitted.why_not(root) for name, root in made_of.items() if name not in told})
