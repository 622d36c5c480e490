"""Optional terms of the vertical equation: found where they are, zero where they are not, else refused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import eivor as ev
from eivor.cli.parsing import flight_options
from eivor.errors import InputError, MissingChannelError, UsageError
from eivor.flights.prepare import check_options
from eivor.flights.quantity import Horizon
from eivor.motions.vertical.motion import Vertical
from eivor.motions.vertical.predict import _run, dragged_run
from eivor.report.json_document import json_document, json_text
from eivor.report.outputs import saved_fit
from eivor.report.saved_fit import fit_of
from flights.flight_logs import FRICTION, GAIN, HOVER, changed, flown

pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")

RADIUS = 0.2


@pytest.fixture(scope="module")
def log():
    return flown(seconds=30.0, seed=5)[0]


def commanded(log, change):
    """The log of a vehicle that needed another thrust: its mapped command is changed by what is given."""
    command = log.channels["rotor_command_1"]
    values = np.sqrt(change(command.values**2))
    return replace(log, channels={**log.channels, command.name: replace(command, values=values)})


def near(quantity, truth):
    """Whether the truth lies within four standard errors or so."""
    return abs(quantity.value - truth) < 2.0 * quantity.half_width


def with_channel(log, name, values, time_s=None):
    like = log.channels["velocity_z"]
    channel = replace(like, name=name, values=values, time_s=like.time_s if time_s is None else time_s)
    return replace(log, channels={**log.channels, name: channel})


def test_thrust_that_falls_in_time_is_reported_and_moves_nothing_else(log):
    """Real flights lose 1 to 5 per cent of the thrust of one command in half a minute."""
    time = log.channels["rotor_command_1"].time_s
    falling = commanded(log, lambda mapped: mapped * (1.0 + 0.04 * (time - time[0]) / np.ptp(time)))
    still, fit = (ev.identify_flight(item) for item in (log, falling))
    for name in ("viscous_friction", "effective_lag"):
        moved = fit.quantities[name].value - still.quantities[name].value
        assert abs(moved) < 0.25 * still.quantities[name].half_width
    assert fit.quantities["hover_input"].value == pytest.approx(1.01 * HOVER, rel=2e-3)
    numbers = fit.diagnostics
    assert numbers["thrust_drift"] == pytest.approx(-0.04 * 9.81, abs=numbers["thrust_drift_half_width"])
    share = 0.02 * 60.0 / numbers["thrust_drift_duration_s"]
    assert numbers["hover_drift"] == pytest.approx(share, abs=numbers["hover_drift_half_width"])
    assert numbers["hover_drift_half_width"] < 0.4 * share
    assert "thrust of one command fell by 0.3" in dict(fit.fit.motion_checks.report)["drift"]
    short = ev.identify_flight(log, ev.FlightOptions(window=(5.0, 18.0)))
    assert "thrust_drift" not in short.diagnostics


def with_height(log, lowest):
    """Height over the ground, which the log begins on, and the log with it."""
    reference = log.channels["reference_position_z"].values
    over = reference - reference.min() + lowest
    time = log.channels["velocity_z"].time_s
    before = time[0] - 0.01 * np.arange(200, 0, -1)
    values = np.concatenate([np.zeros(200), over])
    return over, with_channel(log, "position_z", values, np.concatenate([before, time]))


def sagging(log):
    """Share of the voltage that is lost, about its mean."""
    lost = np.linspace(0.0, 0.1, log.channels["velocity_z"].values.size)
    return (1.0 - lost) / (1.0 - lost.mean())


@pytest.mark.thorough
def test_quadratic_drag_is_told_apart_from_friction(log):
    velocity = log.channels["reference_velocity_z"].values
    draggy = commanded(log, lambda U: U + 0.2 / GAIN * velocity * np.abs(velocity))
    biased = ev.identify_flight(draggy).quantities["viscous_friction"]
    assert biased.interval[0] > FRICTION
    quantities = ev.identify_flight(draggy, terms=("quadratic-drag",)).quantities
    assert near(quantities["viscous_friction"], FRICTION)
    assert near(quantities["quadratic_drag"], 0.2)
    assert quantities["quadratic_drag"].interval[0] > 0.0
    assert quantities["quadratic_drag"].unit == "1/m"


def test_climbs_with_drag_are_predicted_of_the_input_alone():
    """Against the equation itself, in steps a twenty-fifth as long; without drag as the linear answer is."""
    step, fine, K, K_2 = 0.02, 25, 0.3, 0.2
    times = step / fine * np.arange(12 * 50 * fine)
    force = 1.5 * np.sin(1.1 * times) + 0.8 * np.sin(2.3 * times + 1.0)
    force -= force[::fine].mean()
    v = np.empty(times.size)
    v[0] = 0.7
    for k in range(times.size - 1):
        v[k + 1] = v[k] + step / fine * (force[k] - K * v[k] - K_2 * v[k] * abs(v[k]) + 0.1)
    reported = dragged_run(force[::fine], v[::fine], slice(None), K, K_2, step)
    np.testing.assert_allclose(reported, v[::fine], atol=0.01)
    linear = dragged_run(force[::fine], v[::fine], slice(None), K, 0.0, step)
    np.testing.assert_allclose(linear, _run(force[::fine], v[::fine], slice(None), K, step), atol=1e-6)
    assert np.sqrt(np.mean((linear - v[::fine]) ** 2)) > 0.05


@pytest.mark.thorough
def test_thrust_near_the_ground_is_told_apart_from_the_gain(log):
    over, near_ground = with_height(log, 0.5)
    near_ground = commanded(near_ground, lambda U: U / (1.0 + 0.3 * (RADIUS / over) ** 2))
    plain = ev.identify_flight(near_ground, rotor_radius=RADIUS)
    for name in ("input_gain", "hover_input"):
        assert any(
            "rotor radii over the ground" in reason.sentence for reason in plain.quantities[name].reasons
        )
    fit = ev.identify_flight(near_ground, terms=("ground-effect",), rotor_radius=RADIUS)
    assert not any("rotor radii" in reason.sentence for reason in fit.quantities["input_gain"].reasons)
    assert near(fit.quantities["ground_effect"], 0.3)
    assert fit.quantities["ground_effect"].interval[0] > 0.0
    assert near(fit.quantities["input_gain"], GAIN)
    assert not any(name.startswith("left_out_ground_effect") for name in fit.diagnostics)
    assert "left_out_quadratic_drag" in fit.diagnostics


@pytest.mark.thorough
def test_thrust_follows_the_voltage_and_the_gain_is_that_of_its_mean(log):
    voltage = sagging(log)
    sags = commanded(with_channel(log, "battery_voltage", 16.0 * voltage), lambda U: U / voltage**2)
    fit = ev.identify_flight(sags, terms=("voltage",))
    assert near(fit.quantities["voltage_exponent"], 2.0)
    assert fit.quantities["voltage_exponent"].interval[0] > 1.0
    # a slow column: its covariance is taken row by row as well
    assert fit.estimate.joint_covariance.part("by_row").matrix.shape == (5, 5)
    assert near(fit.quantities["input_gain"], GAIN)
    # at the mean voltage
    assert near(fit.quantities["hover_input"], HOVER)
    # another part of the flight is predicted with the voltage that the gain belongs to, not with its own
    result = ev.validate(fit, sags, window=(0.0, 12.0))
    assert result.motion.mean_voltage == fit.motion.mean_voltage
    assert result.predicts
    reported = next(
        prediction
        for prediction in result.predictions
        if prediction.model == "fit" and prediction.horizon is Horizon.OPEN_LOOP
    )
    saved = saved_fit(fit)
    values = [
        0.0 if name == "voltage_exponent" else parameter
        for name, parameter in fit.estimate.parameters.items()
    ]
    blind = replace(saved.joint, values=np.array(values))
    worse = ev.validate(replace(saved, estimated=blind), sags, window=(0.0, 12.0)).predictions
    assert reported.error.rms < next(item for item in worse if item.horizon is Horizon.OPEN_LOOP).error.rms


@pytest.mark.thorough
def test_terms_that_are_absent_cannot_be_told_from_zero_and_several_go_together(log):
    _, high_up = with_height(with_channel(log, "battery_voltage", 16.0 * sagging(log)), 0.5)
    every = ("quadratic-drag", "ground-effect", "voltage")
    fit = ev.identify_flight(high_up, terms=every, rotor_radius=RADIUS)
    for name in ("quadratic_drag", "ground_effect", "voltage_exponent"):
        low, high = fit.quantities[name].interval
        assert low < 0.0 < high
        assert any(
            "cannot be distinguished from zero" in reason.sentence for reason in fit.quantities[name].reasons
        )
    assert near(fit.quantities["viscous_friction"], FRICTION)
    assert "voltage_exponent" in fit.summary()
    assert fit.motion.view(fit.prepared[0]).symbols.endswith("; V the battery's voltage, V_0 its mean")
    model = json_document(fit)["model"]
    assert model["equation"].startswith(
        "z'' + g = K_u U - K z' + b - K_2 z'|z'| + k g (U/mean U) (R/h)² + n g (U/mean U) (V/V_0 - 1); "
    )
    with pytest.raises(InputError, match="begins or ends on the ground"):
        ev.validate(fit, log)
    reported = json.loads(json_text(json_document(fit)))
    assert reported["prediction"]["vehicle"] == {
        "rotor_radius": RADIUS,
        "mean_voltage": fit.motion.mean_voltage,
    }
    reported["prediction"]["vehicle"] = None  # as it was written before terms were predicted with
    with pytest.raises(UsageError, match="radius of a rotor"):
        ev.validate(fit_of(reported), high_up)
    reported["prediction"]["vehicle"] = {"rotor_radius": "wide"}
    with pytest.raises(InputError, match="with rotor_radius and mean_voltage of its terms"):
        ev.validate(fit_of(reported), high_up)


def test_without_instruments_terms_are_provisional(log):
    fit = ev.identify_flight(log, terms=("quadratic-drag",), method="least_squares")
    assert fit.quantities["quadratic_drag"].verdict.value == "provisional"


def test_what_a_term_needs_is_asked_for(log):
    with pytest.raises(UsageError, match="quadratic-drag, ground-effect, voltage; received 'qudratic-drag'"):
        ev.identify_flight(log, terms=("qudratic-drag",))
    with pytest.raises(UsageError, match="each term once; received voltage twice"):
        ev.identify_flight(log, terms=("voltage", "voltage"))
    with pytest.raises(UsageError, match="the radius of a rotor with the term ground-effect"):
        ev.identify_flight(log, terms=("ground-effect",))
    with pytest.raises(UsageError, match="between 0 and 5 m; received -1 m"):
        ev.identify_flight(log, rotor_radius=-1.0)
    with pytest.raises(MissingChannelError, match="battery_voltage for the term voltage"):
        ev.identify_flight(log, terms=("voltage",))
    with pytest.raises(MissingChannelError, match="position_z for the term ground-effect"):
        ev.identify_flight(changed(log, "position_z"), terms=("ground-effect",), rotor_radius=RADIUS)
    with pytest.raises(InputError, match="begins or ends on the ground"):
        ev.identify_flight(log, terms=("ground-effect",), rotor_radius=RADIUS)
    measured = with_channel(log, "battery_voltage", 16.0 * sagging(log))
    command = measured.channels["rotor_command_1"]
    measured = replace(
        measured,
        channels={name: channel for name, channel in measured.channels.items() if name != command.name}
        | {"rotor_speed_1": replace(command, name="rotor_speed_1", held=False)},
    )
    with pytest.raises(InputError, match="commands for the term voltage"):
        ev.identify_flight(measured, terms=("voltage",))


def test_the_command_line_takes_terms_before_a_log_is_read():
    options = flight_options(Vertical(), terms=["ground-effect", "voltage"], rotor_radius=RADIUS)
    assert (options.terms, options.rotor_radius) == (("ground-effect", "voltage"), RADIUS)
    with pytest.raises(UsageError, match="received 'lift'"):
        flight_options(Vertical(), terms=["lift"])


def test_motions_without_terms_say_so():
    with pytest.raises(UsageError, match="no optional terms: 'rates' has none"):
        check_options(ev.motion_by_name("rates"), ev.FlightOptions(terms=("voltage",)))
