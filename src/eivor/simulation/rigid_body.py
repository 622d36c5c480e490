"""Simulated flights of whole vehicles: specification, log and truth."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from fnmatch import fnmatch
from itertools import count, groupby
from operator import attrgetter
from typing import Annotated, TypeAlias

import numpy as np

from eivor import checks
from eivor.errors import ParameterError
from eivor.motions.rigid_body import dynamics
from eivor.motions.rigid_body.dynamics import Body, Triple, Value, coefficients_of, specific_force
from eivor.motions.rigid_body.vehicle import Rotors, Vehicle
from eivor.signals.channels import roll_pitch_yaw
from eivor.signals.noise import WhiteNoise
from eivor.signals.recording import CONTROLLER_RATE, Channel, Frame, Recording
from eivor.simulation import controller, environment
from eivor.simulation.controller import FlightController, LiveFilter, Sensor, control_effectiveness, gains_of
from eivor.simulation.environment import KnownLog
from eivor.simulation.excitation import Disturbance, Excitation
from eivor.strict_toml import package_tables
from eivor.tools import Float

#: State of the body, and of its rotors.
StepResult: TypeAlias = tuple[Body, list[Value]]

#: State of body and rotors a step later, of a flight or of several side by side, under what is held over it:
#: commands, velocity of the air in the world [m/s], and torque from outside on the body's axes [N m].
Stepper: TypeAlias = Callable[[Body, Sequence[Value], Sequence[Value], Triple, Triple], StepResult]
#: Neither wind nor torque.
STILL: Triple = (0.0, 0.0, 0.0)


def runge_kutta(coefficients: dynamics.Coefficients, step_s: float) -> Stepper:
    """Return steps of this length [s] by the classical method of the fourth order."""
    c, h = coefficients, step_s
    half_step = rotor_response(c, h / 2.0)

    def spin_up(speeds: Sequence[Value], command: Sequence[Value]) -> Sequence[Value]:
        return dynamics.speed_derivative(c, speeds, command) if c.gyroscopic else ()

    def step(
        body: Body, speeds: Sequence[Value], command: Sequence[Value], wind: Triple, disturbance: Triple
    ) -> StepResult:
        middle = half_step(speeds, command)
        end, acceleration = half_step(middle, command), spin_up(middle, command)
        k1 = dynamics.body_derivative(c, body, speeds, spin_up(speeds, command), wind, disturbance)
        k2 = dynamics.body_derivative(c, _stepped(body, k1, h / 2.0), middle, acceleration, wind, disturbance)
        k3 = dynamics.body_derivative(c, _stepped(body, k2, h / 2.0), middle, acceleration, wind, disturbance)
        k4 = dynamics.body_derivative(c, _stepped(body, k3, h), end, spin_up(end, command), wind, disturbance)
        # Six times the mean slope.
        slope = [p + 2.0 * (q + r) + s for p, q, r, s in zip(k1, k2, k3, k4, strict=True)]
        return _unit_attitude(_stepped(body, slope, h / 6.0)), end

    return step


def rotor_response(
    coefficients: dynamics.Coefficients, time_s: float
) -> Callable[[Sequence[Value], Sequence[Value]], list[Value]]:
    """Closed-form response of rotor speeds to a held command over a time."""
    down = _decay(time_s * coefficients.rate_down)
    difference = _decay(time_s * coefficients.rate_up) - down

    def response(speeds: Sequence[Value], command: Sequence[Value]) -> list[Value]:
        return [
            item + (speed - item) * (down + difference * (item > speed))
            for speed, item in zip(speeds, command, strict=True)
        ]

    return response


def _decay(lags: Value) -> Value:
    return math.exp(-lags) if isinstance(lags, float) else np.exp(-lags)


def _stepped(state: Body, slope: Sequence[Value], time_s: float) -> Body:
    if isinstance(state, np.ndarray):
        return state + time_s * np.array(slope)
    return [x + time_s * k for x, k in zip(state, slope, strict=True)]


def _unit_attitude(body: Body) -> Body:
    w, x, y, z = body[6:10]
    scale = (w * w + x * x + y * y + z * z) ** -0.5
    if isinstance(body, np.ndarray):
        body[6:10] *= scale
    else:
        body[6:10] = [w * scale, x * scale, y * scale, z * scale]
    return body


def _noisy(std: float) -> Sensor:
    return Sensor(noise=WhiteNoise(std))


@dataclass(frozen=True, slots=True)
class AxisExcitations:
    """A series about each axis of the body, or none."""

    roll: Excitation | None = None  # About the axes that point forward, left and up
    pitch: Excitation | None = None
    yaw: Excitation | None = None


@dataclass(frozen=True, slots=True)
class TorqueDisturbance:
    """Torques from outside, as the angular acceleration that each would give by itself."""

    roll: Disturbance | None = None  # About the axes that point forward, left and up [rad/s^2]
    pitch: Disturbance | None = None
    yaw: Disturbance | None = None


@dataclass(frozen=True, slots=True)
class Wind:
    """Velocity of the air in the world."""

    steady: tuple[float, ...] = (0.0, 0.0, 0.0)  # What does not change, on three axes [m/s]
    x: Disturbance | None = None  # Gusts along each axis of the world [m/s]
    y: Disturbance | None = None
    z: Disturbance | None = None

    def __post_init__(self) -> None:
        if len(self.steady) != 3 or not all(abs(speed) <= 50.0 for speed in self.steady):
            expected = "a steady wind of three speeds up to 50 m/s"
            raise ParameterError(expected, f"{self.steady}", "Correct the wind.")


@dataclass(frozen=True, slots=True)
class Sensors:
    """What the vehicle measures; a sensor that is described has the noise of its description, else none."""

    # Body rates [rad/s], which the rate loop gets; of .02 rad/s of white noise when left out
    angular_rate: Sensor = field(default_factory=lambda: _noisy(0.02))
    # Accelerometer in the centre of mass [m/s^2]; of .5 m/s^2
    specific_force: Sensor = field(default_factory=lambda: _noisy(0.5))
    # In the world [m/s, m]; of .05 m/s and .02 m
    velocity: Sensor = field(default_factory=lambda: _noisy(0.05))
    position: Sensor = field(default_factory=lambda: _noisy(0.02))
    # Its errors are small rotations about the body's axes [rad]; of .002 rad. It has no filter
    attitude: Sensor = field(default_factory=lambda: _noisy(0.002))
    rotor_speed: Sensor | None = None  # [rad/s]; not logged when left out

    def __post_init__(self) -> None:
        if self.attitude.cutoff_hz:
            remedy = "Leave it out: quaternions are not averaged part by part."
            received = f"cutoff_hz={self.attitude.cutoff_hz:g}"
            raise ParameterError("an attitude without a filter", received, remedy)


@dataclass(frozen=True, slots=True)
class Logged:
    """How often what is no measurement is logged; at every step of the simulation where zero."""

    rotor_command_hz: Annotated[float, (0.0, 1e5)] = 0.0  # Commands of the rotors [Hz]
    # Setpoints of thrust, torques and rates, and injected torques [Hz]: the values of that moment
    setpoint_hz: Annotated[float, (0.0, 1e5)] = 0.0
    reference_hz: Annotated[float, (0.0, 1e5)] = 0.0  # References of height and attitude [Hz]
    omitted: tuple[str, ...] = ()  # Channels that are not logged, `rotor_command_*` for those of all rotors

    def __post_init__(self) -> None:
        checks.in_ranges(self, "Correct it.")


@dataclass(frozen=True, slots=True)
class RigidBodyFlightSpec:
    """Everything that a flight is a function of."""

    vehicle: Vehicle  # What flies
    # Steps of the simulation per second [Hz], over which commands, wind and torques from outside are held
    rate_hz: Annotated[float, (20.0, 1e4)] = 500.0
    duration: Annotated[float, (0.1, 3600.0)] = 30.0  # Of the flight [s]
    trajectory: environment.TrajectoryKind = environment.TrajectoryKind.MULTISINE  # The height reference
    # Share of the speed and acceleration that an excitation of the height may reach
    vigour: Annotated[float, (0.01, 2.0)] = 1.0
    # Roll, pitch and yaw that are requested [rad], yaw first
    attitude: AxisExcitations = field(default_factory=AxisExcitations)
    # What is added to the normalised torque setpoints
    injection: AxisExcitations = field(default_factory=AxisExcitations)
    controller: FlightController = field(default_factory=FlightController)  # Its loops
    wind: Wind = field(default_factory=Wind)  # Of the air
    torque_disturbance: TorqueDisturbance = field(default_factory=TorqueDisturbance)  # From outside
    sensors: Sensors = field(default_factory=Sensors)  # What is measured, and how
    logged: Logged = field(default_factory=Logged)  # How often the rest is logged
    seed: Annotated[int, (0, 2**63)] = 0  # Of the random streams

    def __post_init__(self) -> None:
        checks.in_ranges(self, "Correct the flight's description.")
        for name in ("rate_hz", "attitude_hz", "height_hz"):
            self._check(f"{name} of the controller", self.rate_hz / getattr(self.controller, name))
        self._check("attitude_hz of the controller", self.controller.rate_hz / self.controller.attitude_hz)
        self._check("height_hz of the controller", self.controller.rate_hz / self.controller.height_hz)
        steps = self.vehicle.rotors.delay * self.rate_hz
        if abs(steps - round(steps)) > 1e-6:
            raise ParameterError(
                f"a delay of the rotors that is a multiple of {self.step_s:g} s, a step of the simulation",
                f"{self.vehicle.rotors.delay}",
                "Correct it, or the simulation's rate_hz.",
            )

    def _check(self, name: str, periods: float) -> None:
        if not (periods > 0.5 and abs(periods - round(periods)) < 1e-6):
            expected = f"{name} that is the rate of the simulation, and of its rate loop, over a whole number"
            remedy = f"The simulation has {self.rate_hz:g} Hz, its rate loop {self.controller.rate_hz:g} Hz."
            raise ParameterError(expected, f"{periods:g} periods of these in one of its own", remedy)

    @property
    def step_s(self) -> float:
        return 1.0 / self.rate_hz

    @property
    def count(self) -> int:
        return round(self.duration * self.rate_hz)


Series: TypeAlias = Float[np.ndarray, " n"]
Vectors: TypeAlias = Float[np.ndarray, "n 3"]

#: Sensors that the controller reads; and all, in the order of their streams of randomness.
SENSES = ("angular_rate", "attitude", "velocity", "position")
SENSORS = (*SENSES, "specific_force", "rotor_speed")
axis_values = attrgetter("roll", "pitch", "yaw")


@dataclass(frozen=True, slots=True)
class Surroundings:
    """References, wind, disturbances and sensor errors of a flight, a row for each step."""

    height: Float[np.ndarray, "n 3"]  # [m]
    attitude: Float[np.ndarray, "n 4"]
    injected: Float[np.ndarray, "n 3"]
    wind: Float[np.ndarray, "n 3"]  # Velocity of the air [m/s]
    disturbance: Float[np.ndarray, "n 3"]  # Torque from outside [N m]
    errors: Mapping[str, Float[np.ndarray, "n _"]]  # Of each sensor, on its axes


def draw_conditions(spec: RigidBodyFlightSpec) -> Surroundings:
    """Draw the conditions of a flight."""
    height, angles, injected, air, torque, *sensor_streams = streams(spec.seed)
    count, step_s, wind = spec.count, spec.step_s, spec.wind

    def series(rng: np.random.Generator, *sources: Excitation | None) -> Vectors:
        """Each source's series from a stream of its own; zeros where there is none."""
        pairs = zip(sources, rng.spawn(len(sources)), strict=True)
        columns = [x.sample(count, step_s, stream) if x else np.zeros(count) for x, stream in pairs]
        return np.column_stack(columns)

    reference = environment.altitude_reference(
        spec.trajectory, count=count, step_s=step_s, rng=height, vigour=spec.vigour
    )
    period = round(spec.rate_hz / spec.controller.rate_hz)
    last_update = np.arange(count) // period * period  # injected torques are held as torque setpoints are
    axes = dict.fromkeys(SENSORS, 3) | {"rotor_speed": spec.vehicle.rotors.count}
    sensors = {name: getattr(spec.sensors, name) for name in SENSORS}
    return Surroundings(
        height=np.column_stack(reference),
        attitude=quaternions(series(angles, *axis_values(spec.attitude))),
        injected=series(injected, *axis_values(spec.injection))[last_update],
        wind=np.array(wind.steady) + series(air, wind.x, wind.y, wind.z),
        disturbance=series(torque, *axis_values(spec.torque_disturbance)) @ spec.vehicle.inertia_matrix,
        errors={
            name: sensor.errors(count, axes[name], rng)
            for (name, sensor), rng in zip(sensors.items(), sensor_streams, strict=False)
            if sensor
        },
    )


def streams(seed: int) -> list[np.random.Generator]:
    """Streams of the sources of randomness; the last one is that of the stamps' errors."""
    return [np.random.Generator(np.random.PCG64(s)) for s in np.random.SeedSequence(seed).spawn(12)]


def quaternions(angles: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
    """Attitudes w, x, y, z of roll, pitch and yaw [rad]: yaw first, then pitch, then roll."""
    (a, b, c), (d, e, f) = np.cos(0.5 * angles).T, np.sin(0.5 * angles).T
    return np.column_stack(
        [a * b * c + d * e * f, d * b * c - a * e * f, a * e * c + d * b * f, a * b * f - d * e * c]
    )


def vehicle_text(spec: RigidBodyFlightSpec, name: str) -> str:
    """Text of the vehicle file of a flight's vehicle, without parameters to be identified."""
    rotors, sensors = spec.vehicle.rotors, spec.sensors
    lines = ["# The simulated vehicle as it is: every number is exact.", f"name = {_text(name)}"]
    lines.append(f"mass = {spec.vehicle.mass!r}")
    filtered = {"gyro": sensors.angular_rate, "accelerometer": sensors.specific_force}
    lines += [f"{key}_cutoff_hz = {item.cutoff_hz!r}" for key, item in filtered.items() if item.cutoff_hz]
    lines += ["", "[rotors]", f"positions = {[[x, y] for x, y, _ in rotors.positions]}"]
    lines += [f"spins = {list(rotors.spins)}", "speed_scale = 1.0", f"torque_ratio = {rotors.torque_ratio!r}"]
    lines.append(f"thrust_map = {_text(_thrust_map(rotors))}")
    return "\n".join(lines) + "\n"


def _text(words: str) -> str:
    return json.dumps("".join(word if word.isprintable() else "?" for word in words), ensure_ascii=False)


def _thrust_map(rotors: Rotors) -> str:
    if not rotors.thrust_linear:
        return "square"
    if not rotors.thrust_quadratic:
        return "linear"
    return f"mixed:{rotors.thrust_quadratic / (rotors.thrust_linear + rotors.thrust_quadratic)!r}"


@dataclass(frozen=True, slots=True)
class ClosedLoopRecord:
    """States, commands and setpoints of one flight, a row for each step."""

    body: Float[np.ndarray, "n 13"]  # Position [m], velocity [m/s], attitude w, x, y, z, body rates [rad/s]
    rotor_speed: Float[np.ndarray, "n rotors"]  # [rad/s]
    rotor_command: Float[np.ndarray, "n rotors"]  # [rad/s]
    thrust: Series  # Collective thrust setpoint, a share of full thrust
    torque: Vectors
    rate_setpoint: Vectors  # [rad/s]


def fly(specs: Sequence[RigidBodyFlightSpec], env: Sequence[Surroundings]) -> Iterator[ClosedLoopRecord]:
    """Fly specifications whose `shared_settings` are the same, side by side."""
    count, flights, start = specs[0].count, len(specs), 0
    series: list[Float[np.ndarray, "n ..."]] = []
    for moments in _chunks(specs, env):
        for number, (part, shape) in enumerate(zip(zip(*moments, strict=True), _SHAPES, strict=True)):
            # Of rotors, flights side by side have a list of one array.
            values = np.array(part).reshape(len(moments), *shape, flights)
            if start == 0:
                series.append(np.empty((count, *values.shape[1:])))
            series[number][start : start + len(moments)] = values
        start += len(moments)
    for flight in range(flights):
        yield ClosedLoopRecord(*(np.ascontiguousarray(part[..., flight]) for part in series))


def shared_settings(spec: RigidBodyFlightSpec) -> tuple[object, ...]:
    """Settings that flights must share to be simulated side by side."""
    c = spec.controller
    loops = (c.rate_hz, c.attitude_hz, c.height_hz)
    return (spec.rate_hz, spec.count, spec.vehicle.rotors.count, loops)


#: Steps whose inputs are laid out at a time.
CHUNK_STEPS = 500

#: Series that a loop reads, one entry for each step: components of one row.
_Rows: TypeAlias = Sequence[dynamics.Components] | Float[np.ndarray, "n _ flights"]
#: Body, rotor speeds, commands, thrust, torques and wanted rates of a step.
_Moment: TypeAlias = tuple[Body, list[Value], list[Value], Value, Triple, Triple]

#: Shapes of the parts of a moment, of one flight.
_SHAPES: tuple[tuple[int, ...], ...] = ((13,), (-1,), (-1,), (), (3,), (3,))


def _chunks(specs: Sequence[RigidBodyFlightSpec], env: Sequence[Surroundings]) -> Iterator[list[_Moment]]:
    """Moments of the whole flight, some steps at a time to save memory."""
    first, vehicles, single = specs[0], [spec.vehicle for spec in specs], len(specs) == 1
    step_s, control, delays = first.step_s, first.controller, [spec.vehicle.rotors.delay for spec in specs]
    gains = [gains_of(spec.controller, spec.vehicle, spec.sensors.angular_rate.lateness_s) for spec in specs]
    cascade = controller.Cascade(dynamics.together(gains), 1.0 / control.rate_hz, 1.0 / control.height_hz)
    filters = [LiveFilter([getattr(spec.sensors, name) for spec in specs], step_s) for name in SENSES]
    mixer = controller.mixer_of(vehicles[0]) if single else controller.stacked_mixer(vehicles)
    stepper = runge_kutta(coefficients_of(vehicles[0]) if single else dynamics.side_by_side(vehicles), step_s)
    body: Body = _start(env[0]).tolist() if single else np.stack([_start(item) for item in env], axis=1)
    hover = np.tile([vehicle.hover_speed for vehicle in vehicles], (vehicles[0].rotors.count, 1))
    speeds: list[Value] = hover[:, 0].tolist() if single else [hover]
    line = controller.DelayLine(delays, step_s, speeds)
    rate_every, attitude_every, height_every = (
        round(first.rate_hz / hz) for hz in (control.rate_hz, control.attitude_hz, control.height_hz)
    )
    holds_position = any(spec.controller.hold for spec in specs)
    thrust = dynamics.ZERO
    rates = torque = (dynamics.ZERO, dynamics.ZERO, dynamics.ZERO)
    command = speeds
    for k in range(first.count):
        row = k % CHUNK_STEPS
        if row == 0:
            inputs, moments = _chunk_inputs(env, k), list[_Moment]()
        true_readings = (
            _sum(body[10:13], inputs["angular_rate_error"][row]),
            dynamics.turned(body[6:10], *inputs["attitude_error"][row]),
            _sum(body[3:6], inputs["velocity_error"][row]),
            _sum(body[0:3], inputs["position_error"][row]),
        )
        (p, q, r), attitude, velocity, position = (
            sense.read(raw) for sense, raw in zip(filters, true_readings, strict=True)
        )
        if k % height_every == 0:
            _, x, y, _ = attitude
            cosine = 1.0 - 2.0 * (x * x + y * y)
            z, climb, acceleration = inputs["height"][row]
            thrust = cascade.thrust((z, climb, acceleration), position[2], velocity[2], cosine)
        if k % attitude_every == 0:
            attitude_reference = inputs["attitude"][row]
            if holds_position:
                attitude_reference = cascade.holding(attitude_reference, position[:2], velocity[:2])
            rates = cascade.rates(attitude_reference, attitude)
        if k % rate_every == 0:
            roll, pitch, yaw = _sum(cascade.torques(rates, (p, q, r)), inputs["injected"][row])
            torque = (roll, pitch, yaw)
            command = mixer.commands(thrust, torque)
        moments.append((body, speeds, command, thrust, torque, rates))
        (wx, wy, wz), (mx, my, mz) = inputs["wind"][row], inputs["disturbance"][row]
        body, speeds = stepper(body, speeds, line.push(command), (wx, wy, wz), (mx, my, mz))
        if row == CHUNK_STEPS - 1 or k == first.count - 1:
            yield moments


def _chunk_inputs(env: Sequence[Surroundings], start: int) -> dict[str, _Rows]:
    """Inputs of the loop for the next steps: floats of one flight, arrays of several."""
    part = slice(start, start + CHUNK_STEPS)
    series = ("height", "attitude", "injected", "wind", "disturbance")
    rows = {name: [getattr(item, name)[part] for item in env] for name in series}
    rows |= {f"{name}_error": [item.errors[name][part] for item in env] for name in SENSES}
    return {name: of[0].tolist() if len(env) == 1 else np.stack(of, axis=-1) for name, of in rows.items()}


def _start(env: Surroundings) -> Float[np.ndarray, " 13"]:
    height, climb, _ = env.height[0]
    return np.array([0.0, 0.0, height, *env.wind[0, :2], climb, *env.attitude[0], 0.0, 0.0, 0.0])


def _sum(first: dynamics.Components, second: dynamics.Components) -> list[Value]:
    return [a + b for a, b in zip(first, second, strict=True)]


SIMULATOR = "rigid body"


def recording_of(
    spec: RigidBodyFlightSpec, env: Surroundings, flight: ClosedLoopRecord, force: Vectors
) -> Recording:
    """Log of a flight."""
    rng = streams(spec.seed)[-1]
    channels: dict[str, Channel] = {}
    for sensor, series in _sensor_series(spec, env, flight, force):
        rows = sensor.rows(spec.count, spec.step_s)
        time_s = sensor.stamps(rows, spec.step_s, rng)
        for name, values in series.items():
            if not any(fnmatch(name, item) for item in spec.logged.omitted):
                channels[name] = environment.simulated_channel(name, SIMULATOR, time_s, values[rows])
    logged_hz = [rate or math.inf for rate in (spec.logged.rotor_command_hz, spec.logged.setpoint_hz)]
    complete = min(logged_hz) >= spec.controller.rate_hz
    return Recording(
        name=f"rigid body, {spec.trajectory}, seed {spec.seed}",
        format="simulation",
        channels=channels,
        frame=Frame.Z_UP,
        parameters={CONTROLLER_RATE: spec.controller.rate_hz} if complete else {},
        input_map="" if spec.vehicle.rotors.thrust_linear else "square",
    )


def _sensor_series(
    spec: RigidBodyFlightSpec, env: Surroundings, flight: ClosedLoopRecord, force: Vectors
) -> Iterator[tuple[Sensor, dict[str, Series]]]:
    """Series of each sensor; commands, setpoints and references."""
    body, logged = flight.body, spec.logged
    attitude = np.column_stack(dynamics.turned(list(body[:, 6:10].T), *env.errors["attitude"].T))
    measured: tuple[tuple[str, str, controller.Readings, Iterable[object]], ...] = (
        ("angular_rate", "angular_rate", body[:, 10:13], "xyz"),
        ("specific_force", "specific_force_body", force, "xyz"),
        ("velocity", "velocity", body[:, 3:6], "xyz"),
        ("position", "position", body[:, 0:3], "xyz"),
        ("attitude", "attitude", attitude, "wxyz"),
        ("rotor_speed", "rotor_speed", flight.rotor_speed, count(1)),
    )
    for name, stem, values, parts in measured:
        if sensor := getattr(spec.sensors, name):
            raw = values if name == "attitude" else values + env.errors[name]
            yield sensor, _named(stem, sensor.readings(raw, spec.step_s), parts)
    setpoints = {
        "input": flight.thrust,
        **_named("torque_setpoint", flight.torque, "xyz"),
        **_named("feedback_reference_angular_rate", flight.rate_setpoint, "xyz"),
    }
    if env.injected.any():
        setpoints |= _named("injected_torque", env.injected, "xyz")
    yield Sensor(rate_hz=logged.rotor_command_hz), _named("rotor_command", flight.rotor_command, count(1))
    yield Sensor(rate_hz=logged.setpoint_hz), setpoints
    height = ("reference_position_z", "reference_velocity_z", "reference_acceleration_z")
    references = (*height, "reference_roll", "reference_pitch", "reference_yaw")
    series = [*env.height.T, *roll_pitch_yaw(env.attitude.T)]
    yield Sensor(rate_hz=logged.reference_hz), dict(zip(references, series, strict=True))


def _named(stem: str, series: Float[np.ndarray, "n parts"], parts: Iterable[object]) -> dict[str, Series]:
    return {f"{stem}_{part}": values for part, values in zip(parts, series.T, strict=False)}


#: Steps of all flights that are simulated side by side: some hundred megabytes.
BATCH_STEPS = 1_200_000
#: A vehicle this far from its height [m], or with so small a cosine of its tilt, is lost.
LOST_M, LOST_COSINE = 5.0, 0.17


@dataclass(frozen=True, slots=True)
class RigidBodyTruth:
    """Truth of a flight, a row for each step of the simulation."""

    record: ClosedLoopRecord
    specific_force: Vectors  # On the body's axes [m/s^2]
    air_velocity: Vectors  # Of the vehicle through the air, in the world [m/s]
    parameters: dynamics.EffectiveParameters  # Combinations of the vehicle's parameters that the flight shows
    control_effectiveness: tuple[float, float, float]  # [rad/s^2]


RigidBodyFlight: TypeAlias = environment.SimulatedFlight[RigidBodyTruth]


def simulate_rigid_body_flights(specs: Sequence[RigidBodyFlightSpec]) -> Iterator[RigidBodyFlight]:
    """Fly each specification and give its log and its truth, in order."""
    for _, group in groupby(specs, shared_settings):
        similar = list(group)
        batch_size = max(BATCH_STEPS // similar[0].count, 1)
        for start in range(0, len(similar), batch_size):
            batch = similar[start : start + batch_size]
            env = [draw_conditions(spec) for spec in batch]
            for spec, of_flight, record in zip(batch, env, fly(batch, env), strict=True):
                yield _flight(spec, of_flight, record)


def _flight(spec: RigidBodyFlightSpec, env: Surroundings, flight: ClosedLoopRecord) -> RigidBodyFlight:
    body = flight.body
    force = specific_force(
        dynamics.side_by_side([spec.vehicle]),
        np.ascontiguousarray(body.T),
        [np.ascontiguousarray(flight.rotor_speed.T)],
        (env.wind[:, 0], env.wind[:, 1], env.wind[:, 2]),
    )
    truth = RigidBodyTruth(
        record=flight,
        specific_force=np.column_stack(force),
        air_velocity=body[:, 3:6] - env.wind,
        parameters=dynamics.effective_parameters(spec.vehicle),
        control_effectiveness=control_effectiveness(spec.vehicle),
    )
    cosine = 1.0 - 2.0 * (body[:, 7] ** 2 + body[:, 8] ** 2)
    height_error = np.abs(body[:, 2] - env.height[:, 0])
    flew = bool(height_error.max() < LOST_M and cosine.min() > LOST_COSINE)
    return environment.SimulatedFlight(recording_of(spec, env, flight, truth.specific_force), truth, flew)


def log_of_rigid_body_flight(spec: RigidBodyFlightSpec) -> KnownLog:
    """Log of a flight of a whole vehicle."""
    (flight,) = simulate_rigid_body_flights([spec])
    if not flight.flew:
        expected = "a flight that follows its height within 5 m and stays upright"
        remedy = "Make gusts, steps or disturbances smaller, or the controller less quick."
        raise ParameterError(expected, f"one that is lost with the seed {spec.seed}", remedy)
    # Without its input map where that is the rotors' own default.
    recording = replace(flight.recording, input_map="")
    return KnownLog(recording, spec.rate_hz, spec.count, spec.seed, _rigid_body_truth(spec, flight))


def _rigid_body_truth(spec: RigidBodyFlightSpec, flight: RigidBodyFlight) -> dict[str, object]:
    """The truth as a JSON document, with the names of the vertical motion's truth."""
    parameters = flight.truth.parameters
    return {
        "viscous_friction": viscous_friction(flight.truth),
        "input_gain": spec.vehicle.rotors.count * parameters.thrust_gain,
        "hover_input": spec.vehicle.hover_speed,
        **asdict(parameters),
        "control_effectiveness": list(flight.truth.control_effectiveness),
        "hover_speed": spec.vehicle.hover_speed,
        "units": package_tables("eivor.simulation", "truth.toml")["units"],
        "trajectory": str(spec.trajectory),
    }


def viscous_friction(truth: RigidBodyTruth) -> float:
    """Friction along z at the speeds of a flight: d_z at hover, and c_z sum |v| v_z^2 / sum v_z^2."""
    parameters = truth.parameters
    w, x, y, z = truth.record.body[:, 6:10].T
    along_x, along_y, along_z = truth.air_velocity.T
    _, _, climb = dynamics.into_body(dynamics.rotation(w, x, y, z), along_x, along_y, along_z)
    squared = np.asarray(climb) ** 2
    total = squared.sum()
    if not total > 0.0:
        return parameters.drag[2]
    speed = np.linalg.norm(truth.air_velocity, axis=1)
    return parameters.drag[2] + parameters.quadratic_drag[2] * float(speed @ squared / total)
