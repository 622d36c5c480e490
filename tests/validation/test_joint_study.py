"""The study of joint against alone: its flights, its truth, its tables, and that it goes on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.simulation.environment import NoiseKind
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import AxisExcitations, Sensors, Wind
from validation.flight_recipe.trials import read_grid
from validation.joint import study as trials
from validation.joint.study import (
    ALONE,
    GIVEN,
    GRID,
    JOINT,
    LOST,
    TURNING,
    Told,
    effective_along,
    effective_vertical,
    flight_of,
    noise_of,
    requirements,
    run,
    tables,
)
from validation.studies import kept_lines


def told(flight: str, formula: str, half: float = 0.1, value: float = 0.42, **changes: object) -> Told:
    item = Told(flight, formula, "identified", "identified", 0.4, value, value - half, value + half)
    return replace(item, **changes)


def whole(half: float = 0.05) -> list[Told]:
    """Twenty flights, one of which misses, by each way."""
    return [
        told(f"gusty {number:03d}", formula, half if formula == JOINT else 0.08, 0.6 if number == 0 else 0.42)
        for number in range(20)
        for formula in (JOINT, GIVEN, TURNING, ALONE)
    ]


def test_a_flight_has_the_gusts_the_noise_and_the_lag_of_its_case():
    case = read_grid(GRID).cases[0]
    flight = flight_of(case.spec)
    assert flight.wind.z.std == case.spec.gust_rms
    assert flight.vehicle.rotors.lag_up == case.spec.actuator_lag
    assert flight.vehicle.rotors.delay == case.spec.delay
    assert flight.attitude.roll.amplitude == 0.25
    rng = np.random.default_rng(0)
    for kind in NoiseKind:
        assert noise_of(kind, 0.3, -0.4, 20_000).sample(20_000, rng).std() == pytest.approx(0.3, rel=0.3)


@pytest.mark.thorough
def test_without_gusts_and_tilt_both_truths_are_the_vehicle_s():
    spec = flight_of(replace(read_grid(GRID).cases[0].spec, duration=8.0))
    calm = replace(spec, wind=Wind(), attitude=AxisExcitations(), sensors=Sensors.exact())
    (flight,) = simulate_rigid_body_flights([calm])
    used = np.ones(flight.truth.time_s.size, dtype=np.bool_)
    nominal = flight.truth.parameters.drag[2]
    assert effective_along(flight, calm.vehicle, used) == pytest.approx(nominal, rel=0.02)
    assert effective_vertical(flight, calm.vehicle, used) == pytest.approx(nominal, rel=0.05)


def test_requirements_compare_what_is_identified_and_how_long_intervals_are():
    assert all(requirement.met for requirement in requirements(whole()))
    assert [requirement.met for requirement in requirements(whole(0.09))] == [True, False, True]
    weak = [replace(item, verdict="weak") if item.formula == JOINT else item for item in whole()]
    assert [requirement.met for requirement in requirements(weak)] == [False, True, True]
    missing = [replace(item, truth=1.0) if item.formula == JOINT else item for item in whole()]
    assert [requirement.met for requirement in requirements(missing)] == [True, True, False]


def test_tables_leave_out_what_was_lost():
    gone = Told("gusty 020", JOINT, LOST, LOST), Told("gusty 020", GIVEN, LOST, LOST)
    text = tables([*whole(), *gone])
    assert "21 flights, of which 1 were lost" in text
    assert "| rigid body | 20 of 21 |" in text


def test_a_run_goes_on_where_it_was_interrupted(tmp_path, monkeypatch):
    grid, kept = read_grid(GRID).small(), tmp_path / "kept.jsonl"
    flight = []

    def fly(specs):
        flight.extend(specs)
        return iter(specs)

    monkeypatch.setattr(trials, "simulate_rigid_body_flights", fly)
    monkeypatch.setattr(trials, "strength_of", lambda case, _flight, _vehicle: [told(case.name, JOINT)])
    first = run(grid, kept)
    assert len(flight) == len(first) == len(grid.cases) == 12
    assert run(grid, kept) == first == kept_lines(kept, Told)
    assert len(flight) == len(first)
