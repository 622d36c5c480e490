"""Simulated logs with their true parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version

import numpy as np

from eivor.errors import ParameterError
from eivor.motions.rigid_body.dynamics import into_body, rotation
from eivor.signals.recording import Recording
from eivor.simulation.rigid_body import (
    RigidBodyFlight,
    RigidBodyFlightSpec,
    RigidBodyTruth,
    simulate_rigid_body_flights,
)
from eivor.simulation.vertical import STEP_S, VerticalFlightSpec, simulate_vertical_flights
from eivor.strict_toml import package_tables

SCHEMA = "eivor.simulate/1"


@dataclass(frozen=True)
class KnownLog:
    """A log and its truth."""

    recording: Recording
    rate_hz: float
    samples: int
    truth: dict[str, object]


def known_log(
    recording: Recording, rate_hz: float, samples: int, seed: int, truth: Mapping[str, object]
) -> KnownLog:
    """Log with the document of its truth."""
    of_log = {"rate_hz": rate_hz, "samples": samples, "seed": seed}
    document = {"schema": SCHEMA, **truth, **of_log, "provenance": {"version": version("eivor")}}
    return KnownLog(recording, rate_hz, samples, document)


def logs_of_flights(specs: Sequence[VerticalFlightSpec]) -> Iterator[KnownLog]:
    """Logs of flights of one duration, in order; many are flown side by side."""
    for spec, flight in zip(specs, simulate_vertical_flights(specs), strict=True):
        if not flight.flew:
            expected = "a flight that follows its reference within 5 m"
            remedy = "Make the gusts weaker, or the trajectory less vigorous."
            raise ParameterError(expected, f"one that is lost with the seed {spec.seed}", remedy)
        # Without its input map, which is the rotors' own default.
        recording = replace(flight.recording, input_map="")
        yield known_log(recording, 1.0 / STEP_S, spec.count, spec.seed, _flight_truth(spec))


def _flight_truth(spec: VerticalFlightSpec) -> dict[str, object]:
    levels = ("acceleration", "velocity", "position", "attitude")
    numbers = ("viscous_friction", "input_gain", "actuator_lag", "delay", "hover_input")
    changes = ("gust_rms", "gain_after", "gain_changes_at", "gain_changes_over")
    return {
        **{name: getattr(spec, name) for name in numbers},
        "units": {
            "viscous_friction": "1/s",
            "input_gain": "m/s^2 per squared share of full command",
            "hover_input": "share of full command",
            **dict.fromkeys(("actuator_lag", "delay", "gain_changes_at", "gain_changes_over"), "s"),
        },
        "noise": {"kind": str(spec.noise.kind)} | {name: getattr(spec.noise, name) for name in levels},
        **{name: getattr(spec, name) for name in changes},
        "trajectory": str(spec.trajectory),
    }


def log_of_rigid_body_flight(spec: RigidBodyFlightSpec) -> KnownLog:
    """Log of a flight of a whole vehicle."""
    (flight,) = simulate_rigid_body_flights([spec])
    if not flight.flew:
        expected = "a flight that follows its height within 5 m and stays upright"
        remedy = "Make gusts, steps or disturbances smaller, or the controller less quick."
        raise ParameterError(expected, f"one that is lost with the seed {spec.seed}", remedy)
    # Without its input map where that is the rotors' own default.
    recording = replace(flight.recording, input_map="")
    return known_log(recording, spec.rate_hz, spec.count, spec.seed, _rigid_body_truth(spec, flight))


def _rigid_body_truth(spec: RigidBodyFlightSpec, flight: RigidBodyFlight) -> dict[str, object]:
    """Everything true, as a JSON document; what the vertical motion's truth has by the same names."""
    parameters = flight.truth.parameters
    return {
        "viscous_friction": viscous_friction(flight.truth),
        "input_gain": spec.vehicle.rotors.count * parameters.thrust_gain,
        "hover_input": spec.vehicle.hover_speed,
        **asdict(parameters),
        "control_effectiveness": list(flight.truth.control_effectiveness),
        "hover_speed": spec.vehicle.hover_speed,
        "units": package_tables("eivor.simulation", "truth.toml")["units"],
        "trajectory": str(spec.trajectory),
    }


def viscous_friction(truth: RigidBodyTruth) -> float:
    """Friction along z at the speeds of a flight: d_z at hover, and c_z sum |v| v_z^2 / sum v_z^2."""
    parameters = truth.parameters
    w, x, y, z = truth.record.body[:, 6:10].T
    along_x, along_y, along_z = truth.air_velocity.T
    _, _, climb = into_body(rotation(w, x, y, z), along_x, along_y, along_z)
    squared = np.asarray(climb) ** 2
    total = squared.sum()
    if not total > 0.0:
        return parameters.drag[2]
    speed = np.linalg.norm(truth.air_velocity, axis=1)
    return parameters.drag[2] + parameters.quadratic_drag[2] * float(speed @ squared / total)
