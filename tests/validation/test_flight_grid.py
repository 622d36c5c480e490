"""The published grid holds what the study promises, and a damaged one is refused in words."""

from __future__ import annotations

from collections import Counter
from importlib.resources import files

import pytest

from eivor.errors import InputError, UsageError
from validation.flight_recipe.trials import FlightGrid, flight_grid, published_grid

TEXT = files("validation.flight_recipe").joinpath("grid.toml").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def grid() -> FlightGrid:
    return published_grid()


def test_grid_is_as_large_as_promised(grid):
    excited = [case for case in grid.cases if case.kind == "excited"]
    assert len(excited) >= 300
    assert sum(case.calm for case in excited) >= 150
    assert sum(case.simulator == "rotorpy" for case in excited) >= 60
    hovers = [case for case in grid.cases if case.kind == "hover"]
    assert len(hovers) >= 60
    assert {case.simulator for case in hovers} == {"vertical", "rotorpy"}
    assert Counter(case.simulator for case in grid.cases).most_common(1)[0][0] == "vertical"
    assert {case.spec.duration for case in grid.cases} == {60.0}


def test_calm_is_excited_and_hardly_any_wind(grid):
    for case in grid.cases:
        assert case.calm == (case.kind == "excited" and case.spec.gust_rms <= 0.3)
        assert (case.kind == "excited") == (case.spec.trajectory in {"steps", "multisine", "chirp"})


def test_small_size_is_a_part_with_every_kind(grid):
    small = grid.small()
    assert set(small.cases) < set(grid.cases)
    assert {case.kind for case in small.cases} == {"excited", "climbs", "hover", "hover-steps"}
    assert {case.simulator for case in small.cases} == {"vertical", "rotorpy"}
    assert {case.spec.noise.kind for case in small.cases if case.calm} == {
        "white",
        "heavy-tailed",
        "fractional",
    }


def test_draws_do_not_depend_on_one_another(grid):
    other = flight_grid(TEXT.replace("hover_input = [0.4, 0.7]", "hover_input = [0.3, 0.4]"))
    for first, second in zip(grid.cases, other.cases, strict=True):
        assert first.spec.actuator_lag == second.spec.actuator_lag
        assert first.spec.noise == second.spec.noise
        if first.simulator == "vertical":
            assert first.spec.hover_input >= 0.4 >= second.spec.hover_input


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("duration = 60.0", "duration = ", "a grid of the study"),
        ("duration = 60.0", "", "missing required field `duration`"),
        ("duration = 60.0", 'duration = "long"', "Expected `float`, got `str` - at `..duration`"),
        ('name = "gusty"', 'name = "calm"', "names and seeds of their own"),
        ("seed = 420000", "seed = 410001", "names and seeds of their own"),
        ('kind = "climbs"', 'kind = "walks"', "Invalid enum value 'walks'.*kind"),
        ("replicates = 4", "repetitions = 4", "unknown field `repetitions`"),
        ("small_every = 19", "colour = 19", "unknown field `colour`"),
        ("vigour = [0.6, 1.0]", "vigour = [1.0, 0.6]", "a range of vigour.*1.0, 0.6.*vertical"),
        ("vigour = [0.6, 1.0]", "vigour = 0.6", "Expected `array`, got `float` - at `..vertical.uniform"),
        (
            "delay = [0.0, 0.01, 0.02]\n\n# -----",
            "delay = []\n# -----",
            "of length >= 1 - at `..rotorpy.choice",
        ),
        ("vigour = [0.6, 1.0]", "courage = [0.6, 1.0]", "every value of a flight"),
        ("velocity_noise = [0.02, 0.05]\nposition", "position", "every value of a flight"),
        ('"fractional"]\ngust_rms = [0.0, 0.1, 0.2', '"pink"]\ngust_rms = [0.0, 0.1, 0.2', "every value"),
        ("quickness = [0.2, 0.45]", "quickness = [2.0, 4.5]", "quickness between"),
    ],
)
def test_damaged_grid_is_refused(old, new, message):
    assert old in TEXT
    with pytest.raises((InputError, UsageError), match=message):
        flight_grid(TEXT.replace(old, new, 1))
