"""Shares of 13 states, half a second on, that 90 % bands of 300 draws of an exported vehicle hold."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from eivor.errors import NotIdentifiedError
from eivor.exports.fitted import Supplied
from eivor.exports.vehicle import BODY, DRAGS, REPLAY_STEP_S, coefficients, describe
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.dynamics import coefficients_of
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import KnownNumber
from eivor.report.outputs import saved_of
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import STILL, runge_kutta
from validation.flight_recipe.rotorpy_flight import Vehicle
from validation.rigid_body.trials import flight_of, known_vehicle, published_grid

FLIGHTS, STARTS, DRAWS, STEPS, NOMINAL = 20, 3, 300, 100, published_grid().scenario("nominal noise")
#: Kind, places of the rotors forward of the centre of mass [m], quadratic drag [N/(m/s)^2].
VEHICLES: dict[str, tuple[Vehicle, float, tuple[float, float, float]]] = {
    "Crazyflie": (Vehicle.CRAZYFLIE, 0.0, (0.0, 0.0, 0.0)),
    "centre of mass 4 mm forward": (Vehicle.CRAZYFLIE, -0.004, (0.0, 0.0, 0.0)),
    "quadratic drag": (Vehicle.CRAZYFLIE, 0.0, (0.002, 0.002, 0.004)),
    "1.2 kg": (Vehicle.MEDIUM, 0.0, (0.0, 0.0, 0.0)),
}


def held(kind: Vehicle, forward: float, quadratic: tuple[float, float, float], seed: int) -> Any:
    """Whether the band of a flight's result holds each state of its vehicle, by start."""
    spec, known, rng = (
        flight_of(kind, NOMINAL, 30.0, seed),
        known_vehicle(kind, NOMINAL),
        np.random.default_rng(seed),
    )
    (xx, yy, zz, *products), rotors = spec.vehicle.inertia, spec.vehicle.rotors
    true = replace(
        spec.vehicle,
        inertia=(xx, yy, min(zz, 0.9 * (xx + yy)), *products),  # that of RotorPy's Crazyflie is of no body
        rotors=replace(rotors, positions=tuple((x + forward, y, z) for x, y, z in rotors.positions)),
        drag=replace(spec.vehicle.drag, quadratic=quadratic),
    )
    (flight,) = simulate_rigid_body_flights([replace(spec, vehicle=true)])
    motion = RigidBody(replace(known, mass=KnownNumber(true.mass), arm_scale=KnownNumber(1.0)))
    fit = saved_of(identify_flight(flight.recording, model=motion), "", "", preferred=("rigid_body",))
    try:
        made = describe(fit.fitted, Supplied(), "a study", (*BODY, *DRAGS), fit.sample(DRAWS, seed), seed)
    except NotIdentifiedError:
        return np.empty((0, 13))
    moving = np.repeat([1.0, 0.5], 3) * rng.standard_normal((STARTS, 6))
    pushes = np.repeat(rng.standard_normal((STARTS, STEPS // 10, len(rotors.spins))), 10, axis=1)

    def ends(equations: Any) -> Any:
        step, results = runge_kutta(equations, REPLAY_STEP_S), []
        for moves, commands in zip(moving.tolist(), true.hover_speed * (1.0 + 0.12 * pushes), strict=True):
            body: Any = [0.0] * 3 + moves[:3] + [1.0, 0.0, 0.0, 0.0] + moves[3:]
            speeds: Any = [true.hover_speed] * len(rotors.spins)
            for command in commands.tolist():
                body, speeds = step(body, speeds, command, STILL, STILL)
            results.append(body)
        return np.array(results)

    every = [{name: column[[row]] for name, column in made.values.items()} for row in range(DRAWS)]
    drawn = [ends(coefficients(replace(made, values=row))) for row in every]
    low, high = np.quantile(drawn, [0.05, 0.95], axis=0)
    truth = ends(coefficients_of(true))
    return (low <= truth) & (truth <= high)


if __name__ == "__main__":
    for name, changed in VEHICLES.items():
        rows = np.concatenate([held(*changed, seed) for seed in range(FLIGHTS)])
        shares = rows.mean(axis=0)
        print(f"{name:30} of {len(rows)}: {shares.mean():.3f}, least {shares.min():.2f}", np.round(shares, 2))
