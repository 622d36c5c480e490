"""Regression problem of the vertical motion: terms, row noise and force balance."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import msgspec
import numpy as np

from eivor.errors import InputError, MissingChannelError, UsageError
from eivor.estimation.estimate import Estimate
from eivor.flights.grid import on_grid
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import CommandLimit, InputFamily, PreparedFlight
from eivor.inference.covariance import COSINE_AVERAGES, long_run_mean_variance
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.distributions import normal_quantile, t_quantile
from eivor.models import lagged_runs, separable
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, AxisColumns
from eivor.models.spectral import LINE_S
from eivor.motions.equation import AxisEquation, Term, evaluated, explained, mean_of
from eivor.motions.vertical.model import INPUT_GAIN, VISCOUS_FRICTION
from eivor.motions.vertical.select import INPUTS, FittedCurve
from eivor.signals.recording import GRAVITY
from eivor.signals.signals import Signals
from eivor.signals.thrust_map import InputMap, Power, input_map
from eivor.tools import Float

# -- Equation --

FORCE = "specific_force_z"
#: What the gain multiplies: the cosine of tilt times the mean of the mapped states; and the change of z'.
MAPPED, DERIVATIVE = "mapped_input", "velocity_derivative"
#: Of optional terms: the lift over the mapped input of that mean, the height over the ground in rotor radii,
#: and the voltage over its mean less one.
PER_INPUT, RADII, VOLTAGE_SHARE = "lift_per_input", "radii", "voltage_share"
#: Actuators without lag and delay.
NO_LAG_VALUES = {ACTUATOR_LAG.name: 0.0, DELAY.name: 0.0}


@dataclass(frozen=True)
class VerticalEquation(AxisEquation):
    """Equation of the vertical motion, with the mapped input in place of the logged one."""

    driving: InputFamily = INPUTS[0]
    input_map: InputMap = field(default_factory=Power)

    def family(self, signals: Signals, _name: str) -> Float[np.ndarray, "n m"]:
        return signals.family(self.driving.name)

    def states(
        self, logged: Mapping[str, Float[np.ndarray, "n m"]], signals: Signals, path: Mapping[str, float]
    ) -> Mapping[str, Float[np.ndarray, " n"]]:
        command = logged[MAPPED]
        if self.input_map == Power() and not path.get("asymmetry"):
            command = mean_of(command)[:, None]  # what is linear answers to the mean
        states = self.input_map(self.driving.state(command, signals.step_s, **path))
        return {MAPPED: mean_of(states) * signals.channel("cos_tilt")}


EQUATION = VerticalEquation(
    "vertical",
    (MAPPED,),
    (f"{FORCE} - {GRAVITY}", DERIVATIVE),
    (
        Term(VISCOUS_FRICTION.name, "-velocity_z", "K", VISCOUS_FRICTION.unit),
        Term(INPUT_GAIN.name, MAPPED, "K_u", INPUT_GAIN.unit, behind=True),
    ),
    ("vertical acceleration", "m/s²", "K_u U − K z'", "K_u U"),
)


def equation_of(flight: PreparedFlight, added: tuple[OptionalTerm, ...] = ()) -> VerticalEquation:
    """The equation with optional terms, and the input and the map of a flight."""
    terms, curve = (*EQUATION.terms, *added), input_map(flight.input_map)
    linear = curve == Power() and not flight.input.measured
    return replace(EQUATION, terms=terms, driving=flight.input, input_map=curve, linear=linear)


def mapped_input(flight: PreparedFlight, **path: float) -> Float[np.ndarray, " n"]:
    """Mapped input over the whole grid, at a lag, a delay and a second stage; by default at once."""
    signals, path = flight.signals, {"lag_s": 0.0, "delay_s": 0.0, **path}
    return equation_of(flight).states({MAPPED: signals.family(flight.input.name)}, signals, path)[MAPPED]


def mean_command(flight: PreparedFlight) -> float:
    """Mean of the rotors' commands over the command of their mean thrust, each a mean over time."""
    means, curve = flight.used_input.mean(axis=0), input_map(flight.input_map)
    collective = curve.inverse(float(curve(means[None]).mean()))
    return float(means.mean() / collective) if collective > 0.0 else 1.0


def signals_of(
    flight: PreparedFlight, with_terms: bool, radius: float | None, reference_voltage: float | None
) -> Signals:
    """Signals of the equation: channels, and series derived from them."""
    signals, mapped = flight.signals, mapped_input(flight)
    added = {DERIVATIVE: np.gradient(signals.channel("velocity_z"), signals.step_s), MAPPED: mapped}
    if with_terms:
        # of either sign; one where it is zero
        added[PER_INPUT] = np.full(mapped.size, GRAVITY / (float(mapped[flight.used].mean()) or 1.0))
        (height, _), volts = height_over_ground(flight), voltage(flight)
        if height is not None and radius is not None:
            added[RADII] = height / radius
        if volts is not None and reference_voltage is not None:
            added[VOLTAGE_SHARE] = volts / reference_voltage - 1.0
    return replace(signals, channels={**signals.channels, **added})


# -- Terms --

#: Names of omitted terms in their tests.
DRAG, GROUND, SUPPLY = "quadratic_drag", "ground_effect", "supply"
#: Power of the polynomial of time that is an instrument for the voltage.
TREND = 3


@dataclass(frozen=True, kw_only=True)
class OptionalTerm(Term):
    """A term that a user may add to the equation."""

    behind: bool = True  # So that it comes after the gain
    word: str  # As it is requested
    meaning: str
    written: str  # As it stands in the equation, with its sign
    symbols: str = ""  # What its symbols are; empty where the equation has none


QUADRATIC_DRAG = OptionalTerm(
    "quadratic_drag",
    "-velocity_z * abs(velocity_z)",
    "K_2",
    "1/m",
    word="quadratic-drag",
    meaning="drag that grows with the square of the speed",
    written="- K_2 z'|z'|",
)
GROUND_EFFECT = OptionalTerm(
    "ground_effect",
    # lift over the squared height in radii, of half a radius at least
    f"{PER_INPUT} * {MAPPED} * greatest({RADII}, 0.5) ** -2",
    "k",
    "",
    word="ground-effect",
    meaning="thrust that grows as one over the squared height over the ground",
    written="+ k g (U/mean U) (R/h)²",
    symbols="h the height over the ground, R a rotor's radius",
)
VOLTAGE_TERM = OptionalTerm(
    "voltage_exponent",
    f"{PER_INPUT} * {MAPPED} * {VOLTAGE_SHARE}",
    "n",
    "",
    word="voltage",
    meaning="thrust that follows the battery's voltage",
    written="+ n g (U/mean U) (V/V_0 - 1)",
    symbols="V the battery's voltage, V_0 its mean",
)
#: By the words of the command line.
TERMS = {term.word: term for term in (QUADRATIC_DRAG, GROUND_EFFECT, VOLTAGE_TERM)}


def explained_channels(
    channels: Mapping[str, np.ndarray], item: AxisColumns
) -> dict[str, Float[np.ndarray, " n"]]:
    """Velocity, mapped input and height as references predict them."""
    names = [name for name in ("velocity_z", MAPPED, RADII) if name in channels]
    made = explained(item.instruments, item.runs, np.column_stack([channels[name] for name in names])).T
    return dict(zip(names, made, strict=True))


def with_instruments_of(
    terms: Sequence[OptionalTerm], item: AxisColumns, signals: Signals
) -> Float[np.ndarray, "n q"]:
    """References of a flight, and an instrument for each term."""
    predicted = explained_channels(signals.channels, item)
    if VOLTAGE_SHARE in signals.channels:
        time = np.linspace(-1.0, 1.0, signals.sample_count)
        trend = np.column_stack([time**power for power in range(1, TREND + 1)])
        # the charge alone: loads, which references explain, pull the voltage down within a second
        predicted[VOLTAGE_SHARE] = explained(trend, item.runs, signals.channel(VOLTAGE_SHARE)[:, None])[:, 0]
    return np.column_stack(
        [item.instruments, *(evaluated(term.expression, signals, predicted) for term in terms)]
    )


# -- Flights --


@dataclass(frozen=True, kw_only=True)
class VerticalFlights(lagged_runs.LaggedRuns):
    """Regressions of vertical motion for each actuator lag and delay."""

    flights: tuple[PreparedFlight, ...]
    made_of: Callable[[tuple[PreparedFlight, ...]], VerticalFlights]  # Problem of other flights
    terms: tuple[OptionalTerm, ...] = ()
    command_limit: CommandLimit | None = None  # Limit that was applied to commands
    unlimited: bool = False  # Whether no limit of commands was found with this map
    curve: FittedCurve | None = None

    @cached_property
    def input_map(self) -> InputMap:
        return input_map(self.flights[0].input_map)

    @cached_property
    def lines(self) -> list[Float[np.ndarray, " _"]]:
        """Seconds from the middle of each run whose rows lose a line in time; zeros in shorter ones."""
        results = []
        for item in self.columns:
            times = item.cut(np.arange(len(item.fixed)) * item.step_s)
            lengths = [(run.stop - run.start) * item.step_s for run in item.runs]
            pairs = zip(times, lengths, strict=True)
            results += [(time - time.mean()) * (length >= LINE_S) for time, length in pairs]
        return results

    @property
    def few_rows(self) -> bool:
        """Whether there are terms: voltage and height change slowly."""
        return bool(self.terms)

    def of(self, flights: tuple[PreparedFlight, ...]) -> VerticalFlights:
        """Problem of other flights, or of these with other commands or another map."""
        problem = self.made_of(flights)
        return replace(problem, nuisances=self.nuisances, command_limit=self.command_limit)

    def sampled_state(self, _at: separable.Values) -> separable.SampledState | None:
        """The vertical velocity, where every flight has an accelerometer."""
        if any(FORCE not in flight.signals.channels for flight in self.flights):
            return None
        powers = []  # per Hz, of the errors in z', U and z'' at low frequencies
        for flight in self.flights:
            noise = {name: level.density**2 for name, level in flight.noise.items() if level.source}
            of_sensors = [noise.get(name, np.nan) for name in ("velocity_z", FORCE)]
            powers.append([of_sensors[0], input_variance(flight, noise), of_sensors[1]])
        lengths = [flight.used.sum() for flight in self.flights]
        velocity, driving, response = np.sqrt(np.average(powers, axis=0, weights=lengths)).tolist()
        input_errors = np.zeros(len(self.parameters))
        input_errors[1] = driving
        return separable.SampledState(0, velocity, response, input_errors)


#: Share of the largest state over which the slope of an input map is taken.
SLOPE_STEP = 1e-5
#: Samples that an actuator's response is followed over: 25 of the longest lags on a grid of 5 ms.
RESPONSE_SAMPLES = 1_500
#: Samples before the impulse, so that a state may be early.
PRE_IMPULSE = 50


def row_noise(
    flights: Sequence[PreparedFlight],
    terms: int,
    instruments: int,
    rule: separable.InstrumentRule,
    nuisance_values: separable.Values,
) -> lagged_runs.RowNoise:
    """Variances of the errors in z', U, terms and z'', and covariances of past inputs with U."""
    selected, shared = [], []
    for flight in flights:
        noise = {name: item.std**2 for name, item in flight.signals.noise.items()}
        if "velocity_z" in noise and FORCE not in flight.signals.channels:
            noise[FORCE] = noise["velocity_z"] / (2.0 * flight.signals.step_s**2)
        variance = input_variance(flight, noise)
        response = _response(flight, nuisance_values) if variance else np.zeros(1)
        velocity, force = (noise.get(name, np.nan) for name in ("velocity_z", FORCE))
        selected.append([velocity, variance * float(response @ response), *[0.0] * terms, force])
        # covariance of the instruments' noises with those of [Phi y]
        covariance = np.zeros((instruments, terms + 3))
        if isinstance(rule, separable.LaggedInputs) and variance and response.any():
            covariance[: rule.last - rule.first + 1, 1] = variance * response[rule.first : rule.last + 1]
        shared.append(covariance)
    weights = [float(flight.used.sum()) for flight in flights]
    mean = np.average(selected, axis=0, weights=weights)
    regressors = None if np.isnan(mean).any() else np.diag(mean)
    return regressors, np.average(shared, axis=0, weights=weights)


def input_variance(flight: PreparedFlight, noise: Mapping[str, float]) -> float:
    """Variance of the mapped input's error by that of channels, without the actuators' response."""
    variances = np.array([noise.get(name, 0.0) for name in flight.driving])
    if not variances.any():
        return 0.0
    state, curve = flight.signals.family(flight.input.name), input_map(flight.input_map)
    step = SLOPE_STEP * max(float(np.abs(state).max()), SLOPE_STEP)
    slopes = (curve(state + step) - curve(state - step)) / (2.0 * step)
    tilt = flight.signals.channel("cos_tilt")[:, None]
    gains = (tilt * slopes / variances.size)[flight.used] ** 2
    return float(gains.mean(axis=0) @ variances)


def _response(flight: PreparedFlight, nuisance_values: separable.Values) -> Float[np.ndarray, " lags"]:
    """Samples after an impulse of the input, of the state that enters the equation."""
    impulse = np.zeros((PRE_IMPULSE + RESPONSE_SAMPLES, 1))
    impulse[PRE_IMPULSE] = 1.0
    path = lagged_runs.actuators(nuisance_values)
    return np.asarray(flight.input.state(impulse, flight.signals.step_s, **path)[PRE_IMPULSE:, 0])


# -- Balance --

#: Names of the change of the thrust of one command, and of that of the hover input.
DRIFT, HOVER_DRIFT = "thrust_drift", "hover_drift"

#: A quantity that is linear in an estimate: value, gradient by the joint vector, and variance besides.
Linear = tuple[float, Float[np.ndarray, " n"], float]
#: Half of what the friction of a multirotor may be at most [1/s].
MIDDLE_FRICTION = 0.4
#: Gains with a wider interval do not serve the hover input, which then rests on thrust that is the weight.
ROUGH_GAIN = 0.25


@dataclass(frozen=True)
class WeightBalance:
    """Hover input and its drift by thrust that is the weight: neither a gain nor an instrument is needed."""

    problem: VerticalFlights
    nuisances: separable.Values

    @cached_property
    def columns(self) -> list[Float[np.ndarray, "_ m"]]:
        """z'', z', U and the columns of terms, of every run."""
        return [run for flight in _columns(self.problem, self.nuisances) for run in flight]

    @cached_property
    def means(self) -> Float[np.ndarray, " m"]:
        return np.concatenate(self.columns).mean(axis=0)

    @cached_property
    def excess(self) -> Float[np.ndarray, " n"]:
        """U over its mean, less 1 + (z'' + K z') / g: about ln U less that of hover."""
        derivative, velocity, mapped = np.concatenate(self.columns)[:, :3].T
        return np.asarray(
            mapped / (self.means[2] or 1.0) - 1.0 - (derivative + MIDDLE_FRICTION * velocity) / GRAVITY
        )

    @property
    def hover(self) -> tuple[float, float, float]:
        """U_h, to second order the mean of U / (1 + (z'' + K z') / g); standard error, 95 % half-width."""
        value, lines = float(self.means[2]) * (1.0 + float(self.excess.mean())), self.problem.lines
        averages = COSINE_AVERAGES - bool(np.concatenate(lines).any())  # the first is that of a line
        variance = _variance_of_mean(self.problem, self.excess) * COSINE_AVERAGES / averages
        std_error = abs(value) * math.sqrt(variance)
        bound = abs(value * MIDDLE_FRICTION * float(self.means[1]) / GRAVITY)
        return value, std_error, t_quantile(0.95, averages) * std_error + bound

    @property
    def drift(self) -> ThrustDrift | None:
        """Slope of the excess in time, as a change of thrust; None of short runs."""
        line, velocity = np.concatenate(self.problem.lines), np.concatenate(self.columns)[:, 1]
        squares, curve = float(line @ line), self.problem.input_map
        hover = curve.inverse(max(self.hover[0], 0.0))
        if not (squares and hover > 0.0):
            return None
        slope, centred = float(line @ self.excess) / squares, self.excess - self.excess.mean()
        error = math.sqrt(long_run_mean_variance(line * (centred - slope * line))) * line.size / squares
        bound = MIDDLE_FRICTION * abs(float(line @ velocity)) / squares
        half_width = GRAVITY * t_quantile(0.95, COSINE_AVERAGES) * error + bound
        exponent = hover * curve.slope(hover) / curve(np.array([hover]))[0]
        return ThrustDrift(-GRAVITY * slope, half_width, _duration_s(self.problem), exponent)


@dataclass(frozen=True)
class Balance:
    """Means over the runs of the terms of the equation of motion, at an estimate."""

    problem: VerticalFlights
    estimate: Estimate

    @cached_property
    def weight(self) -> WeightBalance:
        """The balance without the gain."""
        return WeightBalance(self.problem, self.estimate.nuisances)

    @property
    def by_weight(self) -> bool:
        """Whether the gain is too uncertain for the hover input."""
        gain, direction = float(self.estimate.theta[1]), self.estimate.direction("input_gain")
        known = self.estimate.joint_covariance.half_width(direction) < ROUGH_GAIN * gain
        strong = bool(self.estimate.first_stage[1] >= STRONG_FIRST_STAGE)
        return not (self.problem.terms or (known and strong)) and self.weight.hover[0] > 0.0

    @property
    def coefficients(self) -> Float[np.ndarray, " m"]:
        """Coefficients of the columns in the residual."""
        K, K_u = self.estimate.theta[:2]
        return np.array([1.0, K, -K_u, *-self.estimate.theta[2:]])

    @cached_property
    def intercept(self) -> Linear:
        """B = g + mean z'' + K mean z' - K_u mean U less the terms; its variance is robust [m/s^2]."""

        def mapped_mean(nuisance_values: separable.Values) -> float:
            return float(np.concatenate(WeightBalance(self.problem, nuisance_values).columns)[:, 2].mean())

        searched = [nuisance for nuisance in self.problem.nuisances if nuisance.searched]
        slopes = [nuisance.derivative(mapped_mean, self.estimate.nuisances) for nuisance in searched]
        _, by_friction, *by_others = self.weight.means.tolist()
        gain = float(self.estimate.theta[1])
        gradient = [by_friction, *(-mean for mean in by_others), *(-gain * slope for slope in slopes)]
        residual = np.concatenate(self.weight.columns) @ self.coefficients
        value = GRAVITY + float(self.weight.means @ self.coefficients)
        return value, np.array(gradient), _variance_of_mean(self.problem, residual)

    @property
    def hover(self) -> Linear:
        """U_h = (g - b) / K_u."""
        (b, gradient, variance), gain = self.intercept, float(self.estimate.theta[1])
        value, by_joint = (GRAVITY - b) / gain, -gradient / gain
        by_joint[1] -= value / gain
        return value, by_joint, variance / gain**2

    @property
    def hover_input(self) -> Linear:
        """Hover input: U_h through the inverse of the input map."""
        (mapped, gradient, variance), curve = self.hover, self.problem.input_map
        slope = curve.slope(curve.inverse(mapped))
        return curve.inverse(mapped), gradient / slope, variance / slope**2

    @property
    def exponents(self) -> tuple[float, float]:
        """Near hover, of the input map and of thrust; NaN where the numbers make none."""
        mapped, curve = self.hover[0], self.problem.input_map
        if not mapped > 0.0:
            return math.nan, math.nan
        hover = curve.inverse(mapped)
        of_map = hover * curve.slope(hover) / mapped
        return of_map, of_map * float(self.estimate.theta[1]) * mapped / GRAVITY

    @property
    def drift(self) -> ThrustDrift | None:
        """Slope of the residual in time, with an intercept for each run; None of short runs."""
        if self.by_weight:
            return self.weight.drift
        line, columns = np.concatenate(self.problem.lines), np.concatenate(self.weight.columns)
        squares = float(line @ line)
        if not squares:
            return None
        slopes = line @ columns / squares
        rate = float(slopes @ self.coefficients)
        residual = (columns - self.weight.means) @ self.coefficients - rate * line
        variance = long_run_mean_variance(line * residual) * (line.size / squares) ** 2
        gradient = np.zeros(self.estimate.values.size)
        gradient[: slopes.size - 1] = [slopes[1], *-slopes[2:]]
        half_width = self.estimate.joint_covariance.half_width(gradient, extra_variance=variance)
        return ThrustDrift(rate, half_width, _duration_s(self.problem), self.exponents[1])


def _duration_s(problem: VerticalFlights) -> float:
    """Length of the runs whose rows lose a line in time [s]."""
    return sum(map(float, map(np.ptp, problem.lines)))


def _variance_of_mean(problem: VerticalFlights, residual: Float[np.ndarray, " n"]) -> float:
    """Robust to autocorrelation, without the line in time that rows of long runs lose: that is no error."""
    lines = problem.lines
    parts = np.split(residual - residual.mean(), np.cumsum([line.size for line in lines])[:-1])
    pairs = zip(lines, parts, strict=True)
    return long_run_mean_variance(
        np.concatenate([part - line * (line @ part) / (line @ line or 1.0) for line, part in pairs])
    )


class ThrustDrift(msgspec.Struct, frozen=True):
    """Line in time of the thrust of one command, which rows of long runs lose, with a 95 % interval."""

    rate: float  # Change of the thrust over mass in a second [m/s^3]
    half_width: float  # [m/s^3]
    duration_s: float  # Of the runs that have it
    exponent: float  # Of thrust near hover

    @property
    def hover_rate(self) -> float:
        """Change of the hover input in a second, as a share of it."""
        return -self.rate / (GRAVITY * self.exponent)

    @property
    def hover_change(self) -> float:
        """Change of the hover input over the runs, as a share of it; zero within its error."""
        # the positive part of Stein's estimate (Efron and Morris 1973)
        noise = (self.half_width / normal_quantile(0.95) / self.rate) ** 2 if self.rate else 1.0
        return self.hover_rate * self.duration_s * max(1.0 - noise, 0.0)

    @property
    def numbers(self) -> dict[str, float]:
        """Change over the runs [m/s^2], and of the hover input [a minute] by the exponent of thrust."""
        return {
            DRIFT: self.rate * self.duration_s,
            f"{DRIFT}_half_width": self.half_width * self.duration_s,
            f"{DRIFT}_duration_s": self.duration_s,
            HOVER_DRIFT: 60.0 * self.hover_rate,
            f"{HOVER_DRIFT}_half_width": 60.0 * self.half_width / (GRAVITY * abs(self.exponent)),
        }

    @property
    def sentence(self) -> str:
        """The line that rows lose."""
        change, width, duration_s, of_hover, hover_half = self.numbers.values()
        direction, share = "rose" if change > 0.0 else "fell", abs(change) / GRAVITY
        return (
            f"thrust of one command {direction} by {abs(change):.2f} ± {width:.2f} m/s² ({share:.1%}) in "
            f"{duration_s:.0f} s; hover input {of_hover:+.1%} ± {hover_half:.1%} a minute"
        )


def _columns(
    problem: VerticalFlights, nuisance_values: separable.Values
) -> list[list[Float[np.ndarray, "_ m"]]]:
    """z'', z', U and the columns of terms, of every run of each flight."""
    return [
        item.cut(np.column_stack([item.responses[:, -1], -item.fixed, item.moving(nuisance_values)]))
        for item in problem.columns
    ]


def balance_sums(
    problem: VerticalFlights, nuisance_values: separable.Values
) -> dict[str, Float[np.ndarray, " flights"]]:
    """Number of samples of each flight, and sums of z'', z', U and the columns of terms over them."""
    flights = map(np.concatenate, _columns(problem, nuisance_values))
    sums = np.array([[len(terms), *terms.sum(axis=0)] for terms in flights])
    names = ("samples", "derivative", "velocity", "mapped", *(term.parameter.name for term in problem.terms))
    return dict(zip(names, sums.T, strict=True))


def apparent_gravity(problem: VerticalFlights) -> float:
    """Mean of the specific force less the velocity's derivative; NaN without an accelerometer [m/s^2]."""
    offsets = [
        run
        for item in problem.columns
        if item.responses.shape[1] > 1
        for run in item.cut(item.responses[:, 0] - item.responses[:, 1])
    ]
    return GRAVITY + float(np.concatenate(offsets).mean()) if offsets else float("nan")


def hover_of_sums(parameters: Mapping[str, float], sums: Mapping[str, float]) -> float:
    """U_h from linear parameters by name and the totals of `balance_sums`."""
    friction, gain = parameters[VISCOUS_FRICTION.name], parameters[INPUT_GAIN.name]
    of_terms = sum(parameters[name] * sums[name] for name in parameters if name in sums)
    drift = sums["derivative"] + friction * sums["velocity"] - of_terms
    return (sums["mapped"] - drift / gain) / sums["samples"]


VOLTAGE = "battery_voltage"
#: The log's lowest height is the ground if the flight stays so far above; else that is so far below it [m].
ABOVE_GROUND, BELOW_FLIGHT = 0.1, 0.5


def channel_on_grid(flight: PreparedFlight, name: str) -> Float[np.ndarray, " n"] | None:
    """A channel on the grid; None where it has not two numbers."""
    channel = flight.recording.channels.get(name)
    known = channel is not None and np.isfinite(channel.values).sum() >= 2
    return on_grid(flight.recording.channel(name), flight.grid)[0] if known else None


def height_over_ground(flight: PreparedFlight) -> tuple[Float[np.ndarray, " n"] | None, bool]:
    """Height over the ground [m], or over a place below the flight; whether the log shows the ground."""
    height = channel_on_grid(flight, "position_z")
    if height is None:
        return None, False
    lowest = float(np.nanquantile(flight.recording.channels["position_z"].values, 0.005))
    lowest_used = float(height[flight.used].min())
    landed = lowest_used - lowest > ABOVE_GROUND
    return height - (lowest if landed else lowest_used - BELOW_FLIGHT), landed


def voltage(flight: PreparedFlight) -> Float[np.ndarray, " n"] | None:
    """Voltage of the supply; None where it is not logged, or not above zero in the mean [V]."""
    volts = channel_on_grid(flight, VOLTAGE)
    return volts if volts is not None and float(volts[flight.used].mean()) > 0.0 else None


# -- Term channels --


def check_terms(options: FlightOptions, radius: float | None = None) -> None:
    """Refuse a term near the ground without the rotors' radius."""
    if GROUND_EFFECT.word in options.terms and options.rotor_radius is None and radius is None:
        expected = f"the radius of a rotor with the term {GROUND_EFFECT.word}, which counts heights in radii"
        remedy = (
            "Give it in metres, half a propeller's diameter: --rotor-radius 0.12, or a vehicle file with it."
        )
        raise UsageError(expected, "none", remedy)


def check_flights(flights: Sequence[PreparedFlight], options: FlightOptions) -> None:
    """Refuse a term that a flight does not log enough for."""
    for flight in [flight for flight in flights if flight.runs]:
        name = flight.recording.name
        if GROUND_EFFECT.word in options.terms:
            height, landed = height_over_ground(flight)
            if height is None:
                raise _missing("position_z", GROUND_EFFECT, name, "height")
            if not landed:
                needs = f"whose height the term {GROUND_EFFECT.word} needs"
                received = f"{name}, whose height is never below that of the flight"
                remedy = "Log from before take-off or until after landing, or leave the term out."
                raise InputError(f"a log that begins or ends on the ground, {needs}", received, remedy)
        if VOLTAGE_TERM.word in options.terms:
            if voltage(flight) is None:
                raise _missing(VOLTAGE, VOLTAGE_TERM, name, "battery's voltage")
            if flight.input.measured:
                expected = f"commands for the term {VOLTAGE_TERM.word}: what they give follows the voltage"
                received = f"{flight.input.name} of {name}, which was measured"
                raise InputError(expected, received, "Leave the term out, or name the commands with --input.")


def _missing(channel: str, term: OptionalTerm, name: str, words: str) -> MissingChannelError:
    needed = f"the channel {channel} for the term {term.word}"
    return MissingChannelError(needed, f"{name}, which has none", f"Log the {words}, or leave the term out.")


def mean_voltage(flights: Sequence[PreparedFlight]) -> float | None:
    """Mean over flights of the mean voltage while each was used; None where one does not log it [V]."""
    known = [(flight, voltage(flight)) for flight in flights if flight.runs]
    means = [float(volts[flight.used].mean()) for flight, volts in known if volts is not None]
    return float(np.mean(means)) if means and len(means) == len(known) else None
