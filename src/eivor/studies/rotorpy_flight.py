"""Closed-loop flights of RotorPy's multirotors: a simulator that others wrote and that Eivor never fits.

Conventions, settled here once:

* Controller and log run at 100 Hz. At each stamp the controller reads the noisy measurements, the same
  values are logged, and its command is held until the next stamp. A delay of d means that the command
  issued at t reaches the rotors at t + d; the log holds it at t, as an autopilot's log does.
* RotorPy: z up, quaternions [x, y, z, w] body to world, rotor speed w' = (command - w)/tau_m with the
  command clipped to the rotor's range, thrust k_eta w^2 along the body's z, rotor drag -k_z w v_z for
  each rotor (v the air velocity in the body's axes), parasitic drag -c |v| v. Its accelerometer reads
  R'(v' + g e3). Wind is held over a step.
* In still air at hover, K = k_z (sum of the hover speeds)/m: parasitic drag is quadratic and adds
  nothing there, and K_u = (number of rotors) k_eta/m for the mean squared speed.
* A lost vehicle ends the flight; what was logged until then is kept.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from jaxtyping import Float

from eivor.errors import MissingReaderError, UsageError
from eivor.signals.recording import CANONICAL_UNITS, Channel, Frame, Recording
from eivor.studies.flight_truth import FlightTruth, SimulatedFlight

#: Step of the controller and of the log [s].
STEP_S = 0.01
_STUDENT_DOF = 4.0


class Vehicle(StrEnum):
    """The multirotors: two that RotorPy ships and one of 1.2 kg."""

    CRAZYFLIE = "crazyflie"
    HUMMINGBIRD = "hummingbird"
    MEDIUM = "medium-1.2kg"


class TrajectoryKind(StrEnum):
    """What the altitude reference does."""

    STEPS = "steps"
    MULTISINE = "multisine"
    CHIRP = "chirp"
    CLIMBS = "climbs"
    HOVER = "hover"


class NoiseKind(StrEnum):
    """Distribution and memory of the noise of acceleration and velocity.

    Fractional noise has the order -0.5 on acceleration and -0.4 on velocity. Position, attitude and rate
    noise are white in every kind.
    """

    WHITE = "white"
    HEAVY_TAILED = "heavy-tailed"
    FRACTIONAL = "fractional"


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Noise of what the controller sees and the log holds, alike on each axis.

    Every level is the standard deviation over the whole record. That also holds for fractional noise,
    whose variance grows along the record: its white source is scaled so that the mean variance is right.

    Parameters
    ----------
    kind : NoiseKind
        Of acceleration and velocity.
    acceleration : float
        [m/s^2]
    velocity : float
        [m/s]
    position : float
        [m]
    attitude : float
        Small rotations about the body's axes [rad].
    angular_rate : float
        [rad/s]

    Raises
    ------
    UsageError
        When a level is negative or not finite.
    """

    kind: NoiseKind = NoiseKind.WHITE
    acceleration: float = 0.4
    velocity: float = 0.03
    position: float = 0.01
    attitude: float = 0.002
    angular_rate: float = 0.01

    def __post_init__(self) -> None:
        levels = (self.acceleration, self.velocity, self.position, self.attitude, self.angular_rate)
        if not all(0.0 <= level < np.inf for level in levels):
            raise UsageError("finite noise levels of at least 0", f"{levels}", "Give standard deviations.")

    @classmethod
    def none(cls) -> SensorNoise:
        """Sensors without noise."""
        return cls(NoiseKind.WHITE, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class RotorpyFlightSpec:
    """Everything that a flight is a function of.

    Parameters
    ----------
    vehicle : Vehicle
        Which multirotor.
    actuator_lag : float or None
        Time constant of the rotors [s]; None for the vehicle's own.
    delay : float
        Delay of the commands [s], a multiple of 0.01.
    gust_rms : float
        Standard deviation of the wind on each of the three axes [m/s].
    gust_correlation : float
        Correlation time of the wind, an Ornstein-Uhlenbeck process [s].
    noise : SensorNoise
        Levels and kind.
    trajectory : TrajectoryKind
        The altitude reference.
    seed : int
        Trajectory, wind and noise have streams of their own, so that a change of the noise's kind leaves
        trajectory and wind as they were.
    duration : float
        [s], a multiple of 0.01.

    Raises
    ------
    UsageError
        When a value is out of its range.
    """

    vehicle: Vehicle = Vehicle.CRAZYFLIE
    actuator_lag: float | None = None
    delay: float = 0.0
    gust_rms: float = 0.0
    gust_correlation: float = 1.0
    noise: SensorNoise = field(default_factory=SensorNoise)
    trajectory: TrajectoryKind = TrajectoryKind.MULTISINE
    seed: int = 0
    duration: float = 60.0

    def __post_init__(self) -> None:
        lag = 0.01 if self.actuator_lag is None else self.actuator_lag
        if not (0.0 < lag <= 0.5 and 0.0 <= self.gust_rms < np.inf and self.gust_correlation > 0.0):
            raise UsageError(
                "a lag in (0, 0.5] s, gusts of at least 0 m/s, a positive correlation time",
                f"lag {self.actuator_lag}, gusts {self.gust_rms}, correlation time {self.gust_correlation}",
                "Correct the flight's specification.",
            )
        steps = self.delay / STEP_S
        if not 0.0 <= self.delay <= 0.2 or abs(steps - round(steps)) > 1e-6:
            raise UsageError(
                f"a delay between 0 and 0.2 s that is a multiple of {STEP_S} s",
                f"{self.delay}",
                "The simulator delays whole control steps.",
            )
        if not 2.0 <= self.duration <= 3600.0:
            raise UsageError("a duration of 2 to 3600 s", f"{self.duration}", "Choose another one.")

    @property
    def count(self) -> int:
        """Number of stamps."""
        return round(self.duration / STEP_S)


def simulate_rotorpy_flight(spec: RotorpyFlightSpec) -> SimulatedFlight:
    """Fly one closed loop of RotorPy and return its log and its truth.

    Parameters
    ----------
    spec : RotorpyFlightSpec
        The flight. The result is a pure function of it.

    Returns
    -------
    SimulatedFlight
        Recording with the channels rotor_command_1..4 [rad/s], velocity_z, position_z, attitude_*,
        specific_force_body_*, reference_*_z (the trajectory's own, no feedback in it), and the truth.

    Raises
    ------
    MissingReaderError
        When RotorPy is not installed.

    Notes
    -----
    On one core a flight of 60 s takes 6 to 20 s, the more the shorter the lag.
    """
    shape, gusts, sensors = (
        np.random.Generator(np.random.PCG64(s)) for s in np.random.SeedSequence(spec.seed).spawn(3)
    )
    parts = _Parts(
        parameters=_vehicle_parameters(spec),
        reference=_reference(spec, shape),
        wind=_wind(spec, gusts),
        noise=_Noise.sample(spec.noise, spec.count, sensors),
    )
    log, flew = _fly(spec, parts)
    truth = _truth(spec, parts, log)
    return SimulatedFlight(_recording(spec, parts, log), truth, flew)


# ---------------------------------------------------------------------------------------- vehicles


#: A quadrotor of 1.2 kg in the size of the common 450 mm frames; Eivor's own choice, not a measured
#: vehicle. k_eta: a 10 x 4.5 inch propeller, C_T about .11 in C_T rho D^4/(2 pi)^2. k_m/k_eta: .016 m,
#: usual for such propellers. Inertia: scaled from the shipped Hummingbird by mass x arm^2. k_z: makes K
#: about .4 1/s at hover, the size published for real quadrotors; k_d: half of it, as in the Hummingbird.
_MEDIUM: Mapping[str, Any] = {
    "mass": 1.2,
    "Ixx": 0.0153,
    "Iyy": 0.0155,
    "Izz": 0.0296,
    "Ixy": 0.0,
    "Iyz": 0.0,
    "Ixz": 0.0,
    "num_rotors": 4,
    "rotor_pos": {
        "r1": np.array([0.1591, 0.1591, 0.0]),
        "r2": np.array([0.1591, -0.1591, 0.0]),
        "r3": np.array([-0.1591, -0.1591, 0.0]),
        "r4": np.array([-0.1591, 0.1591, 0.0]),
    },
    "rotor_directions": np.array([1, -1, 1, -1]),
    "rI": np.zeros(3),
    "c_Dx": 0.01,
    "c_Dy": 0.01,
    "c_Dz": 0.02,
    "k_eta": 1.39e-5,
    "k_m": 2.2e-7,
    "k_d": 1.3e-4,
    "k_z": 2.6e-4,
    "k_h": 0.0,
    "k_flap": 0.0,
    "tau_m": 0.04,
    "rotor_speed_min": 0,
    "rotor_speed_max": 900,
    "motor_noise_std": 0.0,
    "kp_att": 544,
    "kd_att": 46.64,
}


def _vehicle_parameters(spec: RotorpyFlightSpec) -> dict[str, Any]:
    """RotorPy's parameter set of the vehicle, with the lag of the specification."""
    try:
        from rotorpy.vehicles import crazyflie_params, hummingbird_params
    except ModuleNotFoundError as error:
        raise MissingReaderError(
            "the simulator RotorPy",
            f"an environment without it ({error})",
            "Install it: python -m pip install 'rotorpy>=3.0'.",
        ) from error
    sets: Mapping[Vehicle, Mapping[str, Any]] = {
        Vehicle.CRAZYFLIE: crazyflie_params.quad_params,
        Vehicle.HUMMINGBIRD: hummingbird_params.quad_params,
        Vehicle.MEDIUM: _MEDIUM,
    }
    parameters = dict(sets[spec.vehicle])
    if spec.actuator_lag is not None:
        parameters["tau_m"] = spec.actuator_lag
    return parameters


def _integrator(lag: float) -> dict[str, Any]:
    """Options of the integrator, by the actuator's lag [s].

    RotorPy's default tolerance (1e-3) puts a 5 s flight off by .33 m. These leave errors below 2e-5 rad/s
    and 1e-8 m against a tolerance of 1e-11, because the first step, given rather than guessed, spans the
    control step or the lag, whichever is shorter. The fifth order suffices when the lag is long.
    """
    method = "RK45" if lag >= 4.0 * STEP_S else "DOP853"
    return {"method": method, "rtol": 1e-6, "atol": 1e-7, "first_step": min(STEP_S, lag)}


def _tuned_controller(parameters: Mapping[str, Any], delay: float) -> Any:
    """RotorPy's SE3 controller, its gains lowered where the actuator's lag asks for it.

    The shipped gains lose a Crazyflie (lag 72 ms) at 20 ms of delay. T is the lag, the delay and half a
    control step together; each loop's crossover stays a fixed part of 1/T, and below the shipped gain.
    """
    from rotorpy.controllers.quadrotor_control import SE3Control

    controller = SE3Control(dict(parameters))
    slowness = float(parameters["tau_m"]) + delay + STEP_S / 2
    controller.kd_att = min(controller.kd_att, 0.6 / slowness)
    controller.kp_att = min(controller.kp_att, 0.3 / slowness * controller.kd_att)
    sideways, upward = min(4.0, 0.15 / slowness), min(9.0, 0.9 / slowness)
    controller.kd_pos = np.array([sideways, sideways, upward])
    side_gain = min(6.5, 0.06 / slowness * sideways)
    controller.kp_pos = np.array([side_gain, side_gain, min(15.0, 0.185 * upward**2)])
    return controller


# ---------------------------------------------------------------------- reference, wind and noise


@dataclass(frozen=True, slots=True)
class _Reference:
    """Altitude reference and its derivatives on the log's grid [m, m/s, m/s^2]."""

    position: Float[np.ndarray, " n"]
    velocity: Float[np.ndarray, " n"]
    acceleration: Float[np.ndarray, " n"]


def _reference(spec: RotorpyFlightSpec, rng: np.random.Generator) -> _Reference:
    """Shape of the kind, scaled so that speed and acceleration stay below about 2 m/s and 3-4 m/s^2."""
    from scipy.interpolate import make_interp_spline

    time = STEP_S * np.arange(spec.count)
    position = _SHAPES[spec.trajectory](time, rng)
    spline = make_interp_spline(time, position, k=5)
    velocity, acceleration = spline(time, 1), spline(time, 2)
    fastest, hardest = float(np.abs(velocity).max()), float(np.abs(acceleration).max())
    limits = rng.uniform(1.6, 2.2), rng.uniform(3.0, 4.0)
    scale = min(limits[0] / fastest, limits[1] / hardest) if fastest > 0.0 else 0.0
    if spec.trajectory is TrajectoryKind.CLIMBS:
        scale = min(1.0, scale)  # a climb keeps its own height; the others use all that the limits leave
    return _Reference(scale * position, scale * velocity, scale * acceleration)


def _steps(time: Float[np.ndarray, " n"], rng: np.random.Generator) -> Float[np.ndarray, " n"]:
    """Random levels, held 1.5 to 4 s each, through four equal first-order lags."""
    starts = np.cumsum(rng.uniform(1.5, 4.0, size=int(time[-1] / 1.5) + 2))
    levels = rng.uniform(-2.0, 2.0, size=starts.size + 1)
    levels[0] = 0.0
    series = levels[np.searchsorted(starts, time, side="right")]
    decay = np.exp(-STEP_S / rng.uniform(0.25, 0.45))
    for _ in range(4):
        state = 0.0
        for k in range(series.size):
            state = decay * state + (1.0 - decay) * series[k]
            series[k] = state
    return series


def _multisine(time: Float[np.ndarray, " n"], rng: np.random.Generator) -> Float[np.ndarray, " n"]:
    """Twelve sines between 0.06 and 1.2 Hz with random phases, amplitude falling with frequency."""
    edges = np.geomspace(0.06, 1.2, 13)
    frequencies = rng.uniform(edges[:-1], edges[1:])
    phases = rng.uniform(0.0, 2.0 * np.pi, size=frequencies.size)
    angles = 2.0 * np.pi * frequencies * time[:, None] + phases
    return np.asarray(np.sin(angles) @ frequencies**-1.3)


def _chirp(time: Float[np.ndarray, " n"], rng: np.random.Generator) -> Float[np.ndarray, " n"]:
    """Sine whose frequency rises from about 0.1 to 1.2 Hz, at the full speed or acceleration throughout."""
    first, last = rng.uniform(0.08, 0.12), rng.uniform(1.0, 1.4)
    growth = np.log(last / first) / time[-1]
    angle = 2.0 * np.pi * first * np.expm1(growth * time) / growth + rng.uniform(0.0, 2.0 * np.pi)
    pulsation = 2.0 * np.pi * first * np.exp(growth * time)
    return np.asarray(np.sin(angle) / (pulsation / 2.0 + pulsation**2 / 3.5))


def _climbs(time: Float[np.ndarray, " n"], rng: np.random.Generator) -> Float[np.ndarray, " n"]:
    """One climb and one descent, each of least jerk (a polynomial of the fifth degree)."""
    span = float(time[-1])
    height = rng.uniform(1.5, 4.0)
    position = np.zeros_like(time)
    for sign, earliest in ((1.0, 0.2), (-1.0, 0.6)):
        start, length = span * rng.uniform(earliest, earliest + 0.1), span * rng.uniform(0.05, 0.1)
        part = np.clip((time - start) / length, 0.0, 1.0)
        position += sign * height * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    return position


def _hover(time: Float[np.ndarray, " n"], rng: np.random.Generator) -> Float[np.ndarray, " n"]:  # noqa: ARG001
    """Return a constant reference."""
    return np.zeros_like(time)


_Shape = Callable[[Float[np.ndarray, " n"], np.random.Generator], Float[np.ndarray, " n"]]
_SHAPES: Mapping[TrajectoryKind, _Shape] = {
    TrajectoryKind.STEPS: _steps,
    TrajectoryKind.MULTISINE: _multisine,
    TrajectoryKind.CHIRP: _chirp,
    TrajectoryKind.CLIMBS: _climbs,
    TrajectoryKind.HOVER: _hover,
}


def _wind(spec: RotorpyFlightSpec, rng: np.random.Generator) -> Float[np.ndarray, "n 3"]:
    """Stationary Ornstein-Uhlenbeck wind on each axis [m/s], sampled exactly and held over a step."""
    shocks = rng.standard_normal((spec.count, 3))
    decay = np.exp(-STEP_S / spec.gust_correlation)
    wind = np.empty_like(shocks)
    wind[0] = shocks[0]
    for k in range(1, spec.count):
        wind[k] = decay * wind[k - 1] + np.sqrt(1.0 - decay**2) * shocks[k]
    return np.asarray(spec.gust_rms * wind)


@dataclass(frozen=True, slots=True)
class _Noise:
    """What is added to each measurement, one row for each stamp, in SI units."""

    acceleration: Float[np.ndarray, "n 3"]
    velocity: Float[np.ndarray, "n 3"]
    position: Float[np.ndarray, "n 3"]
    attitude: Float[np.ndarray, "n 3"]
    angular_rate: Float[np.ndarray, "n 3"]

    @classmethod
    def sample(cls, noise: SensorNoise, count: int, rng: np.random.Generator) -> _Noise:
        acceleration, velocity = (
            level * _unit_noise(noise.kind, order, count, rng)
            for level, order in ((noise.acceleration, -0.5), (noise.velocity, -0.4))
        )
        position, attitude, angular_rate = (
            level * rng.standard_normal((count, 3))
            for level in (noise.position, noise.attitude, noise.angular_rate)
        )
        return cls(acceleration, velocity, position, attitude, angular_rate)


def _unit_noise(
    kind: NoiseKind, order: float, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "n 3"]:
    """Three independent records of the kind whose variance, averaged along the record, is 1."""
    if kind is NoiseKind.HEAVY_TAILED:
        heavy = rng.standard_t(_STUDENT_DOF, size=(count, 3))
        return np.asarray(heavy * np.sqrt(1.0 - 2.0 / _STUDENT_DOF))
    white = rng.standard_normal((count, 3))
    if kind is NoiseKind.WHITE:
        return white
    # Delta^order, started at zero: a_j = a_{j-1} (j - 1 - order)/j.
    lags = np.arange(1, count)
    weights = np.concatenate([[1.0], np.cumprod((lags - 1.0 - order) / lags)])
    spectrum = np.fft.rfft(weights, 2 * count)[:, None] * np.fft.rfft(white, 2 * count, axis=0)
    series = np.fft.irfft(spectrum, 2 * count, axis=0)[:count]
    return np.asarray(series / np.sqrt(np.cumsum(weights**2).mean()))


# ------------------------------------------------------------------------------------- the flight


@dataclass(frozen=True, slots=True)
class _Parts:
    """What a flight is flown with."""

    parameters: dict[str, Any]
    reference: _Reference
    wind: Float[np.ndarray, "n 3"]
    noise: _Noise


@dataclass(frozen=True, slots=True)
class _Log:
    """Noise-free states, what the controller was told, and what it commanded; one row for each stamp."""

    position: Float[np.ndarray, "n 3"]
    velocity: Float[np.ndarray, "n 3"]
    attitude: Float[np.ndarray, "n 4"]
    acceleration: Float[np.ndarray, "n 3"]
    rotor_state: Float[np.ndarray, "n rotors"]
    seen_attitude: Float[np.ndarray, "n 4"]
    command: Float[np.ndarray, "n rotors"]


def _fly(spec: RotorpyFlightSpec, parts: _Parts) -> tuple[_Log, bool]:
    """Run the loop; the second result is False when the vehicle was lost."""
    from rotorpy.vehicles.multirotor import Multirotor

    hover = np.full(parts.parameters["num_rotors"], _hover_speed(parts.parameters))
    state = _initial_state(parts.reference, hover)
    options = _integrator(float(parts.parameters["tau_m"]))
    vehicle = Multirotor(parts.parameters, dict(state), "cmd_motor_speeds", integrator_kwargs=options)
    controller = _tuned_controller(parts.parameters, spec.delay)
    pending = deque([hover] * round(spec.delay / STEP_S))
    rows = []
    flew = True
    for k in range(spec.count):
        state["wind"] = parts.wind[k]
        seen = _measured(state, parts.noise, k)
        told = controller.update(k * STEP_S, seen, _flat_output(parts.reference, k))["cmd_motor_speeds"]
        command = np.clip(told, vehicle.rotor_speed_min, vehicle.rotor_speed_max)
        pending.append(command)
        acting = {"cmd_motor_speeds": pending.popleft()}
        acceleration = vehicle.statedot(state, acting, STEP_S)["vdot"]
        rows.append(
            (state["x"], state["v"], state["q"], acceleration, state["rotor_speeds"], seen["q"], command)
        )
        if _is_lost(state, float(parts.reference.position[k])):
            flew = False
            break
        state = vehicle.step(state, acting, STEP_S)
    return _Log(*(np.array(column) for column in zip(*rows, strict=True))), flew


def _hover_speed(parameters: Mapping[str, Any]) -> float:
    """Rotor speed at which the thrust carries the weight [rad/s]; RotorPy's g is 9.81."""
    lift = parameters["num_rotors"] * parameters["k_eta"]
    return float(np.sqrt(parameters["mass"] * 9.81 / lift))


def _initial_state(
    reference: _Reference, hover: Float[np.ndarray, " rotors"]
) -> dict[str, Float[np.ndarray, " _"]]:
    """Level, on the reference, rotors at hover speed."""
    return {
        "x": np.array([0.0, 0.0, reference.position[0]]),
        "v": np.array([0.0, 0.0, reference.velocity[0]]),
        "q": np.array([0.0, 0.0, 0.0, 1.0]),
        "w": np.zeros(3),
        "wind": np.zeros(3),
        "rotor_speeds": hover,
    }


def _flat_output(reference: _Reference, k: int) -> dict[str, Any]:
    """RotorPy's name for the reference: the vertical one, and none sideways or in yaw."""
    upward = np.array([0.0, 0.0, 1.0])
    return {
        "x": reference.position[k] * upward,
        "x_dot": reference.velocity[k] * upward,
        "x_ddot": reference.acceleration[k] * upward,
        "x_dddot": np.zeros(3),
        "x_ddddot": np.zeros(3),
        "yaw": 0.0,
        "yaw_dot": 0.0,
    }


def _measured(state: Mapping[str, Float[np.ndarray, " _"]], noise: _Noise, k: int) -> dict[str, Any]:
    """Return the state as the sensors show it."""
    x, y, z, w = state["q"]
    a, b, c = 0.5 * noise.attitude[k]
    # q multiplied from the right by the small rotation [a, b, c, 1], first order in the angles.
    turned = np.array(
        [
            x + w * a + y * c - z * b,
            y + w * b + z * a - x * c,
            z + w * c + x * b - y * a,
            w - x * a - y * b - z * c,
        ]
    )
    return {
        "x": state["x"] + noise.position[k],
        "v": state["v"] + noise.velocity[k],
        "q": turned / np.sqrt(turned @ turned),
        "w": state["w"] + noise.angular_rate[k],
    }


def _is_lost(state: Mapping[str, Float[np.ndarray, " _"]], altitude: float) -> bool:
    """Return whether the vehicle is beyond recovery: far from the reference, or tilted by 70 degrees."""
    away = np.abs(state["x"] - np.array([0.0, 0.0, altitude]))
    near = bool(away[0] < 50.0 and away[1] < 50.0 and away[2] < 5.0)
    x, y = float(state["q"][0]), float(state["q"][1])
    return not (near and 1.0 - 2.0 * (x * x + y * y) > np.cos(np.radians(70.0)))


# -------------------------------------------------------------------------------- truth and log


def _truth(spec: RotorpyFlightSpec, parts: _Parts, log: _Log) -> FlightTruth:
    count = log.position.shape[0]
    mass, rotors = float(parts.parameters["mass"]), int(parts.parameters["num_rotors"])
    speed = _hover_speed(parts.parameters)
    return FlightTruth(
        time_s=STEP_S * np.arange(count),
        specific_force_z=log.acceleration[:, 2] + 9.81,
        air_velocity_z=log.velocity[:, 2] - parts.wind[:count, 2],
        rotor_state=log.rotor_state,
        cos_tilt=1.0 - 2.0 * (log.attitude[:, 0] ** 2 + log.attitude[:, 1] ** 2),
        actuator_lag=float(parts.parameters["tau_m"]),
        delay=spec.delay,
        viscous_friction=float(parts.parameters["k_z"]) * rotors * speed / mass,
        input_gain=rotors * float(parts.parameters["k_eta"]) / mass,
        hover_input=speed,
    )


def _recording(spec: RotorpyFlightSpec, parts: _Parts, log: _Log) -> Recording:
    from scipy.spatial.transform import Rotation

    count = log.position.shape[0]
    noise, reference, gravity = parts.noise, parts.reference, np.array([0.0, 0.0, 9.81])
    force = Rotation.from_quat(log.attitude).apply(log.acceleration + gravity, inverse=True)
    force = force + noise.acceleration[:count]
    held = {
        **{f"rotor_command_{i + 1}": log.command[:, i] for i in range(log.command.shape[1])},
        "reference_position_z": reference.position[:count],
        "reference_velocity_z": reference.velocity[:count],
        "reference_acceleration_z": reference.acceleration[:count],
    }
    sampled = {
        "position_z": log.position[:, 2] + noise.position[:count, 2],
        "velocity_z": log.velocity[:, 2] + noise.velocity[:count, 2],
        **{f"attitude_{axis}": log.seen_attitude[:, i] for i, axis in enumerate("xyzw")},
        **{f"specific_force_body_{axis}": force[:, i] for i, axis in enumerate("xyz")},
    }
    time = STEP_S * np.arange(count)
    channels = {
        name: Channel(name, time, values.copy(), _unit(name), source="rotorpy", held=name in held)
        for name, values in (held | sampled).items()
    }
    return Recording(
        name=f"rotorpy {spec.vehicle}, {spec.trajectory}, seed {spec.seed}",
        format="simulation",
        channels=channels,
        frame=Frame.Z_UP,
        input_map="square",
    )


def _unit(name: str) -> str:
    return CANONICAL_UNITS["rotor_command_*" if name.startswith("rotor_command_") else name]
