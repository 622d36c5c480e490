"""Rough vehicle, limits, setpoints and targets of a plan."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import msgspec
import numpy as np

from eivor import checks
from eivor.errors import InputError, UsageError
from eivor.flights.quantity import Quantity
from eivor.inference.verdict import Status
from eivor.signals.filters import first_order_lag
from eivor.signals.recording import GRAVITY
from eivor.simulation.vertical import AltitudeController
from eivor.tools import Float


@dataclass(frozen=True, slots=True)
class FlightLimits:
    """Limits of a planned flight. Setpoints stay inside them with room for how a vehicle follows them.

    Raises
    ------
    UsageError
        When a limit is not above zero, the heights leave no room, or the flight is too short or too long.
    """

    height_m: tuple[float, float] = (3.0, 8.0)  # Lowest and highest above the place of take-off [m]
    speed: Annotated[float, (0.2, 10.0)] = 2.0  # Largest climb and sink rate [m/s]
    acceleration: Annotated[float, (0.3, 6.0)] = 3.0  # Largest vertical acceleration of the setpoints [m/s^2]
    # Largest tilt [deg]; the flight is vertical, and ends beyond it
    tilt_deg: Annotated[float, (5.0, 60.0)] = 20.0
    duration_s: Annotated[float, (20.0, 600.0)] = 60.0  # From the first setpoint to the last [s]

    def __post_init__(self) -> None:
        remedy = "Give FlightLimits(height_m=(3.0, 8.0)), in metres above the place of take-off."
        checks.items("height_m", self.height_m, checks.NUMBERS, "two numbers", remedy)
        ends = [float(end) for end in self.height_m]
        if len(ends) != 2 or not 0.0 < ends[0] <= ends[-1] - 0.5 < math.inf:
            expected = "a lowest height above zero and a highest one, half a metre or more above it"
            raise UsageError(expected, f"{self.height_m}", remedy)
        checks.in_ranges(self, "Give another limit.")

    @property
    def middle_m(self) -> float:
        """Height about which a flight is planned [m]."""
        return 0.5 * (self.height_m[0] + self.height_m[1])


#: Step of the simulation, and of what the recipe sees [s].
STEP_S = 0.01
#: Share of the limits of height and speed that setpoints use.
USED_SHARE = 0.8
#: Hover at both ends, and how long a multisine takes to rise and to fade [s].
HOVER_S, FADE_S = 2.0, 3.0
#: A step passes through so many equal first-order lags.
LAG_COUNT = 4


@dataclass(frozen=True)
class Shape:
    """Height setpoint of a flight, about the middle of its limits."""

    kind: str  # "multisine" or "steps"
    words: str
    offset: Float[np.ndarray, " n"]  # Height from the middle, every `STEP_S` [m]

    @cached_property
    def derivatives(self) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Velocity and acceleration [m/s, m/s^2]."""
        velocity = np.gradient(self.offset, STEP_S)
        return velocity, np.gradient(velocity, STEP_S)

    def scaled(self, factor: float) -> Shape:
        """Return the same shape, higher or lower."""
        return Shape(self.kind, self.words, factor * self.offset)

    def within(self, limits: FlightLimits) -> Shape:
        """Return the shape as large as the limits allow."""
        velocity, acceleration = self.derivatives
        half_height = 0.5 * (limits.height_m[1] - limits.height_m[0])
        factor = min(
            USED_SHARE * half_height / float(np.abs(self.offset).max()),
            USED_SHARE * limits.speed / float(np.abs(velocity).max()),
            limits.acceleration / float(np.abs(acceleration).max()),
        )
        return self.scaled(factor)


KINDS = ("multisine", "steps")


def candidates(duration_s: float, kinds: tuple[str, ...], seed: int, pace: float = 1.0) -> Iterator[Shape]:
    """Shapes of these kinds, of any size; of machines slower or quicker than what flies."""
    count = round(duration_s / STEP_S)
    rng = np.random.default_rng(seed)
    if "multisine" in kinds:
        for low in (0.06, 0.12, 0.25):
            for high in (0.5, 0.8, 1.2, 1.8):
                for fall in (0.8, 1.3, 1.8, 2.4):
                    yield _multisine(count, pace * low, pace * high, fall, rng)
    if "steps" in kinds:
        for hold in (2.0, 3.0, 4.5):
            for smoothing in (0.12, 0.2, 0.35, 0.6):
                yield _steps(count, hold / pace, smoothing / pace, rng)


def _multisine(count: int, low_hz: float, high_hz: float, power: float, rng: np.random.Generator) -> Shape:
    """Sines on a grid of frequencies, amplitudes falling as a power of it, phases of the smallest crest."""
    time = STEP_S * np.arange(count)
    frequency = np.geomspace(low_hz, high_hz, 10)
    angle = 2.0 * np.pi * time[:, None] * frequency
    amplitude = frequency**-power
    best, crest = np.zeros(count), np.inf
    for phases in rng.uniform(0.0, 2.0 * np.pi, (4, frequency.size)):
        series = np.sin(angle + phases) @ amplitude
        speed = np.diff(series)
        peak = float(np.abs(speed).max() / speed.std())
        if peak < crest:
            best, crest = series, peak
    words = f"{frequency.size} sines from {low_hz:g} to {high_hz:g} Hz, amplitudes falling as f^-{power:g}"
    return Shape("multisine", words, best * _window(time))


def _window(time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Rise and fall between the hovers at the ends, with three continuous derivatives."""
    from_end = np.minimum(time, time[-1] - time)
    phase = np.clip((from_end - HOVER_S) / FADE_S, 0.0, 1.0)
    return phase**4 * (35.0 - 84.0 * phase + 70.0 * phase**2 - 20.0 * phase**3)


def _steps(count: int, hold_s: float, smoothing_s: float, rng: np.random.Generator) -> Shape:
    """Levels up and down, each held for a while that varies, through equal first-order lags."""
    time = STEP_S * np.arange(count)
    settling_s = LAG_COUNT * 2.0 * smoothing_s
    starts = [HOVER_S]
    while starts[-1] < time[-1] - HOVER_S - settling_s - hold_s:
        starts.append(starts[-1] + hold_s * rng.uniform(0.6, 1.4))
    sign = np.where(np.arange(len(starts)) % 2 == 0, 1.0, -1.0)
    levels = np.concatenate([[0.0], sign * rng.uniform(0.5, 1.0, sign.size)])
    levels[-1] = 0.0
    series: Float[np.ndarray, " n"] = levels[np.searchsorted(starts, time, side="right")]
    for _ in range(LAG_COUNT):
        series = first_order_lag(series, step_s=STEP_S, lag_s=smoothing_s)
    words = (
        f"{len(starts)} steps, one every {hold_s:g} s or so, smoothed over {LAG_COUNT * smoothing_s:.1f} s"
    )
    return Shape("steps", words, series)


@dataclass(frozen=True, slots=True)
class ExportTarget:
    """A quantity of the vertical motion."""

    quantity: str
    words: str
    unit: str
    scale: float = 1.0
    relative: bool = False
    number: str = ""  # Of `VehicleGuess`


#: By their words on the command line, in the order of the ranking's joint vector.
TARGETS = {
    "friction": ExportTarget("viscous_friction", "viscous friction", "1/s", number="viscous_friction"),
    "gain": ExportTarget("input_gain", "input gain", "%", 100.0, relative=True),
    "lag": ExportTarget("effective_lag", "effective lag", "ms", 1000.0, number="lag_s"),
}

#: Gain of a velocity loop times its lag, and the largest one [1/s]; of the position loop, a share of that.
QUICKNESS, LARGEST_VELOCITY_GAIN, POSITION_SHARE, INTEGRAL_SHARE = 0.35, 4.0, 0.3, 0.05
#: Half a step of a controller at 100 Hz [s].
HALF_STEP_S = 0.005
#: Where numbers lie that nobody gave: evenly, and friction [1/s] and lag [s] evenly in logarithms.
USUAL = {"viscous_friction": (0.15, 0.9), "lag_s": (0.015, 0.12), "quadratic_share": (0.0, 0.5)}
#: From one simulated vehicle to the next, of these ranges: with them places fill space evenly (Roberts 2018).
SEQUENCE_STEPS = {"viscous_friction": 0.8192, "lag_s": 0.6710, "quadratic_share": 0.5497}


@dataclass(frozen=True)
class Densities:
    """One-sided residual densities over frequency, linear in logarithms."""

    frequency_hz: Float[np.ndarray, " n"]
    force: Float[np.ndarray, " n"]  # [(m/s^2)^2/Hz]
    accelerometer: Float[np.ndarray, " n"]  # [(m/s^2)^2/Hz]
    velocity: Float[np.ndarray, " n"]  # [(m/s^2)^2/Hz]
    climb_rms: float = 0.0  # Standard deviation of the climb rate with which they were measured [m/s]

    def density_at(self, name: str, frequency_hz: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
        """Density of that name above zero frequency; constant beyond the ends, force falls above them."""
        values = np.maximum(getattr(self, name), 1e-12)
        result = np.exp(np.interp(np.log(frequency_hz), np.log(self.frequency_hz), np.log(values)))
        if name == "force":
            result = result * np.minimum(1.0, (self.frequency_hz[-1] / frequency_hz) ** 2)
        return np.asarray(result)


class UsualNumber(float):
    """A number that nobody gave."""


@dataclass(frozen=True)
class VehicleGuess:
    """Rough numbers of a vehicle. Its mass is not needed.

    Raises
    ------
    UsageError
        When a number is out of its range.
    """

    hover_input: Annotated[float, (0.05, 0.95)] = 0.5  # Input at which it hovers, a share of full input
    viscous_friction: Annotated[float, (0.05, 1.5)] = UsualNumber(0.3)  # K [1/s]
    lag_s: Annotated[float, (0.005, 0.25)] = UsualNumber(0.05)  # Actuator lag and delay together [s]
    # Standard deviation of the vertical wind [m/s], where `densities` are not given
    gust_rms: Annotated[float, (0.0, 3.0)] = 0.3
    # Of the errors at 100 Hz [m/s^2], where `densities` are not given
    acceleration_noise: Annotated[float, (0.0, 5.0)] = 0.4
    velocity_noise: Annotated[float, (0.0, 1.0)] = 0.03  # Likewise [m/s]
    tilt_rms: Annotated[float, (0.0, 0.2)] = 0.05  # Standard deviation of roll and of pitch [rad]
    #: Share of the drag that is quadratic: gusts push a vehicle harder the faster it moves
    quadratic_share: Annotated[float, (0.0, 1.0)] = UsualNumber(0.25)
    issue_times_known: bool = False  # Whether its log, or a given rate, says when commands were issued
    densities: Densities | None = None  # What an estimate left; default: gusts and white noise as above
    controller: AltitudeController | None = None  # Of the height setpoint; default: one that suits the lag
    requested: str = field(default="", repr=False)  # What an estimate could not identify, a word of `TARGETS`

    def __post_init__(self) -> None:
        checks.in_ranges(self, "A rough number will do.")
        if self.densities is not None:
            checks.kind("densities", self.densities, Densities, "Densities", "Leave it out.")
        if self.controller is not None:
            checks.kind("controller", self.controller, AltitudeController, "a controller", "Leave it out.")
        checks.flag("issue_times_known", self.issue_times_known)
        checks.text("requested", self.requested)

    @property
    def unknown(self) -> dict[str, tuple[float, float]]:
        """Where numbers lie that nobody gave."""
        return {name: ends for name, ends in USUAL.items() if isinstance(getattr(self, name), UsualNumber)}

    def drawn(self, number: int) -> VehicleGuess:
        """The vehicle with other usual numbers in place of those that nobody gave."""
        values: dict[str, Any] = {}
        for name, (low, high) in self.unknown.items():
            share = (0.5 + number * SEQUENCE_STEPS[name]) % 1.0
            values[name] = low * (high / low) ** share if low > 0.0 else share * high
        return replace(self, **values)

    def harder(self, climb_rate: Float[np.ndarray, " n"], gust_rms: float) -> Float[np.ndarray, " n"]:
        """Factor of a gust's force at a climb rate [m/s], over that where it was measured."""
        # quadratic drag multiplies a gust by the airspeed, which in hover only gusts make
        share = self.quadratic_share / max(gust_rms, 1e-3)
        return np.hypot(1.0, share * climb_rate) / math.hypot(1.0, share * self.left.climb_rms)

    @property
    def input_gain(self) -> float:
        """K_u of a rotor whose thrust goes with the square of its share [m/s^2]."""
        return GRAVITY / self.hover_input**2

    @property
    def follows(self) -> AltitudeController:
        """Controller that the vehicle is simulated with."""
        if self.controller is not None:
            return self.controller
        velocity = min(QUICKNESS / (self.lag_s + HALF_STEP_S), LARGEST_VELOCITY_GAIN)
        return AltitudeController(POSITION_SHARE * velocity, velocity, INTEGRAL_SHARE * velocity**2)

    @property
    def left(self) -> Densities:
        """Residual densities: the estimate's, else of gusts of a second and white noise."""
        if self.densities is not None:
            return self.densities
        frequency = np.geomspace(0.05, 5.0, 12)
        gust = 4.0 * self.gust_rms**2 / (1.0 + (2.0 * np.pi * frequency) ** 2)
        white = np.ones(frequency.size) / 50.0
        return Densities(
            frequency,
            self.viscous_friction**2 * gust,
            self.acceleration_noise**2 * white,
            self.velocity_noise**2 * white,
        )


#: Words of the command line for its numbers.
ROUGH = {"hover": "hover_input", "friction": "viscous_friction", "lag": "lag_s", "gusts": "gust_rms"}


class FlownRecord(msgspec.Struct):
    """How the flights of a result were flown, as its motion has recorded it."""

    taken: dict[str, float] = {}
    residual: dict[str, list[float]] | None = None
    controller: dict[str, float] | None = None
    tilt_rms: float = VehicleGuess.tilt_rms
    climb_rms: float = 0.0
    issue_times_known: bool = False


def vehicle_of_result(
    model: str, input_map: str, quantities: Mapping[str, Quantity], record: object
) -> VehicleGuess:
    """Vehicle of a result; what it does not identify is taken as usual."""
    if model != "vertical_motion":
        expected = "a result of the vertical motion, or of a machine with an estimate"
        remedy = "Others are not planned: the remedies of eivor identify say how to move."
        raise UsageError(expected, f"one of '{model}'", remedy)
    # the first of friction, lag and gain that is not identified
    order = {"friction": "viscous_friction", "lag": "effective_lag", "gain": "input_gain"}
    try:
        flight = msgspec.convert(record, FlownRecord)
        verdicts = {word: quantities[name].verdict for word, name in order.items()}
        unidentified = (word for word, verdict in verdicts.items() if verdict is not Status.IDENTIFIED)
        residual = flight.residual
        arrays = {name: np.array(values) for name, values in (residual or {}).items()}
        return VehicleGuess(
            hover_input=_hover(quantities["hover_input"].value, input_map),
            viscous_friction=_in_range("viscous_friction", flight.taken),
            lag_s=_in_range("lag_s", flight.taken),
            tilt_rms=_in_range("tilt_rms", {"tilt_rms": flight.tilt_rms}),
            issue_times_known=flight.issue_times_known,
            densities=None if residual is None else Densities(**arrays, climb_rms=flight.climb_rms),
            controller=None if flight.controller is None else AltitudeController(**flight.controller),
            requested=next(unidentified, ""),
        )
    except (KeyError, TypeError, msgspec.ValidationError) as error:
        expected = "a result of the vertical motion that says how it was flown, under prediction.flown"
        raise InputError(expected, f"one that does not ({error})", "Identify the flight again.") from error


def _in_range(name: str, numbers: Mapping[str, float]) -> float:
    """A number clipped to its range, or the default where nothing is identified."""
    usual: float = getattr(VehicleGuess, name)
    number = numbers.get(name, usual)
    return usual if number == usual else float(np.clip(number, *checks.annotated(VehicleGuess)[name][0]))


def _hover(value: float, input_map: str) -> float:
    """Hover input as the share of a rotor whose thrust goes with its square; speeds have no share."""
    if not 0.0 < value < 1.0:
        return VehicleGuess.hover_input
    return _in_range("hover_input", {"hover_input": math.sqrt(value) if input_map == "linear" else value})
