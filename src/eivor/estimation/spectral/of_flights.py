"""Spectral methods of flights, whose actuators lag: the linear methods that they are, a guard, the noises.

Lag and delay are nuisances as for every other method of flights. References are instruments, the closed-loop
form of `spectral_giv`: they share no noise with the input, so that nothing is compensated.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from eivor.errors import EstimationError
from eivor.estimation.assembler import Direct, Instrumental
from eivor.estimation.candidate import Candidate
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod
from eivor.estimation.methods import generalized_iv
from eivor.estimation.spectral.pair_whitening import CorrectedSpectra, ModelledSpectra, PairWhitening
from eivor.estimation.spectral.paired_bins import paired_bins
from eivor.inference.covariances.equal_weighted_cosines import COSINE_AVERAGES
from eivor.inference.sets.ellipse import hotelling_quantile
from eivor.inference.verdict import Reason, Status
from eivor.linalg import LeastSquares
from eivor.models.separable import SeparableProblem

#: Share of right pairs of answers that are no farther apart than is allowed.
ALLOWED = 0.999


def corrected_whitening(name: str) -> LinearMethod:
    """Instrumental least squares of both equations, by corrected spectra."""
    return LinearMethod(name, Instrumental(), LeastSquares(), PairWhitening(CorrectedSpectra()))


def spectral_giv_of_flights(name: str, problem: SeparableProblem) -> Estimate:
    """Instrumental estimate of both equations, or generalized IV's where that contradicts it beyond chance.

    Raises
    ------
    EstimationError
        When the motion has no state whose derivative was measured, or neither method has an answer.
    """
    paired_bins(
        problem, np.zeros(problem.bins(problem.first_values).regressors.shape[1]), problem.first_values
    )
    try:
        found = corrected_whitening(name).estimate(problem)
    except (EstimationError, np.linalg.LinAlgError):
        return _instead(name, generalized_iv().estimate(problem), "its equations have no solution")
    try:
        plain = generalized_iv().estimate(problem)
    except (EstimationError, np.linalg.LinAlgError):
        return with_noises(problem, found)
    distance, farthest = _apart(found, plain)
    if distance > farthest:
        why = f"it contradicts generalized IV beyond chance (squared distance {distance:.3g})"
        return _instead(name, plain, why)
    return with_noises(problem, found)


def whittle_of_flights(name: str, problem: SeparableProblem) -> Estimate:
    """Least squares of both equations, weighted by the noises of the largest likelihood.

    Raises
    ------
    EstimationError
        When the motion has no state whose derivative was measured, or the search does not settle.
    """
    method = LinearMethod(name, Direct(), LeastSquares(), PairWhitening(ModelledSpectra()))
    return with_noises(problem, method.estimate(problem))


def with_noises(problem: SeparableProblem, estimate: Estimate) -> Estimate:
    """Estimate with the noises that fit what it leaves."""
    best = estimate.best
    pairs = paired_bins(problem, best.theta, best.at)
    return replace(estimate, noises=pairs.told(problem.bins(best.at)))


def _instead(name: str, plain: Estimate, why: str) -> Estimate:
    reason = Reason(
        Status.WEAK,
        f"The spectral estimate is not given, since {why}: these are generalized IV's numbers.",
        "Compare with reference_iv; fly longer, or with more excitation.",
    )
    return replace(plain, method=name, reasons=(*plain.reasons, reason))


def _apart(found: Estimate, plain: Estimate) -> tuple[float, float]:
    """Least squared distance of the linear parameters of two estimates, and what chance hardly exceeds.

    Of every candidate that fits with every other one: parameters follow the discrete nuisances.
    """
    count = found.best.theta.size
    farthest = hotelling_quantile(ALLOWED, count, COSINE_AVERAGES)
    pairs = product(found.tenable(), plain.tenable())
    return min(_squared_distance(one, other) for one, other in pairs), farthest


def _squared_distance(one: Candidate, other: Candidate) -> float:
    count = one.theta.size
    between = one.theta - other.theta
    spread = one.covariance.matrix[:count, :count] + other.covariance.matrix[:count, :count]
    return float(between @ np.linalg.lstsq(spread, between, rcond=None)[0])
