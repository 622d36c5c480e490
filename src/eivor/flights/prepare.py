"""From a recording to a flight that can be identified: channels, grid, limits, segments, references.

Which channels, and what limits them, is the motion's to say. Nothing is estimated here. What is wrong with
a flight becomes a finding, so that it can be reported beside the numbers; only what makes numbers
impossible raises.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from eivor.errors import MissingChannelError
from eivor.flights.frames import upward
from eivor.flights.grid import Grid, command_on_grid, common_grid, on_grid
from eivor.flights.motion import Motion
from eivor.flights.noise_level import white_noise_std
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight, mask_of
from eivor.flights.references import Reference, named_reference, references
from eivor.flights.selection import Limit, Selection
from eivor.signals.noise import WhiteNoise
from eivor.signals.recording import Channel, Recording, interval_within
from eivor.signals.signals import Signals

#: Runs shorter than this are left out [s].
SHORTEST_RUN_S = 3.0


def prepare(recording: Recording, motion: Motion[Any], options: FlightOptions) -> PreparedFlight:
    """Put a recording on one grid and find the runs that can be used.

    Raises
    ------
    MissingChannelError
        When the motion's channels, or the options', are not in the log.
    InputError
        When the channels share no time.
    UsageError
        When the window lies outside the log.
    """
    log = upward(recording)
    selected = motion.select(log, options)
    for channel in selected.channels:
        _refuse_empty(log, channel)
    fast = [*selected.commands, *selected.logged_responses]
    grid = common_grid(selected.channels, fast, motion.memory_s)
    channels, good = _gridded(selected, grid)
    level = np.stack([channels[command.name] for command in selected.commands], axis=1).mean(axis=1)
    active = motion.active(log, grid, level)
    usable = good & active.mask & _within(channels, selected.limits, grid.count)
    if options.window is not None:
        start, end = interval_within(options.window, log.span_s)
        usable &= (grid.time_s >= start) & (grid.time_s <= end)
    runs = Signals(1.0 / grid.step_s, channels, valid=usable).runs(SHORTEST_RUN_S)
    used = mask_of(runs, grid.count)
    candidates = _references(log, motion, grid, used, options)
    channels.update({reference.name: reference.values for reference in candidates if reference.usable})
    noise = _noise(selected, channels, used)
    return PreparedFlight(
        log,
        Signals(1.0 / grid.step_s, channels, noise=noise, valid=usable, start_s=grid.start_s),
        selected.input,
        options.input_map or log.input_map or selected.input.input_map,
        tuple(runs),
        selected.band_hz,
        candidates,
        active,
        usable,
        selected.rates_hz,
        (*log.findings, *selected.findings),
        grid,
        motion.memory_s,
        selected.estimated,
    )


def _refuse_empty(log: Recording, channel: Channel) -> None:
    if channel.time_s.size < 2 or not np.isfinite(channel.values).any():
        raise MissingChannelError(
            f"values in the channel '{channel.name}' of {log.name}",
            f"{channel.time_s.size} samples, {int(np.isfinite(channel.values).sum())} of them numbers",
            "Log it, or use another channel.",
        )


def _gridded(
    selected: Selection, grid: Grid
) -> tuple[dict[str, Float[np.ndarray, " n"]], Bool[np.ndarray, " n"]]:
    """Values of every channel on the grid, and where all of them stand on data."""
    commands = {command.name for command in selected.commands}
    channels: dict[str, Float[np.ndarray, " n"]] = {}
    good = np.ones(grid.count, dtype=np.bool_)
    for channel in selected.channels:
        bring = command_on_grid if channel.name in commands else on_grid
        channels[channel.name], stands = bring(channel, grid)
        good &= stands
    for name, value in selected.constants.items():
        channels.setdefault(name, np.full(grid.count, value))
    return channels, good


def _within(
    channels: dict[str, Float[np.ndarray, " n"]], limits: tuple[Limit, ...], count: int
) -> Bool[np.ndarray, " n"]:
    """Samples within every limit."""
    mask = np.ones(count, dtype=np.bool_)
    for limit in limits:
        mask &= (channels[limit.channel] >= limit.low) & (channels[limit.channel] <= limit.high)
    return mask


def _references(
    log: Recording,
    motion: Motion[Any],
    grid: Grid,
    used: Bool[np.ndarray, " n"],
    options: FlightOptions,
) -> tuple[Reference, ...]:
    """References that the log has; in place of them those that a user named."""
    automatic = references(log, motion.references, grid, used)
    named = [name for name in options.instruments if name not in {"references", "lags"}]
    if not named:
        return automatic
    clean = {reference.name: reference for reference in automatic if reference.usable and reference.exogenous}
    return tuple(clean[name] if name in clean else named_reference(log, name, grid) for name in named)


def _noise(
    selected: Selection, channels: dict[str, Float[np.ndarray, " n"]], used: Bool[np.ndarray, " n"]
) -> dict[str, WhiteNoise]:
    """White noise levels, read off above the band; what total least squares scales its columns by."""
    measured = (*selected.states.values(), *selected.logged_responses)
    return {channel.name: WhiteNoise(white_noise_std(channels[channel.name][used])) for channel in measured}
