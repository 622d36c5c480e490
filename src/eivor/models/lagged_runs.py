"""Regression of runs with a lagged and delayed input."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from eivor.errors import InstrumentError, ShapeError, TooFewSamplesError
from eivor.models.regression import AxisRows, Parameter, Regression, RowLayout, SampleRows, noise_of_surrogate
from eivor.models.separable import (
    Interpolation,
    ManyValues,
    MovingColumns,
    Nuisance,
    SeparableProblem,
    Values,
    WarmStart,
    values_of,
)
from eivor.models.spectral import BinRows, SpectralRegression, SpectralRun, trend
from eivor.signals.filters import weights_between_samples
from eivor.tools import Bool, Complex, Float

#: Nuisances of nearly every vehicle, as they are called in results.
ACTUATOR_LAG = Parameter("actuator_lag", "s")
DELAY = Parameter("delay", "s")
#: q of actuators that lag in two stages, q lag^2 w'' + lag w' + w = command, and the shorter of these [s].
SECOND_STAGE, SECOND_LAG = Parameter("second_stage", ""), "second_lag"
STAGES = (SECOND_LAG, SECOND_STAGE.name)
#: Half the difference of actuators' rates upward and downward over their mean; their lags [s].
ASYMMETRY, LAGS_UP_AND_DOWN = Parameter("lag_asymmetry", ""), ("lag_up", "lag_down")
#: Its range: one lag is at most four times the other.
ASYMMETRIES = np.array([-0.6, 0.6])
#: Values of it to begin a search at: from one stage to nearly two equal ones.
SECOND_STAGES = np.linspace(0.0, 0.249, 4)

#: Complex numbers of moving columns that are cached: the first of a search, those of its grid.
MEMO_NUMBERS = 5_000_000
#: Number of points whose rows in frequency are cached: stages of an estimate use few again and again.
KEPT_BINS = 4

#: Band of spectral rows [Hz].
BAND_HZ = (0.04, 5.0)
#: Grid of lags [s] and delays [s] that are searched.
LAG_GRID_S = np.geomspace(0.002, 0.3, 40)
DELAYS_S = (0.0, 0.010, 0.020, 0.030, 0.040, 0.060, 0.080, 0.120, 0.160, 0.200)
#: Accuracy of both [s].
TOLERANCE_S = 1e-5
#: Grid of delays [s] of a state that was measured.
TELEMETRY_DELAYS_S = np.linspace(-0.06, 0.06, 25)


def lag_and_delay(
    lags_s: Sequence[float] | Float[np.ndarray, " lags"] = LAG_GRID_S,
    delays_s: Sequence[float] | Float[np.ndarray, " delays"] = DELAYS_S,
    *,
    step_s: float = 0.0,
) -> tuple[Nuisance, Nuisance]:
    """Nuisances of actuators that lag [s] behind delayed commands; samples a step apart resolve no less."""
    lags, delays = (np.asarray(grid, dtype=np.float64) for grid in (lags_s, delays_s))
    lag = Nuisance(ACTUATOR_LAG, lags, resolution=step_s, tolerance=TOLERANCE_S)
    return lag, Nuisance(DELAY, delays, part_of=ACTUATOR_LAG.name, tolerance=TOLERANCE_S)


def with_order(nuisances: tuple[Nuisance, ...], order: int | None) -> tuple[Nuisance, ...]:
    """Nuisances of a response of order 1, without a lag, or 3, with a second stage; others as they are."""
    searched = any(n.name == ACTUATOR_LAG.name and n.searched for n in nuisances)
    if order == 1:
        return tuple(n.known_at(0.0) if n.name == ACTUATOR_LAG.name else n for n in nuisances)
    if order != 3 or not searched or SECOND_STAGE in [n.parameter for n in nuisances]:
        return nuisances
    return (*nuisances, Nuisance(SECOND_STAGE, SECOND_STAGES, tolerance=1e-4))


def actuators(values: Values) -> dict[str, float]:
    """Lag, delay, second stage and asymmetry of `actuator_state`; the stage by a second lag where known."""
    lag_s, second_s = values[ACTUATOR_LAG.name], values.get(SECOND_LAG, 0.0)
    share = min(second_s / lag_s, 0.49) if lag_s > 0.0 and second_s > 0.0 else 0.0
    stage = values.get(SECOND_STAGE.name, share * (1.0 - share))
    path = {"lag_s": lag_s, "delay_s": values[DELAY.name], "second_stage": stage}
    if ASYMMETRY.name in values:
        path["asymmetry"] = values[ASYMMETRY.name]
    return path


def measured_state() -> tuple[Nuisance, Nuisance]:
    """Nuisances of actuators whose state was measured: no lag, and a delay of either sign."""
    lag, delay = lag_and_delay()
    return lag.known_at(0.0), replace(delay, grid=TELEMETRY_DELAYS_S, tolerance=1e-9)


#: Covariances of the measurement noises of rows in time: of [Phi y], and of Psi with [Phi y].
RowNoise = tuple[Float[np.ndarray, "n_plus_1 n_plus_1"] | None, Float[np.ndarray, "p n_plus_1"]]


@dataclass(frozen=True)
class AxisColumns:
    """Columns of one axis of one flight on its whole grid of n samples, and the runs of it that count."""

    step_s: float  # Step of the grid [s]
    runs: tuple[slice, ...]  # Stretches to use
    responses: Float[np.ndarray, "n r"]  # One or two candidates, the one for rows in time first
    fixed: Float[np.ndarray, "n f"]  # Columns of the first f parameters
    #: From the nuisances' values to columns of the other parameters; with `moved` to those of some.
    moving: Callable[[Values], Float[np.ndarray, "n m"]]
    instruments: Float[np.ndarray, "n p"]  # Exogenous; as many in every flight of the axis, zero for none
    flight: int = 0
    axis: int = 0
    band_hz: tuple[float, float] = BAND_HZ  # Band of spectral rows [Hz]
    #: Samples that count; rows in time leave the others out, rows in frequency have no weight there.
    valid: Bool[np.ndarray, " n"] | None = None
    #: Which of the other parameters `moving` gives columns of, where the equation has but some. Default: all.
    moved: tuple[int, ...] | None = None
    #: Whether moving columns are linear in actuators that lag behind held commands, or in late samples.
    linear: bool = False

    def counted(self, run: slice) -> Bool[np.ndarray, " length"] | None:
        """Samples of a run that count; None for all."""
        return None if self.valid is None or self.valid[run].all() else self.valid[run]

    def cut(self, columns: np.ndarray) -> list[np.ndarray]:
        """Rows of each run that count."""
        counted = ((run, self.counted(run)) for run in self.runs)
        return [columns[run] if inside is None else columns[run][inside] for run, inside in counted]

    def all_columns(self, nuisances: Values, count: int) -> Float[np.ndarray, "n count"]:
        """Columns of all `count` parameters, with zeros for those that are not in the equation."""
        return np.column_stack([self.fixed, self.padded(self.moving(nuisances), count)])

    def padded(self, moving: np.ndarray, count: int) -> np.ndarray:
        """Rows of moving columns at their places, with zeros for those of `count` not in the equation."""
        if self.moved is None:
            return moving
        padded = np.zeros((len(moving), count - self.fixed.shape[1]), moving.dtype)
        padded[:, list(self.moved)] = moving
        return padded

    def spectral(self, run: slice) -> SpectralRun:
        """The run and its bins."""
        length, counted = run.stop - run.start, self.counted(run)
        return SpectralRun(self.flight, length, self.step_s, self.band_hz, self.axis, run.start, counted)


#: Share of columns that interpolation between lags may take.
INTERPOLATION_ERROR = 1e-9
#: A lag that leaves the held input as it is [s].
NO_LAG_S = 1e-9
#: Samples of all axes and runs whose columns take a few milliseconds.
COSTLY_SAMPLES = 50_000
#: Most lags and delays of them for each nuisance: more take longer than a search.
MOST_INTERPOLATED = 200
#: The shortest second lag that is distinguished from none, as a share of the shortest lag.
LEAST_SECOND_LAG = 0.05


@dataclass(frozen=True)
class LagsAndDelays(Interpolation):
    """Columns at Chebyshev's points of log lag and whole steps of delay, with held inputs exact between."""

    ends: tuple[float, float]  # Logarithms of the least and the longest lag [s]
    lags: int
    step_s: float
    delays: int

    @classmethod
    def of_grids(cls, lag: Nuisance, delay: Nuisance, step_s: float, *, staged: bool) -> LagsAndDelays:
        """For all values of two grids, and all stages of these lags."""
        shortest_s = lag.around(lag.first)[0] * (LEAST_SECOND_LAG if staged else 1.0)
        low, high = np.log(shortest_s), np.log(lag.around(float(lag.grid[-1]))[1])
        # 1/(1 + i w tau) has its poles pi/2 from the line of log tau
        ratio = np.pi / (high - low)
        count = np.ceil(-np.log(INTERPOLATION_ERROR) / np.log(ratio + np.hypot(ratio, 1.0)))
        return cls((low, high), int(count), step_s, int(np.ceil(delay.grid[-1] / step_s - 1e-9)) + 1)

    @cached_property
    def _nodes(self) -> Float[np.ndarray, " lags"]:
        return np.cos(np.pi * np.arange(self.lags) / (self.lags - 1))

    @cached_property
    def points(self) -> list[dict[str, float]]:  # type: ignore[override]
        """The input itself at every delay but the longest, and every lag at the longest."""
        (low, high), (*delays, longest) = self.ends, (self.step_s * np.arange(self.delays)).tolist()
        lags_s = np.exp(0.5 * (low + high) + 0.5 * (high - low) * self._nodes)
        pairs = [(NO_LAG_S, delay) for delay in delays] + [(lag, longest) for lag in lags_s.tolist()]
        stage = {SECOND_STAGE.name: 0.0}
        return [{ACTUATOR_LAG.name: lag, DELAY.name: delay, **stage} for lag, delay in pairs]

    def weights(self, values: ManyValues) -> Float[np.ndarray, "points nodes"]:
        lags, steps = values[ACTUATOR_LAG.name], values[DELAY.name] / self.step_s
        stages = values.get(SECOND_STAGE.name, np.zeros(1))
        if not stages.any():
            return self._lag_weights(lags, steps)
        apart = np.sqrt(1.0 - 4.0 * stages)
        longer, shorter = (
            part[:, None] * self._lag_weights(np.maximum(part * lags, np.exp(self.ends[0])), steps)
            for part in (0.5 + 0.5 * apart, 0.5 - 0.5 * apart)
        )
        return (longer - shorter) / apart[:, None]

    def _lag_weights(
        self, lags: Float[np.ndarray, " points"], steps: Float[np.ndarray, " points"]
    ) -> Float[np.ndarray, "points nodes"]:
        low, high = self.ends
        distances = ((2.0 * np.log(lags) - low - high) / (high - low))[:, None] - self._nodes
        ends = np.where(np.isin(np.arange(self.lags), (0, self.lags - 1)), 0.5, 1.0)
        at_lags = (-1.0) ** np.arange(self.lags) * ends / np.where(distances == 0.0, 1e-300, distances)
        at_lags /= at_lags.sum(axis=1, keepdims=True)
        whole_steps = np.minimum(np.floor(steps + 1e-9).astype(np.int64), self.delays - 2)
        decay = self.step_s / lags
        earlier = np.expm1((np.maximum(steps - whole_steps, 0.0) - 1.0) * decay) / np.expm1(-decay)
        # w(t - k) = exp(-h/tau) w(t - k - 1) + (1 - exp(-h/tau)) u(t - k - 1)
        since = np.arange(self.delays)[None] - whole_steps[:, None]
        gain = np.exp(-np.maximum(since, 0) * decay[:, None])
        later = np.exp(-np.maximum(since - 1, 0) * decay[:, None])
        gain = earlier[:, None] * gain * (since >= 0) + (1.0 - earlier)[:, None] * later * (since >= 1)
        return np.concatenate([-np.expm1(-decay)[:, None] * gain[:, :-1], gain[:, -1:] * at_lags], axis=1)


@dataclass(frozen=True)
class Shifts(Interpolation):
    """Columns at whole steps of a delay of either sign, and those of `shifted_by` between."""

    points: list[dict[str, float]]
    step_s: float
    none: int  # Place of no delay among them

    def weights(self, values: ManyValues) -> Float[np.ndarray, "points nodes"]:
        steps, weights = weights_between_samples(np.asarray(values[DELAY.name]) / self.step_s)
        count = len(self.points)
        results = np.zeros((steps.size, count + 4))
        places = np.clip(self.none + steps[:, None] + np.arange(2, -2, -1), -2, count + 1) + 2
        results[np.arange(steps.size)[:, None], places] = weights
        return results[:, 2:-2]


@dataclass(frozen=True)
class LaggedRuns(SeparableProblem):
    """Regressions of runs for each value of the nuisances."""

    columns: tuple[AxisColumns, ...]  # Of each flight and axis
    #: Those of the fixed columns first; every axis has a column for each, maybe of zeros.
    parameters: tuple[Parameter, ...]
    nuisances: tuple[Nuisance, ...]  # What moves columns
    #: Noises in rows in time. Default: unknown ones, and exact instruments.
    noise: Callable[[Values], RowNoise] | None = None
    #: The same flights with so much more of every noise that is known: the difference has their covariance.
    noisier: LaggedRuns | None = None
    warm_start: WarmStart | None = None  # What an estimate has its weights from
    #: Bins of the moving columns: every pass of a weighting visits the same grid again.
    _memo: dict[tuple[float, ...], list[np.ndarray]] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    #: Rows of the latest values.
    _latest: dict[tuple[float, ...], SpectralRegression] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        if not any(column.runs for column in self.columns):
            remedy = "See the reasons that `eivor inspect` gives."
            raise TooFewSamplesError("at least one usable run of flight", "none", remedy)
        runs = self._bin_layout.runs
        count, fewest = sum(run.count for run in runs), len(self.parameters) // 2 + 1  # two numbers each
        if count < fewest:
            low, high = min(run.band_hz[0] for run in runs), max(run.band_hz[1] for run in runs)
            longest = max(run.length * run.step_s for run in runs)
            expected = f"{fewest} frequencies or more between {low:.3g} and {high:.3g} Hz in the runs used"
            received = f"{count or 'none'}; the longest run lasts {longest:.3g} s"
            remedy = "Fly longer without a break, and log commands and sensors faster."
            raise TooFewSamplesError(expected, received, remedy)
        for axis_columns in self.columns:
            if axis_columns.responses.shape[1] not in (1, 2):
                expected = "one or two candidates for the response of an axis"
                remedy = "Give what was measured and, beside it, a derivative of what was measured."
                raise ShapeError(expected, f"{axis_columns.responses.shape[1]}", remedy)
        for axis in self.axes:
            widths = [column.instruments.shape[1] for column in self.columns if column.axis == axis]
            if len(set(widths)) != 1:
                expected = "the same instruments in every flight of a pool"
                remedy = "Pool flights that log the same references, or name the instruments."
                raise InstrumentError(expected, f"{widths} columns", remedy)

    @cached_property
    def axes(self) -> tuple[int, ...]:
        """Numbers of the axes, increasing."""
        return tuple(sorted({column.axis for column in self.columns}))

    @property
    def still(self) -> int:
        return self.columns[0].fixed.shape[1]

    @property
    def costly(self) -> bool:
        samples = sum(run.stop - run.start for _, run in self._cut())
        return self.interpolation is None and samples >= COSTLY_SAMPLES

    @cached_property
    def interpolation(self) -> LagsAndDelays | Shifts | None:
        """Lags and delays between which columns are taken, where these are searched for and it pays."""
        searched, steps = [item for item in self.nuisances if item.searched], {c.step_s for c in self.columns}
        names, step_s = [item.name for item in searched], min(steps)
        if not all(column.linear for column in self.columns) or len(steps) > 1:
            return None
        known = [ACTUATOR_LAG.name, DELAY.name, SECOND_STAGE.name][: len(self.nuisances)]
        if names == [DELAY.name] and searched[0].first < 0.0:
            low, high = np.floor(searched[0].grid[[0, -1]] / step_s).astype(np.int64).tolist()
            shifted = [self.first_values | {DELAY.name: k * step_s} for k in range(low - 2, high + 4)]
            result: LagsAndDelays | Shifts = Shifts(shifted, step_s, 2 - low)
        elif len(names) > 1 and names == known and searched[1].first >= 0.0:
            result = LagsAndDelays.of_grids(searched[0], searched[1], step_s, staged=len(names) > 2)
        else:
            return None
        count, moving = len(result.points), len(self.parameters) - self.still
        numbers = count * sum(run.count for run in self._bin_layout.runs) * moving
        return result if count <= MOST_INTERPOLATED * len(names) and numbers <= MEMO_NUMBERS else None

    def moving_columns(self, points: Sequence[Values]) -> Iterator[MovingColumns]:
        places = [self.still + np.array(self._positions(c), dtype=np.int64) for c, _ in self._cut()]
        runs = zip(places, self._bin_layout.runs, strict=True)
        bins = [np.empty((len(points), index.size, 2 * run.count)) for index, run in runs]
        for number, point in enumerate(points):
            for rows, block in zip(bins, self._moving_bins(point), strict=True):
                np.concatenate([block.real.T, block.imag.T], axis=1, out=rows[number])
        yield from zip(places, bins, strict=True)

    def with_nuisances(self, nuisances: tuple[Nuisance, ...], **changes: Any) -> Any:
        result = replace(self, nuisances=nuisances, **changes)
        names = ["_bin_layout", "_fixed_bins", "instrument_bins"]  # no spectrum is made twice
        if [item.name for item in nuisances] == [item.name for item in self.nuisances]:
            names += ["_memo", "_latest"]
        vars(result).update({name: vars(self)[name] for name in names if name in vars(self)})
        return result

    def with_instruments(self, instruments: Sequence[Float[np.ndarray, "n p"]]) -> LaggedRuns:
        """The same with other instruments of each flight and axis."""
        pairs = zip(self.columns, instruments, strict=True)
        result = replace(self, columns=tuple(replace(column, instruments=block) for column, block in pairs))
        vars(result).update(_bin_layout=self._bin_layout, _memo=self._memo, _fixed_bins=self._fixed_bins)
        return result

    def band_hz(self, axis: int) -> tuple[float, float]:
        return next(column.band_hz for column in self.columns if column.axis == axis)

    def spectra(self, columns: Sequence[Float[np.ndarray, "n k"]]) -> Complex[np.ndarray, "bins k_axes"]:
        """Bins of columns of each flight, in the rows of every axis by themselves."""
        blocks, axes = [], self.axes
        for (column, run), layout in zip(self._cut(), self._bin_layout.runs, strict=True):
            spectrum = layout.spectrum(columns[column.flight][run])
            zeros = np.zeros_like(spectrum)
            blocks.append(np.hstack([spectrum if axis == column.axis else zeros for axis in axes]))
        return np.concatenate(blocks)

    def _cut(self) -> Iterator[tuple[AxisColumns, slice]]:
        for column in self.columns:
            for run in column.runs:
                yield column, run

    def _moving(self, nuisances: Values) -> list[Float[np.ndarray, "_ k"]]:
        """Moving columns of every run, of the parameters that move in its equation."""
        results: list[np.ndarray] = []
        for column in self.columns:
            columns, positions = column.moving(nuisances), self._positions(column)
            if columns.shape[1] != len(positions):
                expected = f"a fixed or moving column for each of {len(self.parameters)} parameters"
                remedy = "Give columns of zeros for what is not in an axis' equation, or say what is."
                raise ShapeError(expected, f"{column.fixed.shape[1]} and {columns.shape[1]}", remedy)
            results.extend(columns[run] for run in column.runs)
        return results

    def _positions(self, axis_columns: AxisColumns) -> Sequence[int]:
        """Places of the columns that move in an axis' equation, among all that move."""
        every = range(len(self.parameters) - axis_columns.fixed.shape[1])
        return every if axis_columns.moved is None else axis_columns.moved

    def _padded(self, blocks: list[np.ndarray]) -> list[np.ndarray]:
        """Moving columns of every run at their places, with zeros for those not in its equation."""
        pairs = zip(self._cut(), blocks, strict=True)
        return [column.padded(block, len(self.parameters)) for (column, _), block in pairs]

    def _instruments(self) -> Iterator[Float[np.ndarray, "_ p"]]:
        """Instruments of every run: each axis has columns of its own. They are large, and used once."""
        widths = {column.axis: column.instruments.shape[1] for column in self.columns}
        first = dict(zip(self.axes, np.cumsum([0, *(widths[axis] for axis in self.axes)]), strict=False))
        for column, run in self._cut():
            trailing = sum(widths.values()) - first[column.axis] - widths[column.axis]
            columns, around = column.instruments[run], ((0, 0), (first[column.axis], trailing))
            yield np.pad(columns, around) if len(widths) > 1 else columns

    def _detrend(self, blocks: Iterable[Float[np.ndarray, "_ columns"]]) -> Float[np.ndarray, "rows columns"]:
        """Samples of all runs that count, without mean and line of their run, as rows in frequency are."""
        rows: list[np.ndarray] = []
        for (column, run), block in zip(self._cut(), blocks, strict=True):
            polynomials, counted = trend(run.stop - run.start, column.step_s), column.counted(run)
            mask = slice(None) if counted is None else counted
            values, (basis, _) = block[mask], np.linalg.qr(polynomials[mask])
            rows.append(values - basis @ (basis.T @ values))
        return np.concatenate(rows)

    @cached_property
    def _fixed_rows(self) -> tuple[Float[np.ndarray, "rows f_plus_1"], Float[np.ndarray, "rows p"]]:
        fixed = (np.column_stack([c.responses[run, 0], c.fixed[run]]) for c, run in self._cut())
        return self._detrend(fixed), self._detrend(self._instruments())

    @cached_property
    def _row_layout(self) -> RowLayout:
        parts = [
            np.stack([np.full(samples.size, column.flight), np.full(samples.size, column.axis), samples])
            for column in self.columns
            for samples in column.cut(np.arange(len(column.responses)))
        ]
        flights, axes, samples = np.concatenate(parts, axis=1)
        return SampleRows(flights) if len(self.axes) == 1 else AxisRows(flights, axes, samples)

    def rows(self, nuisance_values: Values) -> Regression:
        fixed, instruments = self._fixed_rows
        moving = self._detrend(self._padded(self._moving(nuisance_values)))
        regressors = np.column_stack([fixed[:, 1:], moving])
        exact = np.zeros((instruments.shape[1], len(self.parameters) + 1))
        noises: RowNoise = (None, exact) if self.noise is None else self.noise(nuisance_values)
        columns = (fixed[:, 0], regressors, instruments)
        regression = Regression(*columns, self.parameters, self._row_layout, *noises)
        if self.noisier is None:
            return regression
        surrogate = self.noisier.rows(nuisance_values)
        return replace(regression, regressor_noise=noise_of_surrogate(regression, surrogate))

    @cached_property
    def _bin_layout(self) -> BinRows:
        return BinRows(tuple(column.spectral(run) for column, run in self._cut()))

    @cached_property
    def _fixed_bins(self) -> tuple[Complex[np.ndarray, "bins r"], Complex[np.ndarray, "bins f"]]:
        """Candidate responses that all flights of an axis have, and fixed columns."""
        common = {
            axis: min(column.responses.shape[1] for column in self.columns if column.axis == axis)
            for axis in self.axes
        }
        count, blocks = max(common.values()), []
        for (column, run), layout in zip(self._cut(), self._bin_layout.runs, strict=True):
            responses = column.responses[run, -common[column.axis] :]
            repeated = [responses] * (count - responses.shape[1] + 1)
            blocks.append(layout.spectrum(np.column_stack([*repeated, column.fixed[run]])))
        spectra = np.concatenate(blocks)
        return spectra[:, :count], spectra[:, count:]

    @cached_property
    def instrument_bins(self) -> Complex[np.ndarray, "bins p"]:
        runs = zip(self._bin_layout.runs, self._instruments(), strict=True)
        return np.concatenate([run.spectrum(columns) for run, columns in runs])

    def _moving_bins(self, nuisance_values: Values) -> list[Complex[np.ndarray, "_ k"]]:
        """Bins of the moving columns of every run, of the parameters that move in its equation."""
        key = tuple(nuisance_values[nuisance.name] for nuisance in self.nuisances)
        result = self._memo.get(key)
        if result is None:
            interpolation = self.interpolation
            if isinstance(interpolation, Shifts) and nuisance_values not in interpolation.points:
                nodes = zip(*map(self._moving_bins, interpolation.points), strict=True)
                weights = interpolation.weights(values_of([nuisance_values]))[0]
                return [np.tensordot(weights, node_bins, 1) for node_bins in nodes]
            moving = zip(self._bin_layout.runs, self._moving(nuisance_values), strict=True)
            result = [run.spectrum(block) for run, block in moving]
            if (len(self._memo) + 1) * sum(block.size for block in result) <= MEMO_NUMBERS:
                self._memo[key] = result
        return result

    def bins(self, nuisance_values: Values) -> SpectralRegression:
        key = tuple(nuisance_values[nuisance.name] for nuisance in self.nuisances)
        if key in self._latest:
            return self._latest[key]
        (responses, fixed), instruments = self._fixed_bins, self.instrument_bins
        moving = np.concatenate(self._padded(self._moving_bins(nuisance_values)))
        more = None if self.noisier is None else partial(self.noisier.bins, nuisance_values)
        regressors = np.concatenate([fixed, moving], axis=1)
        parts = (responses, regressors, instruments, self.parameters, self._bin_layout, more)
        for earlier in list(self._latest)[: 1 - KEPT_BINS]:
            del self._latest[earlier]
        return self._latest.setdefault(key, SpectralRegression(*parts))

    def series_in_band(
        self, nuisance_values: Values, axis: int, theta: Float[np.ndarray, " n"], part: Sequence[int]
    ) -> Float[np.ndarray, "samples 3"]:
        """Response of an axis, its prediction, and the part of some parameters in it, within the band."""
        bins, index = self.bins(nuisance_values), list(part)
        columns = np.column_stack(
            [bins.responses[:, 0], bins.regressors @ theta, bins.regressors[:, index] @ theta[index]]
        )
        ends = np.cumsum([run.count for run in self._bin_layout.runs])
        results = []
        for run, end in zip(self._bin_layout.runs, ends.tolist(), strict=True):
            if run.axis == axis:
                series = run.series(columns[end - run.count : end])
                results.append(series if run.counted is None else series[run.counted])
        return np.concatenate(results)
