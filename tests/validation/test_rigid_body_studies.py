"""Studies of the rigid body, of turning, and of K by both motions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import polars as pl
import pytest

from validation.flight_recipe.rotorpy_flight import Vehicle
from validation.joint import study as joint
from validation.joint.study import ALONE, GIVEN, JOINT, TURNING
from validation.joint.study import Told as ToldOfK
from validation.pages import marks
from validation.rates import study as rates
from validation.rigid_body import study
from validation.rigid_body.study import PART, scores
from validation.rigid_body.trials import GROUPS, Task, published_grid, rows_of, tasks_of
from validation.studies import KeptRun, Requirement, Row

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


def told_of_rates(vehicle: str, condition: str, number: int) -> rates.Turned:
    return rates.Turned(
        vehicle, condition, number, rates.INSTRUMENTS, "roll_effectiveness", 0.01, -0.02, 0.03, True
    )


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


def required(lines: list[ToldOfK]) -> list[Requirement]:
    return list(joint.requirements(KeptRun(None, "full", Path(), lines)))


def test_requirements_compare_what_is_identified_and_how_long_intervals_are():
    assert all(requirement.met for requirement in required(all_formulas()))
    assert [requirement.met for requirement in required(all_formulas(0.09))] == [True, False, True]
    weak = [replace(item, verdict="weak") if item.formula == JOINT else item for item in all_formulas()]
    assert [requirement.met for requirement in required(weak)] == [False, True, True]
    missing = [replace(item, truth=1.0) if item.formula == JOINT else item for item in all_formulas()]
    assert [requirement.met for requirement in required(missing)] == [True, True, False]


@pytest.mark.parametrize(("study_of", "trials"), [(rates, None), (joint, 12)], ids=["rates", "joint"])
def test_a_run_goes_on_where_it_was_interrupted(study_of, trials, tmp_path, monkeypatch, capsys):
    kept, flown = tmp_path / "kept.jsonl", []

    def fly(specs):
        flown.extend(specs)
        return iter(specs)

    def strength_of(first, *others):
        if study_of is rates:
            vehicle, condition, number = others
            return [told_of_rates(vehicle, condition.name, number)]
        return [told_of_k(first.name, formula) for formula in joint.FORMULAS]

    monkeypatch.setattr(study_of, "simulate_rigid_body_flights", fly)
    monkeypatch.setattr(study_of, "strength_of", strength_of)
    code = study_of.main(["--kept", str(kept)])
    printed, lines = capsys.readouterr().out, kept.read_text()
    assert len(flown) == (trials or len(lines.splitlines()))
    assert study_of.main(["--kept", str(kept)]) == code
    assert (capsys.readouterr().out, kept.read_text()) == (printed, lines)
    assert len(flown) == (trials or len(lines.splitlines()))
