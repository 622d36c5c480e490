"""The program that flies a plan, against a simulated system, through every branch."""

from __future__ import annotations

import ast
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from eivor.planning.plan import FlightPlan
from eivor.planning.written.offboard import MARK, mavsdk_text
from planning.fake_mavsdk import FlightMode, Vehicle, fly


@pytest.fixture
def flight(
    multisine: FlightPlan,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
):
    """Fly the plan with a vehicle; returns the exit code and what was printed."""

    def flown(vehicle: Vehicle, *, begin: bool = True) -> tuple[int, str]:
        code = fly(mavsdk_text(multisine), vehicle, monkeypatch, tmp_path, begin=begin)
        return code, capsys.readouterr().out

    return flown


def at(number: int, **changes: object):
    """What happens at a setpoint: attributes of the vehicle change."""

    def happens(vehicle: Vehicle, sent: int) -> None:
        if sent >= number:
            for name, value in changes.items():
                setattr(vehicle, name, value)

    return happens


def test_a_flight_to_the_end_ends_in_hold(flight, multisine: FlightPlan) -> None:
    vehicle = Vehicle(height=5.4)
    code, out = flight(vehicle)
    assert code == 0
    assert "Flown to the end" in out
    assert vehicle.calls == ["connect udpin://0.0.0.0:14540", "offboard", "hold"]
    assert vehicle.mode is FlightMode.HOLD
    # the first setpoint before the mode, then all of them, at the heights of the plan
    np.testing.assert_allclose(vehicle.heights[1:], multisine.height[::5], atol=1e-3)


def test_without_the_command_nothing_starts(flight) -> None:
    vehicle = Vehicle()
    code, out = flight(vehicle, begin=False)
    assert code == 0
    assert "add --start" in out
    assert vehicle.calls == ["connect udpin://0.0.0.0:14540"]
    assert not vehicle.heights


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"battery": 40.0}, "battery at 40 %"),
        ({"battery": float("nan")}, "battery at nan %"),
        ({"mode": FlightMode.MANUAL}, "change to hold or position mode"),
        ({"height": 3.2}, "height 3.2 m: hover at 5.5 m"),
        ({"in_air": False}, "take off first"),
        ({"position_ok": False}, "no local position"),
        ({"climb": 0.9}, "hover still"),
        ({"roll_deg": 30.0}, "tilted"),
        ({"silent": True}, "no telemetry of"),
    ],
)
def test_checks_that_are_not_met_leave_it_alone(flight, changes, words) -> None:
    vehicle = Vehicle(**changes)
    code, out = flight(vehicle)
    assert code == 1
    assert words in out
    assert vehicle.calls == ["connect udpin://0.0.0.0:14540"]


def test_no_vehicle_answers(flight) -> None:
    code, out = flight(Vehicle(connected=False))
    assert code == 1
    assert "No vehicle answers" in out


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"height": 8.3}, "height 8.30 m outside 3.0 to 8.0 m"),
        ({"height": 2.8}, "height 2.80 m outside 3.0 to 8.0 m"),
        ({"height": float("nan")}, "height nan m outside"),
        ({"climb": -2.4}, "sink rate 2.40 m/s"),
        ({"roll_deg": 25.0}, "tilt beyond 20.0 degrees"),
        ({"east": 4.0}, "sideways"),
        ({"battery": 25.0}, "battery below 30 %"),
        ({"in_air": False}, "no longer in the air"),
        ({"silent": True}, "the link is lost"),
    ],
)
def test_a_breach_on_the_way_ends_in_hold(flight, changes, words) -> None:
    vehicle = Vehicle(happens=at(60, **changes))
    code, out = flight(vehicle)
    assert code == 2
    assert words in out
    assert vehicle.calls[-1] == "hold"
    assert vehicle.mode is FlightMode.HOLD
    assert 60 <= len(vehicle.heights) < 300


def test_the_pilot_takes_over_and_keeps_the_mode(flight) -> None:
    vehicle = Vehicle(happens=at(60, mode=FlightMode.POSCTL))
    code, out = flight(vehicle)
    assert code == 2
    assert "has taken over" in out
    assert vehicle.calls[-1] == "offboard"
    assert vehicle.mode is FlightMode.POSCTL


def test_offboard_mode_that_is_refused_ends_in_hold(flight) -> None:
    vehicle = Vehicle(refuses_offboard=True)
    code, out = flight(vehicle)
    assert code == 2
    assert "STOPPED: denied" in out
    assert vehicle.calls[-2:] == ["offboard", "hold"]


@pytest.mark.thorough
def test_hold_is_tried_again_and_its_failure_is_told(flight) -> None:
    vehicle = Vehicle(refuses_hold=2)
    code, out = flight(vehicle)
    assert (code, vehicle.mode) == (0, FlightMode.HOLD)
    assert out.count("Hold was not accepted") == 2
    code, out = flight(Vehicle(refuses_hold=3))
    assert "TAKE OVER" in out


def test_only_numbers_enter_the_program(multisine: FlightPlan, steps: FlightPlan) -> None:
    blank = files("eivor.planning.written").joinpath("fly_plan.txt").read_text(encoding="utf-8")
    assert blank.count(MARK) == 1
    before, after = blank.split(MARK)
    for plan in (multisine, steps):
        text = mavsdk_text(plan)
        assert text.startswith(before)
        assert text.endswith(after)
        for statement in ast.parse(text[len(before) : len(text) - len(after)]).body:
            assert isinstance(statement, ast.Assign)
            value = np.array(ast.literal_eval(statement.value), dtype=float)
            assert np.isfinite(value).all()
