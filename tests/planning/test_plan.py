"""Plans: what a flight tells of the next one, shapes within limits, the formula, and the choice."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

import eivor as ev
from eivor.errors import InputError, UsageError
from eivor.flights.quantity import Quantity
from eivor.inference.verdict import Status
from eivor.models.separable import NoInstruments
from eivor.motions.vertical.motion import Vertical
from eivor.motions.vertical.predict import controller_gains
from eivor.planning import plan as planning
from eivor.planning import vehicle as vehicles
from eivor.planning.plan import ExpectedWidth, csv_text, levels, mavsdk_text, qgc_text, ranked_std_errors
from eivor.planning.vehicle import STEP_S, USED_SHARE, Shape, candidates, vehicle_of_result
from eivor.report.other_results import plan_document, plan_json
from eivor.report.terminal import on_terminal
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights
from flights.flight_logs import prepare_vertical
from refusal_rows import calls, rows, table

LIMITS = ev.FlightLimits(height_m=(2.0, 5.0), speed=1.5, acceleration=2.0, duration_s=25.0)
SHORT = ev.FlightLimits(duration_s=30.0)


@cache
def planned(kind):
    """A plan without its simulations: the first shape of a kind, and half-widths that were written down."""
    both, targets = (Status.IDENTIFIED, Status.WEAK), vehicles.TARGETS
    predicted = {
        word: ExpectedWidth(targets[word].words, value, width, targets[word].unit, both)
        for word, width, value in (("friction", 0.05, 0.3), ("gain", 1.2, 100.0), ("lag", 3.0, 50.0))
    }
    shape = next(candidates(SHORT.duration_s, (kind,), 0)).within(SHORT)
    return ev.FlightPlan(ev.VehicleGuess(), SHORT, "friction", shape, predicted, (4.0, 7.0, 1.5))


def program_text(kind):
    """The program that `eivor plan -o flight.py` writes of such a plan."""
    return mavsdk_text(planned(kind))


@pytest.fixture
def multisine():
    return planned("multisine")


@pytest.fixture
def steps():
    return planned("steps")


@pytest.mark.thorough
def test_the_controller_is_read_off_a_flight():
    specs = [VerticalFlightSpec(gust_rms=0.5, seed=seed, duration=40.0) for seed in range(4)]
    flights = simulate_vertical_flights(specs)
    prepared = tuple(prepare_vertical(flight.recording, ev.FlightOptions()) for flight in flights)
    problem, spec = Vertical().problem(prepared, NoInstruments()), specs[0]
    numbers = {name: getattr(spec, name) for name in ("viscous_friction", "input_gain", "actuator_lag")}
    for name, value in controller_gains(problem, numbers | {"delay": 0.0}, prepared).items():
        assert value == pytest.approx(getattr(spec.controller, name), rel=0.2), name


@pytest.mark.parametrize("kind", ["multisine", "steps"])
def test_shapes_keep_their_limits_and_rest_at_the_ends(kind):
    shapes = [shape.within(LIMITS) for shape in candidates(LIMITS.duration_s, (kind,), 0)]
    assert len(shapes) > 10
    for shape in shapes:
        velocity, acceleration = shape.derivatives
        limits = (USED_SHARE * 1.5, USED_SHARE * LIMITS.speed, LIMITS.acceleration)
        used = zip((shape.offset, velocity, acceleration), limits, strict=True)
        assert max(np.abs(series).max() / limit for series, limit in used) == pytest.approx(1.0)
        assert shape.offset.size == round(LIMITS.duration_s / STEP_S)
        for end in (slice(0, 100), slice(-50, None)):
            assert np.abs(velocity[end]).max() < 0.02 * LIMITS.speed
            assert np.abs(shape.offset[end]).max() < 0.05


def test_the_formula_knows_what_slow_and_quick_flights_tell():
    time = STEP_S * np.arange(6000)
    window = np.sin(np.pi * time / time[-1]) ** 2

    def sines(*hertz):
        series = sum(np.sin(2.0 * np.pi * f * time + f) / f for f in hertz)
        return Shape("multisine", "", window * series).within(ev.FlightLimits())

    hertz = (0.1, 0.2, 0.3), (0.6, 1.0, 1.5)
    slow, quick = (ranked_std_errors(sines(*item), ev.VehicleGuess()) for item in hertz)
    assert slow[0] < quick[0]
    assert quick[2] < slow[2]
    calm, windy = (ranked_std_errors(sines(0.1, 0.9), ev.VehicleGuess(gust_rms=g)) for g in (0.1, 1.0))
    assert (calm < windy).all()


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_plan_is_chosen_by_flying_it(monkeypatch):
    monkeypatch.setattr(planning, "FINALISTS", 2)
    monkeypatch.setattr(planning, "RUNS", 2)
    made = ev.plan(
        ev.VehicleGuess(viscous_friction=0.5, gust_rms=0.1), target="lag", limits=LIMITS, shape="multisine"
    )
    assert made.target == "lag"
    result = made.predicted["lag"]
    assert len(result.verdicts) == 2
    assert 0.5 < result.half_width < 20.0
    assert result.value == 50.0
    low, high, speed = made.reached
    assert LIMITS.height_m[0] <= low < high <= LIMITS.height_m[1]
    assert speed <= LIMITS.speed
    assert made.height.shape == made.velocity.shape == made.acceleration.shape == made.time_s.shape
    assert f"{result.half_width:.2g} ms" in made.sentence


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_flight_that_cannot_keep_its_limits_is_refused(monkeypatch):
    for name in ("FINALISTS", "RUNS", "MOST_SHRINKS"):
        monkeypatch.setattr(planning, name, 1)
    tight = ev.FlightLimits(height_m=(2.0, 2.5), speed=0.2, duration_s=20.0)
    with pytest.raises(InputError, match="a flight that keeps its limits"):
        ev.plan(ev.VehicleGuess(gust_rms=3.0, viscous_friction=1.0), limits=tight)


WEAK, NAMES = Quantity(0.42, "", 0.1, (0.3, 0.5), verdict=Status.WEAK), ("viscous_friction", "effective_lag")
QUANTITIES = dict.fromkeys(NAMES, WEAK) | {"hover_input": replace(WEAK, value=0.6)}
QUANTITIES["input_gain"] = replace(WEAK, verdict=Status.IDENTIFIED)
FLOWN = {
    "taken": {"viscous_friction": 0.42, "lag_s": 0.03},
    "residual": {name: [1.0, 2.0] for name in ("frequency_hz", "force", "accelerometer", "velocity")},
    "controller": {"position_gain": 1.0, "velocity_gain": 2.0, "integral_gain": 0.1},
    "tilt_rms": 0.5,
    "issue_times_known": True,
}


def test_what_a_result_tells_is_planned_with_and_the_rest_is_usual():
    vehicle = vehicle_of_result("vertical_motion", "square", QUANTITIES, FLOWN)
    assert (vehicle.viscous_friction, vehicle.lag_s, vehicle.hover_input) == (0.42, 0.03, 0.6)
    assert vehicle.follows.velocity_gain == 2.0
    assert vehicle.tilt_rms == 0.2  # the most that is flown
    assert vehicle.requested == "friction"
    without = vehicle_of_result("vertical_motion", "square", QUANTITIES, {})
    assert replace(without, hover_input=0.5, requested="") == ev.VehicleGuess()


def test_a_flight_is_planned_with_the_issue_times_that_its_log_has():
    shape = next(candidates(LIMITS.duration_s, ("multisine",), 0)).within(LIMITS)
    assert vehicle_of_result("vertical_motion", "square", QUANTITIES, FLOWN).issue_times_known
    rough = ev.VehicleGuess(gust_rms=0.1)
    flights = planning.fly([shape, shape], [replace(rough, issue_times_known=True), rough], [0, 0])
    known, unknown = (ev.identify_flight(item.recording).quantities["effective_lag"] for item in flights)
    assert not known.systematic_uncertainties
    assert unknown.systematic_uncertainties[0].above == pytest.approx(0.005)  # half of a command period


def test_numbers_that_nobody_gave_are_others_in_each_flight():
    guess = ev.VehicleGuess(viscous_friction=0.3)  # as usual, and given
    drawn = [guess.drawn(number) for number in range(5)]
    assert {item.viscous_friction for item in drawn} == {0.3}
    low, high = vehicles.USUAL["lag_s"]
    assert drawn[0].lag_s == pytest.approx(np.sqrt(low * high))
    assert low < min(item.lag_s for item in drawn) < max(item.lag_s for item in drawn) < high
    assert ev.VehicleGuess(viscous_friction=0.5, lag_s=0.08).drawn(3).lag_s == 0.08


test_refused = table(
    rows("limits", UsageError, lambda limits: ev.FlightLimits(**limits),
        ({"height_m": (0.0, 3.0)}, "a lowest height above zero"),
        ({"height_m": (3.0, 3.2)}, "half a metre or more"),
        ({"speed": 0.0}, "speed between"),
        ({"duration_s": 5.0}, "duration_s between"),
    ),
    rows("flown", InputError, partial(vehicle_of_result, "vertical_motion", "square"),
        *((QUANTITIES, damaged, r"under prediction\.flown") for damaged in (3, {"taken": 3},
            {"taken": {"lag_s": None}}, {"residual": {"force": [1.0]}}, {"controller": {"speed": 1.0}})),
        ({}, FLOWN, r"under prediction\.flown"),
    ),
    calls("call", None,
        (lambda: ev.plan(ev.VehicleGuess(), target="drag"), UsageError, "out of friction, gain, lag"),
        (lambda: ev.plan(ev.VehicleGuess(), shape="chirp"), UsageError, "a shape out of multisine, steps"),
        (lambda: vehicle_of_result("rover_motion", "square", QUANTITIES, {}), UsageError, "'rover_motion'"),
        (lambda multisine: qgc_text(multisine, HOME), UsageError, "a plan of steps"),
        (lambda steps: qgc_text(steps, (91.0, 0.0)), UsageError, "a latitude and a longitude"),
    ),
)  # fmt: skip


def test_a_plan_is_told(multisine):
    assert "± 0.05 1/s" in repr(multisine)
    assert "identified in 1 of 2 simulated flights" in multisine.sentence
    assert not multisine.is_informative
    always = replace(multisine.predicted["friction"], verdicts=(Status.IDENTIFIED,))
    assert replace(multisine, predicted={**multisine.predicted, "friction": always}).is_informative
    assert on_terminal(plan_document(multisine)).renderables
    document = json.loads(json.dumps(plan_json(multisine), allow_nan=False))
    numbers = {"half_width": 3.0, "value": 50.0, "unit": "ms"}
    assert document["predicted"]["lag"] == {**numbers, "verdicts": ["identified", "weak"]}


HOME = (47.3977, 8.5456)
NUMBER = (int, float)
ITEM = {"type", "autoContinue", "command", "doJumpId", "frame", "params"}
PLACED = ITEM | {"AMSLAltAboveTerrain", "Altitude", "AltitudeMode"}
MISSION = dict.fromkeys(("version", "firmwareType", "vehicleType", "globalPlanAltitudeMode"), int)
MISSION |= {"cruiseSpeed": NUMBER, "hoverSpeed": NUMBER, "plannedHomePosition": list, "items": list}


def strictly_read(text):
    """Items of a .plan file; every key, type and number of it is looked at."""

    def refuse(constant):
        raise AssertionError(constant)

    document = json.loads(text, parse_constant=refuse)
    assert set(document) == {"fileType", "version", "groundStation", "mission", "geoFence", "rallyPoints"}
    assert (document["fileType"], document["version"]) == ("Plan", 1)
    assert document["groundStation"] == "QGroundControl"
    assert document["geoFence"] == {"version": 2, "circles": [], "polygons": []}
    assert document["rallyPoints"] == {"version": 2, "points": []}
    mission = document["mission"]
    assert set(mission) == set(MISSION)
    assert all(isinstance(mission[key], kind) for key, kind in MISSION.items())
    assert mission["version"] == 2
    assert len(mission["plannedHomePosition"]) == 3
    for number, item in enumerate(mission["items"], start=1):
        assert (item["type"], item["doJumpId"]) == ("SimpleItem", number)
        assert item["autoContinue"] is True
        assert len(item["params"]) == 7
        assert all(value is None or isinstance(value, NUMBER) for value in item["params"])
        if item["frame"] == 3:
            assert set(item) == PLACED
            assert item["command"] in {16, 17, 22}
            assert (item["params"][4:6], item["Altitude"]) == (list(HOME), item["params"][6])
            assert item["AltitudeMode"] == 1
            assert item["AMSLAltAboveTerrain"] is None
        else:
            assert set(item) == ITEM
            assert (item["frame"], item["command"]) == (2, 178)
    return mission["items"]


def test_the_mission_climbs_to_every_level_and_loiters(steps):
    items = strictly_read(qgc_text(steps, HOME))
    commands = [item["command"] for item in items]
    assert (commands[:3], commands[-1]) == ([22, 178, 178], 17)
    assert set(commands[3:-1]) == {16}
    low, high = steps.limits.height_m
    flight = [(item["Altitude"], item["params"][0]) for item in items if item["command"] == 16]
    assert flight == levels(steps)
    assert all(low < height < high and hold >= 0.0 for height, hold in flight)
    rises = np.sign(np.diff([height for height, _ in flight]))
    assert len(flight) > 5
    assert (rises[1:-1] != rises[2:]).all()


def test_the_table_is_the_plan(multisine):
    head, *rows = csv_text(multisine).splitlines()
    assert head == "time,reference_position_z,reference_velocity_z,reference_acceleration_z"
    read = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    np.testing.assert_allclose(read[:, 1], multisine.height[::2], atol=1e-3)
    np.testing.assert_allclose(read[:, 2], multisine.velocity[::2], atol=1e-3)
