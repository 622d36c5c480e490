"""How channels of a machine answer its references, and the formula of what that tells of parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import msgspec
import numpy as np
import scipy.fft

from eivor.estimation.estimate import Estimate
from eivor.flights.lag_prior import EFFECTIVE_LAG
from eivor.flights.motion import Flights
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, LaggedRuns
from eivor.models.separable import Values
from eivor.models.spectral import SpectralRun, densities
from eivor.motions.equation import AxisEquation
from eivor.signals.signals import Signals
from eivor.tools import Bool, Float

#: An answer to a pulse is straight between knots: a sample apart, later in this ratio, up to the last.
RATIO, LAST_S = 1.25, 8.0
#: A plan is in use for this share of its time at least.
LEAST_IN_USE = 0.5
#: What is left out of that, as a share.
SLOW = 0.02
#: Ridges that weights are chosen from, as shares of the largest singular value squared.
RIDGES = np.geomspace(1e-14, 1e-2, 25)
#: Frequencies at which densities are kept, over the band.
NODES = 12
#: Of a uniform law over a range.
UNIFORM = 1.0 / math.sqrt(12.0)

#: From values of expressions to the samples that count, None for all, and the rule.
Counted = Callable[[Callable[[str], Float[np.ndarray, " n"]]], "tuple[Bool[np.ndarray, ' n'] | None, str]"]


class Answers(msgspec.Struct):
    """A machine in its loop: how channels answer references, and what no term explains."""

    step_s: float
    band_hz: tuple[float, float]
    references: list[str]
    levels: dict[str, float]
    #: Largest distance from the level; of references the largest rate and acceleration as well
    sizes: dict[str, tuple[float, ...]]
    highest_hz: dict[
        str, float
    ]  # Of references: all but a little of the power of their acceleration is below
    weights: dict[str, list[float]]  # Of each channel: answers to every reference at the knots
    densities: list[list[float]]  # One-sided, of each axis
    std_errors: dict[str, float] = {}  # By the formula, of what was logged

    def channels(self, moves: Mapping[str, Float[np.ndarray, " n"]]) -> dict[str, np.ndarray]:
        """Every channel where references move so about their levels."""
        columns = _answering([moves[name] for name in self.references], self.step_s)
        answers = {name: self.levels[name] + columns @ weights for name, weights in self.weights.items()}
        return answers | {name: self.levels[name] + moves[name] for name in self.references}

    def expected(
        self,
        axes: Sequence[AxisEquation],
        counted: Counted,
        channels: Mapping[str, Float[np.ndarray, " n"]],
        values: Values,
        delays_s: Sequence[float],
    ) -> tuple[dict[str, float], float]:
        """Standard error of each parameter and nuisance by the formula, and a log determinant of them."""
        signals = Signals(1.0 / self.step_s, channels)
        count = signals.sample_count
        mask, _ = counted(lambda text: axes[0].columns(signals, [text])[:, 0])
        if mask is not None and mask.mean() < LEAST_IN_USE:
            return {}, math.inf
        run = SpectralRun(0, count, self.step_s, self.band_hz, counted=mask)
        lags = [
            item for item in (ACTUATOR_LAG.name, DELAY.name) if any(t.behind for a in axes for t in a.terms)
        ]
        # a lag costs more than a delay, and data hardly tell them apart
        at = dict(zip(lags, (sum(values[name] for name in lags), 0.0), strict=False))
        names = [term.name for axis in axes for term in axis.terms if not term.is_intercept] + lags
        triangle = np.zeros((0, len(names)))
        if lags:
            triangle = np.eye(1, len(names), len(names) - 1)
            triangle /= max(UNIFORM * (delays_s[-1] - delays_s[0]), 1e-4)
        for axis, density in zip(axes, self.densities, strict=True):
            steady = [term for term in axis.terms if term.is_steady]
            behind = [term for term in axis.terms if term.behind]
            gains, columns = [values[term.name] for term in behind], np.zeros((count, len(names)))
            index = [names.index(term.name) for term in (*steady, *behind)]
            columns[:, index[: len(steady)]] = axis.columns(signals, [term.of for term in steady])
            if behind:
                columns[:, index[len(steady) :]] = axis.driven(signals, at)
            for name in lags if behind else ():
                ends = [max(at[name] + part * self.step_s, 0.0) for part in (-0.5, 0.5)]
                below, above = (axis.driven(signals, {**at, name: end}) @ gains for end in ends)
                columns[:, names.index(name)] = (above - below) / (ends[1] - ends[0])
            power = np.exp(np.interp(np.log(run.frequency_hz), np.log(_nodes(self.band_hz)), np.log(density)))
            power *= float(np.mean(run.taper**2)) / (4.0 * self.step_s)
            white = run.spectrum(columns) / np.sqrt(power)[:, None]
            triangle = np.asarray(np.linalg.qr(np.concatenate([triangle, white.real, white.imag]), mode="r"))
        scale = np.maximum(np.linalg.norm(triangle, axis=0), 1e-300)
        inverse = np.linalg.pinv(triangle / scale, rcond=1e-10) / scale[:, None]
        if lags:
            names, inverse = [*names, EFFECTIVE_LAG], np.vstack([inverse, inverse[-2] + inverse[-1]])
        results = dict(zip(names, np.linalg.norm(inverse, axis=1).tolist(), strict=True))
        # of the parameters, and of lag and delay together
        kept = [k for k, name in enumerate(names) if name not in lags]
        return results, 2.0 * float(np.linalg.slogdet(inverse[kept] @ inverse[kept].T)[1])


def answers_of(
    axes: Sequence[AxisEquation],
    counted: Counted,
    delays_s: Sequence[float],
    problem: LaggedRuns,
    estimate: Estimate,
    flights: Flights,
) -> dict[str, object]:
    """The answers of flights, ready for JSON; nothing where references do not move, or do in some only."""
    first = flights[0]
    references, step_s = list(first.usable_references), first.signals.step_s
    alike = all([*f.usable_references] == references and f.signals.step_s == step_s for f in flights)
    if not (references and alike and len(problem.axes) == len(axes)):
        return {}
    channels = dict.fromkeys((*references, *first.signals.channels))
    parts = {
        name: [flight.signals.channel(name) for flight in flights]
        for name in channels
        if all(name in flight.signals.channels for flight in flights)
    }
    used = [flight.usable for flight in flights]
    levels = {name: float(np.mean(_joined(series, used))) for name, series in parts.items()}
    about = {name: [np.nan_to_num(item - levels[name]) for item in series] for name, series in parts.items()}
    sizes = {
        name: tuple(
            float(
                max(np.abs(np.diff(item, n)[keep[n:]]).max() for item, keep in zip(series, used, strict=True))
            )
            / step_s**n
            for n in range(3 if name in references else 1)
        )
        for name, series in about.items()
    }
    highest = {name: max(_highest_hz(item, step_s) for item in about[name]) for name in references}
    answering = [name for name in about if name not in references]
    columns = np.concatenate(
        [_answering([about[name][k] for name in references], step_s)[keep] for k, keep in enumerate(used)]
    )
    targets = np.column_stack([_joined(about[name], used) for name in answering])
    solution = _ridge(columns, targets, 2.0 * first.band_hz[1] * step_s * columns.shape[0])
    weights = dict(zip(answering, solution.T.tolist(), strict=True))
    bins = problem.bins(estimate.nuisances)
    power = (np.abs(bins.residuals(estimate.theta)) ** 2).T
    of_bin = np.concatenate([np.full(run.count, run.axis) for run in bins.layout.runs])
    noises = [
        np.min(
            [
                densities(
                    [run for run in bins.layout.runs if run.axis == number],
                    item[of_bin == number],
                    _nodes(first.band_hz),
                )
                for item in power
            ],
            axis=0,
        )
        for number in range(len(axes))
    ]
    noises = [np.maximum(item, 1e-300).tolist() for item in noises]
    made = Answers(step_s, first.band_hz, references, levels, sizes, highest, weights, noises)
    values = dict(zip((item.name for item in problem.parameters), estimate.theta.tolist(), strict=True))
    every: dict[str, float] = {}
    for k in range(len(flights)):
        logged = made.channels({name: about[name][k] for name in references})
        errors, _ = made.expected(axes, counted, logged, {**values, **estimate.nuisances}, delays_s)
        every = {
            name: 1.0 / math.hypot(1.0 / every.get(name, math.inf), 1.0 / error)
            for name, error in errors.items()
        }
    return msgspec.to_builtins(msgspec.structs.replace(made, std_errors=every))


def faster(series: Float[np.ndarray, " n"], step_s: float, frequency_hz: float) -> float:
    """Share of the power of the acceleration above a frequency."""
    power = np.abs(np.fft.rfft(np.diff(series, 2))) ** 2
    above = np.fft.rfftfreq(series.size - 2, step_s) > frequency_hz
    return float(power[above].sum() / max(power.sum(), 1e-300))


def _highest_hz(series: Float[np.ndarray, " n"], step_s: float) -> float:
    power = np.cumsum(np.abs(np.fft.rfft(np.diff(series, 2))) ** 2)
    return float(np.fft.rfftfreq(series.size - 2, step_s)[np.searchsorted(power, (1.0 - SLOW) * power[-1])])


def _ridge(
    columns: Float[np.ndarray, "n k"], targets: Float[np.ndarray, "n m"], independent: float
) -> Float[np.ndarray, "k m"]:
    """Weights with the ridge of least generalized cross-validation, of so many independent samples."""
    U, s, Vt = np.linalg.svd(columns, full_matrices=False)
    parts, results = U.T @ targets, []
    for part, power in zip(parts.T, (targets**2).sum(axis=0), strict=True):
        kept = s**2 / (s**2 + s[0] ** 2 * RIDGES[:, None])
        left = power - part @ part + (((1.0 - kept) * part) ** 2).sum(axis=1)
        best = kept[np.argmin(left / (1.0 - np.minimum(kept.sum(axis=1) / independent, 0.9)) ** 2)]
        results.append(Vt.T @ (best * part / np.maximum(s, 1e-300)))
    return np.column_stack(results)


def _joined(series: Sequence[np.ndarray], used: Sequence[np.ndarray]) -> Float[np.ndarray, " n"]:
    return np.concatenate([item[keep] for item, keep in zip(series, used, strict=True)])


def _nodes(band_hz: tuple[float, float]) -> Float[np.ndarray, " nodes"]:
    return np.geomspace(max(band_hz[0], 1e-3), band_hz[1], NODES)


def _answering(series: Sequence[np.ndarray], step_s: float) -> Float[np.ndarray, "n columns"]:
    """Each reference through the pulse at every knot."""
    knots = [-1, 0]
    while knots[-1] * step_s < LAST_S:
        knots.append(max(knots[-1] + 1, round(RATIO * knots[-1])))
    taps = np.arange(-1, knots[-1] + 1)
    pulses = np.stack([np.interp(taps, knots, row) for row in np.eye(len(knots))])
    count = series[0].size
    length = scipy.fft.next_fast_len(count + taps.size, real=True)
    of_pulses = np.fft.rfft(pulses, length)
    columns = []
    for item in series:
        # before the first sample a reference was where it is then
        answers = np.fft.irfft(np.fft.rfft(item - item[0], length) * of_pulses, length)[:, 1 : count + 1]
        columns.append(answers.T + item[0] * pulses.sum(axis=1))
    return np.concatenate(columns, axis=1)
