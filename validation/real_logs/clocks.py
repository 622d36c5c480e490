"""When a logger samples its channels, and which stamps it writes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eivor.signals.channels import held_by_default, unit_of
from eivor.signals.recording import Channel, clean_channel
from validation.real_logs.spec import STEP_S, FlightSpec, Jitter

#: A channel's jitter is at most this share of its period, or loggers would write heaps of stamps.
LARGEST_JITTER = 0.35
#: How long the logger is lost [s].
DROPOUT_SECONDS = (0.05, 0.5)


@dataclass(frozen=True, slots=True)
class Clock:
    """Samples of one topic."""

    instants: Float[np.ndarray, " n"]  # When they were taken [s]
    stamps: Float[np.ndarray, " n"]  # When the log says that they were [s]


def topic_clock(spec: FlightSpec, rate_hz: float, rng: np.random.Generator) -> Clock:
    """Clock of a topic that the logger samples itself, out of step with every other."""
    period = 1.0 / rate_hz
    regular = rng.uniform(0.0, period) + period * np.arange(int(spec.duration * rate_hz) - 1)
    return _jittered(spec, regular, period, rng)


def command_clock(spec: FlightSpec, rng: np.random.Generator) -> Clock:
    """Clock of the command."""
    every = STEP_S * spec.vehicle.controller_steps
    period = max(1.0 / spec.logger.command_hz, every)
    ticks = rng.uniform(0.0, period) + period * np.arange(int(spec.duration / period) - 1)
    if spec.logger.jitter is Jitter.INSTANTS:
        ticks = _jittered(spec, ticks, period, rng).instants
    issued = every * np.unique(np.floor(ticks / every + 1e-9))
    return (
        _jittered(spec, issued, period, rng) if spec.logger.jitter is Jitter.STAMPS else Clock(issued, issued)
    )


def _jittered(
    spec: FlightSpec, regular: Float[np.ndarray, " n"], period: float, rng: np.random.Generator
) -> Clock:
    size = min(spec.logger.jitter_s, LARGEST_JITTER * period)
    moved = np.maximum(regular + size * rng.standard_normal(regular.size), 0.0)
    if spec.logger.jitter is Jitter.INSTANTS:
        moved = np.sort(moved)
        return Clock(moved, moved)
    return Clock(regular, moved if spec.logger.jitter is Jitter.STAMPS else regular)


@dataclass(frozen=True)
class Writer:
    """What happens to every topic on its way into the log: gaps, and samples that are written twice."""

    spec: FlightSpec  # The flight
    gaps: Float[np.ndarray, "m 2"]  # Begin and end [s] of what is lost
    rng: np.random.Generator  # Picks what is written twice

    def channel(self, name: str, clock: Clock, values: Float[np.ndarray, " n"], source: str) -> Channel:
        """Channel of the log."""
        kept = ~self._lost(clock.instants)
        times = np.where(self.rng.random(int(kept.sum())) < self.spec.logger.duplicates, 2, 1)
        stamps, series = (np.repeat(part[kept], times) for part in (clock.stamps, values))
        return clean_channel(name, stamps, series, unit_of(name), source=source, held=held_by_default(name))

    def _lost(self, instants: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        after = instants[:, None]
        return np.asarray(((after >= self.gaps[:, 0]) & (after < self.gaps[:, 1])).any(axis=1))


def writer(spec: FlightSpec, rng: np.random.Generator) -> Writer:
    """Writer with gaps drawn over the flight."""
    count = int(rng.poisson(spec.logger.dropouts * spec.duration / 60.0))
    begin = rng.uniform(0.0, spec.duration, count)
    return Writer(spec, np.stack([begin, begin + rng.uniform(*DROPOUT_SECONDS, count)], axis=1), rng)
