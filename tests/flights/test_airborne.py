"""Where a vehicle flies: the land detector, or the rule on input and height."""

from __future__ import annotations

import numpy as np
import pytest
from flight_logs import changed, channel, every, flown, prepare_vertical

from eivor.flights.grid import AIRBORNE_MARGIN_S, airborne
from eivor.flights.options import FlightOptions

STEP_S = 0.01
MARGIN = round(AIRBORNE_MARGIN_S / STEP_S)


def profile(*stretches: tuple[float, float]) -> np.ndarray:
    """Values held for so many seconds each."""
    return np.concatenate([np.full(round(seconds / STEP_S), value) for seconds, value in stretches])


def found(level, *, landed=None, height=None):
    return airborne(input_level=level, step_s=STEP_S, landed=landed, height=height)


def stretches(mask: np.ndarray) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def test_land_detector_decides_and_margins_are_left_out():
    landed = profile((3.0, 1.0), (10.0, 0.0), (2.0, 1.0)) > 0.5
    result = found(np.zeros(1500), landed=landed)
    assert result.rule == "the log's land detector"
    assert stretches(result.mask) == [(300 + MARGIN, 1300 - MARGIN)]
    # In the air from the first sample to the last: no take-off and no landing to leave out.
    assert found(np.zeros(1500), landed=np.zeros(1500, dtype=bool)).mask.all()


def test_input_that_is_never_off_flies_throughout():
    result = found(profile((10.0, 0.5), (0.49, 0.0), (10.0, 0.5)))
    assert result.rule == "the input, which is never off"
    assert result.mask.all()


def test_short_cuts_of_the_throttle_do_not_land_a_vehicle():
    result = found(profile((3.0, 0.0), (10.0, 0.5), (0.3, 0.0), (10.0, 0.5), (3.0, 0.0)))
    assert stretches(result.mask) == [(300 + MARGIN, 2330 - MARGIN)]


def test_input_alone_tells_when_there_is_no_height():
    result = found(profile((2.0, 0.05), (10.0, 0.5), (2.0, 0.0)))
    assert result.rule == "the input (no height is logged)"
    assert stretches(result.mask) == [(200 + MARGIN, 1200 - MARGIN)]


def test_input_and_height_tell_together():
    level = profile((2.0, 0.0), (10.0, 0.5), (2.0, 0.0))
    height = profile((4.0, 3.02), (6.0, 4.5), (2.0, 3.05), (2.0, 3.0))
    result = found(level, height=height)
    assert result.rule == "the input and the height above ground"
    assert stretches(result.mask) == [(400 + MARGIN, 1000 - MARGIN)]


def test_an_input_that_is_off_in_the_air_does_not_make_ground():
    """A dive with the throttle near zero at 1.5 m: the vehicle never touched the ground."""
    level = profile((10.0, 0.5), (0.51, 0.05), (9.49, 0.5))
    result = found(level, height=np.full(2000, 1.5))
    assert result.rule == "the input (it is on at both ends of the log)"
    assert stretches(result.mask) == [(0, 1000 - MARGIN), (1051 + MARGIN, 2000)]
    # the ground is where the flight begins, not where the dive was
    started = found(
        profile((2.0, 0.0), (8.0, 0.5), (2.0, 0.0), (8.0, 0.5)), height=profile((2.0, 0.1), (18.0, 2.0))
    )
    assert stretches(started.mask) == [(200 + MARGIN, 1000 - MARGIN), (1200 + MARGIN, 2000)]


def test_the_ground_is_the_lower_end():
    """Taken off from a table of a metre and landed on the floor: low flight is flight."""
    height = profile((2.0, 1.0), (6.0, 2.0), (10.0, 0.4), (2.0, 0.0))
    result = found(profile((2.0, 0.0), (16.0, 0.5), (2.0, 0.0)), height=height)
    assert stretches(result.mask) == [(200 + MARGIN, 1800 - MARGIN)]


def test_motors_at_idle_end_a_flight_whatever_the_land_detector_says():
    level = profile((10.0, 0.5), (0.4, 0.001), (5.0, 0.5), (5.0, 0.001))
    result = found(level, landed=np.zeros(2040, dtype=bool))
    assert stretches(result.mask) == [(0, 1540 - MARGIN)]


@pytest.mark.parametrize(
    "level", [profile((5.0, 0.0)), profile((5.0, -0.3)), profile((5.0, 0.0), (0.1, 1.0))]
)
def test_input_that_never_rises_never_flies(level):
    assert not found(level).mask.any()


# -- the channels behind it -------------------------------------------------------------------------------


def airborne_share(log) -> float:
    return float(prepare_vertical(log, FlightOptions()).active.mask.mean())


def test_before_its_first_message_the_land_detector_says_landed():
    (log,) = flown(seconds=10.0)
    late = channel("landed", [2.0, 9.0], [0.0, 0.0])
    mask = prepare_vertical(changed(log, landed=late), FlightOptions()).active.mask
    assert stretches(mask) == [(200 + MARGIN, 1000)]


def test_ground_contact_counts_as_landed():
    (log,) = flown(seconds=10.0)
    touching = channel("ground_contact", [0.0, 4.0, 5.0], [0.0, 1.0, 0.0])
    landed = channel("landed", [0.0, 9.0], [0.0, 0.0])
    mask = prepare_vertical(changed(log, landed=landed, ground_contact=touching), FlightOptions()).active.mask
    assert stretches(mask) == [(0, 400 - MARGIN), (500 + MARGIN, 1000)]


@pytest.mark.parametrize("values", [([], []), ([0.0], [np.nan])])
def test_a_land_detector_that_says_nothing_is_no_land_detector(values):
    (log,) = flown(seconds=10.0)
    assert airborne_share(changed(log, landed=channel("landed", *values))) == 1.0


@pytest.mark.parametrize("height", ["one sample", "nothing but NaN", "none"])
def test_a_height_that_is_hardly_known_does_not_ground_the_flight(height):
    (log,) = flown(seconds=10.0)
    off = log.channels["rotor_command_1"].values.copy()
    off[:200] = 0.0
    log = changed(log, rotor_command_1=off)
    position = {
        "one sample": channel("position_z", [5.0], [1.0]),
        "nothing but NaN": channel("position_z", np.arange(0.0, 10.0, 0.1), np.full(100, np.nan)),
        "none": channel("position_z", [], []),
    }[height]
    assert airborne_share(changed(log, position_z=position)) == pytest.approx(0.7, abs=0.01)


def test_slow_heights_serve():
    (log,) = flown(seconds=10.0)
    assert airborne_share(every(log, 20, "position_z")) == 1.0
