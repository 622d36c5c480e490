"""Spectral generalized instrumental variables: the method, and its combination with generalized IV.

Both begin with generalized IV. Where the spectral answer contradicts it beyond chance, or cannot be had,
generalized IV's is returned, with the reason.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from eivor.errors import EivorError
from eivor.estimation.candidate import Candidate
from eivor.estimation.estimate import Estimate
from eivor.estimation.fitted_noise import FittedNoise
from eivor.estimation.linear import LinearMethod
from eivor.estimation.method import Method, Problem
from eivor.estimation.spectral.answers import (
    FARTHEST,
    distance_of,
    fallback,
    fallen_back,
    joint_covariance,
    seems_held,
    start_of,
    usual_blend,
    with_grounds,
)
from eivor.estimation.spectral.of_flights import corrected_whitening, spectral_giv_of_flights
from eivor.estimation.spectral.pilot import consistent_estimate, pilot_at
from eivor.estimation.spectral.sampled_motion import SampledMotion
from eivor.estimation.spectral.sampled_problem import (
    SampledProblem,
    problem_of_motion,
    sampled_problem,
    without_spectra,
)
from eivor.estimation.spectral.spectral_covariance import (
    SpectralCovariance,
    spectral_covariance,
    sum_covariance,
)
from eivor.estimation.spectral.spectral_equations import SpectralSolution, solved_equations
from eivor.estimation.spectral.unknown_input import begun, told_input
from eivor.estimation.spectral.weights import power_around
from eivor.estimation.spectral.whitened_rows import solved_rows
from eivor.inference.covariances.covariance import CovariancePart, JointCovariance
from eivor.inference.verdict import Reason, Status
from eivor.models.equation import Parameter
from eivor.models.separable import SeparableProblem
from eivor.shapes import Float

#: Records shorter than this are combined with generalized IV: alone, spectra are not told well enough.
SHORT_RECORD = 400
#: Relative change of the parameters in the last pass beyond which they are no answer.
MOVING = 0.05
BLEND = Parameter("intersample_share", "")


@dataclass(frozen=True, slots=True)
class SpectralGeneralizedIV(Method):
    """Generalized IV of the least variance: both equations of a sampled motion, weighted by their spectra.

    Parameters
    ----------
    name : str
        The word that results and the command line use.
    """

    name: str = "spectral_giv"

    @property
    def needs_instruments(self) -> bool:
        """No: without others, the input's own spectrum serves, less what its noise adds."""
        return False

    @property
    def of_flights(self) -> LinearMethod:
        """By references, without the guard."""
        return corrected_whitening(self.name)

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate friction and gain of a sampled motion; rho too where it is neither 0 nor 1/2.

        Of flights lag and delay are searched for, and the state of the actuators is linear between samples.

        Raises
        ------
        UsageError, MissingNoiseError
            When the problem is no motion with a declared noise of its input.
        """
        if isinstance(problem, SeparableProblem):
            return spectral_giv_of_flights(self.name, problem)
        return _estimated(self.name, problem, alone_from=SHORT_RECORD)


@dataclass(frozen=True, slots=True)
class CombinedSpectralIV(Method):
    """The combination of spectral and plain generalized IV that has the least variance.

    Parameters
    ----------
    name : str
        The word that results and the command line use.
    """

    name: str = "spectral_giv_combined"

    @property
    def needs_instruments(self) -> bool:
        """No: without others, the input's own spectrum serves, less what its noise adds."""
        return False

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate friction and gain of a sampled motion, see `SpectralGeneralizedIV`."""
        return _estimated(self.name, problem, alone_from=math.inf)


def _estimated(name: str, problem: Problem, *, alone_from: float) -> Estimate:
    """Spectral answer, combined with generalized IV's where there are fewer samples than `alone_from`."""
    start = begun(problem, name)
    if isinstance(start, Estimate):
        return start
    checked = problem_of_motion(start.problem, name)
    plain = consistent_estimate(checked)
    lacking = without_spectra(checked)
    if lacking is not None:
        return fallen_back(name, plain, fallback(*lacking))
    sampled = replace(sampled_problem(checked, name), noise_sought=start.sought)
    found = _spectral(sampled, plain)
    if isinstance(found, Reason):
        return fallen_back(name, plain, found)
    if sampled.record.count >= alone_from:
        return found.estimate(name, sampled)
    combined = _combined(name, sampled, plain, found)
    if math.isinf(alone_from):
        return combined
    return replace(combined, reasons=(*combined.reasons, _shortness(sampled.record.count)))


def _shortness(count: int) -> Reason:
    """What is given of a short record; it is no ground against it."""
    return Reason(
        Status.IDENTIFIED,
        f"{count} samples are fewer than {SHORT_RECORD}: this is the combination of the spectral estimate "
        "with generalized IV's that has the least variance, and slow drifts are not taken off.",
        "Record longer for the spectral estimate alone.",
    )


@dataclass(frozen=True)
class _Found:
    """A spectral solution with its covariance."""

    solution: SpectralSolution
    covariance: SpectralCovariance

    @property
    def values(self) -> Float[np.ndarray, " 2"]:
        """Friction and gain."""
        return np.array([self.solution.motion.friction, self.solution.motion.gain])

    def estimate(self, name: str, sampled: SampledProblem) -> Estimate:
        """As an estimate whose rows are the whitened ones."""
        parameters = (*sampled.parameters, BLEND)[: self.solution.parameters]
        candidate = Candidate(
            {}, solved_rows(self.solution, parameters), streamed_covariance=joint_covariance(self.covariance)
        )
        answer = Estimate(name, parameters, (candidate,), noises=self.noises)
        return with_grounds(answer, settled=self.solution.settled)

    @property
    def noises(self) -> tuple[FittedNoise, ...]:
        """Noises that were fitted, that of the input among them where it was sought."""
        if self.solution.noise_test is None:
            return self.solution.noises
        own = told_input(self.solution.input_variance, self.covariance.noise_error)
        return (*self.solution.noises, own)


def _spectral(sampled: SampledProblem, plain: Estimate) -> _Found | Reason:
    """Spectral solution, or why generalized IV's answer must do."""
    start = start_of(sampled, plain)
    if isinstance(start, Reason):
        return start
    try:
        with np.errstate(all="ignore"):
            found = _with_blend(sampled, start)
    except (EivorError, np.linalg.LinAlgError, ValueError):
        return fallback("its equations have no solution near generalized IV's")
    why = _doubt(found, plain)
    return fallback(why) if why else found


def _doubt(found: _Found, plain: Estimate) -> str:
    """Why a solution is not to be believed; empty where it is."""
    values, covariance = found.values, found.covariance.model[:2, :2]
    if not (np.isfinite(values).all() and np.isfinite(covariance).all()):
        return "its search left every number behind"
    if found.solution.change > MOVING:
        return f"its last pass changed it by {found.solution.change:.0%}"
    if values[0] <= 0.0 or values[1] * plain.best.values[1] <= 0.0:
        return f"its friction came out at {values[0]:.3g} 1/s and its gain at {values[1]:.3g}"
    distance = distance_of(plain, values, covariance)
    if distance > FARTHEST:
        return f"it contradicts generalized IV beyond chance (squared distance {distance:.3g})"
    return ""


def _with_blend(sampled: SampledProblem, start: SampledMotion) -> _Found:
    """Solution with an input that is held, where one step towards a free rho finds no other; else rho free.

    Or rho 1/2, where it is near that.
    """
    pilot = pilot_at(start, sampled.input_variance)
    noise_test = 1.0 / power_around(sampled.record.input) if sampled.noise_sought else None
    solved = partial(
        solved_equations,
        input_variance=sampled.input_variance,
        instrument=sampled.instrument,
        noise_test=noise_test,
    )
    held = solved(pilot)
    if seems_held(held):
        return _found(held)
    free = solved(pilot, free_blend=True)
    usual = usual_blend(free)
    if usual is None:
        return _found(free)
    fixed = replace(pilot, motion=replace(free.motion, blend=usual))
    return _found(solved(fixed))


def _found(solution: SpectralSolution) -> _Found:
    return _Found(solution, spectral_covariance(solution))


# -- with generalized IV ----------------------------------------------------------------------------------


def _combined(name: str, sampled: SampledProblem, plain: Estimate, found: _Found) -> Estimate:
    """theta_S - Cov(theta_S, delta) Var(delta)^-1 delta with delta = theta_G - theta_S."""
    influence, count = found.covariance.influence, sampled.record.count
    equation, own = plain.best.equation, found.solution.parameters
    other = np.zeros((count, 2))
    scores = np.linalg.solve(equation.sensitivity, equation.scores.T).T
    other[-scores.shape[0] :] = scores
    series = np.concatenate([influence, other - influence[:, :2]], axis=1)
    joint = sum_covariance(series)
    delta = plain.best.values[:2] - found.values
    weights = np.linalg.solve(joint[own:, own:], joint[own:, :own]).T
    parameters = (*sampled.parameters, BLEND)[:own]
    solved = solved_rows(found.solution, parameters)
    values = solved.solution.theta - weights @ delta
    covariance = joint[:own, :own] - weights @ joint[own:, :own]
    solved = replace(solved, solution=replace(solved.solution, theta=values))
    alone = joint_covariance(found.covariance)
    of_both = CovariancePart("equal_weighted_cosines", covariance, alone.parts[0].degrees)
    candidate = Candidate({}, solved, streamed_covariance=JointCovariance((of_both, *alone.parts)))
    answer = Estimate(name, parameters, (candidate,), noises=found.noises)
    return with_grounds(answer, settled=found.solution.settled)
