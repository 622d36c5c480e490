"""What spectral methods answer when they cannot answer, and what their numbers rest on."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np

from eivor.errors import FallbackWarning
from eivor.estimation.estimate import Estimate
from eivor.estimation.spectral.sampled_motion import SampledMotion
from eivor.estimation.spectral.sampled_problem import SampledProblem
from eivor.estimation.spectral.spectral_covariance import SpectralCovariance, spectral_covariance
from eivor.estimation.spectral.spectral_equations import SpectralSolution
from eivor.estimation.strength import user_level
from eivor.inference.covariances.covariance import CovariancePart, JointCovariance
from eivor.inference.covariances.equal_weighted_cosines import COSINE_AVERAGES
from eivor.inference.covariances.estimators import EqualWeightedCosines
from eivor.inference.sets.ellipse import hotelling_quantile
from eivor.inference.verdict import Reason, Status
from eivor.shapes import Float

#: Distance of the two answers that chance exceeds once in a thousand times. Generalized IV's covariance,
#: which outweighs the other, is told by few cosine averages: beyond 13.8, the limit with a known covariance,
#: are three good answers in a hundred.
FARTHEST = hotelling_quantile(0.999, 2, COSINE_AVERAGES)

#: What the input may do between samples, and how near, in standard errors, counts as that: chance is farther
#: once in 370 times, and where it is, a free rho may double the error of the gain.
USUAL_BLENDS, NEAR_BLEND = (0.0, 0.5), 3.0


def seems_held(held: SpectralSolution) -> bool:
    """Whether one step towards a free rho leaves a solution with a held input at rho 0."""
    freed = replace(held, free_blend=True)
    return usual_blend(replace(freed, motion=freed.stepped())) == 0.0


def usual_blend(free: SpectralSolution) -> float | None:
    """The usual rho that a free one is within three standard errors of; None where it is near none."""
    blend = free.motion.blend
    usual = min(USUAL_BLENDS, key=lambda one: abs(blend - one))
    return usual if abs(blend - usual) <= NEAR_BLEND * blend_error(free) else None


def blend_error(free: SpectralSolution) -> float:
    """Standard error of a free rho, the larger one of both covariances."""
    of_blend = spectral_covariance(free, slice(2, 3))
    return float(np.sqrt(max(of_blend.model[0, 0], of_blend.in_time[0, 0])))


def joint_covariance(covariance: SpectralCovariance) -> JointCovariance:
    """Both covariances, of which an interval takes the wider, on the fewest degrees of freedom."""
    degrees = float(covariance.degrees.min())
    return JointCovariance(
        (
            CovariancePart("spectral_model", covariance.model, degrees),
            CovariancePart("spectral_in_time", covariance.in_time, degrees),
        )
    )


def with_grounds(estimate: Estimate, *, settled: bool) -> Estimate:
    """Estimate with the grounds against it: passes that ran out, parameters that may be zero."""
    reasons: list[Reason] = []
    if not settled:
        reasons.append(
            Reason(
                Status.WEAK,
                "The spectra of the residuals had not come to rest when the passes ran out.",
                "Record longer, or compare with generalized_iv.",
            )
        )
    for parameter in estimate.joint_parameters[:2]:
        low, high = estimate.interval(parameter.name)
        if low <= 0.0 <= high:
            reasons.append(
                Reason(
                    Status.WEAK,
                    f"The {parameter.name.replace('_', ' ')} cannot be told from zero: its interval is "
                    f"[{low:.3g}, {high:.3g}] {parameter.unit}.",
                    "Excite more, or record longer.",
                )
            )
    return replace(estimate, reasons=tuple(reasons))


#: What to do about numbers that a search did not reach.
EXCITE = "Excite more, or record longer; and see that the input holds between samples as it was meant to."


def fallback(why: str, remedy: str = EXCITE) -> Reason:
    """Ground on which generalized IV's numbers stand in, and what to do about it."""
    return Reason(
        Status.WEAK,
        f"The spectral estimate is not given, since {why}: these are generalized IV's numbers.",
        remedy,
    )


def start_of(sampled: SampledProblem, plain: Estimate) -> SampledMotion | Reason:
    """Motion at generalized IV's numbers, or why nothing can begin there."""
    friction, gain = (float(value) for value in plain.best.values[:2])
    if friction > 0.0 and gain != 0.0:
        return SampledMotion(sampled.record, friction, gain)
    return fallback(f"generalized IV, from which it begins, has a friction of {friction:.3g} 1/s")


def distance_of(
    plain: Estimate, values: Float[np.ndarray, " 2"], covariance: Float[np.ndarray, "2 2"]
) -> float:
    """Squared distance of friction and gain from generalized IV's, in the errors of both."""
    between = plain.best.values[:2] - values
    own = plain.with_covariance(EqualWeightedCosines()).covariance[:2, :2]
    spread = np.diag(np.maximum(np.diag(covariance), 0.0)) + own
    return float(between @ np.linalg.solve(spread, between))


def fallen_back(name: str, plain: Estimate, reason: Reason) -> Estimate:
    """Generalized IV's answer, with the reason as a warning too.

    Warns
    -----
    FallbackWarning
        Always.
    """
    warnings.warn(f"{reason.sentence} {reason.remedy}", FallbackWarning, stacklevel=user_level())
    answer = plain.with_covariance(EqualWeightedCosines())
    return replace(answer, method=name, reasons=(*plain.reasons, reason))
