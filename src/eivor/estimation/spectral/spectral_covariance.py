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
from eivor.shapes import Float

#: Fewest degrees of freedom.
LEAST_DEGREES = 3.0


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
    """

    model: Float[np.ndarray, "n n"]
    in_time: Float[np.ndarray, "n n"]
    degrees: Float[np.ndarray, " n"]
    influence: Float[np.ndarray, "samples n"]


def spectral_covariance(solution: SpectralSolution) -> SpectralCovariance:
    """Covariances at a solution."""
    count = solution.parameters
    shares = solution.sensitivities()
    whole = np.linalg.inv(shares.sum(axis=2))
    inverse = whole[:count]
    meat = _meat(solution)
    of_bins = np.einsum("jl,lmb,jm->jb", inverse, meat, inverse)
    degrees = 2.0 * of_bins.sum(axis=1) ** 2 / (of_bins**2).sum(axis=1)
    leverage = np.clip(np.einsum("jl,ljb->b", whole, shares), 0.0, LARGEST_LEVERAGE)
    enlarged = np.sqrt((of_bins / (1.0 - leverage / 4.0)).sum(axis=1) / of_bins.sum(axis=1))
    model = inverse @ meat.sum(axis=2) @ inverse.T * np.outer(enlarged, enlarged)
    influence = _influence(solution) @ inverse.T * enlarged
    in_time = sum_covariance(influence)
    return SpectralCovariance(model, in_time, np.maximum(degrees, LEAST_DEGREES), influence)


def sum_covariance(series: Float[np.ndarray, "samples n"]) -> Float[np.ndarray, "n n"]:
    """Long-run covariance of the sums of series, of as many cosine averages as have the least error."""
    count = series.shape[0]
    averages = cosine_averages(series, max(COSINE_AVERAGES, round(0.4 * count ** (2.0 / 3.0))))
    found: Float[np.ndarray, "n n"] = averages.T @ averages / averages.shape[0]
    return found


def _meat(solution: SpectralSolution) -> Float[np.ndarray, "n n bins"]:
    """Variance of the equations, bin by bin."""
    tests = solution.tests
    weighted = np.stack([solution.spectrum.solved(one) for one in tests])
    meat = np.einsum("jkb,lkb->jlb", tests.conj(), weighted).real
    if solution.input_variance:
        own = solution.motion.directions[: solution.parameters]
        shared = solution.spectrum.solved(solution.motion.input_noise)
        phi = np.einsum("jkb,kb->jb", own.conj(), shared) * (solution.weights * solution.factors)
        count = solution.parameters
        meat[:count, :count] += solution.input_variance**2 * (phi[:, None] * phi[None, :]).real
    return 0.5 * meat


def _influence(solution: SpectralSolution) -> Float[np.ndarray, "samples n"]:
    """Products of whitened test functions and residuals in time; each column's sum is its equation."""
    record = solution.motion.record
    residual = series_of(solution.spectrum.whitened(solution.residual), record.count)
    tests = [series_of(solution.spectrum.whitened(one), record.count) for one in solution.tests]
    found: Float[np.ndarray, "samples n"] = 0.5 * np.stack(
        [(test * residual).sum(axis=0) for test in tests], axis=1
    )
    return found
