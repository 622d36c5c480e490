"""Logs as they are: the simulator's physics and loggers, the study's requirements, bounds of pools."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace as struct_replace

from eivor.motions.vertical.model import GRAVITY
from eivor.signals.filters import actuator_state
from eivor.simulation.environment import SensorNoise
from validation.real_logs import study
from validation.real_logs.closed_loop import STEP_S, FlightSpec, LoggerSpec, Reference, VehicleSpec
from validation.real_logs.flights import LoggedFlight, logged_flight
from validation.real_logs.study import far_off
from validation.real_logs.trials import folder_of, published_grid

QUIET = LoggerSpec(noise=SensorNoise.none())


def flown(vehicle: VehicleSpec, logger: LoggerSpec = QUIET, **flight) -> LoggedFlight:
    chosen = {"duration": 4.0, "reference": Reference.CHIRP, "seed": 7} | flight
    return logged_flight(FlightSpec(vehicle, logger, **chosen))


def effective(flight: LoggedFlight) -> dict[str, float]:
    time = flight.flown.truth.time_s
    return flight.flown.effective(time, np.ones(time.size, dtype=bool))


def test_motion_obeys_its_equation():
    truth = (flight := flown(VehicleSpec(gust_rms=0.5, horizontal_friction=0.4)).flown).truth
    thrust = GRAVITY / 0.5**2 * truth.cos_tilt * truth.rotor_state[:, 0] ** 2
    np.testing.assert_allclose(truth.specific_force_z, thrust - 0.4 * truth.air_velocity_z, atol=1e-9)
    gained = np.diff(flight.velocity) / STEP_S
    middle = 0.5 * (truth.specific_force_z[1:] + truth.specific_force_z[:-1]) - GRAVITY
    assert np.abs(gained - middle).max() < 0.06 * np.abs(middle).max()
    assert abs((gained - middle).mean()) < 1e-3


def test_rotor_follows_its_command_with_lag_and_delay():
    flight = flown(VehicleSpec(actuator_lag=0.05, delay=0.02)).flown
    expected = actuator_state(flight.command, step_s=STEP_S, lag_s=0.05, delay_s=0.02)
    np.testing.assert_allclose(flight.truth.rotor_state[600:], expected[600:], atol=1e-11)


def test_effective_values_are_nominal_where_the_model_holds():
    result = effective(
        flown(VehicleSpec(actuator_lag=0.03, delay=0.01, updraft=1.0, horizontal_friction=0.4))
    )
    assert result["viscous_friction"] == pytest.approx(0.4, abs=1e-6)
    assert result["input_gain"] == pytest.approx(GRAVITY / 0.25, rel=1e-6)
    assert result["effective_lag"] == pytest.approx(0.04)
    # An updraft of 1 m/s carries K of the weight, and half of its share is the share of the command.
    assert result["hover_input"] == pytest.approx(0.5 * (1.0 - 0.4 / GRAVITY) ** 0.5, rel=1e-3)


GRID = published_grid()


@pytest.mark.calibration
def test_small_size(tmp_path):
    """A few flights of the families of clocks: accepted, and few intervals miss."""
    grid = study.part_of(GRID, 0.025, "r")
    families = tuple(
        family
        for family in grid.families
        if family.holds == "yes" and family.flight(0).duration < 100.0 and not family.flight(0).multirotor
    )
    folder = folder_of(tmp_path, struct_replace(grid, families=families[:3]))
    folder.run(1)
    table = folder.gathered().rows
    assert table.height >= 12
    assert (table["verdict"] == "identified").mean() > 0.6
    assert far_off(table).value < 0.2
