"""Simulated records of a scenario, in open and closed loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
import scipy

from eivor import checks
from eivor.errors import ParameterError
from eivor.signals.channels import held_by_default, unit_of
from eivor.signals.noise import MeasurementNoise, WhiteNoise
from eivor.signals.recording import Channel, Recording
from eivor.signals.signals import Signals
from eivor.simulation.environment import KnownLog
from eivor.simulation.excitation import Disturbance, Excitation, PaperInput, at_least
from eivor.tools import Float


@dataclass(frozen=True, slots=True)
class Control:
    """PI control of the measured velocity, whose setpoint follows the altitude where that has a gain.

    The excitation is the reference velocity [m/s], or with an altitude gain the reference altitude [m].
    """

    velocity_gain: float  # Input per velocity missing [input per m/s]
    velocity_integral_gain: float = 0.0  # Input per metre that the missing velocity adds up to
    altitude_gain: float = 0.0  # Velocity setpoint per altitude missing [1/s]

    def __post_init__(self) -> None:
        checks.non_negative("altitude_gain", self.altitude_gain)
        checks.finite("velocity_gain", self.velocity_gain)
        checks.finite("velocity_integral_gain", self.velocity_integral_gain)
        if self.velocity_gain == 0.0 and self.velocity_integral_gain == 0.0:
            expected = "a controller with a velocity_gain or a velocity_integral_gain"
            raise ParameterError(
                expected, "both zero", "Give one of them, or leave the control out for open loop."
            )

    @property
    def reference(self) -> str:
        """Channel that the excitation is."""
        return "reference_position_z" if self.altitude_gain else "reference_velocity_z"


Series = Float[np.ndarray, " samples"]
#: M of x[k+1] = M x[k] + E [d; a][k], E, and the gains of u[k] by x[k] and by the error d[k].
Loop = tuple[
    Float[np.ndarray, "states states"], Float[np.ndarray, "states 2"], Float[np.ndarray, " states"], float
]


def sampled_loop(scenario: Scenario, control: Control) -> Loop:
    """Loop of a vehicle under control, without the states that the controller does not use."""
    decay, step_gain, ramp = scenario.of_step
    altitude_gain, input_gain = control.altitude_gain, scenario.input_gain
    summed = control.velocity_integral_gain * scenario.step_s
    present = control.velocity_gain + summed
    # All three states; the error is d = addition - output x, the input u = present d + summed x[2].
    plant = np.array([[decay, 0.0, 0.0], [step_gain, 1.0, 0.0], [0.0, 0.0, 1.0]])
    push, sums = np.array([step_gain, scenario.step_s * ramp, 0.0]), np.array([0.0, 0.0, 1.0])
    output = np.array([1.0, altitude_gain, 0.0])
    from_state = summed * sums - present * output
    matrix = plant + np.outer(input_gain * push, from_state) - np.outer(sums, output)
    used = np.array([True, altitude_gain != 0.0, control.velocity_integral_gain != 0.0])
    effects = np.column_stack([input_gain * present * push + sums, push])[used]
    return matrix[np.ix_(used, used)], effects, from_state[used], present


def from_rest(
    matrix: Float[np.ndarray, "states states"], forcing: Float[np.ndarray, "steps states"]
) -> Float[np.ndarray, "samples states"]:
    """x[k+1] = M x[k] + forcing[k] from x[0] = 0, as the banded triangular system that it is."""
    steps, states = forcing.shape
    band = np.zeros((2 * states, (steps + 1) * states))
    band[0] = 1.0
    for row in range(states):
        for column in range(states):
            band[states + row - column, column::states] = -matrix[row, column]
    right = np.concatenate([np.zeros(states), forcing.ravel()])[:, None]
    solved = scipy.linalg.lapack.dtbtrs(band, right, uplo="L", diag="U")[0]
    return np.asarray(solved).reshape(steps + 1, states)


#: Channels that are measured with noise in every record.
ALWAYS_MEASURED = ("velocity_z", "acceleration_z", "input")
#: All that are measured with noise; the altitude under altitude control only.
NOISY_CHANNELS = (*ALWAYS_MEASURED, "position_z")
LEAST_SAMPLES = 2
#: What to say to those who name the response of a recording.
ABOUT_HOVER = "A scenario moves about hover, without gravity: its response is acceleration_z, which is z''."


class DisturbanceRoute(Enum):
    """Where a disturbance enters; the two differ."""

    EQUATION = "equation"
    """Only the measured response is shifted: the paper's simulation."""
    DYNAMICS = "dynamics"
    """It moves the vehicle, so that the velocity responds: a gust."""


class Intersample(Enum):
    """What the input does between samples."""

    HOLD = "hold"
    LINEAR = "linear"


@dataclass(frozen=True)
class Scenario:
    """What to simulate.

    Raises
    ------
    ParameterError
        When a number is outside its range, a channel is not measured, or a disturbance to scale is not
        there. When the control loop is unstable, or a controller is to change its output between samples.
    """

    viscous_friction: float  # K [1/s] and K_u [m/s^2 per unit of input]
    input_gain: float
    rate_hz: float = 5.0  # Samples per second [Hz]
    samples: int = 4000  # Length of the record
    # The input in open loop, the reference under control
    excitation: Excitation = field(default_factory=PaperInput)
    # Of `velocity_z`, `acceleration_z`, `input`, and under altitude control of `position_z`, in their units
    noise: Mapping[str, MeasurementNoise] = field(default_factory=dict)
    # For channels named here the noise's std is this ratio times the standard deviation of the noise-free
    # channel over the record. The noise given is its shape, white when none is; its own std is replaced
    noise_to_signal: Mapping[str, float] = field(default_factory=dict)
    disturbance: Disturbance | None = None  # Of the equation of motion [m/s^2]
    disturbance_to_signal: float | None = None  # Scales it to this share of the standard deviation of z''
    route: DisturbanceRoute = DisturbanceRoute.EQUATION  # Where the disturbance enters
    intersample: Intersample = Intersample.HOLD  # Of the input
    control: Control | None = None  # What makes the input; None for open loop

    def __post_init__(self) -> None:
        ranges = (checks.non_negative, checks.finite, checks.positive)
        for name, in_range in zip(("viscous_friction", "input_gain", "rate_hz"), ranges, strict=True):
            checks.number(name, getattr(self, name))
            in_range(name, getattr(self, name))
        checks.whole("samples", self.samples)
        checks.mapping("noise", self.noise, MeasurementNoise, "noises")
        checks.mapping("noise_to_signal", self.noise_to_signal, checks.NUMBERS, "numbers")
        for name, types, expected in _KINDS:
            checks.kind(name, getattr(self, name), types, expected)
        at_least("samples", self.samples, LEAST_SAMPLES)
        check_noises(self.noise, self.noise_to_signal, self.measured)
        if self.disturbance_to_signal is not None:
            checks.number("disturbance_to_signal", self.disturbance_to_signal)
            checks.non_negative("disturbance_to_signal", self.disturbance_to_signal)
            if self.disturbance is None:
                remedy = "Give the disturbance as well."
                raise ParameterError("a disturbance to scale", "disturbance_to_signal alone", remedy)
        if self.control is None:
            return
        if self.intersample is not Intersample.HOLD:
            expected = "an input that is held between samples, as a sampled controller gives it"
            received = f"intersample '{self.intersample.value}' under control"
            raise ParameterError(expected, received, "Use hold, or leave the control out.")
        radius = float(np.abs(np.linalg.eigvals(sampled_loop(self, self.control)[0])).max())
        if not radius < 1.0:
            raise ParameterError(
                "gains with which every mode of the control loop decays",
                f"{self.control} at input_gain={self.input_gain} and {self.rate_hz:g} Hz, a mode of which "
                f"has the factor {radius:.6g}",
                "Make the gains smaller, the velocity's of the sign of input_gain, or raise the rate.",
            )

    @property
    def step_s(self) -> float:
        """Time between samples [s]."""
        return 1.0 / self.rate_hz

    @property
    def of_step(self) -> tuple[float, float, float]:
        """Decay, and velocity [s] per acceleration that is held, or grows from 0 to 1, over a step."""
        x = self.viscous_friction * self.step_s
        held, ramp = scipy.special.exprel(-x), 0.5 * scipy.special.hyp1f1(1.0, 3.0, -x)
        return float(np.exp(-x)), self.step_s * float(held), self.step_s * float(ramp)

    @property
    def measured(self) -> tuple[str, ...]:
        """Channels of the record that are measured."""
        return NOISY_CHANNELS if self.control and self.control.altitude_gain else ALWAYS_MEASURED

    @property
    def references(self) -> tuple[str, ...]:
        """Channels of the record that are known without error: the reference under control."""
        return (self.control.reference,) if self.control else ()


@dataclass(frozen=True)
class SimulatedRecord:
    """A simulated record and its truth."""

    signals: Signals
    truth: Signals  # The same channels without measurement noise
    parameters: Mapping[str, float]  # viscous_friction and input_gain


_KINDS: tuple[tuple[str, type | tuple[type, ...], str], ...] = (
    ("excitation", Excitation, "an excitation"),
    ("disturbance", (Disturbance, type(None)), "a disturbance"),
    ("route", DisturbanceRoute, "a DisturbanceRoute"),
    ("intersample", Intersample, "an Intersample"),
    ("control", (Control, type(None)), "a control"),
)
#: For channels that a scenario does not measure, or not always.
_REMEDIES = {
    "position_z": "The altitude is measured under altitude control only.",
    "specific_force_z": ABOUT_HOVER,
}


def check_noises(
    noises: Mapping[str, MeasurementNoise], ratios: Mapping[str, float], channels: tuple[str, ...]
) -> None:
    """Refuse noise of other channels, and ratios below zero."""
    for name, ratio in ratios.items():
        checks.non_negative(f"noise_to_signal for {name}", ratio)
    for name in (*noises, *ratios):
        if name not in channels:
            remedy = _REMEDIES.get(name, "Name one of these channels.")
            raise ParameterError(f"noise of {', '.join(channels)}", f"noise of '{name}'", remedy)


#: Sources of randomness, in the order in which they take their streams from the record's generator.
SOURCES = ("excitation", "disturbance", *NOISY_CHANNELS)
#: Input, z' [m/s] and under altitude control z [m]; motions add, since the model is linear.
LinearMotion = Float[np.ndarray, "_ samples"]


def simulate(scenario: Scenario, rng: np.random.Generator) -> SimulatedRecord:
    """Simulate one record.

    Parameters
    ----------
    scenario : Scenario
        What to simulate.
    rng : numpy.random.Generator
        Source of all randomness. Each source spawns its own stream from it, whether the scenario uses it
        or not: changing one leaves the others' realisations as they are. A second call with the same
        generator gives another record.

    Returns
    -------
    SimulatedRecord
        Measured and true channels; every channel's noise is declared, with std 0 where there is none.

    Raises
    ------
    ParameterError
        When a disturbance that is to be scaled does not vary.

    Notes
    -----
    Linear in samples, apart from the FFT of fractional noises.
    """
    checks.kind("scenario", scenario, Scenario, "a Scenario", "Make one: ev.Scenario(0.3, 0.02).")
    checks.kind("rng", rng, np.random.Generator, "a generator", "Give numpy.random.default_rng(0).")
    streams = dict(zip(SOURCES, rng.spawn(len(SOURCES)), strict=True))
    drive = scenario.excitation.sample(scenario.samples, scenario.step_s, streams["excitation"])
    control, zero = scenario.control, np.zeros_like(drive)
    motion = respond(scenario, drive if control is None else (control.altitude_gain or 1.0) * drive, zero)
    disturbance = _disturbance(scenario, motion, streams["disturbance"])
    if scenario.route is DisturbanceRoute.DYNAMICS and scenario.disturbance is not None:
        motion += respond(scenario, zero, disturbance)
    channels = _channels(scenario, motion, disturbance)
    noise = declared_noise(scenario.noise, scenario.noise_to_signal, channels)
    errors = {name: source.sample(scenario.samples, streams[name]) for name, source in noise.items()}
    if control is not None:
        error = errors["velocity_z"] + control.altitude_gain * errors.get("position_z", zero)
        motion += respond(scenario, -error, zero)
    true = _channels(scenario, motion, disturbance)
    references = dict.fromkeys(scenario.references, drive)
    measured = {name: true[name] + error for name, error in errors.items()} | references
    noise |= {name: WhiteNoise(0.0) for name in references}
    parameters = {name: getattr(scenario, name) for name in ("viscous_friction", "input_gain")}
    truth = Signals(scenario.rate_hz, true | references | {"disturbance": disturbance})
    return SimulatedRecord(Signals(scenario.rate_hz, measured, noise=noise), truth, parameters)


def respond(scenario: Scenario, added: Series, pushed: Series) -> LinearMotion:
    """Motion from rest, driven by an addition to the input or controller's error, and by accelerations."""
    control = scenario.control
    if control is not None:
        matrix, effects, from_state, gain = sampled_loop(scenario, control)
        by_error, by_push = effects.T
        states = from_rest(matrix, np.outer(added[:-1], by_error) + np.outer(pushed[:-1], by_push))
        commanded = gain * added + states @ from_state
        return np.stack([commanded, *states.T[: 2 if control.altitude_gain else 1]])
    decay, step_gain, ramp = scenario.of_step
    steps = scenario.input_gain * step_gain * added[:-1] + step_gain * pushed[:-1]
    if scenario.intersample is Intersample.LINEAR:
        steps += scenario.input_gain * ramp * np.diff(added)
    return np.stack([added, from_rest(np.array([[decay]]), steps[:, None])[:, 0]])


def declared_noise(
    noises: Mapping[str, MeasurementNoise], ratios: Mapping[str, float], channels: Mapping[str, Series]
) -> dict[str, MeasurementNoise]:
    """Noise of each channel, with its std in the channel's unit."""
    declared = {name: noises.get(name, WhiteNoise(0.0)) for name in channels}
    scaled = {name: ratio * float(channels[name].std()) for name, ratio in ratios.items()}
    return declared | {name: declared[name].with_std(std) for name, std in scaled.items()}


def _channels(scenario: Scenario, motion: LinearMotion, disturbance: Series) -> dict[str, Series]:
    """Channels without measurement noise; the response is z''."""
    K, K_u = scenario.viscous_friction, scenario.input_gain
    drive, velocity, *altitude = motion
    response = K_u * drive - K * velocity + disturbance
    channels = {"velocity_z": velocity, "acceleration_z": response, "input": drive}
    return channels | dict(zip(("position_z",), altitude, strict=False))


def _disturbance(scenario: Scenario, undisturbed: LinearMotion, rng: np.random.Generator) -> Series:
    zeros = np.zeros(scenario.samples)
    if scenario.disturbance is None:
        return zeros
    series = scenario.disturbance.sample(scenario.samples, scenario.step_s, rng)
    if scenario.disturbance_to_signal is None:
        return series
    spread = float(series.std())
    if not 0.0 < spread < np.inf:
        expected = "a disturbance that varies, since it is to be scaled to a share of z''"
        remedy = "Give it a positive std, or leave disturbance_to_signal out."
        raise ParameterError(expected, f"a standard deviation of {spread} over the record", remedy)
    response = _channels(scenario, undisturbed, zeros)["acceleration_z"]
    return scenario.disturbance_to_signal * float(response.std()) / spread * series


def log_about_hover(scenario: Scenario, seed: int) -> KnownLog:
    """Log of the measured channels of a scenario."""
    record = simulate(scenario, np.random.default_rng(seed))
    signals = record.signals
    time_s = np.arange(signals.sample_count) * signals.step_s
    channels = {
        key: Channel(key, time_s, values, unit_of(key), source="simulation", held=held_by_default(key))
        for key, values in signals.channels.items()
    }
    recording = Recording(name="simulation", format="simulation", channels=channels)
    truth = {
        **record.parameters,
        "units": {"viscous_friction": "1/s", "input_gain": "m/s^2 per unit of input"},
        "noise": {
            name: {"std": noise.std, "order": getattr(noise, "order", 0.0)}
            for name, noise in signals.noise.items()
        },
        "disturbance": {
            "route": scenario.route.value,
            "std": float(record.truth.channels["disturbance"].std()),
        },
    }
    return KnownLog(recording, scenario.rate_hz, scenario.samples, seed, truth)
