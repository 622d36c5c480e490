"""Measured rotor speeds: telemetry that is late or early, and what it would do to the friction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flight_logs import FRICTION, GAIN, LAG_S, STEP_S, changed, channel, flown

import eivor as ev
from eivor.inference.verdict import Status
from eivor.signals.filters import actuator_state, shifted_by
from eivor.signals.recording import Recording

pytestmark = pytest.mark.usefixtures("unchecked_shapes")


def telemetry(log: Recording, late_s: float) -> Recording:
    """The log with its rotors' actual speed, stamped late, in place of their command."""
    command = log.channels["rotor_command_1"]
    speed = actuator_state(command.values[:, None], step_s=STEP_S, lag_s=LAG_S, delay_s=0.0)[:, 0]
    measured = channel("rotor_speed_1", command.time_s + late_s, speed)
    return changed(log, "rotor_command_1", rotor_speed_1=replace(measured, held=False))


@pytest.mark.parametrize("late_s", [0.0, 0.02, pytest.param(-0.023, marks=pytest.mark.thorough)])
def test_late_telemetry_moves_no_parameter_and_is_told(late_s):
    identify_flight = ev.identify_flight(telemetry(flown(seconds=26.0)[0], late_s))
    delay = identify_flight.quantities["delay"]
    assert delay.interval[0] < -late_s < delay.interval[1]
    assert delay.half_width < 0.01
    assert identify_flight.quantities["effective_lag"].value == delay.value
    for name, truth in (("viscous_friction", FRICTION), ("input_gain", GAIN)):
        low, high = identify_flight.quantities[name].interval
        assert low < truth < high
    assert identify_flight.verdict.status is Status.IDENTIFIED
    assert identify_flight.names == ("viscous_friction", "input_gain", "delay")
    assert "their stamps are late" in identify_flight.motion.symbols(identify_flight.prepared[0])


@pytest.mark.thorough
def test_the_delay_is_part_of_the_friction_s_interval():
    log = telemetry(flown(seconds=26.0)[0], 0.0)
    identify_flight = ev.identify_flight(log)
    problem = identify_flight.fit.problem
    known = problem.with_nuisances((problem.lag, problem.delay.known_at(0.0)))
    sure = ev.identify(known, ev.methods.reference_iv())
    assert identify_flight.estimate.std_error("viscous_friction") > 1.05 * sure.std_error("viscous_friction")


@pytest.mark.parametrize("delay_s", [0.0, 0.01, -0.03, 0.0137, -0.0042])
def test_sampled_values_are_shifted_either_way(delay_s):
    t = 0.01 * np.arange(400)
    # a cubic is shifted exactly; so is anything by whole steps
    values = np.column_stack([1.0 - t + 0.3 * t**3, np.sin(3.0 * t)])
    shifted = shifted_by(values, step_s=0.01, delay_s=delay_s)
    inside = slice(10, 390)
    s = t - delay_s
    np.testing.assert_allclose(shifted[inside, 0], (1.0 - s + 0.3 * s**3)[inside], rtol=1e-12)
    np.testing.assert_allclose(shifted[inside, 1], np.sin(3.0 * s)[inside], atol=1e-7)
    np.testing.assert_allclose(shifted_by(values, step_s=0.01, delay_s=0.0), values, rtol=0.0)


def test_beyond_the_ends_values_are_held():
    values = np.arange(5.0)[:, None]
    np.testing.assert_allclose(shifted_by(values, step_s=1.0, delay_s=2.0)[:, 0], [0, 0, 0, 1, 2])
    np.testing.assert_allclose(shifted_by(values, step_s=1.0, delay_s=-2.0)[:, 0], [2, 3, 4, 4, 4])
