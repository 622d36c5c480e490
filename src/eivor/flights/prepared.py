"""A prepared flight: signals, runs, selection and agreement of channels."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from eivor import errors
from eivor.errors import EstimationError, InputError
from eivor.estimation.methods import identify, reference_iv
from eivor.flights import grid as grids
from eivor.flights.grid import Active, Grid, Interpolant, airborne_by_log, courses_on_grid, cubic, with_memory
from eivor.flights.options import FlightOptions
from eivor.flights.quantity import PlotData
from eivor.flights.references import NoiseLevel, Reference
from eivor.flights.timestamps import Clock
from eivor.inference.covariance import Classical, EqualWeightedCosines
from eivor.inference.diagnostics.instruments import OverIdentification
from eivor.inference.diagnostics.record import BEYOND_DOUBT, SIGNIFICANT
from eivor.inference.distributions import chi_square_tail, t_quantile, t_tail
from eivor.models.separable import GivenBins
from eivor.models.spectral import SpectralRun
from eivor.signals.channels import CurveSide, family_members
from eivor.signals.filters import CAUGHT_UP_S, actuator_state, rate_limited, shifted_by
from eivor.signals.recording import ROTARY_WING, VTOL, Channel, Finding, Recording
from eivor.signals.signals import Signals
from eivor.tools import Bool, Float, Int

# -- Agreement --

#: Cosine averages of the standard error, and the degrees of freedom of its t.
AVERAGES = 16
#: A difference is reported below this p-value: four kinds together have false alarms in 1 % of flights.
REPORTED = 0.004


@dataclass(frozen=True, slots=True)
class Difference:
    """Difference between two measurements, of one kind."""

    value: float
    std_error: float
    least: float = 0.0  # A smaller difference matters to nothing

    @property
    def p_value(self) -> float:
        """P-value of the test that there is none."""
        return t_tail(self.value / self.std_error, AVERAGES) if self.std_error > 0.0 else 1.0

    @property
    def matters(self) -> bool:
        """Whether it is there, and matters."""
        return self.p_value < REPORTED and abs(self.value) >= self.least

    @property
    def half_width(self) -> float:
        """Half the width of its 95 % interval."""
        return t_quantile(0.95, AVERAGES) * self.std_error


@dataclass(frozen=True, slots=True)
class SensorAgreement:
    """In which ways two measurements of one response differ."""

    differences: Mapping[str, Difference]
    agreement: OverIdentification  # Of the instruments, when all differences are taken out
    either: Mapping[str, Difference] = field(default_factory=dict)

    @property
    def significant(self) -> dict[str, Difference]:
        """Differences that are there, and matter."""
        return {name: difference for name, difference in self.differences.items() if difference.matters}

    @property
    def p_value(self) -> float:
        """P-value of the test that there is no other difference."""
        return self.agreement.p_value

    @property
    def otherwise(self) -> bool:
        """Whether they differ in another way beyond doubt."""
        return self.p_value < BEYOND_DOUBT

    @property
    def numbers(self) -> dict[str, float]:
        """Differences and p-values by name, for diagnostics."""
        results = {"sensors_p_value": self.p_value}
        for name, difference in self.differences.items():
            results |= {f"sensors_{name}": difference.value, f"sensors_{name}_p_value": difference.p_value}
        return results


def sensor_agreement(problem: GivenBins | None, smallest: Mapping[str, float]) -> SensorAgreement | None:
    """Estimate in which ways two measurements differ."""
    if problem is None:
        return None
    try:
        jointly, none_p_value = estimated(problem, smallest)
        if jointly.significant or none_p_value > BEYOND_DOUBT:
            return jointly
        # kinds that explain the difference by themselves: there beyond doubt, and nothing is left
        either: dict[str, Difference] = {}
        for index, parameter in enumerate(problem.given.parameters):
            column = problem.given.regressors[:, [index]]
            by_one = replace(problem.given, regressors=column, parameters=(parameter,))
            single, _ = estimated(GivenBins(by_one), smallest)
            difference = single.differences[parameter.name]
            if difference.matters and difference.p_value < BEYOND_DOUBT and single.p_value >= SIGNIFICANT:
                either[parameter.name] = difference
        return replace(jointly, either=either)
    except (EstimationError, errors.InstrumentError, errors.TooFewSamplesError):
        return None


def estimated(problem: GivenBins, least: Mapping[str, float]) -> tuple[SensorAgreement, float]:
    """Coefficients of given rows as disagreements, and the p-value of all being zero."""
    estimate = identify(problem, reference_iv())
    J, p_value = estimate.over_identification
    covariances = (estimate.with_covariance(kind) for kind in (Classical(), EqualWeightedCosines(AVERAGES)))
    parts = [part.matrix for result in covariances for part in result.joint_covariance.parts]
    std_errors = np.sqrt(np.max([np.diag(part) for part in parts], axis=0))
    if not bool((std_errors > 0.0).all()):
        received = "sensors that differ by nothing, or by exactly what is sought"
        raise EstimationError("sensors whose difference has an error", received, "Give what was measured.")
    values = estimate.values
    scaled, correlation = values / std_errors, parts[0] / np.outer(std_errors, std_errors)
    wald = float(scaled @ np.linalg.lstsq(correlation, scaled, rcond=None)[0])
    named = zip(estimate.names, values.tolist(), std_errors.tolist(), strict=True)
    differences = {name: Difference(value, error, least.get(name, 0.0)) for name, value, error in named}
    agreement = OverIdentification(J, estimate.degrees, 1.0 if math.isnan(p_value) else p_value)
    return SensorAgreement(differences, agreement), chi_square_tail(wald, values.size)


# -- Selection --


#: Hovering inputs of one vehicle, laden or not, and those of its rotors are within this ratio of each other.
LARGEST_INPUT_RATIO = 10.0


@dataclass(frozen=True, slots=True)
class InputFamily:
    """Channels that may drive a vehicle, one for each actuator or one for all."""

    name: str  # The channel, or what stands before the actuators' numbers ("rotor_command")
    #: True for the actuators' measured state, which does not lag, and may be late or early
    measured: bool = False
    input_map: str = "linear"  # Name of the map from its values to what enters the equation
    numbered: bool = False  # One channel for each actuator, recognised by numbers from 1 on
    least_rate_hz: float = 0.0  # Slower channels are passed over where there is another family [Hz]

    def state(self, logged: Float[np.ndarray, "n m"], step_s: float, **path: float) -> np.ndarray:
        """State of actuators by their logged input, at a lag, a delay and a second stage."""
        if self.measured:
            return shifted_by(logged, step_s=step_s, delay_s=path["delay_s"])
        return actuator_state(logged, step_s=step_s, **path)


@dataclass(frozen=True)
class Selection:
    """Channels of one log by their role."""

    #: What drives the vehicle. After a gap in it the actuator's state is not known for a while.
    input: InputFamily
    commands: tuple[Channel, ...]  # Its channels
    states: Mapping[str, Channel]  # By role, what the equation needs beside the input ("velocity")
    #: By role, what the equation explains; None for what the log lacks and the motion can do without
    responses: Mapping[str, Channel | None]
    conditions: tuple[Channel, ...] = ()  # Others that enter
    #: Values in place of conditions that the log lacks
    constants: Mapping[str, float] = field(default_factory=dict)
    #: Which samples count: the lowest value of some channels
    at_least: Mapping[str, float] = field(default_factory=dict)
    band_hz: tuple[float, float] = (0.04, 5.0)  # Band of spectral rows [Hz]
    findings: tuple[Finding, ...] = ()  # What a reader of the result should know of the choice
    log: Recording | None = None  # What the channels are of, where the motion corrected the log
    #: The longest that the next command can be waited for [s], where the command's stamps do not show
    issued_within_s: float = math.inf
    #: The autopilot's parameter of the rate [Hz] at which commands are issued, by about a fifth
    rate_parameter: str = ""
    step_s: float | None = None  # Step of the grid [s]. Default: by the rates of commands and responses.
    #: What was measured is a line between its stamps, spread over time as thinned commands are, and the band
    #: is kept whole; else it is a curve
    matched_interpolation_filter: bool = False
    #: Samples during which the motion holds, by the input's level; for what flies: while it is in the air
    active: Callable[[Recording, Grid, Float[np.ndarray, " n"]], Active] = airborne_by_log

    def between(self, channel: Channel) -> Interpolant:
        """Interpolation of a channel between its stamps."""
        measured = any(channel is item for item in (*self.states.values(), *self.responses.values()))
        return cubic if measured and not self.matched_interpolation_filter else grids.linear

    @property
    def logged_responses(self) -> tuple[Channel, ...]:
        """Responses that are in the log."""
        return tuple(channel for channel in self.responses.values() if channel is not None)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Every channel that is put on the grid."""
        return (*self.states.values(), *self.commands, *self.logged_responses, *self.conditions)

    @property
    def measured(self) -> tuple[str, ...]:
        """Roles whose channel is declared to come from a sensor."""
        roles = {**self.states, **self.responses}
        return tuple(role for role, item in roles.items() if item is not None and item.estimated is False)

    @property
    def rates_hz(self) -> dict[str, float]:
        """Mean logging rate of the slowest command, and by role of what was measured; 0 when absent [Hz]."""
        slowest = min(channel.rate_hz for channel in self.commands)
        roles = {**self.states, **self.responses}
        return {"command": slowest} | {name: item.rate_hz if item else 0.0 for name, item in roles.items()}


#: Shipped machines of vehicles that are no multirotors.
MACHINES = {"fixed wing": "fixed-wing-roll", "rover": "rover", "boat": "boat-yaw"}


def check_vehicle(log: Recording, options: FlightOptions, *also: str) -> None:
    """Refuse a log of a vehicle that does not fly on rotors, or not all the time, but for other kinds."""
    says = f"{log.name}, which says that it is of a {log.vehicle}"
    if log.vehicle == VTOL and options.window is None:
        where = "".join(f" {item.message}" for item in log.findings if item.name == "on_rotors")
        remedy = f"Give a stretch in which it hovers: --window START:END.{where}"
        raise InputError("a window in which the vehicle hovers on its rotors", says, remedy)
    if log.vehicle not in ("", ROTARY_WING, VTOL, *also):
        like = f" --like {MACHINES[log.vehicle]}" if log.vehicle in MACHINES else ""
        remedy = f"Declare another with this log's channels: eivor machine new FILE.toml{like}"
        how = f"This motion is that of multirotors. {remedy} (docs/motions.md says how)."
        raise InputError("a log of a multirotor", says, how)


def chosen_input(
    log: Recording, families: tuple[InputFamily, ...], requested: str, *, remedy: str
) -> tuple[InputFamily, tuple[Channel, ...]]:
    """Family and channels of the input: the requested one, or the first that the log has."""
    if requested:
        name = requested.rstrip("*").rstrip("_")
        channels = log.family(name)
        if not channels:
            expected = f"an input out of the channels of {log.name}"
            known = [*log.channels, *(family.name for family in families if log.family(family.name))]
            remedy = f"Name one that eivor inspect lists, or a family such as {families[0].name}."
            raise errors.UsageError(expected, f"'{requested}'", errors.did_you_mean(name, known, remedy))
        stem, _, number = name.rpartition("_")
        family_names = {name, stem} if number.isdecimal() else {name}
        known_family = next((family for family in families if family.name in family_names), InputFamily(name))
        return replace(known_family, name=name), tuple(channels)
    logged = [(family, tuple(channels)) for family in families if (channels := log.family(family.name))]
    for family, members in logged:
        if min(channel.rate_hz for channel in members) >= family.least_rate_hz:
            return family, _complete(log, family, members)
    if logged:
        return logged[0][0], _complete(log, *logged[0])
    sources = sorted({source for family in families for source in log.looked_for.get(family.name, ())})
    looked_for = f" (looked for: {', '.join(sources)})" if sources else ""
    names = [f"{family.name}_1.." if family.numbered else family.name for family in families]
    raise errors.MissingChannelError(
        f"an input in {log.name}: {', or '.join([', '.join(names[:-1]), names[-1]] if names[1:] else names)}",
        f"a log without one{looked_for}",
        f"{remedy}, or name a channel with --input.",
    )


def _complete(log: Recording, family: InputFamily, members: tuple[Channel, ...]) -> tuple[Channel, ...]:
    """Members of a family; missing rotors and commands on different scales are refused."""
    if not (family.numbered and family.input_map == "square"):
        return members
    numbers = {int(item.name.rpartition("_")[2]) for item in members}
    remedy = "Correct the units in its channel map (--map), or name one input: --input NAME."
    if missing := [f"{family.name}_{number}" for number in range(1, max(numbers)) if number not in numbers]:
        expected = f"values of each {family.name}, 1 to {max(numbers)}, in {log.name}"
        raise InputError(expected, f"none of {', '.join(missing)}", f"Log it. {remedy}")
    magnitudes = ((np.abs(item.values[np.isfinite(item.values)]), item.name) for item in members)
    sizes = sorted((float(np.quantile(values, 0.95)), name) for values, name in magnitudes if values.any())
    if not sizes:
        return members
    (low, first), (high, last) = sizes[0], sizes[-1]
    if high > LARGEST_INPUT_RATIO * low > 0.0:
        expected = f"each {family.name} of {log.name} on one scale"
        raise InputError(expected, f"{last} of {high:.4g} and {first} of {low:.4g}", remedy)
    return members


def matched_interpolation_filter(
    channels: dict[str, Float[np.ndarray, " n"]], selected: Selection, clocks: dict[str, Clock], grid: Grid
) -> dict[str, Float[np.ndarray, " n"]]:
    """Channels on a grid, each smoothed by the interpolation kernel of the others."""
    measured = (*selected.states.values(), *selected.logged_responses)
    thinned = [clock for clock in clocks.values() if clock.thinned]
    commanded_s = max((clock.logged_s for clock in thinned), default=0.0)
    # a step of the grid holds the mean of the line over it, longer than a command was held
    share = max(1.0 - (max((clock.issued_s for clock in thinned), default=np.inf) / grid.step_s) ** 2, 0.0)
    measured_s = max(1.0 / item.rate_hz for item in measured)
    filtered = dict(channels)
    for entry in measured:
        # a faster channel is smoothed like the slowest
        wait_s = measured_s if 1.0 / entry.rate_hz < measured_s else 0.0
        interpolated = triangle_mean(filtered[entry.name], grid, commanded_s, share)
        filtered[entry.name] = triangle_mean(interpolated, grid, wait_s)
    for command in selected.commands:
        filtered[command.name] = triangle_mean(filtered[command.name], grid, measured_s)
    return filtered


def triangle_mean(
    values: Float[np.ndarray, " n"], grid: Grid, width_s: float, held: float = 0.0
) -> Float[np.ndarray, " n"]:
    """Mean around each sample by a triangular kernel, with a share held over a step."""
    half = max(int(np.ceil(width_s / grid.step_s)) - 1, 0)
    if not (half or held):
        return values
    weights = 1.0 - np.abs(np.arange(-half, half + 1)) * grid.step_s / width_s
    # the variance of line and hold, of which samples of a triangle lack a third of a step's square
    weights = np.convolve(weights / weights.sum(), np.array([held, 6.0 - 2.0 * held, held]) / 6.0)
    piece_ends, half = np.cumsum([len(piece) for piece in grid.pieces]), half + 1
    padded = [np.pad(part, half, mode="edge") for part in np.split(values, piece_ends[:-1])]
    return np.concatenate([np.convolve(part, weights, mode="valid") for part in padded])


# -- Prepared --

#: An input whose standard deviation is below this share of its mean is constant.
CONSTANT_INPUT_SHARE = 1e-6


#: Kinds of limits, as diagnostics name them.
RATE, LEVEL = "command_rate_limit", "command_level_limit"


class CommandLimit(NamedTuple):
    """Limit of the commands' rate or level."""

    kind: str
    value: float  # The largest rate [1/s], or the largest command


@dataclass(frozen=True)
class PreparedFlight:
    """A flight on its grid."""

    recording: Recording  # The log, z up
    signals: Signals  # Channels that the motion selected, and the references, on one grid
    input: InputFamily  # What drives the vehicle
    input_map: str  # Name of the input map
    #: Stretches to use; without any nothing can be estimated. Of their samples those count that are usable.
    runs: tuple[slice, ...]
    band_hz: tuple[float, float]  # Band of spectral rows [Hz]
    references: tuple[Reference, ...]  # Candidate instruments
    active: Active  # Where the vehicle does what the motion describes: where it flies
    #: Samples that are active, in the window, within the motion's limits, and standing on data
    usable: Bool[np.ndarray, " n"]
    #: Mean logging rates by role: "command" and those of the selection (0 when absent)
    rates_hz: Mapping[str, float]
    findings: tuple[Finding, ...]  # Named diagnostics
    grid: Grid  # Times of the samples
    measured: tuple[str, ...] = ()  # Roles of the selection whose channel is declared to come from a sensor
    #: Largest constant error of the command's time, see `Clock` [s]
    command_slack_s: float = 0.0
    #: Time between two commands where the log holds but some of them; zero where it holds every one [s]
    unlogged_step_s: float = 0.0
    #: How far a command may lie from the middle of what a loop in step with the log holds, see `Clock` [s]
    locked_s: float = 0.0
    noise: Mapping[str, NoiseLevel] = field(default_factory=dict)  # Measurement noise by channel
    states: tuple[str, ...] = ()  # Channels of the selection's states, which are regressors
    #: Where the channels of the input stand to the autopilot's thrust curve; unknown where they differ
    curve_side: CurveSide = CurveSide.UNKNOWN
    corrected: tuple[str, ...] = ()  # Differences between measurements that were taken out
    issued: tuple[Channel, ...] = ()  # Commands as they were issued; none where the grid smooths slow ones
    shortfall: tuple[str, str] = ("", "")  # Without runs: the condition that fails most, and its remedy

    @cached_property
    def shortened(self) -> PreparedFlight:
        """The flight with only the samples that its runs need."""
        mask = with_memory(mask_of(self.runs, self.usable.size), self.grid)
        if mask.all() or not self.runs:
            return self
        position = np.cumsum(mask) - 1
        signals = replace(
            self.signals,
            channels={name: values[mask] for name, values in self.signals.channels.items()},
            valid=self.usable[mask],
        )
        references = [replace(item, values=item.values[mask], logged=None) for item in self.references]
        return replace(
            self,
            signals=signals,
            runs=tuple(slice(int(position[run.start]), int(position[run.stop - 1]) + 1) for run in self.runs),
            references=tuple(references),
            active=replace(self.active, mask=self.active.mask[mask]),
            usable=self.usable[mask],
            grid=self.grid.select(mask),
        )

    def acting(self, limits: Sequence[CommandLimit]) -> Float[np.ndarray, "n m k"]:
        """Commands on the grid under each of the limits: of rate first, then of level."""
        rates, levels = (np.array([x.value for x in limits if x.kind == kind]) for kind in (RATE, LEVEL))

        def on_grid(command: Channel) -> Float[np.ndarray, "n k"]:
            ends = self.grid.time_s[[0, -1]] + [-2.0 * CAUGHT_UP_S, CAUGHT_UP_S]
            window = slice(*np.searchsorted(command.time_s, ends).tolist())
            part = replace(command, time_s=command.time_s[window], values=command.values[window])
            made = (*rate_limited(part.values, part.time_s, rates), *np.minimum(part.values, levels[:, None]))
            return courses_on_grid(part, np.stack(made), self.grid).T

        return np.stack([on_grid(command) for command in self.issued], axis=1)

    def within(self, limit: CommandLimit) -> PreparedFlight:
        """The flight with commands under a limit."""
        acting = self.acting([limit])[:, :, 0].T
        channels = dict(zip((command.name for command in self.issued), acting, strict=True))
        signals = replace(self.signals, channels={**self.signals.channels, **channels})
        return replace(self, signals=signals)

    @property
    def usable_references(self) -> tuple[str, ...]:
        """Names of the references that may serve as instruments."""
        return tuple(reference.name for reference in self.references if reference.usable)

    def reference_on_grid(self, name: str) -> Float[np.ndarray, " n"] | None:
        """Logged values of a reference on the grid; None for one that is not logged."""
        known = (item for item in self.references if item.name == name)
        return next((item.values if item.logged is None else item.logged for item in known), None)

    def where_logged(self, values: Float[np.ndarray, " n"], *names: str) -> Float[np.ndarray, " n"]:
        """Values for a picture: NaN where one of the channels that they are made of was not logged."""
        for name in names:
            if name in self.recording.channels:
                values = np.where(grids.unlogged(self.recording.channels[name], self.grid), np.nan, values)
        return values

    def plot_data(self, label: str, *, of: str, reference: str = "", scale: float = 1.0) -> PlotData:
        """A channel of the signals to look at, and its reference where the log has one."""
        series = self.reference_on_grid(reference) if reference else None
        reference_values = None if series is None else scale * self.where_logged(series, reference)
        return PlotData(label, scale * self.where_logged(self.signals.channel(of), of), reference_values)

    @property
    def logged_input(self) -> Float[np.ndarray, " n"]:
        """Mean of the input's channels, for a picture."""
        names = (channel.name for channel in self.recording.family(self.input.name))
        return self.where_logged(self.signals.family(self.input.name).mean(axis=1), *names)

    @property
    def used(self) -> Bool[np.ndarray, " n"]:
        """Samples of the runs that count."""
        return mask_of(self.runs, self.usable.size) & self.usable

    @property
    def samples_of_runs(self) -> tuple[Int[np.ndarray, " _"], ...]:
        """Numbers of the samples of each run that count."""
        return tuple(run.start + np.flatnonzero(self.usable[run]) for run in self.runs)

    def spectral_runs(self, number: int = 0) -> tuple[SpectralRun, ...]:
        """The runs as rows in frequency see them; the flight has that number."""
        step_s, band = self.signals.step_s, self.band_hz
        return tuple(
            SpectralRun(number, run.stop - run.start, step_s, band, counted=self.usable[run])
            for run in self.runs
        )

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last second used, of a flight that has runs [s]."""
        time_s = self.grid.time_s
        return float(time_s[self.runs[0].start]), float(time_s[self.runs[-1].stop - 1])

    @property
    def used_s(self) -> float:
        """Time used [s]."""
        return float(self.used.sum()) * self.signals.step_s

    @property
    def used_input(self) -> Float[np.ndarray, "used rotors"]:
        """Input over the samples used, one column for each actuator."""
        return self.signals.family(self.input.name)[self.used]

    @property
    def input_level(self) -> float:
        """Size of the input over the samples used, by which inputs of other scales are recognised."""
        return float(np.abs(self.used_input).mean())

    @property
    def driving(self) -> tuple[str, ...]:
        """Channels that drive the vehicle."""
        return tuple(family_members(self.input.name, self.signals.channels))

    @property
    def constant_input(self) -> bool:
        """The input does not vary over the runs."""
        level = self.used_input
        threshold = CONSTANT_INPUT_SHARE * max(float(np.abs(level).max(initial=0.0)), 1e-12)
        return bool(self.runs) and float(level.std(axis=0).max()) <= threshold


def deviations(flights: Sequence[PreparedFlight], channels: Iterable[tuple[str, str, str, float]]) -> str:
    """Standard deviations over the time used: words, name and shown unit of each channel, and its scale."""
    parts = []
    for words, name, unit, scale in channels:
        used = np.concatenate([flight.signals.channel(name)[flight.used] for flight in flights])
        parts.append(f"{words} {scale * used.std():.2g} {unit}".strip())
    return f"Standard deviations: {', '.join(parts)}."


def mask_of(runs: Sequence[slice], count: int) -> Bool[np.ndarray, " n"]:
    """Mask of `count` samples that is true within the runs."""
    mask = np.zeros(count, dtype=np.bool_)
    for run in runs:
        mask[run] = True
    return mask
