"""The table of motions: Eivor's own, and those that other packages bring."""

from __future__ import annotations

import importlib.metadata
import json
import re
import sys
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import eivor as ev
from eivor.cli.main import app
from eivor.errors import UsageError
from eivor.flights import identify
from eivor.flights.identify import with_coupled_axes
from eivor.flights.prepare import prepare
from eivor.flights.quantity import Quantity, QuantityEstimate, SimpleModel
from eivor.flights.verdict import Instruments, VerdictInputs, reasons_by_quantity
from eivor.inference.verdict import Reason, Status, verdict
from eivor.models.separable import LaggedReferences
from eivor.motions import table as motions
from eivor.motions.machine_verdict import MachineChecks
from eivor.motions.rates.motion import Rates
from eivor.motions.table import loaded_motion, motion_names
from eivor.motions.vertical.motion import Vertical
from eivor.signals import channels
from eivor.signals.channels import CanonicalChannel
from eivor.signals.recording import GRAVITY, Channel
from flights.flight_logs import changed
from motions.turning_logs import AXES, STEP_S, Vehicle, turned

HERE = __name__
CLIMB_RATE = CanonicalChannel("climb_rate", "m/s")


@dataclass(frozen=True)
class Climb(Vertical):
    """The vertical motion under another name."""

    name = "climb"
    words = replace(Vertical.words, model="climbing")
    channels = replace(Vertical.channels, added=(CLIMB_RATE,))


@dataclass(frozen=True)
class Misnamed(Vertical):
    """A motion whose entry point has another name."""

    name = "other"


NO_MOTION = 7


@pytest.fixture
def table(monkeypatch):
    """The table of channels, which is as it was after the test."""
    monkeypatch.setattr(channels, "_TABLE", dict(channels.canonical_channels()))


@pytest.fixture
def added(monkeypatch):
    """Entry points of other packages, for one test."""

    def add(**values):
        points = [EntryPoint(name, value, motions.GROUP) for name, value in values.items()]
        groups = {motions.GROUP: points}
        monkeypatch.setattr("importlib.metadata.entry_points", lambda *, group: groups.get(group, []))
        loaded_motion.cache_clear()

    yield add
    loaded_motion.cache_clear()


def test_own_motions_are_known_by_name():
    motion = ev.motion_by_name("vertical")
    assert motion == Vertical()
    assert (motion.name, motion.words.model) == ("vertical", "vertical_motion")
    assert "vertical" in motion_names()


@pytest.mark.thorough
def test_a_package_brings_a_motion(added, table, recording_of_example):
    added(climb=f"{HERE}:Climb")
    assert motion_names() == ("vertical", "rates", "rigid-body", "climb")
    by_name = ev.identify_flight(recording_of_example, ev.FlightOptions(window=(0.0, 20.0)), model="climb")
    assert by_name.motion == Climb()
    itself = ev.identify_flight(recording_of_example, ev.FlightOptions(window=(0.0, 20.0)), model=Climb())
    assert itself.parameters == by_name.parameters


def test_channels_that_a_motion_adds_are_canonical_from_then_on(added, table):
    added(climb=f"{HERE}:Climb")
    assert channels.canonical_channel("climb_rate") is None
    ev.motion_by_name("climb")
    assert channels.canonical_channel("climb_rate") == CLIMB_RATE


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("walk", "", r"a motion out of vertical, rates, rigid-body; received 'walk'\. Name one of them with"),
        ("walk", "no_such_package:Walk", "a motion 'walk' that can be loaded .*ModuleNotFoundError"),
        ("walk", f"{HERE}:NO_MOTION", "a motion called 'walk' .*; received 7"),
        ("walk", f"{HERE}:Misnamed", "a motion called 'walk' .*; received one .* called 'other'"),
    ],
)
def test_what_is_no_motion_is_refused(added, name, value, said):
    added(**({name: value} if value else {}))
    with pytest.raises(UsageError, match=f"Expected {said}"):
        ev.motion_by_name(name)


@pytest.fixture(scope="module")
def recording_of_example():
    return ev.example_flight()


LOG = turned(3, seconds=16.0)
MOTIONS = {"vertical": Vertical()}


@pytest.fixture(scope="module")
def turning():
    return ev.identify_flight(LOG, model="rates")


def logging(*names):
    """The log with further channels, whose values do not matter."""
    time = np.arange(0.0, 16.0, 0.02)
    added = {name: Channel(name, time, np.full(time.size, 0.5), "", held=True) for name in names}
    return replace(LOG, channels={**LOG.channels, **added})


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("logged", "missing"),
    [
        ((), "no thrust setpoint is logged"),
        (("input",), "no accelerometer is logged"),
        (("input", "specific_force_body_z"), "velocity_z"),
    ],
)
def test_what_is_not_logged_refuses_the_thrust_gain(turning, logged, missing):
    bare = replace(turning, findings=())
    companions = with_coupled_axes(bare, MOTIONS, [logging(*logged)], [None], {})
    (finding,) = companions.findings
    assert finding.name == "no_thrust_gain"
    assert missing in finding.message
    assert "thrust_gain" not in companions.quantities
    assert companions.verdict == turning.verdict


@pytest.mark.thorough
def test_the_other_motion_is_given_the_lag_and_has_its_own_verdict(turning, monkeypatch):
    requested = {}
    why = Reason(Status.WEAK, "The input gain's interval is wide.", "Fly steps.")
    gain = Quantity(30.0, "m/s^2", 1.0, (28.0, 32.0), verdict=Status.WEAK, reasons=(why,))

    def identified(_logs, _motion, options, _windows, *, lag_measurements):
        requested.update(options=options, lag_measurements=lag_measurements)
        return SimpleNamespace(quantities={"input_gain": gain})

    monkeypatch.setattr(identify, "identified", identified)
    of_turning = turning.quantities["effective_lag"]
    lag = replace(of_turning, interval=(0.04, 0.05), verdict=Status.IDENTIFIED)
    known = replace(turning, quantities={**turning.quantities, "effective_lag": lag})
    companions = with_coupled_axes(known, MOTIONS, [logging("input", "acceleration_z")], [None], {})
    assert companions.quantities["thrust_gain"].value == 30.0
    assert companions.quantities["thrust_gain"].reasons[0].sentence == "The thrust gain's interval is wide."
    assert companions.quantities["roll_effectiveness"] == turning.quantities["roll_effectiveness"]
    assert (requested["options"].input, requested["options"].input_map) == ("input", "linear")
    (reported,) = requested["lag_measurements"]
    assert reported.known.mean == turning.quantities["effective_lag"].value


ROVER = Path(__file__).parents[2] / "examples" / "motions" / "rover"


@pytest.fixture
def simulate(monkeypatch):
    """The simulator of the example, whose package is as if it were installed."""
    monkeypatch.syspath_prepend(str(ROVER))
    monkeypatch.syspath_prepend(str(ROVER / "src"))
    monkeypatch.setattr(channels, "_TABLE", dict(channels.canonical_channels()))
    point = EntryPoint("rover", "eivor_rover:Rover", motions.GROUP)
    others = importlib.metadata.entry_points
    monkeypatch.setattr(
        "importlib.metadata.entry_points",
        lambda **by: [point] if by["group"] == motions.GROUP else others(**by),
    )
    loaded_motion.cache_clear()
    import simulate

    yield simulate
    loaded_motion.cache_clear()
    for name in [name for name in sys.modules if name == "simulate" or name.startswith("eivor_rover")]:
        del sys.modules[name]


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
def test_the_rover_is_identified_and_refused(simulate, tmp_path):
    ev.motion_by_name("rover")
    fit = ev.identify_flight(ev.recording_from_columns(simulate.drive(1), name="drive"), model="rover")
    assert fit.verdict.status.value == "identified"
    for name, true in simulate.TRUTH.items():
        low, high = fit.quantities[name].interval
        assert low <= true <= high, name
    # Two quantities make the headline: both are looked at closely, and either refuses.
    assert {"least_squares_drive_gain", "least_squares_dry_friction"} <= set(fit.diagnostics)
    simulate.write(simulate.drive(1, constant_speed=1.0), tmp_path / "still.csv")
    arguments = ["identify", str(tmp_path / "still.csv"), "--model", "rover", "--json", "-"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 3
    document = json.loads(done.output)["motions"]["rover"]
    assert (document["model"]["name"], document["verdict"]) == ("rover", "refused")
    assert list(document["derived"]) == ["breakaway_command", "time_constant", "effective_lag"]


@pytest.mark.usefixtures("simulate")
def test_weak_instruments_refuse_what_has_no_set():
    rover = ev.motion_by_name("rover")
    names = ("drive_gain", "dry_friction", "rolling_drag", "effective_lag", "breakaway_command")
    quantities = {name: QuantityEstimate(1.0, "", 0.02, (0.985, 1.015)) for name in names}
    sets = dict.fromkeys(names[:2], ev.ConfidenceSet(((0.95, 1.05),)))
    for F, robust, wanted in ((3.0, sets, "refused"), (3.0, {}, "refused"), (30.0, {}, "identified")):
        inputs = replace(AT, first_stage={"drive_gain": F}, robust=robust, quantities=quantities)
        reasons = reasons_by_quantity(rover.rules, inputs, rover.quantities)
        given = {name: verdict(list(against)).status.value for name, against in reasons.items()}
        assert given["rolling_drag"] == given["breakaway_command"] == wanted
        assert given["drive_gain"] == ("identified" if robust else wanted)


@pytest.mark.parametrize(
    ("interval", "status", "sentence"),
    [
        ((-0.1, 2.1), "refused", "The drive gain cannot be distinguished from zero"),
        ((0.7, 1.3), "weak", "The interval of the drive gain is ±30% wide; identified needs ±20%"),
        ((0.9, 1.1), "identified", ""),
    ],
)
@pytest.mark.usefixtures("simulate")
def test_the_width_of_an_interval_decides_about_a_declared_motion(interval, status, sentence):
    rover = ev.motion_by_name("rover")
    quantities = {"drive_gain": QuantityEstimate(1.0, "", 0.1, interval)}
    result = reasons_by_quantity(rover.rules, replace(AT, quantities=quantities), rover.quantities)
    found = verdict(list(result["drive_gain"]))
    assert found.status.value == status
    assert re.match(sentence, " ".join(found.sentences))


REFERENCE = Instruments(LaggedReferences(("reference",)))
AT = VerdictInputs((), 100.0, 100.0, REFERENCE, used_s=60.0, checks=MachineChecks({}))

# Turning about the body axes: what flights tell of effectiveness and lag, and what they do not.

TRUTH = Vehicle()
HEADLINE = {"roll_effectiveness": 100.0, "pitch_effectiveness": 80.0, "effective_lag": TRUTH.effective_lag_s}


@pytest.fixture(scope="module")
def short():
    """Steps of 14 degrees for 40 s."""
    return turned(1)


@pytest.fixture(scope="module")
def log():
    """Larger steps for longer, as the remedy of the short flight says; at uneven stamps, as PX4 logs them."""
    return turned(1, seconds=120.0, size=0.5, command_hz=47.3)


@pytest.fixture(scope="module")
def fit(log):
    return ev.identify_flight(log, model="rates")


@pytest.mark.thorough
def test_setpoints_at_47_hz_tell_effectiveness_and_lag(fit):
    assert fit.verdict.status is ev.Status.IDENTIFIED
    for name, truth in HEADLINE.items():
        low, high = fit.quantities[name].interval
        assert low <= truth <= high
    assert fit.quantities["roll_effectiveness"].value == pytest.approx(100.0, rel=0.08)
    assert fit.quantities["effective_lag"].value == pytest.approx(TRUTH.effective_lag_s, abs=0.006)


def test_a_motor_s_controller_is_a_second_stage_and_no_delay():
    """With one stage alone the delay came out three times as long, and was called identified."""
    vehicle, quick = Vehicle(second_s=0.02), {"command_hz": 400.0, "rate_hz": 400.0, "noise": 0.02}
    log = turned(1, vehicle=vehicle, size=0.5, disturbance=1.0, **quick)
    fit = ev.identify_flight(log, model="rates")
    assert "second_stage" in fit.quantities
    assert fit.prepared[0].band_hz == (0.3, 8.0)  # of what such setpoints excite
    assert fit.quantities["delay"].half_width > 1e-4  # no point of a grid
    assert all(line.count("[") == 1 for line in fit.summary().splitlines()[2:] if line[0] != "-")
    for name, true in {
        "delay": 0.005,
        "second_lag": 0.02,
        "effective_lag": vehicle.effective_lag_s + 0.02,
    }.items():
        assert fit.quantities[name].interval[0] <= true <= fit.quantities[name].interval[1], name
    single = ev.identify_flight(log, model="rates", order=2, controller_rate_hz=400.0)
    assert single.quantities["delay"].interval[0] > 0.012


@pytest.mark.thorough
def test_a_sweep_identifies_two_stages_up_to_where_it_reaches_though_yaw_rests():
    """Up to 8 Hz one lag was taken for two, and yaw, which nothing moved, left the lag without a bound."""
    vehicle, injected, since = Vehicle(second_s=0.02), np.zeros((24_000, 3)), np.arange(0.0, 26.0, STEP_S)
    sweep = 0.1 * np.sin(2.0 * np.pi * (0.3 * since + 0.379 * since**2))
    injected[800:, 0][: since.size] = injected[12_400:, 1][: since.size] = sweep
    quick = {"command_hz": 400.0, "rate_hz": 400.0, "seconds": 60.0, "disturbance": 1.0}
    fit = ev.identify_flight(turned(5, vehicle=vehicle, size=0.0, injected=injected, **quick), model="rates")
    assert fit.quantities["yaw_effectiveness"].verdict is ev.Status.REFUSED
    highest = [columns.band_hz[1] for columns in fit.fit.problem.columns]
    assert min(highest[:2]) > 15.0 > highest[2] == 8.0
    lag = fit.quantities["effective_lag"]
    assert lag.verdict is ev.Status.IDENTIFIED
    assert lag.interval[0] <= vehicle.effective_lag_s + 0.02 <= lag.interval[1]


@pytest.mark.thorough
def test_steps_that_leave_the_order_open_have_intervals_of_both():
    """The lag of the order that fits as well is in the interval: without it .63 of such flights missed it."""
    log = turned(1000, vehicle=Vehicle(second_s=0.02), command_hz=200.0, rate_hz=400.0, seconds=60.0)
    fit = ev.identify_flight(log, model="rates")
    assert "second_lag" not in fit.quantities
    low, high = fit.quantities["effective_lag"].interval
    assert low <= sum(fit.fit.estimate.other_order[name] for name in ("actuator_lag", "delay")) <= high


def test_drag_beside_the_centre_of_mass_is_in_the_equation_or_in_intervals():
    quick = {"command_hz": 200.0, "rate_hz": 400.0, "seconds": 80.0, "disturbance": 1.0}
    log = turned(vehicle=replace(TRUTH, drag_moment=(4.0, 4.0, 0.0)), **quick)
    damping = ev.identify_flight(log, model="rates").quantities["roll_damping"]
    (drag,) = [item for item in damping.systematic_uncertainties if "centre of mass" in item.sentence]
    assert damping.interval[1] - drag.above < TRUTH.damping[0] < damping.interval[1]
    log = turned(vehicle=replace(TRUTH, drag_moment=(40.0, 40.0, 0.0)), **quick)
    fit, moment = ev.identify_flight(log, model="rates"), 40.0 / GRAVITY
    for name, true in {"roll_by_drag_y": moment, "pitch_by_drag_x": -moment, "roll_damping": 0.5}.items():
        assert fit.quantities[name].interval[0] < true < fit.quantities[name].interval[1], name


@pytest.mark.thorough
def test_an_interval_wider_than_a_tenth_is_weak(short):
    flight = ev.identify_flight(short, model="rates")
    assert flight.verdict.status is ev.Status.WEAK
    for axis in ("roll", "pitch"):
        effect = flight.quantities[f"{axis}_effectiveness"]
        assert effect.interval[0] <= HEADLINE[f"{axis}_effectiveness"] <= effect.interval[1]
        assert 0.1 * effect.value < effect.half_width <= 0.25 * effect.value
        (reason,) = effect.reasons
        assert f"{axis} effectiveness is" in reason.sentence
        assert "identified needs ±10%" in reason.sentence
        assert reason.remedy == "Fly larger and quicker steps, or longer."
    assert flight.quantities["effective_lag"].verdict is ev.Status.IDENTIFIED
    assert flight.quantities["effective_lag"].value == pytest.approx(TRUTH.effective_lag_s, abs=0.006)


@pytest.mark.thorough
def test_without_noise_the_numbers_are_those_of_the_vehicle():
    log = turned(0, command_hz=400.0, rate_hz=400.0, disturbance=0.0, noise=0.0, seconds=20.0)
    exact = ev.identify_flight(log, model="rates", controller_rate_hz=400.0)
    results = {name: quantity.value for name, quantity in exact.quantities.items()}
    for axis, effect, damping in zip(AXES, TRUTH.effectiveness, TRUTH.damping, strict=True):
        assert results[f"{axis}_effectiveness"] == pytest.approx(effect, rel=1e-3)
        assert results[f"{axis}_damping"] == pytest.approx(damping, abs=0.03)
    assert results["yaw_reaction"] == pytest.approx(0.0, abs=0.02)
    assert results["effective_lag"] == pytest.approx(TRUTH.effective_lag_s, abs=2e-4)
    unknown = ev.identify_flight(log, model="rates").quantities["effective_lag"]
    (slack,) = [item for item in unknown.systematic_uncertainties if "how often" in item.sentence]
    assert slack.above == pytest.approx(0.25 / 400.0)
    # the edge of the doubt, but for the spread of a hold that is taken for a shorter one
    assert abs(unknown.value - TRUTH.effective_lag_s) <= slack.above + 5e-5


@pytest.mark.thorough
def test_references_that_hardly_move_tell_nothing():
    for size in (0.0, 0.01):
        flight = ev.identify_flight(turned(2, size=size, seconds=20.0), model="rates")
        assert flight.verdict.status is ev.Status.REFUSED
        assert flight.quantities["roll_effectiveness"].verdict is ev.Status.REFUSED


@pytest.mark.thorough
def test_a_setpoint_of_the_other_sign_is_named(log):
    torque = log.channels["torque_setpoint_y"]
    turned_over = changed(log, torque_setpoint_y=replace(torque, values=-torque.values))
    flight = ev.identify_flight(turned_over, model="rates")
    assert flight.verdict.status is ev.Status.REFUSED
    reasons = flight.quantities["pitch_effectiveness"].reasons
    assert any("opposite signs" in r.sentence and "torque_setpoint_y" in r.remedy for r in reasons)
    assert flight.quantities["roll_effectiveness"].verdict is ev.Status.IDENTIFIED


@pytest.mark.thorough
@pytest.mark.parametrize("missing", ["torque_setpoint_x", "angular_rate_y", "torque_setpoint_z"])
def test_any_axis_may_be_missing(log, missing):
    without, left = {"x": ("roll", "pitch"), "y": ("pitch", "roll"), "z": ("yaw", "roll")}[missing[-1]]
    flight = ev.identify_flight(changed(log, missing), model="rates")
    assert f"{without}_effectiveness" not in flight.quantities
    assert flight.quantities[f"{left}_effectiveness"].verdict is ev.Status.IDENTIFIED
    assert any(finding.name == f"no_{without}" for finding in flight.findings)


@pytest.mark.thorough
def test_samples_at_the_limit_of_a_gyroscope_do_not_count(log, fit):
    rate = log.channels["angular_rate_x"]
    clipped = replace(rate, values=rate.values.clip(*np.quantile(rate.values, [0.01, 0.99])))
    flight = ev.identify_flight(changed(log, **{rate.name: clipped}), model="rates")
    low, high = flight.quantities["roll_effectiveness"].interval
    assert any(finding.name == "clipped_gyroscope" for finding in flight.findings)
    assert low < Vehicle().effectiveness[0] < high
    assert flight.prepared[0].usable.sum() < 0.98 * fit.prepared[0].usable.sum()


@pytest.mark.thorough
def test_an_attitude_that_a_loop_computes_is_provisional(log):
    names = [f"reference_{axis}" for axis in AXES]
    answering = {f"feedback_{name}": replace(log.channels[name], name=f"feedback_{name}") for name in names}
    flight = ev.identify_flight(changed(log, *names, **answering), model="rates")
    assert flight.verdict.status is ev.Status.PROVISIONAL
    assert any("roll answers" in reason.sentence for reason in flight.verdict.reasons)


@pytest.mark.thorough
def test_an_axis_that_nothing_moves_leaves_the_others_their_sets(log, fit):
    yaw = log.channels["reference_yaw"]
    still = replace(yaw, values=np.zeros_like(yaw.values))
    quiet = ev.identify_flight(changed(log, reference_yaw=still), model="rates")
    for name in ("roll_effectiveness", "pitch_effectiveness"):
        assert quiet.quantities[name].verdict is ev.Status.IDENTIFIED
        assert quiet.fit.sets[name].robust.is_bounded
        assert quiet.quantities[name].interval == pytest.approx(fit.quantities[name].interval, rel=0.1)
    assert quiet.quantities["yaw_effectiveness"].verdict is ev.Status.REFUSED


@pytest.mark.thorough
def test_what_an_unknown_clock_leaves_open_is_in_the_lag(short):
    fit = ev.identify_flight(short, model="rates")
    part, by_loops, *_, rotors = fit.quantities["effective_lag"].systematic_uncertainties
    assert part.above == pytest.approx(0.25 * 0.005)  # once a rate of 200 Hz at least
    assert "how often" in part.sentence
    assert by_loops.above == pytest.approx(0.5 * (0.020 - 0.001))
    of_delay = [item.above for item in fit.quantities["delay"].systematic_uncertainties]
    assert of_delay[:2] == [part.above, by_loops.above]
    assert (rotors.below, rotors.above) == (0.001, 0.001)


@pytest.mark.thorough
def test_a_real_log_of_the_default_profile_is_too_wide(recordings):
    flight = ev.identify_flight(ev.read_log(recordings / "px4" / "battery_brownout.ulg"), model="rates")
    assert flight.verdict.status is ev.Status.REFUSED
    refusals = [item.sentence for item in flight.verdict.reasons if item.status is ev.Status.REFUSED]
    assert all("effectiveness is ±" in item and "it needs ±25%" in item for item in refusals)
    low, high = flight.quantities["pitch_effectiveness"].interval
    assert 50.0 < low < high < 300.0  # by setpoints of velocity and acceleration across the ground
    assert flight.quantities["effective_lag"].interval[1] < 0.06


@pytest.mark.thorough
def test_real_logs_without_excitation_are_refused(recordings):
    """The lag of torques that surely turn nothing, too."""
    for name in ("px4/ekf_failure.ulg", "px4-flights/3DRFlight_1.ulg"):
        flight = ev.identify_flight(ev.read_log(recordings / name), model="rates")
        assert flight.verdict.status is ev.Status.REFUSED
    reasons = flight.quantities["effective_lag"].reasons
    assert any("No effectiveness is distinguished from zero" in reason.sentence for reason in reasons)


AHEAD_TRUTH = {
    **{f"{name}_effectiveness": item for name, item in zip(AXES, TRUTH.effectiveness, strict=True)},
    **{f"{name}_damping": item for name, item in zip(AXES, TRUTH.damping, strict=True)},
    "yaw_reaction": 0.0,
    "actuator_lag": TRUTH.lag_s,
    "delay": TRUTH.delayed * STEP_S,
}


@pytest.fixture(scope="module")
def flight():
    """Without disturbance or noise, every setpoint logged."""
    log = turned(0, seconds=12.0, command_hz=400.0, rate_hz=400.0, disturbance=0.0, noise=0.0)
    return prepare(log, Rates(), ev.FlightOptions()).shortened


MODELS = {
    "fit": SimpleModel("the fit", AHEAD_TRUTH),
    "least_squares": SimpleModel("without lag", {**AHEAD_TRUTH, "actuator_lag": 0.0, "delay": 0.0}),
}


def ahead(flight, *refused, models=MODELS):
    return Rates().abilities.prediction.multi_step((flight,), models, frozenset(refused))


def quantities(prediction):
    return [item[0].quantity for item in prediction.by_quantity]


def test_the_truth_predicts_and_numbers_without_a_lag_do_not(flight):
    prediction = ahead(flight)
    assert quantities(prediction) == ["roll rate", "pitch rate", "yaw rate"]
    assert [item.model for item in prediction.by_quantity[0]] == ["fit", "least_squares", "unchanged"]
    for entry, without, unchanged in prediction.by_quantity:
        assert entry.rms[-1] < 0.03 * unchanged.rms[-1]
        assert entry.rms[0] < 0.1 * without.rms[0]
        assert np.array_equal(unchanged.series[:, 0], entry.series[:, 0])
    assert prediction.predicts
    assert not prediction.omitted


def test_axes_that_are_not_told_are_left_out_and_it_is_said(flight):
    prediction = ahead(flight, "pitch_effectiveness")
    assert quantities(prediction) == ["roll rate", "yaw rate"]
    assert prediction.omitted == ("The pitch rate is not predicted: the pitch effectiveness is refused.",)
    blind = ahead(flight, "effective_lag")
    assert not blind.errors
    assert len(blind.omitted) == 3
    channels = {name: item for name, item in flight.signals.channels.items() if name != "torque_setpoint_z"}
    result = ahead(replace(flight, signals=replace(flight.signals, channels=channels)))
    assert quantities(result) == ["roll rate", "pitch rate"]
    assert "not logged" in result.omitted[0]
    no_yaw = {name: item for name, item in AHEAD_TRUTH.items() if not name.startswith("yaw")}
    lesser = ahead(flight, models={"fit": SimpleModel("the fit", no_yaw)})
    assert "the fit has no yaw effectiveness" in lesser.omitted[0]
