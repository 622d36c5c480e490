r"""Covariance of the spectral generalized instrumental variables: of a model, and of what is seen in time.

The model's is J^-1 M J^-T with the variance M of the equations under independent bins,

    M_jl = 1/2 sum of w^2 c^2 [ |U|^2 Re(d_j^H C^-1 d_l) + sigma_u^4 Re(phi_j phi_l) ],  phi_j = d_j^H C^-1 s,

and alike for nuisances. In time, the equations' influence on each parameter is a series, the product of the
whitened test functions and residuals, whose long-run variance equal-weighted cosines tell: a disturbance that
changes over the record is seen there only. Both are enlarged by what the parameters took of the residuals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.estimation.spectral.spectral_equations import SpectralSolution
from eivor.estimation.spectral.weights import LARGEST_LEVERAGE
from eivor.estimation.spectral.whitened_rows import series_of
from eivor.inference.covariances.equal_weighted_cosines import COSINE_AVERAGES, cosine_averages
from eivor.shapes import Complex, Float

#: Fewest degrees of freedom.
LEAST_DEGREES = 3.0
EVERY = slice(None)


@dataclass(frozen=True)
class SpectralCovariance:
    """Both covariances of K, b, and rho where it is free.

    Parameters
    ----------
    model, in_time : ndarray, shape (n, n)
        The two.
    degrees : ndarray, shape (n,)
        Degrees of freedom of each parameter: few bins that tell it count for few.
    influence : ndarray, shape (samples, n)
        Series whose sum is the error of each parameter, to first order.
    noise_error : float
        Standard error of sigma_u^2; zero where that is given.
    """

    model: Float[np.ndarray, "n n"]
    in_time: Float[np.ndarray, "n n"]
    degrees: Float[np.ndarray, " n"]
    influence: Float[np.ndarray, "samples n"]
    noise_error: float = 0.0


def spectral_covariance(solution: SpectralSolution, chosen: slice = EVERY) -> SpectralCovariance:
    """Covariances at a solution, of all its parameters or of some."""
    sensitivity = solution.sensitivity
    whole = np.linalg.inv(sensitivity.total)
    inverse = whole[: solution.parameters][chosen]
    answered = np.tensordot(inverse, solution.tests, axes=1)
    of_bins = _meat(solution, inverse, answered)
    own = np.einsum("jjb->jb", of_bins)
    degrees = 2.0 * own.sum(axis=1) ** 2 / (own**2).sum(axis=1)
    leverage = np.clip(sensitivity.leverage(whole), 0.0, LARGEST_LEVERAGE)
    enlarged = np.sqrt((own / (1.0 - leverage / 4.0)).sum(axis=1) / own.sum(axis=1))
    model = of_bins.sum(axis=2) * np.outer(enlarged, enlarged)
    influence = _influence(solution, answered) * enlarged
    in_time = sum_covariance(influence)
    noise_error = 0.0
    if solution.noise_test is not None:
        last = np.tensordot(whole[-1:], solution.tests, axes=1)
        noise_error = float(np.sqrt(_meat(solution, whole[-1:], last).sum()))
    return SpectralCovariance(model, in_time, np.maximum(degrees, LEAST_DEGREES), influence, noise_error)


def sum_covariance(series: Float[np.ndarray, "samples n"]) -> Float[np.ndarray, "n n"]:
    """Long-run covariance of the sums of series, of as many cosine averages as have the least error."""
    count = series.shape[0]
    averages = cosine_averages(series, max(COSINE_AVERAGES, round(0.4 * count ** (2.0 / 3.0))))
    found: Float[np.ndarray, "n n"] = averages.T @ averages / averages.shape[0]
    return found


def _meat(
    solution: SpectralSolution,
    inverse: Float[np.ndarray, "n m"],
    answered: Complex[np.ndarray, "n 2 bins"],
) -> Float[np.ndarray, "n n bins"]:
    """J^-1 M J^-T, bin by bin, with the tests that some rows of J^-1 are answered by."""
    meat = np.einsum("jkb,lkb->jlb", answered.conj(), solution.spectrum.solved(answered)).real
    if solution.input_variance:
        own = np.tensordot(inverse[:, solution.noisy], solution.of_noise, axes=1)
        shared = solution.spectrum.solved(solution.motion.input_noise)
        phi = np.einsum("jkb,kb->jb", own.conj(), shared)
        meat += solution.input_variance**2 * (phi[:, None] * phi[None, :]).real
    return 0.5 * meat


def _influence(
    solution: SpectralSolution, answered: Complex[np.ndarray, "n 2 bins"]
) -> Float[np.ndarray, "samples n"]:
    """Products of whitened residuals and what answers them in time; each column's sum is an error."""
    record = solution.motion.record
    residual = series_of(solution.spectrum.whitened(solution.residual), record.count)
    answers = series_of(solution.spectrum.whitened(answered), record.count)
    found: Float[np.ndarray, "samples n"] = 0.5 * np.einsum("jkt,kt->tj", answers, residual)
    return found
