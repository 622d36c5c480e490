"""Figures of a flight's result: the same plots in files and on pages."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, cycle

import numpy as np

from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.flights.quantity import PlotData, Trace
from eivor.flights.result import Fit, FlightEstimate
from eivor.inference.distributions import chi_square_quantile
from eivor.inference.verdict import Status
from eivor.models.spectral import BinRows, SpectralRun
from eivor.report import figure_panels as plots
from eivor.report.document import NO_NUMBER, QuantityRow, axis_of, number_table, plain_numbers, shortened
from eivor.report.figure_panels import Axes, Figure
from eivor.tools import Float, capitalised, printable

#: Lags of the autocorrelation: so many samples at twice the band's highest frequency.
AUTOCORRELATION_LAGS = 30
#: Length of the segments that spectra are averaged over [s].
SEGMENT_S = 10.0
#: Amplitudes below this share of the largest are not drawn: outside of the band there may be none at all.
LEAST_AMPLITUDE = 1e-6


@dataclass(frozen=True)
class FlightRun:
    """One run of the time rows."""

    flight: int  # Number of its flight among all that were prepared
    name: str  # Its log
    time_s: Float[np.ndarray, " length"]  # On the log's clock
    rows: slice  # Its rows among all
    spectral: SpectralRun


def flight_runs(result: FlightEstimate) -> list[FlightRun]:
    """Every run, in the order of the samples of a trace."""
    results: list[FlightRun] = []
    first = 0
    flying = [(index, flight) for index, flight in enumerate(result.prepared) if flight.runs]
    for number, (flight_index, flight) in enumerate(flying):
        seconds, name = flight.grid.time_s, printable(flight.recording.name)
        for samples, spectral in zip(flight.samples_of_runs, flight.spectral_runs(number), strict=True):
            rows = slice(first, first + samples.size)
            results.append(FlightRun(flight_index, name, seconds[samples], rows, spectral))
            first = rows.stop
    return results


def band_of(trace: Trace, run: FlightRun) -> tuple[float, float]:
    """Band that a trace is shown in [Hz]."""
    frequency, (low, high) = run.spectral.frequency_hz, run.spectral.band_hz
    return trace.band_hz or (float(frequency[0]) if frequency.size else low, high)


def within_band(trace: Trace, run: FlightRun) -> Float[np.ndarray, "length 2"]:
    """Measured and predicted over a run, both within the band."""
    return run.spectral.band_passed(np.column_stack([trace.measured, trace.predicted])[run.rows])


def spectrum(
    values: Float[np.ndarray, " rows"], runs: list[FlightRun]
) -> tuple[Float[np.ndarray, " bins"], Float[np.ndarray, " bins"]]:
    """Amplitude density, averaged over half-overlapping Hann segments of every run at one rate."""
    step = min(run.spectral.step_s for run in runs)
    runs_kept = [run for run in runs if run.spectral.step_s == step]
    longest = max(run.time_s.size for run in runs_kept)
    length = min(int(SEGMENT_S / step), longest)
    window = np.hanning(length + 1)[:length] if length > 1 else np.ones(length)
    total, count = np.zeros(length // 2 + 1), 0
    for run in runs_kept:
        series = values[run.rows]
        for first in range(0, series.size - length + 1, max(length // 2, 1)):
            segment = series[first : first + length]
            total += np.abs(np.fft.rfft((segment - segment.mean()) * window)) ** 2
            count += 1
    density = 2.0 * step * total / (max(count, 1) * float(window @ window))
    frequency = np.fft.rfftfreq(length, step)
    return frequency[1:], np.sqrt(np.maximum(density[1:], 1e-20))


def _draw_fit(axes: Axes, trace: Trace, runs: list[FlightRun], *, residual: bool) -> None:
    """Draw measured and predicted signals of one axis within the band, or the residual."""
    run = max(runs, key=lambda candidate: candidate.time_s.size)
    window = plots.liveliest(trace.measured[run.rows], int(plots.FIT_SHOWN_S / run.spectral.step_s))
    time, (measured, predicted) = run.time_s[window], within_band(trace, run)[window].T
    if residual:
        axes.plot(time, measured - predicted, color=plots.GREY, lw=0.9)
        axes.axhline(0.0, color="black", lw=0.5)
        axes.set_ylabel(f"residual\n[{trace.unit}]", parse_math=False)
    else:
        axes.plot(time, measured, color=plots.DARK, lw=0.9, label="measured")
        axes.plot(time, predicted, color=plots.RED, lw=1.1, label=f"predicted: {trace.model}")
        axes.set_ylabel(f"{trace.axis}\n[{trace.unit}]", parse_math=False)
        part = "the whole run" if len(runs) == 1 else f"the longest of {len(runs)} runs"
        if time.size < run.time_s.size:
            part = f"the liveliest {time[-1] - time[0]:.0f} s of {part.replace('the whole', 'the')}"
        low, high = band_of(trace, run)
        band = f"both band-passed {low:.2f} to {high:.0f} Hz"
        plots.headed(axes, f"Measured and predicted, {band}: {part}, {shortened(run.name)}")
        plots.legend(axes)
    plots.labelled(axes, x="time from the log's start [s]")
    axes.margins(x=0.005)


#: Rows of a table beside a spectrum, and bands of its drawing on a page, in each decade.
ROWS_PER_DECADE, BANDS_PER_DECADE = 8, 90
#: The profile is drawn up to so many times the height that bounds a delay, or higher; linear up to
#: that height and logarithmic above it.
PROFILE_HEIGHT = 5.0
#: A grid of positive values whose ends have this ratio or a larger one has a logarithmic axis.
WIDE_RATIO = 10.0


def fit_pictures(result: FlightEstimate, fit: Fit) -> Iterator[plots.Picture]:
    """Pictures of an estimate that are not over time."""
    runs = flight_runs(result)
    yield _autocorrelation_picture(fit.estimate, runs)
    for number in range(len(fit.estimate.profiles)):
        yield _profile_picture(result, fit.estimate, number)
    for trace in fit.traces(result.motion):
        if trace.driven.any():
            yield _excitation_picture((trace,), runs, f"What excites the {trace.axis}", BANDS_PER_DECADE)
    yield from _set_pictures(result, fit)
    yield from _ellipse_pictures(result, fit.estimate)


def _autocorrelation_picture(estimate: Estimate, runs: list[FlightRun]) -> plots.Picture:
    """Autocorrelation of the residual that inference works on, sampled at twice the band's top."""
    layout, residuals = estimate.rows.layout, estimate.residuals
    if isinstance(layout, BinRows):
        blocks = [block[:, 0] for block in layout.complex_blocks(residuals[:, None])]
        spectral, kind = list(layout.runs), "whitened residual"
    else:
        spectral, kind = [run.spectral for run in runs], "residual, band-passed"
        blocks = [
            run.spectral.spectrum(run.spectral.spread(residuals[run.rows][:, None]))[:, 0]
            for run in runs
            if run.rows.stop <= residuals.size
        ]
    step = 1.0 / (2.0 * max(run.band_hz[1] for run in spectral))
    shift = step * np.arange(1, AUTOCORRELATION_LAGS + 1)
    power = np.concatenate([np.abs(block) ** 2 for block in blocks])
    frequency = np.concatenate([run.frequency_hz for run, _ in zip(spectral, blocks, strict=False)])
    correlation = np.cos(2.0 * np.pi * np.outer(shift, frequency)) @ power / (float(power.sum()) or 1.0)
    band = 1.96 / np.sqrt(max(2.0 * power.size, 1.0))

    def draw(axes: Axes) -> None:
        axes.axhspan(-band, band, color=plots.BLUE, alpha=0.18, lw=0, label="95 % band of white noise")
        axes.vlines(shift, 0.0, correlation, color=plots.GREY, lw=1.6)
        axes.plot(shift, correlation, "o", color=plots.GREY, ms=3)
        axes.axhline(0.0, color="black", lw=0.5)
        plots.labelled(axes, x="shift [s]", y="correlation")
        limit = max(0.3, 1.15 * float(np.max(np.abs(correlation), initial=0.0)))
        axes.set_ylim(-limit, limit)
        plots.legend(axes, location="upper right")

    return plots.Picture(
        f"Autocorrelation of the {kind}",
        "Of a residual that holds nothing more, one stem in twenty leaves the band.",
        draw,
        number_table(("shift [s]", "correlation"), zip(shift.tolist(), correlation.tolist(), strict=True)),
    )


def _profile_picture(result: FlightEstimate, estimate: Estimate, number: int) -> plots.Picture:
    """The objective against one nuisance, at the best of the others, as chi-square."""
    profile, minimum = estimate.profiles[number], estimate.solution.objective
    nuisance = profile.nuisance
    row = _row_of(result, nuisance.name)
    wording, scale, quantile = row.wording, row.wording.scale, chi_square_quantile(0.95)
    # J of a method with instruments; for a direct one the logarithm's slope at its minimum
    height = estimate.criterion if estimate.rank else estimate.rows.response.size
    # the minimum lies between points of the grid: without it a sharp valley has no bottom
    points = np.append(nuisance.grid, estimate.nuisances[nuisance.name])
    above = (height / minimum if minimum > 0.0 and height > 0.0 else 1.0) * (
        np.append(profile.objective, minimum) - minimum
    )
    order = np.argsort(points)
    values, excess = scale * points[order], above[order]

    def draw(axes: Axes) -> None:
        axes.plot(values, excess, "-o", ms=2, lw=1.1, label="objective")
        _set_abscissa(axes, nuisance.grid * scale)
        first, last = axes.get_xlim()  # an interval may have no end, and a logarithm has no zero
        low, high = (float(np.clip(end, first, last)) for end in row.interval)
        axes.axvspan(low, high, color=plots.BLUE, alpha=0.18, lw=0, label="95 % interval")
        axes.axvline(row.value, color=plots.BLUE, lw=0.7)
        axes.axhline(quantile, color="black", lw=0.7, ls="--", label="95 % by curves")
        axes.set_yscale("symlog", linthresh=quantile)
        tallest = max(PROFILE_HEIGHT * quantile, float(excess.max()))
        axes.set_ylim(-0.15 * quantile, 60.0 * tallest)  # room for the legend above the curves
        plots.labelled(axes, x=axis_of(wording), y="objective above its least (χ² units)")
        plots.legend(axes, size=7, location="upper left", columns=2)

    rows = [("objective", *pair) for pair in zip(values.tolist(), excess.tolist(), strict=True)]
    return plots.Picture(
        f"How well each {wording.words} fits",
        "Values whose curve stays below the dashed line fit the flight; equal steps below it, powers of "
        "ten above.",
        draw,
        number_table(("curve", axis_of(wording), "above the least"), rows),
    )


def _set_abscissa(axes: Axes, grid: Float[np.ndarray, " values"]) -> None:
    """Range of the grid: logarithmic, with round numbers, where it spans a decade."""
    from matplotlib.ticker import LogLocator

    low, high = float(grid[0]), float(grid[-1])
    if low <= 0.0 or high < WIDE_RATIO * low:
        margin = 0.03 * (high - low)
        axes.set_xlim(low - margin, high + margin)
        return
    axes.set_xscale("log")
    axes.set_xlim(0.9 * low, 1.1 * high)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()


def _excitation_picture(
    traces: tuple[Trace, ...], runs: list[FlightRun], title: str, per_decade: int | None = None
) -> plots.Picture:
    """Amplitude spectra of the input's effect on each axis and of the residual, by bins or bands."""
    traces = tuple(trace for trace in traces if trace.unit == traces[0].unit and trace.driven.any())
    lines = []
    for trace, style in zip(traces, cycle(("-", "--", ":")), strict=False):
        of_axis = f" ({trace.axis})" if len(traces) > 1 else ""
        for values, colour, label in (
            (trace.driven, plots.RED, f"input: {trace.drive}{of_axis}"),
            (trace.measured - trace.predicted, plots.GREY, f"residual{of_axis}"),
        ):
            frequency, amplitude = spectrum(values, runs)
            if per_decade is not None:
                frequency, amplitude = plots.banded(frequency, amplitude, per_decade)
            lines.append((label, colour, style, frequency, amplitude))

    def draw(axes: Axes) -> None:
        for label, colour, style, frequency, amplitude in lines:
            axes.loglog(frequency, amplitude, color=colour, lw=1.2, ls=style, label=label)
        low, high = axes.get_ylim()
        axes.set_ylim(bottom=max(low, LEAST_AMPLITUDE * high))
        low, high = runs[0].spectral.band_hz
        axes.axvspan(low, high, color=plots.BLUE, alpha=0.12, lw=0, label="band used")
        plots.labelled(axes, x="frequency [Hz]", y=f"amplitude [{traces[0].unit} per √Hz]")
        axes.grid(alpha=0.25, which="both")
        plots.legend(axes, size=8 if len(traces) == 1 else 6, location="lower left")

    frequency = lines[0][3]
    steps = int(ROWS_PER_DECADE * np.log10(frequency[-1] / frequency[0])) + 2
    rows = np.searchsorted(frequency, np.geomspace(frequency[0], frequency[-1], steps))
    rows = np.unique(rows.clip(max=frequency.size - 1))
    columns = (frequency[rows].tolist(), *(line[4][rows].tolist() for line in lines))
    titles = ("frequency [Hz]", *(line[0] for line in lines))
    return plots.Picture(
        title,
        "Where the input stands above the residual, the flight carries some information.",
        draw,
        number_table(titles, zip(*columns, strict=True)),
    )


#: Of a set without a value.
EMPTY = "empty: the instruments contradict each other at every value"


def _set_pictures(result: FlightEstimate, fit: Fit) -> Iterator[plots.Picture]:
    for name, sets in fit.sets.items():
        row = _row_of(result, name)
        wording = row.wording
        rows = [quantity_interval("reported", row)]
        labels = "estimate plus and minus", "profile", "Anderson–Rubin"
        symbol = f"{wording.symbol} [{wording.shown_unit}]"
        for label, values in zip(labels, (sets.wald, sets.profile, sets.anderson_rubin), strict=True):
            pieces = tuple((low * wording.scale, high * wording.scale) for low, high in values.intervals)
            texts = " or ".join(_piece(*piece, row.value) for piece in pieces) or EMPTY
            rows.append(plots.PlottedInterval(label, np.nan, pieces, texts))
        yield plots.forest_picture(
            f"Three 95 % sets of the {wording.words}",
            axis_of(wording),
            rows,
            "Nearly one where instruments are strong. Where they are weak, a profile set that is wider by "
            "their strength counts; of a pool, the wider of the last two.",
            number_table(("set", symbol), [(values.label, values.numbers) for values in rows]),
        )


def _row_of(result: FlightEstimate, name: str) -> QuantityRow:
    return QuantityRow(name, result.motion.quantities[name], result.quantities[name])


def quantity_interval(label: str, row: QuantityRow) -> plots.PlottedInterval:
    """A quantity as a row of a forest."""
    low, high = row.interval
    is_known = math.isfinite(row.value) and not (math.isnan(low) or math.isnan(high))
    texts = " ".join(dict.fromkeys(row.texts))
    return plots.PlottedInterval(
        label, row.value, ((low, high),) if is_known else (), texts, row.quantity.verdict
    )


def _piece(low: float, high: float, value: float) -> str:
    text = plain_numbers(value, (low, high))[1]
    if text == NO_NUMBER:
        text = f"below {high:.3g}" if np.isfinite(high) else "any value"
        text = f"above {low:.3g}" if np.isfinite(low) else text
    return text


def _ellipse_pictures(result: FlightEstimate, estimate: Estimate) -> Iterator[plots.Picture]:
    """The two parameters whose errors correlate most, together."""
    covariance, names = estimate.covariance, list(estimate.names)
    spread = np.sqrt(np.diag(covariance))
    identified = [
        name
        for name in result.motion.quantities
        if name in names and np.isfinite(spread[names.index(name)]) and spread[names.index(name)] > 0.0
    ]

    def correlation(pair: tuple[str, str]) -> float:
        i, j = (names.index(name) for name in pair)
        return abs(float(covariance[i, j])) / float(spread[i] * spread[j])

    pair = max(combinations(identified, 2), key=correlation, default=None)
    if pair is None:
        return
    try:
        ellipse = estimate.ellipse(*pair)
    except UsageError:  # too few degrees of freedom for a region of two
        return
    rows = [_row_of(result, name) for name in pair]
    scales = np.array([row.wording.scale for row in rows])
    scaled = replace(
        ellipse, centre=ellipse.centre * scales, covariance=ellipse.covariance * np.outer(scales, scales)
    )
    if not np.isfinite(scaled.outline()).all():
        return
    intervals = (rows[0].interval, rows[1].interval)

    def draw(axes: Axes) -> None:
        bounded = np.isfinite(intervals).all()
        plots.draw_ellipse(axes, scaled, intervals if bounded else ())
        if intervals[0][0] >= 0.0:  # it ends where its quantities do
            axes.set_xlim(left=max(axes.get_xlim()[0], 0.0))
        if intervals[1][0] >= 0.0:
            axes.set_ylim(bottom=max(axes.get_ylim()[0], 0.0))
        plots.labelled(axes, x=axis_of(rows[0].wording), y=axis_of(rows[1].wording))
        plots.legend(axes)

    yield plots.Picture(
        f"{capitalised(rows[0].wording.words)} and {rows[1].wording.words} together",
        f"The two parameters that trade off most: their errors correlate by {ellipse.correlation:+.2f}.",
        draw,
        number_table(
            ("quantity", "value", "95 % interval", "unit"),
            [(row.wording.words, *row.texts, row.wording.shown_unit) for row in rows],
        ),
    )


#: What each further axis adds to the height.
AXIS_INCHES = 4.0
#: So many panels stand side by side in that width; more of them make it wider.
LEAST_BESIDE = 3


def flight_figure(result: FlightEstimate) -> Figure:
    """Figure of a result; without an estimate it shows the flight itself and says why.

    Parameters
    ----------
    result : FlightEstimate
        Of one flight or of a pool.

    Notes
    -----
    Panels are "fit", "residual", "autocorrelation", "profile" and "excitation". A motion of several axes has
    "fit of AXIS" and "residual of AXIS" for each. Several continuous nuisances, as the lag and the delay,
    have a "profile of NAME" each. Without an estimate there are what the motion looks at, "input" and
    "reasons".
    """
    if result.fit is None:
        panels = _flight_panels(result)
        above = len(panels) - 1  # the last has words only
        heights = (*[1.0] * above, 0.6)
        placed = plots.column_page(tuple(panels), plots.SIZE_INCHES, heights=heights, shared=max(above, 1))
    else:
        panels = _fit_panels(result, result.fit)
        placed = _fit_page(tuple(panels))
    figure = plots.drawn(panels, placed)
    _title(figure, result)
    return figure


def _fit_panels(result: FlightEstimate, fit: Fit) -> plots.Panels:
    """Panels of an estimate, in order; where there are several of a kind, they say what they are of."""
    estimate, runs = fit.estimate, flight_runs(result)
    traces = fit.traces(result.motion)
    panels: plots.Panels = {}
    for trace in traces:
        of_axis = f" of {trace.axis}" if len(traces) > 1 else ""
        panels[f"fit{of_axis}"] = partial(_draw_fit, trace=trace, runs=runs, residual=False)
        panels[f"residual{of_axis}"] = partial(_draw_fit, trace=trace, runs=runs, residual=True)
    panels["autocorrelation"] = _autocorrelation_picture(estimate, runs).on
    profiles = estimate.profiles
    for number, profile in enumerate(profiles):
        of_nuisance = f" of {profile.nuisance.name}" if len(profiles) > 1 else ""
        panels[f"profile{of_nuisance}"] = _profile_picture(result, estimate, number).on
    if not profiles:
        panels["profile"] = partial(_draw_no_profile, result=result)
    panels["excitation"] = _excitation_picture(traces, runs, "Excitation").on
    return panels


def _draw_no_profile(axes: Axes, result: FlightEstimate) -> None:
    axes.set_title("How well each lag fits", fontsize=9)
    prior = None if result.fit is None else result.fit.lag_prior
    why = result.motion.words.no_lag if prior is None else f"The lag was given:\n{prior.given}."
    axes.text(0.5, 0.5, why, ha="center", va="center", transform=axes.transAxes)
    axes.set_axis_off()


def _fit_page(names: tuple[str, ...]) -> dict[str, Axes]:
    wide = [name for name in names if name.startswith(("fit", "residual"))]
    others = [name for name in names if name not in wide]
    width, height = plots.SIZE_INCHES
    figure = plots.page(
        width * max(len(others) / LEAST_BESIDE, 1.0), height + AXIS_INCHES * (len(wide) // 2 - 1)
    )
    placed = plots.mosaic(
        figure,
        [*([name] * len(others) for name in wide), others],
        height_ratios=(*(2.0, 0.9) * (len(wide) // 2), 2.2),
    )
    for fit, residual in zip(wide[::2], wide[1::2], strict=True):
        placed[residual].sharex(placed[fit])
        plots.without_abscissa(placed[fit])
    return placed


def _title(figure: Figure, result: FlightEstimate) -> None:
    names = [printable(flight.recording.name) for flight in result.prepared]
    text = shortened(names[0]) if len(names) == 1 else f"{len(names)} flights: {shortened(names[0])}, …"
    parts = []
    for name in result.motion.quantities.rows:
        row = _row_of(result, name)
        value, interval = row.texts
        if value != NO_NUMBER:
            bounds = "" if interval == NO_NUMBER else f" {interval}"
            status = row.quantity.verdict
            suffix = "" if status is Status.IDENTIFIED else f" ({status.label})"
            number = f"{row.wording.words} {value}{bounds} {row.wording.shown_unit}".rstrip()
            parts.append(f"{number}{suffix}")
    lines = [text, "; ".join(parts[:2]), "; ".join(parts[2:]), "" if parts else result.verdict.status.label]
    figure.suptitle("\n".join(line for line in lines if line), fontsize=11, parse_math=False)


def _flight_panels(result: FlightEstimate) -> plots.Panels:
    prepared = result.prepared[0]
    by_label = {
        " ".join(item.label.split()).partition(" [")[0]: item for item in result.motion.view(prepared).panels
    }
    by_label["input"] = PlotData(f"mean of\n{prepared.input.name}", prepared.logged_input)
    where, active = result.motion.words.where, prepared.active
    shading = f"shaded where {where}" if active.mask.any() else f"never {where}"
    title = f"{printable(prepared.recording.name)}: {shading}, by {active.rule}"
    panels: plots.Panels = {
        name: partial(_draw_series, plot_data=item, result=result, title="" if number else title)
        for number, (name, item) in enumerate(by_label.items())
    }
    panels["reasons"] = partial(_write_reasons, result=result)
    return panels


def _draw_series(axes: Axes, plot_data: PlotData, result: FlightEstimate, title: str) -> None:
    prepared = result.prepared[0]
    time = prepared.grid.time_s
    axes.plot(time, plot_data.values, color=plots.DARK, lw=0.9)
    plots.labelled(axes, x="time from the log's start [s]", y=plot_data.label)
    axes.margins(x=0.005)
    across, used = axes.get_xaxis_transform(), plots.STATUS_COLOURS[Status.IDENTIFIED]
    for mask, colour in ((prepared.active.mask, plots.BLUE), (prepared.used, used)):
        if mask.any():
            axes.fill_between(time, 0.0, 1.0, where=mask, transform=across, color=colour, alpha=0.12, lw=0)
    if title:
        plots.headed(axes, title)


def _write_reasons(axes: Axes, result: FlightEstimate) -> None:
    axes.set_axis_off()
    lines = [plots.fitting(axes, printable(sentence)) for sentence in result.verdict.sentences]
    axes.text(0.0, 1.0, "\n".join(lines), va="top", fontsize=9, parse_math=False)
