"""Declared machines: what a declaration says and refuses, and what is identified from simulated records."""

from __future__ import annotations

import json
import runpy
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import eivor as ev
import shape_checks
from eivor.cli.main import app
from eivor.errors import UsageError
from eivor.estimation.methods import by_name, identify
from eivor.exports.fitted import Fitted, Supplied
from eivor.exports.simulators import target_by_name
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.quantity import Quantity, QuantityEstimate
from eivor.flights.track import relative_change
from eivor.flights.track import track as followed
from eivor.flights.verdict import Instruments, VerdictInputs, reasons_by_quantity
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.verdict import Status, verdict
from eivor.logs.channel_map import parse_expression
from eivor.models.separable import LaggedReferences
from eivor.motions.declaration import machine_text, shipped_machines
from eivor.motions.equation import DeclaredMotion
from eivor.motions.machine_verdict import MachineChecks
from eivor.motions.vertical import regression
from eivor.report.other_results import track_document
from eivor.signals import channels
from eivor.signals.channels import CurveSide

ROLL = """name = "roll"
response = "ddt(p)"
[channels]
p = { unit = "rad/s", noise = 0.003 }
aileron = { unit = "1", role = "input" }
phi_reference = { unit = "rad", role = "reference" }
[let]
drag = { is = "2 * p", unit = "rad/s" }
[terms]
L_p = "drag"
L_da = { of = "aileron", behind = "servo", unit = "rad/s^2" }
[actuators.servo]
lag_ms = [2, 300]
[derived]
time_constant = "-1 / L_p"
[active]
when = "abs(p) < 3"
[quality]
headline = ["L_p"]
"""


@pytest.fixture(autouse=True)
def table(monkeypatch):
    """The table of channels, which is as it was after the test."""
    monkeypatch.setattr(channels, "_TABLE", dict(channels.canonical_channels()))


def held(rng, count, step_s, size, lasting):
    """Levels to both sides that last from one time to another [s]."""
    levels, begin = np.zeros(count), 0
    while begin < count:
        end = begin + int(rng.uniform(*lasting) / step_s)
        levels[begin:end] = size * rng.uniform(-1.0, 1.0)
        begin = end
    return levels


def logs_of(columns):
    """A recording for each record that was simulated side by side."""
    records = max(item.shape[1] for item in columns.values() if item.ndim > 1)
    for record in range(records):
        made = {name: item if item.ndim == 1 else item[:, record] for name, item in columns.items()}
        yield ev.recording_from_columns(made, name=f"record {record}")


def smooth(levels, step_s, lag_s=0.15):
    """Levels behind three lags."""
    for _ in range(3):
        levels = parse_expression(f"lag(x, {lag_s})", "here").evaluate({"x": levels}, step_s)
    return levels


def axis_case(rng, count, step_s):
    """A linear axis under control: parameters, signals, noise, disturbance."""
    levels = held(rng, count, step_s, 0.15, (0.8, 2.0))
    position = smooth(levels - levels[0], step_s)
    speed = np.gradient(position, step_s)

    def force(time, measured):
        k = round(time / step_s)
        asked = 95.0 * np.gradient(speed, step_s)[k] + 200.0 * speed[k] + 20.0 * np.sign(speed[k])
        return asked + 4e4 * (position[k] - measured["position"])

    truth = {"M": 95.1, "Fv": 203.5, "Fc": 20.4, "offset": -3.16}
    return truth, {"force": force, "reference_position": position}, {"position": 1e-6}, (1.0, 0.02)


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
def test_commands_that_a_log_may_lack_have_a_delay_that_is_estimated_with_the_parameters():
    machine, step_s = ev.load_machine("linear-axis"), 0.001
    truth, signals, noise, disturbance = axis_case(np.random.default_rng(3), 20_000, step_s)
    errors = {"noise": noise, "disturbance": disturbance}
    columns = machine.simulate(truth, signals, seconds=20.0, step_s=step_s, **errors, records=2)
    calm = machine.simulate(truth, signals, seconds=20.0, step_s=step_s, disturbance=(0.01, 0.02))
    whole = ev.identify_flight(ev.recording_from_columns(calm), model=machine)
    assert whole.quantities["M"].value == pytest.approx(truth["M"], rel=8e-5)
    for log in logs_of({name: item[::5] for name, item in columns.items()}):
        fit, told = (ev.identify_flight(log, model=machine, controller_rate_hz=r) for r in (None, 1000.0))
        for name in ("M", "Fv", "Fc"):
            for result in (fit, told):
                item = result.quantities[name]
                assert abs(item.value - truth[name]) < 2.0 * item.half_width
        # commands of half the distance of stamps are assumed, which hold 1.25 ms; these hold 0.5 ms
        low, high = fit.quantities["delay"].interval
        assert low < -0.00075 < high
        assert told.quantities["delay"].interval == (0.0, 0.0)


def boat_case(rng, count, step_s):
    """A boat with quadratic damping that is steered by its heading."""
    asked, heading = held(rng, count, step_s, 0.8, (10.0, 25.0)), 0.0

    def rudder(time, measured):
        nonlocal heading
        heading = heading + step_s * measured["yaw_rate"]
        return np.clip(asked[round(time / step_s)] - heading - 2.0 * measured["yaw_rate"], -0.5, 0.5)

    truth = {"a": 1.0 / 3.0, "a2": 2.0, "g": 0.2, "actuator_lag": 0.35, "delay": 0.2}
    signals = {"rudder": rudder, "reference_heading": asked}
    return truth, signals, {"yaw_rate": 0.002}, (0.0005, 1.0)


BOAT = {"a": 1.0 / 3.0, "g": 0.2, "actuator_lag": 0.35, "delay": 0.2}


@pytest.fixture(scope="module")
def boat_fit():
    """A result of a boat whose rudder loses 20 % of its effect at half of the record."""
    _, signals, noise, disturbance = boat_case(np.random.default_rng(1), 3000, 0.1)
    machine = ev.load_machine("boat-yaw")
    with shape_checks.unchecked():  # of every step
        columns = machine.simulate(
            BOAT, signals, seconds=300.0, step_s=0.1, noise=noise, disturbance=disturbance
        )
        columns["rudder"][1500:] /= 0.8
        return ev.identify_flight(ev.recording_from_columns(columns, name="boat"), model=machine)


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_run_that_is_too_short_for_a_frequency_has_none():
    _, signals, noise, disturbance = boat_case(np.random.default_rng(2), 1200, 0.1)
    machine, errors = ev.load_machine("boat-yaw"), {"noise": noise, "disturbance": disturbance}
    columns = machine.simulate(BOAT, signals, seconds=120.0, step_s=0.1, **errors)
    kept = np.r_[0:30, 80:1200]
    broken = {name: item[kept] for name, item in columns.items()}
    fit = ev.identify_flight(ev.recording_from_columns(broken), model=machine)
    low, high = fit.quantities["g"].interval
    assert low < BOAT["g"] < high


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_machine_is_written_as_equations(boat_fit, tmp_path):
    pytest.importorskip("casadi", reason="CasADi is not installed")
    known = {"priors": {"actuator_lag": (0.35, 0.01), "delay": (0.2, 0.01)}}
    space = json.loads(boat_fit.export("statespace", **known))
    a, g = (boat_fit.quantities[name].value for name in ("a", "g"))
    A, B = [[-a, g], [0.0, -1.0 / 0.35]], [[0.0], [1.0 / 0.35]]
    np.testing.assert_allclose(space["A"], A, atol=1e-6)
    np.testing.assert_allclose(space["B"], B, atol=1e-6)
    assert (space["states"], space["inputs"]) == (["yaw_rate", "rudder_behind"], ["rudder"])
    assert space["delay_s"] == 0.2
    (tmp_path / "f.py").write_text(boat_fit.export("casadi", **known), encoding="utf-8")
    function = runpy.run_path(str(tmp_path / "f.py"))["f"]
    expected = np.array(A) @ [0.3, -0.2] + np.array(B) @ [0.1]
    np.testing.assert_allclose(np.array(function([0.3, -0.2], [0.1])).ravel(), expected, rtol=1e-6)
    with pytest.raises(UsageError, match="MuJoCo; received one of boat-yaw"):
        boat_fit.export("mujoco")


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_pool_of_a_machine_leaves_out_a_flight_without_the_reference_of_the_others(boat_fit):
    moving = boat_fit.prepared[0].recording
    still = {name: channel for name, channel in moving.channels.items() if name != "reference_heading"}
    without = replace(moving, name="adrift", sha256="adrift", channels=still)
    fit = ev.identify_flight([without, moving], model=boat_fit.motion)
    assert fit.quantities["a"] == boat_fit.quantities["a"]
    assert [item.message[:22] for item in fit.findings if item.name == "left_out_of_pool"] == [
        "adrift is not in the p"
    ]


def test_a_derived_quantity_is_judged_by_its_parameters_and_by_its_width():
    machine = ev.machine(
        "sled",
        channels={"speed": "m/s", "push": ev.input("N"), "asked": ev.reference("m/s")},
        response="ddt(speed)",
        terms={"drag": "-speed", "lift": "-abs(speed) * speed", "per_mass": "push"},
        derived={"mass": "1 / per_mass", "share": "drag / per_mass", "less": "drag - 4 * drag"},
    )
    narrow = {"drag": (1.0, 0.05), "lift": (2.0, 0.05), "per_mass": (3.0, 0.05), "mass": (0.33, 0.01)}
    narrow |= {"share": (0.5, 0.01), "less": (-3.0, 1.0)}
    quantities = {
        name: QuantityEstimate(value, "", 0.5 * half, (value - half, value + half))
        for name, (value, half) in narrow.items()
    }
    inputs = VerdictInputs(
        (),
        50.0,
        50.0,
        Instruments(LaggedReferences(("asked",))),
        checks=MachineChecks({}),
        first_stage={"drag": 50.0, "lift": 2.0, "per_mass": 50.0},
        robust={name: ConfidenceSet.union([quantities[name].interval]) for name in ("drag", "per_mass")}
        | {"lift": ConfidenceSet.union([(1.0, np.inf)])},
        quantities=quantities,
    )

    def status(inputs):
        reasons = reasons_by_quantity(machine.rules, inputs, machine.quantities)
        assert len(set(reasons["share"])) == len(reasons["share"])
        return {name: verdict(list(item)).status for name, item in reasons.items()}

    # what is weak is the lift, of which none of them is made; the width of the last is its fault alone
    identified = dict.fromkeys(narrow, Status.IDENTIFIED)
    assert status(inputs) == identified | {"lift": Status.REFUSED, "less": Status.WEAK}
    wide = {**quantities, "drag": replace(quantities["drag"], interval=(-1.0, np.inf))}
    refused = dict.fromkeys(("drag", "lift", "share", "less"), Status.REFUSED)
    assert status(replace(inputs, quantities=wide)) == identified | refused
    # a set of weak parameters holds for one over each, and for no other quantity that they stand in
    weak = status(replace(inputs, first_stage=dict.fromkeys(inputs.first_stage, 2.0)))
    assert weak == identified | dict.fromkeys(("lift", "share", "less"), Status.REFUSED)


def test_lags_in_two_parts_are_said_with_what_to_declare():
    rover = ev.load_machine("rover")
    quantities = {"drive_gain": QuantityEstimate(1.0, "", 0.1, (0.9, 4.0))}

    def remedy(*parts):
        sets = {"actuator_lag": ConfidenceSet.union(parts), "drive_gain": ConfidenceSet.union([(0.9, 4.0)])}
        chosen = Instruments(LaggedReferences(("reference_forward_speed",)))
        inputs = VerdictInputs((), 50.0, 50.0, chosen, checks=MachineChecks({}))
        inputs = replace(inputs, robust=sets, quantities=quantities)
        (reason,) = reasons_by_quantity(rover.rules, inputs, rover.quantities)["drive_gain"]
        return reason.remedy

    assert remedy((0.4, 0.5)) == "Log for longer, or give several logs."
    assert remedy((0.4, 0.5), (1.6, np.inf)) == (
        "Lags in 2 parts fit the log (400 to 500 ms, 1600 ms or more): narrow lag_ms to the part that fits "
        "the machine. Log for longer, or give several logs."
    )


JUMPING = """name = "jumping"
response = "ddt(v) + ddt(v) * {inertia}"
[channels]
v = {{ unit = "1" }}
w = {{ unit = "1" }}
u = {{ unit = "1", role = "input" }}
r = {{ unit = "1", role = "reference" }}
[terms]
c = {{ of = "{term}", unit = "1/s" }}
k = {{ of = "u", behind = "drive", unit = "1/s" }}
[actuators.drive]
lag_ms = [10, 500]
"""


@pytest.mark.parametrize(
    "term",
    [
        "sign(v) * (1 + abs(w) ** 2) + tanh(v) - hypot(v, w)",
        "greatest(v, 0) - least(w, 1) + (v > 0 and w < 1) + (v <= 2 or not w >= 3)",
        "atan2(v, 2 + w) / sqrt(4 + v ** 2) - exp(-w) + ln(3 + v) + asin(v / 9) - sin(w) * tan(v) - -v",
    ],
)
def test_formulas_of_casadi_are_those_of_the_declaration(term, tmp_path):
    pytest.importorskip("casadi", reason="CasADi is not installed")
    path = tmp_path / "jumping.toml"
    path.write_text(JUMPING.format(term=term, inertia=0.5), encoding="utf-8")
    machine, values = ev.load_machine(path), {"c": 0.7, "k": 1.3, "actuator_lag": 0.2, "delay": 0.1}
    known = {name: (x, "1", 0.01, (x - 0.02, x + 0.02)) for name, x in values.items()}
    quantities = {name: Quantity(*item, verdict=Status.IDENTIFIED) for name, item in known.items()}
    of_log = ("u", "linear", CurveSide.UNKNOWN, {}, False, (), (), "1")
    fitted = Fitted("jumping", quantities, *of_log, machine=machine)
    (tmp_path / "f.py").write_text(target_by_name("casadi").export(fitted, Supplied()).text, encoding="utf-8")
    function = runpy.run_path(str(tmp_path / "f.py"))["f"]
    (equation,) = machine.solved(values)
    for v, w in ((0.3, 0.8), (-1.2, -2.0), (2.5, 3.5)):
        change = equation.derivative({"v": v, "w": w, "u": 0.4}, {"u": 0.9}, 0.0)
        result = np.array(function([v, 0.9], [w, 0.4])).ravel()
        np.testing.assert_allclose(result, [change, (0.4 - 0.9) / 0.2], rtol=1e-9)
    if "sign" in term:
        with pytest.raises(UsageError, match="slopes at rest; received terms that jump"):
            target_by_name("statespace").export(fitted, Supplied())


def test_a_parameter_of_a_machine_is_followed(boat_fit):
    track = followed(boat_fit, 30.0)
    assert track.name == "g"
    assert track_document(track).about.startswith("g over the log")
    before, after = (next(item for item in track.moments if item.time_s > end) for end in (145.0, 290.0))
    share, half = relative_change(before, after)
    assert abs(share + 0.2) < half < 0.1
    assert followed(boat_fit, 30.0, "a").name == "a"
    with pytest.raises(UsageError, match="a parameter out of g, a; received 'gain'"):
        followed(boat_fit, 30.0, "gain")


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
def test_parameters_of_several_equations_are_followed():
    step_s, count = 0.05, 3000
    pull = held(np.random.default_rng(2), count, step_s, 1.0, (0.5, 3.0))
    pull[:300] = pull[0]
    machine = ev.machine(
        "two-tanks",
        channels={"v": "m/s", "w": "m/s", "u": ev.input("1"), "asked": ev.reference("1")},
        axes={
            "first": {"response": "ddt(v)", "terms": {"a": "-v", "c": "-2", "g": ev.behind("u", "drive")}},
            "second": {"response": "ddt(w)", "terms": {"h": ev.behind("u", "drive"), "b": "v - w"}},
        },
        actuators={"drive": ev.actuator(lag_s=(0.02, 0.5))},
    )
    truth = {"a": 0.8, "c": 0.4, "g": 2.0, "b": 0.5, "h": 1.5, "actuator_lag": 0.2, "delay": 0.0}
    noise = {"v": 0.005, "w": 0.005}
    columns = machine.simulate(
        truth, {"u": pull, "asked": pull}, seconds=150.0, step_s=step_s, noise=noise, disturbance=(0.05, 0.5)
    )
    fit = ev.identify_flight(ev.recording_from_columns(columns), model=machine)
    for name in ("a", "g", "h", "b"):
        moments = followed(fit, 40.0, name).moments
        assert abs(moments[-1].value - truth[name]) < 2.0 * moments[-1].half_width < 0.4 * truth[name]
        # before an input moves, nothing tells what it drives from what is always there
        assert all(abs(item.value - truth[name]) < 2.0 * item.half_width for item in moments)
    assert ev.plan(fit).predicted["b"].half_width < 0.1


@pytest.mark.usefixtures("unchecked_shapes")
def test_an_equation_may_hold_what_another_one_drives_alone():
    step_s, count = 0.02, 3000
    pull = held(np.random.default_rng(4), count, step_s, 1.0, (0.5, 2.0))
    channels = {"v": "m/s", "w": "m/s", "angle": "rad", "u": ev.input("1"), "asked": ev.reference("1")}
    terms = {"gravity": "-sin(angle)", "coupling": "-cos(angle) * ddt(v)", "damping": "-ddt(angle)"}
    machine = ev.machine(
        "hanging",
        channels=channels,
        axes={
            "load": {"response": "ddt(ddt(angle))", "terms": terms},
            "cart": {"response": "ddt(v)", "terms": {"drag": "-v", "gain": ev.behind("u", "drive")}},
            "trailer": {"response": "ddt(w)", "terms": {"pull": "v - w"}},
        },
        actuators={"drive": ev.actuator(lag_s=(0.02, 0.5), delay_s=(0.0, 0.1))},
    )
    truth = {"drag": 0.8, "gain": 2.0, "gravity": 4.0, "coupling": 0.5, "damping": 0.6, "pull": 3.0}
    truth |= {"actuator_lag": 0.2, "delay": 0.04}
    noise = {"v": 0.005, "w": 0.005, "angle": 1e-4}
    columns = machine.simulate(
        truth, {"u": pull, "asked": pull}, seconds=60.0, step_s=step_s, noise=noise, disturbance=(0.02, 0.5)
    )
    fit = ev.identify_flight(ev.recording_from_columns(columns), model=machine)
    for name in ("gravity", "coupling", "damping"):
        low, high = fit.quantities[name].interval
        assert low - 0.5 * (high - low) < truth[name] < high + 0.5 * (high - low)
        assert fit.quantities[name].verdict is Status.IDENTIFIED
    assert {item["quantity"] for item in json.loads(fit.to_json())["ahead"]["errors"]} == {"v", "w"}
    space = json.loads(fit.export("statespace"))
    assert space["states"] == ["v", "w", "angle'", "angle", "u_behind"]
    expected = fit.quantities["coupling"].value * fit.quantities["drag"].value
    assert space["A"][2][0] == pytest.approx(expected, rel=1e-4)


def rover_case(rng, count, step_s):
    """A rover that is driven at speeds."""
    asked = smooth(held(rng, count, step_s, 2.0, (1.5, 5.0)), step_s, 0.05)

    def drive(time, measured):
        return 0.8 * asked[round(time / step_s)] - 0.6 * measured["forward_speed"]

    truth = {"drive_gain": 4.0, "rolling_drag": 0.8, "dry_friction": 0.3, "actuator_lag": 0.15, "delay": 0.05}
    noise = {"forward_speed": 0.01, "forward_acceleration": 0.1}
    return truth, {"drive_command": drive, "reference_forward_speed": asked}, noise, (0.05, 0.3)


@pytest.fixture(scope="module")
def drive():
    """Columns of a rover's drive, and its parameters."""
    truth, signals, noise, disturbance = rover_case(np.random.default_rng(1), 3000, 0.02)
    errors = {"noise": noise, "disturbance": disturbance}
    return ev.load_machine("rover").simulate(truth, signals, seconds=60.0, step_s=0.02, **errors), truth


@pytest.mark.usefixtures("unchecked_shapes")
def test_intervals_reach_to_estimates_by_each_of_two_responses_that_disagree(drive):
    columns, truth = drive
    late = columns | {"forward_acceleration": np.roll(columns["forward_acceleration"], 3)}
    fit = ev.identify_flight(ev.recording_from_columns(late), model="rover")
    sentence = ev.load_machine("rover").abilities.sensors.sentence(fit.fit.sensors)
    assert sentence.startswith("Of the responses forward_acceleration is 5")
    lag = fit.quantities["effective_lag"].interval
    assert lag[0] < truth["actuator_lag"] + truth["delay"] < lag[1]


@pytest.mark.usefixtures("unchecked_shapes")
def test_responses_of_each_of_several_equations_are_compared():
    step_s, axes, channels, signals, truth = 0.01, {}, {}, {}, {"actuator_lag": 0.08, "delay": 0.02}
    for seed, (name, drag, gain) in enumerate((("x", 0.5, 1.5), ("y", 0.8, 1.0))):
        asked = held(np.random.default_rng(seed), 3000, step_s, 1.0, (0.4, 1.2))
        channels[f"a{name}"] = {"unit": "m/s^2", "role": "response"}
        channels |= {f"v{name}": "m/s", f"f{name}": ev.input("N"), f"r{name}": ev.reference("m/s")}
        terms = {f"d{name}": f"-v{name}", f"g{name}": ev.behind(f"f{name}", "drive")}
        responses = [f"a{name}", f"ddt(v{name})"]
        axes[name] = {"response": responses, "references": [f"r{name}"], "terms": terms}
        force = partial(lambda v, r, t, seen: 2.0 * (r[round(t / 0.01)] - seen[v]), f"v{name}", asked)
        signals |= {f"f{name}": force, f"r{name}": asked}
        truth |= {f"d{name}": drag, f"g{name}": gain}
    drives = {"drive": ev.actuator(lag_s=(0.002, 0.2), delay_s=(0.0, 0.05))}
    machine = ev.machine("gantry", channels=channels, axes=axes, actuators=drives)
    errors = {"noise": {"vx": 0.01, "vy": 0.01, "ax": 0.1, "ay": 0.1}, "disturbance": (0.1, 0.3)}
    columns = machine.simulate(truth, signals, seconds=30.0, step_s=step_s, **errors)
    more = ev.recording_from_columns(columns | {"ay": 1.2 * columns["ay"]})
    fit = ev.identify_flight(more, model=machine)
    assert [item.instruments.shape[1] for item in fit.fit.problem.columns] == [6, 6]
    assert "Of the responses ay reads" in " ".join(fit.fit.motion_checks.by_response)
    assert fit.quantities["gy"].interval[0] < truth["gy"] < fit.quantities["gy"].interval[1]


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_curve_that_an_equation_lacks_is_named_and_widens_intervals(drive, tmp_path):
    log, truth = ev.recording_from_columns(drive[0]), drive[1]
    assert ev.identify_flight(log, model="rover").fit.motion_checks.missed is None
    lines = [line for line in machine_text("rover").splitlines() if "dry_friction" not in line]
    (tmp_path / "smooth.toml").write_text("\n".join([*lines, 'headline = ["drive_gain"]']))
    fit = ev.identify_flight(log, model=tmp_path / "smooth.toml")
    missed, drag = fit.fit.motion_checks.missed, fit.quantities["rolling_drag"]
    assert missed.of == "sign(forward_speed)"
    assert abs(missed.difference.value + truth["dry_friction"]) < missed.difference.half_width
    assert drag.interval[0] < truth["rolling_drag"] < drag.value - 0.1


def servo_case(rng, count, step_s):
    """A servo that swings without rests."""
    time = step_s * np.arange(count)
    waves = [np.sin(2.0 * np.pi * (f * time + rng.random())) for f in np.geomspace(0.2, 3.0, 10)]
    command = 0.22 * np.sum(waves, axis=0)
    truth = {"k": 400.0, "c": 28.0, "f": 3.0, "actuator_lag": 0.02, "delay": 0.01}
    return truth, {"angle_command": command, "reference_angle": command}, {"angle": 2e-4}, (2.0, 0.05)


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(
    ("name", "case", "seconds", "step_s", "off"),
    [
        ("linear-axis", axis_case, 30.0, 0.002, 0.03),
        ("boat-yaw-quadratic", boat_case, 300.0, 0.1, 0.1),
        ("rover", rover_case, 60.0, 0.02, 0.15),
        ("servo", servo_case, 30.0, 0.01, 0.08),
    ],
)
def test_a_shipped_machine_is_identified_from_its_own_simulation(name, case, seconds, step_s, off):
    machine = ev.load_machine(name)
    truth, signals, noise, disturbance = case(np.random.default_rng(1), round(seconds / step_s), step_s)
    errors = {"noise": noise, "disturbance": disturbance}
    columns = machine.simulate(truth, signals, seconds=seconds, step_s=step_s, **errors, records=2)
    for log in logs_of(columns):
        fit = ev.identify_flight(log, model=machine)
        assert fit.verdict.status.value == "identified"
        values = {name: fit.quantities[name].value for name in machine.headline}
        assert values == pytest.approx({name: truth[name] for name in machine.headline}, rel=off)
        for item in fit.quantities.values():
            assert item.interval[0] < item.value < item.interval[1]
    standstill = [finding.message for finding in fit.findings if finding.name == "standstill"]
    assert bool(standstill) == (not name.startswith("boat"))
    if "offset" in truth:
        # its response is a force, of which no state follows
        validation = ev.validate(fit, log)
        assert "of the force, one step ahead" in validation.sentence
        assert validation.agrees
        low, high = fit.quantities["offset"].interval
        assert low - (high - low) < truth["offset"] < high + (high - low)
        assert fit.quantities["offset"].unit == "N"


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("declared", [False, True])
def test_a_heading_that_guidance_computes_from_the_track_is_no_reference(declared, tmp_path):
    asked, heading, off = np.zeros(3000), 0.0, 20.0

    def rudder(time, measured):
        nonlocal heading, off
        heading = heading + 0.1 * measured["yaw_rate"]
        off = off + 0.1 * 3.0 * np.sin(heading)
        wanted = -np.arctan(off / 10.0)
        asked[round(time / 0.1)] = np.ravel(wanted)[0]
        return np.clip(wanted - heading - 2.0 * measured["yaw_rate"], -0.5, 0.5)

    text = machine_text("boat-yaw")
    if declared:
        text = text.replace('role = "reference"', 'role = "reference", feedback = true')
    (tmp_path / "boat.toml").write_text(text)
    boat, signals = ev.load_machine(tmp_path / "boat.toml"), {"rudder": rudder, "reference_heading": asked}
    errors = {"noise": {"yaw_rate": 0.002}, "disturbance": (0.005, 1.0), "seed": 3}
    log = ev.recording_from_columns(boat.simulate(BOAT, signals, seconds=300.0, step_s=0.1, **errors))
    reasons = ev.identify_flight(log, model=boat).verdict.reasons
    words = "a position loop computes" if declared else "predicts its reference (reference_heading"
    assert [words in item.sentence for item in reasons if item.status is Status.PROVISIONAL] == [True]


@pytest.mark.usefixtures("unchecked_shapes")
def test_standstill_by_the_measured_speed_is_weak_above_a_third():
    rule = next(item for item in ev.load_machine("rover").rules if item.status is Status.WEAK)
    for moving, weak in ((6, True), (8, False)):
        flight = SimpleNamespace(active=SimpleNamespace(counted=np.arange(10) < moving))
        assert rule.when(SimpleNamespace(flights=(flight,))) is weak


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_machine_is_planned_within_limits(boat_fit):
    made = ev.plan(boat_fit, seconds=200.0)
    (reference,) = made.references.values()
    assert np.abs(reference - reference.mean()).max() <= 1.01 * made.limits["reference_heading"][0]
    assert list(made.predicted) == ["a", "g", "actuator_lag", "delay", "effective_lag"]
    for name in ("a", "g"):
        assert 0.2 < made.predicted[name].half_width / boat_fit.quantities[name].half_width < 5.0
    assert made.is_informative
    tighter = ev.plan(boat_fit, seconds=200.0, limits={"rudder": (0.02,)}, target="g")
    assert tighter.predicted["g"].half_width > 2.0 * made.predicted["g"].half_width


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
def test_the_command_line_plans_a_machine(boat_fit, tmp_path):
    made = ev.plan(boat_fit, seconds=200.0)
    (reference,) = made.references.values()
    (tmp_path / "fit.json").write_text(boat_fit.to_json(), encoding="utf-8")
    asked = ["plan", str(tmp_path / "fit.json"), "--time", "200", "--csv", str(tmp_path / "plan.csv")]
    run = CliRunner().invoke(app, [*asked, "--json", "-"])
    document = json.loads(run.stdout)
    assert run.exit_code == 0
    assert document["predicted"]["g"]["half_width"] == pytest.approx(made.predicted["g"].half_width)
    table = np.loadtxt(tmp_path / "plan.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 1], reference, atol=1e-5)
    steps = CliRunner().invoke(app, ["plan", str(tmp_path / "fit.json"), "--time", "60", "--shape", "steps"])
    assert "steps, one every" in steps.output
    refused = {"--limit=rudder": "NAME=SIZE", "--limit=rudde=1": "rudder", "--speed=3": "--speed"}
    refused |= {"--for=h": "out of all, a, g", "--time=5": "10 to 3600 s", "--limit=rudder=0": "above zero"}
    refused |= {"--seed=-1": "a seed of zero or more"}
    for option, words in refused.items():
        run = CliRunner().invoke(app, ["plan", str(tmp_path / "fit.json"), option])
        assert (run.exit_code, words in " ".join(run.output.split())) == (2, True), option


def vertical_log():
    """A vertical motion under control, pushed by gusts; the command has a name of its own as well."""
    step_s, count, rng = 0.01, 6000, np.random.default_rng(3)
    asked = held(rng, count, step_s, 1.2, (1.0, 3.0))
    speed, gust, state = 0.0, 0.0, 0.5
    columns = np.zeros((count, 3))
    for k in range(count):
        command = np.clip(0.5 + 0.12 * (asked[k] - speed), 0.1, 0.9)
        state += (command - state) * (1.0 - np.exp(-step_s / 0.05))
        gust += 0.2 * np.sqrt(2.0 * step_s / 0.5) * rng.standard_normal() - step_s * gust / 0.5
        force = 40.0 * state**2 - 0.4 * speed + gust
        columns[k] = speed, force, command
        speed += step_s * (force - 9.80665 - 0.19335)
    columns[:, :2] += rng.standard_normal((count, 2)) * (0.01, 0.1)
    made = dict(zip(("velocity_z", "specific_force_z", "rotor_command_1"), columns.T, strict=True))
    made |= {"time": step_s * np.arange(count), "reference_velocity_z": asked}
    return {**made, "motor": made["rotor_command_1"]}


@pytest.mark.thorough
@pytest.mark.parametrize(("lag_s", "delay_s"), [((0.05, 0.05), (0.0, 0.0)), ((0.002, 0.3), (0.0, 0.1))])
def test_a_declaration_of_the_vertical_motion_is_the_built_in(monkeypatch, lag_s, delay_s):
    # the built-in motion derives the velocity by central differences, which lose 0.4 % at 2.5 Hz of 100 Hz
    derived = replace(regression.EQUATION, response=(*regression.EQUATION.response[:1], "ddt(velocity_z)"))
    monkeypatch.setattr(regression, "EQUATION", derived)
    machine = ev.machine(
        "declared-vertical",
        channels={
            "velocity_z": "m/s",
            "specific_force_z": {"unit": "m/s^2", "role": "response"},
            "motor": ev.input("1"),
            "reference_velocity_z": ev.reference("m/s"),
        },
        response=["specific_force_z", "ddt(velocity_z)"],
        terms={"viscous_friction": "-velocity_z", "input_gain": ev.behind("motor**2", "motor")},
        actuators={"motor": ev.actuator(lag_s=lag_s, delay_s=delay_s)},
    )
    log, vertical = ev.recording_from_columns(vertical_log()), ev.motion_by_name("vertical")
    rule = LaggedReferences(("reference_velocity_z",), (4, 0.25))
    flights = [(prepare(log, motion, FlightOptions()).shortened,) for motion in (vertical, machine)]
    # the machine would choose the lags of its references by their strength
    declared = DeclaredMotion.problem(machine, flights[1], rule)
    built_in = vertical.problem(flights[0], rule).with_nuisances(declared.nuisances)
    one, other = (identify(problem, by_name("reference_iv")) for problem in (built_in, declared))
    assert one.names == other.names
    assert one.values == pytest.approx(other.values, rel=1e-9, abs=1e-12)
    assert one.std_errors == pytest.approx(other.std_errors, rel=1e-9)


# -- Declarations --


def test_a_file_and_python_declare_the_same(tmp_path):
    (tmp_path / "m.toml").write_text(ROLL)
    of_file = ev.load_machine(tmp_path / "m.toml")
    assert ev.motion_by_name(tmp_path / "m.toml") == of_file
    channels = {"p": {"unit": "rad/s", "noise": 0.003}, "aileron": ev.input("1")}
    channels |= {"phi_reference": ev.reference("rad")}
    in_python = ev.machine(
        "roll",
        response="ddt(p)",
        channels=channels,
        let={"drag": {"is": "2 * p", "unit": "rad/s"}, "most": {"is": "3", "unit": "rad/s"}},
        terms={"L_p": "drag", "L_da": ev.behind("aileron", "servo", unit="rad/s^2")},
        actuators={"servo": ev.actuator(lag_s=(0.002, 0.3))},
        derived={"time_constant": "-1 / L_p"},
        active="abs(p) < most",
        headline=["L_p"],
    )
    assert (in_python.axes, in_python.activity) == (of_file.axes, of_file.activity)
    assert in_python.quantities == of_file.quantities
    assert (of_file.quantities["L_p"].unit, of_file.quantities["time_constant"].unit) == ("1/s", "s")
    assert of_file.equation[0] == "ddt(p) = L_p (2 * p) + L_da aileron + b"


def test_the_equation_shows_the_sign_and_the_number_of_what_stands_alone():
    declared = {"channels": {"v": "m/s", "u": ev.input()}, "response": "ddt(v)"}
    for text, shown in {"-1": "- c", "1": "+ c", "-9.8": "- c 9.8"}.items():
        car = ev.machine("car", **declared, terms={"a": "u", "c": text})
        assert car.equation[0] == f"ddt(v) = a u {shown}"


def test_the_unit_of_a_root_is_read_back():
    tank = ev.machine(
        "tank",
        response="ddt(level)",
        channels={"level": "m", "flow": ev.input("m^3/s"), "goal": ev.reference("m")},
        terms={"outflow": {"of": "-level**0.5", "unit": "m^(1/2)/s"}, "inflow": "flow"},
        derived={"ratio": "outflow / inflow"},
    )
    assert tank.quantities["ratio"].unit == "m^(5/2)/s"


def test_machines_are_listed_shown_and_begun(tmp_path):
    run = CliRunner().invoke
    assert all(name in run(app, ["machine", "list"]).output for name in shipped_machines())
    assert run(app, ["machine", "show", "rover"]).output == machine_text("rover")
    new = tmp_path / "mine.toml"
    assert run(app, ["machine", "new", str(new), "--like", "servo"]).exit_code == 0
    assert ev.load_machine(new).title == "Servo"
    again = run(app, ["machine", "new", str(new)])
    assert (again.exit_code, "would be lost" in again.output) == (2, True)
    assert run(app, ["machine", "new", "--like", "sevro"]).exit_code == 2
    assert run(app, ["identify", "x.csv", "--machine", "rover", "--model", "rates"]).exit_code == 2
