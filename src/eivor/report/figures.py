"""Matplotlib figures of results."""

from __future__ import annotations

import warnings
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from eivor.atomic_file import atomic_write
from eivor.errors import NonFiniteError, TooFewSamplesError
from eivor.estimation.bootstrap import autocovariance
from eivor.flights.motion import UNCHANGED, HorizonErrors, MultiStepPrediction
from eivor.inference.distributions import normal_quantile
from eivor.report import figure_panels as plots
from eivor.report.figure_panels import Axes, Figure
from eivor.report.flight import display_unit
from eivor.signals.channels import canonical_channel
from eivor.signals.noise import LEAST_BANDWIDTH, estimate_long_memory
from eivor.signals.signals import Signals
from eivor.tools import Float, printable

AHEAD_COLOURS = (plots.RED, plots.BLUE, "#8a6d3b")
WIDTH_INCHES, ROW_INCHES = 11.0, 2.3
#: So much of a flight is drawn over time [s].
AHEAD_SHOWN_S = 20.0
#: A line is broken where so many times the usual step passes without a start.
BROKEN_AFTER = 3.0


def prediction_panels(predictions: MultiStepPrediction) -> plots.Panels:
    """Panels by name: each quantity, and "QUANTITY by horizon" beside it."""
    panels: plots.Panels = {}
    liveliest = _liveliest(predictions)
    for number, models in enumerate(predictions.by_quantity):
        name = models[0].quantity
        options: dict[str, Any] = {"prediction": predictions, "models": models, "first": number == 0}
        panels[name] = partial(_draw_ahead_over_time, **options, displayed=liveliest)
        panels[f"{name} by horizon"] = partial(draw_by_horizon, **options)
    return panels


def prediction_page(names: tuple[str, ...]) -> dict[str, Axes]:
    """A page with two panels in a row."""
    pairs = list(zip(names[::2], names[1::2], strict=True))
    figure = plots.page(WIDTH_INCHES, ROW_INCHES * len(pairs) + 1.2)
    return plots.mosaic(figure, pairs, width_ratios=(2.2, 1.0))


def _draw_ahead_over_time(
    ax: Axes,
    prediction: MultiStepPrediction,
    models: tuple[HorizonErrors, ...],
    displayed: slice,
    *,
    first: bool,
) -> None:
    unit, times = display_unit(models[0].unit)
    horizon_s = prediction.horizons_s[-1]
    time = prediction.start_s[displayed] + horizon_s
    words, series = f"{models[0].quantity} [{unit}]", models[0].series
    if series is not None:
        measured = _unbroken(time, times * series[displayed, 0])
        ax.plot(time, measured, color=plots.DARK, lw=2.6, alpha=0.4, label="measured")
    else:
        words = f"error of {words}"
    for item, colour in _coloured(models):
        if item.series is None or item.model != UNCHANGED:
            values = item.sizes[displayed, -1] if item.series is None else item.series[displayed, 1]
            ax.plot(time, _unbroken(time, times * values), color=colour, lw=1.0)
    plots.labelled(ax, x="time [s]", y=words, size=9.0)
    ax.margins(x=0.005)
    if first and series is not None:
        plots.legend(ax, size=7)
    if first:
        plots.headed(ax, f"After {horizon_s:g} s, in the liveliest {time[-1] - time[0]:.0f} s of the flight")


def draw_by_horizon(
    axes: Axes, prediction: MultiStepPrediction, models: tuple[HorizonErrors, ...], *, first: bool = True
) -> None:
    """Root mean square error of each model against the horizon; the first has a key."""
    unit, times = display_unit(models[0].unit)
    for item, colour in _coloured(models):
        errors = times * np.array(item.rms)
        axes.plot(prediction.horizons_s, errors, "o-", color=colour, ms=3.5, lw=1.2, label=item.words)
    peak = times * max(max(model.rms) for model in models)
    axes.set_ylim(0.0, (1.75 if first else 1.1) * peak or 1.0)
    plots.labelled(axes, x="predicted so far ahead [s]", y=f"RMS error [{unit}]", size=9.0)
    if first:
        plots.legend(axes, size=7, location="upper left")


def _coloured(models: tuple[HorizonErrors, ...]) -> list[tuple[HorizonErrors, str]]:
    parametric = [model for model in models if model.model != UNCHANGED]
    colours = dict(zip((item.model for item in parametric), AHEAD_COLOURS, strict=False))
    return [(model, colours.get(model.model, plots.GREY)) for model in reversed(models)]


def _liveliest(prediction: MultiStepPrediction) -> slice:
    """Starts within the part of a flight in which most happens that does not stay as it is."""
    time = prediction.start_s
    stayed = [models[-1] for models in prediction.by_quantity]
    errors = [(np.nan_to_num(item.sizes[:, -1] / (item.rms[-1] or 1.0))) ** 2 for item in stayed]
    step = float(np.median(np.diff(time))) if time.size > 1 else AHEAD_SHOWN_S
    return plots.of_most_power(np.sum(errors, axis=0), max(round(AHEAD_SHOWN_S / step), 1))


def _unbroken(time: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Values without a line over stretches in which nothing starts."""
    steps = np.diff(time, prepend=time[:1])
    usual = float(np.median(steps[1:])) if time.size > 1 else np.inf
    return np.where(steps > BROKEN_AFTER * usual, np.nan, values)


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, SVG or PDF, recognised by the ending; whole."""
    with atomic_write(path) as file:
        write_figure(figure, file, path.suffix.lower().lstrip("."))


def write_figure(figure: Figure, file: BytesIO | BinaryIO, kind: str) -> None:
    """Write a figure as PNG, SVG or PDF, without the date."""
    metadata = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(kind)
    with warnings.catch_warnings():
        # a log's name may hold letters that the font does not have; they become boxes
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        figure.savefig(file, format=kind, metadata=metadata)


#: Periodogram bins are averaged in bands of so many for each decade of frequency.
BANDS_PER_DECADE = 12


def _draw_noise_spectrum(axes: Axes, values: Float[np.ndarray, " n"], rate_hz: float, unit: str) -> None:
    result = estimate_long_memory(values)
    frequency = rate_hz * np.arange(1, (values.size + 1) // 2) / values.size
    spectrum = np.abs(np.fft.rfft(values - values.mean())[1 : frequency.size + 1]) ** 2
    amplitude = np.sqrt(2.0 * spectrum / (values.size * rate_hz))
    gain = 2.0 * np.sin(np.pi * frequency / rate_hz)
    fitted = np.sqrt(2.0 / rate_hz) * result.std * gain**result.order
    axes.loglog(frequency, amplitude, color=plots.GREY, lw=0.4, alpha=0.5, label="periodogram")
    bands = plots.banded(frequency, amplitude, BANDS_PER_DECADE)
    axes.loglog(*bands, "o", color=plots.BLUE, ms=4, label="mean power of bands")
    used = frequency <= rate_hz * result.bandwidth / values.size
    text = f"fractional noise, order {result.order:.3f} ± {result.order_error:.3f}"
    axes.loglog(frequency, fitted, color=plots.RED, lw=0.9, ls="--")
    axes.loglog(frequency[used], fitted[used], color=plots.RED, lw=1.8, label=f"{text}\n(fitted where solid)")
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel(f"amplitude density [{printable(unit) or '-'} per √Hz]", parse_math=False)
    # periodogram bins may be next to nothing; below the bands they say nothing either
    floor, top = float(np.quantile(amplitude, 0.01)), float(amplitude.max())
    axes.set_ylim(0.5 * max(floor, 1e-12 * top), 3.0 * top)
    axes.grid(alpha=0.25, which="both")
    plots.legend(axes)


#: Lags of the autocorrelation, and the largest share of the record that they may reach.
LAGS, LARGEST_SHARE = 60, 0.25
#: More samples than so many are drawn as the range of each of so many stretches.
STRETCHES = 2000


def residual_figure(
    residual: Float[np.ndarray, " n"], *, rate_hz: float, unit: str = "", title: str = ""
) -> Figure:
    """Three panels that identify whether a residual is white.

    Parameters
    ----------
    residual : ndarray, shape (n,)
        In time order, in `unit`.
    rate_hz : float
        Samples per second [Hz].
    unit : str
        Unit of the residual.

    Notes
    -----
    White noise keeps 95 % of its autocorrelations within the dashed band, 1.96 / sqrt(n); uncorrelated noise
    of any varying strength within the shaded one.
    """
    if not (np.isfinite(residual).all() and np.isfinite(rate_hz) and rate_hz > 0.0):
        expected = "finite residuals and a positive rate"
        raise NonFiniteError(expected, f"rate_hz={rate_hz}", "Repair or cut the samples.")
    if residual.size < 2 * LEAST_BANDWIDTH + 1:
        expected = f"{2 * LEAST_BANDWIDTH + 1} residuals or more"
        raise TooFewSamplesError(expected, f"{residual.size}", "Use a longer record.")
    unit = unit.replace("^2", "²")
    panels: plots.Panels = {
        "time": partial(_draw_time, values=residual, rate_hz=rate_hz, unit=unit),
        "autocorrelation": partial(_draw_autocorrelation, values=residual, rate_hz=rate_hz),
        "spectrum": partial(_draw_noise_spectrum, values=residual, rate_hz=rate_hz, unit=unit),
    }
    rows = [("time", "time"), ("autocorrelation", "spectrum")]
    figure = plots.page(10.0, 6.4, title)
    return plots.drawn(panels, plots.mosaic(figure, rows, height_ratios=(0.85, 1.0)))


def _draw_time(axes: Axes, values: Float[np.ndarray, " n"], rate_hz: float, unit: str) -> None:
    time = np.arange(values.size) / rate_hz
    if values.size > 2 * STRETCHES:
        first = np.arange(STRETCHES) * values.size // STRETCHES
        low, high = (reduce.reduceat(values, first) for reduce in (np.minimum, np.maximum))
        axes.fill_between(time[first], low, high, color=plots.GREY, lw=0.3, label="range")
    else:
        axes.plot(time, values, color=plots.GREY, lw=0.7)
    axes.axhline(0.0, color=plots.DARK, lw=0.8)
    plots.labelled(axes, x="time t [s]", y=f"residual [{printable(unit) or '-'}]")
    axes.margins(x=0.005)


def _draw_autocorrelation(axes: Axes, values: Float[np.ndarray, " n"], rate_hz: float) -> None:
    centred = values - values.mean()
    lag = np.arange(1, 1 + max(1, min(LAGS, int(LARGEST_SHARE * values.size))))
    R = autocovariance(centred, lag.size)
    # Var r_k = sum e_t^2 e_t-k^2 / (sum e_t^2)^2 (Lo and MacKinlay 1988); 1 / n for constant strength
    squares, white = centred**2, normal_quantile(0.95) / np.sqrt(values.size)
    products = np.array([float(squares[k:] @ squares[:-k]) for k in lag])
    robust = normal_quantile(0.95) * np.sqrt(products) / squares.sum()
    strength = "uncorrelated, varying strength"
    axes.fill_between(lag, -robust, robust, color=plots.BLUE, alpha=0.3, lw=0, label=strength)
    for edge in (-white, white):
        axes.axhline(edge, color=plots.RED, lw=1.0, ls="--", label="white noise, 95 %" if edge > 0.0 else "_")
    axes.vlines(lag, 0.0, R[1:] / R[0], color=plots.DARK, lw=1.2)
    axes.plot(lag, R[1:] / R[0], "o", color=plots.DARK, ms=2.5)
    axes.axhline(0.0, color=plots.DARK, lw=0.8)
    plots.labelled(axes, x=f"lag [samples of {1.0 / rate_hz:.3g} s]", y="autocorrelation [-]")
    plots.legend(axes, size=7)


SIGNAL_WIDTH, PANEL_HEIGHT = 10.0, 2.3
#: How channels are called on an axis; others by their names.
WORDS = {
    "input": "input u",
    "position_z": "height z",
    "velocity_z": "velocity z'",
    "specific_force_z": "specific force z'' + g",
    "acceleration_z": "acceleration z''",
}


def signals_figure(signals: Signals, *, title: str = "") -> Figure:
    """Channels over time, one below the other; samples that are not valid leave gaps."""
    time = signals.start_s + signals.step_s * np.arange(signals.sample_count)

    def draw(axes: Axes, name: str) -> None:
        values, channel = signals.channel(name), canonical_channel(name)
        valid = values if signals.valid is None else np.where(signals.valid, values, np.nan)
        axes.plot(time, valid, color=plots.DARK, lw=0.7)
        unit = (channel.unit if channel else "").replace("^2", "²") or "-"
        plots.labelled(axes, x="time t [s]", y=f"{printable(WORDS.get(name, name))} [{unit}]")
        axes.margins(x=0.005)

    size = SIGNAL_WIDTH, PANEL_HEIGHT * len(signals.channels) + 0.7
    panels: plots.Panels = {name: partial(draw, name=name) for name in signals.channels}
    return plots.drawn(panels, plots.column_page(tuple(panels), size, title))
