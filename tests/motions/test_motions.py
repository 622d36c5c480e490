"""The table of motions: Eivor's own, and those that other packages bring."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import EntryPoint

import pytest

import eivor as ev
from eivor import motions
from eivor.errors import UsageError
from eivor.flights.motion import Motion
from eivor.motions import loaded_motion, motion_by_name, motion_names, wording_of
from eivor.motions.vertical.motion import Vertical
from eivor.signals import channels
from eivor.signals.channels import CanonicalChannel

HERE = __name__
CLIMB_RATE = CanonicalChannel("climb_rate", "m/s")


@dataclass(frozen=True)
class Climb(Vertical):
    """The vertical motion under another name."""

    name = "climb"
    model_name = "climbing"
    channels = (CLIMB_RATE,)


@dataclass(frozen=True)
class Misnamed(Vertical):
    """A motion whose entry point has another name."""

    name = "other"


NO_MOTION = 7


@pytest.fixture
def table(monkeypatch: pytest.MonkeyPatch):
    """The table of channels, which is as it was after the test."""
    monkeypatch.setattr(channels, "_TABLE", dict(channels.canonical_channels()))


@pytest.fixture
def added(monkeypatch: pytest.MonkeyPatch):
    """Entry points of other packages, for one test."""

    def add(**values: str) -> None:
        points = [EntryPoint(name, value, motions.GROUP) for name, value in values.items()]
        groups = {motions.GROUP: points}
        monkeypatch.setattr(motions, "entry_points", lambda *, group: groups.get(group, []))
        loaded_motion.cache_clear()

    yield add
    loaded_motion.cache_clear()


def test_own_motions_are_known_by_name():
    motion = motion_by_name("vertical")
    assert motion == Vertical()
    assert (motion.name, motion.model_name) == ("vertical", "vertical_motion")
    assert "vertical" in motion_names()


@pytest.mark.parametrize("name", ["vertical"])
def test_a_motion_has_words_for_all_that_it_shows(name):
    motion = motion_by_name(name)
    assert set(motion.plotted) == set(motion.wording)
    assert {*motion.headline, *motion.rows} <= set(motion.wording)
    assert isinstance(motion, Motion)


def test_words_of_quantities_are_found_and_unknown_ones_have_none():
    wording = wording_of("viscous_friction")
    assert wording is not None
    assert (wording.words, wording.symbol, wording.shown_unit) == ("viscous friction", "K", "1/s")
    assert wording_of("theta_1") is None


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
    motion_by_name("climb")
    assert channels.canonical_channel("climb_rate") == CLIMB_RATE


def test_own_motions_come_first(added):
    added(vertical=f"{HERE}:Climb")
    assert motion_by_name("vertical") == Vertical()
    assert motion_names() == ("vertical", "rates", "rigid-body")


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        (
            "walk",
            "",
            r"a motion out of vertical, rates, rigid-body; received 'walk'\. Name one of them with --model",
        ),
        ("walk", "no_such_package:Walk", "a motion 'walk' that can be loaded .*ModuleNotFoundError"),
        ("walk", f"{HERE}:NO_MOTION", "a class of motion called 'walk' .*; received 7"),
        (
            "walk",
            f"{HERE}:Misnamed",
            "a class of motion called 'walk' .*; received one .* called 'other'",
        ),
    ],
)
def test_what_is_no_motion_is_refused(added, name, value, said):
    added(**({name: value} if value else {}))
    with pytest.raises(UsageError, match=f"Expected {said}"):
        motion_by_name(name)


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_model_is_a_name_or_a_motion(recording_of_example):
    with pytest.raises(UsageError, match="Expected the name of a motion, or a motion; received int"):
        ev.identify_flight(recording_of_example, model=7)


@pytest.fixture(scope="module")
def recording_of_example() -> ev.Recording:
    from eivor.logs.read import example_flight

    return example_flight()
