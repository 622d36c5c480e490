"""A flight on its grid, with everything that a motion, the recipe and the verdict need to know of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from eivor.flights.airborne import Active
from eivor.flights.declared_noise import NoiseLevel
from eivor.flights.grid import Grid, around
from eivor.flights.references import Reference
from eivor.flights.selection import InputFamily
from eivor.models.spectral import SpectralRun
from eivor.shapes import Bool, Float, Int
from eivor.signals.canonical import CurveSide
from eivor.signals.families import family_members
from eivor.signals.recording import Finding, Recording
from eivor.signals.signals import Signals

#: An input whose standard deviation is below this share of its mean is constant.
CONSTANT_INPUT_SHARE = 1e-6


@dataclass(frozen=True)
class PreparedFlight:
    """A flight on its grid.

    Parameters
    ----------
    recording : Recording
        The log, z up.
    signals : Signals
        Channels that the motion selected, and the references, on one grid.
    input : InputFamily
        What drives the vehicle.
    input_map : str
        Name of the input map.
    runs : tuple of slice
        Stretches to use; without any nothing can be estimated. Of their samples those count that are usable.
    band_hz : tuple of float
        Band of spectral rows [Hz].
    references : tuple of Reference
        Candidate instruments.
    active : Active
        Where the vehicle does what the motion describes: where it flies.
    usable : ndarray of bool, shape (n,)
        Samples that are active, in the window, within the motion's limits, and standing on data.
    rates_hz : mapping of str to float
        Mean logging rates by role: "command" and those of the selection (0 when absent).
    findings : tuple of Finding
        Named diagnostics.
    grid : Grid
        Times of the samples.
    memory_s : float
        Time before a sample that decides the state of the actuators [s].
    estimated : tuple of str
        Roles of the selection whose channel comes from an estimator.
    command_slack_s : float
        What the command may be late or early by throughout, see `CommandClock` [s].
    unlogged_step_s : float
        Time between two commands where the log holds but some of them; zero where it holds every one [s].
    noise : mapping of str to NoiseLevel
        Measurement noise by channel.
    states : tuple of str
        Channels of the selection's states, which are regressors.
    curve_side : CurveSide
        Where the channels of the input stand to the autopilot's thrust curve; unknown where they differ.
    """

    recording: Recording
    signals: Signals
    input: InputFamily
    input_map: str
    runs: tuple[slice, ...]
    band_hz: tuple[float, float]
    references: tuple[Reference, ...]
    active: Active
    usable: Bool[np.ndarray, " n"]
    rates_hz: Mapping[str, float]
    findings: tuple[Finding, ...]
    grid: Grid
    memory_s: float
    estimated: tuple[str, ...] = ()
    command_slack_s: float = 0.0
    unlogged_step_s: float = 0.0
    noise: Mapping[str, NoiseLevel] = field(default_factory=dict)
    states: tuple[str, ...] = ()
    curve_side: CurveSide = CurveSide.UNKNOWN

    @cached_property
    def shortened(self) -> PreparedFlight:
        """The same flight with the samples that its runs need and no others, whatever lies between them."""
        kept = around(mask_of(self.runs, self.usable.size), self.grid, self.memory_s)
        if kept.all() or not self.runs:
            return self
        place = np.cumsum(kept) - 1
        signals = replace(
            self.signals,
            channels={name: values[kept] for name, values in self.signals.channels.items()},
            valid=self.usable[kept],
        )
        return replace(
            self,
            signals=signals,
            runs=tuple(slice(int(place[run.start]), int(place[run.stop - 1]) + 1) for run in self.runs),
            references=tuple(replace(one, values=one.values[kept]) for one in self.references),
            active=replace(self.active, mask=self.active.mask[kept]),
            usable=self.usable[kept],
            grid=self.grid.kept(kept),
        )

    @property
    def usable_references(self) -> tuple[str, ...]:
        """Names of the references that may serve as instruments."""
        return tuple(reference.name for reference in self.references if reference.usable)

    def asked(self, name: str) -> Float[np.ndarray, " n"] | None:
        """Values of a reference on the grid; None for one that is not logged."""
        return next((one.values for one in self.references if one.name == name), None)

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
    def driving(self) -> tuple[str, ...]:
        """Channels that drive the vehicle."""
        return tuple(family_members(self.input.name, self.signals.channels))

    @property
    def actuators(self) -> int:
        """Number of channels that drive the vehicle."""
        return int(self.signals.family(self.input.name).shape[1])

    @property
    def constant_input(self) -> bool:
        """The input does not vary over the runs."""
        if not self.runs:
            return False
        level = self.used_input
        spread = float(level.std(axis=0).max())
        return spread <= CONSTANT_INPUT_SHARE * max(float(np.abs(level).max()), 1e-12)


def mask_of(runs: Sequence[slice], count: int) -> Bool[np.ndarray, " n"]:
    """Mask of `count` samples that is true within the runs."""
    mask = np.zeros(count, dtype=np.bool_)
    for run in runs:
        mask[run] = True
    return mask
