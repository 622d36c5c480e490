"""Spectral rows of a regression."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from eivor.models.regression import Parameter, Regression, RowLayout, noise_of_surrogate
from eivor.tools import Bool, Complex, Float, Int

PerBin = Float[np.ndarray, " bins"]

#: Share of a run that is tapered at each end, and the band's lowest frequency in cycles per run.
TAPER_SHARE = 0.05
LOWEST_CYCLES = 1.5
#: Most parts in which samples are transformed.
MOST_PARTS = 8
#: Length of the taper before and after samples that do not count [s].
TAPER_S = 0.1
#: Runs that last this long or longer lose a straight line in time besides their mean: thrust of one command
#: drifts while a battery empties and motors warm [s].
LINE_S = 15.0
#: Half-width of the smoothing window: a share of the frequency, and at least so many bins.
SMOOTHING_SHARE = 0.3
SMOOTHING_BINS = 10


@dataclass(frozen=True)
class SpectralRun:
    """One run of one axis, and its place among the bins."""

    flight: int
    length: int  # Samples in the run
    step_s: float  # Time between samples [s]
    band_hz: tuple[float, float]  # Lowest and highest frequency that may be kept [Hz]
    axis: int = 0
    start: int = 0
    counted: Bool[np.ndarray, " length"] | None = field(default=None, compare=False, repr=False)

    @cached_property
    def bins(self) -> slice:
        """Bins of the run's real FFT that are kept."""
        resolution = 1.0 / (self.length * self.step_s)
        first = int(np.ceil(max(self.band_hz[0], LOWEST_CYCLES * resolution) / resolution - 1e-9))
        last = int(np.floor(self.band_hz[1] / resolution + 1e-9))
        return slice(first, min(last + 1, (self.length + 1) // 2))

    @cached_property
    def count(self) -> int:
        return max(self.bins.stop - self.bins.start, 0)

    @cached_property
    def frequency_hz(self) -> PerBin:
        return np.arange(self.bins.start, self.bins.stop) / (self.length * self.step_s)

    @cached_property
    def taper(self) -> Float[np.ndarray, " length"]:
        """Cosine taper of both ends, and of both sides of samples that do not count."""
        window = self._end_taper
        if self.counted is not None:
            window = window * _taper(self.counted, max(round(TAPER_S / self.step_s), 1))
        return window

    @property
    def _end_taper(self) -> Float[np.ndarray, " length"]:
        edge = max(int(TAPER_SHARE * self.length), 1)
        window = np.ones(self.length)
        window[:edge] = 0.5 * (1.0 - np.cos(np.pi * (np.arange(edge) + 0.5) / edge))
        window[-edge:] = window[:edge][::-1]
        return window

    @cached_property
    def independent(self) -> float:
        """Bins whose errors are as many independent ones, as a share: gaps let neighbours go together."""
        if self.counted is None:
            return 1.0
        # a sum of products has the power of w^4 where bins by themselves have that of w^2
        shares = [np.mean(w**2) ** 2 / np.mean(w**4) for w in (self.taper, self._end_taper)]
        return float(shares[0] / shares[1])

    def spectrum(self, values: Float[np.ndarray, "length columns"]) -> Complex[np.ndarray, "bins columns"]:
        """Unitary real FFT of the tapered columns without mean and line, on the bins kept."""
        (basis, basis_spectrum), turns = self._trend, self._turns
        spectra = np.zeros((values.shape[1], self.count), dtype=np.complex128)
        for k, column in enumerate(values.T):  # small arrays: new memory takes long
            if column[self.length // 2] or column.any():  # an equation of one axis of several has zeros
                tapered = column * self.taper
                parts = np.fft.rfft(tapered.reshape(-1, turns.shape[1]), axis=0)[self.bins]
                np.einsum("kr,kr->k", parts, turns, out=spectra[k])
                spectra[k] -= (tapered @ basis) @ basis_spectrum
        spectra /= np.sqrt(self.length)
        return spectra.T

    @cached_property
    def _turns(self) -> Complex[np.ndarray, "bins d"]:
        """Phase factors that add up the bins of every d-th sample: short FFTs stay in a cache."""
        lengths = {d: self.length // d for d in range(1, MOST_PARTS + 1) if self.length % d == 0}
        parts = max(d for d, length in lengths.items() if self.bins.stop <= (length + 1) // 2)
        number = np.arange(self.bins.start, self.bins.stop)[:, None]
        return np.exp(-2j * np.pi / self.length * number * np.arange(parts))

    @cached_property
    def _trend(self) -> tuple[Float[np.ndarray, "length k"], Complex[np.ndarray, "k bins"]]:
        """Orthonormal basis of the tapered trend, and its FFT on the bins kept."""
        basis, _ = np.linalg.qr(trend(self.length, self.step_s) * self.taper[:, None])
        return basis, np.ascontiguousarray(np.fft.rfft(basis.T)[:, self.bins])

    def series(self, spectrum: Complex[np.ndarray, "bins columns"]) -> Float[np.ndarray, "length columns"]:
        """Time series whose unitary FFT is `spectrum` on the bins kept and zero elsewhere."""
        turns = self._turns
        parts = self.length // (2 * turns.shape[1]) + 1, turns.shape[1]
        full, series = np.zeros(parts, dtype=np.complex128), np.empty((spectrum.shape[1], self.length))
        for row, column in zip(series, spectrum.T, strict=True):
            np.multiply(column[:, None], turns.conj(), out=full[self.bins])
            row[:] = np.fft.irfft(full, n=self.length // parts[1], axis=0).ravel()
        series *= np.sqrt(self.length) / parts[1]
        return series.T

    def spread(self, rows: Float[np.ndarray, "counted columns"]) -> Float[np.ndarray, "length columns"]:
        """Rows of the samples that count at their places in the run, and zeros between them."""
        if self.counted is None:
            return rows
        padded = np.zeros((self.length, rows.shape[1]))
        padded[self.counted] = rows
        return padded

    def band_passed(self, rows: Float[np.ndarray, "counted columns"]) -> Float[np.ndarray, "counted columns"]:
        """The part of such rows within the band."""
        series = self.series(self.spectrum(self.spread(rows)))
        return series if self.counted is None else series[self.counted]

    @cached_property
    def _windows(self) -> tuple[Int[np.ndarray, " bins"], Int[np.ndarray, " bins"]]:
        index = np.arange(self.bins.start, self.bins.stop)
        half = np.maximum(SMOOTHING_BINS, (SMOOTHING_SHARE * index).astype(np.int64))
        position = np.arange(self.count)
        return np.maximum(position - half, 0), np.minimum(position + half + 1, self.count)

    @property
    def smoothed_over(self) -> PerBin:
        """Number of bins that `smoothed` averages over."""
        lower, upper = self._windows
        return (upper - lower).astype(np.float64)

    def smoothed(self, values: Float[np.ndarray, "bins columns"]) -> Float[np.ndarray, "bins columns"]:
        """Mean over the bins within +-30 % of each frequency, and at least +-10 bins."""
        lower, upper = self._windows
        total = np.zeros((self.count + 1, values.shape[1]))
        np.cumsum(values, axis=0, out=total[1:])
        return (total[upper] - total[lower]) / (upper - lower)[:, None]


def trend(length: int, step_s: float) -> Float[np.ndarray, "length k"]:
    """Trend that columns of a run lose: a constant, and from `LINE_S` on a line in time from -1 to 1."""
    line = np.linspace(-1.0, 1.0, length)
    return np.column_stack([np.ones(length), line] if length * step_s >= LINE_S else [np.ones(length)])


def _taper(counted: Bool[np.ndarray, " length"], edge: int) -> Float[np.ndarray, " length"]:
    """Zero where samples do not count, and a cosine of `edge` samples up to one beside them."""
    index = np.arange(counted.size)
    last = np.maximum.accumulate(np.where(counted, -edge - 1, index))
    following = np.where(counted, counted.size + edge, index)
    following = np.minimum.accumulate(following[::-1])[::-1]
    distance = np.minimum(np.minimum(index - last, following - index), edge)
    return np.asarray(0.5 * (1.0 - np.cos(np.pi * distance / edge)))


#: Factor of frequency within which bins are averaged for a density, and the fewest bins.
AVERAGED_OVER, LEAST_BINS = 1.6, 8


def densities(
    runs: Sequence[SpectralRun], power: PerBin, nodes_hz: Float[np.ndarray, " nodes"]
) -> Float[np.ndarray, " nodes"]:
    """One-sided densities near frequencies, of the power of every bin of some runs."""
    frequency = np.concatenate([run.frequency_hz for run in runs])
    scales = [np.full(run.count, 2.0 * run.step_s / float(np.mean(run.taper**2))) for run in runs]
    values, results = np.concatenate(scales) * power, []
    for node in nodes_hz:
        distances = np.abs(np.log(frequency / node))
        radius = max(np.log(AVERAGED_OVER) / 2.0, np.sort(distances)[min(LEAST_BINS, distances.size) - 1])
        results.append(values[distances <= radius].mean())
    return np.array(results)


@dataclass(frozen=True)
class BinRows(RowLayout):
    """Rows are, run after run, the real parts and then the imaginary parts of the bins kept."""

    runs: tuple[SpectralRun, ...]

    flight_of_row: Int[np.ndarray, " rows"] = field(init=False, repr=False, compare=False)
    axis_of_row: Int[np.ndarray, " rows"] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        counts = np.array([2 * run.count for run in self.runs], dtype=np.int64)
        object.__setattr__(self, "flight_of_row", np.repeat([run.flight for run in self.runs], counts))
        object.__setattr__(self, "axis_of_row", np.repeat([run.axis for run in self.runs], counts))

    @cached_property
    def independent(self) -> float:
        counts = [run.count for run in self.runs]
        return (
            float(np.average([run.independent for run in self.runs], weights=counts)) if sum(counts) else 1.0
        )

    @cached_property
    def ends(self) -> Int[np.ndarray, " _"]:
        """First bin of each run but the first."""
        return np.cumsum([run.count for run in self.runs])[:-1]

    def smoothed(self, values: Float[np.ndarray, "bins columns"]) -> Float[np.ndarray, "bins columns"]:
        """Means over neighbouring bins of each run."""
        blocks = np.split(values, self.ends)
        return np.concatenate([run.smoothed(block) for run, block in zip(self.runs, blocks, strict=True)])

    def stacked(self, columns: Complex[np.ndarray, "bins columns"]) -> Float[np.ndarray, "rows columns"]:
        """Real rows of complex columns."""
        return np.concatenate(
            [part for block in np.split(columns, self.ends) for part in (block.real, block.imag)]
        )

    def complex_blocks(
        self, rows: Float[np.ndarray, "rows columns"]
    ) -> Iterator[Complex[np.ndarray, "_ columns"]]:
        """Complex columns of each run; the inverse of `stacked`."""
        halves = (np.split(block, 2) for block in np.split(rows, 2 * self.ends))
        return (real + 1j * imaginary for real, imaginary in halves)

    def series(self, *columns: Float[np.ndarray, "rows _"]) -> Iterator[tuple[Any, ...]]:
        """Each run with time series of blocks of real rows: those of all six axes together are large."""
        for run, *blocks in zip(self.runs, *map(self.complex_blocks, columns), strict=True):
            yield run, *map(run.series, blocks)

    def scores(
        self, test: Float[np.ndarray, "rows n"], residual: Float[np.ndarray, " rows"]
    ) -> Float[np.ndarray, "samples n"]:
        """Half the products of the time series: by Parseval they add up to ``test.T @ residual``."""
        sums: dict[tuple[int, int, int], np.ndarray] = {}
        for run, tested, errors in self.series(test, residual[:, None]):
            time = (run.flight, run.start, run.length)
            scores = np.multiply(tested, 0.5 * errors, out=tested)
            sums[time] = sums[time] + scores if time in sums else scores
        parts = list(sums.values())
        return np.concatenate(parts) if len(parts) > 1 else parts[0]


@dataclass(frozen=True)
class SpectralRegression:
    """Columns of all runs, bin by bin, before whitening."""

    responses: Complex[np.ndarray, "bins r"]
    regressors: Complex[np.ndarray, "bins n"]
    instruments: Complex[np.ndarray, "bins p"]
    parameters: tuple[Parameter, ...]
    layout: BinRows = field(repr=False)
    #: Makes the same with more of every noise that is known.
    noisier: Callable[[], SpectralRegression] | None = field(default=None, repr=False)

    def whitened(self, blend: PerBin, power: PerBin, instruments: Float[np.ndarray, "rows q"]) -> Regression:
        """Rows with the responses blended and every column divided by sqrt(power)."""
        rows = self.whitened_rows(blend, power)
        regression = Regression(rows[:, 0], rows[:, 1:], instruments, self.parameters, self.layout)
        if self.noisier is None:
            return regression
        surrogate = self.noisier().whitened(blend, power, instruments)
        return replace(regression, regressor_noise=noise_of_surrogate(regression, surrogate))

    def whitened_rows(self, blend: PerBin, power: PerBin) -> Float[np.ndarray, "rows n_plus_1"]:
        """Real rows of [y Phi], the responses blended; see `whitened`."""
        response = (1.0 - blend) * self.responses[:, 0] + blend * self.responses[:, -1]
        weight = 1.0 / np.sqrt(power)
        return self.layout.stacked(np.column_stack([response, self.regressors]) * weight[:, None])

    def residuals(self, theta: Float[np.ndarray, " n"]) -> Complex[np.ndarray, "bins r"]:
        return self.responses - (self.regressors @ theta)[:, None]
