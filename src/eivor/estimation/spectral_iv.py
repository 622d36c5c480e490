"""Spectral generalized instrumental variables and Whittle likelihood."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy

from eivor.errors import EivorError, EstimationError, FallbackWarning, MissingNoiseError
from eivor.estimation import sampled_motion as sampling
from eivor.estimation import spectral_equations as spectral
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod, Method, Problem, user_level
from eivor.estimation.moments import Direct, FittedNoise, Instrumental
from eivor.estimation.pair_whitening import PairWhitening, paired_bins, power_around, signal_weights
from eivor.estimation.unknown_noise import NoiseEstimatingIV
from eivor.inference.covariance import COSINE_AVERAGES, CovariancePart, EqualWeightedCosines, JointCovariance
from eivor.inference.regions import hotelling_quantile
from eivor.inference.verdict import Reason, Status
from eivor.linalg.total_least_squares import LeastSquares
from eivor.models.regression import Parameter
from eivor.models.separable import SeparableProblem
from eivor.models.signal_regression import SignalRegression
from eivor.signals.noise import WhiteNoise
from eivor.tools import Float

#: Distance of the two answers that chance exceeds once in a thousand times. Generalized IV's covariance,
#: which outweighs the other, is identified by few cosine averages: beyond 13.8, the limit with a known
#: covariance, are three good answers in a hundred.
FARTHEST = 49.57485384009213  # hotelling_quantile(0.999, 2, COSINE_AVERAGES), which would load SciPy

#: What the input may do between samples, and how near, in standard errors, counts as that: chance is farther
#: once in 370 times, and where it is, a free rho may double the error of the gain.
USUAL_BLENDS, NEAR_BLEND = (0.0, 0.5), 3.0


def seems_held(held: spectral.SpectralSolution) -> bool:
    """Whether one step towards a free rho leaves a solution with a held input at rho 0."""
    freed = replace(held, free_blend=True)
    return usual_blend(replace(freed, motion=freed.stepped())) == 0.0


def usual_blend(free: spectral.SpectralSolution) -> float | None:
    """The usual rho that a free one is within three standard errors of; None where it is near none."""
    blend = free.motion.blend
    usual = min(USUAL_BLENDS, key=lambda item: abs(blend - item))
    return usual if abs(blend - usual) <= NEAR_BLEND * blend_error(free) else None


def blend_error(free: spectral.SpectralSolution) -> float:
    """Standard error of a free rho, the larger one of both covariances."""
    covariance = spectral.spectral_covariance(free, slice(2, 3))
    return float(np.sqrt(max(covariance.model[0, 0], covariance.in_time[0, 0])))


def joint_covariance(covariance: spectral.SpectralCovariance) -> JointCovariance:
    """Both covariances, of which an interval takes the wider, on the fewest degrees of freedom."""
    degrees = float(covariance.degrees.min())
    matrices = {"spectral_model": covariance.model, "spectral_in_time": covariance.in_time}
    return JointCovariance(tuple(CovariancePart(name, item, degrees) for name, item in matrices.items()))


def with_reasons(
    name: str, candidate: Estimate, noises: tuple[FittedNoise, ...], *, converged: bool
) -> Estimate:
    """Estimate with the reasons against it: passes that ran out, parameters that may be zero."""
    estimate = replace(candidate, method=name, joint_parameters=candidate.rows.parameters, noises=noises)
    reasons: list[Reason] = []
    if not converged:
        sentence = "The spectra of the residuals had not come to rest when the passes ran out."
        reasons.append(Reason(Status.WEAK, sentence, "Record longer, or compare with generalized_iv."))
    for parameter in estimate.joint_parameters[:2]:
        low, high = estimate.interval(parameter.name)
        if low <= 0.0 <= high:
            sentence = (
                f"The {parameter.name.replace('_', ' ')} cannot be distinguished from zero: its "
                f"interval is [{low:.3g}, {high:.3g}] {parameter.unit}."
            )
            reasons.append(Reason(Status.WEAK, sentence, "Excite more, or record longer."))
    return replace(estimate, met=tuple(reasons))


#: What to do about numbers that a search did not reach.
EXCITE = "Excite more, or record longer; and see that the input holds between samples as it was meant to."
COMPARE = "Compare with reference_iv; fly longer, or with more excitation."
CONTRADICTS = "it contradicts generalized IV beyond chance"


def substitute(name: str, plain: Estimate, why: str, remedy: str = EXCITE) -> Estimate:
    """Generalized IV's answer, with the reason why it stands in and what to do about it."""
    sentence = f"The spectral estimate is not given, since {why}: these are generalized IV's numbers."
    return replace(plain, method=name, met=(*plain.met, Reason(Status.WEAK, sentence, remedy)))


def start_of(sampled: sampling.SampledProblem, plain: Estimate) -> sampling.SampledMotion:
    """Motion at generalized IV's numbers; a `SpectraError` where these are no start."""
    friction, gain = (float(value) for value in plain.values[:2])
    if friction > 0.0 and gain != 0.0:
        return sampling.SampledMotion(sampled.record, friction, gain)
    raise sampling.SpectraError(f"generalized IV, from which it begins, has a friction of {friction:.3g} 1/s")


def distance_of(plain: Estimate, solution: spectral.SpectralSolution) -> float:
    """Squared distance of friction and gain from generalized IV's, in the errors of both."""
    difference = plain.values[:2] - solution.values
    instrument_covariance = plain.with_covariance(EqualWeightedCosines()).covariance[:2, :2]
    spread = np.diag(np.maximum(np.diag(solution.covariance.model[:2, :2]), 0.0)) + instrument_covariance
    return float(difference @ np.linalg.solve(spread, difference))


def fall_back(name: str, plain: Estimate, error: sampling.SpectraError) -> Estimate:
    """Generalized IV's answer, with a warning."""
    answer = substitute(name, plain.with_covariance(EqualWeightedCosines()), *error.args)
    reason = answer.met[-1]
    warnings.warn(f"{reason.sentence} {reason.remedy}", FallbackWarning, stacklevel=user_level())
    return answer


#: Passes of noises and parameters, and the change relative to the parameters that ends them.
LIKELIHOOD_PASSES, LIKELIHOOD_TOLERANCE = 8, 1e-5
#: Searches of the parameters end after so many evaluations.
EVALUATIONS = 60


def minimise_quadratic(
    motion: sampling.SampledMotion,
    transient: float,
    spectrum: Callable[[sampling.SampledMotion], sampling.PairSpectrum],
) -> tuple[sampling.SampledMotion, float, bool]:
    """Minimum of Q at given noises, by least squares of the whitened residuals; and whether it is one."""
    units = np.array([motion.friction, motion.gain, max(abs(transient), 1e-3 * abs(motion.gain))])

    def motion_at(x: Float[np.ndarray, " 3"]) -> tuple[sampling.SampledMotion, float]:
        friction, gain, t = (x * units).tolist()
        return replace(motion, friction=friction, gain=gain), t

    def whitened(x: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " rows"]:
        trial, t = motion_at(x)
        residual = spectrum(trial).whitened(trial.steady_state(t)).ravel()
        return np.concatenate([residual.real, residual.imag])

    first = np.array([1.0, 1.0, transient / units[2]])
    evaluations = EVALUATIONS * first.size
    squares = scipy.optimize.least_squares(
        whitened, first, method="lm", max_nfev=evaluations, xtol=1e-9, ftol=1e-10
    )
    return *motion_at(squares.x), bool(squares.success)


#: Probability that two consistent estimates are no farther apart than is allowed.
ALLOWED = 0.999


def corrected_whitening(name: str) -> LinearMethod:
    """Instrumental least squares of both equations, by corrected spectra."""
    return LinearMethod(name, Instrumental(), LeastSquares(), PairWhitening(corrected=True))


def spectral_giv_of_flights(name: str, problem: SeparableProblem) -> Estimate:
    """Instrumental estimate of both equations."""
    first = problem.first_values
    paired_bins(problem, np.zeros(problem.bins(first).regressors.shape[1]), first)
    try:
        result = corrected_whitening(name).estimate(problem)
    except (EstimationError, np.linalg.LinAlgError):
        why = "its equations have no solution"
        return substitute(name, spectral.GENERALIZED_IV.estimate(problem), why, COMPARE)
    try:
        plain = spectral.GENERALIZED_IV.estimate(problem)
    except (EstimationError, np.linalg.LinAlgError):
        return with_noises(problem, result)
    distance = _squared_distance(result, plain)
    if distance > hotelling_quantile(ALLOWED, result.theta.size, COSINE_AVERAGES):
        return substitute(name, plain, f"{CONTRADICTS} (squared distance {distance:.3g})", COMPARE)
    return with_noises(problem, result)


def with_noises(problem: SeparableProblem, estimate: Estimate) -> Estimate:
    """Estimate with the noises that fit its residuals."""
    pairs = paired_bins(problem, estimate.theta, estimate.nuisances)
    return replace(estimate, noises=pairs.fitted_noises(problem.bins(estimate.nuisances)))


def _squared_distance(estimate: Estimate, other: Estimate) -> float:
    count = estimate.theta.size
    difference = estimate.theta - other.theta
    spread = estimate.covariance[:count, :count] + other.covariance[:count, :count]
    return float(difference @ np.linalg.lstsq(spread, difference, rcond=None)[0])


#: Least share of the input's variance that a search begins at.
LEAST_SHARE = 1e-6


def input_noise_start(problem: Problem, method: str) -> tuple[Problem, bool] | Estimate:
    """Problem with a noise of its input to begin with, and whether that is a rough estimate."""
    if not isinstance(problem, SignalRegression):
        return problem, False
    _, _, driver = sampling.motion_of(problem, method)
    if driver in problem.signals.noise:
        return problem, False
    problem = sampling.with_instruments(problem, driver)
    if not sampling.is_own_instrument(problem, driver):
        return _with_noise(problem, driver, 0.0), False  # nothing is taken off
    try:
        result = NoiseEstimatingIV("generalized_iv_unknown_noise").estimate(problem)
    except (EivorError, np.linalg.LinAlgError) as error:
        expected = f"the noise of {driver}, which {method} takes off, or an input that identifies it"
        remedy = "Declare it: Signals(..., noise={'input': ev.WhiteNoise(0.01)}); zero says that it is exact."
        raise MissingNoiseError(expected, f"none that is declared; and {error}", remedy) from error
    if result.status is Status.REFUSED:
        return replace(result, method=method)
    floor = LEAST_SHARE * float(np.var(problem.signals.channel(driver)))
    variance = max(result.parameters[f"noise_variance_{driver}"], floor)
    return _with_noise(problem, driver, float(np.sqrt(variance))), True


def _with_noise(problem: SignalRegression, driver: str, std: float) -> SignalRegression:
    noise = {**problem.signals.noise, driver: WhiteNoise(std)}
    return replace(problem, signals=replace(problem.signals, noise=noise))


#: Records shorter than this are combined with generalized IV: alone, spectra are not identified well enough.
SHORT_RECORD = 400
#: Relative change of the parameters in the last pass beyond which they are no answer.
MOVING = 0.05
BLEND = Parameter("intersample_share", "")


@dataclass(frozen=True, slots=True)
class SpectralGeneralizedIV(Method):
    """Generalized IV of the least variance: both equations of a sampled motion, weighted by their spectra."""

    name: str = "spectral_giv"  # The word that results and the command line use
    alone_from: float = SHORT_RECORD  # Samples; of fewer it is combined with generalized IV
    needs_instruments = False  # Without others, the input's own spectrum serves, less what its noise adds

    @property
    def of_flights(self) -> LinearMethod:
        return corrected_whitening(self.name)

    def estimate(self, problem: Problem) -> Estimate:
        """Estimate friction and gain of a sampled motion; rho too where it is neither 0 nor 1/2."""
        always_combined = math.isinf(self.alone_from)
        if isinstance(problem, SeparableProblem) and not always_combined:
            return spectral_giv_of_flights(self.name, problem)
        start = input_noise_start(problem, self.name)
        if isinstance(start, Estimate):
            return start
        checked = sampling.problem_of_motion(start[0], self.name)
        plain = spectral.consistent_estimate(checked)
        try:
            sampled = replace(sampling.sampled_problem(checked, self.name), noise_estimated=start[1])
            solution, count = _spectral(sampled, plain), sampled.record.count
        except sampling.SpectraError as error:
            return fall_back(self.name, plain, error)
        candidate = spectral.solved_rows(
            solution, (*sampled.problem.parameters, BLEND)[: solution.parameters]
        )
        if count >= self.alone_from:
            candidate = replace(candidate, streamed_covariance=joint_covariance(solution.covariance))
        else:
            candidate = _combined(candidate, plain, solution)
        answer = with_reasons(self.name, candidate, _noises(solution), converged=solution.converged)
        if count >= self.alone_from or always_combined:
            return answer
        sentence = (  # of a short record, and no reason against it
            f"{count} samples are fewer than {SHORT_RECORD}: this is the combination of the spectral "
            "estimate with generalized IV's that has the least variance, and slow drifts are not taken off."
        )
        short = Reason(Status.IDENTIFIED, sentence, "Record longer for the spectral estimate alone.")
        return replace(answer, met=(*answer.met, short))


def _noises(solution: spectral.SpectralSolution) -> tuple[FittedNoise, ...]:
    if solution.noise_test is None:
        return solution.noises
    error, strength = solution.covariance.noise_error, math.sqrt(max(solution.input_variance, 0.0))
    by_root = 0.5 * error / strength if strength else math.sqrt(error)
    return (*solution.noises, FittedNoise("input", strength, by_root, 0.0, 0.0, sampling.MEASURE))


def _spectral(sampled: sampling.SampledProblem, plain: Estimate) -> spectral.SpectralSolution:
    """Spectral solution with its covariance; a `SpectraError` where generalized IV's answer must do."""
    try:
        with np.errstate(all="ignore"):
            solution = _with_blend(sampled, start_of(sampled, plain))
            why = _doubt(solution, plain)
    except (EivorError, np.linalg.LinAlgError, ValueError) as error:
        raise sampling.SpectraError("its equations have no solution near generalized IV's") from error
    if why:
        raise sampling.SpectraError(why)
    return solution


def _doubt(solution: spectral.SpectralSolution, plain: Estimate) -> str:
    values, covariance = solution.values, solution.covariance.model[:2, :2]
    if not (np.isfinite(values).all() and np.isfinite(covariance).all()):
        return "its search left every number behind"
    if solution.change > MOVING:
        return f"its last pass changed it by {solution.change:.0%}"
    if values[0] <= 0.0 or values[1] * plain.values[1] <= 0.0:
        return f"its friction came out at {values[0]:.3g} 1/s and its gain at {values[1]:.3g}"
    distance = distance_of(plain, solution)
    return f"{CONTRADICTS} (squared distance {distance:.3g})" if distance > FARTHEST else ""


def _with_blend(sampled: sampling.SampledProblem, start: sampling.SampledMotion) -> spectral.SpectralSolution:
    """Solution with an input that is held, where one step towards a free rho finds no other."""
    pilot = spectral.pilot_at(start, sampled.input_variance)
    solved = partial(
        spectral.solved_equations,
        input_variance=sampled.input_variance,
        instrument=sampled.instrument,
        noise_test=1.0 / power_around(sampled.record.input) if sampled.noise_estimated else None,
    )
    held = solved(pilot)
    if seems_held(held):
        return held
    free = solved(pilot, free_blend=True)
    usual = usual_blend(free)
    return free if usual is None else solved(replace(pilot, motion=replace(free.motion, blend=usual)))


def _combined(candidate: Estimate, plain: Estimate, solution: spectral.SpectralSolution) -> Estimate:
    """theta_S - Cov(theta_S, delta) Var(delta)^-1 delta with delta = theta_G - theta_S."""
    influence, equation, n = solution.covariance.influence, plain.equation, solution.parameters
    plain_influence = np.zeros((influence.shape[0], 2))
    scores = np.linalg.solve(equation.sensitivity, equation.scores.T).T
    plain_influence[-scores.shape[0] :] = scores
    joint = spectral.sum_covariance(np.concatenate([influence, plain_influence - influence[:, :2]], axis=1))
    weights = np.linalg.solve(joint[n:, n:], joint[n:, :n]).T
    theta = candidate.theta - weights @ (plain.values[:2] - solution.values)
    marginal = joint_covariance(solution.covariance)
    matrix = joint[:n, :n] - weights @ joint[n:, :n]
    combined = CovariancePart("equal_weighted_cosines", matrix, marginal.parts[0].degrees)
    new, covariance = replace(candidate.solution, theta=theta), JointCovariance((combined, *marginal.parts))
    return replace(candidate, solution=new, streamed_covariance=covariance)


#: What to do about a likelihood whose assumptions do not hold.
USE = "Use spectral_giv, which does not assume these."


@dataclass(frozen=True, slots=True)
class WhittleLikelihood(Method):
    """Maximum likelihood in frequency, with noises as they are declared and all others fitted."""

    name: str = "whittle_ml"  # The word that results and the command line use
    needs_instruments = False  # Instruments of the pilot are taken where a problem has some

    def estimate(self, problem: Problem) -> Estimate:
        if isinstance(problem, SeparableProblem):
            method = LinearMethod(self.name, Direct(), LeastSquares(), PairWhitening(corrected=False))
            return with_noises(problem, method.estimate(problem))
        checked = sampling.problem_of_motion(problem, self.name)
        plain = spectral.consistent_estimate(checked)
        try:
            sampled = sampling.sampled_problem(checked, self.name)
            if sampled.instrument is not None:
                expected = f"an open loop for {self.name}"
                remedy = "Under control use spectral_giv."
                raise MissingNoiseError(expected, "instruments of another channel than the input", remedy)
            solution = self._likelihood(sampled, plain)
        except sampling.SpectraError as error:
            return fall_back(self.name, plain, error)
        solved = spectral.solved_rows(solution, sampled.problem.parameters)
        candidate = replace(
            solved,
            solution=replace(solved.solution, theta=solution.values),
            streamed_covariance=joint_covariance(solution.covariance),
        )
        answer = with_reasons(self.name, candidate, solution.noises, converged=solution.converged)
        reasons, distance = list(answer.reasons), distance_of(plain, solution)
        if distance > FARTHEST:
            sentence = (
                f"It contradicts generalized IV beyond chance (squared distance {distance:.3g}): a noise, or "
                "the input between samples, is not what the likelihood takes it for."
            )
            reasons.append(Reason(Status.WEAK, sentence, USE))
        return replace(answer, met=(*reasons, *_not_held(solution)))

    @staticmethod
    def _likelihood(sampled: sampling.SampledProblem, plain: Estimate) -> spectral.SpectralSolution:
        start = start_of(sampled, plain)
        try:
            with np.errstate(all="ignore"):
                pilot = spectral.pilot_at(start, sampled.input_variance, sampled.declared)
                # search from a pilot, with the noises that are not declared fitted anew
                motion, transient, noise = pilot.motion, pilot.transient, pilot.noise
                refined = False
                for _ in range(LIKELIHOOD_PASSES):
                    previous = np.array([motion.friction, motion.gain])
                    motion, transient, result = minimise_quadratic(motion, transient, noise.spectrum)
                    change = np.abs(np.array([motion.friction, motion.gain]) - previous)
                    refined = result and bool((change <= LIKELIHOOD_TOLERANCE * np.abs(previous)).all())
                    if refined:
                        break
                    noise = sampling.fitted_noise(motion, motion.steady_state(transient), noise, pilot.prior)
                noises = sampling.fitted_noises(
                    motion, motion.steady_state(transient), noise, pilot.prior, sampling.MEASURE
                )
        except (EivorError, np.linalg.LinAlgError, ValueError) as error:
            raise sampling.SpectraError("its search failed near generalized IV's numbers") from error
        if not (np.isfinite(motion.gain) and motion.friction > 0.0 and motion.gain * start.gain > 0.0):
            raise sampling.SpectraError(f"its friction came out at {motion.friction:.3g} 1/s")
        # spectral equations at the likelihood's numbers, whose covariance is its own where the model holds
        bins, variance = sampled.record.input, sampled.input_variance
        weights, factors = np.sqrt(signal_weights(bins, variance)), np.ones(bins.size)
        numbers = motion, np.array([transient]), noise.spectrum(motion), bins, variance, weights, factors
        return spectral.SpectralSolution(*numbers, False, 0.0 if refined else np.inf, noises)


def _not_held(solution: spectral.SpectralSolution) -> tuple[Reason, ...]:
    """Reason against numbers from an input that is not held between samples; the numbers stay."""
    with np.errstate(all="ignore"):
        if seems_held(solution):
            return ()
        try:
            pilot = spectral.pilot_at(solution.motion, solution.input_variance)
            free = spectral.solved_equations(pilot, solution.input_variance, free_blend=True)
        except (EivorError, np.linalg.LinAlgError, ValueError):
            return (
                Reason(Status.WEAK, "Whether the input is held between samples cannot be identified.", USE),
            )
        if usual_blend(free) == 0.0:
            return ()
        error = blend_error(free)
    sentence = (
        "The input is not held between samples, as the likelihood takes it: the share of the next sample is "
        f"{free.motion.blend:.2g} +- {error:.1g}, where 0 is held and 0.5 is linear."
    )
    return (Reason(Status.WEAK, sentence, USE),)
