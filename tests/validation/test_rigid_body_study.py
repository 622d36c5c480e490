"""The study of the rigid body: its grid, its flights and their stamps, its tables, and what is asked."""

from __future__ import annotations

import msgspec
import numpy as np
import polars as pl
import pytest

from eivor.errors import InputError
from eivor.lab.experiments import marks
from eivor.signals.recording import Channel, Frame, Recording
from validation.flight_recipe.rotorpy_flight import Vehicle
from validation.rigid_body import study
from validation.rigid_body.study import PART, requirements, scores, study_tables
from validation.rigid_body.trials import (
    GRID,
    GROUPS,
    Grid,
    Task,
    flight_of,
    jittered,
    known_vehicle,
    published_grid,
    rows_of,
    tasks_of,
    truth_of,
    unit_of_error,
)
from validation.studies import Row, StudyTable, read_as

pytest.importorskip("rotorpy")

TEXT = GRID.read_text(encoding="utf-8")
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


def unmet(table: pl.DataFrame) -> set[str]:
    return {requirement.what for requirement in requirements(table, published_grid()) if not requirement.met}


def test_the_grid_asks_what_it_was_published_with():
    grid = published_grid()
    nominal = grid.scenario("nominal noise")
    assert nominal.count == 200
    assert nominal.rmse["torque gains"] == 0.001
    assert nominal.coverage_pooled == (0.92, 0.97)
    exact = grid.scenario("no noise")
    assert set(exact.largest) == set(GROUPS)
    assert len(exact.vehicles) == 3
    assert known_vehicle(Vehicle.CRAZYFLIE, grid.scenario("a delay of 4 ms")).delay is None
    assert (
        known_vehicle(Vehicle.CRAZYFLIE, grid.scenario("a delay of 4 ms, taken for none")).delay.value == 0.0
    )


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ('vehicles = ["crazyflie", ', 'vehicles = ["dragonfly", ', "vehicles"),
        ('"torque gains" = 0.001', '"torque" = 0.001', "groups out of torque gains"),
        ("jitter = 0.001", "jiter = 0.001", "jiter"),
    ],
)
def test_a_damaged_grid_is_refused(before, after, expected):
    assert before in TEXT
    with pytest.raises(InputError, match=expected):
        read_as(Grid, GRID, TEXT.replace(before, after, 1))


def test_scenarios_are_flown_as_they_say():
    grid = published_grid()
    plain, thinned = grid.scenario("nominal noise"), grid.scenario("and commands at 125 of 500 Hz")
    spec = flight_of(Vehicle.CRAZYFLIE, plain, 5.0, 3)
    assert spec.seed == plain.seed + 3
    assert spec.rate_hz == spec.controller.rate_hz == 500.0
    spec = flight_of(Vehicle.CRAZYFLIE, thinned, 5.0, 0)
    assert (spec.rate_hz, spec.controller.rate_hz, spec.logged.rotor_command_hz) == (1000.0, 500.0, 125.0)
    assert spec.sensors.angular_rate.jitter_s == 0.001
    filtered = flight_of(
        Vehicle.CRAZYFLIE, grid.scenario("onboard filters, delay, torques of the air"), 5.0, 0
    )
    assert filtered.sensors.angular_rate.cutoff_hz == 80.0
    assert filtered.torque_disturbance.roll.std == 4.0


def test_stamps_of_commands_err_together_and_keep_their_order():
    time_s, values = 0.002 * np.arange(500), np.zeros(500)
    channels = {
        name: Channel(name, time_s, values, "rad/s", held=name.startswith("rotor"))
        for name in ("rotor_command_1", "rotor_command_2", "angular_rate_x")
    }
    log = Recording("flight", "simulation", channels, frame=Frame.Z_UP)
    assert jittered(log, 0.0, 1) is log
    moved = jittered(log, 0.001, 1).channels
    first, second = (moved[f"rotor_command_{number}"].time_s for number in (1, 2))
    np.testing.assert_array_equal(first, second)
    assert (np.diff(first) > 0.0).all()
    assert 5e-4 < np.std(first - time_s) < 1e-3
    np.testing.assert_array_equal(moved["angular_rate_x"].time_s, time_s)


def test_errors_are_relative_but_of_ratios_that_are_nearly_zero():
    assert unit_of_error("yaw_coupling", -0.004) == 1.0
    assert unit_of_error("roll_coupling", -1.02) == 1.02
    assert unit_of_error("drag_x", 0.25) == 0.25
    assert set(truth_of(_parameters())) == set(QUANTITIES)


def _parameters():
    from eivor.motions.rigid_body.dynamics import effective_parameters
    from validation.rigid_body.trials import flown_vehicle

    return effective_parameters(flown_vehicle(Vehicle.HUMMINGBIRD, published_grid().scenarios[0]))


def test_requirements_look_at_errors_bias_and_coverage():
    assert {name.split(":")[1] for name in unmet(rows())} == {" coverage of all"}  # all of them hold
    off = unmet(rows(roll_gain=0.004, half_width=1.0))
    assert "nominal noise: RMSE, torque gains" in off
    assert "no noise, crazyflie: largest error, torque gains" in off
    assert "and commands at 125 of 500 Hz: bias, torque gains" not in off
    short = unmet(rows(0.0005, half_width=1e-5))
    assert {"nominal noise: coverage of each", "nominal noise: coverage of all"} <= short
    assert not any("RMSE" in what or "largest" in what for what in short)


def test_a_flight_that_tells_nothing_misses():
    table = rows().with_columns(
        [
            pl.when(pl.col("number") == 0).then(np.nan).otherwise(pl.col(name)).alias(name)
            for name in ("value", "low", "high")
        ]
    )
    score = scores(table.filter(pl.col("scenario") == "nominal noise"))["roll_gain"]
    assert (score.count, score.covered.hits, score.covered.count) == (29, 29, 30)


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
    assert study.main(["--folder", str(tmp_path / "none"), "--tables"]) == 2


def test_tables_have_every_scenario():
    tables = study_tables(
        StudyTable(rows(), {"made with": "it", "grid": "1", "flights": "30"}), published_grid()
    )
    for scenario in published_grid().scenarios:
        assert f"| {scenario.name}" in tables


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
