"""Every rule and every systematic part of the vertical motion's tables, each reached alone."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import eivor as ev
from coarse_search import coarse
from eivor.estimation.methods import identify, reference_iv
from eivor.estimation.profile_sets import ProfileSets
from eivor.flights.lag_prior import LagPrior
from eivor.flights.motion import for_flights, of_vehicle
from eivor.flights.prepare import prepare
from eivor.flights.prepared import Difference, SensorAgreement
from eivor.flights.quantity import QuantityEstimate
from eivor.flights.verdict import Instruments, VerdictInputs, reasons_by_quantity, systematic_uncertainties
from eivor.inference.diagnostics.excitation import Periodicity, Swing
from eivor.inference.diagnostics.instruments import OverIdentification
from eivor.inference.verdict import Status, verdict
from eivor.models.separable import LaggedInputs, LaggedReferences, NoInstruments
from eivor.motions.vertical.misspecification import OmittedTerms
from eivor.motions.vertical.motion import Vertical, beyond, fitting_p_value, supply_findings
from eivor.motions.vertical.regression import ThrustDrift, check_terms, mean_command
from eivor.motions.vertical.select import QUANTITIES
from eivor.motions.vertical.verdict import PARTS, RULES, VerticalChecks, near_ground
from eivor.report.flight import log_documents
from eivor.signals.recording import GRAVITY
from flights.flight_logs import changed, channel, flown, prepare_vertical

FRICTION, GAIN, HOVER, LAG = "viscous_friction", "input_gain", "hover_input", "effective_lag"
NAMES = (FRICTION, GAIN, "actuator_lag")
PLANNED = LaggedReferences(("reference_position_z",))
WEAK, REFUSED, PROVISIONAL = Status.WEAK, Status.REFUSED, Status.PROVISIONAL


def quantity(value, half_width):
    return QuantityEstimate(value, "", 0.5 * half_width, (value - half_width, value + half_width))


def strength(F=(50.0, 50.0, 50.0), p_value=0.5, lag_s=0.05, names=NAMES, **sets):
    searched = {"actuator_lag": (lag_s, 0.3)} if "actuator_lag" in names else {}
    agreement = OverIdentification(18.0, 2, p_value)
    known = {name: ev.ConfidenceSet(pieces) for name, pieces in sets.items()}
    first_stage = dict(zip(names, F, strict=True))
    return {"first_stage": first_stage, "agreement": agreement, "searched": searched, "robust": known}


GOOD = {
    FRICTION: quantity(0.4, 0.1),
    GAIN: quantity(40.0, 1.0),
    "actuator_lag": quantity(0.05, 0.005),
    LAG: quantity(0.05, 0.005),
    HOVER: quantity(0.5, 0.005),
    "intercept": quantity(0.0, 0.1),
    "delay": QuantityEstimate(0.0, "s", 0.002, (0.0, 0.004)),
}


def inputs(found=(), flights=(), **changed):
    good = {"checks": VerticalChecks(apparent_gravity=GRAVITY), **strength(), "used_s": 300.0}
    good |= {"command_rate_hz": 100.0, "response_rate_hz": 100.0, "instruments": Instruments(PLANNED)}
    return VerdictInputs(flights, **good | changed, quantities=GOOD | dict(found))


def judged(name, found=(), **changed):
    return verdict(list(reasons_by_quantity(RULES, inputs(found, **changed), QUANTITIES)[name]))


def test_a_good_flight_has_no_reason_against_it():
    reasons = reasons_by_quantity(RULES, inputs(), QUANTITIES)
    assert not any(reasons.values())


UNKNOWN = QuantityEstimate(0.4, "1/s", 0.1, (-np.inf, np.inf))
TURNED = {"turned": ("velocity", "The velocity goes down.")}
STILL = {"scale": Difference(-2.05, 0.05)}
UNIT = {"scale": Difference(2.0 * 99.0 / 101.0, 1e-3)}
AGREE = OverIdentification(0.0, 1, 0.5)
CONTRADICTED = LagPrior(ev.Prior(0.05, 0.001), quantity(0.09, 0.002))
CONSTANT = {"instruments": Instruments(NoInstruments(), missing="a: constant", constant=True)}
DIRECT = {"instruments": Instruments(NoInstruments())}
MISSING = {"instruments": Instruments(NoInstruments(), missing="none")}
COMPUTED = {"instruments": Instruments(PLANNED, exogenous=False)}
PAST = {"instruments": Instruments(LaggedInputs(1), exogenous=False, past_inputs=True)}
ONE_TONE = {**strength((50.0, 50.0, 2.0)), "single_frequency_hz": 0.318}
ABOVE = replace(UNKNOWN, interval=(0.2, np.inf))
LEFT_OPEN = r"how long the lag is at most. They leave the viscous friction anywhere above 0\.2\.$"
CASES = [
    # contradictions
    (FRICTION, {FRICTION: quantity(-0.2, 0.1)}, {}, REFUSED, r"came out at -0.2 1/s, which no vehicle has"),
    (FRICTION, {GAIN: quantity(-40.0, 1.0)}, {}, REFUSED, "input gain is not positive"),
    (FRICTION, {"intercept": quantity(-9.5, 0.5)}, {}, WEAK, r"intercept is -9\.5 m/s\^2"),
    (FRICTION, {}, strength(p_value=9e-7), WEAK, r"references disagree .* \(J p-value 9e-07\)"),
    (FRICTION, {}, {"lag_prior": CONTRADICTED}, WEAK, "lag that was given contradicts the flight"),
    (LAG, {}, strength(lag_s=0.2999), WEAK, "ran into the top of its grid"),
    (HOVER, {HOVER: quantity(0.0, 0.0)}, {}, REFUSED, "not positive"),
    (HOVER, {HOVER: quantity(math.nan, 0.1)}, {}, REFUSED, "not positive"),
    (GAIN, {}, {"checks": VerticalChecks(near_ground=(0.2, 1.5))}, WEAK, "below 4 rotor radii"),
    (HOVER, {}, {"checks": VerticalChecks(near_ground=(0.2, 1.5))}, WEAK, "below 4 rotor radii"),
    ("thrust_curve", {"thrust_curve": UNKNOWN}, {}, REFUSED, "no interval with two ends"),
    (GAIN, {}, {"checks": VerticalChecks(apparent_gravity=1.0)}, REFUSED, "its values look like g"),
    (LAG, {}, {"checks": VerticalChecks(apparent_gravity=998.0)}, REFUSED, "look like milli-g"),
    (GAIN, {}, {"checks": VerticalChecks(apparent_gravity=-9.8)}, REFUSED, "-9.8 m/s.2, where 9.81"),
    (GAIN, {}, {"checks": VerticalChecks(**TURNED)}, REFUSED, "The velocity goes down"),
    (GAIN, {}, {"sensors": SensorAgreement(STILL, AGREE)}, REFUSED, "does not follow the accelerometer"),
    (GAIN, {}, {"sensors": SensorAgreement(UNIT, AGREE)}, REFUSED, "reads 100 times what"),
    # instruments
    (FRICTION, {}, CONSTANT, REFUSED, r"never moved \(a: constant"),
    (FRICTION, {}, MISSING, PROVISIONAL, "No reference can serve"),
    (GAIN, {}, DIRECT, PROVISIONAL, "direct method is biased"),
    (FRICTION, {}, COMPUTED, WEAK, "answer the vehicle's own disturbances"),
    (LAG, {}, PAST, PROVISIONAL, "Past inputs"),
    (FRICTION, {}, strength((9.9, 50.0, 50.0)), REFUSED, "about the viscous friction: first-st"),
    (FRICTION, {}, strength((50.0, np.nan, 50.0)), REFUSED, "about the input gain"),
    (FRICTION, {}, ONE_TONE, REFUSED, r"one frequency \(0.32 Hz\), which identifies two of 3 numbers"),
    (FRICTION, {FRICTION: ABOVE}, strength(viscous_friction=(ABOVE.interval,)), REFUSED, LEFT_OPEN),
    # widths
    (FRICTION, {FRICTION: quantity(0.0, 0.1)}, {}, REFUSED, "cannot be distinguished from zero"),
    (FRICTION, {FRICTION: quantity(-0.2, 0.3)}, {}, REFUSED, r"zero: its interval is \[-0.5, 0.1\] 1/s"),
    (FRICTION, {FRICTION: quantity(0.4, 0.201)}, {}, WEAK, r"±50\.2% wide; identified needs ±50%"),
    (GAIN, {GAIN: quantity(300.0, 1500.0)}, {}, REFUSED, r"zero: its interval is \[-1200, 1800\] m/s\^2"),
    (GAIN, {GAIN: quantity(40.0, 4.12)}, {}, WEAK, r"±10\.3% wide"),
    (GAIN, {GAIN: quantity(40.0, 10.2)}, {}, REFUSED, r"±25\.5% wide; it needs ±25%"),
    (LAG, {LAG: quantity(0.05, 0.021)}, {}, WEAK, "±21 ms wide; identified needs ±20 ms"),
    (LAG, {LAG: quantity(0.2, 0.051)}, {}, WEAK, "±25.5% wide"),
    (LAG, {LAG: quantity(0.05, 0.026)}, {}, REFUSED, "±52% wide; it needs ±50%"),
    (LAG, {LAG: replace(UNKNOWN, interval=(0.0, np.inf))}, {}, REFUSED, "no interval with two ends"),
    (HOVER, {HOVER: quantity(0.5, 0.013)}, {}, WEAK, "±2.6% wide"),
    (HOVER, {HOVER: quantity(0.5, 0.026)}, {}, REFUSED, "±5.2% wide"),
    (HOVER, {HOVER: quantity(0.5, math.nan)}, {}, REFUSED, "wide"),
    ("thrust_curve", {"thrust_curve": quantity(0.3, 0.2)}, {}, WEAK, "±0.2"),
    ("thrust_curve", {"thrust_curve": quantity(0.3, 0.6)}, {}, REFUSED, "±0.6"),
    (
        "thrust_curve",
        {"thrust_curve": quantity(0.3, 0.1), "intercept": quantity(1.0, 0.2)},
        {},
        REFUSED,
        "No th",
    ),
]


@pytest.mark.parametrize(("name", "found", "changed", "status", "said"), CASES)
def test_each_rule(name, found, changed, status, said):
    checks = changed.get("checks")
    if checks is not None and math.isnan(checks.apparent_gravity):
        changed = {**changed, "checks": replace(checks, apparent_gravity=GRAVITY)}
    result = judged(name, found, **changed)
    assert result.status is status
    assert re.search(said, " ".join(reason.sentence for reason in result.reasons))
    assert all(reason.remedy.endswith(".") or ")" in reason.remedy for reason in result.reasons)


@pytest.mark.parametrize(
    ("name", "found", "changed"),
    [
        (FRICTION, {FRICTION: quantity(0.5, 0.25)}, {}),
        (GAIN, {GAIN: quantity(40.0, 4.0)}, {}),
        (LAG, {LAG: quantity(0.03, 0.0199)}, {}),
        (HOVER, {HOVER: quantity(0.4, 0.0099)}, {}),
        (HOVER, {}, {**DIRECT, "checks": VerticalChecks(apparent_gravity=GRAVITY, **TURNED)}),
        (FRICTION, {}, strength((10.0, 10.0, 10.0))),
        (FRICTION, {}, strength(p_value=1e-6)),
        (LAG, {}, strength(names=NAMES[:2], F=(50.0, 50.0), lag_s=0.3)),
        # what no verdict is withheld for
        (FRICTION, {}, {"command_rate_hz": 10.0}),
        (FRICTION, {}, {"used_s": 12.0}),
        (FRICTION, {}, strength((50.0, 50.0, 3.0), viscous_friction=((0.3, 0.5),))),
        (GAIN, {}, strength((50.0, 2.0, 50.0), input_gain=((39.0, 41.0),))),
        (LAG, {}, strength((50.0, 50.0, 2.0), effective_lag=((0.04, 0.06),))),
        (FRICTION, {}, {"sensors": SensorAgreement({"tilt_x": Difference(0.04, 1e-3)}, AGREE)}),
        (FRICTION, {}, {"sensors": SensorAgreement({"scale": Difference(-0.815, 1e-3)}, AGREE)}),
    ],
)
def test_bounds_themselves_are_accepted_and_what_widens_is_no_veto(name, found, changed):
    assert judged(name, found, **changed).status is Status.IDENTIFIED


def test_the_controllers_rate_is_asked_for_where_references_disagree():
    lacking = judged(FRICTION, **strength(p_value=9e-7), **logged_at(50.0)).reasons[0]
    assert "the log may lack commands, or something" in lacking.sentence
    assert lacking.remedy.startswith("Give --controller-rate")


def test_the_lag_is_asked_for_where_it_would_help():
    weak, given = (50.0, 50.0, 3.0), LagPrior(ev.Prior(0.05, 0.01), quantity(0.05, 0.1))
    cases = strength(weak), {**strength(weak), "lag_prior": given}, strength(weak[1:], names=NAMES[:2])
    texts = ["--lag MS:STD" in judged(FRICTION, **changed).reasons[0].remedy for changed in cases]
    assert texts == [True, False, False]


def test_a_delay_that_is_not_separated_from_the_lag_is_weak():
    some, every = (QuantityEstimate(0.0, "s", high / 4.0, (0.0, high)) for high in (0.01, 0.04))
    for delay, wanted in ((some, Status.IDENTIFIED), (every, Status.WEAK)):
        assert judged("delay", {"delay": delay}).status is wanted
        assert judged("actuator_lag", {"delay": delay}).status is Status.IDENTIFIED


def test_a_delay_of_measured_rotors_at_the_end_of_its_grid_is_weak():
    for value, status in ((0.06, WEAK), (-0.06, WEAK), (0.05, Status.IDENTIFIED)):
        assert judged(FRICTION, searched={"delay": (value, 0.06)}).status is status


def parts(name, found=(), **changed):
    known = systematic_uncertainties(PARTS, inputs(found, **changed))
    return [(item.counts.value, item.below, item.above, item.sentence) for item in known.get(name, ())]


def logged_at(rate_hz):
    """A command at even stamps, whose controller's rate is not known."""
    flight = prepare_vertical(flown(1, seconds=10.0)[0], ev.FlightOptions())
    unknown = replace(flight, command_slack_s=0.25 / rate_hz, unlogged_step_s=0.5 / rate_hz)
    return {"flights": (unknown,), "command_rate_hz": rate_hz}


def with_two_clocks():
    """A flight whose commands are stamped otherwise than what is measured."""
    (log,) = flown(1, seconds=10.0)
    command = log.channels["rotor_command_1"]
    later = replace(command, time_s=command.time_s + 0.001)
    return {"flights": (prepare_vertical(changed(log, rotor_command_1=later), ev.FlightOptions()),)}


SENSITIVE = {
    "tilt_x": {FRICTION: 10.0, GAIN: -200.0, "actuator_lag": 0.5},
    "offset": {FRICTION: -4.0, GAIN: 50.0},
    "late velocity": {FRICTION: -3.0, GAIN: 20.0},
    "late accelerometer": {FRICTION: 2.0, GAIN: 10.0},
}
TILTED = SensorAgreement({"tilt_x": Difference(0.02, 1e-3)}, AGREE)
LATE = SensorAgreement({"offset": Difference(0.01, 1e-3)}, AGREE)
EARLY = SensorAgreement({"offset": Difference(-0.01, 1e-3)}, AGREE)
SCALED = SensorAgreement({"scale": Difference(-0.02, 1e-3)}, AGREE)
SUPPLY = OmittedTerms({"supply": Difference(-0.04, 0.01)})
BENDING, GROUNDED = (
    OmittedTerms({term: Difference(0.3, 0.01)}, changes={term: {LAG: -0.01, GAIN: 0.5}})
    for term in ("thrust_curvature", "ground_effect")
)
DRIFTING = OmittedTerms({"clock_drift": Difference(2e-4, 2e-5)}, clock_reach_s=30.0)
SWINGING = Periodicity((), (Swing("vertical acceleration", "m/s²", 5.0, 0.2, 1e-4),), "s", 0.01)
APART = SensorAgreement({}, OverIdentification(8.0, 2, 0.001))


def drift(change):
    return ThrustDrift(change, 0.001, 30.0, 2.0)


@pytest.mark.parametrize(
    ("name", "changed", "kind", "sizes", "said"),
    [
        (FRICTION, {"used_s": 15.0}, "factor", 1.6**0.5, "15 s are few"),
        (FRICTION, strength(p_value=0.009), "factor", 3.0, "references disagree"),
        (GAIN, strength(p_value=0.02), "factor", (18.0 / 5.9915) ** 0.5, "disagree"),
        (
            FRICTION,
            strength(p_value=0.009) | {"prior_share": {FRICTION: 0.5}},
            "factor",
            5.0**0.5,
            "3.00 times",
        ),
        (FRICTION, {"sensors": APART}, "factor", 2.0, "in another way"),
        (FRICTION, {"sensors": TILTED}, "added", 0.5, "differ by 1.1"),
        (LAG, {"sensors": TILTED}, "added", 0.025, "differ by 1.1"),
        (FRICTION, {"sensors": LATE}, "added", (0.03, 0.0), "10.0 ± 2.1 ms behind"),
        (FRICTION, {"sensors": EARLY}, "added", (0.0, 0.03), "10.0 ± 2.1 ms behind"),
        (GAIN, {"sensors": LATE}, "added", (0.1, 0.2), "10.0 ± 2.1 ms behind"),
        (LAG, {"sensors": LATE}, "added", (0.01, 0.0), "10.0 ± 2.1 ms behind"),
        (FRICTION, {"sensors": SCALED}, "added", (0.008, 0.0), "reads 2.0%"),
        (GAIN, {"sensors": SCALED}, "added", 0.8, "reads 2.0%"),
        (LAG, logged_at(50.0), "added", 0.01, "logged at 50 Hz"),
        (GAIN, logged_at(25.0), "added", 1.0, "edges are not known"),
        (GAIN, logged_at(100.0), "added", 0.125, "edges are not known"),
        (LAG, {"checks": {"omitted": DRIFTING}}, "added", 0.006, "apart by 200 ± 42 ppm: up to 6 ms"),
        (
            LAG,
            with_two_clocks() | {"checks": {"omitted": DRIFTING}},
            "independent",
            1.272e-3,
            "several clocks",
        ),
        (GAIN, {"checks": {"omitted": DRIFTING}}, "added", 0.3, "drift apart"),
        (LAG, {"checks": {"omitted": BENDING}}, "added", (0.01, 0.0), "Thrust bends more"),
        (GAIN, {"checks": {"omitted": GROUNDED}}, "added", (0.0, 0.5), "Thrust grows towards the ground"),
        (GAIN, {"checks": {"sideways_speed": 6.0}}, "added", 1.28, "sideways at 6.0 m/s"),
        (GAIN, {"checks": {"omitted": SUPPLY}}, "added", 0.8, "fell by 4.0%"),
        (GAIN, {"checks": {"omitted": SUPPLY, "drift": drift(-0.01)}}, "added", 0.673, "fell by 4.0%"),
        (HOVER, {"checks": {"omitted": SUPPLY}}, "added", 0.005, "fell by 4.0%"),
        (HOVER, {"checks": {"drift": drift(-0.02)}}, "independent", 0.003823, "fell by"),
        (HOVER, {"checks": {"omitted": SUPPLY, "drift": drift(0.0)}}, "at least", 0.01, ""),
        (HOVER, {"checks": {"mean_command": 0.97}}, "added", (0.015, 0.0), "at hover is 3.0% from"),
        (HOVER, {}, "at least", 0.01, "±2.0% wide"),
        (FRICTION, {"periodicity": SWINGING}, "added", 0.2 / 2**0.5 / 2.0, "period of 5 s"),
    ],
)
def test_each_systematic_part(name, changed, kind, sizes, said):
    """Of one size to both sides, or of two."""
    own = {"sensitivities": SENSITIVE, "velocity": (np.array([0.2]), np.array([4.0]))}
    checks = VerticalChecks(apparent_gravity=GRAVITY, **own | changed.get("checks", {}))
    found = [item for item in parts(name, **{**changed, "checks": checks}) if said in item[3]]
    below, above = sizes if isinstance(sizes, tuple) else (sizes, sizes)
    assert [(item[0], *item[1:3]) for item in found] == [
        (kind, pytest.approx(below, rel=2e-3), pytest.approx(above, rel=2e-3))
    ]


def test_channels_in_some_rows_of_a_table_have_one_clock():
    (log,) = flown(1, seconds=10.0)
    sensors = (log.channels[name] for name in ("velocity_z", "specific_force_z"))
    sparse = {x.name: replace(x, time_s=x.time_s[::5], values=x.values[::5]) for x in sensors}
    flights = (prepare_vertical(changed(log, **sparse), ev.FlightOptions()),)
    checks = VerticalChecks(sensitivities=SENSITIVE, omitted=DRIFTING)
    assert not any("several clocks" in item[3] for item in parts(LAG, flights=flights, checks=checks))


def test_the_mean_command_of_uneven_rotors_is_measured():
    log = changed(flown(1, seconds=10.0)[0])
    first = log.channels["rotor_command_1"]
    each = {
        f"rotor_command_{n}": replace(first, name=f"rotor_command_{n}", values=share * first.values)
        for n, share in enumerate((1.25, 0.75), 1)
    }
    flight = prepare_vertical(changed(log, **each), ev.FlightOptions())
    assert mean_command(flight) == pytest.approx((1.0 + 0.25**2) ** -0.5, rel=1e-6)


def at_least(intercept, **changed):
    """What the gain reaches to at least with an intercept."""
    found = parts(GAIN, {"intercept": quantity(intercept, 0.1)}, **changed)
    return [item for item in found if item[0] == "at least"]


BENT = {"map_exponent": 2.0, "thrust_exponent": 1.6, "input_spread": 0.3}


@pytest.mark.parametrize(
    ("intercept", "checks", "below", "above"),
    [
        (0.0, {}, None, None),
        # 40 g / (g - 1) - 40, and of the secant 1 % and .1 / g together
        (1.0, {}, 0.0, 4.542 + 44.542 * math.hypot(0.01, 0.1 / GRAVITY)),
        (-1.0, {}, 3.701 + 36.299 * math.hypot(0.01, 0.1 / GRAVITY), 0.0),
        (1.0, BENT, 0.0, 4.542 + 44.542 * math.hypot(2.0 * 0.01 + 0.4 * 0.09 / 4.0, 0.1 / GRAVITY)),
    ],
)
def test_the_gain_reaches_to_the_weight_over_the_hover_input(intercept, checks, below, above):
    made = {"checks": VerticalChecks(apparent_gravity=GRAVITY, **checks)} if checks else {}
    found = at_least(intercept, **made)
    assert [item[1:3] for item in found] == (
        [] if below is None else [pytest.approx((below, above), abs=1e-3)]
    )


@pytest.mark.parametrize(
    ("exponent", "of_map", "thrust", "remedy"),
    [
        (1.99, 1.5, False, "--input-map square "),
        (1.0, 2.0, False, "--input-map linear "),
        (1.6, 2.0, False, "--input-map power:1.6 "),
        # (1 - s) u + s u^2 at u = .5 with s = .6: exponent (.4 + .6) / (.4 + .3)
        (1.0 / 0.7, 1.0, True, "--input-map mixed:0.6 "),
        (0.8, 1.0, True, "sags under load"),
    ],
)
def test_a_map_that_does_not_fit_is_named_with_the_secant(exponent, of_map, thrust, remedy):
    checks = VerticalChecks(0.01, exponent, of_map, thrust_command=thrust, apparent_gravity=GRAVITY)
    intercept = GRAVITY * (1.0 - exponent / of_map)
    ((*_, said),) = at_least(intercept, checks=checks)
    assert f"to the power {exponent:.2f}, and the map says {of_map:.2f}" in said
    assert remedy in said
    ((*_, fitting),) = at_least(intercept, checks=replace(checks, map_p_value=0.051))
    assert "to the power" not in fitting


@pytest.mark.parametrize(
    ("bend", "std_error", "said"),
    [
        (-0.12, 0.01, "more than such a power does (-0.046): so does thrust that sags under load."),
        (-0.12, 0.045, "The curve bends as well (-0.12 ± 0.095)."),
        (-0.12, 0.08, "and the map says 2.00."),
        (0.12, 0.01, "and the map says 2.00."),
    ],
)
def test_what_the_bend_of_the_thrust_curve_says_beside_the_intercept(bend, std_error, said):
    omitted = OmittedTerms({"thrust_curvature": Difference(bend, std_error)})
    checks = VerticalChecks(0.01, 1.8, 2.0, apparent_gravity=GRAVITY, omitted=omitted)
    found = parts(GAIN, {"intercept": quantity(0.9, 0.2)}, checks=checks)
    assert any(f"{said} Use --input-map" in item[3] for item in found)


# The vertical motion as the recipe and the reports see it.


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
    off = {item.name: replace(item, values=0.0 * item.values) for item in log.family("rotor_command")}
    idle = replace(log, channels={**log.channels, **off, "landed": replace(off["rotor_command_1"])})
    flight = prepare(idle, Vertical(), ev.FlightOptions())
    assert flight.runs
    assert Vertical().abilities.excitation((flight,)) == ""


def test_lag_and_delay_have_profile_sets_and_their_sum_is_known_best(fit):
    lag, delay, both = (fit.quantities[name] for name in ("actuator_lag", "delay", "effective_lag"))
    assert both.value == pytest.approx(lag.value + delay.value)
    assert both.half_width <= lag.half_width
    assert all(item.interval[0] <= item.value <= item.interval[1] for item in (lag, delay, both))
    # another run, of .2 s, has no bin in the band
    (columns,), (run,) = fit.fit.problem.columns, fit.fit.problem.columns[0].runs
    runs = slice(run.start, run.stop - 40), slice(run.stop - 20, run.stop)
    problem = replace(fit.fit.problem, columns=(replace(columns, runs=runs),))
    assert ProfileSets(problem, identify(problem, reference_iv())).of_nuisances(["delay"]).profile.intervals


RADIUS = 0.2


def flight(lowest, *, on_ground=True):
    log = flown(seconds=10.0, seed=5)[0]
    height = log.channels["position_z"]
    over = height.values - height.values.min() + lowest
    before = np.full(200 if on_ground else 0, 0.0)
    time = height.time_s[0] - 0.01 * np.arange(before.size, 0, -1)
    changed = replace(height, time_s=np.append(time, height.time_s), values=np.append(before, over))
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
    file.write_text(rotors, encoding="utf-8")
    assert of_vehicle(Vertical(), str(file)) == Vertical()  # one without serves all but the ground effect
    file.write_text(rotors + "radius = 0.15\n", encoding="utf-8")
    vertical = of_vehicle(Vertical(), str(file))
    assert vertical.rotor_radius == 0.15
    check_terms(ev.FlightOptions(terms=("ground-effect",)), vertical.rotor_radius)
    low = (flight(0.4),)
    assert for_flights(vertical, low, ev.FlightOptions()).rotor_radius == 0.15
    assert for_flights(vertical, low, ev.FlightOptions(rotor_radius=0.3)).rotor_radius == 0.3


HOVER_INPUT, START, REACH = 0.495, 0.55, 0.2
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
def test_a_hover_by_balance_needs_no_instruments_and_no_thrust_is_not_compared(log):
    wrong = replace(log, parameters={"MPC_THR_HOVER": 0.3})
    biased = ev.identify_flight(wrong, ev.FlightOptions(input_map="linear", method="least_squares"))
    assert biased.quantities["input_gain"].verdict is not Status.IDENTIFIED
    assert biased.quantities["hover_input"].verdict is Status.IDENTIFIED
    assert " -> " not in repr(log_documents(ev.LogEstimate({"motion": biased}))[0].card)
    rotors = changed(wrong, "input", rotor_command_1=wrong.channel("input").values)
    card = repr(log_documents(ev.LogEstimate({"motion": ev.identify_flight(rotors)}))[0].card)
    assert "->" not in card
    assert "outside the interval" not in card


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
