"""Flights of a whole vehicle: seconds for half a minute at 500 Hz, by itself and among others.

Target: 3 s for one flight, sensors, controller and log included. The peer is RotorPy's own step of the same
vehicle under held commands, without any controller or sensor, with the tolerance at which it is as exact.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from _shared import arguments, least_seconds, machine

from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.simulation.rigid_body import RigidBodyFlightSpec, simulate_rigid_body_flights
from validation.flight_recipe.rotorpy_flight import Vehicle, hover_speed, vehicle_parameters

#: What all times are told for [s].
FLIGHT_S = 30.0


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    duration, many, repeats = (3.0, 10, 1) if small else (FLIGHT_S, 80, 3)
    spec = replace(shipped_rigid_body_flight("crazyflie"), duration=duration)
    fly([replace(spec, duration=2.0)])  # what is imported with the first flight
    alone = least_seconds(lambda: fly([spec]), repeats) * FLIGHT_S / duration
    together = least_seconds(lambda: fly([replace(spec, seed=seed) for seed in range(many)]), 1)
    each = together / many * FLIGHT_S / duration
    peer = least_seconds(lambda: rotorpy(spec.rate_hz, 1.0), repeats) * FLIGHT_S
    print(
        f"one flight of {FLIGHT_S:g} s   {alone:6.2f} s   RotorPy's steps alone {peer:6.2f} s   "
        f"ratio {alone / peer:5.3f}   of target {alone / 3.0:5.2f}"
    )
    print(f"each of {many}             {each:6.3f} s   ratio to one alone {each / alone:5.3f}")


def fly(specs: list[RigidBodyFlightSpec]) -> None:
    """Fly, and keep nothing."""
    for flight in simulate_rigid_body_flights(specs):
        assert flight.flew


def rotorpy(rate_hz: float, seconds: float) -> None:
    """Steps of RotorPy about hover."""
    from rotorpy.vehicles.multirotor import Multirotor

    parameters = vehicle_parameters(Vehicle.CRAZYFLIE, None)
    hover = np.full(4, hover_speed(parameters))
    zero = np.zeros(3)
    state = {
        "x": zero,
        "v": zero,
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": zero,
        "wind": zero,
        "rotor_speeds": hover,
    }
    vehicle = Multirotor(
        parameters,
        control_abstraction="cmd_motor_speeds",
        integrator_kwargs={"rtol": 1e-8, "atol": 1e-10},
    )
    shares = 1.0 + 0.02 * np.random.default_rng(0).standard_normal((round(rate_hz * seconds), 4))
    for share in shares:
        state = vehicle.step(state, {"cmd_motor_speeds": hover * share}, 1.0 / rate_hz)


if __name__ == "__main__":
    main()
