"""Where no loop acts on the thrust, it is its own instrument, and serves alone."""

from __future__ import annotations

import numpy as np
import pytest
from flight_logs import changed, channel, flown, prepare_vertical

from eivor.flights.options import FlightOptions
from eivor.motions.identify import identify_flight
from eivor.signals.recording import Recording


@pytest.fixture(scope="module")
def log() -> Recording:
    flight = flown(seconds=20.0, seed=4)[0]
    return changed(flight, "rotor_command_1", input=flight.channel("rotor_command_1").values)


def usable(log: Recording, **open_loop: list[float]) -> dict[str, str]:
    """Remarks on what may serve, with states of the loop at some times."""
    log = changed(log, input_open_loop=channel("landed", open_loop["at"], open_loop["states"]))
    references = prepare_vertical(log, FlightOptions()).references
    return {reference.name: reference.remark for reference in references if reference.usable}


def test_it_serves_alone_where_no_loop_acts(log):
    remarks = usable(log, at=[0.0, 19.9], states=[1.0, 1.0])
    assert list(remarks) == ["input"]
    assert remarks["input"].endswith("no loop acts on it")


def test_it_does_not_serve_where_a_loop_acts_now_and_then_or_nothing_is_known(log):
    assert "input" not in usable(log, at=[0.0, 15.0, 19.9], states=[1.0, 0.0, 0.0])
    flight = prepare_vertical(
        changed(log, input_open_loop=channel("landed", [0.0, 15.0], [1.0, 0.0])), FlightOptions()
    )
    (remark,) = [reference.remark for reference in flight.references if reference.name == "input"]
    assert remark == "a loop acts on it, though for 25% of the flight only"
    assert "input" not in [reference.name for reference in prepare_vertical(log, FlightOptions()).references]


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_the_reason_is_given(log):
    flown_by_hand = changed(log, input_open_loop=channel("landed", [0.0, 19.9], [1.0, 1.0]))
    result = identify_flight(flown_by_hand)
    assert result.instruments == "input"
    (messages,) = [finding.message for finding in result.findings if finding.name == "open_loop_input"]
    assert messages == "No loop acts on the input in this mode of flight: it is its own instrument."
    assert np.isfinite(result.quantities["viscous_friction"].value)
