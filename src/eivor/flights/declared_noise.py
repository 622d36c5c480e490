"""Measurement noises of a flight's channels: declared, by a data sheet or a channel map, or read off.

What is declared is of one sample as it is logged. On the grid a sample is a mean of the two beside it, or of
several, which have less noise: that share is worked out from the stamps.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eivor.errors import MissingNoiseError, UsageError, did_you_mean
from eivor.flights.between import Between, line_between
from eivor.flights.grid import Grid, on_grid
from eivor.flights.noise_level import white_noise_std
from eivor.shapes import Bool, Float
from eivor.signals.canonical import unit_of
from eivor.signals.data_sheet import DataSheet
from eivor.signals.families import family_members
from eivor.signals.noise import LARGEST_STD
from eivor.signals.recording import Channel, Finding, Recording

#: In place of numbers: noises are read off each channel's fastest part.
ESTIMATE = "estimate"
#: Most combs of stamps that are put on the grid to see how it thins noise.
COMBS = 24

#: What is said of the noise of a sample: its standard deviation, or the sensor's data sheet.
Declared = float | DataSheet


@dataclass(frozen=True, slots=True)
class NoiseLevel:
    """Noise of one channel.

    Parameters
    ----------
    std : float
        Standard deviation on the grid, in the channel's unit.
    logged_std : float
        Of a sample as logged.
    unit : str
        The channel's.
    source : str
        Where it is from, in words; empty for what nothing is declared of, which is read off the grid.
    density : float
        Amplitude density at frequencies far below the rate of the log, in the channel's unit per root of Hz.
    """

    std: float
    logged_std: float
    unit: str
    source: str = ""
    density: float = math.nan

    @property
    def sentence(self) -> str:
        """What is told of it."""
        told = f"{self.logged_std:.3g} {self.unit}".strip() + f" a sample, {self.source}"
        return told if self.std == self.logged_std else f"{told}, {self.std:.3g} on the grid"


def noise_levels(
    log: Recording,
    channels: Iterable[Channel],
    noise: Mapping[str, Declared] | str | None,
    on: tuple[Grid, Bool[np.ndarray, " n"], Mapping[str, Float[np.ndarray, " n"]]],
    between: Callable[[Channel], Between],
) -> dict[str, NoiseLevel]:
    """Noise of each channel that was measured.

    Parameters
    ----------
    log : Recording
        Whose channel map may have noises.
    channels : iterable of Channel
        What was measured, or drives the vehicle.
    noise : mapping, or str, or None
        See `FlightOptions.noise`.
    on : tuple
        The grid, the samples of it that are used, and the channels' values on it.
    between : callable
        Gives what a channel was between its stamps.

    Raises
    ------
    UsageError
        When a noise is declared of a channel that is not there.
    """
    measured = {channel.name: channel for channel in channels}
    declared = _by_channel(log, measured, {} if noise is None or isinstance(noise, str) else noise)
    grid, used, values = on
    levels = {}
    for name, channel in measured.items():
        source, logged = "", declared.get(name)
        if logged is not None:
            source = "declared"
        elif channel.noise is not None:
            source, logged = "by the channel map", channel.noise
        if isinstance(logged, DataSheet):
            source, logged = f"{source}, by a data sheet", logged.std(channel.rate_hz)
        if logged is None and noise == ESTIMATE and not channel.held:
            source, logged = "estimated from its fastest part", _read_off(channel, grid, used)
        if logged is None:
            level = white_noise_std(values[name][used])
            levels[name] = NoiseLevel(level, level, unit_of(name))
        else:
            std = (
                logged
                if channel.held
                else logged * math.sqrt(share_left(channel, grid, used, between(channel)))
            )
            density = logged * math.sqrt(2.0 / channel.rate_hz) if channel.rate_hz else math.nan
            levels[name] = NoiseLevel(std, logged, unit_of(name), source, density)
    return levels


def _by_channel(
    log: Recording, measured: Mapping[str, Channel], noise: Mapping[str, Declared]
) -> dict[str, Declared]:
    """What is declared by channel, that of a family for each of its members."""
    known = dict.fromkeys((*measured, *log.channels))
    found: dict[str, Declared] = {}
    for name, declared in noise.items():
        members = [name] if name in known else family_members(name.rstrip("*").rstrip("_"), known)
        if not members:
            raise UsageError(
                f"noise of channels of {log.name}: {', '.join(sorted(known))}",
                f"'{name}'",
                did_you_mean(name, known, "Name one of them, or a family such as rotor_speed."),
            )
        found.update(dict.fromkeys(members, declared))
    return found


def _read_off(channel: Channel, grid: Grid, used: Bool[np.ndarray, " n"]) -> float:
    """Noise of a sample as logged, during the time that is used."""
    time = grid.time_s[used]
    if not time.size:
        return 0.0
    inside = (channel.time_s >= time[0]) & (channel.time_s <= time[-1]) & np.isfinite(channel.values)
    return white_noise_std(channel.values[inside])


def share_left(
    channel: Channel, grid: Grid, used: Bool[np.ndarray, " n"], between: Between = line_between
) -> float:
    """Variance on the grid of noise that is white from stamp to stamp, over its variance there.

    Combs of ones, so far apart that no sample of the grid sees two, give the weights of all stamps.
    """
    if not used.any():
        return 1.0
    apart = math.ceil(grid.step_s * channel.rate_hz) + 3
    chosen = np.unique(np.linspace(0, apart - 1, min(apart, COMBS)).round().astype(np.int64))
    place, known = np.arange(channel.values.size) % apart, np.isfinite(channel.values)
    total = 0.0
    for first in chosen.tolist():
        comb = np.where(known, (place == first).astype(np.float64), np.nan)
        weights, _ = on_grid(Channel(channel.name, channel.time_s, comb, channel.unit), grid, between)
        total += float(np.mean(weights[used] ** 2))
    return total * apart / chosen.size


def check_declared(
    levels: Sequence[Mapping[str, NoiseLevel]], needed: Sequence[Sequence[str]], method: str
) -> None:
    """Refuse to estimate with noises that nothing is declared of.

    Parameters
    ----------
    levels : sequence of mapping of str to NoiseLevel
        By flight and channel.
    needed : sequence of sequence of str
        Channels of each flight whose noise the method takes out.
    method : str
        Its name.

    Raises
    ------
    MissingNoiseError
        With what to say.
    """
    missing = {
        name: own[name].unit if name in own else ""
        for own, names in zip(levels, needed, strict=True)
        for name in names
        if name not in own or not own[name].source
    }
    if missing:
        words = [f"{name} in {unit}" if unit else name for name, unit in missing.items()]
        first = next(iter(missing))
        raise MissingNoiseError(
            f"the measurement noise of {' and '.join(words)}, which {method} takes out",
            "none declared",
            f"Give it (--noise {first}=STD, a data sheet's --noise {first}=density:D,bandwidth:HZ,step:S, or "
            "a noise key in a channel map), or have it estimated: --noise estimate.",
        )


def noise_findings(levels: Mapping[str, NoiseLevel]) -> list[Finding]:
    """What was taken for the noise of each channel that something is declared of."""
    told = [f"{name} {level.sentence}" for name, level in levels.items() if level.source]
    return [Finding("noise", f"Measurement noise: {'; '.join(told)}.")] if told else []


def check_noise(noise: object) -> None:
    """Refuse what declares no noise.

    Raises
    ------
    UsageError
        With what came instead.
    """
    if noise is None or (isinstance(noise, str) and noise == ESTIMATE):
        return
    if not isinstance(noise, Mapping):
        raise UsageError(
            "noises by channel, or estimate",
            f"{noise!r}",
            'Give noise={"velocity_z": 0.02}, in SI units, or noise="estimate".',
        )
    for name, declared in noise.items():
        if isinstance(declared, DataSheet) and isinstance(name, str):
            continue
        number = isinstance(declared, int | float) and not isinstance(declared, bool)
        if not (isinstance(name, str) and number and 0.0 <= declared <= LARGEST_STD):
            raise UsageError(
                f"a standard deviation of zero or more for the noise of {name!r}",
                f"{declared!r}",
                'Give noise={"velocity_z": 0.02}, in SI units, or a DataSheet.',
            )
