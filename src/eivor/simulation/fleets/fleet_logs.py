"""A simulated fleet as logs, one small file for each flight."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from eivor.logs.table.written import write_recording
from eivor.simulation.fleets.fleet_spec import FleetSpec, fleet_truth
from eivor.simulation.flights.known_log import logs_of_flights
from eivor.simulation.flights.vertical_flight_spec import VerticalFlightSpec


def write_fleet_logs(spec: FleetSpec, folder: Path) -> Iterator[Path]:
    """Simulate and write the flights of a fleet, one after the other.

    Parameters
    ----------
    spec : FleetSpec
        The fleet; `duration_s` is that of a flight.
    folder : Path
        Gets a folder for each vehicle, made where it is not there.

    Yields
    ------
    Path
        Each log as soon as it is written: ``VEHICLE/FLIGHT.parquet``, the numbers from zero.

    Raises
    ------
    ParameterError
        When a vehicle is lost.
    """
    truth = fleet_truth(spec)
    specs = [
        VerticalFlightSpec(
            viscous_friction=float(truth.viscous_friction[row]),
            hover_input=float(truth.hover_input[row]),
            actuator_lag=float(truth.actuator_lag[row]),
            duration=spec.duration_s,
            seed=spec.seed * truth.vehicle.size + row,
        )
        for row in range(truth.vehicle.size)
    ]
    for vehicle, flight, made in zip(truth.vehicle, truth.flight, logs_of_flights(specs), strict=True):
        place = folder / f"v{vehicle:04d}" / f"{flight:04d}.parquet"
        place.parent.mkdir(parents=True, exist_ok=True)
        write_recording(made.recording, place)
        yield place
