"""The whole vehicle out of a log of 60 s at 1 kHz: all six axes, lag and delay, intervals and verdicts.

Target: 10 s on two cores; what is told is processor time. The peer is plain least squares of each axis by
itself, with lag and delay given, from the same log on and in the same columns.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from _shared import arguments, least_seconds, machine

from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.separable import NoInstruments
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import KnownVehicle
from eivor.signals.recording import Recording
from eivor.simulation.rigid_body import simulate_rigid_body_flights

TARGET_S = 10.0


def main() -> None:
    small = arguments(__doc__).small
    print(machine())
    duration, rate_hz, repeats = (10.0, 500.0, 1) if small else (60.0, 1000.0, 3)
    spec = replace(shipped_rigid_body_flight("crazyflie"), duration=duration, rate_hz=rate_hz)
    log = next(iter(simulate_rigid_body_flights([spec]))).recording
    rotors = spec.vehicle.rotors
    positions = tuple((x, y) for x, y, _ in rotors.positions)
    motion = RigidBody(KnownVehicle("simulated", positions, rotors.spins))
    seconds = least_seconds(lambda: identify_flight(log, model=motion), repeats, time.process_time)
    peer = least_seconds(lambda: axis_by_axis(log, motion, rotors.lag_up), repeats, time.process_time)
    print(
        f"{duration:g} s at {rate_hz:g} Hz   eivor {seconds:6.2f} s   least squares by axis {peer:6.2f} s   "
        f"ratio {seconds / peer:5.1f}   of target {seconds / TARGET_S:5.2f}"
    )


def axis_by_axis(log: Recording, motion: RigidBody, lag_s: float) -> None:
    """Least squares of every axis by itself, from the log on."""
    flight = prepare(log, motion, FlightOptions()).shortened
    rows = motion.problem((flight,), NoInstruments()).rows({ACTUATOR_LAG.name: lag_s, DELAY.name: 0.0})
    axes = rows.layout.axis_of_row
    for axis in np.unique(axes):
        of_axis = rows.regressors[axes == axis]
        there = of_axis.any(axis=0)
        sizes = np.linalg.norm(of_axis[:, there], axis=0)
        np.linalg.lstsq(of_axis[:, there] / sizes, rows.response[axes == axis])


if __name__ == "__main__":
    main()
