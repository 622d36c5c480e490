"""Frequency responses in closed loop, by local polynomials of spectra on an exogenous reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from importlib import import_module
from typing import Any, TypeAlias

import numpy as np
import scipy
from numpy.typing import ArrayLike

from eivor import checks
from eivor.errors import DataError, EstimationError, MissingReaderError, TooFewSamplesError
from eivor.signals.filters import fast_length
from eivor.signals.signals import stretches
from eivor.tools import Bool, Complex, Float, Int

Spectrum = Complex[np.ndarray, " f"]
PerFrequency = Float[np.ndarray, " f"]
Band = Float[np.ndarray, "f 2"]

#: Degree of the polynomials, half-width of the window as a share of its frequency, and its least in bins.
DEGREE, SHARE, LEAST_BINS = 2, 0.2, 15
#: The marginal bands are those of the joint region where its radius is above this share of the response.
JOINT_ABOVE = 0.5
#: Coherence of reference and output above which noise hides no bend of a response, and its column.
CLEAR, OUTPUT_COHERENCE = 0.9, 7
#: Fewest neighbours with a significant response of the input for a frequency to be shown, and the level.
NEIGHBOURS, SIGNIFICANT = 3, 0.01
APART = (1.0 + SHARE) / (1.0 - SHARE)
#: Frequencies of the default grid, its first in cycles of the longest run, its last as a share of the rate.
FREQUENCIES, FIRST_CYCLES, LAST_SHARE = 40, 15.0, 0.25
#: A line of a multisine has more than this share of the power of the strongest one.
LINE_SHARE = 1e-6
#: Least length of the longest run [s].
LEAST_S = 5.0
#: Runs shorter than this are left out [s].
SHORTEST_S = 1.0
#: Columns whose angle is smaller than this are the same; numbers below the other are none.
ALIKE, TINY = 1e-10, 1e-300

DIRECT = "No reference was given: this is the direct estimate, which is biased where the input answers."
NOT_REACHED = (
    "The reference reaches the input at no three neighbouring frequencies: nothing is shown. Fly a sweep."
)

ANSWERS = (
    "The reference answers the output, whose past explains {:.2g} % of what is new in it: the bands are "
    "provisional. Give what is set from outside."
)
#: Lags of the reference that predict it, lags of the output that are tested, and most rows of the test.
OWN_PAST, OUTPUT_PAST, MOST_ROWS = 60, 4, 20_000
NAMES = ("reference", "u", "y")
#: Least share of the innovation explained by the output, least innovation, and level of the test.
ANSWERED, NEW, BY_CHANCE = 1e-3, 1e-6, 1e-6

#: One array, or one for each run or flight.
Arrays: TypeAlias = ArrayLike | Sequence[ArrayLike]


def python_control(instead: str = "") -> Any:
    """The package `control`, which is an extra."""
    try:
        return import_module("control")
    except ImportError as error:
        expected = "python-control, which to_control makes its model with"
        remedy = f"Install it: pip install control.{instead}"
        raise MissingReaderError(expected, "a Python without it", remedy) from error


@dataclass(frozen=True)
class Points:
    """Responses to the reference at frequencies, with the covariance of their errors."""

    frequency_hz: PerFrequency
    output: Spectrum  # Of y to the reference
    input: Spectrum  # Of u to the reference
    #: Variances of both errors, and their covariance E[e_y conj e_u]
    output_variance: PerFrequency
    input_variance: PerFrequency
    covariance: Spectrum
    dof: PerFrequency  # Complex degrees of freedom of the variances
    coherence: PerFrequency  # Of reference and input, adjusted for the fit
    output_coherence: PerFrequency  # Of reference and output
    partial: PerFrequency  # Of input and output without the reference
    share: PerFrequency  # Variances over those of the noise: one over the reference's power

    @property
    def response(self) -> Spectrum:
        """Ratio of both; NaN where there is none."""
        known = np.isfinite(self.input) & (self.input != 0.0)
        return np.asarray(np.where(known, self.output, np.nan) / np.where(known, self.input, 1.0))

    def selected(self, mask: Bool[np.ndarray, " f"]) -> Points:
        return Points(*(getattr(self, item.name)[mask] for item in fields(self)))

    def with_known_input(self) -> Points:
        """Responses of the output to the input itself, which is without error."""
        none = np.zeros(self.dof.size)
        exact = {"input": none + 1.0 + 0.0j, "input_variance": none, "covariance": none + 0.0j}
        return replace(self, **exact, coherence=none + 1.0, partial=none)

    def smoothed(self, half_width: int) -> Points:
        """The same with noise smoothed over neighbours: logarithms by a line, correlations by a mean."""
        bias = scipy.special.digamma(self.dof) - np.log(self.dof)
        variances = (self.output_variance, self.input_variance)
        sizes = [np.log(np.maximum(item / self.share, TINY)) - bias for item in variances]
        correlation = self.covariance / np.sqrt(np.maximum(variances[0] * variances[1], TINY))
        x, f = np.log(self.frequency_hz), self.frequency_hz.size
        smooth, dof, common = np.empty((2, f)), np.empty(f), np.empty(f, dtype=np.complex128)
        for k in range(f):
            near = slice(max(k - half_width, 0), k + half_width + 1)
            x_near = x[near] - x[near].mean()
            power = max(float(x_near @ x_near), TINY)
            weight = 1.0 / x_near.size + x_near * (x[k] - x[near].mean()) / power
            smooth[:, k] = [weight @ size[near] for size in sizes]
            dof[k], common[k] = self.dof[near].sum(), correlation[near].mean()
        S_y, S_u = np.exp(smooth) * self.share
        S_u = np.where(self.input_variance > 0.0, S_u, 0.0)
        covariance = common * np.sqrt(S_y * S_u)
        return replace(self, output_variance=S_y, input_variance=S_u, covariance=covariance, dof=dof)

    def disc(self, critical: PerFrequency) -> tuple[Spectrum, PerFrequency]:
        """Centre and radius of the set {G: |a - G b|^2 <= c var(e_y - G e_u)}; NaN where it is unbounded."""
        a, b = self.output, self.input
        scale = np.abs(b) ** 2 - critical * self.input_variance
        scale = np.where(scale > 0.0, scale, np.inf)
        centre = (a * b.conj() - critical * self.covariance) / scale
        rest = (np.abs(a) ** 2 - critical * self.output_variance) / scale
        radius = np.sqrt(np.maximum(np.abs(centre) ** 2 - rest, 0.0))
        return np.where(np.isfinite(scale), centre, np.nan), np.where(np.isfinite(scale), radius, np.nan)

    def joint(self, level: float) -> tuple[Spectrum, PerFrequency]:
        """Disc that holds the complex response with a probability."""
        return self.disc(scipy.special.fdtri(2.0, 2.0 * self.dof, level))

    def bands(self, level: float) -> tuple[Band, Band]:
        """Bands of the magnitude and of the phase [rad], each with the probability."""
        widths = scipy.special.stdtrit(2.0 * self.dof, 0.5 + 0.5 * level)
        narrow, wide = self.disc(widths**2 / 2.0), self.joint(level)
        use_wide = ~(wide[1] <= JOINT_ABOVE * np.abs(wide[0]))
        return _magnitude_and_phase(*(np.where(use_wide, *pair) for pair in zip(wide, narrow, strict=True)))

    @property
    def significance(self) -> PerFrequency:
        """p-value of no response to the reference, of the input, or of the output to a known input."""
        known = self.input_variance == 0.0
        size = np.abs(np.where(known, self.output, self.input)) ** 2
        variance = np.maximum(np.where(known, self.output_variance, self.input_variance), TINY)
        values: PerFrequency = scipy.special.fdtrc(2.0, 2.0 * self.dof, size / variance)
        return np.where(np.isfinite(values), values, 1.0)


def _magnitude_and_phase(centre: Spectrum, radius: PerFrequency) -> tuple[Band, Band]:
    size = np.abs(centre)
    half = np.where(radius < size, np.arcsin(np.minimum(radius / size, 1.0)), np.nan)
    angle = np.angle(centre)
    magnitude = np.column_stack([np.maximum(size - radius, 0.0), size + radius])
    return magnitude, np.column_stack([angle - half, angle + half])


@dataclass(frozen=True)
class Spectra:
    """Spectra of one run without window: columns are reference, input and output."""

    length_s: float
    values: Complex[np.ndarray, "bins 3"]  # Of the whole real FFT, unitary

    def window(self, frequency_hz: float, half_hz: float) -> Int[np.ndarray, " k"]:
        """Bins within the half-width of a frequency, the mean left out."""
        middle = round(frequency_hz * self.length_s)
        half = round(half_hz * self.length_s)
        return np.arange(max(middle - half, 1), min(middle + half + 1, self.values.shape[0] - 1))


def local_polynomials(
    runs: Sequence[Spectra],
    frequency_hz: PerFrequency,
    *,
    driver: int = 0,
    share: float = SHARE,
    least_bins: int = LEAST_BINS,
    linear: float = 0.0,
) -> Points:
    """Responses to the driving column at frequencies: polynomials of frequency, and a transient each run.

    A window whose half-width is up to `linear` times its frequency has straight lines if noise hides bends.
    """
    longest = max(run.length_s for run in runs)
    rows = []
    for frequency in frequency_hz.tolist():
        centre = round(frequency * longest) / longest
        half = max(least_bins / longest, share * centre)
        row = _window(runs, driver, centre, half, 1 if half <= linear * centre else DEGREE)
        if half <= linear * centre and row[OUTPUT_COHERENCE] > CLEAR:
            row = _window(runs, driver, centre, half, DEGREE)
        rows.append(row)
    return _points(frequency_hz, rows)


def _window(runs: Sequence[Spectra], driver: int, centre: float, half: float, degree: int) -> tuple[Any, ...]:
    powers, blocks, outputs = np.arange(degree + 1), [], []
    for run in runs:
        bins = run.window(centre, half)
        if bins.size <= 2 * powers.size:
            continue
        x = ((bins / run.length_s - centre) / half)[:, None] ** powers
        blocks.append((run.values[bins, driver][:, None] * x, x))
        outputs.append(run.values[bins][:, [2, 1]])
    if not blocks:
        return _NOTHING
    driven = np.concatenate([block for block, _ in blocks])
    A = np.column_stack([driven, scipy.linalg.block_diag(*(free for _, free in blocks))])
    return _row(A, np.concatenate(outputs), A.shape[0] - A.shape[1])


_NOTHING = (complex(np.nan), complex(np.nan), np.nan, np.nan, complex(np.nan), 1.0, 0.0, 0.0, 0.0, 1.0)


def _row(A: np.ndarray, outputs: np.ndarray, dof: int) -> tuple[Any, ...]:
    """Row of `Points` of the first column of A: a regression of [y, u]."""
    scale = np.sqrt(np.mean(np.abs(A) ** 2, axis=0))
    if not scale.all() or dof < 1:
        return _NOTHING
    Q, R = np.linalg.qr(A / scale)
    diagonal = np.abs(np.diag(R))
    if diagonal.min() < ALIKE * diagonal.max():
        return _NOTHING
    first = scipy.linalg.solve_triangular(R, np.eye(R.shape[0], 1), trans="C")[:, 0].conj()
    projected = Q.conj().T @ outputs
    e = outputs - Q @ projected
    variance = float(np.sum(np.abs(first) ** 2)) / scale[0] ** 2
    return _numbers(first @ projected / scale[0], e.T @ e.conj() / dof, variance, scale[0] ** 2, dof)


def _numbers(
    responses: np.ndarray, S: np.ndarray, variance: float, power: float, dof: int
) -> tuple[Any, ...]:
    """Row of `Points` of responses of [y, u], their noise S, its share in them, and the reference's power."""
    noise = S.diagonal().real
    explained = power * np.maximum(np.abs(responses) ** 2 - variance * noise, 0.0)
    coherence = explained / np.maximum(explained + noise, TINY)
    partial = abs(S[0, 1]) ** 2 / max(noise.prod(), TINY)
    errors = (*(variance * noise), variance * S[0, 1], float(dof))
    return (*responses, *errors, coherence[1], coherence[0], partial, variance)


def _points(frequency_hz: PerFrequency, rows: Sequence[tuple[Any, ...]]) -> Points:
    columns = np.array(rows).reshape(-1, len(_NOTHING)).T
    is_complex = (0, 1, 4)
    return Points(
        frequency_hz, *(column if k in is_complex else column.real for k, column in enumerate(columns))
    )


def multisine_lines(runs: Sequence[Spectra], period_s: float, band_hz: tuple[float, float]) -> Points:
    """Responses at the lines of a reference of whole periods, noise and transient from their neighbours."""
    periods = round(runs[0].length_s / period_s)
    count = min(run.values.shape[0] for run in runs)
    lines = np.arange(periods, count - 1, periods)
    power = np.mean([np.abs(run.values[lines, 0]) ** 2 for run in runs], axis=0)
    excited = lines[power > LINE_SHARE * power.max()]
    frequency = excited / runs[0].length_s
    excited = excited[(frequency >= band_hz[0]) & (frequency <= band_hz[1])]
    rows = []
    for line in excited.tolist():
        half = max(LEAST_BINS, round(SHARE * line))
        bins = np.arange(max(line - half, 1), min(line + half + 1, count - 1))
        bins = bins[bins % periods != 0]
        x = ((bins - line) / half)[:, None] ** np.arange(DEGREE + 1)
        Q, R = np.linalg.qr(x)
        first = scipy.linalg.solve_triangular(R, np.eye(R.shape[0], 1), trans="T")[:, 0]
        S, response, weight = np.zeros((2, 2), dtype=np.complex128), np.zeros(2, dtype=np.complex128), 0.0
        for run in runs:
            outputs, r = run.values[bins][:, [2, 1]], run.values[line, 0]
            residual = outputs - Q @ (Q.T @ outputs)
            S += residual.T @ residual.conj()
            response += (run.values[line, [2, 1]] - first @ (Q.T @ outputs)) * r.conj()
            weight += abs(r) ** 2
        dof = len(runs) * (bins.size - DEGREE - 1)
        share = (1.0 + float(first @ first)) / weight
        rows.append(_numbers(response / weight, S / dof, share, weight / len(runs), dof))
    return _points(excited / runs[0].length_s, rows)


@dataclass(frozen=True)
class FrequencyResponse:
    """Response from input to output at frequencies, with bands, coherences and the direct estimate."""

    points: Points  # Responses of output and input to the reference; their ratio is the response
    direct: Spectrum  # Regression of output on input, which is biased in closed loop
    direct_coherence: PerFrequency  # Coherence of input and output [-]
    level: float  # Probability of the bands
    rate_hz: float
    #: No reference was given: `points` are the direct estimate, and its bands hold in open loop only
    is_direct: bool = False
    findings: tuple[str, ...] = ()  # What speaks against the response, in sentences
    runs: tuple[Spectra, ...] = field(default=(), repr=False)
    is_periodic: bool = False  # At the lines of a reference that repeats
    is_answered: bool = False  # The reference answers the output: bands hold no more than those of `direct`

    @property
    def is_provisional(self) -> bool:
        """Whether the bands hold in open loop only: without a reference, or with one that answers."""
        return self.is_direct or self.is_answered

    @property
    def frequency_hz(self) -> PerFrequency:
        return self.points.frequency_hz

    @property
    def response(self) -> Spectrum:
        return self.points.response

    @cached_property
    def bands(self) -> tuple[Band, Band]:
        """Lowest and highest magnitude, and phase [rad], at each frequency by itself; NaN is unbounded."""
        return self.points.bands(self.level)

    @cached_property
    def simultaneous_bands(self) -> tuple[Band, Band]:
        """The same for all frequencies together (Sidak)."""
        level = self.level ** (1.0 / max(self.frequency_hz.size, 1))
        return _magnitude_and_phase(*self.points.joint(level))

    @cached_property
    def is_shown(self) -> Bool[np.ndarray, " f"]:
        """Where three neighbours or more answer the reference, windows apart, in a band without zero."""
        significant, f = self.points.significance < SIGNIFICANT, self.frequency_hz
        accepted = np.zeros_like(significant)
        for part in stretches(significant):
            apart = self.is_periodic or f[part.stop - 1] >= APART * f[part.start]
            accepted[part] = apart and part.stop - part.start >= NEIGHBOURS
        return accepted & (self.bands[0][:, 0] > 0.0) & np.isfinite(self.bands[0][:, 1])

    @property
    def shown_ranges(self) -> tuple[tuple[float, float], ...]:
        """First and last frequency of each stretch that is shown [Hz]."""
        f = self.frequency_hz
        return tuple((float(f[part.start]), float(f[part.stop - 1])) for part in stretches(self.is_shown))

    def columns(self) -> dict[str, PerFrequency]:
        """Every column of the table by name; bands are NaN where they are unbounded."""
        (low, high), (early, late) = (band.T for band in self.bands)
        (all_low, all_high), (all_early, all_late) = (band.T for band in self.simultaneous_bands)
        return {
            "frequency_hz": self.frequency_hz,
            "magnitude": np.abs(self.response),
            "magnitude_low": low,
            "magnitude_high": high,
            "phase_deg": np.rad2deg(np.angle(self.response)),
            "phase_low_deg": np.rad2deg(early),
            "phase_high_deg": np.rad2deg(late),
            "simultaneous_magnitude_low": all_low,
            "simultaneous_magnitude_high": all_high,
            "simultaneous_phase_low_deg": np.rad2deg(all_early),
            "simultaneous_phase_high_deg": np.rad2deg(all_late),
            "coherence_reference_input": self.points.coherence,
            "coherence_input_output": self.direct_coherence,
            "coherence_partial": self.points.partial,
            "direct_magnitude": np.abs(self.direct),
            "direct_phase_deg": np.rad2deg(np.angle(self.direct)),
            "shown": self.is_shown.astype(np.float64),
        }

    def to_frame(self) -> Any:
        """Polars frame with a row for each frequency; see `columns`."""
        import polars

        return polars.DataFrame(self.columns()).with_columns(polars.col("shown") > 0.5)

    def to_control(self) -> Any:
        """FRD of python-control, of the frequencies that are shown; an `EstimationError` where none is."""
        mask = self.is_shown
        if not mask.any():
            raise EstimationError("a response that is shown somewhere", "none", "Fly a sweep.")
        return python_control().FRD(self.response[mask], 2.0 * np.pi * self.frequency_hz[mask])

    def summary(self) -> str:
        """Table of the frequencies that are shown, and the findings."""
        lines = [f"{'f [Hz]':>8} {'|G|':>10} {'low':>10} {'high':>10} {'phase':>8} {'+-':>6} {'r,u':>5}"]
        for index in np.flatnonzero(self.is_shown).tolist():
            low, high = self.bands[0][index]
            early, late = np.rad2deg(self.bands[1][index])
            value, angle = abs(self.response[index]), np.rad2deg(np.angle(self.response[index]))
            lines.append(
                f"{self.frequency_hz[index]:8.3f} {value:10.4g} {low:10.4g} {high:10.4g} "
                f"{angle:8.1f} {(late - early) / 2:6.1f} {self.points.coherence[index]:5.2f}"
            )
        return "\n".join([*lines, *self.findings])


def frequency_response(
    u: Arrays,
    y: Arrays,
    *,
    reference: Arrays | None,
    rate_hz: float,
    frequency_hz: ArrayLike | None = None,
    period_s: float | None = None,
    level: float = 0.9,
) -> FrequencyResponse:
    """Frequency response from u to y in closed or open loop, with bands that hold in both.

    Parameters
    ----------
    u, y : array_like, shape (n,), or sequence of them
        Input and output, samples at an even rate; NaN ends a run. Several arrays are runs or flights.
    reference : array_like, shape (n,), or sequence of them, or None
        What moves the input and does not answer the output: an injected sweep, a setpoint from outside.
        None gives the direct estimate, which is biased where the input answers the output.
    rate_hz : float
        Samples per second [Hz].
    frequency_hz : array_like, shape (f,), optional
        Frequencies [Hz]; default: 40 from 15 cycles of the longest run to a quarter of the rate.
    period_s : float, optional
        Period of a reference that repeats, a whole number of samples: the response is at its lines.
    level : float
        Probability of the bands.

    Returns
    -------
    FrequencyResponse
        With a value at every frequency; `shown` says where the reference reaches.

    Raises
    ------
    DataError
        For arrays of different lengths, and a constant input, output or reference.
    TooFewSamplesError
        When no run lasts 5 s, or a periodic reference has fewer than two periods in each.
    ParameterError
        For a rate, level, period or frequencies that cannot be.

    Notes
    -----
    Spectra of u and y are a quadratic in frequency times that of the reference, plus a quadratic transient.
    This holds within +-20 % of a frequency, at least +-15 bins (Pintelon and Schoukens 2012, chapter 7). The
    ratio's region is that of Fieller and of Anderson and Rubin; it is unbounded where the input does not
    answer the reference.
    """
    checks.number("rate_hz", rate_hz)
    checks.positive("rate_hz", rate_hz)
    checks.level(level)
    parts = _stretches(u if reference is None else reference, u, y)
    runs = _runs(parts, float(rate_hz), period_s)
    grid = _frequencies(frequency_hz, max(run.length_s for run in runs), float(rate_hz))
    if period_s is None:
        points = local_polynomials(runs, grid)
    else:
        ends = (0.0, rate_hz / 2.0) if frequency_hz is None else (float(grid[0]), float(grid[-1]))
        points = multisine_lines(runs, period_s, ends)
    direct = local_polynomials(runs, points.frequency_hz, driver=1)
    answered = 0.0 if reference is None else answered_share(parts)
    findings = (DIRECT,) if reference is None else ()
    if answered > 0.0:
        findings = (ANSWERS.format(100.0 * answered),)
    result = FrequencyResponse(
        direct.with_known_input() if reference is None else points,
        direct.response,
        direct.output_coherence,
        float(level),
        float(rate_hz),
        reference is None,
        findings,
        runs,
        period_s is not None,
        answered > 0.0,
    )
    return result if result.is_shown.any() else replace(result, findings=(*findings, NOT_REACHED))


def _frequencies(frequency_hz: ArrayLike | None, longest_s: float, rate_hz: float) -> PerFrequency:
    if frequency_hz is None:
        low = FIRST_CYCLES / longest_s
        return np.geomspace(low, max(LAST_SHARE * rate_hz, 2.0 * low), FREQUENCIES)
    if np.ndim(frequency_hz) == 0:
        checks.number("frequency_hz", frequency_hz)
    grid = np.atleast_1d(checks.real_array("frequency_hz", frequency_hz))
    sound = grid.ndim == 1 and grid.size > 0 and bool(np.isfinite(grid).all())
    sound = sound and bool((np.diff(grid, prepend=0.0) > 0.0).all() and grid[-1] < rate_hz / 2.0)
    received = f"{grid.size} from {grid.min():.3g} to {grid.max():.3g} Hz" if grid.size else "none"
    checks.require(sound, f"increasing frequencies between 0 and {rate_hz / 2.0:g} Hz", received)
    return grid


def _arrays(name: str, values: Arrays) -> list[Float[np.ndarray, " n"]]:
    is_sequence = isinstance(values, list | tuple) and bool(values) and np.ndim(values[0]) > 0
    arrays = [checks.real_array(name, value) for value in (values if is_sequence else [values])]  # type: ignore[union-attr]
    for array in arrays:
        if array.ndim != 1:
            raise DataError(f"one column in {name}", f"the shape {array.shape}", "Give it as one array.")
    return arrays


def _stretches(reference: Arrays, u: Arrays, y: Arrays) -> list[Float[np.ndarray, "n 3"]]:
    """Reference, input and output of every stretch of samples that are finite in all three."""
    columns = [_arrays(name, column) for name, column in zip(NAMES, (reference, u, y), strict=True)]
    lengths = [[array.size for array in arrays] for arrays in columns]
    if lengths[0] != lengths[1] or lengths[0] != lengths[2]:
        received = ", ".join(f"{name} {sizes}" for name, sizes in zip(NAMES, lengths, strict=True))
        raise DataError("arrays of the same lengths", received, "Cut them to the same samples.")
    runs = []
    for arrays in zip(*columns, strict=True):
        values = np.column_stack(arrays)
        runs += [values[part] for part in stretches(np.isfinite(values).all(axis=1))]
    return runs


def answered_share(parts: Sequence[Float[np.ndarray, "n 3"]]) -> float:
    """Share of a reference's innovation that the output's past explains; zero where that may be chance."""
    rows: list[np.ndarray] = []
    for part in parts:
        count = min(len(part), MOST_ROWS - sum(len(row) for row in rows)) - OWN_PAST
        if count > 0:
            r, y = part[: count + OWN_PAST, [0, 2]].T
            past = np.lib.stride_tricks.sliding_window_view(r - r.mean(), OWN_PAST + 1)
            late = np.lib.stride_tricks.sliding_window_view(y - y.mean(), OUTPUT_PAST)
            rows.append(np.column_stack([past[:, :-1], late[OWN_PAST - OUTPUT_PAST : -1], past[:, -1:]]))
    if not rows:
        return 0.0
    table = np.concatenate(rows)
    moments = (table.T @ table) / len(table)

    def residual_power(count: int) -> float:
        solved = np.linalg.lstsq(moments[:count, :count], moments[:count, -1], rcond=1e-13)[0]
        return float(moments[-1, -1] - moments[:count, -1] @ solved)

    new, rest = residual_power(OWN_PAST), residual_power(OWN_PAST + OUTPUT_PAST)
    degrees = len(table) - OWN_PAST - OUTPUT_PAST - 1
    if degrees < 1 or not new > NEW * moments[-1, -1]:
        return 0.0
    ratio = (new - rest) / OUTPUT_PAST / max(rest, TINY) * degrees
    by_chance = float(scipy.special.fdtrc(OUTPUT_PAST, degrees, max(ratio, 0.0))) > BY_CHANCE
    share = 1.0 - rest / new
    return 0.0 if by_chance or share < ANSWERED else share


def _runs(
    runs: Sequence[Float[np.ndarray, "n 3"]], rate_hz: float, period_s: float | None
) -> tuple[Spectra, ...]:
    longest = max((len(values) for values in runs), default=0) / rate_hz
    if longest < LEAST_S:
        expected = f"a run of {LEAST_S:g} s or more without NaN"
        raise TooFewSamplesError(expected, f"{longest:.3g} s at most", "Use a longer record.")
    for name, column in zip(NAMES, np.concatenate(runs).T, strict=True):
        if np.ptp(column) == 0.0:
            raise DataError(f"a {name} that changes", f"{column[0]:g} throughout", "Use a record that moves.")
    if period_s is None:
        runs = [values for values in runs if len(values) >= SHORTEST_S * rate_hz]
        runs_used = [values[: fast_length(len(values))] for values in runs]
    else:
        runs_used = _whole_periods(runs, rate_hz, period_s)
    return spectra(runs_used, 1.0 / rate_hz)


def spectra(runs: Sequence[Float[np.ndarray, "n 3"]], step_s: float) -> tuple[Spectra, ...]:
    """Spectra of reference, input and output of each run."""
    ffts = (np.fft.rfft(values - values.mean(axis=0), axis=0) / np.sqrt(len(values)) for values in runs)
    return tuple(Spectra(len(values) * step_s, spectrum) for values, spectrum in zip(runs, ffts, strict=True))


def _whole_periods(
    runs: Sequence[Float[np.ndarray, "n 3"]], rate_hz: float, period_s: float
) -> list[Float[np.ndarray, "m 3"]]:
    """The last samples of each run, as many whole periods of each."""
    checks.number("period_s", period_s)
    checks.positive("period_s", period_s)
    samples = round(period_s * rate_hz)
    integral = samples > 1 and abs(samples - period_s * rate_hz) < 1e-6 * samples
    checks.require(integral, "a period of a whole number of samples", f"{period_s * rate_hz:g} of them")
    runs = [values for values in runs if len(values) >= 2 * samples]
    if not runs:
        expected = f"a run of two periods ({2 * period_s:g} s) or more"
        raise TooFewSamplesError(expected, "shorter ones", "Use a longer record, or leave period_s out.")
    periods = min(len(values) for values in runs) // samples
    return [values[-periods * samples :] for values in runs]
