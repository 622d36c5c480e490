"""Simulated flights from TOML: what `eivor simulate` makes besides scenarios about hover.

    kind = "flight"
    viscous_friction = 0.3          # K [1/s]; optional, as is all but the kind
    hover_input = 0.5               # share of full command; K_u is g over its square
    actuator_lag = 0.05             # [s]
    trajectory = "steps"            # of the altitude: steps, multisine, chirp, climbs, hover, hover-steps
    duration = 60.0                 # [s]
    gain_after = 0.8                # what K_u is multiplied by in the end
    gain_changes_at = 30.0          # when it begins to change [s]
    gain_changes_over = 0.0         # how long that takes [s]; at once when left out

    [noise]
    kind = "white"                  # or heavy-tailed, fractional; of acceleration and velocity
    acceleration = 0.4              # standard deviations [m/s^2]; velocity [m/s], position [m],
                                    # attitude [rad]

The other keys are those of `eivor.simulation.flights.vertical_flight_spec` and
`eivor.simulation.flights.sensor_noise`. Unknown
keys are errors.
"""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path

from eivor.simulation.flights.sensor_noise import NoiseKind, SensorNoise
from eivor.simulation.flights.trajectories import TrajectoryKind
from eivor.simulation.flights.vertical_flight_spec import VerticalFlightSpec
from eivor.simulation.scenario_files.kinds import built
from eivor.toml_table import TomlTable, read_toml

#: What a file of a flight says of itself.
KIND = "flight"


def read_flight(path: Path) -> VerticalFlightSpec:
    """Flight from a file, with the seed zero.

    Raises
    ------
    InputError
        When the file cannot be read, or does not describe a flight; says where and why.
    """
    return flight_from_table(read_toml(path, "a flight"))


def shipped_flight() -> VerticalFlightSpec:
    """Flight that comes with the package, "flight"."""
    with as_file(files("eivor.simulation.scenario_files").joinpath("flights", f"{KIND}.toml")) as path:
        return read_flight(path)


def flight_from_table(table: TomlTable) -> VerticalFlightSpec:
    """Flight from the top table of a TOML file, all of whose keys it takes.

    Parameters
    ----------
    table : TomlTable
        With ``kind = "flight"``.

    Raises
    ------
    InputError
        When a key is unknown, a value of the wrong type, or a number out of its range.
    """
    table.choice("kind", (KIND,))
    known: dict[str, object] = {"seed": 0}
    if table.has("trajectory"):
        known["trajectory"] = TrajectoryKind(table.choice("trajectory", tuple(TrajectoryKind)))
    if table.has("noise"):
        section = table.section("noise")
        quiet = SensorNoise()
        kind = NoiseKind(section.choice("kind", tuple(NoiseKind))) if section.has("kind") else quiet.kind
        # The log of vertical motion has no angular rates.
        known["noise"] = built(section, SensorNoise, kind=kind, angular_rate=quiet.angular_rate)
    flight: VerticalFlightSpec = built(table, VerticalFlightSpec, **known)
    return flight
