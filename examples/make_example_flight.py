"""Make the example flight that comes with the package, and the file that says what is true of it.

A Crazyflie flies 60 s of vertical excitation in closed loop in RotorPy, a simulator that others wrote,
and the log holds what an autopilot would log: commanded (not actual) rotor speeds, noisy sensors, the
trajectory's references. The seed was fixed before any estimate was seen and is never changed because
another one would look better.

    PYTHONPATH=. python examples/make_example_flight.py [FOLDER]
"""

from __future__ import annotations

import json
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import polars as pl

from eivor.logs.table.columnar import METADATA_KEY
from eivor.signals.recording import CONTROLLER_RATE
from eivor.simulation.environment import SensorNoise, SimulatedFlight, TrajectoryKind
from validation.effective_parameters import FlightTruth
from validation.flight_recipe.rotorpy_flight import RotorpyFlightSpec, Vehicle, simulate_rotorpy_flight

SPEC = RotorpyFlightSpec(
    vehicle=Vehicle.CRAZYFLIE,
    actuator_lag=0.072,
    delay=0.0,
    gust_rms=0.2,
    noise=SensorNoise(acceleration=0.4, velocity=0.03),
    trajectory=TrajectoryKind.MULTISINE,
    seed=20240617,
    duration=60.0,
)
FOLDER = Path(__file__).resolve().parent.parent / "src" / "eivor" / "data"

#: Step of the logged values by the beginning of the channel's name, in the channel's unit: powers of two,
#: far below the noise, so that the file compresses.
RESOLUTION = {
    "rotor_command": 2.0**-4,
    "specific_force": 2.0**-9,
    "velocity": 2.0**-12,
    "position": 2.0**-12,
    "attitude": 2.0**-14,
    "reference": 2.0**-14,
}

#: What is no column: the log holds every command of a controller of 100 Hz.
KEPT = {
    "frame": "Z_UP",
    "input_map": "",
    "parameters": {CONTROLLER_RATE: 100.0},
    "channels": {},
}


def table(flight: SimulatedFlight[FlightTruth]) -> pl.DataFrame:
    """One column for each channel under its canonical name, rounded to its resolution, and `time` [s]."""
    columns = {"time": flight.truth.time_s}
    for name, channel in sorted(flight.recording.channels.items()):
        step = next(step for start, step in RESOLUTION.items() if name.startswith(start))
        columns[name] = (np.round(channel.values / step) * step).astype(np.float32)
    return pl.DataFrame(columns)


def truth_record(flight: SimulatedFlight[FlightTruth]) -> dict[str, object]:
    """Return what is true of the flight, for the file beside the table."""
    truth = flight.truth
    return {
        "viscous_friction": truth.viscous_friction,
        "input_gain": truth.input_gain,
        "actuator_lag": truth.actuator_lag,
        "delay": truth.delay,
        "hover_input": truth.hover_input,
        "units": {
            "viscous_friction": "1/s",
            "input_gain": "m/s^2 per (rad/s)^2 of the mean squared rotor speed",
            "actuator_lag": "s",
            "delay": "s",
            "hover_input": "rad/s",
        },
        "input_map": flight.recording.input_map,
        "vehicle": "Crazyflie, RotorPy's rotorpy.vehicles.crazyflie_params",
        "simulator": "rotorpy",
        "simulator_version": version("rotorpy"),
        "seed": SPEC.seed,
        "duration": SPEC.duration,
        "trajectory": str(SPEC.trajectory),
        "gust_rms": SPEC.gust_rms,
        "noise": {"kind": str(SPEC.noise.kind)}
        | {name: getattr(SPEC.noise, name) for name in ("acceleration", "velocity", "position")},
        "provenance": (
            "Simulated by examples/make_example_flight.py. Friction: RotorPy's induced inflow coefficient "
            "times the sum of the rotor speeds at hover, over the mass; input gain: four thrust "
            "coefficients over the mass; lag: the shipped motor time constant, .072 s, which RotorPy takes "
            "from Eschmann et al. 2024 (arXiv 2404.07837)."
        ),
    }


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    flight = simulate_rotorpy_flight(SPEC)
    if not flight.flew:
        raise SystemExit("The vehicle was lost; the example is a flight, so nothing was written.")
    path = folder / "example_flight.parquet"
    metadata = {METADATA_KEY: json.dumps(KEPT)}
    table(flight).write_parquet(
        path, compression="zstd", compression_level=19, statistics=False, metadata=metadata
    )
    record = json.dumps(truth_record(flight), indent=2)
    (folder / "example_flight_truth.json").write_text(record + "\n", encoding="utf-8")
    print(f"{path.name}: {path.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
