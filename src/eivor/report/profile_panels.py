"""Panels of a flight's figure that say how well each value of a continuous nuisance fits."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from eivor.estimation.estimate import Estimate
from eivor.flights.result import FlightEstimate
from eivor.inference.quantiles import chi_square_quantile
from eivor.report.fit_numbers import profile_curves
from eivor.report.fit_panels import SHADE
from eivor.report.plain_figure import legend
from eivor.shapes import Float

#: The profile is drawn up to so many times the height that bounds a delay, or higher; linear up to
#: that height and logarithmic above it.
PROFILE_HEIGHT = 5.0
#: A grid of positive values whose ends have this ratio or a larger one has a logarithmic axis.
WIDE_RATIO = 10.0
#: Numbers that a logarithmic axis has in each decade.
TICKS = (1, 2, 5)


def draw_no_profile(axes: Axes, result: FlightEstimate) -> None:
    """Say why there is no nuisance whose values could be compared."""
    axes.set_title("How well each lag fits", fontsize=9)
    given = None if result.fit is None else result.fit.given_lag
    why = result.motion.words.no_lag if given is None else f"The lag was given:\n{given.given}."
    axes.text(0.5, 0.5, why, ha="center", va="center", transform=axes.transAxes)
    axes.set_axis_off()


def draw_profile(axes: Axes, result: FlightEstimate, estimate: Estimate, number: int) -> None:
    """Draw the objective against one nuisance, a curve for each combination of discrete ones that fits.

    Parameters
    ----------
    axes : Axes
        Where to.
    result : FlightEstimate
        With words and intervals.
    estimate : Estimate
        Its estimate.
    number : int
        Which of the profiles.
    """
    profile = estimate.best.profiles[number]
    quantity = result.quantities[profile.nuisance.name]
    wording = result.motion.wording[profile.nuisance.name]
    scale = wording.scale
    quantile = chi_square_quantile(0.95)
    tallest = PROFILE_HEIGHT * quantile
    for curve in profile_curves(result, estimate, number):
        tallest = max(tallest, float(curve.excess.max()))
        axes.plot(curve.values * scale, curve.excess, "-o", ms=2, lw=1.1, label=curve.choice)
    _abscissa(axes, profile.grid * scale)
    first, last = axes.get_xlim()  # an interval may have no end, and a logarithm has no zero
    low, high = (float(np.clip(scale * end, first, last)) for end in quantity.interval)
    axes.axvspan(low, high, color=SHADE, alpha=0.18, lw=0, label="95 % interval")
    axes.axvline(scale * quantity.value, color=SHADE, lw=0.7)
    axes.axhline(quantile, color="black", lw=0.7, ls="--", label="95 % by curves")
    axes.set_yscale("symlog", linthresh=quantile)
    axes.set_ylim(-0.15 * quantile, 60.0 * tallest)  # room for the legend above the curves
    axes.set_title(f"How well each {wording.words} fits", fontsize=9, parse_math=False)
    axes.set_xlabel(f"{wording.words} {wording.symbol} [{wording.shown_unit or '-'}]", parse_math=False)
    axes.set_ylabel("objective above its least (χ² units)")
    axes.grid(alpha=0.25)
    legend(axes, size=7, place="upper left", columns=2)


def _abscissa(axes: Axes, grid: Float[np.ndarray, " values"]) -> None:
    """Range of the grid: logarithmic, with round numbers, where it spans a decade."""
    low, high = float(grid[0]), float(grid[-1])
    if low <= 0.0 or high < WIDE_RATIO * low:
        margin = 0.03 * (high - low)
        axes.set_xlim(low - margin, high + margin)
        return
    axes.set_xscale("log")
    low, high = 0.9 * low, 1.1 * high
    axes.set_xlim(low, high)
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    ticks = [tick * 10.0**decade for decade in decades for tick in TICKS]
    shown = [tick for tick in ticks if low <= tick <= high]
    axes.set_xticks(shown, labels=[f"{tick:g}" for tick in shown])
    axes.minorticks_off()
