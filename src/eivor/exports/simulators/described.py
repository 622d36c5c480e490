"""A vehicle for a simulator, out of a result and what is supplied: once, or once for each draw."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from eivor.errors import NotIdentifiedError, UsageError
from eivor.exports.fitted import VERTICAL, Fitted, Number, Supplied
from eivor.exports.simulators.bodily import bodily
from eivor.exports.simulators.of_vertical import vertical_parts
from eivor.exports.simulators.parts import DRAGS, INERTIAS, WORDS, Column, Columns, Part, Parts, itself
from eivor.inference.quantiles import normal_quantile
from eivor.motions.rigid_body.known_number import KnownNumber
from eivor.motions.rigid_body.known_vehicle import KnownVehicle
from eivor.motions.vertical.model import GRAVITY
from eivor.signals.input_map import InputMap

#: Name in documents of the other motion that tells a vehicle.
RIGID_BODY = "rigid_body"
#: What no vehicle flies without, beside mass and geometry.
BODY = ("thrust", "actuator_lag", *INERTIAS, "torque_ratio")
#: What may be given with --prior: in words of the flight, and of the vehicle.
FLIGHT = {
    VERTICAL: ("input_gain", "viscous_friction", "actuator_lag", "delay"),
    RIGID_BODY: ("thrust_gain", "actuator_lag", "delay"),
}
BESIDE = (*INERTIAS, "torque_ratio", "largest_command", "speed_scale")
MAY_BE_ZERO = ("viscous_friction", "actuator_lag", "delay", "torque_ratio")
#: What is given for a thrust, which is this times the mass.
GAINS = {VERTICAL: "input_gain", RIGID_BODY: "thrust_gain"}
#: Simulators divide by the lag, and fly off with a drag below zero.
LEAST = {"actuator_lag": 1e-3} | dict.fromkeys(DRAGS, 0.0)
#: What is given is drawn from a stream of its own, so that it leaves the flight's draws alone.
GIVEN_STREAM = 2
#: Least value of a draw of what is given, as a share of it.
LEAST_SHARE = 0.01


@dataclass(frozen=True)
class Described:
    """A vehicle for a simulator.

    Parameters
    ----------
    vehicle : KnownVehicle
        Where its rotors are.
    thrust_map : InputMap
        From a command to what thrust is proportional to.
    values : mapping of str to ndarray, shape (n,)
        By the names of `parts`; of one row, or of one for each draw.
    comments : tuple of str
        Where the numbers come from, each with its interval, and what is missing.
    left_out : tuple of str
        Those of the comments that say what the flight should have told.
    """

    vehicle: KnownVehicle
    thrust_map: InputMap
    values: Columns
    comments: tuple[str, ...]
    left_out: tuple[str, ...]

    @property
    def count(self) -> int:
        """Number of rotors."""
        return self.vehicle.count


def describe(
    fitted: Fitted,
    supplied: Supplied,
    target: str,
    needs: tuple[str, ...],
    draws: Columns | None = None,
    seed: int = 0,
) -> Described:
    """Vehicle of a result.

    Parameters
    ----------
    fitted : Fitted
        The result, of the vertical motion or of the rigid body.
    supplied : Supplied
        Mass, vehicle, and what the flight does not tell.
    target : str
        What messages call the simulator.
    needs : tuple of str
        Names of `parts` that it cannot do without, beside mass and geometry.
    draws : mapping of str to ndarray, shape (n,), optional
        Joint draws of the parameters; without them there is one row, of the estimates.
    seed : int
        Of draws of what is given.

    Raises
    ------
    NotIdentifiedError
        With all that is missing, and how to give it.
    UsageError
        When the result is of another motion, or a prior is of no use.
    ParameterError
        When the inertia is that of no body.
    """
    if fitted.model not in FLIGHT:
        raise UsageError(
            f"a result of the vertical motion or the rigid body for {target}",
            f"one of {fitted.model}",
            "Identify the log with --model vertical or rigid-body.",
        )
    supplied.check_only((*FLIGHT[fitted.model], *BESIDE), target, body=True)
    _check_signs(supplied)
    vehicle = _vehicle(fitted, supplied, target)
    given = _given(fitted, supplied, vehicle)
    parts = _parts(fitted, given, vehicle)
    told = {**{name: Part(one, itself(name)) for name, one in given.items() if name in WORDS}, **parts.told}
    lacking = [name for name in needs if name not in told]
    if lacking:
        raise _lacks(lacking, parts, fitted, target)
    columns = _columns(fitted, given, told, draws, seed)
    values, changed = bodily({name: _at_least(name, one.column(columns)) for name, one in told.items()})
    gone = {name: f"{name} is not written: {why}" for name, why in parts.missing.items() if name not in told}
    numbers = (f"{words}: {told[name].number.words}" for name, words in WORDS.items() if name in told)
    comments = (*fitted.origin(), f"Vehicle: {vehicle.name}.", *numbers, *changed, *gone.values())
    return Described(vehicle, fitted.input_map, values, comments, tuple(gone.values()))


def _check_signs(supplied: Supplied) -> None:
    """Refuse what no vehicle has."""
    for name, one in supplied.priors.items():
        if one.value < 0.0 or (one.value == 0.0 and name not in MAY_BE_ZERO):
            raise UsageError(f"a {name} above zero", f"{one.value:g}", "Correct the prior.")


def _vehicle(fitted: Fitted, supplied: Supplied, target: str) -> KnownVehicle:
    """Whose rotors and mass are known."""
    vehicle = supplied.vehicle or fitted.vehicle
    mass = supplied.mass is not None or (vehicle is not None and vehicle.mass is not None)
    if vehicle is not None and mass and vehicle.in_metres:
        return vehicle
    lacks = [] if mass else ["a mass (--mass 1.53:0.02)"]
    lacks += [] if vehicle is not None else ["where the rotors are (--vehicle FILE.toml)"]
    lacks += [] if vehicle is None or vehicle.in_metres else ["the arm's length (in the vehicle's file)"]
    raise NotIdentifiedError(
        f"what no flight tells, for {target}: {' and '.join(lacks)}",
        "none" if vehicle is None else f"the vehicle '{vehicle.name}'",
        "Give it; `eivor vehicle new` writes a vehicle's file to begin with.",
    )


def _given(fitted: Fitted, supplied: Supplied, vehicle: KnownVehicle) -> dict[str, Number]:
    """What is supplied and the flight does not tell, the priors before the vehicle's file."""
    known = {
        name: one
        for name in ("mass", "arm_scale", "speed_scale", "torque_ratio", "yaw_inertia_ratio")
        if (one := getattr(vehicle, name)) is not None
    }
    known.setdefault("speed_scale", KnownNumber(1.0))
    if _hovers_with_a_share(fitted, vehicle):
        known["largest_command"] = KnownNumber(1.0)
    known |= {name: one for name, one in supplied.priors.items() if fitted.told(name) is None}
    if supplied.mass is not None:
        known["mass"] = supplied.mass
    return {name: Number(one.value, one.interval, "given") for name, one in known.items()}


def _hovers_with_a_share(fitted: Fitted, vehicle: KnownVehicle) -> bool:
    """Whether commands are shares of the largest, as autopilots have them."""
    gain = fitted.told(GAINS[fitted.model])
    if gain is None or fitted.input_measured:
        return False
    rotors = 1 if fitted.model == VERTICAL else vehicle.count
    return fitted.input_map.inverse(GRAVITY / (rotors * gain.value)) < 1.0


def _parts(fitted: Fitted, given: dict[str, Number], vehicle: KnownVehicle) -> Parts:
    if fitted.model == VERTICAL:
        return vertical_parts(fitted, given, vehicle.count)
    from eivor.exports.simulators.of_rigid_body import rigid_body_parts

    return rigid_body_parts(fitted, given, vehicle, _std(given["mass"]))


def _lacks(lacking: Iterable[str], parts: Parts, fitted: Fitted, target: str) -> NotIdentifiedError:
    """Say all that is missing at once."""
    reasons = " ".join(parts.missing.get(name, f"No flight of this kind tells {name}.") for name in lacking)
    asked = {"thrust": GAINS[fitted.model]}
    priors = " ".join(f"--prior {asked.get(name, name)}=VALUE:STD" for name in lacking)
    words = ", ".join(WORDS[name] for name in lacking)
    return NotIdentifiedError(
        f"{words}: identified, or given, since {target} cannot do without",
        reasons.rstrip("."),
        f"Give what is known: {priors}",
    )


def _columns(
    fitted: Fitted, given: dict[str, Number], told: dict[str, Part], draws: Columns | None, seed: int
) -> dict[str, Column]:
    """Columns of all that the parts rest on."""
    if draws is None:
        joint = {name: one.value for name, one in fitted.quantities.items()}
        given_values = {name: one.value for name, one in given.items()}
        return {name: np.array([value]) for name, value in (joint | given_values).items()}
    count = next(iter(draws.values())).size
    rng = np.random.default_rng([seed, GIVEN_STREAM])
    columns = {name: np.full(count, part.number.value) for name, part in told.items()}
    for name, one in given.items():
        drawn = one.value + _std(one) * rng.standard_normal(count)
        columns[name] = np.maximum(drawn, LEAST_SHARE * one.value)
    return columns | {name: column for name, column in draws.items() if fitted.told(name) is not None}


def _std(one: Number) -> float:
    """Standard deviation of what is given."""
    return (one.interval[1] - one.interval[0]) / (2.0 * normal_quantile(0.95))


def _at_least(name: str, column: Column) -> Column:
    return np.maximum(column, LEAST[name]) if name in LEAST else column
