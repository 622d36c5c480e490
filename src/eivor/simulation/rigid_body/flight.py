"""Flights of a whole vehicle: what was logged of each, and what is true of it.

Flights that share their steps are simulated side by side, in batches; one by itself in floats. Both are the
same to rounding: a flight is a function of its specification and of nothing else.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from eivor.motions.rigid_body.coefficients import side_by_side
from eivor.motions.rigid_body.dynamics import specific_force
from eivor.motions.rigid_body.effective import EffectiveParameters, effective_parameters
from eivor.shapes import Float
from eivor.signals.recording import Recording
from eivor.simulation.rigid_body.controller import control_effectiveness
from eivor.simulation.rigid_body.logged import recording_of
from eivor.simulation.rigid_body.loop import Flown, alike, fly
from eivor.simulation.rigid_body.spec import RigidBodyFlightSpec
from eivor.simulation.rigid_body.surroundings import Surroundings, surroundings_of

#: Steps of all flights that are simulated side by side: some hundred megabytes.
BATCH_STEPS = 1_200_000
#: A vehicle this far from its height [m], or with so small a cosine of its tilt, is lost.
LOST_M, LOST_COSINE = 5.0, 0.17


@dataclass(frozen=True, slots=True)
class RigidBodyTruth:
    """What is true of a flight, a row for each step of the simulation, without errors of sensors.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        [s].
    position, velocity : ndarray, shape (n, 3)
        In the world [m, m/s].
    attitude : ndarray, shape (n, 4)
        From body to world, w, x, y, z.
    angular_rate : ndarray, shape (n, 3)
        Body rates [rad/s].
    specific_force : ndarray, shape (n, 3)
        On the body's axes [m/s^2].
    air_velocity : ndarray, shape (n, 3)
        Of the body against the air, in the world [m/s].
    rotor_speed, rotor_command : ndarray, shape (n, rotors)
        [rad/s]. A command is issued at its row's time, and held until the next.
    thrust_setpoint : ndarray, shape (n,)
        A share of full thrust.
    torque_setpoint : ndarray, shape (n, 3)
        Normalised, what is injected included.
    disturbance : ndarray, shape (n, 3)
        Torque from outside [N m].
    parameters : EffectiveParameters
        Combinations of the vehicle's parameters that the flight shows.
    control_effectiveness : tuple of float
        Angular acceleration per unit of each torque setpoint [rad/s^2].
    """

    time_s: Float[np.ndarray, " n"]
    position: Float[np.ndarray, "n 3"]
    velocity: Float[np.ndarray, "n 3"]
    attitude: Float[np.ndarray, "n 4"]
    angular_rate: Float[np.ndarray, "n 3"]
    specific_force: Float[np.ndarray, "n 3"]
    air_velocity: Float[np.ndarray, "n 3"]
    rotor_speed: Float[np.ndarray, "n rotors"]
    rotor_command: Float[np.ndarray, "n rotors"]
    thrust_setpoint: Float[np.ndarray, " n"]
    torque_setpoint: Float[np.ndarray, "n 3"]
    disturbance: Float[np.ndarray, "n 3"]
    parameters: EffectiveParameters
    control_effectiveness: tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class RigidBodyFlight:
    """A flight as its log has it, and as it was.

    Parameters
    ----------
    recording : Recording
        Noisy channels, each group on its own stamps, z up.
    truth : RigidBodyTruth
        What was flown.
    flew : bool
        False when the vehicle was lost.
    """

    recording: Recording
    truth: RigidBodyTruth
    flew: bool


def simulate_rigid_body_flights(specs: Sequence[RigidBodyFlightSpec]) -> Iterator[RigidBodyFlight]:
    """Fly each specification and give its log and its truth, in order.

    Parameters
    ----------
    specs : sequence of RigidBodyFlightSpec
        Neighbours that have rate, duration, loops' rates and number of rotors in common are simulated side by
        side.

    Yields
    ------
    RigidBodyFlight
        With the channels of `eivor.simulation.rigid_body.logged`.

    Notes
    -----
    At 500 Hz a flight of 30 s takes about 2 s by itself, and .2 s among forty. Each keeps its arrays of some
    10 MB.
    """
    for _, group in groupby(specs, alike):
        together = list(group)
        first = together[0]
        most = max(BATCH_STEPS // first.count, 1) if first.integrator.side_by_side else 1
        for start in range(0, len(together), most):
            batch = together[start : start + most]
            met = [surroundings_of(spec) for spec in batch]
            for spec, one, flown in zip(batch, met, fly(batch, met), strict=True):
                yield _flight(spec, one, flown)


def _flight(spec: RigidBodyFlightSpec, met: Surroundings, flown: Flown) -> RigidBodyFlight:
    body = flown.body
    force = specific_force(
        side_by_side([spec.vehicle]),
        np.ascontiguousarray(body.T),
        [np.ascontiguousarray(flown.rotor_speed.T)],
        (met.wind[:, 0], met.wind[:, 1], met.wind[:, 2]),
    )
    truth = RigidBodyTruth(
        time_s=spec.step_s * np.arange(spec.count),
        position=body[:, 0:3],
        velocity=body[:, 3:6],
        attitude=body[:, 6:10],
        angular_rate=body[:, 10:13],
        specific_force=np.column_stack(force),
        air_velocity=body[:, 3:6] - met.wind,
        rotor_speed=flown.rotor_speed,
        rotor_command=flown.rotor_command,
        thrust_setpoint=flown.thrust,
        torque_setpoint=flown.torque,
        disturbance=met.disturbance,
        parameters=effective_parameters(spec.vehicle),
        control_effectiveness=control_effectiveness(spec.vehicle),
    )
    cosine = 1.0 - 2.0 * (body[:, 7] ** 2 + body[:, 8] ** 2)
    away = np.abs(body[:, 2] - met.height[:, 0])
    flew = bool(away.max() < LOST_M and cosine.min() > LOST_COSINE)
    return RigidBodyFlight(recording_of(spec, met, flown, truth.specific_force), truth, flew)
