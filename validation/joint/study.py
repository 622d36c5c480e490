"""K of flights in gusts by the rigid body and by the vertical motion, and the command that finds out.

    python -m validation.joint.study --size full --kept FILE.jsonl [--page docs/studies/rigid-body.md]

Flights are kept as they are done; a run that was interrupted goes on there.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool
from scipy.spatial.transform import Rotation

from eivor.errors import EivorError
from eivor.flights.identify import identified
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Status
from eivor.lab.disturbances import OrnsteinUhlenbeck
from eivor.lab.study import Share
from eivor.models.separable import Prior
from eivor.motions.identify import identify_flight
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.rigid_body.vehicle import KnownVehicle, Vehicle
from eivor.motions.vertical.motion import Vertical
from eivor.signals.noise import (
    FractionalNoise,
    HeavyTailedNoise,
    MeasurementNoise,
    WhiteNoise,
    fractional_weights,
)
from eivor.simulation.controller import FlightController, Sensor
from eivor.simulation.environment import (
    ACCELERATION_ORDER,
    STUDENT_DOF,
    VELOCITY_ORDER,
    FlightTruth,
    NoiseKind,
)
from eivor.simulation.excitation import RandomSteps
from eivor.simulation.rigid_body import RigidBodyFlight, simulate_rigid_body_flights
from eivor.simulation.rigid_body_spec import AxisExcitations, Logged, RigidBodyFlightSpec, Sensors, Wind
from validation.effective_parameters import effective_parameters
from validation.flight_recipe.rotorpy_flight import RotorpyFlightSpec, rigid_body, vehicle_parameters
from validation.flight_recipe.trials import FlightCase, GridFile, grid_of
from validation.pages import markdown
from validation.studies import Group, KeptRun, KeptStudy, Requirement, share_text


def noise_of(kind: NoiseKind, std: float, order: float, count: int) -> MeasurementNoise:
    """Noise of a kind with a standard deviation over a record of `count` samples."""
    if kind is NoiseKind.WHITE:
        return WhiteNoise(std)
    if kind is NoiseKind.HEAVY_TAILED:
        return HeavyTailedNoise(std, degrees=STUDENT_DOF)
    mean_variance = np.cumsum(fractional_weights(order, count) ** 2).mean()
    return FractionalNoise(float(std / np.sqrt(mean_variance)), order)


#: Of the simulation, and of controller and log [Hz].
SIMULATION_HZ, LOG_HZ = 500.0, 100.0
#: Steps of roll and pitch, and of yaw [rad], and how long a level is held [s].
TILT, TURN, HELD_S = 0.25, 0.5, (0.7, 1.8)
#: Gain towards the place where the flight began [1/s].
HOLD = 0.2


def flight_of(spec: RotorpyFlightSpec) -> RigidBodyFlightSpec:
    """Flight of the whole vehicle with the settings of a flight of the vertical study."""
    vehicle = rigid_body(vehicle_parameters(spec.vehicle, spec.actuator_lag))
    vehicle = replace(vehicle, rotors=replace(vehicle.rotors, delay=spec.delay))
    noise, count = spec.noise, round(spec.duration * SIMULATION_HZ)
    tilt = RandomSteps(TILT, *HELD_S)
    gust = OrnsteinUhlenbeck(spec.gust_rms, spec.gust_correlation)

    def logged(error: MeasurementNoise) -> Sensor:
        return Sensor(error, rate_hz=LOG_HZ)

    return RigidBodyFlightSpec(
        vehicle,
        rate_hz=SIMULATION_HZ,
        duration=spec.duration,
        trajectory=spec.trajectory,
        attitude=AxisExcitations(tilt, tilt, RandomSteps(TURN, *HELD_S)),
        controller=FlightController(rate_hz=LOG_HZ, attitude_hz=LOG_HZ, height_hz=LOG_HZ, hold=HOLD),
        wind=Wind(x=gust, y=gust, z=gust),
        sensors=Sensors(
            angular_rate=logged(WhiteNoise(noise.angular_rate)),
            specific_force=logged(noise_of(noise.kind, noise.acceleration, ACCELERATION_ORDER, count)),
            velocity=logged(noise_of(noise.kind, noise.velocity, VELOCITY_ORDER, count)),
            position=logged(WhiteNoise(noise.position)),
            attitude=logged(WhiteNoise(noise.attitude)),
        ),
        logged=Logged(rotor_command_hz=LOG_HZ, setpoint_hz=LOG_HZ, reference_hz=LOG_HZ),
        seed=spec.seed,
    )


def known(vehicle: Vehicle) -> KnownVehicle:
    """What the identification is told: places and spins of the rotors."""
    rotors = vehicle.rotors
    return KnownVehicle("simulated", tuple((x, y) for x, y, _ in rotors.positions), rotors.spins)


def vertical_truth(flight: RigidBodyFlight, vehicle: Vehicle) -> FlightTruth:
    truth, rotors = flight.truth, vehicle.rotors
    body = Rotation.from_quat(truth.attitude[:, [1, 2, 3, 0]])
    return FlightTruth(
        time_s=truth.time_s,
        specific_force_z=body.apply(truth.specific_force)[:, 2],
        air_velocity_z=truth.air_velocity[:, 2],
        rotor_state=truth.rotor_speed,
        cos_tilt=body.as_matrix()[:, 2, 2],
        actuator_lag=rotors.lag_up,
        delay=rotors.delay,
        viscous_friction=truth.parameters.drag[2],
        input_gain=rotors.count * truth.parameters.thrust_gain,
        hover_input=vehicle.hover_speed,
    )


def effective_vertical(flight: RigidBodyFlight, vehicle: Vehicle, used: Bool[np.ndarray, " n"]) -> float:
    """K of the noise-free vertical motion over some steps [1/s]."""
    return effective_parameters(vertical_truth(flight, vehicle), used, np.square).viscous_friction


def effective_along(flight: RigidBodyFlight, vehicle: Vehicle, used: Bool[np.ndarray, " n"]) -> float:
    """Drag over mass at hover of the noise-free force along the body's z over some steps [1/s]."""
    truth, positions = flight.truth, np.array(vehicle.rotors.positions)
    body = Rotation.from_quat(truth.attitude[:, [1, 2, 3, 0]])
    air = body.inv().apply(truth.air_velocity)
    hub = air[:, None, :] + np.cross(truth.angular_rate[:, None, :], positions[None, :, :])
    speed = truth.rotor_speed
    hover = vehicle.rotors.count * vehicle.hover_speed
    columns = np.column_stack(
        [
            -(speed * hub[:, :, 2]).sum(axis=1) / hover,
            (speed**2).sum(axis=1),
            (hub[:, :, :2] ** 2).sum(axis=(1, 2)),
        ]
    )[used]
    columns -= columns.mean(axis=0)
    force = truth.specific_force[used, 2]
    solution = np.linalg.lstsq(columns / columns.std(axis=0), force - force.mean(), rcond=None)[0]
    return float(solution[0] / columns[:, 0].std())


def used_steps(flight: RigidBodyFlight, prepared: PreparedFlight) -> Bool[np.ndarray, " n"]:
    time_s = prepared.grid.time_s
    used = np.interp(flight.truth.time_s, time_s, prepared.used.astype(np.float64), left=0.0, right=0.0)
    return np.asarray(used > 0.5)


#: Standard error of a lag that is given [s].
GIVEN_STD_S = 0.003
#: Distinguishes the stream of given lags from those of the flight.
GIVEN_KEY = 77
#: Flights that are simulated side by side.
TOGETHER = 9
JOINT, GIVEN, TURNING, ALONE = "rigid body", "lag given", "lag from turning", "alone"
#: Name of K in the results of either motion.
FRICTION = "viscous_friction"
#: Verdict of a flight whose vehicle was lost, or that could not be identified at all.
LOST, FAILED = "lost", "failed"


@dataclass(frozen=True, slots=True)
class Told:
    """What one identification of one flight says of K."""

    flight: str  # Name of the flight, and how it was identified
    formula: str
    verdict: str  # K's own
    of_flight: str  # The overall one
    # Effective value over the samples that were used, estimate and interval [1/s]; zeros without an estimate
    truth: float = 0.0
    value: float = 0.0
    low: float = 0.0
    high: float = 0.0

    @property
    def accepted(self) -> bool:
        return self.verdict == Status.IDENTIFIED.value

    @property
    def held(self) -> bool:
        return self.low <= self.truth <= self.high

    @property
    def length(self) -> float:
        """Of the interval [1/s]; infinite without an estimate."""
        return self.high - self.low if self.verdict not in (LOST, FAILED) else float("inf")


def formulas(
    flight: RigidBodyFlight, vehicle: Vehicle, seed: int
) -> Mapping[str, Callable[[], FlightEstimate]]:
    stream = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(GIVEN_KEY,))))
    reported = vehicle.rotors.lag_up + vehicle.rotors.delay + GIVEN_STD_S * float(stream.standard_normal())
    lag = Prior(max(reported, 0.1 * GIVEN_STD_S), GIVEN_STD_S)
    log = flight.recording
    return {
        JOINT: lambda: identify_flight(log, model=RigidBody(known(vehicle))),
        GIVEN: lambda: identify_flight(log, lag=lag),
        TURNING: lambda: identify_flight(log),
        ALONE: lambda: identified([log], Vertical(), FlightOptions(), [None]),
    }


def strength_of(case: FlightCase, flight: RigidBodyFlight, vehicle: Vehicle) -> list[Told]:
    if not flight.flew:
        return [Told(case.name, formula, LOST, LOST) for formula in (JOINT, GIVEN, TURNING, ALONE)]
    results = []
    for formula, identify in formulas(flight, vehicle, case.spec.seed).items():
        try:
            result = identify()
        except EivorError:
            results.append(Told(case.name, formula, FAILED, FAILED))
            continue
        effective = effective_along if formula == JOINT else effective_vertical
        friction = result.quantities.get(FRICTION)
        if friction is None:  # The rigid body does not tell it of every flight.
            results.append(Told(case.name, formula, FAILED, result.verdict.status.value))
            continue
        results.append(
            Told(
                case.name,
                formula,
                friction.verdict.value,
                result.verdict.status.value,
                effective(flight, vehicle, used_steps(flight, result.prepared[0])),
                friction.value,
                *friction.interval,
            )
        )
    return results


#: What the interval of the coverage must meet, and its confidence level.
COVERAGE, LEVEL = (0.92, 0.98), 0.99


def groups(file: GridFile, size: str, _kept: Path) -> Iterator[Group[tuple[str], Told]]:
    """Flights side by side."""
    grid = grid_of(file)
    cases = {case.name: case for case in (grid if size == "full" else grid.small()).cases}

    def made(keys: list[tuple[str]]) -> Iterator[list[Told]]:
        chosen = [cases[name] for (name,) in keys]
        specs = [flight_of(case.spec) for case in chosen if isinstance(case.spec, RotorpyFlightSpec)]
        flights = simulate_rigid_body_flights(specs)
        for case, spec, flight in zip(chosen, specs, flights, strict=True):
            yield strength_of(case, flight, spec.vehicle)

    names = [(name,) for name in cases]
    for first in range(0, len(names), TOGETHER):
        yield names[first : first + TOGETHER], made


def requirements(run: KeptRun[GridFile, Told]) -> Iterator[Requirement]:
    by = {formula: [item for item in run.lines if item.formula == formula] for formula in (JOINT, GIVEN)}
    joint, given = (sum(item.accepted for item in by[formula]) for formula in (JOINT, GIVEN))
    yield Requirement(
        "flights whose K is identified",
        f"at least {given}, as with the lag given",
        f"{joint}",
        joint >= given,
    )
    ratio = float(np.median(_lengths(run.lines, JOINT)))
    what = "length of K's interval over that with the lag given, median"
    yield Requirement(what, "at most 1", f"{ratio:.2f}", ratio <= 1.0)
    covered = _coverage(by[JOINT])
    low, high = covered.interval
    yield Requirement(
        "coverage of K where it is identified",
        f"99 % interval meets {COVERAGE[0]} to {COVERAGE[1]}",
        share_text(covered, 2),
        low <= COVERAGE[1] and high >= COVERAGE[0],
    )


FORMULAS = (JOINT, GIVEN, TURNING, ALONE)
HEADER = (
    *("", "K identified", "flight identified", "length over lag given", "median size of error", "coverage"),
)


def tables(run: KeptRun[GridFile, Told]) -> Iterator[str]:
    lost = len({item.flight for item in run.lines if item.verdict == LOST})
    yield f" of {len({item.flight for item in run.lines})} flights, of which {lost} were lost."
    yield markdown(HEADER, [(formula, *_cells(run.lines, formula)) for formula in FORMULAS])


def _cells(lines: Sequence[Told], formula: str) -> tuple[str, ...]:
    selected = [item for item in lines if item.formula == formula]
    errors = [abs(item.value / item.truth - 1.0) for item in selected if np.isfinite(item.length)]
    flights = sum(item.of_flight == Status.IDENTIFIED.value for item in selected)
    return (
        f"{sum(item.accepted for item in selected)} of {len(selected)}",
        f"{flights} of {len(selected)}",
        f"{float(np.median(_lengths(lines, formula))):.2f}",
        f"{float(np.median(errors)):.1%}".replace("%", " %"),
        share_text(_coverage(selected), 2),
    )


def _lengths(lines: Sequence[Told], formula: str) -> list[float]:
    """Length of K's interval over that with the lag given, of every flight that has both."""
    given = {item.flight: item.length for item in lines if item.formula == GIVEN}
    both = (item for item in lines if item.formula == formula and np.isfinite(item.length))
    return [item.length / given[item.flight] for item in both if np.isfinite(given[item.flight])]


def _coverage(lines: Sequence[Told]) -> Share:
    held = [item.held for item in lines if item.accepted]
    return Share(sum(held), len(held), LEVEL)


STUDY = KeptStudy(
    "joint.study",
    __doc__,
    "joint",
    GridFile,
    Told,
    ("flight",),
    groups,
    requirements,
    tables,
    "K in gusts, attitude and height excited",
)
main = STUDY.main


if __name__ == "__main__":
    sys.exit(main())
