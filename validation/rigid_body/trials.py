"""Trials of the study: flights are flown, logged and identified; a row is what came of a quantity."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np

from eivor.errors import EivorError
from eivor.lab.disturbances import OrnsteinUhlenbeck
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.dynamics import EffectiveParameters, effective_parameters
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.regression import ALONG, COUPLING, DAMPING, DRAG, GAIN, LIFT, THRUST
from eivor.motions.rigid_body.vehicle import KnownNumber, KnownVehicle
from eivor.motions.rigid_body.vehicle import Vehicle as FlownBody
from eivor.signals.noise import WhiteNoise
from eivor.signals.recording import Recording
from eivor.simulation.controller import FlightController, Sensor
from eivor.simulation.environment import TrajectoryKind
from eivor.simulation.excitation import FilteredWhite, RandomSteps
from eivor.simulation.rigid_body import (
    AxisExcitations,
    Logged,
    RigidBodyFlightSpec,
    Sensors,
    TorqueDisturbance,
    simulate_rigid_body_flights,
)
from eivor.tools import Float
from validation.flight_recipe.rotorpy_flight import Vehicle, rigid_body, vehicle_parameters
from validation.rigid_body.rotorpy import LOGGED, logged_flight
from validation.studies import GridStruct, Row, StudyFolder, Task, read_as, tasks_of

LAG = "effective_lag"
GROUPS = {
    "torque gains": tuple(item.name for item in GAIN),
    "gyroscopic ratios": tuple(item.name for item in COUPLING),
    "rate damping": tuple(item.name for item in DAMPING),
    "lag": (LAG,),
    "thrust gain": (THRUST.name,),
    "vertical drag": (DRAG[ALONG.index("z")].name,),
    "horizontal drag": tuple(item.name for item in DRAG if not item.name.endswith("z")),
    "translational lift": (LIFT.name,),
}
#: A ratio nearer to zero than this is compared absolutely.
NEARLY_ZERO = 0.1


def truth_of(parameters: EffectiveParameters) -> dict[str, float]:
    selected = (
        *zip(GROUPS["torque gains"], parameters.torque_gains, strict=True),
        *zip(GROUPS["gyroscopic ratios"], parameters.gyroscopic_ratios, strict=True),
        *zip(GROUPS["rate damping"], parameters.rate_damping, strict=True),
        *zip((item.name for item in DRAG), parameters.drag, strict=True),
    )
    return {
        **dict(selected),
        THRUST.name: parameters.thrust_gain,
        LIFT.name: parameters.translational_lift,
        LAG: parameters.lag_up + parameters.delay,
    }


def unit_of_error(name: str, truth: float) -> float:
    """What errors of a quantity are told in: the truth, or one for a ratio that is nearly zero."""
    return 1.0 if name in GROUPS["gyroscopic ratios"] and abs(truth) < NEARLY_ZERO else abs(truth)


GRID = Path(__file__).with_name("grid.toml")


class Scenario(GridStruct, frozen=True, kw_only=True):
    name: str  # What they are
    seed: int  # Seed of the first flight, and flights of each vehicle
    count: int = msgspec.field(name="flights")
    vehicles: tuple[str, ...] = (Vehicle.CRAZYFLIE,)  # What flies, families where RotorPy does
    rotorpy: bool = False  # Closed loops of RotorPy, of which nothing but seed and flights is changed
    methods: tuple[str, ...]  # What identifies; the first one is judged
    # Bounds by group of quantities, relative to the truth: of every error, of the root of their mean square,
    # of the size of their mean
    largest: dict[str, float] = msgspec.field(default_factory=dict)
    rmse: dict[str, float] = msgspec.field(default_factory=dict)
    bias: dict[str, float] = msgspec.field(default_factory=dict)
    coverage_each: float = 0.0  # What each quantity's coverage may be; zero where nothing is asked
    # Between which the coverage of all quantities with a bound lies; empty where nothing is asked
    coverage_pooled: tuple[float, ...] = ()
    others: int = 0  # So many flights are identified by methods other than the first
    noise: float = 1.0  # Of the sensors, times the nominal one
    delay_s: float = msgspec.field(name="delay", default=0.0)  # From a rotor's command to its first effect
    # What that is taken for [s]; None where it is searched for
    taken_delay_s: float | None = msgspec.field(name="taken_delay", default=None)
    # Standard deviation of every stamp's error [s]; with it channels are logged out of step
    jitter_s: float = msgspec.field(name="jitter", default=0.0)
    command_hz: float = 0.0  # At which rotor commands are logged [Hz]; all of them where zero
    filtered: bool = False  # Gyroscope and accelerometer have filters onboard
    torque: float = 0.0  # Standard deviation of what the air does about each axis [rad/s^2]
    injected: float = 0.0  # Standard deviation of what is added to the normalised torque setpoints
    quickness: float = 0.6  # Of the controller, see `FlightController`
    derivative_share: float = 0.0

    def __post_init__(self) -> None:
        if not set(self.groups) <= set(GROUPS):
            raise ValueError(f"groups out of {', '.join(GROUPS)}")

    @property
    def groups(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys([*self.largest, *self.rmse, *self.bias]))


class Grid(GridStruct, frozen=True):
    name: str  # Of the grid
    seconds: float  # Of a flight [s]
    scenarios: tuple[Scenario, ...] = msgspec.field(name="scenario")  # In the order of the file

    def scenario(self, name: str) -> Scenario:
        return next(item for item in self.scenarios if item.name == name)


@cache
def published_grid() -> Grid:
    return read_as(Grid, GRID)


CONTROLLER_HZ, FINE_HZ = 500.0, 1000.0
#: Onboard filters [Hz].
GYROSCOPE_CUTOFF_HZ, ACCELEROMETER_CUTOFF_HZ = 80.0, 30.0
#: Nominal noise: gyroscope [rad/s], accelerometer [m/s^2], velocity [m/s], position [m], attitude [rad].
NOISE = (0.02, 0.5, 0.05, 0.01, 0.002)
#: Rates [Hz] and first instants [s] of the same sensors where they are out of step.
OUT_OF_STEP = ((1000.0 / 3.0, 0.001), (250.0, 0.003), (100.0, 0.007), (100.0, 0.006), (200.0, 0.002))
#: Correlation of the torques of the air [s].
TORQUE_S = 0.3
#: Jitter moves no stamp further than this share of the distance to the next.
LARGEST_JITTER = 0.45


def flown_vehicle(vehicle: str, scenario: Scenario) -> FlownBody:
    body = rigid_body(vehicle_parameters(vehicle, None))
    delay_s = LOGGED[vehicle][1] if scenario.rotorpy else scenario.delay_s
    return replace(body, rotors=replace(body.rotors, delay=delay_s))


def known_vehicle(vehicle: str, scenario: Scenario) -> KnownVehicle:
    rotors, taken = flown_vehicle(vehicle, scenario).rotors, scenario.taken_delay_s
    return KnownVehicle(
        str(vehicle),
        tuple((x, y) for x, y, _ in rotors.positions),
        rotors.spins,
        delay=None if taken is None else KnownNumber(taken),
        gyro_cutoff_hz=GYROSCOPE_CUTOFF_HZ if scenario.filtered else None,
        accelerometer_cutoff_hz=ACCELEROMETER_CUTOFF_HZ if scenario.filtered else None,
    )


def flight_of(vehicle: str, scenario: Scenario, seconds: float, number: int) -> RigidBodyFlightSpec:
    air = OrnsteinUhlenbeck(scenario.torque, TORQUE_S) if scenario.torque else None
    added = FilteredWhite(scenario.injected, 0.5, 8.0) if scenario.injected else None
    all_hz = CONTROLLER_HZ if scenario.jitter_s else 0.0  # Of every command and setpoint
    return RigidBodyFlightSpec(
        flown_vehicle(vehicle, scenario),
        rate_hz=FINE_HZ if scenario.jitter_s else CONTROLLER_HZ,
        duration=seconds,
        trajectory=TrajectoryKind.MULTISINE,
        controller=FlightController(quickness=scenario.quickness, derivative_share=scenario.derivative_share),
        attitude=AxisExcitations(RandomSteps(0.25), RandomSteps(0.25), FilteredWhite(0.5, 0.05, 0.6)),
        injection=AxisExcitations(added, added, added),
        torque_disturbance=TorqueDisturbance(air, air, air),
        sensors=_sensors(scenario),
        logged=Logged(scenario.command_hz or all_hz, all_hz, all_hz),
        seed=scenario.seed + number,
    )


def _sensors(scenario: Scenario) -> Sensors:
    filters = (GYROSCOPE_CUTOFF_HZ, ACCELEROMETER_CUTOFF_HZ) if scenario.filtered else (0.0, 0.0)
    sensors = []
    for number, std in enumerate(NOISE):
        sensor = Sensor(WhiteNoise(scenario.noise * std), cutoff_hz=(*filters, 0.0, 0.0, 0.0)[number])
        if scenario.jitter_s:
            rate_hz, first_s = OUT_OF_STEP[number]
            sensor = replace(sensor, rate_hz=rate_hz, offset_s=first_s, jitter_s=scenario.jitter_s)
        sensors.append(sensor)
    return Sensors(*sensors)


def jittered(log: Recording, std_s: float, seed: int) -> Recording:
    """Log in which stamps of commands, setpoints and references err, as those of its sensors do already."""
    if not std_s:
        return log
    rng = np.random.default_rng((seed, 1))
    moved: dict[bytes, Float[np.ndarray, " n"]] = {}
    channels = dict(log.channels)
    for name, channel in channels.items():
        if channel.held:
            group = channel.time_s.tobytes()
            if group not in moved:
                moved[group] = _moved(channel.time_s, std_s, rng)
            channels[name] = replace(channel, time_s=moved[group])
    return replace(log, channels=channels)


def _moved(
    time_s: Float[np.ndarray, " n"], std_s: float, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    most = LARGEST_JITTER * float(np.diff(time_s).min())
    return time_s + np.clip(std_s * rng.standard_normal(time_s.size), -most, most)


#: Flights of a task, which are simulated side by side.
FLIGHTS_TOGETHER = 10
#: Value, interval and verdict of a flight that was lost or not taken.
_FAILED = (np.nan, np.nan, np.nan, "failed")
COLUMNS = ("scenario", "vehicle", "number", "method", "quantity", "truth", "value", "low", "high", "verdict")


def folder_of(path: Path, grid: Grid, share: float, word: str) -> StudyFolder:
    """First flights of scenarios whose name holds a word."""
    planned = sum(scenario.count * len(scenario.vehicles) for scenario in grid.scenarios)
    tasks = [
        task
        for number, each in enumerate(grid.scenarios, start=1)
        if word in each.name
        for vehicle in each.vehicles
        for task in tasks_of(
            (each.name, vehicle),
            f"scenario-{number:02d}-{vehicle}",
            max(1, round(share * each.count)),
            FLIGHTS_TOGETHER,
        )
    ]
    text = GRID.read_text(encoding="utf-8")
    return StudyFolder(path, tasks, grid.name, text, "validation.rigid_body", planned, rows_of)


def rows_of(task: Task) -> tuple[Row, ...]:
    """Rows of a task: one for each flight, method and quantity."""
    grid, (name, vehicle) = published_grid(), task.of
    scenario, numbers = grid.scenario(name), range(task.first, task.last)
    truth = truth_of(effective_parameters(flown_vehicle(vehicle, scenario)))
    motion, rows = RigidBody(known_vehicle(vehicle, scenario)), list[Row]()
    for number, log in zip(numbers, logs_of(vehicle, scenario, grid.seconds, numbers), strict=True):
        for method in scenario.methods if number < scenario.others else scenario.methods[:1]:
            results = {} if log is None else _report(log, motion, method)
            for quantity, true in truth.items():
                row = (name, vehicle, number, method, quantity, true, *results.get(quantity, _FAILED))
                rows.append(dict(zip(COLUMNS, row, strict=True)))
    return tuple(rows)


def logs_of(
    vehicle: str, scenario: Scenario, seconds: float, numbers: Sequence[int]
) -> Iterator[Recording | None]:
    """Logs of flights, None of one that was lost."""
    seeds = [scenario.seed + number for number in numbers]
    if scenario.rotorpy:
        yield from (logged_flight(vehicle, seed, seconds, NOISE) for seed in seeds)
        return
    flights = simulate_rigid_body_flights(
        [flight_of(vehicle, scenario, seconds, number) for number in numbers]
    )
    for seed, flight in zip(seeds, flights, strict=True):
        yield jittered(flight.recording, scenario.jitter_s, seed) if flight.flew else None


def _report(log: Recording, motion: RigidBody, method: str) -> dict[str, tuple[float, float, float, str]]:
    """Value, interval and verdict of every quantity; nothing of a flight that is not taken."""
    try:
        result = identify_flight(log, model=motion, method=method)
    except EivorError:
        return {}
    return {
        name: (quantity.value, *quantity.interval, quantity.verdict.value)
        for name, quantity in result.quantities.items()
    }
