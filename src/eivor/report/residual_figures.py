"""Figure of a residual: over time, its autocorrelation with bands, its spectrum and long memory."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eivor.errors import NonFiniteError, TooFewSamplesError
from eivor.inference.quantiles import normal_quantile
from eivor.inference.resampling.blocks import autocovariance
from eivor.report.given_axes import GivenAxes, figure_of, given_axes
from eivor.report.noise_figures import draw_noise_spectrum
from eivor.report.plain_figure import BLUE, DARK, GREY, RED, legend, page
from eivor.report.printable import printable
from eivor.shapes import Float
from eivor.signals.long_memory import LEAST_BANDWIDTH

#: Names of the panels.
PANELS = ("time", "autocorrelation", "spectrum")
#: Lags of the autocorrelation, and the largest share of the record that they may reach.
LAGS, LARGEST_SHARE = 60, 0.25
#: More samples than so many are drawn as the range of each of so many stretches.
STRETCHES = 2000


def residual_figure(
    residual: Float[np.ndarray, " n"],
    *,
    rate_hz: float,
    unit: str = "",
    start_s: float = 0.0,
    lags: int = LAGS,
    title: str = "",
    axes: GivenAxes | None = None,
) -> Figure:
    """Three panels that tell whether a residual is white.

    Parameters
    ----------
    residual : ndarray, shape (n,)
        In time order, in `unit`.
    rate_hz : float
        Samples per second [Hz].
    unit : str
        Unit of the residual.
    start_s : float
        Time of the first sample [s].
    lags : int
        Lags of the autocorrelation [samples].
    title : str
        Of the figure, or of the first panel that is given.
    axes : mapping of str to Axes, or sequence of Axes, optional
        Where to draw: some of "time", "autocorrelation" and "spectrum", or all three in this order.
        Default: a figure of its own.

    Returns
    -------
    matplotlib.figure.Figure
        With a canvas of its own, or that of `axes`. White noise keeps 95 % of its autocorrelations within
        the dashed band, 1.96 / sqrt(n); uncorrelated noise of any varying strength within the shaded one.

    Raises
    ------
    NonFiniteError
        When a value is not finite, or the rate is not positive.
    TooFewSamplesError
        With too few samples for a spectrum.
    UsageError
        When `axes` do not fit the panels.
    """
    if not (np.isfinite(residual).all() and np.isfinite(rate_hz) and rate_hz > 0.0):
        raise NonFiniteError(
            "finite residuals and a positive rate", f"rate_hz={rate_hz}", "Repair or cut the samples."
        )
    if residual.size < 2 * LEAST_BANDWIDTH + 1:
        raise TooFewSamplesError(
            f"{2 * LEAST_BANDWIDTH + 1} residuals or more", f"{residual.size}", "Use a longer record."
        )
    panels = _page(title) if axes is None else given_axes(axes, PANELS, title)
    squared = unit.replace("^2", "²")
    if "time" in panels:
        over_time = panels["time"]
        _draw_time(over_time, residual, start_s + np.arange(residual.size) / rate_hz)
        over_time.set_ylabel(f"residual [{printable(squared) or '-'}]", parse_math=False)
    if "autocorrelation" in panels:
        most = max(1, min(lags, int(LARGEST_SHARE * residual.size)))
        _draw_autocorrelation(panels["autocorrelation"], residual, most, rate_hz)
    if "spectrum" in panels:
        draw_noise_spectrum(panels["spectrum"], residual, rate_hz=rate_hz, unit=squared)
    return figure_of(*panels.values())


def _page(title: str) -> dict[str, Axes]:
    figure = page(10.0, 6.4, title)
    grid = figure.add_gridspec(2, 2, height_ratios=(0.85, 1.0))
    places = (grid[0, :], grid[1, 0], grid[1, 1])
    return {name: figure.add_subplot(place) for name, place in zip(PANELS, places, strict=True)}


def robust_band(residual: Float[np.ndarray, " n"], lags: int) -> Float[np.ndarray, " lags"]:
    """95 % half-width of the autocorrelation at each lag of uncorrelated noise whose strength varies.

    Parameters
    ----------
    residual : ndarray, shape (n,)
        The mean is taken off.
    lags : int
        At lags 1 to `lags`.

    Notes
    -----
    Var r_k = sum e_t^2 e_t-k^2 / (sum e_t^2)^2 (Lo and MacKinlay 1988); 1 / n for constant strength.
    """
    e = residual - residual.mean()
    power = float(e @ e)
    squares = e * e
    together = np.array([float(squares[k:] @ squares[:-k]) for k in range(1, lags + 1)])
    width: Float[np.ndarray, " lags"] = normal_quantile(0.95) * np.sqrt(together) / power
    return width


def _draw_time(axes: Axes, values: Float[np.ndarray, " n"], time: Float[np.ndarray, " n"]) -> None:
    if values.size > 2 * STRETCHES:
        first = np.arange(STRETCHES) * values.size // STRETCHES
        low, high = (reduce.reduceat(values, first) for reduce in (np.minimum, np.maximum))
        axes.fill_between(time[first], low, high, color=GREY, lw=0.3, label="range")
    else:
        axes.plot(time, values, color=GREY, lw=0.7)
    axes.axhline(0.0, color=DARK, lw=0.8)
    axes.set_xlabel("time t [s]")
    axes.margins(x=0.005)
    axes.grid(alpha=0.25)


def _draw_autocorrelation(axes: Axes, values: Float[np.ndarray, " n"], lags: int, rate_hz: float) -> None:
    centred = values - values.mean()
    R = autocovariance(centred, lags)
    lag = np.arange(1, lags + 1)
    robust, white = robust_band(values, lags), normal_quantile(0.95) / np.sqrt(values.size)
    axes.fill_between(
        lag, -robust, robust, color=BLUE, alpha=0.3, lw=0, label="uncorrelated, varying strength"
    )
    for edge in (-white, white):
        axes.axhline(edge, color=RED, lw=1.0, ls="--", label="white noise, 95 %" if edge > 0.0 else "_")
    axes.vlines(lag, 0.0, R[1:] / R[0], color=DARK, lw=1.2)
    axes.plot(lag, R[1:] / R[0], "o", color=DARK, ms=2.5)
    axes.axhline(0.0, color=DARK, lw=0.8)
    axes.set_xlabel(f"lag [samples of {1.0 / rate_hz:.3g} s]")
    axes.set_ylabel("autocorrelation [-]")
    axes.grid(alpha=0.25)
    legend(axes, size=7)
