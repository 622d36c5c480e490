"""Panels of a flight's figure that say how well each value of a continuous nuisance fits."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from eivor.estimation.candidate import Candidate
from eivor.estimation.estimate import Estimate
from eivor.estimation.search import NuisanceProfile
from eivor.flights.result import FlightEstimate
from eivor.inference.quantiles import chi_square_quantile
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
    lowest = min(candidate.criterion for candidate in estimate.candidates)
    for candidate in estimate.tenable():
        values, height = _curve(candidate, candidate.profiles[number])
        excess = height + candidate.criterion - lowest
        tallest = max(tallest, float(excess.max()))
        axes.plot(values * scale, excess, "-o", ms=2, lw=1.1, label=_choice(candidate, result))
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


def _curve(
    candidate: Candidate, profile: NuisanceProfile
) -> tuple[Float[np.ndarray, " values"], Float[np.ndarray, " values"]]:
    """Values of a nuisance, and the objective above its least there, as chi-square."""
    least = candidate.solution.objective
    # J of a method with instruments; for a direct one the logarithm's slope at its minimum
    height = candidate.criterion if candidate.inference.rank else candidate.rows.response.size
    scale = height / least if least > 0.0 and height > 0.0 else 1.0
    # the refined minimum lies between points of the grid: without it a sharp valley has no bottom
    values = np.append(profile.grid, candidate.at[profile.nuisance.name])
    excess = scale * (np.append(profile.objective, least) - least)
    order = np.argsort(values)
    return values[order], excess[order]


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


def _choice(candidate: Candidate, result: FlightEstimate) -> str:
    """Values of the discrete nuisances, in the motion's words: "delay 10 ms"."""
    refined = {profile.nuisance.name for profile in candidate.profiles}
    told = [
        (result.motion.wording[name], value) for name, value in candidate.at.items() if name not in refined
    ]
    return ", ".join(f"{one.words} {value * one.scale:.3g} {one.shown_unit}".rstrip() for one, value in told)
