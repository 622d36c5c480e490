"""Studies of the rigid body, of turning, and of K by both motions."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import polars as pl
import pytest

from eivor.lab.experiments import marks
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import AxisExcitations, Sensors, Wind
from validation.flight_recipe.rotorpy_flight import Vehicle
from validation.flight_recipe.trials import read_grid
from validation.joint import study as joint
from validation.joint.study import ALONE, GIVEN, JOINT, TURNING, effective_along, effective_vertical
from validation.joint.study import GRID as JOINT_GRID
from validation.joint.study import Told as ToldOfK
from validation.joint.study import flight_of as joint_flight_of
from validation.joint.study import requirements as joint_requirements
from validation.joint.study import run as run_joint
from validation.rates import study as rates
from validation.rates.study import GRID as RATES_GRID
from validation.rates.study import INSTRUMENTS, VEHICLES
from validation.rates.study import Grid as RatesGrid
from validation.rates.study import Told as ToldOfRates
from validation.rates.study import run as run_rates
from validation.rigid_body import study
from validation.rigid_body.study import PART, scores
from validation.rigid_body.trials import GROUPS, Task, published_grid, rows_of, tasks_of
from validation.studies import Row, kept_lines, read_as

pytest.importorskip("rotorpy")


QUANTITIES = [name for names in GROUPS.values() for name in names]


def rows(error: float = 0.0, half_width: float = 0.01, **only: float) -> pl.DataFrame:
    """Thirty flights of every scenario, each quantity off by as much, or those named."""
    result: list[Row] = []
    for scenario in published_grid().scenarios:
        for vehicle in scenario.vehicles:
            for number in range(30):
                for name in QUANTITIES:
                    value = 2.0 * (1.0 + only.get(name, error))
                    row = {"scenario": scenario.name, "vehicle": str(vehicle), "number": number}
                    row |= {"method": scenario.methods[0], "quantity": name, "truth": 2.0, "value": value}
                    ends = {"low": value - half_width, "high": value + half_width}
                    result.append({**row, **ends, "verdict": "identified"})
    return pl.DataFrame(result)


@pytest.mark.thorough
def test_a_run_goes_on_and_fills_its_page(tmp_path, monkeypatch, capsys):
    made: list[Task] = []

    def fake(task: Task) -> tuple[Row, ...]:
        made.append(task)
        current = pl.col("number").is_between(task.first, task.last - 1) & (
            pl.col("vehicle") == str(task.vehicle)
        )
        return tuple(rows().filter((pl.col("scenario") == task.scenario) & current).to_dicts())

    monkeypatch.setattr(study, "rows_of", fake)
    begin, end = marks(PART)
    page = tmp_path / "page.md"
    page.write_text(f"# Page\n\n{begin}\n{end}\n", encoding="utf-8")
    chosen = ["--folder", str(tmp_path / "rows"), "--workers", "1", "--share", "0.05"]
    assert study.main([*chosen, "--page", str(page), "--out", str(tmp_path / "rows.parquet")]) == 3
    assert len(made) == len(tasks_of(published_grid(), 0.05))
    printed = capsys.readouterr().out
    assert printed.strip() in page.read_text(encoding="utf-8")
    assert "| nominal noise, whitened_least_squares | 10 |" in printed
    assert study.main([*chosen, "--tables"]) == 3
    assert study.main(["--from", str(tmp_path / "rows.parquet")]) == 3
    assert len(made) == len(tasks_of(published_grid(), 0.05))


@pytest.mark.calibration
def test_a_flight_of_the_study_is_flown_and_told(monkeypatch):
    """One flight of every third of a minute, from its specification to its rows."""
    from validation.rigid_body import trials

    grid = msgspec.structs.replace(published_grid(), seconds=20.0)
    monkeypatch.setattr(trials, "published_grid", lambda: grid)
    for name in ("nominal noise", "stamps out of step, with 1 ms of jitter"):
        reported = scores(pl.DataFrame(list(rows_of(Task(name, Vehicle.CRAZYFLIE, 0, 1)))))
        for quantity in GROUPS["torque gains"] + GROUPS["lag"]:
            assert reported[quantity].largest < 0.01


def told_of_rates(condition: str, error: float = 0.01, **changes: object) -> ToldOfRates:
    item = ToldOfRates("usual", condition, 0, INSTRUMENTS, "roll_effectiveness", error, -0.02, 0.03, True)
    return replace(item, **changes)


def test_rates_go_on_where_they_were_interrupted(tmp_path, monkeypatch):
    grid, kept = read_as(RatesGrid, RATES_GRID), tmp_path / "kept.jsonl"
    flight = []

    def fly(specs):
        flight.extend(specs)
        return iter(specs)

    monkeypatch.setattr(rates, "simulate_rigid_body_flights", fly)
    monkeypatch.setattr(
        rates,
        "strength_of",
        lambda _flight, vehicle, condition, number: [
            told_of_rates(condition.name, vehicle=vehicle, number=number)
        ],
    )
    first = run_rates(grid, "small", kept)
    assert len(flight) == len(first) == len(VEHICLES) * len(grid.conditions)
    assert run_rates(grid, "small", kept) == first == kept_lines(kept, ToldOfRates)
    assert len(flight) == len(first)


def told_of_k(
    flight: str, formula: str, half: float = 0.1, value: float = 0.42, **changes: object
) -> ToldOfK:
    item = ToldOfK(flight, formula, "identified", "identified", 0.4, value, value - half, value + half)
    return replace(item, **changes)


def all_formulas(half: float = 0.05) -> list[ToldOfK]:
    """Twenty flights, one of which misses, by each way."""
    return [
        told_of_k(
            f"gusty {number:03d}", formula, half if formula == JOINT else 0.08, 0.6 if number == 0 else 0.42
        )
        for number in range(20)
        for formula in (JOINT, GIVEN, TURNING, ALONE)
    ]


@pytest.mark.thorough
def test_without_gusts_and_tilt_both_truths_are_the_vehicle_s():
    spec = joint_flight_of(replace(read_grid(JOINT_GRID).cases[0].spec, duration=8.0))
    calm = replace(spec, wind=Wind(), attitude=AxisExcitations(), sensors=Sensors.exact())
    (flight,) = simulate_rigid_body_flights([calm])
    used = np.ones(flight.truth.time_s.size, dtype=np.bool_)
    nominal = flight.truth.parameters.drag[2]
    assert effective_along(flight, calm.vehicle, used) == pytest.approx(nominal, rel=0.02)
    assert effective_vertical(flight, calm.vehicle, used) == pytest.approx(nominal, rel=0.05)


def test_requirements_compare_what_is_identified_and_how_long_intervals_are():
    assert all(requirement.met for requirement in joint_requirements(all_formulas()))
    assert [requirement.met for requirement in joint_requirements(all_formulas(0.09))] == [True, False, True]
    weak = [replace(item, verdict="weak") if item.formula == JOINT else item for item in all_formulas()]
    assert [requirement.met for requirement in joint_requirements(weak)] == [False, True, True]
    missing = [replace(item, truth=1.0) if item.formula == JOINT else item for item in all_formulas()]
    assert [requirement.met for requirement in joint_requirements(missing)] == [True, True, False]


def test_a_run_goes_on_where_it_was_interrupted(tmp_path, monkeypatch):
    grid, kept = read_grid(JOINT_GRID).small(), tmp_path / "kept.jsonl"
    flight = []

    def fly(specs):
        flight.extend(specs)
        return iter(specs)

    monkeypatch.setattr(joint, "simulate_rigid_body_flights", fly)
    monkeypatch.setattr(joint, "strength_of", lambda case, _flight, _vehicle: [told_of_k(case.name, JOINT)])
    first = run_joint(grid, kept)
    assert len(flight) == len(first) == len(grid.cases) == 12
    assert run_joint(grid, kept) == first == kept_lines(kept, ToldOfK)
    assert len(flight) == len(first)
