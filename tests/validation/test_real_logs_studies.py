"""Logs as they are: the simulator's physics and loggers, the study's requirements, bounds of pools."""

from __future__ import annotations

import json

import numpy as np
import pytest
from msgspec.structs import replace as struct_replace

from eivor.errors import InputError
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.model import GRAVITY
from eivor.signals.filters import actuator_state
from eivor.simulation.environment import SensorNoise
from validation.pages import marks
from validation.real_logs import scoreboard, study
from validation.real_logs.closed_loop import STEP_S, FlightSpec, LoggerSpec, Reference, VehicleSpec
from validation.real_logs.flights import LoggedFlight, logged_flight
from validation.real_logs.study import PART, far_off
from validation.real_logs.trials import folder_of, grid_from, published_grid
from validation.studies import StudyFolder

QUIET = LoggerSpec(noise=SensorNoise.none())


def flown(vehicle: VehicleSpec, logger: LoggerSpec = QUIET, **flight) -> LoggedFlight:
    chosen = {"duration": 4.0, "reference": Reference.CHIRP, "seed": 7} | flight
    return logged_flight(FlightSpec(vehicle, logger, **chosen))


def effective(flight: LoggedFlight) -> dict[str, float]:
    time = flight.flown.truth.time_s
    return flight.flown.effective(time, np.ones(time.size, dtype=bool))


def test_motion_obeys_its_equation():
    truth = (flight := flown(VehicleSpec(gust_rms=0.5, horizontal_friction=0.4)).flown).truth
    thrust = GRAVITY / 0.5**2 * truth.cos_tilt * truth.rotor_state[:, 0] ** 2
    np.testing.assert_allclose(truth.specific_force_z, thrust - 0.4 * truth.air_velocity_z, atol=1e-9)
    gained = np.diff(flight.velocity) / STEP_S
    middle = 0.5 * (truth.specific_force_z[1:] + truth.specific_force_z[:-1]) - GRAVITY
    assert np.abs(gained - middle).max() < 0.06 * np.abs(middle).max()
    assert abs((gained - middle).mean()) < 1e-3


def test_rotor_follows_its_command_with_lag_and_delay():
    flight = flown(VehicleSpec(actuator_lag=0.05, delay=0.02)).flown
    expected = actuator_state(flight.command, step_s=STEP_S, lag_s=0.05, delay_s=0.02)
    np.testing.assert_allclose(flight.truth.rotor_state[600:], expected[600:], atol=1e-11)


def test_effective_values_are_nominal_where_the_model_holds():
    result = effective(
        flown(VehicleSpec(actuator_lag=0.03, delay=0.01, updraft=1.0, horizontal_friction=0.4))
    )
    assert result["viscous_friction"] == pytest.approx(0.4, abs=1e-6)
    assert result["input_gain"] == pytest.approx(GRAVITY / 0.25, rel=1e-6)
    assert result["effective_lag"] == pytest.approx(0.04)
    # An updraft of 1 m/s carries K of the weight, and half of its share is the share of the command.
    assert result["hover_input"] == pytest.approx(0.5 * (1.0 - 0.4 / GRAVITY) ** 0.5, rel=1e-3)


@pytest.mark.parametrize(
    ("vehicle", "name", "expected"),
    [
        (VehicleSpec(thrust_power=1.0), "input_gain", GRAVITY / 0.25),
        (VehicleSpec(thrust_share=0.5), "hover_input", 0.5),
        (VehicleSpec(voltage_sag=0.1), "input_gain", 0.903 * GRAVITY / 0.25),
    ],
)
def test_effective_values_are_those_of_the_true_thrust(vehicle, name, expected):
    assert effective(flown(vehicle))[name] == pytest.approx(expected, rel=0.01)


@pytest.mark.thorough
def test_motors_of_two_lags_have_an_effective_one_between():
    even, slower = (VehicleSpec(actuator_lag=0.05, delay=0.01, slower_down=by) for by in (1.0, 1.5))
    assert effective(flown(even))["effective_lag"] == pytest.approx(0.06, abs=1e-9)
    lag = effective(flown(slower))["effective_lag"]
    assert 0.066 < lag < 0.080
    log = flown(slower, LoggerSpec(), duration=40.0)
    low, high = identify_flight(log.recording).quantities["effective_lag"].interval
    assert low < effective(log)["effective_lag"] < high


GRID = published_grid()


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ("flights = 170", "flights = 170.5", "Expected `int`, got `float` - at `$.family[1].flights`"),
        ("seed = 1200000", "seed = 1100001", "parts with names and seeds of their own"),
        ("thrust_power = 1.0", "thrust_might = 1.0", "keys of a flight; received thrust_might"),
        ('holds = "short"', 'holds = "perhaps"', "Invalid enum value 'perhaps' - at `$.family["),
    ],
)
def test_damaged_grid_is_refused(before, after, expected):
    assert before in GRID.text
    with pytest.raises(InputError) as caught:
        grid_from(GRID.text.replace(before, after, 1))
    assert expected in str(caught.value)


@pytest.mark.thorough
def test_command_flies_a_family_and_fills_the_page(tmp_path, capsys, monkeypatch):
    """One short flight from its specification to the tables."""
    (short,) = [family for family in GRID.families if family.holds == "short"]
    grid = struct_replace(GRID, families=(struct_replace(short, count=1),))
    monkeypatch.setattr(study, "published_grid", lambda: grid)
    begin, end = marks(PART)
    page = tmp_path / "page.md"
    page.write_text(f"# Page\n\n{begin}\n{end}\n", encoding="utf-8")
    chosen = ["--folder", str(tmp_path / "rows"), "--workers", "1", "--page", str(page)]
    assert study.main(chosen) == 3
    printed = capsys.readouterr().out
    assert "| 15 s | 1 | " in printed
    assert "| 15 s: coverage of K | at least 0.9, or weak |" in printed
    assert printed.strip() in page.read_text(encoding="utf-8")
    (row,) = folder_of(tmp_path / "rows", grid).gathered().rows.to_dicts()
    vehicle = short.flight(0).vehicle
    assert row["truth.effective_lag"] == pytest.approx(vehicle.actuator_lag + vehicle.delay)
    assert row["truth.viscous_friction"] == pytest.approx(vehicle.viscous_friction, rel=0.01)
    monkeypatch.setattr(StudyFolder, "run", None)
    assert study.main([*chosen, "--tables"]) == 3
    assert capsys.readouterr().out == printed


@pytest.mark.calibration
def test_small_size(tmp_path):
    """A few flights of the families of clocks: accepted, and few intervals miss."""
    grid = study.part_of(GRID, 0.025, "r")
    families = tuple(
        family
        for family in grid.families
        if family.holds == "yes" and family.flight(0).duration < 100.0 and not family.flight(0).multirotor
    )
    folder = folder_of(tmp_path, struct_replace(grid, families=families[:3]))
    folder.run(1)
    table = folder.gathered().rows
    assert table.height >= 12
    assert (table["verdict"] == "identified").mean() > 0.6
    assert far_off(table).value < 0.2


def test_scoreboard_counts_verdicts_and_pairs_that_agree(tmp_path, capsys):
    def row(name, mode, verdict, value, p_value=0.5):
        friction = ["viscous_friction", verdict, value, value - 0.1, value + 0.1]
        return {"log": name, "mode": mode, "p_value": p_value, "quantities": [friction]}

    flights = ("alone", "identified", 0.3, 0.01), ("alone", "weak", 0.5), ("alone", "identified", 0.41)
    rows = [row(f"nanobench/B9_trefoil_slow_rep{index}.csv", *flight) for index, flight in enumerate(flights)]
    rows += [row("nanobench/B3.csv", "half", "identified", value) for value in (0.3, 0.4)]
    (path := tmp_path / "rows.json").write_text(json.dumps(rows), encoding="utf-8")
    assert scoreboard.main(["--from", str(path)]) == 0
    printed = capsys.readouterr().out
    assert "| trefoils, alone | 3 | 1/3 | 0 | 0 | 2/1/0 (0.1) | 0/0/3 (nan) |" in printed
    assert "| trefoils, alone, identified | 1/1 |" in printed
    assert "| trefoils, alone, or rough | 2/3 |" in printed
    assert "| other NanoBench, half, identified | 1/1 |" in printed
