"""Flights near the ground, in rotor radii: gain and hover input are weak, however quiet the tests are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from eivor.errors import InputError, UsageError
from eivor.flights.motion import VerdictInputs
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.motions.vertical.motion import Vertical
from eivor.motions.vertical.regression import check_terms
from eivor.motions.vertical.verdict import near_ground, near_ground_reasons
from flights.flight_logs import flown

pytestmark = pytest.mark.usefixtures("unchecked_shapes")
RADIUS = 0.2


def flight(lowest: float, *, on_ground: bool = True):
    log = flown(seconds=10.0, seed=5)[0]
    height = log.channels["position_z"]
    over = height.values - height.values.min() + lowest
    before = np.full(200 if on_ground else 0, 0.0)
    time = height.time_s[0] - 0.01 * np.arange(before.size, 0, -1)
    changed = replace(
        height, time_s=np.concatenate([time, height.time_s]), values=np.concatenate([before, over])
    )
    log = replace(log, channels={**log.channels, "position_z": changed})
    return prepare(log, Vertical(), FlightOptions())


def at(numbers) -> VerdictInputs:
    return VerdictInputs(1, 100.0, 100.0, exogenous=True, direct=False, numbers=numbers)


def test_heights_count_in_radii():
    low, high = flight(0.4), flight(1.0)
    assert near_ground([high], RADIUS, corrected=False)["near_ground_share"] == 0.0
    ground = near_ground([low, high], RADIUS, corrected=False)
    assert ground["lowest_radii"] == pytest.approx(2.0, abs=0.5)
    assert 0.01 < ground["near_ground_share"] < 0.9
    (reason,) = near_ground_reasons(at(ground))
    assert reason.sentence.startswith("The vehicle flew below 4 rotor radii over the ground for ")
    assert not list(near_ground_reasons(at(near_ground([high], RADIUS, corrected=False))))


def test_nothing_is_said_without_radius_or_ground_or_where_the_equation_has_it():
    low = flight(0.4)
    assert near_ground([low], None, corrected=False) == {}
    assert near_ground([low], RADIUS, corrected=True) == {}
    assert near_ground([flight(0.4, on_ground=False)], RADIUS, corrected=False) == {}
    assert not list(near_ground_reasons(at({})))


def test_the_radius_comes_from_a_vehicle_too(tmp_path: Path):
    file = tmp_path / "mine.toml"
    rotors = '[rotors]\nlayout = "quad-x"\nnumbering = "px4"\n'
    file.write_text(rotors + "radius = 0.15\n", encoding="utf-8")
    vertical = Vertical().of_vehicle(str(file))
    assert vertical.rotor_radius == 0.15
    check_terms(FlightOptions(terms=("ground-effect",)), vertical.rotor_radius)
    low = (flight(0.4),)
    assert vertical.for_flights(low, FlightOptions()).rotor_radius == 0.15
    assert vertical.for_flights(low, FlightOptions(rotor_radius=0.3)).rotor_radius == 0.3
    with pytest.raises(UsageError, match="the radius of its rotors"):
        Vertical().of_vehicle("quadrotor-x")
    file.write_text(rotors + "radius = 15.0\n", encoding="utf-8")
    with pytest.raises(InputError, match="rotor_radius"):
        Vertical().of_vehicle(str(file))
