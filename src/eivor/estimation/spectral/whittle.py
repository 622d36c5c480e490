"""Whittle maximum likelihood of a sampled motion: a method like the others."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import EivorError, MissingNoiseError
from eivor.estimation.candidate import Candidate
from eivor.estimation.estimate import Estimate
from eivor.estimation.method import Method, Problem
from eivor.estimation.spectral.answers import (
    FARTHEST,
    blend_error,
    distance_of,
    fallback,
    fallen_back,
    joint_covariance,
    seems_held,
    start_of,
    usual_blend,
    with_grounds,
)
from eivor.estimation.spectral.likelihood import Likelihood, maximum_likelihood
from eivor.estimation.spectral.of_flights import whittle_of_flights
from eivor.estimation.spectral.pilot import consistent_estimate, pilot_at
from eivor.estimation.spectral.sampled_problem import (
    SampledProblem,
    problem_of_motion,
    sampled_problem,
    without_spectra,
)
from eivor.estimation.spectral.spectral_covariance import spectral_covariance
from eivor.estimation.spectral.spectral_equations import SpectralSolution, solved_equations
from eivor.estimation.spectral.weights import signal_weights
from eivor.estimation.spectral.whitened_rows import solved_rows
from eivor.inference.verdict import Reason, Status
from eivor.models.separable import SeparableProblem
from eivor.shapes import Float

#: What to do about a likelihood whose assumptions do not hold.
USE = "Use spectral_giv, which does not assume these."


@dataclass(frozen=True, slots=True)
class WhittleLikelihood(Method):
    """Maximum likelihood in frequency, with noises as they are declared and all others fitted.

    That of the input must be declared, those of velocity and acceleration may be; a disturbance is fitted.

    Parameters
    ----------
    name : str
        The word that results and the command line use.

    Notes
    -----
    Efficient where the noises are what the model takes them for, and biased where they are not. The input is
    taken as held between samples; that is tested as `SpectralGeneralizedIV` does, and an estimate from an
    input that is not held is weak.
    """

    name: str = "whittle_ml"

    @property
    def needs_instruments(self) -> bool:
        """No; instruments of the pilot are taken where a problem has some."""
        return False

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate friction and gain of a sampled motion.

        Raises
        ------
        UsageError, MissingNoiseError
            When the problem is no motion with a declared noise of its input.
        """
        if isinstance(problem, SeparableProblem):
            return whittle_of_flights(self.name, problem)
        checked = problem_of_motion(problem, self.name)
        plain = consistent_estimate(checked)
        lacking = without_spectra(checked)
        if lacking is not None:
            return fallen_back(self.name, plain, fallback(*lacking))
        sampled = sampled_problem(checked, self.name)
        if sampled.instrument is not None:
            raise MissingNoiseError(
                f"an open loop for {self.name}",
                "instruments of another channel than the input",
                "Under control use spectral_giv.",
            )
        found = self._likelihood(sampled, plain)
        if isinstance(found, Reason):
            return fallen_back(self.name, plain, found)
        solution = _as_solution(sampled, found)
        solved = solved_rows(solution, sampled.parameters)
        values = np.array([found.motion.friction, found.motion.gain])
        solved = replace(solved, solution=replace(solved.solution, theta=values))
        covariance = spectral_covariance(solution)
        candidate = Candidate({}, solved, streamed_covariance=joint_covariance(covariance))
        answer = Estimate(self.name, sampled.parameters, (candidate,), noises=found.noises)
        answer = with_grounds(answer, settled=found.settled)
        reasons = (*_contradiction(plain, values, covariance.model), *_not_held(sampled, found, solution))
        return replace(answer, reasons=(*answer.reasons, *reasons))

    def _likelihood(self, sampled: SampledProblem, plain: Estimate) -> Likelihood | Reason:
        start = start_of(sampled, plain)
        if isinstance(start, Reason):
            return start
        try:
            with np.errstate(all="ignore"):
                pilot = pilot_at(start, sampled.input_variance, sampled.declared)
                found = maximum_likelihood(pilot)
        except (EivorError, np.linalg.LinAlgError, ValueError):
            return fallback("its search failed near generalized IV's numbers")
        friction, gain = found.motion.friction, found.motion.gain
        if not (np.isfinite(gain) and friction > 0.0 and gain * start.gain > 0.0):
            return fallback(f"its friction came out at {friction:.3g} 1/s")
        return found


def _contradiction(
    plain: Estimate, values: Float[np.ndarray, " 2"], covariance: Float[np.ndarray, "2 2"]
) -> tuple[Reason, ...]:
    """Ground against numbers that generalized IV, which assumes less, contradicts; the numbers stay."""
    distance = distance_of(plain, values, covariance)
    if not distance > FARTHEST:
        return ()
    sentence = (
        f"It contradicts generalized IV beyond chance (squared distance {distance:.3g}): a noise, or the "
        "input between samples, is not what the likelihood takes it for."
    )
    return (Reason(Status.WEAK, sentence, USE),)


def _not_held(sampled: SampledProblem, found: Likelihood, solution: SpectralSolution) -> tuple[Reason, ...]:
    """Ground against numbers from an input that is not held between samples; the numbers stay."""
    with np.errstate(all="ignore"):
        if seems_held(solution):
            return ()
        try:
            pilot = pilot_at(found.motion, sampled.input_variance)
            free = solved_equations(pilot, sampled.input_variance, free_blend=True)
        except (EivorError, np.linalg.LinAlgError, ValueError):
            return (Reason(Status.WEAK, "Whether the input is held between samples cannot be told.", USE),)
        if usual_blend(free) == 0.0:
            return ()
        error = blend_error(free)
    sentence = (
        "The input is not held between samples, as the likelihood takes it: the share of the next sample is "
        f"{free.motion.blend:.2g} +- {error:.1g}, where 0 is held and 0.5 is linear."
    )
    return (Reason(Status.WEAK, sentence, USE),)


def _as_solution(sampled: SampledProblem, found: Likelihood) -> SpectralSolution:
    """Spectral equations at the likelihood's numbers, whose covariance is its own where the model holds."""
    bins = sampled.record.input
    return SpectralSolution(
        found.motion,
        np.array([found.transient]),
        found.noise.spectrum(found.motion),
        bins,
        sampled.input_variance,
        np.sqrt(signal_weights(bins, sampled.input_variance)),
        np.ones(bins.size),
        free_blend=False,
        change=0.0 if found.settled else np.inf,
    )
