"""Spectra of noises, with the slope that a fractional noise of the estimated order has."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eivor.errors import NonFiniteError
from eivor.report.given_axes import figure_of
from eivor.report.plain_figure import BLUE, GREY, RED, legend, panel
from eivor.report.printable import printable
from eivor.shapes import Float
from eivor.signals.long_memory import LongMemory, estimate_long_memory

#: Periodogram bins are averaged in bands of so many for each decade of frequency.
BANDS_PER_DECADE = 12


def noise_spectrum_figure(
    values: Float[np.ndarray, " n"],
    *,
    rate_hz: float,
    unit: str = "",
    estimate: LongMemory | None = None,
    title: str = "",
    ax: Axes | None = None,
) -> Figure:
    """Spectrum of a record at rest and the fractional noise that was fitted to it.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Uniformly sampled noise, in `unit`.
    rate_hz : float
        Samples per second [Hz].
    unit : str
        Unit of the values; "-" for none.
    estimate : LongMemory, optional
        What was fitted. Default: `estimate_long_memory` of the values.
    title : str
        Of the figure, or of the panel that is given.
    ax : matplotlib.axes.Axes, optional
        Where to draw; default: a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        With a canvas of its own, or that of `ax`.

    Raises
    ------
    NonFiniteError
        When the rate is not positive; see also `estimate_long_memory`.
    UsageError
        When `ax` are no Axes.
    """
    if not (np.isfinite(rate_hz) and rate_hz > 0.0):
        raise NonFiniteError("a positive rate in Hz", f"rate_hz={rate_hz}", "Give samples per second.")
    axes = panel(ax, 8.0, 5.0, title)
    draw_noise_spectrum(axes, values, rate_hz=rate_hz, unit=unit, estimate=estimate)
    return figure_of(axes)


def draw_noise_spectrum(
    axes: Axes,
    values: Float[np.ndarray, " n"],
    *,
    rate_hz: float,
    unit: str = "",
    estimate: LongMemory | None = None,
) -> None:
    """Draw what `noise_spectrum_figure` shows into one panel."""
    found = estimate or estimate_long_memory(values)
    frequency = rate_hz * np.arange(1, (values.size + 1) // 2) / values.size
    spectrum = np.abs(np.fft.rfft(values - values.mean())[1 : frequency.size + 1]) ** 2
    amplitude = np.sqrt(2.0 * spectrum / (values.size * rate_hz))
    gain = 2.0 * np.sin(np.pi * frequency / rate_hz)
    fitted = np.sqrt(2.0 / rate_hz) * found.std * gain**found.order
    axes.loglog(frequency, amplitude, color=GREY, lw=0.4, alpha=0.5, label="periodogram")
    axes.loglog(*_banded(frequency, amplitude), "o", color=BLUE, ms=4, label="mean power of bands")
    used = frequency <= rate_hz * found.bandwidth / values.size
    what = f"fractional noise, order {found.order:.3f} ± {found.order_error:.3f}"
    axes.loglog(frequency, fitted, color=RED, lw=0.9, ls="--")
    axes.loglog(frequency[used], fitted[used], color=RED, lw=1.8, label=f"{what}\n(fitted where solid)")
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel(f"amplitude density [{printable(unit) or '-'} per √Hz]", parse_math=False)
    # periodogram bins may be next to nothing; below the bands they say nothing either
    floor, top = float(np.quantile(amplitude, 0.01)), float(amplitude.max())
    axes.set_ylim(0.5 * max(floor, 1e-12 * top), 3.0 * top)
    axes.grid(alpha=0.25, which="both")
    legend(axes)


def _banded(
    frequency: Float[np.ndarray, " bins"], amplitude: Float[np.ndarray, " bins"]
) -> tuple[Float[np.ndarray, " bands"], Float[np.ndarray, " bands"]]:
    """Geometric mean frequency and root mean square amplitude of bands of equal ratio."""
    band = np.floor(BANDS_PER_DECADE * np.log10(frequency / frequency[0])).astype(np.int64)
    _, place = np.unique(band, return_inverse=True)
    count = np.bincount(place)
    centre = np.exp(np.bincount(place, np.log(frequency)) / count)
    return centre, np.sqrt(np.bincount(place, amplitude**2) / count)
