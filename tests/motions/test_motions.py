"""The table of motions: Eivor's own, and those that other packages bring."""

from __future__ import annotations

import json
import re
import sys
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from turning_logs import turned
from typer.testing import CliRunner

import eivor as ev
from eivor.cli.main import app
from eivor.errors import UsageError
from eivor.flights import identify
from eivor.flights.identify import with_coupled_axes
from eivor.flights.quantity import Quantity, QuantityEstimate
from eivor.flights.verdict import InstrumentStrength, VerdictInputs, reasons_by_quantity
from eivor.inference.verdict import Reason, Status, verdict
from eivor.motions import table as motions
from eivor.motions.table import loaded_motion, motion_names
from eivor.motions.vertical.motion import Vertical
from eivor.signals import channels
from eivor.signals.channels import CanonicalChannel
from eivor.signals.recording import Channel

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
        monkeypatch.setattr(motions, "entry_points", lambda *, group: groups.get(group, []))
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
        (
            "walk",
            "",
            r"a motion out of vertical, rates, rigid-body; received 'walk'\. Name one of them with --model",
        ),
        ("walk", "no_such_package:Walk", "a motion 'walk' that can be loaded .*ModuleNotFoundError"),
        ("walk", f"{HERE}:NO_MOTION", "a motion called 'walk' .*; received 7"),
        ("walk", f"{HERE}:Misnamed", "a motion called 'walk' .*; received one .* called 'other'"),
    ],
)
def test_what_is_no_motion_is_refused(added, name, value, said):
    added(**({name: value} if value else {}))
    with pytest.raises(UsageError, match=f"Expected {said}"):
        ev.motion_by_name(name)


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_model_is_a_name_or_a_motion(recording_of_example):
    with pytest.raises(UsageError, match="Expected the name of a motion, or a motion; received int"):
        ev.identify_flight(recording_of_example, model=7)


@pytest.fixture(scope="module")
def recording_of_example():
    from eivor.logs.read import example_flight

    return example_flight()


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
    companions = with_coupled_axes(bare, MOTIONS, [logging(*logged)], [None])
    (finding,) = companions.findings
    assert finding.name == "no_thrust_gain"
    assert missing in finding.message
    assert "thrust_gain" not in companions.quantities
    assert companions.verdict == turning.verdict


@pytest.mark.thorough
def test_the_other_motion_is_given_the_lag_and_has_its_own_verdict(turning, monkeypatch):
    requested = {}
    why = Reason(Status.WEAK, "The input gain's interval is wide.", "Fly steps.")
    gain = Quantity(30.0, "m/s^2", 1.0, (28.0, 32.0), Status.WEAK, reasons=(why,))

    def identified(_logs, _motion, options, _windows, *, lag_measurements):
        requested.update(options=options, lag_measurements=lag_measurements)
        return SimpleNamespace(quantities={"input_gain": gain})

    monkeypatch.setattr(identify, "identified", identified)
    of_turning = turning.quantities["effective_lag"]
    lag = replace(of_turning, interval=(0.04, 0.05), verdict=Status.IDENTIFIED)
    known = replace(turning, quantities={**turning.quantities, "effective_lag": lag})
    companions = with_coupled_axes(known, MOTIONS, [logging("input", "acceleration_z")], [None])
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
    monkeypatch.setattr(motions, "entry_points", lambda *, group: [point] if group == motions.GROUP else [])
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
    done = CliRunner().invoke(
        app, ["identify", str(tmp_path / "still.csv"), "--model", "rover", "--json", "-"]
    )
    assert done.exit_code == 3
    document = json.loads(done.output)
    assert document["model"]["name"] == "rover"
    assert document["verdict"] == "refused"
    assert list(document["derived"]) == ["breakaway_command", "time_constant", "effective_lag"]


@pytest.mark.usefixtures("simulate")
def test_weak_instruments_refuse_what_has_no_set():
    rover = ev.motion_by_name("rover")
    names = ("drive_gain", "dry_friction", "rolling_drag", "effective_lag", "breakaway_command")
    quantities = {name: QuantityEstimate(1.0, "", 0.02, (0.985, 1.015)) for name in names}
    sets = dict.fromkeys(names[:2], ev.ConfidenceSet(((0.95, 1.05),)))
    for F, robust, wanted in ((3.0, sets, "refused"), (3.0, {}, "refused"), (30.0, {}, "identified")):
        strength = InstrumentStrength({"drive_gain": F}, robust=robust)
        inputs = replace(AT, strength=strength, quantities=quantities)
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


AT = VerdictInputs((), 100.0, 100.0, exogenous=True, direct=False, used_s=60.0)
