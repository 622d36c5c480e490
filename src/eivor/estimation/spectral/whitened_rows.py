r"""A spectral solution as a linear one: the last Newton step is an instrumental regression of whitened rows.

Rows are the whitened residuals of both equations at each sample. With x_l the whitened series of what a
parameter does to them and r that of the residual, y = r + X theta, and the test functions, made orthogonal to
what the nuisances do, are the instruments. What noise of the input the two share is known, as in (29). So
everything that is said of a linear estimate can be said of this one.
"""

from __future__ import annotations

import numpy as np

from eivor.estimation.assembler import Compensated
from eivor.estimation.solved import Solved
from eivor.estimation.spectral.pair_spectrum import Pairs
from eivor.estimation.spectral.spectral_equations import SpectralSolution
from eivor.linalg import LeastSquares
from eivor.models.equation import Parameter
from eivor.models.regression import Regression
from eivor.models.rows import AxisRows
from eivor.shapes import Float


def solved_rows(solution: SpectralSolution, parameters: tuple[Parameter, ...]) -> Solved:
    """Linear equations that the solution meets, and their solution."""
    rows = whitened_rows(solution, parameters)
    assembler, solver = Compensated(), LeastSquares()
    moments = assembler.full_moments(rows)
    system = assembler.system(moments)
    return Solved(assembler, solver, moments, rows, system, None, solver.solve(system))


def whitened_rows(solution: SpectralSolution, parameters: tuple[Parameter, ...]) -> Regression:
    """Rows of both equations, sample by sample, one equation after the other."""
    motion, C, count = solution.motion, solution.spectrum, solution.motion.record.count
    own = motion.directions[: solution.parameters]
    theta = np.array([motion.friction, motion.gain, motion.blend])[: solution.parameters]
    tests = solution.tests
    moved = C.solved(solution.nuisance_shapes)
    nuisance_tests = tests[solution.parameters : solution.parameters + solution.nuisances.size]
    by_nuisance = np.einsum("jkb,lkb->jl", moved.conj(), tests[: solution.parameters]).real
    among = np.einsum("jkb,lkb->jl", moved.conj(), nuisance_tests).real
    freed = tests[: solution.parameters] - np.tensordot(
        np.linalg.solve(among, by_nuisance).T, nuisance_tests, 1
    )
    X = -series_of(C.whitened(own * motion.record.input), count).reshape(own.shape[0], -1).T
    Psi = -series_of(C.whitened(freed), count).reshape(own.shape[0], -1).T
    residual = series_of(C.whitened(solution.residual), count).ravel()
    shared = _shared_noise(solution, theta) / (2 * count)
    samples = np.tile(np.arange(count), 2)
    layout = AxisRows(np.zeros(2 * count, dtype=np.int64), np.repeat([0, 1], count), samples)
    return Regression(residual + X @ theta, X, Psi, parameters, layout, instrument_noise=shared)


def _shared_noise(
    solution: SpectralSolution, theta: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n n_plus_1"]:
    """Sum over the rows of what the input's noise adds to products of instruments with [X y]."""
    count = solution.parameters
    if not solution.input_variance:
        return np.zeros((count, count + 1))
    own = solution.motion.directions[:count]
    whole = np.concatenate([own, (solution.motion.input_noise + np.tensordot(theta, own, 1))[None]])
    weighted = solution.spectrum.solved(whole) * (solution.weights * solution.factors)
    found: Float[np.ndarray, "n n_plus_1"] = (
        2.0 * solution.input_variance * np.einsum("jkb,lkb->jl", own.conj(), weighted).real
    )
    return found


def series_of(pairs: Pairs, count: int) -> Float[np.ndarray, "*shape 2 samples"]:
    """Series of pairs of unitary spectra without means."""
    bins = np.zeros((*pairs.shape[:-1], count // 2 + 1), dtype=np.complex128)
    bins[..., 1 : pairs.shape[-1] + 1] = pairs
    series: Float[np.ndarray, "*shape 2 samples"] = np.fft.irfft(bins, count, axis=-1) * np.sqrt(count)
    return series
