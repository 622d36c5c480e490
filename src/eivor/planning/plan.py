"""Plans: of a flight by simulation, with files that fly it, and of a machine by the formula."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.resources import files
from itertools import chain

import msgspec
import numpy as np
import scipy

from eivor import checks
from eivor.errors import InputError, UsageError
from eivor.flights.quantity import Quantity
from eivor.flights.result import FlightEstimate
from eivor.inference.distributions import normal_quantile
from eivor.inference.verdict import Status
from eivor.motions.equation import TAIL, LoopResponses, faster
from eivor.motions.identify import identify_flight
from eivor.motions.machine import Machine
from eivor.planning.vehicle import KINDS, STEP_S, TARGETS, FlightLimits, Shape, VehicleGuess, candidates
from eivor.signals.recording import Recording
from eivor.signals.signals import stretches
from eivor.simulation import vertical
from eivor.tools import Float

#: Error of a logged height [m].
POSITION_NOISE = 0.01


@dataclass(frozen=True)
class ClosedLoopFlight:
    """Simulated flight of a shape."""

    shape: Shape
    height: Float[np.ndarray, " n"]  # [m]
    velocity: Float[np.ndarray, " n"]  # [m]
    recording: Recording

    def keeps(self, limits: FlightLimits) -> bool:
        """Whether the vehicle stayed within height and speed."""
        half_height = 0.5 * (limits.height_m[1] - limits.height_m[0])
        return bool(np.abs(self.height).max() <= half_height and np.abs(self.velocity).max() <= limits.speed)


def fly(
    shapes: Sequence[Shape], vehicles: Sequence[VehicleGuess], seeds: Sequence[int]
) -> list[ClosedLoopFlight]:
    """Fly each shape by its vehicle with its seed, all side by side."""
    environments = [_surroundings(*item) for item in zip(shapes, vehicles, seeds, strict=True)]
    environment = vertical.stacked(vertical.VerticalEnvironment, environments)
    numbers = [(_regular_friction(item), item.input_gain, item.lag_s, 0.0) for item in vehicles]
    motion = vertical.simulate_vertical(
        vertical.VerticalVehicles(*np.array(numbers).T),
        environment,
        step_s=STEP_S,
        controller=vertical.stacked(vertical.AltitudeController, [item.follows for item in vehicles]),
    )
    logs = (
        vertical.vertical_recording(f"planned {x.kind}", "plan", environment, motion, n)
        for n, x in enumerate(shapes)
    )
    # the log of an autopilot mostly does not say when its commands were issued
    logged = [
        log if vehicle.issue_times_known else replace(log, parameters={})
        for vehicle, log in zip(vehicles, logs, strict=True)
    ]
    return list(map(ClosedLoopFlight, shapes, motion.position.T, motion.velocity.T, logged))


def _regular_friction(vehicle: VehicleGuess) -> float:
    """Friction, shifted a little where the simulator's closed form is singular."""
    rate = 1.0 / vehicle.lag_s
    is_singular = any(abs(vehicle.viscous_friction - multiple * rate) < 1e-6 for multiple in (1.0, 2.0))
    return vehicle.viscous_friction + (1e-4 if is_singular else 0.0)


def _surroundings(shape: Shape, vehicle: VehicleGuess, seed: int) -> vertical.VerticalEnvironment:
    count = shape.offset.size
    force, acceleration, velocity, rest = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(4))
    angles = [vehicle.tilt_rms * _with_density(_tilt_density, count, rest) for _ in range(2)]

    def residual(name: str, rng: np.random.Generator) -> Float[np.ndarray, " n"]:
        return _with_density(partial(vehicle.left.density_at, name), count, rng)

    gust = residual("force", force) / _regular_friction(vehicle)
    return vertical.VerticalEnvironment(
        shape.offset,
        *shape.derivatives,
        gust=gust * vehicle.harder(shape.derivatives[0], float(gust.std())),
        cos_tilt=np.cos(angles[0]) * np.cos(angles[1]),
        position_noise=POSITION_NOISE * rest.standard_normal(count),
        velocity_noise=residual("velocity", velocity),
        acceleration_noise=residual("accelerometer", acceleration),
    )


def _tilt_density(frequency_hz: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Density of an angle of standard deviation 1 with that correlation time, smoothed."""
    pulsation = 2.0 * np.pi * frequency_hz
    wandering = 4.0 * vertical.TILT_CORRELATION_S / (1.0 + (pulsation * vertical.TILT_CORRELATION_S) ** 2)
    return np.asarray(wandering / (1.0 + (pulsation * vertical.TILT_SMOOTHING_S) ** 2))


def _with_density(
    density: Callable[[Float[np.ndarray, " m"]], Float[np.ndarray, " m"]],
    count: int,
    rng: np.random.Generator,
) -> Float[np.ndarray, " n"]:
    frequency = np.fft.rfftfreq(count, STEP_S)
    scale = np.zeros(frequency.size)
    scale[1:] = np.sqrt(density(frequency[1:]) * count / (4.0 * STEP_S))
    spectrum = scale * (rng.standard_normal(frequency.size) + 1j * rng.standard_normal(frequency.size))
    return np.fft.irfft(spectrum, n=count)


#: Band of the recipe [Hz].
BAND_HZ = (0.04, 5.0)


def ranked_std_errors(shape: Shape, vehicle: VehicleGuess) -> Float[np.ndarray, " 3"]:
    """Standard errors of friction [1/s], gain (as a share) and lag [s] by the formula, infinite for none."""
    count = shape.offset.size
    frequency = np.fft.rfftfreq(count, STEP_S)
    in_band = (frequency >= BAND_HZ[0]) & (frequency <= BAND_HZ[1])
    f = frequency[in_band]
    s, gains = 2j * np.pi * f, vehicle.follows
    # from the setpoint's velocity to the vehicle's, with feed-forward of velocity and acceleration
    plant = 1.0 / ((1.0 + s * vehicle.lag_s) * (s + vehicle.viscous_friction))
    feedback = (gains.velocity_gain + gains.integral_gain / s) * (1.0 + gains.position_gain / s)
    velocity = plant * (s + feedback) / (1.0 + plant * feedback) * s * np.fft.rfft(shape.offset)[in_band]
    drive = (s + vehicle.viscous_friction) * velocity
    columns = np.column_stack([-velocity, drive, -s / (1.0 + s * vehicle.lag_s) * drive])
    residual = vehicle.left
    gust_density = 1.0 / (
        1.0 / np.maximum(residual.density_at("accelerometer", f), 1e-9)
        + 1.0 / np.maximum(np.abs(s) ** 2 * residual.density_at("velocity", f), 1e-9)
    )
    density = (residual.density_at("force", f) + gust_density) * count / (2.0 * STEP_S)
    whitened = columns / np.sqrt(density)[:, None]
    rows = np.concatenate([whitened.real, whitened.imag])
    triangle = np.linalg.qr(rows, mode="r")
    try:
        inverse = np.linalg.solve(triangle, np.eye(3))
    except np.linalg.LinAlgError:
        return np.full(3, np.inf)
    return np.linalg.norm(inverse, axis=1)


# -- Plan of a flight --

#: So many shapes are flown in simulation. A flight of each chooses among them, so many others predict.
FINALISTS, RUNS = 3, 10
#: Flights longer than this leave time for one that predicts [s].
LONG_S = 150.0
#: How far a shape is made smaller when its flights leave the limits, and how often at most.
SHRINK_FACTOR, MOST_SHRINKS = 0.85, 4


@dataclass(frozen=True, slots=True)
class ExpectedWidth:
    """Half-width of a 95 % interval that a flight or a record is expected to give."""

    words: str
    value: float
    half_width: float  # Of a flight the median over the simulated ones
    unit: str
    verdicts: tuple[Status, ...] = ()  # Of the simulated flights

    @property
    def identified(self) -> int:
        """Number of simulated flights in which it was identified."""
        return sum(status is Status.IDENTIFIED for status in self.verdicts)


@dataclass(frozen=True)
class FlightPlan:
    """A flight, and what it is expected to identify."""

    vehicle: VehicleGuess  # What it was planned for
    limits: FlightLimits  # What it keeps
    target: str  # What it should identify, a word of `TARGETS`
    shape: Shape  # The height setpoint about the middle of the limits
    predicted: Mapping[str, ExpectedWidth]  # For each target
    #: Lowest and highest height above take-off [m] and largest speed [m/s] of the simulated flights.
    reached: tuple[float, float, float]

    @property
    def time_s(self) -> Float[np.ndarray, " n"]:
        """Time from the first setpoint [s]."""
        return STEP_S * np.arange(self.shape.offset.size)

    @property
    def height(self) -> Float[np.ndarray, " n"]:
        """Height setpoint above the place of take-off [m]."""
        return self.limits.middle_m + self.shape.offset

    @property
    def velocity(self) -> Float[np.ndarray, " n"]:
        """Its rate [m/s]."""
        return self.shape.derivatives[0]

    @property
    def acceleration(self) -> Float[np.ndarray, " n"]:
        """Its second derivative [m/s^2]."""
        return self.shape.derivatives[1]

    @property
    def is_informative(self) -> bool:
        """Whether the target was identified in most of the simulated flights."""
        result = self.predicted[self.target]
        return 2 * result.identified > len(result.verdicts)

    @property
    def sentence(self) -> str:
        """What is planned and expected, in a sentence."""
        result = self.predicted[self.target]
        flights = len(result.verdicts)
        return (
            f"{self.limits.duration_s:g} s of {self.shape.words}: the {result.words} within ± "
            f"{result.half_width:.2g} {result.unit}, identified in {result.identified} of {flights} "
            f"simulated flight{'' if flights == 1 else 's'}."
        )

    def taken(self, word: str) -> str:
        """Value of a target in the simulated flights, in its unit; nothing of one that is relative."""
        target = TARGETS[word]
        if usual := self.vehicle.unknown.get(target.number):
            return "{:.3g} to {:.3g}".format(*(target.scale * end for end in usual))
        return "" if target.relative else f"{self.predicted[word].value:.3g}"

    def summary(self) -> str:
        """Setpoint, expected half-widths and what the simulated flights reached, as plain text."""
        lines = [self.sentence]
        for word, item in self.predicted.items():
            target = TARGETS[word]
            value = self.taken(word)
            value_words = value and f" (of {value})"
            lines.append(f"{target.words:<18}± {item.half_width:.2g} {target.unit}{value_words}")
        low, high, speed = self.reached
        lines.append(f"heights {low:.1f} to {high:.1f} m above take-off, up to {speed:.1f} m/s")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<FlightPlan for the {self.predicted[self.target].words}: {self.sentence}>"


def make_plan(
    vehicle: VehicleGuess,
    *,
    target: str = "",
    limits: FlightLimits | None = None,
    shape: str = "",
    seed: int = 0,
) -> FlightPlan:
    """Choose a flight for the smallest interval of what is asked."""
    limits = FlightLimits() if limits is None else limits
    checks.kind("limits", limits, FlightLimits, "FlightLimits", "Give ev.FlightLimits(), or nothing.")
    checks.text("target", target)
    target = target or vehicle.requested or "friction"
    _check_choices(target, TARGETS, shape, seed)
    finalists = _finalists(vehicle, limits, target, (shape,) if shape else KINDS, seed)
    flights = _flights_within_limits(finalists, vehicle, limits, seed)
    best = min(flights, key=lambda runs: _half_width(identify_flight(runs[0].recording), target))
    # the flight that chose is the luckiest of several, and predicts too narrow an interval
    results = [identify_flight(item.recording) for item in best[1:]]
    values = {"friction": vehicle.viscous_friction, "gain": 1.0, "lag": vehicle.lag_s}
    predicted = {
        word: ExpectedWidth(
            item.words,
            item.scale * values[word],
            item.scale * float(np.median([_half_width(result, word) for result in results])),
            item.unit,
            tuple(result.quantities[item.quantity].verdict for result in results),
        )
        for word, item in TARGETS.items()
    }
    heights = np.concatenate([item.height for item in best]) + limits.middle_m
    speed = max(float(np.abs(item.velocity).max()) for item in best)
    reached = (float(heights.min()), float(heights.max()), speed)
    return FlightPlan(vehicle, limits, target, best[0].shape, predicted, reached)


def _check_choices(target: str, targets: Iterable[str], shape: str, seed: int) -> None:
    checks.index_of("a target", target, targets)
    checks.text("shape", shape)
    checks.index_of("a shape", shape or KINDS[0], KINDS, "Or nothing, for the better one.")
    checks.seed(seed)


def _finalists(
    vehicle: VehicleGuess, limits: FlightLimits, target: str, kinds: tuple[str, ...], seed: int
) -> list[Shape]:
    """The best shapes of each kind by the formula, then the best for target and lag."""
    shapes = [shape.within(limits) for shape in candidates(limits.duration_s, kinds, seed)]
    errors = np.array([ranked_std_errors(shape, vehicle) for shape in shapes])
    words = list(TARGETS)
    target_errors, lag_errors = errors[:, words.index(target)], errors[:, words.index("lag")]
    best = [shapes[index] for index in np.argsort(target_errors)]
    best_of_kind = [next(item for item in best if item.kind == kind) for kind in kinds]
    best_with_lag = [shapes[index] for index in np.argsort(target_errors * lag_errors)]
    return list({id(item): item for item in (*best_of_kind, *best_with_lag)}.values())[:FINALISTS]


def _flights_within_limits(
    shapes: list[Shape], vehicle: VehicleGuess, limits: FlightLimits, seed: int
) -> list[list[ClosedLoopFlight]]:
    """Flights of each shape, shrunk until all of them keep the limits."""
    runs = 1 + (RUNS if limits.duration_s <= LONG_S else 1)
    for _ in range(MOST_SHRINKS):
        seeds = [seed + run for run in range(runs)]
        cases = [(shape, vehicle.drawn(run), seed) for shape in shapes for run, seed in enumerate(seeds)]
        flights = fly(*zip(*cases, strict=True))
        by_shape = [flights[first : first + runs] for first in range(0, len(flights), runs)]
        within_limits = [of_shape for of_shape in by_shape if all(item.keeps(limits) for item in of_shape)]
        if within_limits:
            return within_limits
        shapes = [shape.scaled(SHRINK_FACTOR) for shape in shapes]
    raise InputError(
        "a flight that keeps its limits",
        f"flights that leave {limits.height_m[0]:g} to {limits.height_m[1]:g} m or {limits.speed:g} m/s in "
        "the wind of the simulation",
        "Widen the limits, or wait for calmer air.",
    )


def _half_width(result: FlightEstimate, target: str) -> float:
    """Half-width in SI, or as a share; infinite without an estimate."""
    target_quantity = TARGETS[target]
    quantity = result.quantities[target_quantity.quantity]
    width = quantity.half_width / (abs(quantity.value) if target_quantity.relative else 1.0)
    return width if math.isfinite(width) else math.inf


# -- Plan of a machine --

#: Candidates are so many times as quick as those of flights.
PACES = (0.25, 1.0, 4.0)
#: Length of what can be planned [s].
SECONDS = (10.0, 3600.0)
#: Intervals are wider than the formula by what those of the log were, within these.
WIDENING_LIMITS = (1.0, 4.0)
#: References are so many times as quick as those of the log, at most.
QUICKER_LIMIT = 1.75
ALL = "all"


@dataclass(frozen=True)
class MachinePlan:
    """References of a machine, and what they are expected to identify."""

    machine: Machine
    target: str  # A parameter, or "all"
    shape: Shape  # Of the first reference
    references: Mapping[str, Float[np.ndarray, " n"]]  # Every `STEP_S`, about their levels in the log
    limits: Mapping[str, tuple[float, ...]]  # As in `LoopResponses.sizes`
    predicted: Mapping[str, ExpectedWidth]

    @property
    def time_s(self) -> Float[np.ndarray, " n"]:
        """Time from the first setpoint [s]."""
        return STEP_S * np.arange(self.shape.offset.size)

    @property
    def _sought(self) -> list[ExpectedWidth]:
        names = self.machine.headline if self.target == ALL else (self.target,)
        return [self.predicted[name] for name in names if name in self.predicted]

    @property
    def is_informative(self) -> bool:
        """Whether the target, or the headline, is expected to be identified."""
        limit = self.machine.half_widths[0]
        return all(item.half_width <= limit * abs(item.value) for item in self._sought)

    @property
    def sentence(self) -> str:
        """What is planned and expected, in a sentence."""
        widths = (f"{item.words} within ± {item.half_width:.2g} {item.unit}".strip() for item in self._sought)
        where = " and ".join(self.references)
        return f"{self.time_s.size * STEP_S:g} s of {self.shape.words} in {where}: {' and '.join(widths)}."

    def summary(self) -> str:
        """References and expected half-widths, as plain text."""
        rows = (
            f"{item.words:<18}{item.value:.3g} ± {item.half_width:.2g} {item.unit}".rstrip()
            for item in self.predicted.values()
        )
        return "\n".join([self.sentence, *rows])

    def __repr__(self) -> str:
        return f"<MachinePlan for {self.machine.name}: {self.sentence}>"

    def csv_text(self) -> str:
        """Setpoints at 100 Hz, under the names of their channels."""
        columns = np.column_stack([self.time_s, *self.references.values()])
        return _csv(("time", *self.references), columns, 6)


def plan_machine(
    machine: Machine,
    quantities: Mapping[str, Quantity],
    record: object,
    limits: Mapping[str, tuple[float, ...]],
    seconds: float,
    seed: int,
    *,
    target: str = "",
    shape: str = "",
) -> MachinePlan:
    """References for the smallest joint uncertainty, or the smallest interval of one parameter."""
    try:
        loop = msgspec.convert(record, LoopResponses)
    except msgspec.ValidationError as error:
        expected = "a result of a log whose references move, with prediction.flown in its JSON"
        raise InputError(
            expected, f"one without ({error})", "Log a reference, and identify it again."
        ) from None
    values = {name: item.value for name, item in quantities.items()}
    known = [name for name in loop.std_errors if name in machine.quantities]
    checks.text("target", target)
    target = target or ALL
    _check_choices(target, (ALL, *known), shape, seed)
    inputs = [item.name for item in machine.logged if item.role == "input"]
    allowed = {name: loop.sizes[name] for name in (*loop.references, *inputs)}
    for name, sizes in limits.items():
        checks.index_of("a channel", name, tuple(loop.sizes))
        if not sizes or not all(item > 0.0 for item in sizes):
            received = f"{tuple(sizes)} for {name}"
            raise UsageError("a size, and maybe a rate, above zero", received, "Such as 0.5.")
        allowed[name] = (*sizes, *allowed.get(name, ())[len(sizes) :])
    counted, lowest = machine.activity.counted, math.inf
    best: tuple[Shape, dict[str, Float[np.ndarray, " n"]], dict[str, float]] | None = None
    seeds, kinds = range(seed, seed + len(loop.references)), (shape or KINDS[0],)
    by_pace = (zip(*(candidates(seconds, kinds, k, pace) for k in seeds), strict=True) for pace in PACES)
    for shapes in chain.from_iterable(by_pace):
        deltas = _scaled_references(loop, shapes, allowed)
        tops = loop.highest_hz.items()
        if any(faster(deltas[name], loop.step_s, QUICKER_LIMIT * high) > 2.0 * TAIL for name, high in tops):
            continue  # nobody knows how it would answer
        channels = loop.channels(deltas)
        errors, volume = loop.expected(machine.axes, counted, channels, values, machine.delays_s)
        score = volume if target == ALL else errors.get(target, math.inf)
        if score < lowest:
            lowest, best = score, (shapes[0], deltas, errors)
    if best is None:
        raise InputError("a reference that moves within its limits", f"{allowed}", "Widen the limits.")
    best_shape, deltas, errors = best
    quantile, predicted = normal_quantile(0.95), {}
    for name in known:
        item = quantities[name]
        measured = item.half_width / (quantile * loop.std_errors[name])
        factor = float(np.clip(measured, *WIDENING_LIMITS)) if math.isfinite(measured) else WIDENING_LIMITS[1]
        words = machine.quantities[name].words
        predicted[name] = ExpectedWidth(words, item.value, factor * quantile * errors[name], item.unit)
    time = np.arange(best_shape.offset.size) * STEP_S
    setpoints = {
        name: loop.levels[name] + _spline(loop.step_s, series, time) for name, series in deltas.items()
    }
    return MachinePlan(machine, target, best_shape, setpoints, allowed, predicted)


def _scaled_references(
    responses: LoopResponses, shapes: tuple[Shape, ...], limits: Mapping[str, tuple[float, ...]]
) -> dict[str, Float[np.ndarray, " n"]]:
    """References scaled to the limits of channels."""
    results = {}
    for name, shape in zip(responses.references, shapes, strict=True):
        time = np.arange(0.0, STEP_S * shape.offset.size, responses.step_s)
        series = _spline(STEP_S, shape.offset, time)
        results[name] = series * _factor(series, responses.step_s, limits[name])
    channels = responses.channels(results)
    levels = responses.levels
    factor = min(
        _factor(channels[name] - levels[name], responses.step_s, limit) for name, limit in limits.items()
    )
    return {name: min(factor, 1.0) * series for name, series in results.items()}


def _factor(series: Float[np.ndarray, " n"], step_s: float, limit: Sequence[float]) -> float:
    """Largest scale at which a series, its rate and its acceleration keep limits."""
    peaks = (float(np.abs(np.diff(series, n)).max()) / step_s**n for n in range(len(limit)))
    return min(largest / max(item, 1e-300) for item, largest in zip(peaks, limit, strict=True))


def _spline(
    step_s: float, series: Float[np.ndarray, " n"], times: Float[np.ndarray, " m"]
) -> Float[np.ndarray, " m"]:
    """Cubic spline through samples, at other times; constant after the end."""
    time = step_s * np.arange(series.size)
    return np.asarray(scipy.interpolate.CubicSpline(time, series)(np.minimum(times, time[-1])))


# -- Files --

#: Commands of MAVLink.
WAYPOINT, LOITER, TAKEOFF, CHANGE_SPEED = 16, 17, 22, 178
#: Frame of heights above the place of take-off; commands without a place have another.
RELATIVE, NO_PLACE = 3, 2
CLIMB, DESCENT = 2.0, 3.0


def qgc_text(plan: FlightPlan, home: tuple[float, float]) -> str:
    """Text of a .plan file."""
    if plan.shape.kind != "steps":
        raise UsageError("a plan of steps", f"a {plan.shape.kind}", "Plan with --shape steps.")
    latitude, longitude = home
    if not (abs(latitude) <= 90.0 and abs(longitude) <= 180.0):
        received = f"{latitude:g}, {longitude:g}"
        raise UsageError("a latitude and a longitude [deg]", received, "Such as 47.4,8.5.")
    position = [round(float(latitude), 7), round(float(longitude), 7)]
    speed = plan.limits.speed * 0.8
    commands: list[tuple[int, int, list[float | None]]] = [
        (TAKEOFF, RELATIVE, [0.0, 0.0, 0.0, None, *position, plan.limits.middle_m]),
        (CHANGE_SPEED, NO_PLACE, [CLIMB, speed, -1.0, 0.0, 0.0, 0.0, 0.0]),
        (CHANGE_SPEED, NO_PLACE, [DESCENT, speed, -1.0, 0.0, 0.0, 0.0, 0.0]),
        *(
            (WAYPOINT, RELATIVE, [hold_s, 0.0, 0.0, None, *position, height])
            for height, hold_s in levels(plan)
        ),
        (LOITER, RELATIVE, [0.0, 0.0, 0.0, None, *position, plan.limits.middle_m]),
    ]
    items = [_item(number, *command) for number, command in enumerate(commands, start=1)]
    document = json.loads(_text("mission.json"))
    document["mission"] |= {"plannedHomePosition": [*position, 0.0], "items": items}
    return json.dumps(document, indent=2, allow_nan=False) + "\n"


def levels(plan: FlightPlan) -> list[tuple[float, float]]:
    """Heights above take-off [m] at which the setpoint rests, each with how long [s], in order."""
    results: list[tuple[float, float]] = []
    for rest in stretches(np.abs(plan.velocity) < 0.05 * plan.limits.speed):
        height = round(float(np.median(plan.height[rest])), 2)
        if not results or abs(height - results[-1][0]) > 0.1:
            results.append((height, math.floor((rest.stop - rest.start) * STEP_S * 10.0) / 10.0))
    return results


def _item(number: int, command: int, frame: int, params: list[float | None]) -> dict[str, object]:
    item: dict[str, object] = {"type": "SimpleItem", "autoContinue": True, "command": command}
    item |= {"doJumpId": number, "frame": frame, "params": params}
    if frame == RELATIVE:
        item |= {"AMSLAltAboveTerrain": None, "Altitude": params[-1], "AltitudeMode": 1}
    return item


def sampled(plan: FlightPlan, rate_hz: float) -> Float[np.ndarray, "n 4"]:
    """Time [s], height above take-off [m], velocity [m/s] and acceleration [m/s^2] at about that rate."""
    stride = max(round(1.0 / (rate_hz * STEP_S)), 1)
    return np.column_stack([plan.time_s, plan.height, plan.velocity, plan.acceleration])[::stride]


OFFBOARD_RATE_HZ = 20.0


def mavsdk_text(plan: FlightPlan) -> str:
    """Text of a Python program for MAVSDK-Python 3."""
    return _program("fly_plan.txt", limits=plan.limits, rows=sampled(plan, OFFBOARD_RATE_HZ).tolist())


def _text(file: str) -> str:
    return files("eivor.planning").joinpath(file).read_text(encoding="utf-8")


def _program(file: str, **numbers: object) -> str:
    """Program with numbers in it."""
    from jinja2 import StrictUndefined, Template

    template = Template(_text(file), keep_trailing_newline=True, trim_blocks=True, undefined=StrictUndefined)
    return template.render(numbers)


COLUMNS = ("time", "reference_position_z", "reference_velocity_z", "reference_acceleration_z")
TABLE_RATE_HZ = 50.0


def csv_text(plan: FlightPlan) -> str:
    """Setpoints at 50 Hz: seconds, metres above the place of take-off, m/s, m/s^2."""
    return _csv(COLUMNS, sampled(plan, TABLE_RATE_HZ), 5)


def _csv(names: Sequence[str], columns: Float[np.ndarray, "n k"], digits: int) -> str:
    rows = (",".join(f"{value:.{digits}g}" for value in row) for row in columns.tolist())
    return "\n".join([",".join(names), *rows]) + "\n"


def rotorpy_text(plan: FlightPlan) -> str:
    """Text of a Python module with the class `PlannedFlight`."""
    return _program("trajectory.txt", rows=sampled(plan, TABLE_RATE_HZ).tolist())


@dataclass(frozen=True, slots=True)
class WrittenPlan:
    """A kind of file."""

    words: str
    file: str
    write: Callable[..., str]  # Of a plan; of a mission, of a plan and its place
    is_mission: bool = False

    def text(self, plan: FlightPlan, position: tuple[float, float] | None) -> str:
        """Content of the file; a mission has the place too."""
        return self.write(plan, position) if self.is_mission else self.write(plan)


WRITTEN = {
    "csv": WrittenPlan("table of setpoints", "setpoints.csv", csv_text),
    "mavsdk": WrittenPlan("MAVSDK program that flies it", "fly_plan.py", mavsdk_text),
    "qgc": WrittenPlan("QGroundControl plan", "flight.plan", qgc_text, is_mission=True),
    "rotorpy": WrittenPlan("trajectory of RotorPy", "trajectory.py", rotorpy_text),
}
