"""The vertical motion as the recipe and the reports see it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import eivor as ev
from coarse_search import coarse
from eivor.errors import InputError, UsageError
from eivor.flights.motion import for_flights, of_vehicle
from eivor.flights.prepare import prepare
from eivor.flights.prepared import Difference
from eivor.inference.verdict import Status
from eivor.motions.vertical.motion import Vertical, beyond, fitting_p_value, supply_findings
from eivor.motions.vertical.regression import check_terms
from eivor.motions.vertical.verdict import near_ground
from flights.flight_logs import changed, channel, flown, prepare_vertical


@pytest.fixture(scope="module")
def fit():
    with coarse():
        return ev.identify_flight(ev.example_flight(), ev.FlightOptions(window=(0.0, 20.0)))


@pytest.mark.thorough
def test_every_quantity_is_worded_and_in_the_order_of_results(fit):
    always = {name: wording for name, wording in Vertical.quantities.items() if not wording.optional}
    assert list(fit.quantities) == list(always)
    assert {name: quantity.unit for name, quantity in fit.quantities.items()} == {
        name: wording.unit for name, wording in always.items()
    }


def test_an_input_of_zero_says_nothing_of_its_variation():
    log = ev.example_flight()
    off = {
        name: replace(channel, values=np.zeros_like(channel.values))
        for name, channel in log.channels.items()
        if name.startswith("rotor_command")
    }
    idle = replace(log, channels={**log.channels, **off, "landed": replace(off["rotor_command_1"])})
    flight = prepare(idle, Vertical(), ev.FlightOptions())
    assert flight.runs
    assert Vertical().abilities.excitation((flight,)) == ""


def test_lag_and_delay_have_profile_sets_and_their_sum_is_known_best(fit):
    lag, delay, both = (fit.quantities[name] for name in ("actuator_lag", "delay", "effective_lag"))
    assert both.value == pytest.approx(lag.value + delay.value)
    assert both.half_width <= lag.half_width
    for item in (lag, delay, both):
        assert item.interval[0] <= item.value <= item.interval[1]


RADIUS = 0.2


def flight(lowest, *, on_ground=True):
    log = flown(seconds=10.0, seed=5)[0]
    height = log.channels["position_z"]
    over = height.values - height.values.min() + lowest
    before = np.full(200 if on_ground else 0, 0.0)
    time = height.time_s[0] - 0.01 * np.arange(before.size, 0, -1)
    changed = replace(
        height, time_s=np.concatenate([time, height.time_s]), values=np.concatenate([before, over])
    )
    log = replace(log, channels={**log.channels, "position_z": changed})
    return prepare(log, Vertical(), ev.FlightOptions())


@pytest.mark.usefixtures("unchecked_shapes")
def test_heights_count_in_radii():
    low, high = flight(0.4), flight(1.0)
    assert near_ground([high], RADIUS, corrected=False)[0] == 0.0
    share, lowest = near_ground([low, high], RADIUS, corrected=False)
    assert lowest == pytest.approx(2.0, abs=0.5)
    assert 0.01 < share < 0.9


@pytest.mark.usefixtures("unchecked_shapes")
def test_nothing_is_known_without_radius_or_ground_or_where_the_equation_has_it():
    low = flight(0.4)
    assert near_ground([low], None, corrected=False) is None
    assert near_ground([low], RADIUS, corrected=True) is None
    assert near_ground([flight(0.4, on_ground=False)], RADIUS, corrected=False) is None


@pytest.mark.usefixtures("unchecked_shapes")
def test_the_radius_comes_from_a_vehicle_too(tmp_path):
    file = tmp_path / "mine.toml"
    rotors = '[rotors]\nlayout = "quad-x"\nnumbering = "px4"\n'
    file.write_text(rotors + "radius = 0.15\n", encoding="utf-8")
    vertical = of_vehicle(Vertical(), str(file))
    assert vertical.rotor_radius == 0.15
    check_terms(ev.FlightOptions(terms=("ground-effect",)), vertical.rotor_radius)
    low = (flight(0.4),)
    assert for_flights(vertical, low, ev.FlightOptions()).rotor_radius == 0.15
    assert for_flights(vertical, low, ev.FlightOptions(rotor_radius=0.3)).rotor_radius == 0.3
    with pytest.raises(UsageError, match="the radius of its rotors"):
        of_vehicle(Vertical(), "quadrotor-x")
    file.write_text(rotors + "radius = 15.0\n", encoding="utf-8")
    with pytest.raises(InputError, match="rotor_radius"):
        of_vehicle(Vertical(), str(file))


HOVER, START, REACH = 0.495, 0.55, 0.2
TIME = np.arange(0.0, 30.0, 0.1)


@pytest.fixture(scope="module")
def log():
    """A flight by thrust, whose hover input is .495."""
    flight = flown(seed=2, noise=0.3)[0]
    commands = flight.channel("rotor_command_1").values
    parameters = {"MPC_THR_HOVER": START, "HTE_THR_RANGE": REACH}
    return replace(
        changed(flight, "rotor_command_1", input=commands), input_map="square", parameters=parameters
    )


def told(log, values=None, **parameters):
    log = replace(log, parameters=dict(log.parameters) | parameters)
    if values is not None:
        log = changed(log, hover_thrust_estimate=channel("hover_thrust_estimate", TIME, values))
    result = ev.identify_flight(log)
    assert isinstance(result, ev.FlightEstimate)
    assert result.quantities["hover_input"].verdict is Status.IDENTIFIED
    return {finding.name: finding.message for finding in result.findings if finding.name.startswith("hover")}


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_a_parameter_that_disagrees_is_pointed_out(log):
    assert told(log) == {}
    message = told(log, MPC_THR_HOVER=0.35)["hover_parameter"]
    assert message.startswith("The log's own MPC_THR_HOVER is 0.35, but this vehicle hovered at 0.49")


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_an_estimate_is_compared_where_it_says_something(log):
    """It leaves its start at 10 s; what is invalid, and the two seconds after, are not looked at."""
    values = np.where(TIME < 10.0, START, np.where(TIME < 12.0 - 1e-9, 0.45, 0.5))
    values[250:] = np.nan
    message = told(log, values)["hover_estimate"]
    assert "is 0.5 (median of 130 samples)" in message
    assert message.endswith("% less.")
    assert "hover_estimate" not in told(log, np.full(TIME.size, START))


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
@pytest.mark.parametrize(("value", "words"), [(0.354, "lower limit, 0.35"), (0.747, "upper limit, 0.75")])
def test_an_estimate_at_its_limit_is_not_compared(log, value, words):
    result = told(log, np.full(TIME.size, value))
    assert words in result["hover_estimate_at_limit"]
    assert "hover_estimate" not in result


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_a_hover_that_is_not_identified_or_no_thrust_is_not_compared(log):
    wrong = replace(log, parameters={"MPC_THR_HOVER": 0.3})
    biased = ev.identify_flight(wrong, ev.FlightOptions(input_map="linear", method="least_squares"))
    assert biased.quantities["hover_input"].verdict is Status.PROVISIONAL
    rotors = changed(wrong, "input", rotor_command_1=wrong.channel("input").values)
    for result in (biased, ev.identify_flight(rotors)):
        assert not [finding.name for finding in result.findings if finding.name.startswith("hover")]


@pytest.fixture(scope="module")
def prepared():
    return prepare_vertical(flown(seconds=150.0, noise=0.3)[0], ev.FlightOptions())


def told_supply(prepared, volts=None, **changes):
    log = prepared.recording
    if volts is not None:
        stamps = np.linspace(0.0, 150.0, 700)
        log = changed(log, battery_voltage=channel("battery_voltage", stamps, volts(stamps)))
    flight = replace(prepared, recording=log, **changes)
    return [(finding.name, finding.message) for finding in supply_findings((flight,))]


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
def test_a_long_flight_without_a_voltage_may_have_sagged(prepared):
    ((name, message),) = told_supply(prepared)
    assert name == "voltage_not_logged"
    assert "2.5 minutes" in message
    assert told_supply(prepared, volts=lambda t: np.full(t.size, np.nan)) == told_supply(prepared)
    assert told_supply(prepared, runs=(slice(0, 3000),)) == []


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
def test_a_fall_of_the_voltage_is_told(prepared):
    ((name, message),) = told_supply(prepared, volts=lambda t: 16.5 - 0.01 * t)
    assert name == "voltage_sag"
    assert "fell by 8.2%, from 16.4 to 15.1 V" in message
    assert told_supply(prepared, volts=lambda t: 16.5 - 0.002 * t) == []


def bend(value):
    """So many standard errors of a bend."""
    return Difference(value, 1.0)


def test_without_an_intercept_beyond_the_bound_the_map_fits():
    assert fitting_p_value(0.0, 0.3, bend(-20.0)) == 1.0


def test_the_intercept_alone_is_held_against_one_side_and_the_bend_that_is_not_there():
    index = 4.2306  # where half of chi-square with one degree and a quarter of that with two leave .05
    assert fitting_p_value(index, 1.0, None) == pytest.approx(0.05, abs=1e-4)
    assert fitting_p_value(index, 1.0, bend(5.0)) == fitting_p_value(index, 1.0, None)
    assert fitting_p_value(index, -1.0, bend(-5.0)) == fitting_p_value(index, 1.0, None)


def test_a_bend_to_the_side_of_the_intercept_counts_as_much_as_its_p_value_says():
    half = bend(-2.0)
    z = stats.norm.isf(0.5 * half.p_value)
    assert fitting_p_value(1.0, 1.0, half) == pytest.approx(fitting_p_value(1.0 + z**2, 1.0, None))
    assert fitting_p_value(1.0, -1.0, bend(2.0)) == pytest.approx(fitting_p_value(1.0, 1.0, half))
    assert fitting_p_value(1.0, 1.0, bend(-1e9)) == 0.0


def test_what_is_known_without_noise_is_held_against_the_bound_and_what_is_not_known_says_nothing():
    assert beyond(0.7, 0.1) == pytest.approx(9.0 * 3.8415, rel=1e-4)
    assert fitting_p_value(beyond(0.5, 0.0), 0.5, None) == 0.0
    assert fitting_p_value(beyond(np.nan, 0.0), np.nan, None) == 1.0


def test_at_the_edge_of_what_fits_one_map_in_twenty_is_called_wrong():
    """Both distances are normal; the bend's is that of a t with its degrees of freedom."""
    rng = np.random.default_rng(3)
    intercepts, bends = rng.standard_normal(4000), rng.standard_t(16, 4000)
    called = [
        fitting_p_value(max(b, 0.0) ** 2, 0.4 + b, bend(c)) < 0.05
        for b, c in zip(intercepts.tolist(), bends.tolist(), strict=True)
    ]
    assert np.mean(called) <= 0.055
