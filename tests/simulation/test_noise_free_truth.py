"""With no noise and no gust on the linear simulator, every method finds the parameters.

Measured when this was written: with the actual rotor state given, least squares, total least squares and
extended IV find K and K_u to 2e-13, the whitened recipe to 1.6e-3 and 1e-4: it also listens to the
differentiated velocity, whose central difference is not the acceleration at the sample. With commands in
place of the state and the delay known, all find the lag: the recipe to 1.2 ms when the lag is 5 ms, half a
step of the grid, since the central difference also sees the rotor between the samples; to .1 ms when it
is 40 ms or more.

The delay is told from J, which measures the residual in units of its own noise. Without any noise it has
no scale and cannot rank delays; a tenth of a real sensor's noise suffices.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import pytest

from eivor.estimation.methods import TABLE, by_name, identify
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.models.lagged_runs import lag_and_delay
from eivor.models.separable import InstrumentRule, LaggedInputs, LaggedReferences, NoInstruments
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.model import VerticalMotion
from eivor.motions.vertical.motion import Vertical, vertical_flight
from eivor.motions.vertical.regression import VerticalFlights
from eivor.signals.thrust_map import Power
from eivor.simulation.environment import SensorNoise, SimulatedFlight, TrajectoryKind
from eivor.simulation.vertical import STEP_S, VerticalFlightSpec, simulate_vertical_flights
from simulation.rotor_states import actual_state_recording

EXCITATIONS = (TrajectoryKind.STEPS, TrajectoryKind.MULTISINE, TrajectoryKind.CHIRP)
#: Methods that listen to the differentiated velocity too.
WHITENED = ("reference_iv", "whitened_least_squares", "spectral_giv", "whittle_ml")
#: Relative tolerance of K and of K_u.
EXACT, SPECTRAL = 1e-6, 0.015
#: Vehicles at the corners of the study's grid: lag [s], delay [s], K [1/s].
VEHICLES = ((0.005, 0.0, 0.87), (0.04, 0.01, 0.4), (0.12, 0.02, 0.18))
#: Every excitation and every vehicle, not each with each.
CASES = tuple(zip(EXCITATIONS, VEHICLES, strict=True))


def quiet(kind: TrajectoryKind, vehicle: tuple[float, float, float], **changes: object) -> VerticalFlightSpec:
    lag, delay, friction = vehicle
    fields = {"noise": SensorNoise.none(), "trajectory": kind, "seed": 71, "duration": 40.0} | changes
    return VerticalFlightSpec(viscous_friction=friction, actuator_lag=lag, delay=delay, **fields)


QUIET = tuple(quiet(kind, vehicle) for kind, vehicle in CASES)
#: Steps from a level hover: the rotor then starts where its model lets it start, at its first command.
LEVEL = tuple(quiet(TrajectoryKind.STEPS, vehicle, tilt_rms=0.0) for vehicle in VEHICLES)
#: A tenth of the noise of a real sensor.
FAINT = tuple(
    replace(spec, noise=SensorNoise(acceleration=0.04, velocity=0.003, position=0.001, attitude=0.0))
    for spec in QUIET
)


@functools.cache
def flights() -> dict[VerticalFlightSpec, SimulatedFlight]:
    specs = [*QUIET, *LEVEL, *FAINT]
    return dict(zip(specs, simulate_vertical_flights(specs), strict=True))


def told_the_delay(spec: VerticalFlightSpec, method: str) -> dict[str, float]:
    flight = prepare(flights()[spec].recording, Vertical(), FlightOptions())
    rule: InstrumentRule = {
        "reference_iv": LaggedReferences(flight.usable_references),
        "extended_iv": LaggedInputs(),
        "generalized_iv": LaggedReferences(flight.usable_references),
        "generalized_iv_tls": LaggedReferences(flight.usable_references),
    }.get(method, NoInstruments())
    nuisances = lag_and_delay(delays_s=[spec.delay])
    problem = VerticalFlights((vertical_flight(flight),), VerticalMotion(Power(2.0)), rule, nuisances)
    return identify(problem, by_name(method)).parameters


@pytest.mark.thorough
@pytest.mark.parametrize("spec", QUIET, ids=lambda spec: str(spec.trajectory))
@pytest.mark.parametrize("method", list(TABLE))
def test_every_method_recovers_the_parameters_from_the_actual_rotor_state(method, spec):
    recording = actual_state_recording(flights()[spec])
    exact = {"velocity_z": 0.0, "rotor_speed_1": 0.0} if method == "bias_compensated_least_squares" else None
    quantities = identify_flight(recording, FlightOptions(method=method, noise=exact)).quantities
    tolerance = SPECTRAL if method in WHITENED else EXACT
    assert quantities["viscous_friction"].value == pytest.approx(spec.viscous_friction, rel=tolerance)
    assert quantities["input_gain"].value == pytest.approx(spec.input_gain, rel=tolerance)
    # The velocity's derivative carries the balance, hence the difference quotient's error.
    assert quantities["hover_input"].value == pytest.approx(spec.hover_input, rel=1e-4)


@pytest.mark.thorough
@pytest.mark.parametrize("spec", LEVEL, ids=lambda spec: f"lag {spec.actuator_lag}")
@pytest.mark.parametrize("method", [name for name in TABLE if name not in WHITENED])
def test_method_told_the_delay_recovers_the_lag_from_commands(method, spec):
    delay = told_the_delay(spec, method)
    assert delay["actuator_lag"] == pytest.approx(spec.actuator_lag, abs=1e-5)
    assert delay["viscous_friction"] == pytest.approx(spec.viscous_friction, rel=1e-3)
    assert delay["input_gain"] == pytest.approx(spec.input_gain, rel=1e-3)


@pytest.mark.thorough
@pytest.mark.parametrize("spec", QUIET, ids=lambda spec: str(spec.trajectory))
def test_recipe_told_the_delay_recovers_the_lag_from_commands(spec):
    delay = told_the_delay(spec, "reference_iv")
    tolerance = 1.5e-3 if spec.actuator_lag < STEP_S else 2e-4
    assert delay["actuator_lag"] == pytest.approx(spec.actuator_lag, abs=tolerance)
    assert delay["viscous_friction"] == pytest.approx(spec.viscous_friction, rel=SPECTRAL)
    assert delay["input_gain"] == pytest.approx(spec.input_gain, rel=SPECTRAL)


@pytest.mark.thorough
@pytest.mark.parametrize("spec", FAINT, ids=lambda spec: str(spec.trajectory))
def test_recipe_tells_the_delay_from_a_tenth_of_a_sensors_noise(spec):
    quantities = identify_flight(flights()[spec].recording).quantities
    assert quantities["delay"].value == spec.delay
    assert quantities["effective_lag"].value == pytest.approx(spec.actuator_lag + spec.delay, abs=2.5e-3)
    assert quantities["viscous_friction"].value == pytest.approx(spec.viscous_friction, rel=SPECTRAL)
    assert quantities["input_gain"].value == pytest.approx(spec.input_gain, rel=SPECTRAL)
