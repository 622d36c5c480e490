"""Diagnostics of a flight: constancy, least squares beside the estimate, memory, leverage of runs."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy
import scipy.linalg
import scipy.stats
from flight_logs import FRICTION, LAG_S, flown
from scipy import stats

import eivor as ev
from eivor.errors import UsageError
from eivor.estimation.profile_sets import ProfileSets
from eivor.flights.estimate import with_systematic_uncertainties
from eivor.flights.quantity import NAN, Counts, QuantityEstimate, SystematicUncertainty, widened
from eivor.inference.diagnostics.excitation import Swing
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.verdict import Status
from eivor.motions.vertical.motion import Vertical
from eivor.report.flight import checks
from eivor.signals.recording import Recording
from estimation.vertical_flight_signals import Noise, flights, problem

EXAMPLE = Path(ev.__file__).parent / "data" / "example_flight.parquet"
LAGS = np.geomspace(0.02, 0.12, 5)


@pytest.fixture(scope="module")
def example() -> ev.FlightEstimate:
    return ev.identify_flight(ev.read_log(str(EXAMPLE)))


@pytest.mark.calibration
def test_constancy_keeps_its_size_in_flights():
    """Flights in gusts: no more of them change than the level says."""
    runs = 12
    each = [problem(*flights(1, seconds=40.0, noise=Noise(gust=0.5), seed=s), lags=LAGS) for s in range(runs)]
    p_values = [ev.diagnose(ev.identify(item, ev.methods.reference_iv())).constancy.p_value for item in each]
    assert sum(p < 0.05 for p in p_values) <= stats.binom.ppf(1.0 - 1e-4, runs, 0.06)


@pytest.mark.thorough
def test_a_change_between_flights_is_told():
    """A command that is scaled from the second flight on: the gain per command is another one."""
    first, second = flights(2, seconds=40.0, noise=Noise())
    channels = dict(second.signals.channels)
    channels["rotor_command_1"] = 1.1 * channels["rotor_command_1"]
    changed = replace(second, signals=replace(second.signals, channels=channels))
    fit = ev.identify(problem(first, changed, lags=LAGS), ev.methods.reference_iv())
    diagnose = ev.diagnose(fit)
    assert diagnose.constancy.p_value <= 0.01
    assert diagnose.constancy.break_at == pytest.approx(0.5, abs=0.05)
    gain = fit.names.index("input_gain")
    assert diagnose.constancy.change[gain] / fit.parameters["input_gain"] == pytest.approx(
        1.0 / 1.21 - 1.0, abs=0.07
    )
    assert any("change during the record" in reason.sentence for reason in diagnose.reasons)


def test_numbers_of_the_example(example):
    numbers = example.diagnostics
    friction = example.quantities["viscous_friction"]
    # calm air and a faithful model: least squares agrees, nothing changes, nothing drifts
    assert numbers["least_squares_viscous_friction"] == pytest.approx(friction.value, abs=friction.std_error)
    assert numbers["constancy_p_value"] > 0.01
    assert 0.15 <= numbers["constancy_break"] <= 0.85
    assert abs(numbers["residual_memory"]) < 0.3
    assert abs(numbers["thrust_drift"]) < numbers["thrust_drift_half_width"] < 0.03
    assert abs(numbers["leverage_viscous_friction"]) < 1.5
    assert numbers["leverage_segments"] == 10.0
    assert 1.0 <= numbers["leverage_segment"] <= 10.0


def test_checks_are_said_in_words(example):
    sentence = dict(checks(example))
    assert list(sentence) == [
        "sensors",
        "instruments",
        "agreement",
        "constancy",
        "periods",
        "residual",
        "leverage",
        "least squares",
        "drift",
        "left out",
    ]
    assert "first-stage F" in sentence["instruments"]
    assert sentence["agreement"].startswith("the instruments agree")
    assert sentence["constancy"].startswith("the parameters stay the same")
    assert sentence["periods"].startswith("no periodic component in the residual (p ")
    assert sentence["least squares"] == "would give K 0.183 1/s"
    result = example.fit.checks
    index = example.names.index("viscous_friction")

    def moved(values: np.ndarray, by: float) -> np.ndarray:
        return np.where(np.arange(values.size) == index, by, values)

    worse = replace(
        result,
        agreement=replace(result.agreement, p_value=1e-9),
        constancy=replace(
            result.constancy, p_value=0.001, break_at=0.4, change=moved(result.constancy.change, 0.1)
        ),
        endogeneity=replace(
            result.endogeneity, p_value=0.001, difference=moved(result.endogeneity.difference, -0.3)
        ),
        leverage=replace(
            result.leverage,
            in_std_errors=np.vstack([moved(row, -3.0) for row in result.leverage.in_std_errors]),
        ),
        memory=replace(result.memory, memory=0.9),
        periodicity=replace(
            result.periodicity, parameters=(Swing("viscous_friction", "1/s", 6.0, 0.1, 1e-6),), left_over=()
        ),
    )
    sentence = dict(checks(replace(example, fit=replace(example.fit, checks=worse))))
    assert sentence["agreement"] == "the instruments disagree (p <= 0.001)"
    assert sentence["constancy"] == (
        "the parameters change (p <= 0.001), most likely 40% into the time used: K by +0.1 1/s"
    )
    assert sentence["periods"] == "K varies by ±0.1 1/s with a period of 6 s (p <= 0.001)"
    pushed = replace(
        worse,
        periodicity=replace(result.periodicity, left_over=(Swing("acceleration", "m/s²", 6.0, 0.3, 1e-6),)),
    )
    said_of_a_push = dict(checks(replace(example, fit=replace(example.fit, checks=pushed))))["periods"]
    assert said_of_a_push == (
        "what the model leaves over of the acceleration swings by ±0.3 m/s² with a period of 6 s "
        "(p <= 0.001), as by a wind or a supply that swings"
    )
    assert "standard errors off" in sentence["least squares"]
    assert sentence["residual"].endswith("(it drifts)")
    assert sentence["leverage"].endswith("-3.0 standard errors: inspect that part")


@pytest.mark.thorough
def test_a_direct_method_has_fewer_checks():
    identify_flight = ev.identify_flight(ev.read_log(str(EXAMPLE)), ev.FlightOptions(method="least_squares"))
    sentence = dict(checks(identify_flight))
    assert "instruments" not in sentence
    assert "least squares" not in sentence
    assert "constancy" in sentence


K = "viscous_friction"


@pytest.fixture(scope="module")
def gusty() -> Recording:
    """A flight in gusts."""
    return flown(seconds=15.0, gust=2.0, amplitude=0.5, seed=3)[0]


@pytest.fixture(scope="module")
def one_frequency() -> Recording:
    """A flight whose reference tells friction and lag together only."""
    return flown(seconds=30.0, gust=2.0, seed=1, hertz=(0.32,))[0]


@pytest.fixture(scope="module")
def two_frequencies() -> Recording:
    """A flight whose reference hardly tells its lag."""
    return flown(seconds=30.0, gust=3.0, amplitude=0.7, seed=1501, hertz=(0.3, 0.35))[0]


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_one_frequency_tells_no_friction_without_the_lag(one_frequency):
    alone = ev.identify_flight(one_frequency)
    sets = alone.fit.sets[K]
    assert not sets.anderson_rubin.is_bounded
    assert not sets.profile.is_bounded
    quantity = alone.quantities[K]
    assert quantity.interval == quantity.widened(sets.robust.hull)
    assert quantity.interval[0] < sets.robust.hull[0]
    assert alone.verdict.status is Status.REFUSED
    (reason,) = [item for item in alone.quantities[K].reasons if item.status is Status.REFUSED]
    assert "one frequency (0.3" in reason.sentence
    assert "leave the viscous friction anywhere in [" in reason.sentence
    assert reason.remedy.endswith("--lag MS:STD or --lag LOW..HIGH.")
    assert json.loads(alone.to_json())["parameters"][K]["sets"]["anderson_rubin"][-1][1] is None
    known = ev.identify_flight(one_frequency, lag=ev.Prior(LAG_S, 0.015))
    sets = known.fit.sets[K]
    assert sets.anderson_rubin.is_bounded
    assert sets.anderson_rubin.hull[0] > 0.0
    assert sets.profile.contains(FRICTION)
    assert known.verdict.status in {Status.IDENTIFIED, Status.WEAK}


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_strong_instruments_at_a_wrong_lag_tell_nothing():
    """At the best lag, which is far too long, every F is above ten, and the interval there has two ends."""
    result = ev.identify_flight(flown(seconds=15.0, gust=1.0, seed=2, hertz=(0.32,))[0])
    assert min(result.fit.checks.first_stage.values()) >= STRONG_FIRST_STAGE
    sets = result.fit.sets[K]
    assert sets.wald.is_bounded
    assert not sets.profile.is_bounded
    assert sets.profile.contains(FRICTION)
    low, high = result.quantities[K].interval
    assert low < FRICTION < high == np.inf
    assert result.verdict.status is Status.REFUSED
    assert any("how long the lag is at most" in sentence for sentence in result.verdict.sentences)


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_weak_instruments_refuse_nothing_that_a_bounded_set_tells(two_frequencies):
    result = ev.identify_flight(two_frequencies)
    assert min(result.fit.checks.first_stage.values()) < 10.0
    sets, quantity = result.fit.sets[K], result.quantities[K]
    assert sets.wald.hull[0] < 0.0 < sets.anderson_rubin.hull[0]
    assert quantity.interval == quantity.widened(sets.robust.hull)
    (low, high), (outer_low, outer_high) = sets.robust.hull, sets.anderson_rubin.hull
    assert outer_low < low < high < outer_high  # the conditional set is the shorter one
    # the width of the set refuses, and not the first stage
    (reason,) = [item for item in quantity.reasons if item.status is Status.REFUSED]
    assert "interval of the viscous friction is ±" in reason.sentence
    assert "it needs ±100%" in reason.sentence
    assert quantity.half_width > quantity.value
    assert not any("First-stage F" in item.sentence for item in quantity.reasons)
    low, high = quantity.interval
    assert result.quantities["time_constant"].interval == (1.0 / high, 1.0 / low)
    narrow = result.interval(K, 0.9)
    assert result.interval(K) == quantity.interval
    assert low < narrow[0] < narrow[1] < high


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_methods_whose_rows_are_not_white_have_no_sets(gusty):
    result = ev.identify_flight(gusty, method="extended_iv")
    assert result.fit.sets == {}
    assert json.loads(result.to_json())["parameters"][K]["sets"] is None
    whitened = ev.identify_flight(gusty)
    problem, estimate = whitened.fit.problem, whitened.fit.estimate
    with pytest.raises(UsageError, match="viscous_friction, input_gain"):
        ProfileSets(problem, estimate).of_parameter("actuator_lag")


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.calibration
def test_sets_cover_and_tell_where_instruments_are_weak():
    logs = [
        log
        for first in range(2)
        for log in flown(10, seconds=30.0, gust=3.0, amplitude=0.7, seed=900 + first, hertz=(0.3, 0.35))
    ]
    results = [ev.identify_flight(log) for log in logs]
    weak = [result for result in results if min(result.fit.checks.first_stage.values()) < STRONG_FIRST_STAGE]
    assert len(weak) >= 10
    robust = [result.fit.sets[K].robust for result in weak]
    covered = sum(item.contains(FRICTION) for item in robust)
    assert covered >= scipy.stats.binom.ppf(1e-3, len(robust), 0.95)
    selected = [item.is_bounded and item.hull[0] > 0.0 for item in robust]
    assert np.mean(selected) >= 0.3
    assert np.mean([result.fit.sets[K].wald.hull[0] > 0.0 for result in weak]) < np.mean(selected)


LATE = SystematicUncertainty(Counts.ADDED, 0.0, 0.25, "late by up to a quarter")
BOTH = SystematicUncertainty(Counts.ADDED, 0.5, 0.5, "either way")
LEAST = SystematicUncertainty(Counts.AT_LEAST, 2.0, 2.0, "at least")
OWN = SystematicUncertainty(Counts.INDEPENDENT, 0.75, 2.4, "of its own")
TWICE = SystematicUncertainty(Counts.FACTOR, 2.0, 2.0, "twice as long")


@pytest.mark.parametrize(
    ("parts", "wanted"),
    [
        ((), (9.0, 11.0)),
        ((LATE,), (9.0, 11.25)),
        ((LATE, BOTH), (8.5, 11.75)),
        ((LEAST,), (8.0, 12.0)),
        ((LEAST, BOTH, LATE), (8.0, 12.0)),  # a least width is not added to what widens
        ((TWICE,), (8.0, 12.0)),
        ((TWICE, BOTH), (7.5, 12.5)),  # a factor comes first
        ((OWN,), (8.75, 12.6)),  # squares add up: 1, .75 and 1.25, 1, 2.4 and 2.6
        ((BOTH, OWN), (8.25, 13.1)),
    ],
)
def test_intervals_with_their_systematic_parts(parts, wanted):
    assert widened((9.0, 11.0), 10.0, parts) == wanted
    assert widened((9.0, 11.0), NAN, parts) == (9.0, 11.0)


def test_what_follows_from_a_headline_follows_it_when_it_widens():
    quantities = {
        "viscous_friction": QuantityEstimate(0.5, "1/s", 0.05, (0.4, 0.6)),
        "hover_input": QuantityEstimate(10.0, "", 0.5, (9.0, 11.0)),
        "time_constant": QuantityEstimate(2.0, "s", 0.2, (1.6, 2.6)),
    }
    same = with_systematic_uncertainties(
        Vertical(), quantities, {"viscous_friction": (), "hover_input": (LEAST,)}
    )
    assert same["time_constant"] == quantities["time_constant"]
    assert same["hover_input"].interval == (8.0, 12.0)
    part = SystematicUncertainty(Counts.ADDED, 0.15, 0.4, "more")
    wider = with_systematic_uncertainties(Vertical(), quantities, {"viscous_friction": (part,)})
    assert wider["viscous_friction"].interval == pytest.approx((0.25, 1.0))
    assert wider["time_constant"].interval == pytest.approx((1.0, 4.0))
