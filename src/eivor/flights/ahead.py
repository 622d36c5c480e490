"""Predictions some tenths of a second ahead, from many starts of a flight: what they leave, by horizon.

A prediction starts from what was measured at a sample, and of what follows it knows the input alone. What
belongs to a run, its trim, is fitted to the run; the state is not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import ceil

import numpy as np

from eivor.flights.grid import RECOVERY_S
from eivor.flights.prepared import PreparedFlight
from eivor.shapes import Float, Int

#: How far ahead predictions look [s].
HORIZONS_S = (0.1, 0.2, 0.3, 0.4, 0.5)
#: Starts are so far apart [s]; in longer flights further, so that there are no more than so many.
BETWEEN_STARTS_S, MOST_STARTS = 0.05, 2000
#: Steps of the integration are no longer than this, or one of the grid [s].
LONGEST_STEP_S = 0.010
#: A state that runs away, by numbers that are far off, stays at this.
AWAY = 1e9
#: Names among the models: the fit itself, and that everything stays as it is at the start.
FIT, UNCHANGED = "fit", "unchanged"
#: Right-hand side of x' = f(x, sample) for starts side by side, over the step that begins at a sample.
Derivative = Callable[[Float[np.ndarray, "parts starts"], Int[np.ndarray, " starts"]], np.ndarray]


@dataclass(frozen=True)
class AheadError:
    """What one model leaves of one quantity after each horizon.

    Parameters
    ----------
    model, words : str
        The model's name, and what it is.
    quantity, unit : str
        What is predicted, and the unit of what is left.
    left : ndarray, shape (starts, horizons)
        Size of predicted less measured; NaN where nothing was measured.
    series : ndarray, shape (starts, 2), optional
        Measured and predicted after the last horizon, of a quantity that is a single number.
    """

    model: str
    words: str
    quantity: str
    unit: str
    left: Float[np.ndarray, "starts horizons"] = field(repr=False)
    series: Float[np.ndarray, "starts 2"] | None = field(default=None, repr=False)

    @property
    def rms(self) -> tuple[float, ...]:
        """Root mean square of what is left after each horizon."""
        return tuple(float(np.sqrt(np.mean(one[np.isfinite(one)] ** 2))) for one in self.left.T)


@dataclass(frozen=True)
class Ahead:
    """Predictions of flights by several models.

    Parameters
    ----------
    errors : tuple of AheadError
        Of every quantity: by the fit, then by each simpler model.
    start_s : ndarray, shape (starts,)
        Times of the starts on their log's clock [s], flight after flight.
    left_out : tuple of str
        Sentences that say what is not predicted, and why.
    horizons_s : tuple of float
        How far ahead [s].
    """

    errors: tuple[AheadError, ...]
    start_s: Float[np.ndarray, " starts"] = field(repr=False)
    left_out: tuple[str, ...] = ()
    horizons_s: tuple[float, ...] = HORIZONS_S

    @property
    def by_quantity(self) -> tuple[tuple[AheadError, ...], ...]:
        """Errors of each quantity, the fit's first."""
        names = dict.fromkeys(one.quantity for one in self.errors)
        return tuple(tuple(one for one in self.errors if one.quantity == name) for name in names)

    @property
    def ratios(self) -> dict[str, float]:
        """Errors of the fit over those of each simpler model, by its words.

        After the last horizon; the geometric mean over all quantities.
        """
        found: dict[str, list[float]] = {}
        for own, *others in self.by_quantity:
            for other in others:
                found.setdefault(other.words, []).append(own.rms[-1] / max(other.rms[-1], 1e-300))
        return {words: float(np.exp(np.mean(np.log(ratios)))) for words, ratios in found.items()}

    @property
    def predicts(self) -> bool:
        """Whether the fit leaves less than every simpler model, see `ratios`."""
        return bool(self.errors) and all(ratio <= 1.0 for ratio in self.ratios.values())

    @property
    def sentence(self) -> str:
        """What was found, in sentences."""
        after = f"After {self.horizons_s[-1]:g} s"
        than = [f"{ratio:.2g} of those of '{words}'" for words, ratio in self.ratios.items()]
        if not than:
            return f"{after} there is nothing to hold the fit's errors against."
        return f"{after} the fit's errors are {' and '.join(than)}, in the mean.{self._beaten}"

    @property
    def _beaten(self) -> str:
        """Sentences that say where a simpler model leaves less."""
        less: dict[str, list[str]] = {}
        for own, *others in self.by_quantity:
            for other in others:
                if other.rms[-1] < own.rms[-1]:
                    less.setdefault(other.words, []).append(own.quantity)
        return "".join(f" '{words}' leaves less of {', '.join(names)}." for words, names in less.items())


def all_ahead(
    by_flight: Sequence[tuple[AheadError, ...]],
    starts: Sequence[Float[np.ndarray, " _"]],
    left_out: tuple[str, ...],
) -> Ahead:
    """Predictions of several flights, one after the other; what nothing was measured of is left out."""
    errors = []
    for parts in zip(*(one for one in by_flight if one), strict=True):
        left = np.concatenate([one.left for one in parts])
        series = [one.series for one in parts if one.series is not None]
        if np.isfinite(left).any(axis=0).all():
            errors.append(replace(parts[0], left=left, series=np.concatenate(series) if series else None))
    return Ahead(tuple(errors), np.concatenate([*starts, np.empty(0)]), left_out)


@dataclass(frozen=True)
class Starts:
    """Where predictions of a flight start.

    Parameters
    ----------
    samples : ndarray of int, shape (starts,)
        Numbers of samples, all of whose next half second stands on data.
    steps : tuple of int
        Samples from a start to each horizon.
    step_s : float
        Step of the grid [s].
    """

    samples: Int[np.ndarray, " starts"]
    steps: tuple[int, ...]
    step_s: float

    @property
    def ends(self) -> Int[np.ndarray, "horizons starts"]:
        """Samples that are predicted."""
        return self.samples + np.array(self.steps)[:, None]

    def carried(
        self, state: Float[np.ndarray, "parts starts"], derivative: Derivative
    ) -> Float[np.ndarray, "horizons parts starts"]:
        """States at the horizons by Heun's method, all starts side by side.

        Parameters
        ----------
        state : ndarray, shape (parts, starts)
            At the starts.
        derivative : callable
            From states, and the samples at which a step begins, to the states' rates of change, with what
            drives them as `over_step` has it.
        """
        found, stride = [], self._stride
        step_s = stride * self.step_s
        for step in range(0, self.steps[-1], stride):
            now = self.samples + step
            first = derivative(state, now)
            second = derivative(np.clip(state + step_s * first, -AWAY, AWAY), now)
            state = np.clip(state + 0.5 * step_s * (first + second), -AWAY, AWAY)
            if step + stride in self.steps:
                found.append(state)
        return np.stack(found)

    def over_step(self, series: Float[np.ndarray, "... n"]) -> Float[np.ndarray, "... n"]:
        """Mean of a series, taken as a line between samples, over the step that begins at each sample."""
        stride = self._stride
        between = 0.5 * (series[..., :-1] + series[..., 1:])
        area = np.concatenate([np.zeros_like(series[..., :1]), np.cumsum(between, axis=-1)], axis=-1)
        found = series.copy()
        found[..., :-stride] = (area[..., stride:] - area[..., :-stride]) / stride
        return found

    @property
    def _stride(self) -> int:
        """Samples of a step, of which every horizon has a whole number."""
        most = max(int(LONGEST_STEP_S / self.step_s + 1e-9), 1)
        return max(one for one in range(1, most + 1) if all(step % one == 0 for step in self.steps))


def starts_of(flight: PreparedFlight) -> Starts:
    """Starts at even distances in every run of a flight, as soon as its actuators' states are known."""
    step_s = flight.signals.step_s
    steps = tuple(max(round(horizon / step_s), 1) for horizon in HORIZONS_S)
    broken = np.concatenate([[0], np.cumsum(~flight.usable)])
    every = max(round(BETWEEN_STARTS_S / step_s), -(-int(flight.used.sum()) // MOST_STARTS))
    known = ceil(RECOVERY_S / step_s)
    found = [np.arange(max(run.start, known), run.stop - steps[-1], every) for run in flight.runs]
    samples = np.concatenate([*found, np.empty(0, dtype=np.int64)]).astype(np.int64)
    whole = broken[samples + steps[-1] + 1] == broken[samples]
    return Starts(samples[whole], steps, step_s)


def trim(flight: PreparedFlight, left: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Mean of what an equation leaves over each run, on the samples of that run; zero elsewhere."""
    found = np.zeros(left.size)
    for run, samples in zip(flight.runs, flight.samples_of_runs, strict=True):
        found[run] = left[samples].mean()
    return found
