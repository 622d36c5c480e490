"""The recipe from recordings to verdicts: truth found, flights refused, pools, and logs that are broken."""

from __future__ import annotations

import pickle
import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy
from flight_logs import FRICTION, GAIN, HOVER, LAG_S, changed, channel, every, flown
from scipy import stats

import eivor as ev
import shape_checks
from coarse_search import coarse
from eivor.errors import EstimationError, InputError, PoolingError, UsageError
from eivor.models.spectral import SpectralRun

pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


@pytest.fixture(scope="module")
def log():
    return flown(seconds=30.0, seed=11)[0]


@pytest.fixture(scope="module")
def fit(log):
    return ev.identify_flight(log)


@pytest.fixture(scope="module")
def coarse_fit(log):
    """What `fit` is where the search is coarse, as in the tests."""
    with shape_checks.unchecked(), coarse():
        return ev.identify_flight(log)


@pytest.mark.thorough
def test_a_result_goes_to_another_process_and_back(fit):
    """With what was asked of it before: a pool of processes, a cache."""
    fit.fit.estimate.interval("viscous_friction")
    again = pickle.loads(pickle.dumps(fit))  # noqa: S301 - made here
    assert again.summary() == fit.summary()
    assert again.fit.estimate.interval("input_gain", 0.9) == fit.fit.estimate.interval("input_gain", 0.9)


def statuses(result):
    return {name: quantity.verdict.value for name, quantity in result.quantities.items()}


def test_an_excited_flight_is_identified_and_its_intervals_hold_the_truth(fit):
    assert fit.verdict.status is ev.Status.IDENTIFIED
    assert fit.verdict.sentences == ()
    truth = {
        "viscous_friction": FRICTION,
        "input_gain": GAIN,
        "effective_lag": LAG_S,
        "actuator_lag": LAG_S,
        "delay": 0.0,
        "hover_input": HOVER,
        "intercept": 0.0,
    }
    for name, value in truth.items():
        low, high = fit.quantities[name].interval
        # Three half-widths: seven intervals of 95 % would otherwise miss one now and then.
        half = 3.0 * max(0.5 * (high - low), 1e-12)
        assert abs(fit.quantities[name].value - value) <= half, name
    assert (fit.method, fit.instruments) == ("reference_iv", "reference_position_z, reference_velocity_z")
    assert fit.window_s == pytest.approx((0.0, 29.99))
    # the interval of the hover input, which is that of one flight's conditions, is four percent wide
    floor = fit.quantities["hover_input"].systematic_uncertainties[-1]
    assert fit.quantities["hover_input"].half_width == pytest.approx(0.02 * HOVER, rel=0.01)
    assert "this flight's conditions" in floor.sentence
    (of_run,) = fit.quantities["intercept"].by_run
    assert of_run == pytest.approx(fit.quantities["intercept"].value, abs=1e-9)
    assert "identified" in fit.summary()


def test_intercept_and_hover_are_two_views_of_one_balance(fit):
    """U_h = (g - b) / K_u."""
    b, K_u = fit.quantities["intercept"].value, fit.quantities["input_gain"].value
    assert fit.quantities["hover_input"].value ** 2 == pytest.approx((9.80665 - b) / K_u, rel=1e-12)


def test_names_and_levels_of_intervals(fit):
    assert fit.names == ("viscous_friction", "input_gain", "actuator_lag", "delay")
    narrow, wide = fit.interval("viscous_friction", 0.5), fit.interval("viscous_friction", 0.99)
    assert wide[0] < narrow[0] < narrow[1] < wide[1]
    # derived ones, too: a floor, a set, Student's t, one over the friction
    assert fit.interval("hover_input") == fit.quantities["hover_input"].interval
    assert fit.interval("hover_input", 0.5) == pytest.approx(fit.interval("hover_input"))
    assert np.ptp(fit.interval("effective_lag", 0.5)) < np.ptp(fit.interval("effective_lag"))
    intercept = fit.quantities["intercept"]
    degrees = scipy.special.stdtridf(0.975, intercept.half_width / intercept.std_error)
    half = intercept.std_error * stats.t.ppf(0.75, degrees)
    expected = intercept.value - half, intercept.value + half
    assert fit.interval("intercept", 0.5) == pytest.approx(expected)
    assert fit.interval("time_constant", 0.5) == pytest.approx((1.0 / narrow[1], 1.0 / narrow[0]))
    with pytest.raises(UsageError, match=r"a quantity out of .*; received 'mass'"):
        fit.interval("mass")


def test_an_accelerometer_in_g_refuses_what_rests_on_it(log):
    force = log.channels["specific_force_z"]
    in_g = replace(force, values=force.values / 9.80665)
    flight = ev.identify_flight(replace(log, channels=log.channels | {"specific_force_z": in_g}))
    assert flight.diagnostics["apparent_gravity"] == pytest.approx(1.0, abs=0.05)
    assert flight.verdict.status is flight.quantities["input_gain"].verdict is ev.Status.REFUSED
    # means of the input are not moved by it
    hover, known = (item.quantities["hover_input"] for item in (flight, ev.identify_flight(log)))
    assert hover.verdict is known.verdict is ev.Status.IDENTIFIED
    assert hover.value == pytest.approx(known.value, rel=0.01)
    assert "its values look like g." in flight.verdict.reasons[0].sentence


@pytest.mark.thorough
def test_friction_of_an_estimator_is_in_the_interval(log):
    friction, measured = (
        ev.identify_flight(
            replace(
                log, channels=log.channels | {"velocity_z": replace(log.channels["velocity_z"], estimated=of)}
            )
        ).quantities["viscous_friction"]
        for of in (True, False)
    )
    (added,) = [part for part in friction.systematic_uncertainties if "estimator" in part.sentence]
    assert (added.below, added.above) == (0.03, 0.0)  # an estimator adds friction
    assert not any("estimator" in part.sentence for part in measured.systematic_uncertainties)
    assert friction.interval == pytest.approx((measured.interval[0] - 0.03, measured.interval[1]), abs=1e-3)


@pytest.mark.thorough
def test_constant_reference_is_refused(log):
    hover = flown(seconds=30.0, amplitude=0.0, seed=12)[0]
    still = changed(hover, "reference_velocity_z", reference_position_z=np.zeros(3000))
    result = ev.identify_flight(still)
    assert result.verdict.status is ev.Status.REFUSED
    assert "The reference never moved (reference_position_z: constant)" in result.verdict.sentences[0]
    # The numbers are printed all the same, and the hover input may be told.
    assert result.estimate is not None
    assert result.quantities["hover_input"].value == pytest.approx(HOVER, rel=0.02)
    dragged = ev.identify_flight(still, terms=("quadratic-drag",))
    assert dragged.quantities["quadratic_drag"].verdict is ev.Status.REFUSED


def test_without_a_reference_the_numbers_are_provisional(log):
    result = ev.identify_flight(changed(log, "reference_position_z", "reference_velocity_z"))
    assert result.verdict.status is ev.Status.PROVISIONAL
    assert "No reference can serve as an instrument (the log has none)" in result.verdict.sentences[0]
    assert (result.method, result.instruments) == ("least_squares", "none")
    (hover,) = [name for name, status in statuses(result).items() if status != "provisional"]
    assert hover == "hover_input"  # thrust is the weight: no instrument is needed
    figures = {figure.name: figure for figure in result.figures}
    assert {"hover_drift", "hover_next_flight", "thrust_exponent"} <= figures.keys()
    low, high = figures["hover_next_flight"].interval
    assert high - low >= 0.05 * figures["hover_next_flight"].value
    # nor an estimate
    still = ev.identify_flight(changed(log, velocity_z=np.zeros(log.channels["velocity_z"].time_s.size)))
    assert still.fit is None
    known, without = (item.quantities["hover_input"] for item in (result, still))
    assert without.verdict is ev.Status.IDENTIFIED
    assert without.value == pytest.approx(known.value, rel=0.01)


def test_key_figures_are_what_was_put_in():
    """Shares of motors, vibration of a known size and pitch, and a supply that sags with the load."""
    log = flown(seconds=40.0, noise=0.1)[0]
    command, force = log.channels["rotor_command_1"], log.channels["specific_force_z"]
    shares, fast = np.array([0.9, 1.0, 1.05, 1.05]), np.arange(0.0, 40.0, 0.0025)
    load = (command.values / HOVER) ** 2
    columns = {f"rotor_command_{n}": share * command.values for n, share in enumerate(shares, 1)}
    columns |= {"battery_voltage": 16.0 - 0.8 * load - 0.01 * command.time_s}
    shaken = np.interp(fast, force.time_s, force.values) + 2.0 * np.sin(2.0 * np.pi * 60.0 * fast)
    known = dict.fromkeys("xyz", 0.0 * fast) | {"z": shaken}
    body = {f"specific_force_body_{axis}": channel("", fast, values) for axis, values in known.items()}
    body = {name: replace(item, name=name) for name, item in body.items()}
    changes = {name: channel(name, command.time_s, values) for name, values in columns.items()}
    result = ev.identify_flight(replace(log, channels={**log.channels, **changes, **body}))
    figures = {figure.name: figure for figure in result.figures}
    found = [figures[f"motor_share_{n}"].value for n in range(1, 5)]
    assert found == pytest.approx(shares.tolist(), rel=1e-3)
    assert figures["vibration"].value == pytest.approx(2.0**0.5, rel=0.02)
    assert figures["vibration_peak"].value == pytest.approx(60.0, abs=0.5)
    assert figures["battery_sag"].value == pytest.approx(0.8, rel=0.05)
    assert figures["thrust_margin"].value == pytest.approx(1.0 - HOVER, abs=0.02)
    assert figures["thrust_exponent"].interval[0] < 2.0 < figures["thrust_exponent"].interval[1]


def test_a_velocity_of_the_wrong_sign_is_refused(log):
    velocity = log.channels["velocity_z"]
    backward = changed(
        log, velocity_z=-velocity.values, specific_force_z=log.channels["specific_force_z"].values
    )
    result = ev.identify_flight(replace(backward), ev.FlightOptions(method=ev.methods.least_squares()))
    assert result.verdict.status is ev.Status.REFUSED
    assert "velocity goes down where height and accelerometer go up" in result.verdict.sentences[0]


@pytest.fixture(scope="module")
def gusty():
    """Result of a flight that hardly tells anything, of a full search."""
    with shape_checks.unchecked():
        return ev.identify_flight(flown(seconds=8.0, gust=12.0, seed=14)[0])


def test_friction_not_told_from_zero_is_refused(gusty):
    result = gusty
    assert result.verdict.status is ev.Status.REFUSED
    assert "cannot be distinguished from zero" in result.verdict.sentences[0]
    low, _ = result.quantities["viscous_friction"].interval
    assert low <= 0.0


def test_slow_commands_widen_the_lag_and_the_gain(log):
    result = ev.identify_flight(every(log, 3, "rotor_command_1"))
    for name, value in (("viscous_friction", FRICTION), ("input_gain", GAIN), ("effective_lag", LAG_S)):
        low, high = result.quantities[name].interval
        assert low <= value <= high
        parts = [part.sentence for part in result.quantities[name].systematic_uncertainties]
        assert any("The command is logged at 33" in sentence for sentence in parts)
    assert result.quantities["effective_lag"].half_width > 0.015


@pytest.mark.thorough
def test_feedback_in_the_instruments_is_weak_at_best(log):
    feedback = changed(log, feedback_reference_velocity_z=log.channels["reference_velocity_z"].values)
    named = ev.FlightOptions(instruments=("reference_position_z", "feedback_reference_velocity_z"))
    result = ev.identify_flight(feedback, named)
    assert result.verdict.status is ev.Status.WEAK
    assert "answer the vehicle's own disturbances" in result.verdict.sentences[0]
    assert ev.identify_flight(feedback).verdict.status is ev.Status.IDENTIFIED


def test_grounded_flights_never_take_off(log):
    landed = channel("landed", [0.0, 29.0], [1.0, 1.0])
    result = ev.identify_flight(changed(log, landed=landed))
    assert result.verdict.status is ev.Status.REFUSED
    assert result.verdict.sentences[0].startswith("flight 0 never takes off (by the log's land detector).")
    assert "never_takes_off" in [finding.name for finding in result.findings]
    assert result.estimate is None
    assert result.window_s is None
    assert np.isnan(result.quantities["hover_input"].value)
    for ask in (
        lambda: result.names,
        lambda: result.covariance,
        lambda: result.interval("input_gain"),
        result.plot,
    ):
        with pytest.raises(EstimationError, match="Expected a flight with an estimate; received one without"):
            ask()


def lossy(log, name, share):
    """The log without a share of the values of a channel, at random."""
    known = log.channels[name]
    lost = np.random.default_rng(0).random(known.values.size) < share
    return changed(log, **{name: replace(known, values=np.where(lost, np.nan, known.values))})


@pytest.mark.parametrize(
    ("of", "window", "told"),
    [
        (lambda log: log, (5.0, 7.5), "the window holds 2.5 s of it.*Widen the window"),
        (lambda _: flown(seconds=2.0)[0], None, "it covers 2 s.*check the unit of its clock"),
        (
            lambda log: changed(log, cos_tilt=np.full(3000, 0.8)),
            None,
            "100% .* have a cos_tilt below 0.9.*unit",
        ),
        (
            lambda log: lossy(log, "rotor_command_1", 0.99),
            None,
            "100% of its samples have no rotor_command_1.*Log rotor_command_1 without gaps",
        ),
    ],
)
def test_flights_without_three_seconds_say_what_they_lack(of, window, told, log):
    result = ev.identify_flight(of(log), ev.FlightOptions(window=window))
    sentences = " ".join(result.verdict.sentences)
    assert re.search(f"has no three seconds in the air in runs of a second or more: {told}", sentences)
    assert "no_usable_run" in [finding.name for finding in result.findings]


@pytest.mark.parametrize(
    ("number", "factor", "told"),
    [(2, 1e3, "on one scale; received rotor_command_2 of"), (3, 1.0, "received none of rotor_command_2")],
)
def test_rotors_that_are_not_all_there_or_on_other_scales_are_refused(number, factor, told, log):
    first = log.channels["rotor_command_1"]
    other = replace(first, name=f"rotor_command_{number}", values=factor * first.values)
    with pytest.raises(InputError, match=told):
        ev.identify_flight(changed(log, **{other.name: other}))


def test_single_values_that_a_command_lacks_are_bridged(log, fit):
    quantities = ev.identify_flight(lossy(log, "rotor_command_1", 0.05)).quantities
    for name in ("viscous_friction", "input_gain", "effective_lag"):
        entire, low, high = fit.quantities[name].value, *quantities[name].interval
        assert low < entire < high
        assert quantities[name].value == pytest.approx(entire, abs=0.3 * (high - low))


@pytest.mark.parametrize(("taken", "exponent"), [("linear", 2.0), ("power:1.5", 2.0), ("square", 2.0)])
def test_a_wrong_input_map_is_told_with_the_exponent_that_thrust_has(log, taken, exponent):
    result = ev.identify_flight(log, ev.FlightOptions(input_map=taken))
    assert result.diagnostics["thrust_exponent"] == pytest.approx(exponent, abs=0.15)
    gain, hover = result.quantities["input_gain"], result.quantities["hover_input"]
    parts = [part.sentence for part in gain.systematic_uncertainties]
    assert any("thrust grows" in sentence for sentence in parts) == (taken != "square")
    secant = 9.80665 / hover.value ** {"linear": 1.0, "square": 2.0}.get(taken, 1.5)
    assert gain.interval[0] * (1.0 - 1e-12) <= secant <= gain.interval[1] * (1.0 + 1e-12)


def test_a_longer_flight_needs_no_more_spectra(monkeypatch):
    """Of two hours that tell little each optional term was estimated again, with a search of its own."""
    made, spectrum, counts = [], SpectralRun.spectrum, []
    monkeypatch.setattr(SpectralRun, "spectrum", lambda run, series: made.append(0) or spectrum(run, series))
    for seconds in (15.0, 60.0):
        made.clear()
        ev.identify_flight(flown(seconds=seconds, gust=3.0, amplitude=0.15, seed=5)[0])
        counts.append(len(made))
    assert counts[1] < 1.1 * counts[0] < 1000


@pytest.mark.thorough
def test_compare_lists_every_method_as_if_it_had_been_asked_for(log, coarse_fit):
    result = ev.identify_flight(log, ev.FlightOptions(compare=True))
    every_method = (
        "reference_iv least_squares whitened_least_squares total_least_squares extended_iv generalized_iv "
        "generalized_iv_tls bias_compensated_least_squares spectral_giv whittle_ml"
    )
    assert [row.label for row in result.comparisons] == every_method.split()
    assert result.quantities["viscous_friction"] == coarse_fit.quantities["viscous_friction"]
    for row in result.comparisons[:2]:
        alone = ev.identify_flight(log, ev.FlightOptions(method=row.label))
        assert row.verdict is alone.verdict.status
        assert row.quantities["viscous_friction"] == alone.quantities["viscous_friction"]


@pytest.mark.parametrize(
    ("method", "asked", "used"),
    [
        ("extended_iv", (), "input lagged by 1 to 15 samples"),
        ("extended_iv", ("references",), "reference_position_z, reference_velocity_z"),
        ("generalized_iv", (), "reference_position_z, reference_velocity_z"),
        ("generalized_iv", ("lags",), "input lagged by 0 to 15 samples"),
        ("reference_iv", (), "reference_position_z, reference_velocity_z"),
        ("reference_iv", ("lags",), "input lagged by 1 to 15 samples"),
        ("least_squares", (), "none"),
    ],
)
def test_methods_have_instruments_of_their_own(log, method, asked, used):
    result = ev.identify_flight(log, ev.FlightOptions(method=method, instruments=asked, window=(0.0, 8.0)))
    assert result.instruments == used
    # Past inputs answer the vehicle: that is said wherever they come from.
    reported = any("Past inputs are the instruments" in sentence for sentence in result.verdict.sentences)
    assert reported is used.startswith("input lagged")


def test_start_of_the_clock_does_not_matter(log, coarse_fit):
    later = replace(
        log, channels={k: replace(c, time_s=c.time_s + 12_345.0) for k, c in log.channels.items()}
    )
    result = ev.identify_flight(later)
    assert result.window_s == pytest.approx((12_345.0, 12_374.99))
    for name, quantity in coarse_fit.quantities.items():
        assert result.quantities[name].value == pytest.approx(quantity.value, rel=1e-4, abs=1e-9)


@pytest.fixture(scope="module")
def fleet():
    return flown(10, seconds=10.0, seed=14)


@pytest.fixture(scope="module")
def alone(fleet):
    """Result of each of the first four flights."""
    with shape_checks.unchecked(), coarse():
        return [ev.identify_flight(flight) for flight in fleet[:4]]


@pytest.fixture(scope="module")
def three(fleet):
    """Result of the pool of the first three."""
    with shape_checks.unchecked(), coarse():
        return ev.identify_flight(fleet[:3])


def half(result, name):
    return (
        result.estimate.joint_covariance.part("classical").matrix[result.names.index(name)][
            result.names.index(name)
        ]
        ** 0.5
    )


@pytest.mark.thorough
def test_a_log_given_twice_is_used_once(fleet):
    first = replace(fleet[0], sha256="a")
    again = replace(fleet[0], sha256="a", name="copy")
    result = ev.identify_flight([first, again])
    assert result.flights == ()
    (finding,) = [item for item in result.findings if item.name == "duplicate_log"]
    assert finding.message == "copy has the same content as flight 0; it is used once only."
    # Two windows of one log are two flights; logs without a file are never taken for one another.
    windows = [(0.0, 5.0), (5.0, 9.9)]
    assert len(ev.identify_flight([first, again], windows=windows).flights) == 2
    assert len(ev.identify_flight(fleet[:2]).flights) == 2


@pytest.mark.thorough
def test_a_grounded_flight_does_not_spoil_the_pool(fleet, alone):
    grounded = changed(fleet[1], landed=channel("landed", [0.0, 9.0], [1.0, 1.0]))
    pool = ev.identify_flight([fleet[0], grounded])
    assert pool.quantities["viscous_friction"].value == pytest.approx(
        alone[0].quantities["viscous_friction"].value
    )
    assert pool.flights[1].verdict is ev.Status.REFUSED
    assert pool.flights[1].quantities == {}
    none = ev.identify_flight([grounded, replace(grounded, name="other")])
    assert none.verdict.sentences[0].startswith("No flight of the pool takes off (by the log's")
    brief = ev.identify_flight(fleet[:2], ev.FlightOptions(window=(2.0, 4.0)))
    assert brief.verdict.sentences[0].startswith("No flight of the pool has three seconds in the air")
    assert none.verdict.status is ev.Status.REFUSED


@dataclass(frozen=True)
class Wheeled(type(ev.motion_by_name("vertical"))):
    """A motion whose vehicles are told apart by another parameter."""

    channels = replace(ev.motion_by_name("vertical").channels, vehicle_parameters=("WHEEL_COUNT",))


@pytest.mark.thorough
def test_a_motion_says_which_parameters_stand_for_the_vehicle(fleet):
    two, three = (replace(fleet[0], parameters={"WHEEL_COUNT": count}) for count in (2.0, 3.0))
    with pytest.raises(PoolingError, match=r"WHEEL_COUNT = 2\.0 and 3\.0"):
        ev.identify_flight([two, replace(fleet[1], parameters={"WHEEL_COUNT": 3.0})], model=Wheeled())
    # finding 13: a parameter that one log lacks is of another firmware
    pooled = ev.identify_flight([three, replace(fleet[1], parameters={"THR_MDL_FAC": 0.3})], model=Wheeled())
    assert len(pooled.flights) == 2
    # a user who knows better pools them
    logs = [two, replace(fleet[1], parameters={"WHEEL_COUNT": 3.0})]
    assert len(ev.identify_flight(logs, model=Wheeled(), pool_anyway=True).flights) == 2


def test_without_a_gain_the_hover_input_is_where_thrust_is_the_weight():
    result = ev.identify_flight(flown(1, seconds=40.0, amplitude=0.002, gust=0.3)[0])
    hover = result.quantities["hover_input"]
    assert result.quantities["input_gain"].verdict is ev.Status.REFUSED
    assert hover.verdict is ev.Status.IDENTIFIED
    assert hover.interval[0] <= HOVER <= hover.interval[1]
    assert hover.std_error < 0.005 * HOVER


@pytest.mark.calibration
def test_hover_intervals_cover():
    runs = 25
    logs = flown(runs, seconds=12.0, noise=2.0, gust=0.5, seed=15)
    results = [ev.identify_flight(log).quantities["hover_input"] for log in logs]
    covered = sum(quantity.interval[0] <= HOVER <= quantity.interval[1] for quantity in results)
    assert covered >= stats.binom.ppf(1e-4, runs, 0.95)
    # And what scatters is not so wide that covering is no feat: the floor is for repeats, not for errors.
    errors = np.array([(quantity.value - HOVER) / quantity.std_error for quantity in results])
    assert np.sqrt(np.mean(errors**2)) > 0.3
