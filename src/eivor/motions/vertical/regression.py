"""Regression problem of the vertical motion: terms, row noise and force balance."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial, reduce

import numpy as np

from eivor.errors import InputError, MissingChannelError, UsageError
from eivor.estimation.estimate import Estimate
from eivor.flights.grid import on_grid
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import CommandLimit, PreparedFlight
from eivor.inference.covariance import COSINE_AVERAGES, long_run_mean_variance
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.inference.distributions import normal_quantile, t_quantile
from eivor.linalg.system import COPIED_ROWS, merged_roots, row_blocks
from eivor.models import lagged_runs, separable
from eivor.models.regression import Parameter
from eivor.models.spectral import LINE_S
from eivor.motions.vertical.model import INPUT_GAIN, VISCOUS_FRICTION, VerticalMotion
from eivor.motions.vertical.select import FittedCurve
from eivor.signals.channels import family_members
from eivor.signals.filters import actuator_state, shifted_by
from eivor.signals.noise import WhiteNoise
from eivor.signals.recording import GRAVITY
from eivor.signals.signals import Signals
from eivor.signals.thrust_map import InputMap, Power
from eivor.tools import Float

#: Share of the largest state over which the slope of an input map is taken.
SLOPE_STEP = 1e-5
#: Samples that an actuator's response is followed over: 25 of the longest lags on a grid of 5 ms.
RESPONSE_SAMPLES = 1_500
#: Samples before the impulse, so that a state may be early.
BEFORE = 50


def row_noise(
    flights: Sequence[VerticalFlight],
    level: InputMap,
    terms: int,
    instruments: int,
    rule: separable.InstrumentRule,
    nuisance_values: separable.Values,
) -> lagged_runs.RowNoise:
    """Variances of the errors in z', U, so many terms and z'', and what past inputs share with U."""
    selected, shared = [], []
    for flight in flights:
        noise = {name: item.std**2 for name, item in flight.signals.noise.items()}
        if "velocity_z" in noise and flight.acceleration is None:
            noise["specific_force_z"] = noise["velocity_z"] / (2.0 * flight.signals.step_s**2)
        variance = input_variance(flight, level)
        response = _response(flight, nuisance_values) if variance else np.zeros(1)
        velocity, force = (noise.get(name, np.nan) for name in ("velocity_z", "specific_force_z"))
        selected.append([velocity, variance * float(response @ response), *[0.0] * terms, force])
        # covariance of the instruments' noises with those of [Phi y]
        covariance = np.zeros((instruments, terms + 3))
        if isinstance(rule, separable.LaggedInputs) and variance and response.any():
            covariance[: rule.last - rule.first + 1, 1] = variance * response[rule.first : rule.last + 1]
        shared.append(covariance)
    weights = [float(flight.sample_count) for flight in flights]
    mean = np.average(selected, axis=0, weights=weights)
    regressors = None if np.isnan(mean).any() else np.diag(mean)
    return regressors, np.average(shared, axis=0, weights=weights)


def input_variance(flight: VerticalFlight, level: InputMap) -> float:
    """Variance of the mapped input's error, the actuators' response left aside."""
    names, noise = family_members(flight.input, flight.signals.channels), flight.signals.noise
    variances = np.array([noise[name].std ** 2 if name in noise else 0.0 for name in names])
    if not variances.any():
        return 0.0
    state = flight.signals.family(flight.input)
    step = SLOPE_STEP * max(float(np.abs(state).max()), SLOPE_STEP)
    slopes = (level(state + step) - level(state - step)) / (2.0 * step)
    tilt = flight.signals.channel("cos_tilt")[:, None]
    return float(np.concatenate(flight.cut((tilt * slopes / len(names)) ** 2)).mean(axis=0) @ variances)


def _response(flight: VerticalFlight, nuisance_values: separable.Values) -> Float[np.ndarray, " lags"]:
    """Samples after an impulse of the input, of the state that enters the equation."""
    impulse = np.zeros((BEFORE + RESPONSE_SAMPLES, 1))
    impulse[BEFORE] = 1.0
    return np.asarray(flight.state_of(impulse, **lagged_runs.actuators(nuisance_values))[BEFORE:, 0])


# -- Terms --

#: Names of what the model leaves out, in tests that it is missed.
DRAG, GROUND, SUPPLY = "quadratic_drag", "ground_effect", "supply"
#: Heights below this count as this, in rotor radii.
LEAST_RADII = 0.5
#: Power of the polynomial of time that is an instrument for the voltage.
TREND = 3

TermColumn = Float[np.ndarray, " n"]
#: What optional terms of a flight are made of, as far as it is known: "velocity" z' [m/s], "lift" [m/s^2],
#: "radii", the height over the ground in those of a rotor, "voltage", "time" from the flight's middle [s].
Ingredients = Mapping[str, TermColumn]


@dataclass(frozen=True, slots=True)
class OptionalTerm:
    """A term that a user may add to the equation."""

    word: str  # As it is requested
    meaning: str
    parameter: Parameter  # Its coefficient
    written: str  # As it stands in the equation, with its sign
    symbols: str  # What its symbols are; empty where the equation has none
    column: Callable[[Ingredients], TermColumn]  # Of the parameter


QUADRATIC_DRAG = OptionalTerm(
    "quadratic-drag",
    "drag that grows with the square of the speed",
    Parameter("quadratic_drag", "1/m"),
    "- K_2 z'|z'|",
    "",
    lambda of: -of["velocity"] * np.abs(of["velocity"]),
)
GROUND_EFFECT = OptionalTerm(
    "ground-effect",
    "thrust that grows as one over the squared height over the ground",
    Parameter("ground_effect", ""),
    "+ k g (U/mean U) (R/h)²",
    "h the height over the ground, R a rotor's radius",
    # lift over the squared height in radii
    lambda of: of["lift"] * np.maximum(of["radii"], LEAST_RADII) ** -2.0,
)
VOLTAGE_TERM = OptionalTerm(
    "voltage",
    "thrust that follows the battery's voltage",
    Parameter("voltage_exponent", ""),
    "+ n g (U/mean U) (V/V_0 - 1)",
    "V the battery's voltage, V_0 its mean",
    lambda of: of["lift"] * of["voltage"],
)
#: By the words of the command line.
TERMS = {term.word: term for term in (QUADRATIC_DRAG, GROUND_EFFECT, VOLTAGE_TERM)}


def explained_ingredients(
    of: Ingredients, references: Float[np.ndarray, "n p"], runs: Sequence[slice]
) -> Ingredients:
    """The same as far as references explain them; voltage and time as they are."""
    names = [name for name in ("velocity", "lift", "radii") if name in of]
    made = explained(references, runs, np.column_stack([of[name] for name in names])).T
    return {**of, **dict(zip(names, made, strict=True))}


def explained(
    by: Float[np.ndarray, "n p"], runs: Sequence[slice], columns: Float[np.ndarray, "n k"]
) -> Float[np.ndarray, "n k"]:
    """Columns as far as others explain them by least squares over the runs, a constant among them."""
    parts = (slice(*ends) for run in runs for ends in row_blocks(run.start, run.stop, COPIED_ROWS))
    rows = (np.column_stack([by[k], np.ones(k.stop - k.start), columns[k]]) for k in parts)
    root, least = reduce(merged_roots, rows), len(by) * np.finfo(np.float64).eps
    weights = np.linalg.lstsq(root[:, : by.shape[1] + 1], root[:, by.shape[1] + 1 :], rcond=least)[0]
    return np.asarray(by @ weights[:-1] + weights[-1])


# -- Flights --


@dataclass(frozen=True)
class VerticalFlight:
    """One flight on its grid, and the runs of it that count."""

    signals: Signals
    input: str  # Family of channels that drive the vehicle ("rotor_command")
    measured: bool
    runs: tuple[slice, ...]  # Stretches to use
    band_hz: tuple[float, float] = lagged_runs.BAND_HZ  # Band of spectral rows [Hz]
    surroundings: Ingredients = field(default_factory=dict)  # Radii and voltage
    densities: Mapping[str, float] = field(default_factory=dict)
    prepared: PreparedFlight | None = None  # What it was made of
    command_limit: CommandLimit | None = None  # What its commands were limited to

    @cached_property
    def velocity(self) -> Float[np.ndarray, " n"]:
        """Z' [m/s]."""
        return self.signals.channel("velocity_z")

    @cached_property
    def velocity_derivative(self) -> Float[np.ndarray, " n"]:
        """Central difference of z' [m/s^2]."""
        return np.asarray(np.gradient(self.velocity, self.signals.step_s))

    @cached_property
    def acceleration(self) -> Float[np.ndarray, " n"] | None:
        """Z'' from the accelerometer [m/s^2]; None when it was not logged."""
        if "specific_force_z" not in self.signals.channels:
            return None
        return self.signals.channel("specific_force_z") - GRAVITY

    def state_of(self, logged: Float[np.ndarray, "n m"], **path: float) -> np.ndarray:
        """State of actuators by what is logged of them, at a lag, a delay and a second stage."""
        if self.measured:
            return shifted_by(logged, step_s=self.signals.step_s, delay_s=path["delay_s"])
        return actuator_state(logged, step_s=self.signals.step_s, **path)

    def mapped_input(
        self, motion: VerticalMotion, lag_s: float = 0.0, delay_s: float = 0.0, second_stage: float = 0.0
    ) -> Float[np.ndarray, " n"]:
        """Cosine of tilt times the mean of the mapped actuator states, over the whole grid."""
        path = {"lag_s": lag_s, "delay_s": delay_s, "second_stage": second_stage}
        states = motion.input_map(self.state_of(self._logged, **path))
        mapped: Float[np.ndarray, " n"] = states[:, 0] if states.shape[1] == 1 else states.mean(axis=1)
        return mapped * self.signals.channel("cos_tilt")

    def mean_command(self, motion: VerticalMotion) -> float:
        """Mean of the rotors' commands over the command of their mean thrust, each a mean over time."""
        each = np.concatenate(self.cut(self._logged)).mean(axis=0)
        collective = motion.input_map.inverse(float(motion.input_map(each[None]).mean()))
        return float(each.mean() / collective) if collective > 0.0 else 1.0

    @cached_property
    def _logged(self) -> Float[np.ndarray, "n m"]:
        return self.signals.family(self.input)

    @property
    def sample_count(self) -> int:
        return sum(item.shape[0] for item in self.cut(self.velocity[:, None]))

    def cut(self, columns: Float[np.ndarray, "n columns"]) -> list[Float[np.ndarray, "_ columns"]]:
        """Rows of each run that count."""
        valid = self.signals.valid
        return [columns[run] if valid is None else columns[run][valid[run]] for run in self.runs]

    @cached_property
    def lines(self) -> list[Float[np.ndarray, " _"]]:
        """Seconds from the middle of each run whose rows lose a line in time; zeros in shorter runs."""
        time = np.arange(self.velocity.size) * self.signals.step_s
        centred = [item[:, 0] - item[:, 0].mean() for item in self.cut(time[:, None])]
        lengths = [(run.stop - run.start) * self.signals.step_s for run in self.runs]
        return [item * (length >= LINE_S) for item, length in zip(centred, lengths, strict=True)]


@dataclass(frozen=True)
class MovingColumns:
    """The mapped input, which moves with lag and delay, and the optional terms."""

    flight: VerticalFlight
    motion: VerticalMotion  # With the input map
    terms: tuple[OptionalTerm, ...] = ()

    def __call__(self, nuisance_values: separable.Values) -> Float[np.ndarray, "n m"]:
        mapped = self.flight.mapped_input(self.motion, **lagged_runs.actuators(nuisance_values))
        if not self.terms:
            return mapped[:, None]
        of = self._ingredients(mapped)
        return np.column_stack([mapped, *(term.column(of) for term in self.terms)])

    def instruments(self, references: Float[np.ndarray, "n p"]) -> Float[np.ndarray, "n q"]:
        """References, and where there are any an instrument for each term."""
        if not (self.terms and references.shape[1]):
            return references
        # an instrument for each term; performs no checks
        of = self._ingredients(self._unlagged)
        made = explained_ingredients(of, references, self.flight.runs)
        if "voltage" in of:
            time = np.linspace(-1.0, 1.0, of["voltage"].size)
            trend = np.column_stack([time**power for power in range(1, TREND + 1)])
            # the charge alone: loads, which references explain, pull the voltage down within a second
            charge = explained(trend, self.flight.runs, of["voltage"][:, None])[:, 0]
            made = {**made, "voltage": charge}
        return np.column_stack([references, np.column_stack([term.column(made) for term in self.terms])])

    def _ingredients(self, mapped: Float[np.ndarray, " n"]) -> Ingredients:
        lift = GRAVITY / self._mean * mapped
        return {"velocity": self.flight.velocity, "lift": lift, **self.flight.surroundings}

    @cached_property
    def _unlagged(self) -> Float[np.ndarray, " n"]:
        return self.flight.mapped_input(self.motion)

    @cached_property
    def _mean(self) -> float:
        """Mean of the mapped input over the runs, of either sign; one where it is zero."""
        return float(np.concatenate(self.flight.cut(self._unlagged[:, None])).mean()) or 1.0


@dataclass(frozen=True)
class VerticalFlights(lagged_runs.LaggedRuns):
    """Regressions of vertical motion for each actuator lag and delay, made by `vertical_problem`."""

    flights: tuple[VerticalFlight, ...] = ()
    motion: VerticalMotion = field(default_factory=VerticalMotion)
    rule: separable.InstrumentRule = field(default_factory=separable.NoInstruments)
    terms: tuple[OptionalTerm, ...] = ()
    curve: FittedCurve | None = None
    unlimited: bool = False  # Whether no limit of commands was found with this map

    @property
    def few_rows(self) -> bool:
        """Whether there are terms: voltage and height change slowly."""
        return bool(self.terms)

    def sampled_state(self, _at: separable.Values) -> separable.SampledState | None:
        """The vertical velocity, where every flight has an accelerometer."""
        if any(flight.acceleration is None for flight in self.flights):
            return None
        lengths = [flight.sample_count for flight in self.flights]
        powers = []  # per Hz, of the errors in z', U and z'' at low frequencies
        for flight in self.flights:
            noise = {name: WhiteNoise(density) for name, density in flight.densities.items()}
            noisy = replace(flight, signals=replace(flight.signals, noise=noise))
            of = [flight.densities.get(name, np.nan) ** 2 for name in ("velocity_z", "specific_force_z")]
            powers.append([of[0], input_variance(noisy, self.motion.input_map), of[1]])
        velocity, driving, response = np.sqrt(np.average(powers, axis=0, weights=lengths)).tolist()
        driven = np.zeros(len(self.parameters))
        driven[1] = driving
        return separable.SampledState(0, velocity, response, driven)


def vertical_problem(
    flights: tuple[VerticalFlight, ...],
    motion: VerticalMotion,
    rule: separable.InstrumentRule | None = None,
    nuisances: tuple[separable.Nuisance, ...] = (),
    terms: tuple[OptionalTerm, ...] = (),
) -> VerticalFlights:
    """Regressions of z'' = -K z' + K_u U + terms, for the usual lags and delays where none are given."""
    rule = separable.NoInstruments() if rule is None else rule
    if not nuisances:
        step_s = max((flight.signals.step_s for flight in flights), default=0.0)
        measured = all(flight.measured for flight in flights)
        nuisances = lagged_runs.measured_state() if measured else lagged_runs.lag_and_delay(step_s=step_s)
    columns = []
    for number, flight in enumerate(flights):
        moving = MovingColumns(flight, motion, terms)
        accelerations = (flight.acceleration, flight.velocity_derivative)
        columns.append(
            lagged_runs.AxisColumns(
                flight.signals.step_s,
                flight.runs,
                np.column_stack([item for item in accelerations if item is not None]),
                -flight.velocity[:, None],
                moving,
                moving.instruments(rule.columns(flight.signals, flight.mapped_input(motion))),
                number,
                band_hz=flight.band_hz,
                valid=flight.signals.valid,
                linear=motion.input_map == Power() and not (terms or flight.measured),
            )
        )
    width = columns[0].instruments.shape[1] if columns else 0
    return VerticalFlights(
        tuple(columns),
        (*motion.parameters, *(term.parameter for term in terms)),
        nuisances,
        partial(row_noise, flights, motion.input_map, len(terms), width, rule),
        flights=flights,
        motion=motion,
        rule=rule,
        terms=terms,
    )


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
    def left(self) -> Float[np.ndarray, " n"]:
        """U over its mean, less 1 + (z'' + K z') / g: about ln U less that of hover."""
        derivative, velocity, mapped = np.concatenate(self.columns)[:, :3].T
        return np.asarray(
            mapped / (self.means[2] or 1.0) - 1.0 - (derivative + MIDDLE_FRICTION * velocity) / GRAVITY
        )

    @property
    def hover(self) -> tuple[float, float, float]:
        """U_h, to second order the mean of U / (1 + (z'' + K z') / g); standard error, 95 % half-width."""
        value, lines = float(self.means[2]) * (1.0 + float(self.left.mean())), _lines(self.problem)
        averages = COSINE_AVERAGES - bool(np.concatenate(lines).any())  # the first is that of a line
        variance = _variance_of_mean(self.problem, self.left) * COSINE_AVERAGES / averages
        std_error = abs(value) * math.sqrt(variance)
        bound = abs(value * MIDDLE_FRICTION * float(self.means[1]) / GRAVITY)
        return value, std_error, t_quantile(0.95, averages) * std_error + bound

    @property
    def drift(self) -> ThrustDrift | None:
        """Slope in time of what is left, as a change of thrust; None of short runs."""
        line, velocity = np.concatenate(_lines(self.problem)), np.concatenate(self.columns)[:, 1]
        squares, chosen = float(line @ line), self.problem.motion.input_map
        hover = chosen.inverse(max(self.hover[0], 0.0))
        if not (squares and hover > 0.0):
            return None
        slope, centred = float(line @ self.left) / squares, self.left - self.left.mean()
        error = math.sqrt(long_run_mean_variance(line * (centred - slope * line))) * line.size / squares
        bound = MIDDLE_FRICTION * abs(float(line @ velocity)) / squares
        half_width = GRAVITY * t_quantile(0.95, COSINE_AVERAGES) * error + bound
        exponent = hover * chosen.slope(hover) / chosen(np.array([hover]))[0]
        return ThrustDrift(-GRAVITY * slope, half_width, _duration_s(self.problem), exponent)


@dataclass(frozen=True)
class Balance:
    """Means over the runs of the terms of the equation of motion, at an estimate."""

    problem: VerticalFlights
    estimate: Estimate

    @cached_property
    def weight(self) -> WeightBalance:
        """The same without the gain."""
        return WeightBalance(self.problem, self.estimate.nuisances)

    @property
    def by_weight(self) -> bool:
        """Whether the gain is known too roughly to serve the hover input."""
        gain, direction = float(self.estimate.theta[1]), self.estimate.direction("input_gain")
        known = self.estimate.joint_covariance.half_width(direction) < ROUGH_GAIN * gain
        strong = bool(self.estimate.first_stage[1] >= STRONG_FIRST_STAGE)
        return not (self.problem.terms or (known and strong)) and self.weight.hover[0] > 0.0

    @property
    def coefficients(self) -> Float[np.ndarray, " m"]:
        """What the columns are multiplied by to add up to the residual."""
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
        """The same through the inverse of the input map."""
        (mapped, gradient, variance), chosen = self.hover, self.problem.motion.input_map
        slope = chosen.slope(chosen.inverse(mapped))
        return chosen.inverse(mapped), gradient / slope, variance / slope**2

    @property
    def exponents(self) -> tuple[float, float]:
        """Near hover, of the input map and of thrust; NaN where the numbers make none."""
        mapped, chosen = self.hover[0], self.problem.motion.input_map
        if not mapped > 0.0:
            return math.nan, math.nan
        hover = chosen.inverse(mapped)
        of_map = hover * chosen.slope(hover) / mapped
        return of_map, of_map * float(self.estimate.theta[1]) * mapped / GRAVITY

    @property
    def drift(self) -> ThrustDrift | None:
        """Slope of the residual in time, with an intercept for each run; None of short runs."""
        if self.by_weight:
            return self.weight.drift
        line, columns = np.concatenate(_lines(self.problem)), np.concatenate(self.weight.columns)
        squares = float(line @ line)
        if not squares:
            return None
        slopes = line @ columns / squares
        rate = float(slopes @ self.coefficients)
        left = (columns - self.weight.means) @ self.coefficients - rate * line
        variance = long_run_mean_variance(line * left) * (line.size / squares) ** 2
        gradient = np.zeros(self.estimate.values.size)
        gradient[: slopes.size - 1] = [slopes[1], *-slopes[2:]]
        half_width = self.estimate.joint_covariance.half_width(gradient, extra_variance=variance)
        return ThrustDrift(rate, half_width, _duration_s(self.problem), self.exponents[1])


def _lines(problem: VerticalFlights) -> list[Float[np.ndarray, " _"]]:
    """Seconds from the middle of each run whose rows lose a line in time; zeros in shorter ones."""
    return [item for flight in problem.flights for item in flight.lines]


def _duration_s(problem: VerticalFlights) -> float:
    """Length of the runs whose rows lose a line in time [s]."""
    return sum(map(float, map(np.ptp, _lines(problem))))


def _variance_of_mean(problem: VerticalFlights, residual: Float[np.ndarray, " n"]) -> float:
    """Robust to autocorrelation, without the line in time that rows of long runs lose: that is no error."""
    lines = _lines(problem)
    parts = np.split(residual - residual.mean(), np.cumsum([line.size for line in lines])[:-1])
    pairs = zip(lines, parts, strict=True)
    return long_run_mean_variance(
        np.concatenate([part - line * (line @ part) / (line @ line or 1.0) for line, part in pairs])
    )


@dataclass(frozen=True, slots=True)
class ThrustDrift:
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
        change, half, duration_s, of_hover, hover_half = self.numbers.values()
        moved, share = "rose" if change > 0.0 else "fell", abs(change) / GRAVITY
        return (
            f"thrust of one command {moved} by {abs(change):.2f} ± {half:.2f} m/s² ({share:.1%}) in "
            f"{duration_s:.0f} s; hover input {of_hover:+.1%} ± {hover_half:.1%} a minute"
        )


def _columns(
    problem: VerticalFlights, nuisance_values: separable.Values
) -> list[list[Float[np.ndarray, "_ m"]]]:
    """z'', z', U and the columns of terms, of every run of each flight."""
    blocks = []
    for flight in problem.flights:
        moving = MovingColumns(flight, problem.motion, problem.terms)(nuisance_values)
        blocks.append(flight.cut(np.column_stack([flight.velocity_derivative, flight.velocity, moving])))
    return blocks


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
    resting = [
        run
        for flight in problem.flights
        if flight.acceleration is not None
        for run in flight.cut((flight.acceleration - flight.velocity_derivative)[:, None])
    ]
    return GRAVITY + float(np.concatenate(resting).mean()) if resting else float("nan")


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
        give = (
            "Give it in metres, half a propeller's diameter: --rotor-radius 0.12, or a vehicle file with it."
        )
        raise UsageError(expected, "none", give)


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
                remedy = "Leave the term out, or name the commands with --input."
                raise InputError(expected, received, remedy)


def _missing(channel: str, term: OptionalTerm, name: str, words: str) -> MissingChannelError:
    needed = f"the channel {channel} for the term {term.word}"
    return MissingChannelError(needed, f"{name}, which has none", f"Log the {words}, or leave the term out.")


def mean_voltage(flights: Sequence[PreparedFlight]) -> float | None:
    """Mean over flights of the mean voltage while each was used; None where one does not log it [V]."""
    known = [(flight, voltage(flight)) for flight in flights if flight.runs]
    means = [float(volts[flight.used].mean()) for flight, volts in known if volts is not None]
    return float(np.mean(means)) if means and len(means) == len(known) else None


def with_surroundings(
    cut: VerticalFlight, flight: PreparedFlight, radius: float | None, reference_voltage: float | None
) -> VerticalFlight:
    """A flight with its height in rotor radii, and its voltage over the one given less one."""
    (height, _), volts = height_over_ground(flight), voltage(flight)
    known = {} if height is None or radius is None else {"radii": height / radius}
    if volts is not None and reference_voltage is not None:
        known["voltage"] = volts / reference_voltage - 1.0
    return replace(cut, surroundings=known)
