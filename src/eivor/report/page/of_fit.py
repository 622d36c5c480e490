"""Pictures of an estimate: its residual's memory, how well each lag fits, spectra, sets, a joint ellipse."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations, cycle

import numpy as np

from eivor.errors import UsageError
from eivor.estimation.estimate import Estimate
from eivor.flights.quantity import Wording
from eivor.flights.result import Fit, FlightEstimate
from eivor.flights.shown import Trace
from eivor.inference.quantiles import chi_square_quantile
from eivor.inference.sets.confidence_set import ConfidenceSet
from eivor.report.fit_numbers import (
    LEAST_AMPLITUDE,
    FlightRun,
    flight_runs,
    profile_curves,
    residual_autocorrelation,
    spectrum,
)
from eivor.report.page.forest import Forest, ForestRow
from eivor.report.page.number_tables import number_table
from eivor.report.page.picture import Picture, Pictures
from eivor.report.page.plot import Band, Curve, Dots, Mark, Plot, Rule, Stems
from eivor.report.page.scale import Linear, LinearBelow, Logarithmic, margined
from eivor.report.wording import NO_NUMBER, numbers, plain_numbers
from eivor.shapes import Float

#: A grid of positive values whose ends have this ratio or a larger one has a logarithmic axis.
WIDE_RATIO = 10.0
#: Looks of several curves in one drawing.
LOOKS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth")
#: Rows of a table beside a spectrum: so many for each decade.
ROWS_PER_DECADE = 8
#: Bands of a spectrum in each decade.
BANDS_PER_DECADE = 90


def pictures_of_fit(result: FlightEstimate, fit: Fit) -> Pictures:
    """Pictures of an estimate that are not over time."""
    runs = flight_runs(result)
    traces = fit.traces(result.motion)
    return Pictures(
        "",
        (
            _autocorrelation(fit.estimate, runs),
            *_profiles(result, fit.estimate),
            *(_spectra(trace, runs) for trace in traces if trace.driven.any()),
            *_sets(result, fit),
            *_ellipse(result, fit.estimate),
        ),
    )


def _autocorrelation(estimate: Estimate, runs: list[FlightRun]) -> Picture:
    found = residual_autocorrelation(estimate.best, runs)
    shift, correlation = found.shift_s[1:], found.correlation[1:]
    limit = max(0.3, 1.15 * float(np.max(np.abs(correlation), initial=0.0)))
    marks = (
        Band("95 % band of white noise", "shade", -found.band, found.band, upright=False),
        Rule("", "zero", 0.0, upright=False),
        Stems("correlation", "residual", shift, correlation),
    )
    return Picture(
        f"Autocorrelation of the {found.what}",
        "Of a residual that holds nothing more, one stem in twenty leaves the band.",
        Plot(Linear("shift [s]", 0.0, 1.04 * float(shift[-1])), Linear("correlation", -limit, limit), marks),
        number_table(("shift [s]", "correlation"), zip(shift.tolist(), correlation.tolist(), strict=True)),
    )


def _profiles(result: FlightEstimate, estimate: Estimate) -> Iterator[Picture]:
    for number, profile in enumerate(estimate.best.profiles):
        name = profile.nuisance.name
        wording, quantity = result.motion.wording[name], result.quantities[name]
        scale, quantile = wording.scale, chi_square_quantile(0.95)
        curves = profile_curves(result, estimate, number)
        x = _abscissa(_axis_words(wording), profile.grid * scale)
        # an interval may have no end, and a logarithm has no zero
        low, high = (float(np.clip(scale * end, x.low, x.high)) for end in quantity.interval)
        tallest = max([5.0 * quantile, *(float(one.excess.max()) for one in curves)])
        marks: list[Mark] = [
            Band("95 % interval", "shade", low, high, upright=True),
            Rule("least that 95 % leave out, by curves", "limit", quantile, upright=False),
            Rule("estimate", "value", scale * quantity.value, upright=True),
        ]
        rows = []
        for curve, look in zip(curves, cycle(LOOKS), strict=False):
            label = curve.choice or "objective"
            marks.append(Curve(label, look, curve.values * scale, curve.excess))
            rows += [
                (label, at, excess)
                for at, excess in zip((scale * curve.values).tolist(), curve.excess.tolist(), strict=True)
            ]
        y = LinearBelow("objective above its least (χ² units)", quantile, 1.5 * tallest)
        yield Picture(
            f"How well each {wording.words} fits",
            "Values whose curve stays below the dashed line fit the flight; equal steps below it, powers of "
            "ten above.",
            Plot(x, y, tuple(marks)),
            number_table(("curve", x.words, "above the least"), rows),
        )


def _abscissa(words: str, grid: Float[np.ndarray, " values"]) -> Linear | Logarithmic:
    low, high = float(grid[0]), float(grid[-1])
    if low <= 0.0 or high < WIDE_RATIO * low:
        return margined(words, grid, 0.03)
    return Logarithmic(words, 0.9 * low, 1.1 * high)


def _spectra(trace: Trace, runs: list[FlightRun]) -> Picture:
    frequency, driven = _banded(*spectrum(trace.driven, runs))
    _, left = _banded(*spectrum(trace.measured - trace.predicted, runs))
    low, high = runs[0].spectral.band_hz
    top = float(max(driven.max(), left.max()))
    least = max(float(min(driven.min(), left.min())), LEAST_AMPLITUDE * top)
    x = Logarithmic("frequency [Hz]", float(frequency[0]), float(frequency[-1]))
    y = Logarithmic(f"amplitude [{trace.unit} per √Hz]", 0.8 * least, 1.3 * top)
    marks = (
        Band("band used", "shade", max(low, x.low), min(high, x.high), upright=True),
        Curve("residual", "residual", frequency, left),
        Curve(f"input: {trace.drive}", "predicted", frequency, driven),
    )
    decades = np.log10(frequency[-1] / frequency[0])
    kept = np.unique(
        np.searchsorted(
            frequency, np.geomspace(frequency[0], frequency[-1], int(ROWS_PER_DECADE * decades) + 2)
        )
    ).clip(max=frequency.size - 1)
    columns = (frequency[kept].tolist(), driven[kept].tolist(), left[kept].tolist())
    return Picture(
        f"What excites the {trace.axis}",
        "Where the input stands above the residual, the flight tells something.",
        Plot(x, y, marks),
        number_table((x.words, f"input: {trace.drive}", "residual"), zip(*columns, strict=True)),
    )


def _banded(
    frequency: Float[np.ndarray, " bins"], amplitude: Float[np.ndarray, " bins"]
) -> tuple[Float[np.ndarray, " bands"], Float[np.ndarray, " bands"]]:
    """Root mean square amplitude of narrow bands: bins stand closer than a drawing shows."""
    _, place = np.unique(np.floor(BANDS_PER_DECADE * np.log10(frequency / frequency[0])), return_inverse=True)
    count = np.bincount(place)
    return np.bincount(place, frequency) / count, np.sqrt(np.bincount(place, amplitude**2) / count)


def _sets(result: FlightEstimate, fit: Fit) -> Iterator[Picture]:
    """Sets of the headline beside the interval that is told."""
    for name, sets in fit.sets.items():
        wording, quantity = result.motion.wording[name], result.quantities[name]
        value = quantity.value * wording.scale
        told = numbers(quantity, wording)
        interval = (quantity.interval[0] * wording.scale, quantity.interval[1] * wording.scale)
        rows = [ForestRow("told", " ".join(told), value, (interval,), quantity.verdict)]
        for label, one in (
            ("estimate plus and minus", sets.wald),
            ("profile", sets.profile),
            ("Anderson–Rubin", sets.anderson_rubin),
        ):
            pieces = tuple((low * wording.scale, high * wording.scale) for low, high in one.intervals)
            rows.append(ForestRow(label, _pieces(one, value, wording), np.nan, pieces))
        table = number_table(
            ("set", f"{wording.symbol} [{wording.shown_unit}]"), [(row.label, row.numbers) for row in rows]
        )
        yield Picture(
            f"Three 95 % sets of the {wording.words}",
            "Nearly one where instruments are strong; where they are weak, the wider of the last two counts.",
            Forest(_axis_words(wording), tuple(rows)),
            table,
        )


def _pieces(one: ConfidenceSet, value: float, wording: Wording) -> str:
    """Pieces of a set in words."""
    if not one.intervals:
        return "no value"
    return " or ".join(
        _piece(low * wording.scale, high * wording.scale, value) for low, high in one.intervals
    )


def _piece(low: float, high: float, value: float) -> str:
    told = plain_numbers(value, (low, high))[1]
    if told != NO_NUMBER:
        return told
    if np.isfinite(low):
        return f"above {low:.3g}"
    return f"below {high:.3g}" if np.isfinite(high) else "any value"


def _ellipse(result: FlightEstimate, estimate: Estimate) -> Iterator[Picture]:
    """Joint region of the two parameters that trade off most."""
    pair = _closest(result, estimate)
    if pair is None:
        return
    try:
        ellipse = estimate.ellipse(*pair)
    except UsageError:  # too few degrees of freedom for a region of two
        return
    words = [result.motion.wording[name] for name in pair]
    scales = np.array([one.scale for one in words])
    outline, centre = ellipse.outline() * scales, ellipse.centre * scales
    if not np.isfinite(outline).all():
        return
    ends = [
        np.array(result.quantities[name].interval) * one.scale for name, one in zip(pair, words, strict=True)
    ]
    x, y = (
        margined(_axis_words(one), np.concatenate([outline[:, place], ends[place]]))
        for place, one in enumerate(words)
    )
    marks: list[Mark] = [
        Curve("joint 95 % ellipse", "first", *outline.T),
        *(
            Rule(label, "limit", float(end), upright=True)
            for label, end in zip(("intervals one by one", ""), ends[0], strict=True)
            if np.isfinite(end)
        ),
        *(Rule("", "limit", float(end), upright=False) for end in ends[1] if np.isfinite(end)),
        Dots("estimate", "first", centre[:1], centre[1:]),
    ]
    rows = [
        (one.words, *numbers(result.quantities[name], one), one.shown_unit)
        for name, one in zip(pair, words, strict=True)
    ]
    first, other = (one.words for one in words)
    yield Picture(
        f"{first[0].upper()}{first[1:]} and {other} together",
        f"The two parameters that trade off most: their errors correlate by {ellipse.correlation:+.2f}.",
        Plot(x, y, tuple(marks)),
        number_table(("quantity", "value", "95 % interval", "unit"), rows),
    )


def _closest(result: FlightEstimate, estimate: Estimate) -> tuple[str, str] | None:
    """The two of the reported parameters whose errors correlate most; None where there are no two."""
    covariance, names = estimate.covariance, list(estimate.names)
    spread = np.sqrt(np.diag(covariance))
    known = [
        name
        for name in result.motion.shown
        if name in names and np.isfinite(spread[names.index(name)]) and spread[names.index(name)] > 0.0
    ]

    def size(pair: tuple[str, str]) -> float:
        one, other = (names.index(name) for name in pair)
        return abs(float(covariance[one, other])) / float(spread[one] * spread[other])

    return max(combinations(known, 2), key=size, default=None)


def _axis_words(wording: Wording) -> str:
    return f"{wording.words} {wording.symbol} [{wording.shown_unit or '-'}]"
