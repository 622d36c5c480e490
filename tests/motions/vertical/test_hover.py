"""What the autopilot holds its hover input to be, beside the one that is identified."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.flights.options import FlightOptions
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.motions.identify import identify_flight
from eivor.signals.recording import Recording
from flights.flight_logs import changed, channel, flown

HOVER, START, REACH = 0.495, 0.55, 0.2
TIME = np.arange(0.0, 30.0, 0.1)


@pytest.fixture(scope="module")
def log() -> Recording:
    """A flight by thrust, whose hover input is .495."""
    flight = flown(seed=2, noise=0.3)[0]
    commands = flight.channel("rotor_command_1").values
    parameters = {"MPC_THR_HOVER": START, "HTE_THR_RANGE": REACH}
    return replace(
        changed(flight, "rotor_command_1", input=commands), input_map="square", parameters=parameters
    )


def told(log: Recording, values: np.ndarray | None = None, **parameters: float) -> dict[str, str]:
    log = replace(log, parameters=dict(log.parameters) | parameters)
    if values is not None:
        log = changed(log, hover_thrust_estimate=channel("hover_thrust_estimate", TIME, values))
    result = identify_flight(log)
    assert isinstance(result, FlightEstimate)
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
    rough = identify_flight(wrong, FlightOptions(input_map="linear"))
    assert rough.quantities["hover_input"].verdict is Status.WEAK
    rotors = changed(wrong, "input", rotor_command_1=wrong.channel("input").values)
    for result in (rough, identify_flight(rotors)):
        assert not [finding.name for finding in result.findings if finding.name.startswith("hover")]
