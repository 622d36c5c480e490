"""What diagnostics amount to, in sentences that say what to do.

A test speaks at the level .01: four tests of a good estimate are silent together in 96 records of 100.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from eivor.estimation.strength import STRONG_FIRST_STAGE
from eivor.inference.verdict import Reason, Status

if TYPE_CHECKING:
    from eivor.estimation.diagnose import Diagnostics

#: Level of the tests.
SIGNIFICANT = 0.01
#: Bias of least squares, in standard errors of the estimate, that is worth a word.
NOTABLE_BIAS = 0.5
#: Memory from which a residual is not stationary, and its long-run variance not finite.
NOT_STATIONARY = 0.5
#: Condition of the scaled information from which a combination is called badly determined.
BADLY_CONDITIONED = 1e3
#: Change by one of ten segments, in standard errors of the estimate, that is worth a look; 1/3 is usual.
LARGE_LEVERAGE = 1.5


def reasons_of(found: Diagnostics) -> Iterator[Reason]:
    """Grounds against an estimate, and what should be known of it."""
    yield from _instruments(found)
    yield from _equations(found)
    yield from _residual(found)
    yield from _excitation(found)
    yield from _record(found)


def _instruments(found: Diagnostics) -> Iterator[Reason]:
    strength = found.first_stage
    if strength is None:
        return
    remedy = "Use stronger or more recent instruments, a longer record, or an input that moves more."
    needed = np.where(np.isfinite(strength.critical), strength.critical, STRONG_FIRST_STAGE)
    weak = np.flatnonzero(strength.effective < needed)
    for j in weak:
        yield Reason(
            Status.WEAK,
            f"The instruments hardly move the regressor of {found.names[j]} once the others are accounted "
            f"for: effective F is {strength.effective[j]:.3g}, and {needed[j]:.3g} is needed for "
            "a bias below a tenth of its worst.",
            remedy,
        )
    if not weak.size and strength.smallest_eigenvalue < strength.smallest_critical:
        yield Reason(
            Status.WEAK,
            "The instruments move each regressor, but one combination of them hardly: the smallest "
            f"eigenvalue is {strength.smallest_eigenvalue:.3g}, {strength.smallest_critical:.3g} is needed.",
            remedy,
        )


def _equations(found: Diagnostics) -> Iterator[Reason]:
    left_over = found.over_identification
    if left_over is not None and left_over.p_value < SIGNIFICANT:
        yield Reason(
            Status.WEAK,
            f"The instruments disagree about the parameters (J {left_over.J:.3g} on {left_over.degrees} "
            f"degrees, p-value {left_over.p_value:.1g}): one of them is not exogenous, a declared noise is "
            "wrong, or the model lacks a term.",
            "Leave out the most recent lags, check the declared noise, or add the term.",
        )
    against = found.endogeneity
    if against is None or not against.p_value < SIGNIFICANT:
        return
    errors = np.array([found.estimate.std_error(name) for name in found.names])
    apart = -against.difference / errors
    j = int(np.argmax(np.abs(apart)))
    if abs(apart[j]) > NOTABLE_BIAS:
        yield Reason(
            Status.IDENTIFIED,
            f"Least squares would be biased here: {found.names[j]} by {apart[j]:+.1f} standard errors "
            f"(p-value {against.p_value:.1g}).",
            "Keep the instruments.",
        )


def _residual(found: Diagnostics) -> Iterator[Reason]:
    white = found.whiteness
    if white.p_value < SIGNIFICANT:
        yield Reason(
            Status.IDENTIFIED,
            f"The residual is autocorrelated: {white.outside} of {white.autocorrelation.size} lags are "
            f"outside the band, Durbin-Watson is {white.durbin_watson:.3g}.",
            "Keep a covariance that allows for it; white-noise standard errors are wrong here.",
        )
    memory = found.memory
    if memory is not None and memory.memory - 2.0 * memory.order_error > NOT_STATIONARY:
        yield Reason(
            Status.WEAK,
            f"The residual drifts: its memory is {memory.memory:.2f} +- {2.0 * memory.order_error:.2f}, and "
            "from 0.5 on its variance grows with the record.",
            "Add an intercept, whiten or difference the signals, or look for a slow term that is missing.",
        )


def _excitation(found: Diagnostics) -> Iterator[Reason]:
    information = found.information
    if information.condition > BADLY_CONDITIONED:
        yield Reason(
            Status.WEAK,
            f"One combination of the parameters is determined {np.sqrt(information.condition):.0f} times "
            f"worse than another: {information.worst(found.names)}, each in units of its column's rms.",
            "Excite them apart from each other, or fix one of them.",
        )
    for name, share in zip(found.names, found.bands.share_above, strict=False):
        if share < 0.5:
            yield Reason(
                Status.IDENTIFIED,
                f"{1.0 - share:.0%} of what {name} contributes lies in bands where the residual is stronger.",
                "Excite at other frequencies, or harder.",
            )


def _record(found: Diagnostics) -> Iterator[Reason]:
    constant = found.constancy
    if constant is not None and constant.p_value < SIGNIFICANT:
        j = int(np.argmin(constant.p_values))
        yield Reason(
            Status.WEAK,
            f"The parameters change during the record, most likely at {found.when(constant.break_at)}: "
            f"{found.names[j]} by {constant.change[j]:+.3g} (p-value {constant.p_value:.1g} or less).",
            "Identify both parts apart, and look for what changed: load, battery, wind, a mode.",
        )
    leverage = found.leverage
    if leverage is None:
        return
    for j, k in enumerate(leverage.most):
        by = float(leverage.largest[j])
        if abs(by) > LARGE_LEVERAGE:
            first, end = (share / max(found.segments[-1][1], 1) for share in found.segments[k])
            yield Reason(
                Status.WEAK,
                f"One stretch of the record, from {found.when(first)} to {found.when(end)}, moves "
                f"{found.names[j]} by {abs(by):.1f} standard errors.",
                "Look at it, and identify without it.",
            )
