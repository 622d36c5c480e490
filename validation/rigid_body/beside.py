"""Tables of docs/rigid-body.md beside the grid: two lags, noisy tachometers, and more of the grid's flights.

    python -m validation.rigid_body.beside [--folder FOLDER] [--kinds WORD] [--page docs/rigid-body.md]

flies them, RotorPy's Crazyflie with the grid's nominal noise, and prints the tables. Finished flights are
kept in the folder, and a run that was interrupted goes on there; `--tables` makes the tables of what is done.
A table of which nothing was flown stays on the page as it is.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np
import polars as pl

from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import DRAG, GAIN, THRUST
from eivor.signals.noise import WhiteNoise
from eivor.signals.recording import Recording
from eivor.simulation.controller import Sensor
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import RigidBodyFlightSpec
from validation.flight_recipe.rotorpy_flight import Vehicle
from validation.pages import markdown
from validation.rigid_body.study import cell, scores
from validation.rigid_body.trials import (
    GROUPS,
    LAG,
    NOISE,
    flight_of,
    jittered,
    known_vehicle,
    published_grid,
    truth_of,
)
from validation.studies import Row, StudyFolder, StudyTable, folder_command

VEHICLE = Vehicle.CRAZYFLIE
LEAST_SQUARES, TOTAL, INSTRUMENTS = "whitened_least_squares", "total_least_squares", "reference_iv"
#: Lags of rotors that speed up and slow down [s].
LAGS_S = ((0.072, 0.072), (0.060, 0.072), (0.060, 0.090))
#: Noise of a tachometer, as a share of the speed at hover, and flights of each.
SPEED_NOISES, SPEED_FLIGHTS = (0.01, 0.03), 12
#: First seed of both, see `Scenario`.
LAGS_SEED, SPEED_SEED = 80000, 81000
LAGS, SPEEDS, STAMPS, DELAYS = "two lags", "measured speeds", "erring stamps", "known delay"
CALM, TORQUES = "further calm", "further torques"
#: Scenarios of the grid, with their own seeds and numbers of flights, of which there is a table.
NOMINAL = "nominal noise"
OF_GRID = {
    STAMPS: "stamps out of step, with 1 ms of jitter",
    DELAYS: NOMINAL,
    CALM: NOMINAL,
    TORQUES: "torques of the air, and every fourth command",
}
#: Of these the flights that follow those of the grid, as many again.
FURTHER = (CALM, TORQUES)
#: What the tables of lags and speeds show, in order.
PLOTTED = (*(item.name for item in GAIN), THRUST.name, DRAG[2].name)


@dataclass(frozen=True, slots=True)
class Flown:
    kind: str  # Which table it is of
    case: int  # Which of its lags or noises, and which flight with these
    number: int

    @property
    def file_name(self) -> str:
        """Name of the file that its rows are kept in, without its ending."""
        return f"{self.kind.replace(' ', '-')}-{self.case}-{self.number:02d}"

    @property
    def facts(self) -> Mapping[str, str]:
        return {"flight": self.file_name}

    @property
    def flights(self) -> int:
        return 1


def all_flights() -> list[Flown]:
    lags = [Flown(LAGS, case, 0) for case in range(len(LAGS_S))]
    speeds = [Flown(SPEEDS, case, n) for n in range(SPEED_FLIGHTS) for case in range(len(SPEED_NOISES))]
    of_grid = [
        Flown(kind, 0, number)
        for kind, name in OF_GRID.items()
        for number in range(published_grid().scenario(name).count)
    ]
    return [*lags, *speeds, *of_grid]


def rows_of(suite_study: Flown) -> tuple[Row, ...]:
    """Rows of a flight: one for each method and quantity."""
    if suite_study.kind in OF_GRID:
        return _rows_of_grid(suite_study)
    scenario = msgspec.structs.replace(
        published_grid().scenario(NOMINAL), seed=LAGS_SEED if suite_study.kind == LAGS else SPEED_SEED
    )
    spec = flight_of(VEHICLE, scenario, published_grid().seconds, suite_study.number)
    spec, noise = (
        (_two_lags(spec, suite_study.case), None)
        if suite_study.kind == LAGS
        else _noisy(spec, suite_study.case)
    )
    (flight,) = simulate_rigid_body_flights([spec])
    truth = truth_of(flight.truth.parameters)
    truth[LAG] = float(np.mean(LAGS_S[suite_study.case])) if suite_study.kind == LAGS else 0.0
    methods = (
        (LEAST_SQUARES, INSTRUMENTS) if suite_study.kind == LAGS else (LEAST_SQUARES, TOTAL, INSTRUMENTS)
    )
    motion = RigidBody(known_vehicle(VEHICLE, scenario))
    return tuple(
        row
        for method in methods
        for row in _rows(suite_study, method, truth, identified(flight.recording, motion, method, noise))
    )


def _rows_of_grid(first: Flown) -> tuple[Row, ...]:
    """Rows of a flight of the grid, by the method judged; with its delay where that is to be known."""
    scenario = published_grid().scenario(OF_GRID[first.kind])
    number = first.number + (scenario.count if first.kind in FURTHER else 0)
    (flight,) = simulate_rigid_body_flights([flight_of(VEHICLE, scenario, published_grid().seconds, number)])
    log = jittered(flight.recording, scenario.jitter_s, scenario.seed + number)
    if first.kind == DELAYS:
        scenario = msgspec.structs.replace(scenario, taken_delay_s=scenario.delay_s)
    motion = RigidBody(known_vehicle(VEHICLE, scenario))
    reported = identified(log, motion, scenario.methods[0], None)
    return tuple(_rows(first, scenario.methods[0], truth_of(flight.truth.parameters), reported))


def identified(
    log: Recording, motion: RigidBody, method: str, noise: Mapping[str, float] | None
) -> FlightEstimate:
    """What a method tells of a flight; of measured speeds where their noise is declared."""
    if noise is None:
        return identify_flight(log, model=motion, method=method)
    declared = noise if method == TOTAL else None
    return identify_flight(log, model=motion, method=method, input="rotor_speed", noise=declared)


def _two_lags(spec: RigidBodyFlightSpec, case: int) -> RigidBodyFlightSpec:
    up, down = LAGS_S[case]
    rotors = replace(spec.vehicle.rotors, lag_up=up, lag_down=down)
    return replace(spec, vehicle=replace(spec.vehicle, rotors=rotors))


def _noisy(spec: RigidBodyFlightSpec, case: int) -> tuple[RigidBodyFlightSpec, Mapping[str, float]]:
    """Flight with tachometers, and the noises of all its sensors."""
    std = SPEED_NOISES[case] * spec.vehicle.hover_speed
    sensors = replace(spec.sensors, rotor_speed=Sensor(WhiteNoise(std)))
    gyroscope, accelerometer, velocity, _, _ = NOISE
    known = {"angular_rate": gyroscope, "specific_force_body": accelerometer, "velocity": velocity}
    by_axis = {f"{name}_{axis}": level for name, level in known.items() for axis in "xyz"}
    return replace(spec, sensors=sensors), {"rotor_speed": std, **by_axis}


def _rows(first: Flown, method: str, truth: Mapping[str, float], validation: FlightEstimate) -> Iterator[Row]:
    agreement = validation.diagnostics.get("over_identification_p_value", np.nan)
    for name, true in truth.items():
        quantity = validation.quantities.get(name)
        reported = (np.nan, np.nan, np.nan) if quantity is None else (quantity.value, *quantity.interval)
        yield {
            "kind": first.kind,
            "case": first.case,
            "number": first.number,
            "method": method,
            "quantity": name,
            "truth": true,
            **dict(zip(("value", "low", "high"), reported, strict=True)),
            "verdict": validation.verdict.status.value,
            "agreement": agreement,
        }


# -- tables -----------------------------------------------------------------------------------------------


def tables(table: StudyTable) -> dict[str, str]:
    """Tables as Markdown, by the names of their parts of the page; of the kinds of which any was flown."""
    made = {LAGS: _table_of_lags, SPEEDS: _table_of_speeds, **dict.fromkeys(OF_GRID, _table_of_grid)}
    of_kind = {kind: table.rows.filter(pl.col("kind") == kind) for kind in made}
    return {kind: make(of_kind[kind]) for kind, make in made.items() if of_kind[kind].height}


def _table_of_lags(rows: pl.DataFrame) -> str:
    header = (
        "up, down",
        "by",
        "lag, against the mean of both",
        "roll, pitch, yaw gain",
        "thrust gain",
        "drag along z",
        "verdict, agreement of references",
    )
    lines = []
    for (case, method), item in rows.group_by(["case", "method"], maintain_order=True):
        rows_by_name = {str(entry["quantity"]): entry for entry in item.iter_rows(named=True)}
        lag, *gains, thrust, drag = (_error(rows_by_name[name]) for name in (LAG, *PLOTTED))
        verdict = f"{item['verdict'][0]}"
        if method == INSTRUMENTS:
            verdict += f", p = {item['agreement'][0]:.1g}"
        up, down = (f"{1e3 * lag_s:.0f}" for lag_s in LAGS_S[int(str(case))])
        lines.append((f"{up}, {down} ms", f"`{method}`", lag, ", ".join(gains), thrust, drag, verdict))
    return markdown(header, lines)


def _error(row: Mapping[str, Any]) -> str:
    """Error relative to the truth; in brackets where the interval misses it."""
    text = f"{100.0 * (row['value'] / row['truth'] - 1.0):+.1f} %"
    return text if row["low"] <= row["truth"] <= row["high"] else f"({text})"


def _table_of_speeds(rows: pl.DataFrame) -> str:
    """Errors of flights that are not refused, and how many these are."""
    header = ("noise of speeds", "by", "told", "roll", "pitch", "yaw gain", "thrust gain", "drag along z")
    lines = []
    for (case, method), item in rows.group_by(["case", "method"], maintain_order=True):
        reported = item.filter(pl.col("verdict") != Status.REFUSED.value)
        result = scores(reported)
        cells = [
            f"{100.0 * entry.bias:+.1f}, {100.0 * entry.rmse:.1f} % [{entry.covered.value:.2f}]"
            if entry
            else "-"
            for entry in (result.get(name) for name in PLOTTED)
        ]
        share = f"{100.0 * SPEED_NOISES[int(str(case))]:.2g} %"
        count = f"{reported['number'].n_unique()} of {item['number'].n_unique()}"
        lines.append((share, f"`{method}`", count, *cells))
    return markdown(header, lines)


def _table_of_grid(rows: pl.DataFrame) -> str:
    result = scores(rows)
    groups = {name: names for name, names in GROUPS.items() if set(names) & set(result)}
    flights = f"{rows['number'].n_unique()}"
    return markdown(("flights", *groups), [(flights, *(cell(result, names) for names in groups.values()))])


def folder_of(chosen: argparse.Namespace) -> StudyFolder[Flown]:
    flights = [flight for flight in all_flights() if chosen.word in flight.kind]
    planned = len(all_flights())
    return StudyFolder(chosen.folder, flights, "beside", "", "validation.rigid_body", planned, rows_of)


main = folder_command(
    "validation.rigid_body.beside", __doc__, LAGS, "--kinds", folder_of, lambda table: (tables(table), ())
).main

if __name__ == "__main__":
    sys.exit(main())
