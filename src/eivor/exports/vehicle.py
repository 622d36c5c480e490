"""Description of a simulated vehicle made from a result."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import Any

import numpy as np

from eivor.errors import NotIdentifiedError, ParameterError, UsageError
from eivor.exports.fitted import VERTICAL, Exported, Fitted, Number, Supplied, listed, rendered
from eivor.inference.covariance import CovariancePart, JointCovariance, JointEstimate
from eivor.inference.distributions import normal_quantile
from eivor.motions.rigid_body import physical_parameters as physical
from eivor.motions.rigid_body.dynamics import Coefficients, coefficients_of
from eivor.motions.rigid_body.regression import PRODUCT
from eivor.motions.rigid_body.vehicle import (
    NO_BODY_UNCERTAINTY,
    BodyDrag,
    KnownNumber,
    KnownVehicle,
    Rotors,
    Vehicle,
)
from eivor.signals.recording import GRAVITY
from eivor.signals.thrust_map import InputMap
from eivor.simulation.rigid_body import STILL, runge_kutta
from eivor.strict_toml import package_tables
from eivor.tools import Float

# -- Parts --

Column = Float[np.ndarray, " n"]
Columns = Mapping[str, Column]

TABLES = package_tables("eivor.exports", "vehicle.toml")
#: What each number is, in the order of files.
WORDS: Mapping[str, str] = TABLES["words"]
#: What not every simulator has, and what each lacks; see the file.
EFFECTS: Mapping[str, Mapping[str, Any]] = TABLES["effects"]
LACKS: Mapping[str, list[str]] = TABLES["lacks"]
#: Comments of files.
REMARKS: Mapping[str, Any] = TABLES["remarks"]
INERTIAS = ("inertia_xx", "inertia_yy", "inertia_zz")
DRAGS = ("drag_x", "drag_y", "drag_z")
CENTRE = ("centre_of_mass_forward", "centre_of_mass_left")
TORQUES = ("roll_drag", "pitch_drag", "yaw_drag")
QUADRATIC = ("quadratic_drag_x", "quadratic_drag_y", "quadratic_drag_z")
BEYOND = ("translational_lift", "rotor_inertia")
HEIGHT = "drag_height"


@dataclass(frozen=True)
class SimulatorNumber:
    """A number of the vehicle."""

    number: Number
    column: Callable[[Columns], Column]


# -- Physical quantities --

#: Simulators compare without allowance for rounding.
MARGIN = 1e-6


def realisable_inertia(values: Columns) -> tuple[Columns, tuple[str, ...]]:
    """Columns whose moments of inertia are those of bodies."""
    if not all(name in values for name in INERTIAS):
        return values, ()
    moments = np.stack([values[name] for name in INERTIAS])
    others = moments.sum(axis=0) - moments
    excess = (moments / others).max(axis=0) - 1.0
    bounded = np.minimum(moments, others * (1.0 - MARGIN))
    realisable = {**values, **dict(zip(INERTIAS, bounded, strict=True))}
    if moments.shape[1] > 1 or excess[0] <= 0.0:
        return realisable, ()
    text = ", ".join(f"{moment:.4g}" for moment in moments[:, 0])
    if excess[0] > NO_BODY_UNCERTAINTY:
        expected = "moments of inertia none of which is larger than the other two together"
        remedy = "Correct what is given of them; or fly as the report says, about two axes at once."
        raise ParameterError(expected, f"{text} kg m^2", remedy)
    return realisable, (
        f"Moments of inertia {text} are those of no body: the largest is put at the sum of the others.",
    )


# -- Vehicle description --

#: What is identified, no simulator has, and no free flight of half a second shows.
ELSEWHERE = ("ground_effect", "voltage_exponent", *(item.name for item in PRODUCT))
#: Name in documents of the other motion that identifies a vehicle.
RIGID_BODY = "rigid_body"
#: What no vehicle flies without, beside mass and geometry.
BODY = ("thrust", "actuator_lag", *INERTIAS, "torque_ratio")
#: What the flight identifies of the vehicle's numbers at once, by its own name.
MADE_OF: Mapping[str, Mapping[str, str]] = TABLES["made_of"]
#: What few flights show: left out where the interval holds zero.
RARE = ("quadratic_drag_z", "second_lag", "lag_asymmetry")
#: What may be given with --prior beside these.
BESIDE = (*INERTIAS, "torque_ratio", "largest_command", "speed_scale")
MAY_BE_ZERO = ("viscous_friction", "actuator_lag", "delay", "torque_ratio")
#: Simulators divide by the lag, and fly off with a drag below zero.
LEAST = {"actuator_lag": 1e-3} | dict.fromkeys((*DRAGS, *TORQUES, *QUADRATIC, *BEYOND), 0.0)
#: Least value of a draw of what is given, as a share of it.
LEAST_SHARE = 0.01


@dataclass(frozen=True)
class VehicleDescription:
    """A vehicle for a simulator."""

    vehicle: KnownVehicle
    thrust_map: InputMap
    values: Columns  # shape (n,)
    comments: tuple[str, ...]
    omitted: tuple[str, ...]  # What the flight does not identify
    lost: tuple[str, ...] = ()  # What the simulator cannot hold
    none: Mapping[str, float] = field(default_factory=dict)  # Bounds of torques that were measured as none


def describe(
    fitted: Fitted,
    supplied: Supplied,
    target: str,
    needs: tuple[str, ...],
    draws: Columns | None = None,
    seed: int = 0,
    also: tuple[str, ...] = (),
) -> VehicleDescription:
    """Vehicle of a result for a simulator, with what it lacks, also beside those of `LACKS`."""
    if fitted.model not in MADE_OF:
        expected = f"a result of the vertical motion or the rigid body for {target}"
        remedy = "Identify the log with --model vertical or rigid-body."
        raise UsageError(expected, f"one of {fitted.model}", remedy)
    supplied.check_only((*MADE_OF[fitted.model].values(), *BESIDE), target, body=True)
    for name, prior in supplied.priors.items():
        if prior.value < 0.0 or (prior.value == 0.0 and name not in MAY_BE_ZERO):
            raise UsageError(f"a {name} above zero", f"{prior.value:g}", "Correct the prior.")
    vehicle = _vehicle(fitted, supplied, target)
    priors = _prior_numbers(fitted, supplied, vehicle)
    parts, missing, bounds = _parts(fitted, priors, vehicle)
    selected = {
        **{name: SimulatorNumber(item, itemgetter(name)) for name, item in priors.items() if name in WORDS},
        **parts,
    }
    lacking = [name for name in needs if name not in selected]
    if lacking:
        raise _lacks(lacking, missing, fitted, target)
    columns = _columns(fitted, priors, selected, draws, seed)
    values, changed = realisable_inertia(
        {name: np.maximum(item.column(columns), LEAST.get(name, -np.inf)) for name, item in selected.items()}
    )
    unwritten = _not_written(fitted, {name: why for name, why in missing.items() if name not in selected})
    numbers = (f"{words}: {selected[name].number.words}" for name, words in WORDS.items() if name in selected)
    comments = (*fitted.origin(), f"Vehicle: {vehicle.name}.", *numbers, *bounds, *changed, *unwritten)
    bounded = {name: selected[name].number for name in TORQUES if name in selected}
    none = {name: max(item.interval[1], 0.0) for name, item in bounded.items() if item.value == 0.0}
    craft = VehicleDescription(vehicle, fitted.input_map, values, comments, unwritten, none=none)
    hover = fitted.input_map.inverse(float(mapped_hover(craft)[0])) if "thrust" in values else 0.0
    if (peak := float(values.get("largest_command", [math.inf])[0])) <= hover:
        raise UsageError(f"a largest command above that at hover, {hover:.6g}", f"{peak:.6g}", "Correct it.")
    lacks = (*LACKS.get(target, LACKS["others"]), *also)
    lost = (*_neglected(craft, target, lacks), *fitted.left_over(target, ELSEWHERE)) if draws is None else ()
    return replace(craft, comments=(*comments, *lost), lost=lost)


def _vehicle(fitted: Fitted, supplied: Supplied, target: str) -> KnownVehicle:
    vehicle = supplied.vehicle or fitted.vehicle
    mass = supplied.mass is not None or (vehicle is not None and vehicle.mass is not None)
    if vehicle is not None and mass and vehicle.arm_scale is not None:
        return vehicle
    lacks = [] if mass else ["a mass (--mass 1.53:0.02)"]
    lacks += [] if vehicle is not None else ["where the rotors are (--vehicle FILE.toml)"]
    if vehicle is not None and vehicle.arm_scale is None:
        lacks.append("the arm's length (in the vehicle's file)")
    expected = f"for {target}, what a flight does not identify: {' and '.join(lacks)}"
    remedy = "Give it; `eivor vehicle new` writes a vehicle's file to begin with."
    raise NotIdentifiedError(expected, "none" if vehicle is None else f"the vehicle '{vehicle.name}'", remedy)


def _prior_numbers(fitted: Fitted, supplied: Supplied, vehicle: KnownVehicle) -> dict[str, Number]:
    """Priors and the vehicle's numbers, of what the flight does not identify."""
    known = {
        name: item
        for name in ("mass", "arm_scale", "speed_scale", "torque_ratio", "yaw_inertia_ratio")
        if (item := getattr(vehicle, name)) is not None
    }
    known.setdefault("speed_scale", KnownNumber(1.0))
    gain = fitted.identified_number(MADE_OF[fitted.model]["thrust"])
    if gain is not None and not fitted.input_measured:  # commands may be shares, as autopilots have them
        rotors = 1 if fitted.model == VERTICAL else vehicle.count
        if fitted.input_map.inverse(GRAVITY / (rotors * gain.value)) < 1.0:
            known["largest_command"] = KnownNumber(1.0)
    known |= {
        name: prior for name, prior in supplied.priors.items() if fitted.identified_number(name) is None
    }
    if supplied.mass is not None:
        known["mass"] = supplied.mass
    return {name: Number(entry.value, entry.interval, "given") for name, entry in known.items()}


#: Why a number is missing: the quantities that the flight does not identify, or a sentence.
Missing = Mapping[str, tuple[str, ...] | str]


def _not_written(fitted: Fitted, missing: Missing) -> tuple[str, ...]:
    groups: dict[object, tuple[list[str], dict[str, None]]] = {}
    for name, why in missing.items():
        roots = () if isinstance(why, str) else why
        items = [fitted.quantities.get(root) for root in roots]
        reasons = dict.fromkeys((item.verdict, item.reasons) if item else None for item in items)
        names, all_roots = groups.setdefault(tuple(reasons) if roots else why, ([], {}))
        names.append(name)
        all_roots |= dict.fromkeys(roots)
    return tuple(
        f"{listed(names)} not written: {fitted.why_not(*roots) if roots else reasons}"
        for reasons, (names, roots) in groups.items()
    )


def _lacks(lacking: Iterable[str], missing: Missing, fitted: Fitted, target: str) -> NotIdentifiedError:
    unknown = ", ".join(name for name in lacking if name not in missing)
    whys = [missing[name] for name in lacking if name in missing]
    whys += [f"No flight of this kind determines {unknown}."] if unknown else []
    roots = dict.fromkeys(root for why in whys if not isinstance(why, str) for root in why)
    texts = (sentence for why in whys if isinstance(why, str) for sentence in re.split(r"(?<=\.) ", why))
    reasons = " ".join([fitted.why_not(*roots), *dict.fromkeys(texts)])
    formulas = {"thrust": MADE_OF[fitted.model]["thrust"]}
    priors = " ".join(f"--prior {formulas.get(name, name)}=VALUE:STD" for name in lacking)
    words = ", ".join(WORDS[name] for name in lacking)
    expected = f"{words}, identified or given, which {target} cannot do without"
    remedy = f"Give what is known: {priors}.{fitted.acceptance(*roots)}"
    return NotIdentifiedError(expected, f"none. {reasons.strip().rstrip('.')}", remedy)


def _columns(
    fitted: Fitted,
    priors: dict[str, Number],
    parts: dict[str, SimulatorNumber],
    draws: Columns | None,
    seed: int,
) -> dict[str, Column]:
    if draws is None:
        joint = {name: quantity.value for name, quantity in fitted.quantities.items()}
        given_values = {name: item.value for name, item in priors.items()}
        return {name: np.array([value]) for name, value in (joint | given_values).items()}
    count = next(iter(draws.values())).size
    rng = np.random.default_rng([seed, 2])  # independent of the draws of the flight
    columns = {name: np.full(count, part.number.value) for name, part in parts.items()}
    for name, entry in priors.items():
        samples = entry.value + _std(entry) * rng.standard_normal(count)
        columns[name] = np.maximum(samples, LEAST_SHARE * entry.value)
    return columns | {name: column for name, column in draws.items() if fitted.identified_number(name)}


def _std(number: Number) -> float:
    return (number.interval[1] - number.interval[0]) / (2.0 * normal_quantile(0.95))


# -- Parts of a vehicle --

PHYSICAL = (*INERTIAS, *DRAGS, "torque_ratio")
#: Left out where a flight does not distinguish them from zero; a centre of mass may lie on any side.
FURTHER = (*CENTRE, *TORQUES, *QUADRATIC, *BEYOND)
#: In the mean of what the drag along y turns about x, and the drag along x about y.
_HEIGHT = physical.Formula(
    "0.5 * ({roll} * roll_by_drag_y / drag_y - {pitch} * pitch_by_drag_x / drag_x)".format(**physical.TILTING)
)


def _parts(
    fitted: Fitted, priors: dict[str, Number], vehicle: KnownVehicle
) -> tuple[dict[str, SimulatorNumber], dict[str, tuple[str, ...] | str], tuple[str, ...]]:
    """Parts that a flight identifies, reasons for those that it does not, and sentences on bounds."""
    parts: dict[str, SimulatorNumber] = {}
    missing: dict[str, tuple[str, ...] | str] = {}
    bounds: list[str] = []
    if fitted.model == RIGID_BODY:
        mass, speed = (KnownNumber(priors[key].value, _std(priors[key])) for key in ("mass", "speed_scale"))
        known_vehicle = replace(vehicle, mass=mass, speed_scale=speed)
        identified = _identified(fitted)
        implied = physical.physical_parameters(identified, known_vehicle)
        for name in (*PHYSICAL, *FURTHER):
            number, formula = implied.numbers[name], implied.formulas[name]
            value, interval = number.value, number.interval
            if (
                value is not None
                and interval is not None
                and (name in CENTRE or (value > 0.0 and (name in PHYSICAL or interval[0] > 0.0)))
            ):
                source = f"{fitted.source(*formula.needed)}. {number.sentence}"
                parts[name] = SimulatorNumber(Number(value, interval, source), formula.expression.evaluate)
            elif name in PHYSICAL:
                missing[name] = fitted.lacking(formula.needed) or number.sentence
            elif name in TORQUES and interval is not None:
                source = f"{fitted.source(*formula.needed)}, not distinguished from zero"
                parts[name] = SimulatorNumber(Number(0.0, interval, source), lambda row: 0.0 * row["mass"])
            else:
                bounds.extend(_bound_sentences(fitted, WORDS[name], formula, interval))
        parts |= _height(fitted, identified, known_vehicle)
    for name, root in MADE_OF[fitted.model].items():
        root_number = fitted.identified_number(root) or priors.get(root)
        if root_number is None:
            if name not in RARE or root in fitted.quantities:
                missing[name] = (root,)
        elif name not in RARE or root_number.excludes_zero:
            parts[name] = _root(root_number, name, root, priors["mass"], vehicle.count)
    return parts, missing, tuple(bounds)


def _bound_sentences(
    fitted: Fitted, words: str, formula: physical.Formula, interval: tuple[float, float] | None
) -> Iterator[str]:
    if interval is not None:
        yield f"{words}: below {max(interval[1], 0.0):.3g}, left out"
    elif set(formula.needed) <= fitted.quantities.keys():
        yield f"{words}: left out. {fitted.why_not(*fitted.lacking(formula.needed))}"


def _root(number: Number, name: str, root: str, mass: Number, rotors: int) -> SimulatorNumber:
    """A quantity of a flight, or the mass times one per mass; both err independently."""
    if name not in {"thrust", "drag_z", "quadratic_drag_z"}:
        return SimulatorNumber(number, itemgetter(root))
    share = 1.0 / rotors if root == "input_gain" else 1.0
    value = share * mass.value * number.value
    below, above = (
        share
        * math.hypot(
            number.value * (mass.interval[side] - mass.value),
            mass.value * (number.interval[side] - number.value),
        )
        for side in (0, 1)
    )
    product = Number(value, (value - below, value + above), f"{number.source}, times the mass as given")
    return SimulatorNumber(product, lambda columns: columns["mass"] * columns[root] * share)


def _height(
    fitted: Fitted, identified: physical.Combinations, known_vehicle: KnownVehicle
) -> dict[str, SimulatorNumber]:
    """Rotors above the centre of mass, where a flight distinguishes them from ones in its plane."""
    if not identified.has(*_HEIGHT.needed) or _HEIGHT.missing(known_vehicle):
        return {}
    height = identified.value(_HEIGHT, known_vehicle)
    number = Number(height.value, height.interval, fitted.source(*_HEIGHT.needed))
    is_distinct = physical.differs_from_zero(height.interval)
    return {HEIGHT: SimulatorNumber(number, _HEIGHT.expression.evaluate)} if is_distinct else {}


def _identified(fitted: Fitted) -> physical.Combinations:
    if fitted.joint is None:
        nothing = JointCovariance((CovariancePart("nothing", np.empty((0, 0))),))
        return physical.Combinations((), JointEstimate(np.empty(0), nothing))
    names = frozenset(name for name in fitted.names if fitted.is_identified(name))
    return physical.Combinations(fitted.names, fitted.joint).only(names).reaching(fitted.quantities)


# -- Quad x --

#: Signs of the places forward and left: front right, rear right, rear left, front left.
QUARTERS = ((1, -1), (-1, -1), (-1, 1), (1, 1))


def by_quarters(vehicle: KnownVehicle, target: str) -> tuple[int, ...]:
    """Numbers of the rotors, from zero, in the order of `QUARTERS`."""
    order = [
        number
        for forward, left in QUARTERS
        for number, (x, y) in enumerate(vehicle.positions)
        if x * forward > 0.0 and y * left > 0.0
    ]
    spins = [vehicle.spins[number] for number in order]
    if vehicle.count != len(QUARTERS) or spins not in ([1, -1, 1, -1], [-1, 1, -1, 1]):
        expected = f"four rotors for {target}, one in each quarter, neighbours of opposite spins"
        remedy = "Export to another simulator: mujoco, rotorpy, pybullet and gazebo take rotors anywhere."
        raise UsageError(expected, f"rotors at {vehicle.positions} with spins {vehicle.spins}", remedy)
    return tuple(order)


def mean_distances(vehicle: KnownVehicle) -> tuple[float, float]:
    """Mean distance of the rotors forward or behind, and to a side [m]."""
    forward, sideways = np.abs(vehicle.positions).mean(axis=0).tolist()
    return forward, sideways


# -- Replay --

REPLAY_S, REPLAY_STEP_S = 0.5, 0.005
#: What the replay reaches, and the speed along both axes that it starts with [m/s].
REPLAY_TILT, REPLAY_SPEED = math.radians(30.0), 2.0


def first_row(columns: Columns) -> dict[str, float]:
    """The first row."""
    return {name: float(column[0]) for name, column in columns.items()}


def rotor_positions(craft: VehicleDescription) -> Float[np.ndarray, "n rotors 2"]:
    """Rotor positions about the centre of mass, forward and left, of each vehicle [m]."""
    values, zero = craft.values, np.zeros_like(craft.values["mass"])
    centre = np.stack([values.get(name, zero) for name in CENTRE], axis=-1)
    return values["arm_scale"][:, None, None] * np.array(craft.vehicle.positions) - centre[:, None, :]


def rotor_damping(craft: VehicleDescription, share_along: float = 1.0) -> Float[np.ndarray, "3 n"]:
    """Torque of the rotors' drag against turning about each axis in hover [N m/(rad/s)]."""
    rotors, height = rotors_of(craft), craft.values.get(HEIGHT, np.zeros(1))
    across, along = (rotors["hover_speed"] * rotors[name] for name in ("drag_across", "drag_along"))
    along, (forward, left) = share_along * along, np.square(rotor_positions(craft)).sum(axis=1).T
    raised = craft.vehicle.count * across * height**2
    return np.stack([along * left + raised, along * forward + raised, across * (forward + left)])


#: Rotors of a fitted vehicle reach this many times their speed at hover, where no largest command is given.
REACH = 2.0


def _modelled(craft: VehicleDescription, *, lever: bool) -> tuple[Vehicle, list[tuple[float, ...]]]:
    """Simulator vehicle of the first row, and drags of its body; `lever`: rotors drag at their positions."""
    value, rotor, positions = first_row(craft.values), first_row(rotors_of(craft)), rotor_positions(craft)[0]
    damping = rotor_damping(craft)[:, 0] if lever else np.zeros(3)
    drag = np.array([value.get(name, 0.0) for name in DRAGS])
    torque = np.array([value.get(*pair) for pair in zip(TORQUES, damping.tolist(), strict=True)]) - damping
    across, along = (rotor[name] if lever else 0.0 for name in ("drag_across", "drag_along"))
    height = value.get(HEIGHT, 0.0) if lever else 0.0
    rotor_drag = craft.vehicle.count * rotor["hover_speed"] * np.array([across, across, along])
    largest, (lag_up, lag_down) = rotor["largest_speed"], rotor_lags(value)
    rotors = Rotors(
        positions=tuple((x, y, height) for x, y in positions.tolist()),
        spins=craft.vehicle.spins,
        highest_speed=largest if math.isfinite(largest) else REACH * rotor["hover_speed"],
        thrust_quadratic=rotor["thrust_constant"],
        torque_ratio=value["torque_ratio"],
        lag_up=lag_up,
        lag_down=lag_down,
        inertia=value.get("rotor_inertia", 0.0),
        delay=value.get("delay", 0.0),
        drag=across,
        inflow=along,
        translational_lift=value.get("translational_lift", 0.0) / craft.vehicle.count,
    )
    quadratic = [value.get(name, 0.0) for name in QUADRATIC]
    drags = [tuple(part) for part in ((drag - rotor_drag).tolist(), quadratic, torque.tolist())]
    damped = (tuple(max(item, 0.0) for item in part) for part in drags)
    inertia = tuple(value[name] for name in INERTIAS)
    return Vehicle(value["mass"], inertia, rotors, BodyDrag(*damped)), drags


def rotor_lags(value: Mapping[str, float]) -> tuple[float, float]:
    """Lags towards higher and towards lower speeds [s]."""
    lag, asymmetry = value.get("actuator_lag", LEAST["actuator_lag"]), value.get("lag_asymmetry", 0.0)
    return lag / (1.0 + asymmetry), lag / (1.0 - asymmetry)


def simulated_vehicle(craft: VehicleDescription) -> Vehicle:
    """The first vehicle for Eivor's own simulator; what takes energy out is no less than zero."""
    turned = zip(TORQUES, rotor_damping(craft)[:, 0], strict=True)
    return _modelled(craft, lever=all(torque <= craft.none.get(name, np.inf) for name, torque in turned))[0]


def coefficients(craft: VehicleDescription, *, lever: bool = True) -> Coefficients:
    """Equations of motion of the first vehicle, with its drags as they are."""
    vehicle, drags = _modelled(craft, lever=lever)
    return replace(coefficients_of(vehicle), body=tuple(drags))


def mixing_matrix(craft: VehicleDescription) -> Float[np.ndarray, "4 rotors"]:
    """Map from rotor thrusts to total thrust and torques, of the first vehicle."""
    arms, ratio = rotor_positions(craft)[0], craft.values["torque_ratio"][0]
    return np.stack([np.ones(len(arms)), arms[:, 1], -arms[:, 0], ratio * np.array(craft.vehicle.spins)])


def manoeuvre(craft: VehicleDescription, acceleration: float) -> Float[np.ndarray, "steps rotors"]:
    """Rotor speeds that roll and pitch a vehicle to and fro, from hover [rad/s]."""
    value, rotor = first_row(craft.values), first_row(rotors_of(craft))
    phase = np.arange(0.0, REPLAY_S, REPLAY_STEP_S) / REPLAY_S
    roll = np.select([phase < 0.3, phase < 0.6], [1.0, -1.0])
    pitch = np.select([phase < 0.2, phase < 0.5, phase < 0.8], [0.0, -1.0, 1.0])
    demand = np.stack(
        [
            np.full_like(phase, value["mass"] * GRAVITY),
            value["inertia_xx"] * acceleration * roll,
            value["inertia_yy"] * acceleration * pitch,
            0.0 * phase,
        ]
    )
    thrust = np.linalg.pinv(mixing_matrix(craft)) @ demand
    return np.sqrt(np.maximum(thrust, 0.0).T / rotor["thrust_constant"])


def drag_centre(craft: VehicleDescription) -> list[float]:
    """Where the rotors' drag acts in hover, forward and left of their middle [m]."""
    value, speeds = first_row(craft.values), manoeuvre(craft, 0.0)[0]
    centre: list[float] = (speeds @ rotor_positions(craft)[0] / speeds.sum()).tolist()
    return [value.get(name, 0.0) + offset for name, offset in zip(CENTRE, centre, strict=True)]


def exponent_at_hover(craft: VehicleDescription) -> float:
    """Exponent of thrust as a function of command."""
    mapped = float(mapped_hover(craft)[0])
    command = craft.thrust_map.inverse(mapped)
    return command * craft.thrust_map.slope(command) / mapped


def replay(
    craft: VehicleDescription, commands: Float[np.ndarray, "steps rotors"], lacking: Collection[str] = ()
) -> Float[np.ndarray, "steps 13"]:
    """States of the body under commands, from hover, without effects that have no numbers."""
    c, power = coefficients(craft, lever="lever" not in lacking), exponent_at_hover(craft)
    step, spins = runge_kutta(c, REPLAY_STEP_S), c.torque_ratio * np.array(craft.vehicle.spins)
    decay, inertia = math.exp(-REPLAY_STEP_S * c.rate_up), np.array(c.inertia[:3])
    body: Any = [0.0, 0.0, 0.0, REPLAY_SPEED, REPLAY_SPEED, 0.0, 1.0, *[0.0] * 6]
    hover, states = manoeuvre(craft, 0.0)[0], []
    speeds: Any = hover.tolist()
    for demand in commands:
        command, now, torque = demand, np.array(speeds), [0.0, 0.0, 0.0]
        if "of_speed" in lacking:  # what reaches the same as a lag of the square
            command = (np.sqrt(decay * now**2 + (1.0 - decay) * demand**2) - decay * now) / (1.0 - decay)
        if "in_step" in lacking:
            excess = power / (1.0 + power) * (now / hover) ** (2.0 / power) - 1.0
            torque[2] = float(c.thrust_quadratic * now**2 @ (spins * excess))
        if "coupling" in lacking:
            torque = (torque + np.cross(body[10:13], inertia * body[10:13])).tolist()
        body, speeds = step(body, speeds, command.tolist(), STILL, (torque[0], torque[1], torque[2]))
        states.append(body)
    return np.array(states)


def delay_commands(
    craft: VehicleDescription, commands: Float[np.ndarray, "steps rotors"]
) -> tuple[VehicleDescription, Float[np.ndarray, "steps rotors"]]:
    """Vehicle with the slower lag alone, and commands filtered by its delay and its faster lag."""
    value, hover = first_row(craft.values), manoeuvre(craft, 0.0)[0]
    delay, second = value.get("delay", 0.0), value.get("second_lag", 0.0)
    if delay > 0.0:
        time, padded = REPLAY_STEP_S * np.arange(-1, len(commands)), np.vstack([hover, commands])
        commands = np.stack([np.interp(time[1:] - delay, time, column) for column in padded.T], axis=1)
    if not 0.0 < second < value["actuator_lag"]:
        return craft, commands
    delayed, state = np.empty_like(commands), hover
    for row, command in enumerate(commands):
        state = command + (state - command) * math.exp(-REPLAY_STEP_S / second)
        delayed[row] = state
    first_lag = {"actuator_lag": craft.values["actuator_lag"] - second}
    return replace(craft, values={**craft.values, **first_lag}), delayed


def common_value(value: Mapping[str, float], effect: str) -> float:
    """Mean of the numbers that a simulator has as one; zero where none is known."""
    row = EFFECTS[effect]
    numbers = [[value[name] for name in row[key] if name in value] for key in ("alike", "numbers")]
    return float(np.mean(next(filter(None, numbers), [0.0])))


def _neglected(craft: VehicleDescription, target: str, lacks: tuple[str, ...]) -> Iterator[str]:
    """Sentences on effects that a simulator lacks, with the error of a manoeuvre without each."""
    reference, value = None, first_row(craft.values)
    damping, across = (rotor_damping(craft, share)[:, 0] for share in (1.0, 0.0))
    damped = dict(zip(TORQUES, damping.tolist(), strict=True)) | value
    floor = np.maximum(damping, [damped[name] for name in TORQUES])
    torques = {
        "turning": 0.0 * damping,
        "beside_rotors": damping,
        "beside_across": across,
        "below_rotors": floor,
    }
    for effect in lacks:
        row, expected = EFFECTS[effect], value
        has = dict.fromkeys(row["numbers"], common_value(value, effect) if "alike" in row else 0.0)
        if effect in torques:  # The rotors' drag turns, identified or not
            has, expected = dict(zip(TORQUES, torques[effect].tolist(), strict=True)), damped
        names = tuple(
            name
            for name, number in has.items()
            if not math.isclose(expected.get(name, number), number, rel_tol=1e-6)
            and number > craft.none.get(name, -math.inf)
        )
        if not names and row["numbers"]:
            continue
        if reference is None:
            commands = manoeuvre(craft, 20.0)
            tilt = np.arccos(1.0 - 2.0 * np.square(replay(craft, commands)[:, 7:9]).sum(axis=1)).max()
            commands = manoeuvre(craft, 20.0 * min(REPLAY_TILT / tilt, 5.0))
            reference = replay(*delay_commands(craft, commands))
        columns = {name: column for name, column in craft.values.items() if name not in names}
        if effect in torques or "alike" in row:
            columns |= {name: np.full(1, has[name]) for name in names}
        reduced = craft if effect == "lever" else replace(craft, values=columns)
        without = replay(*delay_commands(reduced, commands), (effect,))
        cosine = np.abs((reference[:, 6:10] * without[:, 6:10]).sum(axis=1)).clip(max=1.0)
        angle = math.degrees(2.0 * np.arccos(cosine).max())
        speed = float(np.linalg.norm(reference[:, 3:6] - without[:, 3:6], axis=1).max())
        unwritten = [
            f"{name} {value[name]:.4g}"
            for name in names
            if name in value and name not in craft.none and (effect != "lever" or name == HEIGHT)
        ]
        left_out = f", and {', '.join(unwritten)} not in this file" if unwritten else ""
        forced = [
            f"{name} {has[name]:.3g}, above its bound {craft.none[name]:.3g}"
            for name in names
            if name in craft.none
        ]
        left_out += f", and its rotors' drag makes {'; '.join(forced)}" if forced else ""
        remedy = f" Hold its commands back by {value['delay']:.4g} s." if effect == "late" else ""
        manoeuvred = f"a manoeuvre of {REPLAY_S:g} s to {math.degrees(REPLAY_TILT):.0f} degrees"
        errors = f"errs by {float(f'{angle:.2g}'):g} degrees and {speed:.2g} m/s"
        yield f"{re.sub('^a ', 'A ', target)} has no {row['words']}{left_out}: {manoeuvred} {errors}.{remedy}"


# -- Templates --


def render(file: str, craft: VehicleDescription, lines: Iterable[str], **values: object) -> Exported:
    """Rendered template: every one takes the first row, rotor positions and spins, and the centre."""
    value = first_row(craft.values)
    arm = value["arm_scale"]
    values = {
        "value": value,
        "centre": [value.get(name, 0.0) for name in CENTRE],
        "dragged": drag_centre(craft),
        "positions": [(arm * x, arm * y) for x, y in craft.vehicle.positions],
        "spins": list(craft.vehicle.spins),
    } | values
    return Exported(rendered(file, lines, **values), craft.omitted, craft.lost)


#: What writes a file of draws, of their columns and seed, for those who train or test on many vehicles.
ExportOfDraws = Callable[[Fitted, Supplied, Columns, int], Exported]


# -- Rotors --


def mapped_hover(craft: VehicleDescription) -> Column:
    """Mapped command at hover."""
    return craft.values["mass"] * GRAVITY / (craft.vehicle.count * craft.values["thrust"])


def rotors_of(craft: VehicleDescription, gravity: float = GRAVITY) -> dict[str, Column]:
    """Numbers of a rotor, a row for each vehicle, in N, N m and rad/s; drags are over a rotor's speed."""
    values, count = craft.values, craft.vehicle.count
    scale, thrust, zero = values["speed_scale"], values["thrust"], np.zeros_like(values["mass"])
    hover = scale * np.sqrt(mapped_hover(craft))
    constant = thrust / scale**2 * (gravity / GRAVITY)
    largest = craft.thrust_map(values.get("largest_command", zero + np.inf))
    across = [values[name] for name in ("drag_x", "drag_y") if name in values]
    return {
        "thrust_constant": constant,
        "torque_constant": values["torque_ratio"] * constant,
        "hover_speed": hover,
        "largest_speed": scale * np.sqrt(largest),
        "drag_along": values.get("drag_z", zero) / (count * hover),
        "drag_across": (np.mean(across, axis=0) if across else zero) / (count * hover),
    }


def speed_comments(craft: VehicleDescription, simulator: str, gravity: float = GRAVITY) -> tuple[str, ...]:
    """What a rotor's speed and gravity are in a simulator, as sentences."""
    sentence = ["Rotor speeds are the commands times the rotor speed per unit of command."]
    if craft.thrust_map.name != "square":
        sentence = [
            "Rotor speeds are the rotor speed per unit of command times the square root of the mapped "
            "command: exact at rest, with the identified lag about hover."
        ]
    if gravity != GRAVITY:
        scale = f"{gravity:g} m/s^2: thrust is times {gravity / GRAVITY:.6g}"
        sentence.append(f"{simulator} takes gravity for {scale}, so that the vehicle hovers as it did.")
    return tuple(sentence)
