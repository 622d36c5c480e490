"""Vehicle files: what is known of a vehicle, in TOML.

    name = "My quadrotor"           # optional, as is all but the rotors' layout
    mass = { value = 1.2, std = 0.01 }      # [kg]
    yaw_inertia_ratio = 1.8         # Izz over the mean of Ixx and Iyy, where it is assumed
    delay_ms = 4.0                  # from a command to its first effect
    gyro_cutoff_hz = 80.0           # onboard low-passes of second order
    accelerometer_cutoff_hz = 30.0

    [rotors]
    layout = "quad-x"               # or "quad-plus"
    numbering = "px4"               # or ardupilot, betaflight, crazyflie
    arm = { value = 0.225, std = 0.002 }    # from the centre to a rotor [m]

    # or, in place of these three, each rotor in the order of the commands:
    positions = [[0.16, -0.16], ...]        # forward and left of the centre [m]
    spins = ["ccw", "ccw", "cw", "cw"]      # as seen from above; or the sign of the reaction torque's z
    positions_std = 0.01            # relative error that all positions share

    speed_scale = 1000.0            # rotor speed per unit of the logged command [rad/s]
    thrust_map = "square"           # or linear, power:EXPONENT, mixed:SHARE
    torque_ratio = 0.016            # reaction torque over thrust [m]
    radius = 0.12                   # of a rotor [m]

A number is given plainly where it counts as exact, or as { value, std }. Unknown keys are errors.
"""

from __future__ import annotations

import os
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from eivor import checks
from eivor.errors import InputError, UsageError, did_you_mean
from eivor.motions.rigid_body.known_number import KnownNumber
from eivor.motions.rigid_body.known_vehicle import KnownVehicle
from eivor.motions.rigid_body.numberings import CLOCKWISE, COUNTERCLOCKWISE, LAYOUTS
from eivor.toml_table import TomlTable, read_toml, toml_table

#: Positions, spins, and what the positions have to be multiplied by.
Rotors = tuple[tuple[tuple[float, float], ...], tuple[int, ...], KnownNumber | None]

WHAT = "a vehicle"
ENDING = ".toml"
TEMPLATE = "vehicle_template.toml"
#: Lengths of arms [m].
LEAST_ARM, LARGEST_ARM = 5e-3, 10.0
SPIN_WORDS = {"cw": CLOCKWISE, "ccw": COUNTERCLOCKWISE}


def shipped_vehicles() -> tuple[str, ...]:
    """Names of the vehicles that come with Eivor."""
    folder = resources.files("eivor.motions.rigid_body") / "vehicles"
    return tuple(
        sorted(entry.name.removesuffix(ENDING) for entry in folder.iterdir() if entry.name.endswith(ENDING))
    )


def load_vehicle(source: str | os.PathLike[str]) -> KnownVehicle:
    """Vehicle by the name of a shipped one, or from a file.

    Parameters
    ----------
    source : str or path
        A name, or the path of a file, which ends in .toml or has a folder before it.

    Raises
    ------
    UsageError
        When the source is neither text nor a path.
    InputError
        When there is no such vehicle, the file cannot be read, or a key of it is wrong; says where and why.
    """
    checks.path("source", source)
    name, path = os.fspath(source), Path(source)
    if name in shipped_vehicles():
        return _vehicle(toml_table(_shipped(name).read_text(encoding="utf-8"), path, WHAT))
    if not name.endswith(ENDING) and path.name == name:
        raise InputError(
            f"a vehicle file that ends in {ENDING}, or one of the vehicles {', '.join(shipped_vehicles())}",
            f"'{name}'",
            did_you_mean(name, shipped_vehicles(), "`eivor vehicle new` writes a file to begin with."),
        )
    return _vehicle(read_toml(path, WHAT))


def vehicle_text(source: str) -> str:
    """Text of the file of a vehicle that `load_vehicle` has loaded."""
    file = _shipped(source) if source in shipped_vehicles() else Path(source)
    return file.read_text(encoding="utf-8")


def _shipped(name: str) -> Traversable:
    return resources.files("eivor.motions.rigid_body") / "vehicles" / f"{name}{ENDING}"


def vehicle_template() -> str:
    """Text of a file to begin with: every key, with what it means."""
    return (resources.files("eivor.motions.rigid_body") / TEMPLATE).read_text(encoding="utf-8")


def _vehicle(top: TomlTable) -> KnownVehicle:
    """Vehicle of a file's top table, all of whose keys are taken."""
    rotors = top.section("rotors")
    try:
        vehicle = KnownVehicle(
            top.text("name", top.file.removesuffix(ENDING)),
            *_rotors(rotors),
            _known(top, "mass"),
            _known(rotors, "speed_scale"),
            _known(rotors, "torque_ratio"),
            _known(top, "yaw_inertia_ratio"),
            _known(top, "delay_ms", unit=1e-3),
            rotors.text("thrust_map", "square"),
            _plain(top, "gyro_cutoff_hz"),
            _plain(top, "accelerometer_cutoff_hz"),
            _plain(rotors, "radius"),
        )
    except UsageError as error:
        raise InputError(f"{error.expected} in {top.file}", error.received, error.remedy) from error
    rotors.finish()
    top.finish()
    return vehicle


def _rotors(table: TomlTable) -> Rotors:
    if table.has("layout") == table.has("positions"):
        raise table.wrong(
            "",
            "either a layout, or positions and spins,",
            "both" if table.has("layout") else "neither",
            f'Give layout = "{next(iter(LAYOUTS))}" with its numbering, or each rotor\'s place and spin.',
        )
    return _of_layout(table) if table.has("layout") else _of_positions(table)


def _of_layout(table: TomlTable) -> Rotors:
    layout = table.choice("layout", tuple(LAYOUTS))
    chosen = LAYOUTS[layout][table.choice("numbering", tuple(LAYOUTS[layout]))]
    arm = _known(table, "arm")
    if arm is not None and not LEAST_ARM <= arm.value <= LARGEST_ARM:
        raise table.wrong("arm", f"{LEAST_ARM:g} to {LARGEST_ARM:g} m", f"{arm.value:g}", "Check its unit.")
    length = 1.0 if arm is None else arm.value
    positions = tuple((length * x, length * y) for x, y, _ in chosen)
    scale = None if arm is None else KnownNumber(1.0, arm.std / arm.value)
    return positions, tuple(spin for _, _, spin in chosen), scale


def _of_positions(table: TomlTable) -> Rotors:
    rows = table.rows("positions")
    positions = []
    for key in rows.values:
        pair = rows.numbers(key)
        if len(pair) != 2:
            remedy = "Give forward and left of the centre, in metres."
            raise rows.wrong(key, "two numbers", f"{len(pair)} of them", remedy)
        if not max(abs(pair[0]), abs(pair[1])) <= LARGEST_ARM:
            raise rows.wrong(key, f"at most {LARGEST_ARM:g} m", f"{list(pair)}", "Check the unit.")
        positions.append((pair[0], pair[1]))
    return tuple(positions), _spins(table), KnownNumber(1.0, table.number("positions_std", 0.0))


def _spins(table: TomlTable) -> tuple[int, ...]:
    """Spins as words or as signs."""
    rows = table.rows("spins")
    if any(isinstance(value, str) for value in rows.values.values()):
        return tuple(SPIN_WORDS[rows.choice(key, tuple(SPIN_WORDS))] for key in rows.values)
    return tuple(rows.whole(key) for key in rows.values)


def _known(table: TomlTable, key: str, unit: float = 1.0) -> KnownNumber | None:
    """A number in units of SI, plain or with its standard deviation; None where there is none."""
    if not isinstance(table.values.get(key), dict):
        plain = _plain(table, key)
        return None if plain is None else KnownNumber(unit * plain)
    section = table.section(key)
    value, std = section.number("value"), section.number("std", 0.0)
    section.finish()
    return KnownNumber(unit * value, unit * std)


def _plain(table: TomlTable, key: str) -> float | None:
    number = table.number(key, 0.0)
    return number if table.has(key) else None
