"""What references can tell of a pool's lag."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from validation.real_logs.closed_loop import FlightSpec, Reference, VehicleSpec
from validation.real_logs.pool_information import PART, flight_information, lag_bound, main
from validation.real_logs.trials import published_grid


def _sine(frequency, friction, gusts=0.2):
    vehicle = VehicleSpec(viscous_friction=friction, gust_rms=gusts)
    return FlightSpec(vehicle=vehicle, reference=Reference.SINE, frequency=frequency, duration=10.0)


@pytest.mark.thorough
def test_stronger_gusts_tell_less():
    weak, strong = (flight_information(_sine(0.3, 0.4, gusts)) for gusts in (0.1, 0.4))
    assert np.all(np.linalg.eigvalsh(weak - strong) > -1e-9 * np.abs(weak).max())
    assert weak[1, 1] > 2.0 * strong[1, 1]


@pytest.mark.thorough
def test_a_delay_that_is_known_narrows_the_lag_and_so_does_a_second_flight():
    flights = [_sine(frequency, friction) for frequency, friction in ((0.3, 0.2), (0.6, 0.6))]
    bound = lag_bound(flights)
    assert bound.delay_known < bound.delay_free
    assert lag_bound([*flights, _sine(0.3, 0.4)]).delay_known < bound.delay_known


def test_frictions_that_differ_tell_the_lag_of_one_frequency():
    separated, equal = (
        lag_bound([_sine(0.3, friction) for friction in frictions])
        for frictions in ((0.2, 0.6), (0.39, 0.41))
    )
    assert equal.delay_known > 5.0 * separated.delay_known


@pytest.mark.thorough
def test_quicker_references_tell_more(tmp_path, capsys):
    page = tmp_path / "page.md"
    page.write_text(f"<!-- generated: {PART} -->\n<!-- end: {PART} -->\n")
    assert main(["--pools", "1", "--page", str(page)]) == 0
    assert capsys.readouterr().out.strip() in page.read_text()
    family = published_grid().family("pools with two reference frequencies")
    flights = [family.flight(number) for number in range(6)]
    quicker = [replace(flight, frequency=2.0 * flight.frequency) for flight in flights]
    assert lag_bound(quicker).delay_known < lag_bound(flights).delay_known
