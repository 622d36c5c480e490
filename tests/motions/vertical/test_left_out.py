"""Terms that the model leaves out: the tests tell those that are missed, and no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.estimation.methods import identify, least_squares, reference_iv
from eivor.flights.estimate import instruments
from eivor.flights.motion import VerdictInputs
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.prepared import Difference, SensorAgreement
from eivor.motions.vertical.misspecification import (
    VOLTAGE_CHANGE,
    omitted_variable_numbers,
    omitted_variable_tests,
    report_omitted,
    voltage_numbers,
)
from eivor.motions.vertical.motion import Vertical
from eivor.motions.vertical.verdict import omitted_variable_reasons, sideways_reasons
from flights.flight_logs import GAIN, flown

pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")

VERTICAL = Vertical()


@pytest.fixture(scope="module")
def log():
    return flown(seconds=30.0, seed=5)[0]


def terms_of(log, method=None) -> dict[str, Difference]:
    chosen = method or reference_iv()
    flights = (prepare(log, VERTICAL, FlightOptions()),)
    problem = VERTICAL.problem(flights, instruments(flights, FlightOptions(), chosen).rule)
    return omitted_variable_tests(problem, identify(problem, chosen), flights)


def commanded(log, change):
    """The log of a vehicle that needed another thrust: its mapped command is changed by what is given."""
    command = log.channels["rotor_command_1"]
    values = np.sqrt(change(command.values**2))
    return replace(log, channels={**log.channels, command.name: replace(command, values=values)})


def with_channel(log, name, values):
    like = log.channels["velocity_z"]
    return replace(log, channels={**log.channels, name: replace(like, name=name, values=values)})


@pytest.mark.thorough
def test_nothing_is_missed_where_the_model_holds(log):
    terms = terms_of(with_channel(log, "position_z", log.channels["reference_position_z"].values))
    assert list(terms) == ["quadratic_drag", "ground_effect", "thrust_curvature", "supply"]
    assert min(term.p_value for term in terms.values()) > 0.005
    ((title, sentence),) = report_omitted(omitted_variable_numbers(terms))
    assert title == "left out"
    assert sentence.startswith("not missed: quadratic drag (p ")


@pytest.mark.thorough
def test_quadratic_drag_is_missed(log):
    velocity = log.channels["velocity_z"].values
    terms = terms_of(commanded(log, lambda U: U + 0.2 / GAIN * velocity * np.abs(velocity)))
    drag = terms["quadratic_drag"]
    assert abs(drag.value - 0.2) < 3.0 * drag.half_width
    assert "a drag of 0.2" in report_omitted(omitted_variable_numbers(terms))[0][1]


@pytest.mark.thorough
def test_a_supply_that_sags_is_missed_by_its_voltage_or_by_the_time(log):
    count = log.channels["velocity_z"].values.size
    share = np.linspace(0.0, 1.0, count)
    sags = commanded(log, lambda U: U / (1.0 - 0.1 * share))
    result = terms_of(sags)["supply"]
    assert abs(result.value + 0.105) < 3.0 * result.half_width < 0.1
    ((_, sentence),) = report_omitted(omitted_variable_numbers({"supply": result}))
    assert sentence.startswith("the thrust of one command fell by 1")
    logged = with_channel(sags, "battery_voltage", 12.0 * (1.0 - 0.05 * share))
    volts = terms_of(logged)["supply"]
    assert volts.value == pytest.approx(2.05, abs=3.0 * volts.half_width)  # thrust goes as its square
    change = voltage_numbers([prepare(logged, VERTICAL, FlightOptions())])
    assert change[VOLTAGE_CHANGE] == pytest.approx(0.05 / 0.975, rel=0.05)


def test_thrust_by_a_logged_voltage_is_told_as_that():
    """A vehicle whose thrust fell by 10 % with a voltage that fell by 10 % was said to have gained 100 %."""
    numbers = omitted_variable_numbers({"supply": Difference(1.0, 0.1)}) | {VOLTAGE_CHANGE: 0.1}
    (reason,) = omitted_variable_reasons(at(numbers))
    assert reason.sentence == (
        "The thrust of one command went as the battery's voltage to the power 1 ± 0.21: the voltage changed "
        "by 10%, and the thrust by 10% (± 2%)."
    )
    assert "--term voltage" in reason.remedy
    assert not list(omitted_variable_reasons(at(numbers | {VOLTAGE_CHANGE: 0.01})))


def test_flights_without_a_voltage_among_others_are_told_by_the_time(log):
    volts = with_channel(
        log, "battery_voltage", np.linspace(12.0, 11.0, log.channels["velocity_z"].values.size)
    )
    flights = [prepare(item, VERTICAL, FlightOptions()) for item in (volts, log)]
    assert list(voltage_numbers(flights[:1])) == [VOLTAGE_CHANGE]
    assert voltage_numbers(flights) == voltage_numbers([]) == {}


def test_a_thrust_curve_that_bends_is_missed(log):
    mean = float(np.mean(log.channels["rotor_command_1"].values ** 2))
    bent = commanded(log, lambda U: U + 0.3 * mean * (U / mean - 1.0) ** 2)
    result = terms_of(bent)["thrust_curvature"]
    assert abs(result.value + 0.3) < 3.0 * result.half_width < 0.3
    ((_, sentence),) = report_omitted(omitted_variable_numbers({"thrust_curvature": result}))
    assert sentence.startswith("thrust bends less than the input map: -0.3")


def test_ground_effect_is_missed(log):
    height = log.channels["reference_position_z"].values
    over = height - height.min() + 0.5
    closer = commanded(with_channel(log, "position_z", height), lambda U: U / (1.0 + 0.05 / over**2))
    terms = terms_of(closer)
    assert terms["ground_effect"].p_value < 0.005
    assert "thrust grows towards the ground" in report_omitted(omitted_variable_numbers(terms))[0][1]


def test_without_instruments_nothing_is_tested(log):
    assert terms_of(log, least_squares()) == {}
    assert report_omitted({}) == ()


def at(numbers: dict[str, float], sensors: SensorAgreement | None = None) -> VerdictInputs:
    return VerdictInputs(1, 100.0, 100.0, exogenous=True, direct=False, numbers=numbers, sensors=sensors)


def test_what_is_missed_makes_the_gain_weak():
    sure, unsure = Difference(-0.1, 0.01), Difference(-0.1, 0.1)
    (reason,) = omitted_variable_reasons(
        at(omitted_variable_numbers({"supply": sure, "ground_effect": unsure}))
    )
    assert reason.sentence.startswith("The thrust of one command fell by 10% (± 2%)")
    (reason,) = omitted_variable_reasons(
        at(omitted_variable_numbers({"supply": unsure, "ground_effect": sure}))
    )
    assert reason.sentence.startswith("Thrust falls towards the ground")
    assert not list(omitted_variable_reasons(at(omitted_variable_numbers({"quadratic_drag": sure}))))
    assert not list(
        omitted_variable_reasons(at(omitted_variable_numbers({"supply": Difference(0.01, 0.001)})))
    )


def test_fast_sideways_flight_asks_for_a_known_tilt():
    def agreement(std_error: float) -> SensorAgreement:
        return SensorAgreement({"tilt_x": Difference(0.0, std_error)}, 0.5)

    assert not list(sideways_reasons(at({"sideways_speed": 2.9})))
    assert not list(sideways_reasons(at({"sideways_speed": float("nan")})))
    assert not list(sideways_reasons(at({"sideways_speed": 4.0}, agreement(0.005))))
    (unknown,) = sideways_reasons(at({"sideways_speed": 4.0}))
    assert (
        "4.0 m/s (rms), and the angle between attitude and accelerometer is known not at all."
        in unknown.sentence
    )
    (rough,) = sideways_reasons(at({"sideways_speed": 4.0}, agreement(0.02)))
    assert "is known to ±2.4 degrees only" in rough.sentence
