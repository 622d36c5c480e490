"""Hours in which nothing was logged, or of which nothing is used, cost nothing and change nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flight_logs import STEP_S, changed, flown, prepare_vertical

from eivor.flights.grid import MARGIN_S, MEMORY_S
from eivor.flights.options import FlightOptions
from eivor.models.separable import LaggedInputs
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.motion import Vertical
from eivor.signals.recording import Recording


def jumping(log: Recording, jump_s: float) -> Recording:
    """The log, its clock jumping in the middle."""
    return replace(
        log,
        channels={
            name: replace(
                c, time_s=np.where(np.arange(c.time_s.size) < c.time_s.size // 2, 0.0, jump_s) + c.time_s
            )
            for name, c in log.channels.items()
        },
    )


@pytest.mark.thorough
def test_a_jump_of_the_clock_costs_what_a_pause_costs():
    log = flown(seconds=12.0)[0]
    paused, jumped = (identify_flight(jumping(log, jump_s)) for jump_s in (20.0, 1e6))
    flight = jumped.prepared[0]
    assert flight.signals.sample_count == paused.prepared[0].signals.sample_count
    assert len(flight.runs) == 2
    assert jumped.window_s == pytest.approx((0.0, 1e6 + 12.0 - STEP_S))
    assert jumped.diagnostics["used_s"] == paused.diagnostics["used_s"]
    assert jumped.diagnostics["command_rate_hz"] == pytest.approx(1.0 / STEP_S)
    for name, quantity in paused.quantities.items():
        # stamps of a million seconds are rounded to a tenth of a nanosecond
        assert jumped.quantities[name].value == pytest.approx(quantity.value, abs=1e-3 * quantity.std_error)


@pytest.mark.thorough
def test_only_the_samples_used_are_searched():
    log = flown(seconds=30.0)[0]
    prepared = prepare_vertical(log, FlightOptions(window=(20.0, 24.0)))
    short = prepared.shortened
    assert prepared.signals.sample_count == 3000
    assert short.signals.sample_count == pytest.approx((4.0 + MEMORY_S + MARGIN_S) / STEP_S, abs=2)
    assert short.used_s == prepared.used_s
    np.testing.assert_array_equal(short.grid.time_s[short.used], prepared.grid.time_s[prepared.used])
    np.testing.assert_array_equal(short.used_input, prepared.used_input)
    motion = Vertical()
    for item in ({"actuator_lag": 0.3, "delay": 0.04}, {"actuator_lag": 0.02, "delay": 0.0}):
        whole, cut = (
            motion.problem((flight,), LaggedInputs(1, 20)).rows(item) for flight in (prepared, short)
        )
        for name in ("response", "regressors", "instruments"):
            was = getattr(whole, name)
            np.testing.assert_allclose(getattr(cut, name), was, rtol=0.0, atol=1e-10 * np.abs(was).max())


@pytest.mark.thorough
def test_runs_on_both_sides_of_a_landing_keep_their_samples():
    log = flown(seconds=30.0)[0]
    command = log.channels["rotor_command_1"]
    lost = (command.time_s > 5.0) & (command.time_s < 25.0)
    missing = replace(command, values=np.where(lost, np.nan, command.values))
    prepared = prepare_vertical(changed(log, rotor_command_1=missing), FlightOptions())
    short = prepared.shortened
    assert len(short.runs) == len(prepared.runs) == 2
    assert short.signals.sample_count < prepared.signals.sample_count - 500
    for was, now in zip(prepared.runs, short.runs, strict=True):
        for name in ("velocity_z", "reference_position_z"):
            np.testing.assert_array_equal(
                short.signals.channels[name][now], prepared.signals.channels[name][was]
            )
    before, after = short.runs
    assert not short.usable[before.stop : after.start].all()


def test_a_flight_that_is_used_throughout_is_itself():
    prepared = prepare_vertical(flown(seconds=10.0)[0], FlightOptions())
    assert prepared.shortened is prepared
