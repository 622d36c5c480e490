"""One inertia of the rotors for all axes: when it is told, and that it is worth what it claims."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.estimation.methods import by_name, identify
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.quantity import SimpleModel
from eivor.lab.scenario_files import shipped_rigid_body_flight
from eivor.models.lagged_runs import LaggedRuns
from eivor.models.separable import NoInstruments
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.dynamics import effective_parameters
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import (
    GYROSCOPIC_MOMENT,
    PITCH_EQUATION,
    REACTION,
    ROLL_EQUATION,
    YAW_EQUATION,
    InertiaRatios,
    KnownVehicle,
    by_pitch_coupling,
    by_roll_coupling,
    pitch_over_roll,
)
from eivor.motions.rigid_body.verdict import (
    identified_ratios,
    rotor_inertia_ratios,
    with_common_rotor_inertia,
    with_gyroscopic_moments,
)
from eivor.simulation.rigid_body import simulate_rigid_body_flights

SPEC = shipped_rigid_body_flight("crazyflie")
INERTIA_OF_A_ROTOR = 5e-8
SPINNING = replace(SPEC.vehicle, rotors=replace(SPEC.vehicle.rotors, inertia=INERTIA_OF_A_ROTOR))
FIRST, SECOND, THIRD = SPEC.vehicle.inertia[:3]
MOTION = RigidBody(
    KnownVehicle(
        "simulated",
        tuple((x, y) for x, y, _ in SPEC.vehicle.rotors.positions),
        SPEC.vehicle.rotors.spins,
    )
)
METHOD = by_name("whitened_least_squares")
AT = {"actuator_lag": SPEC.vehicle.rotors.lag_up, "delay": 0.0}


@pytest.fixture(scope="module")
def log():
    """A noisy flight of a vehicle whose rotors have inertia."""
    (flight,) = simulate_rigid_body_flights([replace(SPEC, vehicle=SPINNING, duration=20.0, seed=3)])
    return flight.recording


@pytest.fixture(scope="module")
def problem(log) -> LaggedRuns:
    return MOTION.problem((prepare(log, MOTION, FlightOptions()).shortened,), NoInstruments())


def told(vehicle=SPINNING) -> dict[str, float]:
    """Gains and couplings of a vehicle."""
    truth = effective_parameters(vehicle)
    gains = {f"{name}_gain": gain for name, gain in zip(("roll", "pitch"), truth.torque_gains, strict=False)}
    pairs = zip(("roll", "pitch"), truth.gyroscopic_ratios, strict=False)
    return gains | {f"{name}_coupling": ratio for name, ratio in pairs}


def test_ratios_are_those_of_the_inertias():
    values = told()
    assert pitch_over_roll(values) == pytest.approx(SECOND / FIRST)
    for ratio in (by_roll_coupling, by_pitch_coupling):
        assert ratio(values) == pytest.approx(THIRD / FIRST)
    ratios = InertiaRatios.of_values(values)
    assert (ratios.of_axis(ROLL_EQUATION), ratios.of_axis(PITCH_EQUATION)) == pytest.approx(
        (THIRD / FIRST, THIRD / SECOND)
    )


def test_columns_are_sums_of_those_that_they_replace(problem):
    ratios = InertiaRatios(1.7, 1.5)
    problem.bins(AT)  # remembers spectra, which the other problem takes
    linked = with_common_rotor_inertia(problem, ratios)
    anew = replace(linked)  # remembers nothing
    assert rotor_inertia_ratios(problem) is None
    assert rotor_inertia_ratios(linked) == ratios
    assert not set(GYROSCOPIC_MOMENT) & set(linked.parameters)
    names = [parameter.name for parameter in problem.parameters]
    kept = [index for index, parameter in enumerate(problem.parameters) if parameter not in GYROSCOPIC_MOMENT]
    for rows in (linked.bins(AT), anew.bins(AT)):
        expected = problem.bins(AT).regressors
        expected[:, names.index(REACTION.name)] += sum(
            ratio * expected[:, names.index(item.name)]
            for ratio, item in zip((1.7, 1.5), GYROSCOPIC_MOMENT, strict=True)
        )
        np.testing.assert_allclose(rows.regressors, expected[:, kept], rtol=1e-9, atol=1e-12)
    axes = linked.rows(AT).layout.axis_of_row
    reaction = linked.rows(AT).regressors[
        :, [parameter.name for parameter in linked.parameters].index(REACTION.name)
    ]
    assert all(reaction[axes == axis].any() for axis in (ROLL_EQUATION, PITCH_EQUATION, YAW_EQUATION))


@pytest.mark.thorough
def test_a_flight_that_couples_tells_one_inertia_within_its_interval(log, problem):
    free, flight = identify(problem, METHOD), identify_flight(log, model=MOTION, method=METHOD.name)
    assert rotor_inertia_ratios(flight.fit.problem) is not None
    for item, inertia in zip((*GYROSCOPIC_MOMENT, REACTION), (FIRST, SECOND, THIRD), strict=True):
        low, high = flight.quantities[item.name].interval
        assert low <= INERTIA_OF_A_ROTOR / inertia <= high
        assert low > 0.0
    for item in GYROSCOPIC_MOMENT:  # each by itself is told far worse
        assert flight.quantities[item.name].std_error < 0.7 * free.std_error(item.name)
    low, high = flight.quantities["effective_lag"].interval
    assert low <= SPEC.vehicle.rotors.lag_up <= high


def test_couplings_that_are_not_told_leave_three_columns(problem):
    free = identify(problem, METHOD)
    assert identified_ratios(free) is not None
    blind = replace(problem, columns=tuple(uncoupled(column) for column in problem.columns))
    assert identified_ratios(identify(blind, METHOD)) is None


def uncoupled(first):
    """Columns of a flight whose products of rates are hardly there."""
    return replace(first, fixed=first.fixed * np.where(np.arange(first.fixed.shape[1]) < 3, 1e-9, 1.0))


def test_columns_that_say_something_else_than_one_inertia_stay_three(problem):
    """A reaction of yaw by far larger than that of any inertia, as of a motor that is slow to turn."""
    free = identify(problem, METHOD)
    slow = replace(problem, columns=tuple(reacting(column, problem) for column in problem.columns))
    other = identify(slow, METHOD)
    assert other.parameters[REACTION.name] > 10.0 * free.parameters[REACTION.name]
    assert identified_ratios(other) is None


def reacting(first, problem):
    """The axis of yaw with a response that has more of a reaction in it."""
    if first.axis != YAW_EQUATION:
        return first
    names = [parameter.name for parameter in problem.parameters[first.fixed.shape[1] :]]
    index = first.moved.index(names.index(REACTION.name))
    more = 20.0 * INERTIA_OF_A_ROTOR / THIRD * first.moving(AT)[:, index]
    return replace(first, responses=first.responses + more[:, None])


def test_predictions_know_what_all_axes_have():
    values = told() | {REACTION.name: INERTIA_OF_A_ROTOR / THIRD}
    other = {REACTION.name: 2.0}
    spin_moments = with_gyroscopic_moments(
        {"fit": SimpleModel("", values), "other": SimpleModel("", other)}, "fit"
    )
    for item, inertia in zip(GYROSCOPIC_MOMENT, (FIRST, SECOND), strict=True):
        assert spin_moments["fit"].values[item.name] == pytest.approx(INERTIA_OF_A_ROTOR / inertia)
        assert spin_moments["other"].values[item.name] == pytest.approx(2.0 * THIRD / inertia)
    before = {
        "fit": SimpleModel(
            "",
            values
            | {GYROSCOPIC_MOMENT[ROLL_EQUATION].name: 3.0, GYROSCOPIC_MOMENT[PITCH_EQUATION].name: 4.0},
        )
    }
    assert with_gyroscopic_moments(before, "fit") == before
