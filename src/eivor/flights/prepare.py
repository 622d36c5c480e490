"""Preparation of recordings: overview, terms and the flights of a pool."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from eivor.errors import MissingChannelError, PoolingError, UsageError, did_you_mean
from eivor.estimation.linear import OUTPUT_ERROR, OutputError
from eivor.estimation.methods import by_name
from eivor.flights import prepared
from eivor.flights.grid import Active, Grid, Mask, bridged, command_on_grid, common_grid, on_grid, upward
from eivor.flights.motion import Motion
from eivor.flights.options import FIT_MAP, FlightOptions
from eivor.flights.prepared import PreparedFlight
from eivor.flights.references import jumps, named_reference, noise_levels, references
from eivor.flights.timestamps import Clock, as_issued, check_rate, command_clock, known_clock
from eivor.signals.channels import common_side, family_members
from eivor.signals.filters import fast_length
from eivor.signals.noise import WhiteNoise
from eivor.signals.recording import CONTROLLER_RATE, Channel, Finding, Recording, interval_within
from eivor.signals.signals import Signals, stretches
from eivor.tools import Float

#: Runs shorter than this are left out, and flights with less than this to use [s].
SHORTEST_RUN_S = 1.0
LEAST_USED_S = 3.0
#: Excursions beyond a limit that are no longer than this do not end a run, unless they are most of it [s].
LONGEST_EXCURSION_S = 1.0
LEAST_COUNTED_SHARE = 0.5
#: Parameters that hold the rate of the loop that issues commands [Hz]: ArduPilot's, and of simulated flights.
CONTROLLER_RATES = ("SCHED_LOOP_RATE", CONTROLLER_RATE)
#: Time that is read around the window of a long log: longer than the actuators' memory [s].
MARGIN_READ_S = 30.0


def prepare(recording: Recording, motion: Motion[Any], options: FlightOptions) -> PreparedFlight:
    """Put a recording on one grid and find the runs that can be used."""
    window = None if options.window is None else interval_within(options.window, recording.span_s)
    log, selected = _selected(part_to_read(recording, options.window), motion, options)
    fast = [*selected.commands, *selected.logged_responses]
    grid = common_grid(selected.channels, fast, step_s=selected.step_s)
    clocks = _clocks(log, selected, options.controller_rate_hz)
    filled = [bridged(command) if command.held else command for command in selected.commands]
    issued = tuple(as_issued(item, clocks[item.name]) if item.name in clocks else item for item in filled)
    channels, masks = _gridded(selected, grid, issued)
    if selected.matched_interpolation_filter:
        channels = prepared.matched_interpolation_filter(channels, selected, clocks, grid)
    level = np.stack([channels[command.name] for command in selected.commands], axis=1).mean(axis=1)
    active = selected.active(log, grid, level)
    inside = np.ones(grid.count, dtype=np.bool_)
    if window is not None:
        inside = (grid.time_s >= window[0]) & (grid.time_s <= window[1])
    allowed = np.logical_and.reduce([inside, active.mask, *masks.values()])
    usable = allowed.copy() if active.counted is None else allowed & active.counted
    for name, limit in selected.at_least.items():
        usable &= channels[name] >= limit
    runs = _runs(allowed, usable, grid.step_s)
    used = prepared.mask_of(runs, grid.count) & usable
    candidates = references(log, motion.channels.references, grid, used)
    words = [word for word in options.instruments if word not in {"references", "lags"}]
    named = [name for word in words for name in family_members(word, log.channels) or [word]]
    if named:  # by a user, who may mean one that serves by itself
        exogenous = {item.name: item for item in candidates if item.usable and item.exogenous}
        candidates = tuple(exogenous.get(name) or named_reference(log, name, grid) for name in named)
    channels.update({reference.name: reference.values for reference in candidates if reference.usable})
    measured = (*selected.states.values(), *selected.logged_responses)
    driving = selected.commands if selected.input.measured or isinstance(options.noise, Mapping) else ()
    levels = noise_levels(log, (*measured, *driving), options.noise, (grid, used, channels), selected.between)
    commands = {command.name for command in selected.commands}
    listed = {name: level for name, level in levels.items() if level.source or name not in commands}
    noise = {name: WhiteNoise(level.std) for name, level in listed.items()}
    requested_map = "" if options.input_map == FIT_MAP else options.input_map
    band = selected.band_hz
    jump = any(jumps(log.channel(item.name), grid, used) for item in candidates if item.usable)
    if jump and not selected.matched_interpolation_filter:
        for clock in clocks.values():  # as far as the command is known
            band = clock.band_hz(band)
    partial = [clock for clock in clocks.values() if clock.thinned]
    # once for commands that are logged alike
    by_clock = [Finding("command_clock", text) for text in dict.fromkeys(item.sentence for item in partial)]
    resets = [item for item in candidates if item.usable and item.logged is not None]
    reset = [Finding("reference_reset", f"{item.name}: {item.remark}.") for item in resets]
    texts = [f"{name} {level.sentence}" for name, level in listed.items() if level.source]
    noisy = [Finding("noise", f"Measurement noise: {'; '.join(texts)}.")] if texts else []
    return PreparedFlight(
        log,
        Signals(1.0 / grid.step_s, channels, noise=noise, valid=usable, start_s=grid.start_s),
        selected.input,
        requested_map or log.input_map or selected.input.input_map,
        tuple(runs),
        band,
        candidates,
        active,
        usable,
        selected.rates_hz,
        (*log.findings, *selected.findings, *by_clock, *reset, *noisy),
        grid,
        selected.measured,
        command_slack_s=max((clock.slack_s for clock in clocks.values()), default=0.0),
        unlogged_step_s=max((clock.issued_s for clock in partial), default=0.0),
        locked_s=max((clock.locked_s for clock in partial), default=0.0),
        noise=listed,
        states=tuple(channel.name for channel in selected.states.values()),
        curve_side=common_side(command.curve_side for command in selected.commands),
        issued=() if selected.matched_interpolation_filter else issued,
        shortfall=("", "") if runs else _shortfall(motion, selected, grid, inside, masks, active, channels),
    )


def part_to_read(log: Recording, window: tuple[float, float] | None) -> Recording:
    """Return the part of a log that a window needs; logs that fit into memory stay whole."""
    if window is None:
        return log
    start, end = interval_within(window, log.span_s)
    return log.part(start - MARGIN_READ_S, end + MARGIN_READ_S)


def _runs(allowed: Mask, usable: Mask, step_s: float) -> list[slice]:
    """Stretches of allowed samples, most of them usable."""
    filled, padded = usable.copy(), np.pad(usable, 1)
    for excursion in stretches(allowed & ~usable):
        inside = padded[excursion.start] and usable[min(excursion.stop, usable.size - 1)]
        filled[excursion] = inside and (excursion.stop - excursion.start) * step_s <= LONGEST_EXCURSION_S
    # without the last few samples that would make spectra slow
    fast = (slice(run.start, run.start + fast_length(run.stop - run.start)) for run in stretches(filled))
    sufficient = (run for run in fast if usable[run].sum() * step_s >= SHORTEST_RUN_S)
    runs = [run for run in sufficient if usable[run].mean() >= LEAST_COUNTED_SHARE]
    return runs if sum(usable[run].sum() for run in runs) * step_s >= LEAST_USED_S else []


def _shortfall(
    motion: Motion[Any],
    selected: prepared.Selection,
    grid: Grid,
    inside: Mask,
    masks: Mapping[str, Mask],
    active: Active,
    channels: Mapping[str, Float[np.ndarray, " n"]],
) -> tuple[str, str]:
    """The condition that fails most often, in words, and its remedy."""
    words, loosen = motion.words, motion.words.loosen
    whole_s, window_s = grid.count * grid.step_s, float(inside.sum()) * grid.step_s
    if whole_s < LEAST_USED_S:
        return f"it covers {whole_s:.2g} s", "Log for longer, or check the unit of its clock."
    if window_s < LEAST_USED_S:
        return f"the window holds {window_s:.2g} s of it", "Widen the window."
    conditions = [(mask, f"have no {name}", f"Log {name} without gaps.") for name, mask in masks.items()]
    conditions.append((active.mask, f"are not {words.where} (by {active.rule})", words.another_log))
    if active.counted is not None:
        conditions.append((active.counted, "are beyond what the motion describes", loosen))
    conditions += [
        (channels[name] >= limit, f"have a {name} below {limit:.2g}", loosen)
        for name, limit in selected.at_least.items()
    ]
    mask, words_of_failure, remedy = min(conditions, key=lambda item: float(item[0][inside].mean()))
    return f"{1.0 - float(mask[inside].mean()):.0%} of its samples {words_of_failure}", remedy


def _selected(
    recording: Recording, motion: Motion[Any], options: FlightOptions
) -> tuple[Recording, prepared.Selection]:
    """The log, z up, and the channels of a motion, none of them empty."""
    log = upward(recording)
    selected = motion.select(log, options)
    for channel in selected.channels:
        if channel.time_s.size < 2 or not np.isfinite(channel.values).any():
            dropped = channel.quality.duplicated_stamps + channel.quality.backward_stamps
            why = f"; {dropped} were dropped, because their stamp repeats or goes backward" if dropped else ""
            numbers = int(np.isfinite(channel.values).sum())
            expected = f"values in the channel '{channel.name}' of {log.name}"
            received = f"{channel.time_s.size} samples, {numbers} of them numbers{why}"
            remedy = "Check the clock: stamps increase." if dropped else "Log it, or use another channel."
            raise MissingChannelError(expected, received, remedy)
    return selected.log or log, selected


def _clocks(log: Recording, selected: prepared.Selection, rate_hz: float | None) -> dict[str, Clock]:
    """Clock of each held command, by a given rate, a parameter of the log or its stamps."""
    rates = (rate_hz, *(log.parameters.get(name) for name in CONTROLLER_RATES))
    known_hz = next((rate for rate in rates if rate), None)
    names = {command.name for command in selected.commands}
    others = [name for name in log.channels if name not in names]

    def clock(command: Channel) -> Clock:
        if rate_hz:
            check_rate(command, rate_hz)
        if known_hz:
            return known_clock(command, known_hz)
        # made one at a time: those of a long log do not fit into memory together
        by_stamps = command_clock(command, map(log.channels.__getitem__, others), selected.issued_within_s)
        nominal_hz = log.parameters.get(selected.rate_parameter)
        return known_clock(command, nominal_hz) if nominal_hz and not by_stamps.is_known else by_stamps

    return {command.name: clock(command) for command in selected.commands if command.held}


def _gridded(
    selected: prepared.Selection, grid: Grid, issued: tuple[Channel, ...]
) -> tuple[dict[str, Float[np.ndarray, " n"]], dict[str, Mask]]:
    """Values of every channel on the grid, and masks of those supported by data."""
    commands = {command.name: command for command in issued}
    channels: dict[str, Float[np.ndarray, " n"]] = {}
    masks: dict[str, Mask] = {}
    for channel in selected.channels:
        name = channel.name
        if name in commands:
            channels[name], masks[name] = command_on_grid(commands[name], grid)
        else:
            channels[name], masks[name] = on_grid(channel, grid, selected.between(channel))
    for name, value in selected.constants.items():
        channels.setdefault(name, np.full(grid.count, value))
    return channels, masks


#: Distance of samples [s]: shorter than what begins or ends a flight, and than that of slow telemetry.
OVERVIEW_STEP_S = 0.05


def overview(
    recording: Recording, motion: Motion[Any], options: FlightOptions
) -> tuple[str, tuple[tuple[float, float], ...]]:
    """Rule for when the vehicle moved, and the stretches in which it did [s]."""
    log = recording.part(*recording.span_s, OVERVIEW_STEP_S)
    log, selected = _selected(log, motion, options)
    grid = common_grid(selected.channels, selected.commands, step_s=OVERVIEW_STEP_S)
    level = np.mean([on_grid(command, grid)[0] for command in selected.commands], axis=0)
    active = selected.active(log, grid, level)
    time_s, moving = grid.time_s, stretches(active.mask)
    return active.rule, tuple((float(time_s[run.start]), float(time_s[run.stop - 1])) for run in moving)


Window = tuple[float, float] | None


def without_duplicates(
    logs: Sequence[Recording], windows: Sequence[Window]
) -> tuple[list[tuple[Recording, Window]], list[Finding]]:
    """Logs with their windows, each file's content with the same window once only."""
    unique: list[tuple[Recording, Window]] = []
    dropped: list[Finding] = []
    for log, window in zip(logs, windows, strict=True):
        twins = [a.name for a, other in unique if log.sha256 and (a.sha256, other) == (log.sha256, window)]
        if twins:
            sentence = f"{log.name} has the same content as {twins[0]}; it is used once only."
            dropped.append(Finding("duplicate_log", sentence))
        else:
            unique.append((log, window))
    return unique, dropped


def check_poolable(flights: tuple[PreparedFlight, ...], motion: Motion[Any], *, anyway: bool) -> None:
    """Refuse flights with different inputs or maps; unless `anyway`, those of different vehicles."""
    first = flights[0]
    for flight in flights[1:]:
        difference, remedy = "", "Identify them one by one."
        if first.input_map != flight.input_map:
            difference = f"input maps {first.input_map} and {flight.input_map}"
        elif (first.input.name, first.input.measured) != (flight.input.name, flight.input.measured):
            difference = f"inputs {first.input.name} and {flight.input.name}"
        elif len(first.driving) != len(flight.driving):
            difference = f"{len(first.driving)} and {len(flight.driving)} rotors"
        elif not anyway:
            difference = _vehicle_difference(first, flight, motion)
            remedy = f"{remedy} Or pool them all the same: --pool-anyway."
        if difference:
            names = f"{first.recording.name} and {flight.recording.name}"
            raise PoolingError(f"flights of one vehicle: {names} alike", difference, remedy)


def _vehicle_difference(first: PreparedFlight, second: PreparedFlight, motion: Motion[Any]) -> str:
    for name in motion.channels.vehicle_parameters:
        values = [flight.recording.parameters.get(name) for flight in (first, second)]
        # a log that lacks a parameter is of another firmware, not of another vehicle
        if None not in values and values[0] != values[1]:
            return f"{name} = {values[0]} and {values[1]}"
    levels = [flight.input_level for flight in (first, second) if flight.runs]
    if len(levels) == 2 and max(levels) > prepared.LARGEST_INPUT_RATIO * min(levels):
        return f"inputs of {levels[0]:.4g} and {levels[1]:.4g} on average, which are not on one scale"
    return ""


def check_options(motion: Motion[Any], options: FlightOptions) -> None:
    """Refuse options that a motion does not have, its optional terms among them."""
    terms = motion.abilities.terms
    unknown = [word for word in options.terms if word not in terms]
    if unknown:
        expected = (
            f"terms out of {', '.join(terms)}" if terms else f"no optional terms: '{motion.name}' has none"
        )
        received = ", ".join(f"'{word}'" for word in unknown)
        raise UsageError(expected, received, did_you_mean(unknown[0], terms, "Leave it out."))
    twice = sorted({word for word in options.terms if options.terms.count(word) > 1})
    if twice:
        raise UsageError("each term once", f"{', '.join(twice)} twice", "Name it once.")
    if isinstance(by_name(options.method), OutputError) and motion.abilities.prediction.output_error is None:
        expected = f"{OUTPUT_ERROR} with a motion that predicts its states"
        remedy = "Identify the rigid body (--model rigid-body), or use another method."
        raise UsageError(expected, f"it with '{motion.name}'", remedy)
    motion.abilities.check(options)
