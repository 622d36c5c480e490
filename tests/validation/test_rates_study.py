"""The study of turning: its grid, its flights, its tables, and that it goes on where it was interrupted."""

from __future__ import annotations

from dataclasses import replace

import pytest

from eivor.errors import InputError
from validation.rates import study as trials
from validation.rates.study import (
    GRID,
    INSTRUMENTS,
    LEAST_SQUARES,
    VEHICLES,
    Grid,
    Told,
    flight_of,
    main,
    requirements,
    run,
    tables,
)
from validation.studies import kept_lines, read_as


def told(condition: str, error: float = 0.01, **changes: object) -> Told:
    item = Told("usual", condition, 0, INSTRUMENTS, "roll_effectiveness", error, -0.02, 0.03, True)
    return replace(item, **changes)


def whole(error: float = 0.01) -> list[Told]:
    """A flight of each condition by each quantity."""
    return [
        told(condition.name, size, quantity=quantity)
        for condition in read_as(Grid, GRID).conditions
        for quantity, size in (
            ("roll_effectiveness", error),
            ("pitch_effectiveness", error),
            ("effective_lag", 1e-3),
        )
    ]


def test_the_published_grid_flies_every_vehicle_alike():
    grid = read_as(Grid, GRID)
    assert {condition.judged for condition in grid.conditions} == {"50 Hz", "250 Hz", "small"}
    specs = [flight_of(vehicle, grid.conditions[0], 2.0, 1) for vehicle in VEHICLES]
    assert {spec.controller.rate_hz for spec in specs} == {400.0}
    assert {spec.logged.setpoint_hz for spec in specs} == {50.0}


def test_requirements_look_at_errors_and_at_what_is_accepted():
    grid = read_as(Grid, GRID)
    assert all(requirement.met for requirement in requirements(grid, whole()))
    unmet = [requirement.what for requirement in requirements(grid, whole(0.05))]
    assert [requirement.what for requirement in requirements(grid, whole(0.05)) if not requirement.met] == [
        "effectiveness, 250 Hz"
    ]
    assert len(unmet) == 6
    hover = next(condition.name for condition in grid.conditions if not condition.steps)
    missing = told(hover, below=0.01)
    for accepted, met in ((True, False), (False, True)):
        results = [*whole(), replace(missing, accepted=accepted)]
        assert list(requirements(grid, results))[-1].met is met


def test_tables_have_least_squares_beside():
    large = read_as(Grid, GRID).conditions[0].name
    plain = [
        told(large, error, method=LEAST_SQUARES, quantity=name, accepted=False)
        for name, error in (("roll_effectiveness", -0.5), ("effective_lag", 0.047))
    ]
    lines = tables(read_as(Grid, GRID), [*whole(), *plain]).splitlines()
    assert any("-50%, +47 ms" in line for line in lines)


def test_a_run_goes_on_where_it_was_interrupted(tmp_path, monkeypatch):
    grid, kept = read_as(Grid, GRID), tmp_path / "kept.jsonl"
    flight = []

    def fly(specs):
        flight.extend(specs)
        return iter(specs)

    monkeypatch.setattr(trials, "simulate_rigid_body_flights", fly)
    monkeypatch.setattr(
        trials,
        "strength_of",
        lambda _flight, vehicle, condition, number: [told(condition.name, vehicle=vehicle, number=number)],
    )
    first = run(grid, "small", kept)
    assert len(flight) == len(first) == len(VEHICLES) * len(grid.conditions)
    assert run(grid, "small", kept) == first == kept_lines(kept, Told)
    assert len(flight) == len(first)


def test_a_grid_that_is_none_is_refused(tmp_path, capsys):
    wrong = tmp_path / "grid.toml"
    wrong.write_text(GRID.read_text().replace('judged = "small"', 'judged = "large"', 1))
    with pytest.raises(InputError, match="judged"):
        read_as(Grid, wrong)
    assert main(["--grid", str(wrong), "--kept", str(tmp_path / "kept.jsonl")]) == 2
    assert "judged" in capsys.readouterr().err
