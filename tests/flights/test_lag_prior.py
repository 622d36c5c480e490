"""The lag as information: what it changes, what it is compared with, and when it cannot be had."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from flight_logs import FRICTION, LAG_S, changed, flown, prepare_vertical
from flight_logs import STEP_S as FLOWN_STEP_S

import eivor as ev
from eivor.errors import ParameterError, UsageError
from eivor.flights.estimate import (
    SENSORS_APART_S,
    FlightState,
    diagnose_fit,
    estimated,
    lags_from_rates,
    single_frequency_hz,
)
from eivor.flights.lag_prior import LagPrior
from eivor.flights.options import FlightOptions
from eivor.flights.quantity import QuantityEstimate, QuantitySpec
from eivor.inference.verdict import Status, Verdict
from eivor.models.separable import LaggedReferences
from eivor.motions.rates.motion import Rates
from eivor.motions.vertical.model import (
    MOT_THST_EXPO,
    THR_MDL_FAC,
    CurveFamily,
    motor_signal,
    plant_share,
    proposed,
    share_of,
    thrust_of,
)
from eivor.motions.vertical.motion import Vertical
from eivor.report.flight import checks
from eivor.signals.channels import CurveSide
from eivor.signals.recording import Recording
from eivor.signals.thrust_map import Mixed, Power
from motions.turning_logs import STEP_S, Vehicle, turned

pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


@pytest.fixture(scope="module")
def log() -> Recording:
    """A flight that hardly tells its lag."""
    return flown(seconds=15.0, gust=3.0, amplitude=0.4, seed=5)[0]


@pytest.mark.thorough
def test_the_report_says_what_the_flight_alone_says(log):
    alone = ev.identify_flight(log).quantities["effective_lag"]
    known = ev.identify_flight(log, lag=ev.Prior(LAG_S, 0.015))
    given = known.fit.lag_prior
    assert given.alone.value == alone.value
    assert given.p_value > 0.05
    sentence = dict(checks(known))["lag"]
    assert sentence.startswith("given 50 ± 15 ms (one standard deviation); the flight alone says ")
    assert "they agree" in sentence
    document = json.loads(known.to_json())
    assert document["given_lag"]["alone"] == alone.value
    assert document["provenance"]["options"]["lag"] == {"mean": LAG_S, "std": 0.015}
    assert json.loads(ev.identify_flight(log).to_json())["given_lag"] is None


@pytest.mark.thorough
def test_bounds_intersect_what_the_flight_says():
    """Finding 20a: bounds around the truth made 8 identified flights weak or refused."""
    good = flown(seconds=30.0)[0]
    alone = ev.identify_flight(good)
    around = ev.identify_flight(good, lag=ev.Bounds(LAG_S - 0.02, LAG_S + 0.02))
    assert around.verdict.status is Status.IDENTIFIED
    for name in ("viscous_friction", "input_gain", "hover_input"):
        assert around.quantities[name].interval == alone.quantities[name].interval
    middle = alone.quantities["effective_lag"].value
    cut = ev.identify_flight(good, lag=ev.Bounds(middle, middle + 0.02))
    low, high = cut.quantities["effective_lag"].interval
    assert middle - 0.005 <= low <= high <= alone.quantities["effective_lag"].interval[1] + 0.005
    width = alone.quantities["viscous_friction"].half_width
    assert cut.quantities["viscous_friction"].half_width < 2.0 * width


@pytest.mark.thorough
def test_a_given_lag_is_one_unknown_less(monkeypatch):
    """Finding 3: two instruments were too few for friction, gain and a lag that was given."""
    every = LaggedReferences.columns
    monkeypatch.setattr(LaggedReferences, "columns", lambda rule, driven: every(rule, driven)[:, :2])
    log = flown(seconds=30.0)[0]
    alone = ev.identify_flight(log)
    assert alone.fit is None
    assert "at least 3 independent instruments" in alone.verdict.sentences[0]
    flight = ev.identify_flight(log, lag=ev.Prior(LAG_S, 0.005))
    assert "the flight alone has too few instruments for a lag" in dict(checks(flight))["lag"]
    assert flight.quantities["viscous_friction"].value == pytest.approx(0.4, rel=0.2)
    low, high = flight.quantities["effective_lag"].interval
    assert LAG_S - 0.0115 <= low <= high <= LAG_S + 0.0115  # never wider than what was given


@pytest.mark.thorough
def test_neither_lag_nor_delay_is_searched():
    good = flown(seconds=15.0)[0]
    none = ev.identify_flight(good, lag=ev.Bounds(0.0, 0.0))
    assert dict(none.estimate.nuisances) == {"actuator_lag": 0.0, "delay": 0.0}
    assert none.quantities["effective_lag"].interval == (0.0, 0.0)
    assert "given neither lag nor delay" in dict(checks(none))["lag"]
    assert none.fit.lag_prior.contradicted


def test_a_delay_that_the_references_do_not_move_leaves_its_degree_to_them():
    """The delay ends at zero in some flights without one: J was too large there for its degrees."""
    estimates = [ev.identify_flight(log).fit.estimate for log in flown(4, seed=900, gust=0.5)]
    at_end = [estimate.nuisances["delay"] < 1e-4 for estimate in estimates]
    assert any(at_end)
    for estimate, ends in zip(estimates, at_end, strict=True):
        left = estimate.degrees - (estimate.rank - estimate.unknowns)
        assert left == 1.0 if ends else 0.0 <= left < 1.0


@pytest.mark.thorough
def test_a_contradiction_is_said_and_makes_the_numbers_weak():
    good = flown(seconds=15.0)[0]
    wrong = ev.identify_flight(good, lag=ev.Prior(0.15, 0.01))
    assert wrong.fit.lag_prior.contradicted
    for name in ("viscous_friction", "input_gain", "effective_lag"):
        assert wrong.quantities[name].verdict is Status.WEAK
        assert any("contradicts the flight" in reason.sentence for reason in wrong.quantities[name].reasons)
    assert not any("references disagree" in sentence for sentence in wrong.verdict.sentences)
    assert wrong.quantities["hover_input"].verdict is Status.IDENTIFIED


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("value", "error", "p_value"), [(0.07, 0.004, 1.0), (0.08, 0.0, 0.0455), (0.083, 0.012, 0.4053)]
)
def test_the_test_is_that_of_two_independent_numbers(value, error, p_value):
    alone = QuantityEstimate(value, "s", error, (value - 2.0 * error, value + 2.0 * error))
    given = LagPrior(ev.Prior(0.07, 0.005 if error < 0.01 else 0.01), alone)
    assert given.p_value == pytest.approx(p_value, abs=1e-3)


@pytest.mark.thorough
def test_a_measured_state_has_no_lag_to_know(log):
    command = log.channels["rotor_command_1"]
    measured = changed(
        log, "rotor_command_1", rotor_speed_1=replace(command, name="rotor_speed_1", held=False)
    )
    with pytest.raises(UsageError, match="whose actuators' lag is searched for"):
        ev.identify_flight(measured, lag=ev.Prior(0.05, 0.01))


@pytest.mark.parametrize("lag", [70, "70:15", (0.07, 0.015)])
def test_a_lag_of_another_type_is_refused(log, lag):
    with pytest.raises(UsageError, match=r"ev\.Prior\(0\.070, 0\.015\) or ev\.Bounds"):
        ev.identify_flight(log, lag=lag)


@pytest.mark.parametrize(
    ("make", "error", "said"),
    [
        (lambda: ev.FlightOptions(lag=ev.Prior(-0.02, 0.01)), UsageError, "a lag above zero"),
        (lambda: ev.FlightOptions(lag=ev.Bounds(50.0, 90.0)), UsageError, "between 0 and 1 s"),
        (lambda: ev.FlightOptions(lag=ev.Bounds(-0.01, 0.05)), UsageError, "between 0 and 1 s"),
        (lambda: ev.Bounds(0.09, 0.05), ParameterError, "the lower one first"),
        (lambda: ev.FlightOptions(accelerometer_bias=0.0), UsageError, "bias above zero"),
        (lambda: ev.FlightOptions(accelerometer_bias=-0.1), UsageError, "bias above zero"),
        (lambda: ev.FlightOptions(accelerometer_bias=math.nan), UsageError, "bias above zero"),
    ],
)
def test_lags_and_biases_that_are_none_are_refused(make, error, said):
    with pytest.raises(error, match=said):
        make()


ROTORS = Vehicle(lag_s=LAG_S - 2 * STEP_S)


@pytest.fixture(scope="module")
def turning() -> Recording:
    """What a flight that turns logs of that."""
    return turned(3, vehicle=ROTORS, seconds=26.0)


def told(value: float = LAG_S, half_width: float = 0.004, source: str = "other") -> LagPrior:
    interval = (value - half_width, value + half_width)
    lag = QuantityEstimate(value, "s", 0.5 * half_width, interval)
    return LagPrior.by_measurement(source, f"{source} motion", lag, SENSORS_APART_S, "delays")


def estimate(log: Recording, *lag_measurement: LagPrior, options: FlightOptions | None = None):
    chosen = options or FlightOptions()
    return estimated(
        FlightState(Vertical(), (prepare_vertical(log, chosen),), chosen, lambda: lag_measurement)
    )


@pytest.mark.thorough
def test_the_lag_by_turning_is_used_and_said(log, turning):
    log = changed(log, **turning.channels)
    alone, known = estimate(log), ev.identify_flight(log)
    for name in ("effective_lag", "viscous_friction"):
        assert known.quantities[name].half_width < alone.quantities[name].half_width
    sentence = dict(checks(known))["lag"]
    assert sentence.startswith("turning about the body axes (--model rates) says ")
    given = json.loads(known.to_json())["given_lag"]
    low, high = given["told_interval"]
    assert low < LAG_S < high
    assert given["told_by"] == "rates"
    assert given["telemetry_interval"] is None
    assert given["alone"] == alone.quantities["effective_lag"].value
    assert given["std"] == pytest.approx(np.hypot(0.25 * (high - low), SENSORS_APART_S), rel=0.05)


@pytest.mark.thorough
def test_what_a_user_knows_comes_first_and_nothing_else_is_asked(log):
    def asked() -> tuple[LagPrior, ...]:
        raise AssertionError("asked")

    for lag in (ev.Prior(LAG_S, 0.01), ev.Bounds(0.0, 0.0)):
        options = FlightOptions(lag=lag)
        flights = (prepare_vertical(log, options),)
        given = estimated(FlightState(Vertical(), flights, options, asked)).fit.lag_prior
        assert given.measured is None
        assert given.known == lag


@pytest.mark.thorough
def test_a_lag_that_contradicts_the_flight_is_told_and_not_used():
    log = flown(seconds=15.0)[0]
    alone, late = estimate(log), estimate(log, told(LAG_S + 0.1))
    assert late.fit.lag_prior is None
    assert late.quantities["viscous_friction"] == alone.quantities["viscous_friction"]
    (finding,) = [item for item in late.findings if item.name == "other_contradicts"]
    assert "is not used" in finding.message


@pytest.mark.thorough
def test_the_closest_that_agrees_serves():
    log = flown(seconds=15.0)[0]
    both = estimate(log, told(half_width=0.02, source="rough"), told(source="close"))
    assert both.fit.lag_prior.source == "close"
    wrong = estimate(log, told(half_width=0.02, source="rough"), told(LAG_S + 0.1, source="wrong"))
    assert wrong.fit.lag_prior.source == "rough"
    assert any(finding.name == "wrong_contradicts" for finding in wrong.findings)


def every(log: Recording, family: str, nth: int) -> Recording:
    slower = {
        name: replace(channel, time_s=channel.time_s[::nth], values=channel.values[::nth])
        for name, channel in log.channels.items()
        if name.startswith(family)
    }
    return changed(log, **slower)


def answering(log: Recording) -> Recording:
    names = [name for name in log.channels if name.startswith("reference_")]
    loops = {f"feedback_{name}": replace(log.channels[name], name=f"feedback_{name}") for name in names}
    return changed(log, *names, **loops)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "spoilt",
    [
        lambda log: every(log, "angular_rate", 3),
        lambda log: every(log, "torque_setpoint", 2),
        lambda log: changed(log, *(name for name in log.channels if name.startswith("torque_setpoint"))),
        answering,
    ],
)
def test_turning_that_cannot_tell_is_not_estimated(turning, spoilt, monkeypatch):
    unmade(monkeypatch)
    assert lags_from_rates((Rates(),), spoilt(turning), None, {}) == ()
    with pytest.raises(AssertionError, match="estimated"):
        lags_from_rates((Rates(),), turning, None, {})


@pytest.mark.thorough
def test_turning_that_hardly_moves_the_lag_is_not_estimated_closely(monkeypatch):
    unmade(monkeypatch)
    assert lags_from_rates((Rates(),), turned(4, vehicle=ROTORS, seconds=26.0, size=0.02), None, {}) == ()


def unmade(monkeypatch: pytest.MonkeyPatch) -> None:
    def not_to_be_made(*_: object, **__: object) -> None:
        raise AssertionError("estimated")

    monkeypatch.setattr("eivor.flights.estimate.STAGES", (not_to_be_made, diagnose_fit))


@pytest.mark.thorough
def test_turning_that_is_not_trusted_says_nothing(turning):
    assert lags_from_rates((Rates(),), turning, (5.0, 18.0), {}) == ()  # too short to be identified


# The thrust curve that is found out: its value, what it rests on, and what it does to everything else.


@pytest.fixture(scope="module")
def square_log():
    """A flight whose thrust goes with the square of its command."""
    return flown(seconds=20.0)[0]


def commanded(log, true, *, thrust, side=CurveSide.BEFORE):
    """The same flight, its commands such that thrust goes with another map of them."""
    command = log.channels["rotor_command_1"]
    values = np.array([true.inverse(item) for item in command.values**2])
    name = "input" if thrust else "rotor_command_1"
    reported = replace(command, name=name, values=values, curve_side=side)
    return replace(changed(log, "rotor_command_1", **{name: reported}), input_map="")


@pytest.mark.parametrize(
    ("true", "thrust", "value"),
    [
        pytest.param(Power(1.5), False, 1.5, marks=pytest.mark.thorough),
        (Mixed(0.5), True, 0.5),
        pytest.param(Mixed(0.0), True, 0.0, marks=pytest.mark.thorough),
    ],
)
def test_the_curve_is_found_out(square_log, true, thrust, value):
    identify_flight = ev.identify_flight(commanded(square_log, true, thrust=thrust), input_map="fit")
    curve = identify_flight.quantities["thrust_curve"]
    low, high = curve.interval
    assert low < value < high
    assert curve.half_width < 0.3
    assert curve.value == pytest.approx(value, abs=0.05)
    friction = identify_flight.quantities["viscous_friction"]
    assert friction.value == pytest.approx(FRICTION, abs=1.5 * friction.half_width)
    # the map's own error is part of the gain's interval, and the bias of the intercept's
    conditional = identify_flight.estimate.interval("input_gain")
    assert identify_flight.quantities["input_gain"].interval != pytest.approx(conditional, rel=1e-3)
    assert identify_flight.quantities["intercept"].half_width >= 1.9 * 0.1
    # no share is below zero: there an intercept is left that is none within its error
    left = identify_flight.quantities["intercept"]
    assert abs(left.value) < (0.03 if curve.value > 0.0 else 0.5 * left.half_width)


@pytest.mark.thorough
def test_what_was_found_is_told_and_can_be_typed(square_log):
    flight = replace(commanded(square_log, Mixed(0.5), thrust=True), parameters={"THR_MDL_FAC": 0.0})
    identify_flight = ev.identify_flight(flight, input_map="fit")
    document = json.loads(identify_flight.to_json())
    name = document["model"]["input_map"]
    assert name.startswith("mixed:0.")
    assert document["parameters"]["thrust_curve"]["value"] == pytest.approx(
        float(name.split(":")[1]), abs=1e-3
    )
    assert document["provenance"]["options"]["accelerometer_bias"] == 0.1
    (messages,) = [finding.message for finding in identify_flight.findings if finding.name == "thrust_curve"]
    assert "THR_MDL_FAC (PX4) would be set to 0." in messages
    assert "The log has THR_MDL_FAC 0." in messages
    typed = ev.identify_flight(flight, input_map=name)
    assert typed.parameters["input_gain"] == pytest.approx(identify_flight.parameters["input_gain"], rel=1e-3)
    assert "thrust_curve" not in typed.quantities
    assert "thrust_curve" not in json.loads(typed.to_json())["parameters"]


@pytest.mark.thorough
def test_curvature_alone_is_refused_when_it_cannot_tell(square_log):
    identify_flight = ev.identify_flight(
        commanded(square_log, Power(1.5), thrust=False), input_map="fit", accelerometer_bias=math.inf
    )
    curve = identify_flight.quantities["thrust_curve"]
    assert curve.verdict is Status.REFUSED
    assert any("Curvature alone" in reason.sentence for reason in curve.reasons)


@pytest.mark.parametrize(("share", "hover"), [(0.3, 0.4), (0.7, 0.6), (-0.2, 0.5)])
def test_the_share_of_a_signal_behind_the_curve_is_the_parameter(share, hover):
    assert plant_share(CurveFamily(True), share, hover, None) == share
    assert plant_share(CurveFamily(True), share, hover, 0.0) == pytest.approx(share)
    exponent = CurveFamily(True).exponent(share, hover)
    assert plant_share(CurveFamily(False), exponent, hover, None) == pytest.approx(share)


@pytest.mark.parametrize("in_force", [-0.4, 0.0, 0.3, 1.0])
@pytest.mark.parametrize("true", [-0.3, 0.0, 0.65, 1.0])
def test_before_the_curve_both_curves_together_are_the_vehicle_s(in_force, true):
    """Commands went through the inverse of one curve, and thrust is another of the signal."""
    signal, step = 0.45, 1e-6

    def setpoint(nuisances):
        return thrust_of(in_force, nuisances)

    hover = setpoint(signal)
    assert motor_signal(hover, in_force) == pytest.approx(signal)
    ends = [
        (math.log(thrust_of(true, item)), math.log(setpoint(item))) for item in (signal - step, signal + step)
    ]
    seen = (ends[1][0] - ends[0][0]) / (ends[1][1] - ends[0][1])
    assert plant_share(CurveFamily(False), seen, hover, in_force) == pytest.approx(true, abs=1e-6)
    of_commands = share_of(seen, hover)
    if math.isfinite(of_commands):
        assert plant_share(CurveFamily(True), of_commands, hover, in_force) == pytest.approx(true, abs=1e-6)
    # thrust that is proportional to the setpoint leaves the curve as it is
    assert plant_share(CurveFamily(True), 0.0, hover, in_force) == pytest.approx(in_force)


@pytest.mark.parametrize("in_force", [None, 0.3])
def test_intervals_hold_every_pair_and_are_cut_to_the_range(in_force):
    curve, hover = (0.6, (0.5, 0.7)), (0.4, (0.38, 0.42))
    share, thrust = proposed(THR_MDL_FAC, CurveFamily(True), curve, hover, in_force)
    for value in np.linspace(0.5, 0.7, 9):
        for command in np.linspace(0.38, 0.42, 9):
            item = plant_share(CurveFamily(True), value, command, in_force)
            assert share[1][0] - 1e-12 <= item <= share[1][1] + 1e-12
            reported = thrust_of(item, motor_signal(command, in_force))
            assert thrust[1][0] - 1e-12 <= reported <= thrust[1][1] + 1e-12
    wide = (0.6, (-math.inf, math.inf))
    assert proposed(THR_MDL_FAC, CurveFamily(True), wide, hover, in_force)[0][1] == (0.0, 1.0)
    exponents = (1.4, (0.2, 40.0))
    at_rest = (0.4, (-0.1, 1.2))
    share, _ = proposed(MOT_THST_EXPO, CurveFamily(False), exponents, at_rest, in_force)
    assert share[1] == (-1.0, 1.0)


@pytest.mark.parametrize(
    ("side", "parameters", "said"),
    [
        (
            CurveSide.BEHIND,
            {},
            r"THR_MDL_FAC \(PX4\) would be set to 0\.5.* MOT_THST_EXPO \(ArduPilot\) would be",
        ),
        pytest.param(
            CurveSide.BEFORE, {}, "no value of it that is in force is known", marks=pytest.mark.thorough
        ),
        (CurveSide.UNKNOWN, {"THR_MDL_FAC": 0.0}, "does not say whether input is before or behind"),
    ],
)
def test_what_the_report_says_without_a_value_in_force(square_log, side, parameters, said):
    flight = commanded(square_log, Mixed(0.5), thrust=True, side=side)
    identify_flight = ev.identify_flight(replace(flight, parameters=parameters), input_map="fit")
    (messages,) = [finding.message for finding in identify_flight.findings if finding.name == "thrust_curve"]
    assert re.search(said, messages)
    document = json.loads(identify_flight.to_json())["model"]["autopilot_curve"]
    assert document == {"side": side.value or None, "in_force": parameters, "logged": parameters}


@pytest.mark.thorough
def test_a_reference_of_one_frequency_is_told():
    seconds = FLOWN_STEP_S * np.arange(2000)
    sine, steps = np.sin(2.0 * np.pi * 0.3 * seconds), np.sign(np.sin(2.0 * np.pi * 0.3 * seconds))
    log = flown(seconds=20.0)[0]

    def frequency(**references):
        flight = prepare_vertical(changed(log, **references), ev.FlightOptions())
        return single_frequency_hz((flight,), tuple(references))

    assert frequency(reference_position_z=sine, reference_velocity_z=np.gradient(sine)) == pytest.approx(
        0.3, abs=0.03
    )
    assert frequency(reference_position_z=steps) == 0.0
    assert frequency(reference_position_z=sine, reference_velocity_z=steps) == 0.0
    assert frequency(reference_position_z=sine + 0.3 * np.sin(2.0 * np.pi * 0.8 * seconds)) == 0.0
    assert frequency() == 0.0


LAG = QuantitySpec("lag", "τ", "s", lowest=0.0)
INFINITY = float("inf")


@pytest.mark.parametrize(
    ("interval", "possible"),
    [
        ((-1.0, 2.0), (0.0, 2.0)),
        ((0.5, 2.0), (0.5, 2.0)),
        ((-1.0, 0.0), (0.0, 0.0)),
        # Nothing possible is left, or nothing was said: cutting would say more than the data do.
        ((-2.0, -1.0), (-2.0, -1.0)),
        ((-INFINITY, INFINITY), (-INFINITY, INFINITY)),
    ],
)
def test_intervals_end_where_the_quantity_does(interval, possible):
    quantity = QuantityEstimate(1.0, "s", 0.5, interval).judged(Verdict(ev.Status.WEAK), LAG)
    assert quantity.interval == possible
    assert quantity.verdict is ev.Status.WEAK
    anything = QuantityEstimate(1.0, "s", 0.5, interval).judged(
        Verdict(ev.Status.WEAK), replace(LAG, lowest=-INFINITY)
    )
    assert anything.interval == interval
