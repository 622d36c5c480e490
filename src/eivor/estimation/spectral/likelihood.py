r"""Maximum likelihood in frequency, parameters and noises in turns.

    Q = sum over bins of r^H C^-1 r

is minimised over K, b, t (and rho where it is free) at given noises, and log det C + Q over the noises at
given parameters, until the parameters rest. C moves with the parameters in Q, as the noises' part of r does:
with C at rest, the noise of what is measured would count as signal. Both sums are never minimised over
everything at once: log det C pulls the parameters, by several per cent even when the spectra are true.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from eivor.estimation.spectral.noise_model import NoiseModel, fitted_noise
from eivor.estimation.spectral.pair_spectrum import Pair
from eivor.estimation.spectral.pilot import Pilot
from eivor.estimation.spectral.sampled_motion import SampledMotion
from eivor.shapes import Float

#: Passes of noises and parameters, and the change relative to the parameters that ends them.
PASSES, STILL = 8, 1e-5
#: Searches of the parameters end after so many evaluations.
EVALUATIONS = 60


@dataclass(frozen=True)
class Likelihood:
    """Where a search ended.

    Parameters
    ----------
    motion : SampledMotion
        Parameters.
    transient : float
        t.
    noise : NoiseModel
        Spectra that were fitted or given.
    information : ndarray, shape (n, n)
        Of K, b, t, and rho where it is free: half the curvature of Q.
    settled : bool
        False when passes or evaluations ran out.
    """

    motion: SampledMotion
    transient: float
    noise: NoiseModel
    information: Float[np.ndarray, "n n"]
    settled: bool


def maximum_likelihood(pilot: Pilot, *, noise_is_known: bool = False, free_blend: bool = False) -> Likelihood:
    """Search from a pilot, with its noises as they are or fitted anew."""
    motion, transient, noise = pilot.motion, pilot.transient, pilot.noise
    settled = False
    for _ in range(1 if noise_is_known else PASSES):
        before = np.array([motion.friction, motion.gain])
        motion, transient, information, found = _least_quadratic(motion, transient, noise, free_blend)
        moved = np.abs(np.array([motion.friction, motion.gain]) - before)
        settled = found and (noise_is_known or bool((moved <= STILL * np.abs(before)).all()))
        if settled:
            break
        if not noise_is_known:
            noise = fitted_noise(motion, _residual(motion, transient), noise, pilot.prior)
    return Likelihood(motion, transient, noise, information, settled)


def _residual(motion: SampledMotion, transient: float) -> Pair:
    return motion.whole(np.array([transient]), motion.nuisance_shapes(False))


def _least_quadratic(
    motion: SampledMotion, transient: float, noise: NoiseModel, free_blend: bool
) -> tuple[SampledMotion, float, Float[np.ndarray, "n n"], bool]:
    """Minimum of Q at given noises, by least squares of the whitened residuals."""
    from scipy.optimize import least_squares

    units = np.array([motion.friction, motion.gain, max(abs(transient), 1e-3 * abs(motion.gain)), 1.0])
    units = units[: 3 + free_blend]

    def at(x: Float[np.ndarray, " n"]) -> tuple[SampledMotion, float]:
        moved = replace(motion, friction=float(x[0] * units[0]), gain=float(x[1] * units[1]))
        return (replace(moved, blend=float(x[3])) if free_blend else moved), float(x[2] * units[2])

    def whitened(x: Float[np.ndarray, " n"]) -> Float[np.ndarray, " rows"]:
        moved, t = at(x)
        pair = noise.spectrum(moved).whitened(_residual(moved, t)).ravel()
        return np.concatenate([pair.real, pair.imag])

    first = np.array([1.0, 1.0, transient / units[2], motion.blend])[: 3 + free_blend]
    found = least_squares(
        whitened, first, method="lm", max_nfev=EVALUATIONS * first.size, xtol=1e-9, ftol=1e-10
    )
    best, t = at(found.x)
    information = found.jac.T @ found.jac / np.outer(units, units)
    return best, t, information, bool(found.success)
