"""The vertical motion as the recipe and the reports see it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import eivor as ev
from coarse_search import coarse
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.logs.read import example_flight
from eivor.motions.vertical.motion import Vertical, vertical_flight


@pytest.fixture(scope="module")
def fit() -> ev.FlightEstimate:
    with coarse():
        return ev.identify_flight(example_flight(), FlightOptions(window=(0.0, 20.0)))


@pytest.mark.thorough
def test_every_quantity_is_worded_and_in_the_order_of_results(fit):
    always = {name: wording for name, wording in Vertical.wording.items() if not wording.optional}
    assert list(fit.quantities) == list(always)
    assert {name: quantity.unit for name, quantity in fit.quantities.items()} == {
        name: wording.unit for name, wording in always.items()
    }


def test_excitation_is_that_of_the_runs(fit):
    (flight,) = fit.prepared
    excitation = Vertical().excitation(fit.prepared)
    command, speed = flight.used_input, flight.signals.channel("velocity_z")[flight.used]
    mapped = (command**2).mean(axis=1) * flight.signals.channel("cos_tilt")[flight.used]
    assert excitation == (
        f"The input varied by {mapped.std() / mapped.mean():.1%} and the vertical speed by "
        f"{speed.std():.2g} m/s (standard deviations)."
    )


def test_an_input_of_zero_says_nothing_of_its_variation():
    log = example_flight()
    off = {
        name: replace(channel, values=np.zeros_like(channel.values))
        for name, channel in log.channels.items()
        if name.startswith("rotor_command")
    }
    idle = replace(log, channels={**log.channels, **off, "landed": replace(off["rotor_command_1"])})
    flight = prepare(idle, Vertical(), FlightOptions())
    assert flight.runs
    assert Vertical().excitation((flight,)) == ""


def test_the_trace_is_the_measured_acceleration_and_the_model(fit):
    (trace,) = Vertical().traces(fit.fit.problem, fit.estimate)
    best, flight = fit.estimate.best, vertical_flight(fit.prepared[0])
    (force,) = flight.cut(flight.acceleration[:, None])
    np.testing.assert_allclose(trace.measured, force[:, 0] - force.mean(), atol=1e-12)
    (speed,) = flight.cut(flight.velocity[:, None])
    friction = -best.theta[0] * (speed[:, 0] - speed.mean())
    np.testing.assert_allclose(trace.predicted, trace.driven + friction, atol=1e-12)


def test_the_delay_is_a_choice(fit):
    delay = fit.quantities["delay"]
    assert delay.choice is not None
    assert delay.choice.tried == (0.0, 0.005, 0.01, 0.02)  # a coarse search's
    assert (delay.choice.fitting[0], delay.choice.fitting[-1]) == delay.interval
