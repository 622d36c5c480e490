"""Description of a vehicle: rotors, known numbers, files and parameter names."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sized
from dataclasses import dataclass, field, fields
from functools import cached_property, partial
from importlib import resources
from typing import Any

import msgspec
import numpy as np

from eivor import checks
from eivor.errors import EivorError, InputError, ParameterError, UsageError
from eivor.inference.distributions import normal_quantile
from eivor.signals.recording import GRAVITY
from eivor.signals.thrust_map import input_map
from eivor.strict_toml import ENDING, TomlFiles, TomlTable, package_tables
from eivor.tools import Float

#: Parameters that identify them; Iyy / Ixx, and Izz / Ixx by either coupling, as formulas.
OF_INERTIAS = ("roll_gain", "pitch_gain", "roll_coupling", "pitch_coupling")
PITCH_OVER_ROLL = "roll_gain / pitch_gain"
YAW_OVER_ROLL = (f"{PITCH_OVER_ROLL} - roll_coupling", f"1 + pitch_coupling * {PITCH_OVER_ROLL}")


#: Of no vehicle Izz is less than this share of Ixx.
LEAST_YAW = 0.2


def inertia_ratios(values: Mapping[str, float]) -> tuple[float, float]:
    """Izz / Ixx and Izz / Iyy by gains and couplings, by name; of both couplings the mean."""
    roll_gain, pitch_gain, roll_coupling, pitch_coupling = (values[name] for name in OF_INERTIAS)
    pitch_over_roll = roll_gain / pitch_gain
    over_roll = 0.5 * (pitch_over_roll - roll_coupling + 1.0 + pitch_coupling * pitch_over_roll)
    return over_roll, over_roll / pitch_over_roll


def inertia_shares(values: Mapping[str, float]) -> tuple[float, float, float]:
    """Ixx over the inertia about each axis, within what bodies have; one where gains are not above zero."""
    if not min(values[name] for name in OF_INERTIAS[:2]) > 0.0:
        return 1.0, 1.0, 1.0
    yaw_over_roll, yaw_over_pitch = inertia_ratios(values)
    pitch = yaw_over_roll / yaw_over_pitch
    return 1.0, 1.0 / pitch, 1.0 / min(max(yaw_over_roll, abs(1.0 - pitch), LEAST_YAW), 1.0 + pitch)


_REMEDY = "Correct the vehicle's description."
#: By how much inertias may be those of no body before it is said: some that were published are by 1 %.
NO_BODY_UNCERTAINTY = 0.05

finite = partial(checks.finite, remedy=_REMEDY)
positive = partial(checks.positive, remedy=_REMEDY)
non_negative = partial(checks.non_negative, remedy=_REMEDY)


def triple(name: str, values: Sized) -> None:
    """Refuse what has not three numbers, one for each axis."""
    if len(values) != 3:
        raise ParameterError(f"three numbers for {name}, forward, left, up", f"{len(values)}", _REMEDY)


@dataclass(frozen=True, slots=True)
class KnownNumber:
    """A value from outside the flight."""

    value: float
    std: float = 0.0

    def __post_init__(self) -> None:
        finite("value", self.value)
        non_negative("std", self.std)

    @property
    def interval(self) -> tuple[float, float]:
        """95 %, of the normal distribution."""
        half = normal_quantile(0.95) * self.std
        return self.value - half, self.value + half

    def check(self, name: str) -> None:
        """Refuse what cannot be such a number, or is not distinguished from zero by its own uncertainty."""
        low, high, unit = RANGES[name]
        if not low <= self.value <= high:
            expected, remedy = f"a {name} between {low:g} and {high:g}{unit}", "Check its unit."
            raise ParameterError(expected, f"{self.value:g}", remedy if unit else _REMEDY)
        if self.value > 0.0 and self.std > LARGEST_STD * self.value:
            expected = f"a standard deviation of the {name} of at most {LARGEST_STD:g} of its value"
            remedy = "Leave it out: so little known, it carries no information."
            raise ParameterError(expected, f"{self.value:g} with {self.std:g}", remedy)


#: Largest standard deviation, as a share of the value.
LARGEST_STD = 0.4

#: A vehicle has at least two, and more than this is a mistake.
MOST_ROTORS = 64


@dataclass(frozen=True, slots=True)
class Rotors:
    """Equal rotors at several places.

    With n the speed of one of them, l the air velocity there on the body's axes, and s its spin:

        thrust = c1 n + c2 n^2 + k_h (l_x^2 + l_y^2) - k_z n l_z
        drag   = -k_d n (l_x, l_y)
        torque = s kappa (c1 n + c2 n^2) + s J n'
        n'     = (command(t - delay) - n) / lag

    The drag terms are those of the simulator RotorPy.
    """

    positions: tuple[tuple[float, ...], ...]  # From the centre of mass, forward, left, up [m]
    # +1 where the reaction torque on the body points up: it turns clockwise as seen from above; else -1
    spins: tuple[int, ...]
    highest_speed: float  # Commands above it are cut off [rad/s]
    thrust_quadratic: float  # c2 [N/(rad/s)^2]
    torque_ratio: float  # kappa, reaction torque over thrust [m]
    lag_up: float  # Time constant towards a higher speed [s]
    lag_down: float  # And towards a lower one [s]
    thrust_linear: float = 0.0  # c1 [N/(rad/s)]
    inertia: float = 0.0  # J of a rotor with what turns of its motor, about its axis [kg m^2]
    delay: float = 0.0  # From a command to its first effect on the speed [s]
    lowest_speed: float = 0.0  # Commands below it are raised to it [rad/s]
    drag: float = 0.0  # k_d across the axis [N/(m/s) per rad/s]
    inflow: float = 0.0  # k_z along it [N/(m/s) per rad/s]
    translational_lift: float = 0.0  # k_h [N/(m/s)^2]
    flapping: float = 0.0  # Torque -k n (l_y, -l_x) on the hub [N m/(m/s) per rad/s]

    def __post_init__(self) -> None:
        _check_places(self.positions, self.spins, planar=False)
        for name in ("highest_speed", "lag_up", "lag_down"):
            positive(name, getattr(self, name))
        for item in fields(self)[2:]:
            non_negative(item.name, getattr(self, item.name))
        if not self.thrust_linear + self.thrust_quadratic > 0.0:
            raise ParameterError("rotors with thrust", "none", "Give thrust_quadratic or thrust_linear.")
        if not self.lowest_speed < self.highest_speed:
            received = f"{self.lowest_speed:g} and {self.highest_speed:g}"
            raise ParameterError("a lowest_speed below the highest_speed", received, "Correct the limits.")

    @property
    def count(self) -> int:
        return len(self.positions)

    def thrust(self, speed: float) -> float:
        """Thrust of one rotor in still air [N]."""
        return (self.thrust_linear + self.thrust_quadratic * speed) * speed

    def speed_of_thrust(self, thrust: float) -> float:
        """Speed at which one rotor has this thrust [N] in still air; zero where there is none."""
        linear, quadratic = self.thrust_linear, self.thrust_quadratic
        if thrust <= 0.0:
            return 0.0
        # the root that also serves without a quadratic part
        return 2.0 * thrust / (linear + math.sqrt(linear**2 + 4.0 * quadratic * thrust))


def _check_places(positions: tuple[tuple[float, ...], ...], spins: tuple[int, ...], *, planar: bool) -> None:
    """Refuse what are no positions and spins of rotors; planar positions have no height."""
    if not 2 <= len(positions) <= MOST_ROTORS or len(spins) != len(positions):
        expected = f"positions of 2 to {MOST_ROTORS} rotors, and a spin for each"
        received = f"{len(positions)} positions and {len(spins)} spins"
        raise ParameterError(expected, received, "Give both in the order of the rotors' commands.")
    if planar and not all(len(position) == 2 for position in positions):
        two = "two numbers for a rotor's position, forward and left"
        raise ParameterError(two, f"{positions}", "Leave its height out.")
    for position in positions:
        if not planar:
            triple("position", position)
        finite("position", *position)
    if not all(spin in (1, -1) for spin in spins):
        remedy = "A rotor whose reaction torque on the body points up (clockwise from above) has +1."
        raise ParameterError("spins of +1 or -1", f"{spins}", remedy)


#: What each known number may be, with its unit.
RANGES = {
    "mass": (1e-3, 1e3, " kg"),
    "arm_scale": (0.5, 2.0, ""),
    "speed_scale": (1e-6, 1e6, " rad/s per unit of command"),
    "torque_ratio": (1e-4, 1.0, " m"),
    "yaw_inertia_ratio": (0.2, 2.0, ""),
    "delay": (0.0, 0.5, " s"),
    "gyro_cutoff_hz": (1.0, 10_000.0, " Hz"),
    "accelerometer_cutoff_hz": (1.0, 10_000.0, " Hz"),
    "rotor_radius": (0.005, 5.0, " m"),
}


@dataclass(frozen=True)
class KnownVehicle:
    """What is known of a vehicle; None for what is not."""

    name: str
    positions: tuple[tuple[float, ...], ...]
    spins: tuple[int, ...]
    arm_scale: KnownNumber | None = None  # Positions are in metres; in arms of an unknown length without it
    mass: KnownNumber | None = None  # With everything on board [kg]
    speed_scale: KnownNumber | None = None  # [rad/s per unit of command]
    torque_ratio: KnownNumber | None = None
    yaw_inertia_ratio: KnownNumber | None = None
    delay: KnownNumber | None = None  # [s]
    thrust_map: str = "square"
    gyro_cutoff_hz: float | None = None
    accelerometer_cutoff_hz: float | None = None
    rotor_radius: float | None = None  # [m]

    def __post_init__(self) -> None:
        _check_places(self.positions, self.spins, planar=True)
        _check_turning(self.positions, self.spins)
        for name in RANGES:
            number: KnownNumber | float | None = getattr(self, name)
            if number is not None:
                (number if isinstance(number, KnownNumber) else KnownNumber(number)).check(name)
        input_map(self.thrust_map)

    @property
    def count(self) -> int:
        return len(self.positions)

    @property
    def arm(self) -> float:
        """Mean distance of the rotors from the centre, in the unit of the positions."""
        return float(np.mean([math.hypot(*position) for position in self.positions]))

    @cached_property
    def arms(self) -> Float[np.ndarray, "4 rotors"]:
        """Arms of the thrusts for lift and for torque about forward, left, up: 1, y, -x, spin."""
        x, y = np.transpose(self.positions)
        return np.stack([np.ones(self.count), y, -x, self.spins])

    @cached_property
    def sums(self) -> Float[np.ndarray, "7 rotors"]:
        """Weights of the rotors in sums over them: 1, x, y, x^2, x y, y^2, and the spin."""
        rotor, y, negative, spin = self.arms
        x = -negative
        return np.stack([rotor, x, y, x * x, x * y, y * y, spin])

    @cached_property
    def numbers(self) -> dict[str, Any]:
        """Sums over the rotors of powers of their places, as terms name them."""
        x, y = self.sums[1:3]
        sums = dict(zip(("rotors", "x", "y", "xx", "xy", "yy"), self.sums[:6].sum(axis=1), strict=True))
        return sums | {"xxx": x @ x**2, "xxy": y @ x**2, "xyy": x @ y**2, "yyy": y @ y**2}


def _check_turning(positions: tuple[tuple[float, ...], ...], spins: tuple[int, ...]) -> None:
    size = max(max(abs(x), abs(y)) for x, y in positions) or 1.0
    rotors = zip(positions, spins, strict=True)
    turning = np.array([[y / size, x / size, spin, 1.0] for (x, y), spin in rotors])
    if np.linalg.matrix_rank(turning) < turning.shape[1]:
        expected = "rotors that turn the vehicle about each of its axes"
        remedy = "Correct the positions and the spins: four rotors or more, on all sides, of both spins."
        raise ParameterError(expected, f"positions {positions} with spins {spins}, which do not", remedy)


#: Spins, as seen from above.
GYROSCOPIC_WORDS = {"cw": 1, "ccw": -1}
_PLACES, _LAYOUTS = package_tables("eivor.motions.rigid_body", "layouts.toml").values()


def _numbered(rotors: str) -> tuple[tuple[float, float, int], ...]:
    """Places forward and left of the centre, and the spin at each."""
    words = [rotor.split() for rotor in rotors.split(", ")]
    return tuple((*_PLACES[corner], GYROSCOPIC_WORDS[spin]) for corner, spin in words)


#: Rotors by layout and numbering.
LAYOUTS = {
    layout: {numbering: _numbered(rotors) for numbering, rotors in numberings.items()}
    for layout, numberings in _LAYOUTS.items()
}


def vehicle_from_record(record: object) -> KnownVehicle:
    """Vehicle of what `dataclasses.asdict` made of it, and JSON of that."""
    try:
        vehicle, names = msgspec.convert(record, KnownVehicle), {item.name for item in fields(KnownVehicle)}
        if isinstance(record, Mapping) and record.keys() != names:
            raise ValueError(f"other keys: {', '.join(sorted(record.keys() ^ names))}")
        return vehicle
    except (ValueError, EivorError) as error:
        expected = "a result that says what flies, under prediction.vehicle"
        received = f"one that does not ({error})"
        raise InputError(expected, received, "Identify the flight again, with --vehicle.") from error


# -- Vehicle file --

#: Positions, spins, and what the positions have to be multiplied by.
RotorTable = tuple[tuple[tuple[float, float], ...], tuple[int, ...], KnownNumber | None]

TEMPLATE = "vehicle_template.toml"
#: Lengths of arms [m].
LEAST_ARM, LARGEST_ARM = 5e-3, 10.0


VEHICLES = TomlFiles(
    "eivor.motions.rigid_body", "vehicles", "a vehicle", "`eivor vehicle new` writes a file to begin with."
)
shipped_vehicles, vehicle_text = VEHICLES.names, VEHICLES.text


def load_vehicle(source: str | os.PathLike[str]) -> KnownVehicle:
    """Vehicle by the name of a shipped one, or from a file."""
    checks.path("source", source)
    return _vehicle(VEHICLES.table(source))


def vehicle_template() -> str:
    """Text of a file to begin with: every key, with what it means."""
    return (resources.files("eivor.motions.rigid_body") / TEMPLATE).read_text(encoding="utf-8")


class _Number(msgspec.Struct, forbid_unknown_fields=True):
    value: float
    std: float = 0.0


class _Rotors(msgspec.Struct, forbid_unknown_fields=True):
    layout: str | None = None
    numbering: str = ""
    arm: float | _Number | None = None
    positions: list[list[float]] | None = None
    positions_std: float = 0.0
    spins: list[int | str] = []
    speed_scale: float | _Number | None = None
    torque_ratio: float | _Number | None = None
    thrust_map: str = "square"
    radius: float | None = None


class _VehicleFile(msgspec.Struct, forbid_unknown_fields=True):
    rotors: dict[str, Any]
    name: str | None = None
    mass: float | _Number | None = None
    yaw_inertia_ratio: float | _Number | None = None
    delay_ms: float | _Number | None = None
    gyro_cutoff_hz: float | None = None
    accelerometer_cutoff_hz: float | None = None


def _vehicle(top: TomlTable) -> KnownVehicle:
    given, table = top.convert(_VehicleFile), top.part("rotors")
    rotors = table.convert(_Rotors)
    try:
        if (rotors.layout is None) == (rotors.positions is None):
            received = "neither" if rotors.layout is None else "both"
            give = (
                f'Give layout = "{next(iter(LAYOUTS))}" with its numbering, or each rotor\'s place and spin.'
            )
            raise table.wrong("", "either a layout, or positions and spins,", received, give)
        of_positions = {"positions", "positions_std", "spins"}
        stray = (of_positions if rotors.positions is None else {"numbering", "arm"}) & table.values.keys()
        if stray:
            kind = "a layout" if rotors.positions is None else "positions"
            raise table.wrong("", f"keys of {kind} alone", f"'{min(stray)}' as well", "Remove it.")
        return KnownVehicle(
            given.name or top.file.removesuffix(ENDING),
            *(_of_positions(rotors, table) if rotors.layout is None else _of_layout(rotors, table)),
            _known(given.mass),
            _known(rotors.speed_scale),
            _known(rotors.torque_ratio),
            _known(given.yaw_inertia_ratio),
            _known(given.delay_ms, unit=1e-3),
            rotors.thrust_map,
            given.gyro_cutoff_hz,
            given.accelerometer_cutoff_hz,
            rotors.radius,
        )
    except UsageError as error:
        raise InputError(f"{error.expected} in {top.file}", error.received, error.remedy) from error


def _of_layout(rotors: _Rotors, table: TomlTable) -> RotorTable:
    layouts = LAYOUTS[table.choose("layout", rotors.layout or "", tuple(LAYOUTS))]
    chosen = layouts[table.choose("numbering", rotors.numbering, tuple(layouts))]
    arm = _known(rotors.arm)
    if arm is not None and not LEAST_ARM <= arm.value <= LARGEST_ARM:
        raise table.wrong("arm", f"{LEAST_ARM:g} to {LARGEST_ARM:g} m", f"{arm.value:g}", "Check its unit.")
    length = 1.0 if arm is None else arm.value
    positions = tuple((length * x, length * y) for x, y, _ in chosen)
    scale = None if arm is None else KnownNumber(1.0, arm.std / arm.value)
    return positions, tuple(spin for _, _, spin in chosen), scale


def _of_positions(rotors: _Rotors, table: TomlTable) -> RotorTable:
    positions = []
    for number, pair in enumerate(rotors.positions or (), start=1):
        key = f"positions[{number}]"
        if len(pair) != 2:
            remedy = "Give forward and left of the centre, in metres."
            raise table.wrong(key, "two numbers", f"{len(pair)} of them", remedy)
        if not max(abs(pair[0]), abs(pair[1])) <= LARGEST_ARM:
            raise table.wrong(key, f"at most {LARGEST_ARM:g} m", f"{pair}", "Check the unit.")
        positions.append((pair[0], pair[1]))
    spins = [
        spin
        if isinstance(spin, int)
        else GYROSCOPIC_WORDS[table.choose(f"spins[{number}]", spin, tuple(GYROSCOPIC_WORDS))]
        for number, spin in enumerate(rotors.spins, start=1)
    ]
    return tuple(positions), tuple(spins), KnownNumber(1.0, rotors.positions_std)


def _known(number: float | _Number | None, unit: float = 1.0) -> KnownNumber | None:
    """A number in units of SI, plain or with its standard deviation; None where there is none."""
    if isinstance(number, _Number):
        return KnownNumber(unit * number.value, unit * number.std)
    return None if number is None else KnownNumber(unit * number)


@dataclass(frozen=True, slots=True)
class BodyDrag:
    """What the air does to the body without its rotors, along and about the body's axes."""

    linear: tuple[float, ...] = (0.0, 0.0, 0.0)  # Against the air speed on each axis [N/(m/s)]
    quadratic: tuple[float, ...] = (0.0, 0.0, 0.0)  # Per product of speed and component [N/(m/s)^2]
    rotational: tuple[float, ...] = (0.0, 0.0, 0.0)  # Against the rate about each axis [N m/(rad/s)]

    def __post_init__(self) -> None:
        for name in ("linear", "quadratic", "rotational"):
            triple(name, getattr(self, name))
            non_negative(name, *getattr(self, name))


@dataclass(frozen=True, slots=True)
class Vehicle:
    """A rigid body that flies on rotors."""

    mass: float  # With everything on board [kg]
    # About the centre of mass, rotors included [kg m^2]: Ixx, Iyy, Izz, and Ixy, Ixz, Iyz of the matrix
    inertia: tuple[float, ...]
    rotors: Rotors  # What drives it
    drag: BodyDrag = field(default_factory=BodyDrag)  # What the air does to the body

    def __post_init__(self) -> None:
        positive("mass", self.mass)
        if len(self.inertia) not in (3, 6):
            expected = "an inertia of three numbers (Ixx, Iyy, Izz) or six (and Ixy, Ixz, Iyz)"
            received = f"{len(self.inertia)} of them"
            raise ParameterError(expected, received, "Give the elements of the matrix in this order.")
        matrix = self.inertia_matrix
        if not (np.all(np.isfinite(matrix)) and np.linalg.eigvalsh(matrix)[0] > 0.0):
            remedy = "Correct its elements; those off the diagonal are minus the products of inertia."
            raise ParameterError("an inertia matrix that is positive definite", f"{self.inertia}", remedy)

    @property
    def inertia_matrix(self) -> Float[np.ndarray, "3 3"]:
        """Inertia about the body's axes [kg m^2]."""
        xx, yy, zz, xy, xz, yz = (*self.inertia, 0.0, 0.0, 0.0)[:6]
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    @property
    def hover_speed(self) -> float:
        """Speed at which equal rotors carry the weight."""
        return self.rotors.speed_of_thrust(self.mass * GRAVITY / self.rotors.count)

    @property
    def full_thrust(self) -> float:
        """Thrust of all rotors at their highest speed [N]."""
        return self.rotors.count * self.rotors.thrust(self.rotors.highest_speed)
