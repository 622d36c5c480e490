"""What the flight recipe must reach, and whether a run of the study says that it does."""

from __future__ import annotations

import polars as pl

from eivor.lab.study_run import Share
from validation.flight_recipe.metrics import Score, accepted, accepted_share, score
from validation.flight_recipe.trials import LAG_IGNORED, NONLINEAR
from validation.requirement import Requirement

#: Largest median and 90th percentile of the errors on calm accepted flights: relative, and [s] for the lag.
ERROR_BOUNDS = {
    "viscous_friction": (0.07, 0.22),
    "input_gain": (0.012, 0.05),
    "effective_lag": (0.005, 0.020),
}
#: What the 99 % interval of the coverage of a 95 % interval must meet.
COVERAGE_BOUNDS = (0.92, 0.98)
COVERED = ("viscous_friction", "input_gain", "effective_lag", "hover_input")
LEAST_ACCEPTED = 0.75
MOST_BEYOND_HALF = 0.04
#: A control fails when its coverage is below this, or its mean error on calm flights below the other.
CONTROL_COVERAGE = 0.8
CONTROL_BIAS = -0.2

NAMES = {
    "viscous_friction": "K",
    "input_gain": "K_u",
    "effective_lag": "effective lag",
    "hover_input": "hover input",
}


def requirements(rows: pl.DataFrame, *, allow_chance: bool = False) -> tuple[Requirement, ...]:
    """Judge a run of the study."""
    calm = rows.filter(pl.col("calm"))
    excited = rows.filter(pl.col("kind") == "excited")
    gusty = excited.filter(~pl.col("calm"))
    return (
        *(_small_errors(accepted(calm), quantity) for quantity in ERROR_BOUNDS),
        *(_coverage(accepted(rows), quantity) for quantity in COVERED),
        _enough_accepted(accepted_share(calm), allow_chance=allow_chance),
        _no_hover(accepted_share(rows.filter(pl.col("kind") == "hover"))),
        _few_far_off(score(accepted(rows), "viscous_friction").beyond_half, allow_chance=allow_chance),
        _lag_ignored_fails(score(calm, "viscous_friction", LAG_IGNORED)),
        _least_squares_fails(score(gusty, "viscous_friction", NONLINEAR), allow_chance=allow_chance),
    )


def error_text(quantity: str, value: float) -> str:
    """Error in per cent, or in milliseconds for the lag."""
    return f"{value * 1e3:.1f} ms" if quantity == "effective_lag" else f"{value:.1%}".replace("%", " %")


def share_text(share: Share) -> str:
    """Share with its count and its interval."""
    if not share.count:
        return "-"
    low, high = share.interval
    return f"{share.value:.3f} [{low:.3f}, {high:.3f}] of {share.count}"


def _small_errors(rows: pl.DataFrame, quantity: str) -> Requirement:
    median, ninetieth = ERROR_BOUNDS[quantity]
    result = score(rows, quantity)
    return Requirement(
        f"error of {NAMES[quantity]}, calm accepted flights: median, 90th percentile",
        f"at most {error_text(quantity, median)}, {error_text(quantity, ninetieth)}",
        f"{error_text(quantity, result.median)}, {error_text(quantity, result.ninetieth)}",
        result.median <= median and result.ninetieth <= ninetieth,
    )


def _coverage(rows: pl.DataFrame, quantity: str) -> Requirement:
    low, high = COVERAGE_BOUNDS
    coverage = score(rows, quantity).coverage
    least, most = coverage.interval
    return Requirement(
        f"coverage of the 95 % interval of {NAMES[quantity]}, all accepted flights",
        f"99 % interval meets [{low}, {high}]",
        share_text(coverage),
        least <= high and most >= low,
    )


def _enough_accepted(share: Share, *, allow_chance: bool) -> Requirement:
    reached = share.interval[1] if allow_chance else share.value
    return Requirement(
        "calm excited flights accepted",
        f"at least {LEAST_ACCEPTED}",
        share_text(share),
        reached >= LEAST_ACCEPTED,
    )


def _no_hover(share: Share) -> Requirement:
    return Requirement(
        "constant-reference hovers accepted", "none", f"{share.hits} of {share.count}", share.hits == 0
    )


def _few_far_off(share: Share, *, allow_chance: bool) -> Requirement:
    reached = share.interval[0] if allow_chance else share.value
    return Requirement(
        "accepted flights whose K is off by more than half",
        f"at most {MOST_BEYOND_HALF}",
        share_text(share),
        share.count > 0 and reached <= MOST_BEYOND_HALF,
    )


def _lag_ignored_fails(result: Score) -> Requirement:
    fails = result.bias < CONTROL_BIAS or result.coverage.interval[1] < CONTROL_COVERAGE
    return Requirement(
        "control that must fail: lag ignored, calm flights",
        f"bias of K below {CONTROL_BIAS:.0%}, or coverage below {CONTROL_COVERAGE}".replace("%", " %"),
        f"bias {result.bias:.1%}, coverage {share_text(result.coverage)}".replace("%", " %"),
        fails,
    )


def _least_squares_fails(result: Score, *, allow_chance: bool) -> Requirement:
    reached = result.coverage.interval[0] if allow_chance else result.coverage.value
    return Requirement(
        "control that must fail: nonlinear least squares, gusty flights",
        f"coverage of K below {CONTROL_COVERAGE}",
        f"bias {result.bias:.1%}, coverage {share_text(result.coverage)}".replace("%", " %"),
        reached < CONTROL_COVERAGE,
    )
