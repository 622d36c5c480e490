r"""Maximum likelihood in frequency, parameters and noises in turns.

    Q = sum over bins of r^H C^-1 r

is minimised over K, b and t at given noises, and log det C + Q over the noises at given parameters, until the
parameters rest. C moves with the parameters in Q, as the noises' part of r does:
with C at rest, the noise of what is measured would count as signal. Both sums are never minimised over
everything at once: log det C pulls the parameters, by several per cent even when the spectra are true.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from eivor.estimation.fitted_noise import FittedNoise
from eivor.estimation.spectral.noise_fit import MEASURE, fitted_noise, told_noises
from eivor.estimation.spectral.noise_model import NoiseModel
from eivor.estimation.spectral.pair_spectrum import Pair, PairSpectrum
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
        Spectra that were fitted or declared.
    settled : bool
        False when passes or evaluations ran out.
    noises : tuple of FittedNoise
        The same noises with their errors; those that were declared have none.
    """

    motion: SampledMotion
    transient: float
    noise: NoiseModel
    settled: bool
    noises: tuple[FittedNoise, ...]


@runtime_checkable
class KnownSpectra(Protocol):
    """Spectra of the residuals at any parameters of the motion."""

    @abstractmethod
    def spectrum(self, motion: SampledMotion) -> PairSpectrum:
        """C."""


def maximum_likelihood(pilot: Pilot) -> Likelihood:
    """Search from a pilot, with the noises that are not declared fitted anew."""
    motion, transient, noise = pilot.motion, pilot.transient, pilot.noise
    settled = False
    for _ in range(PASSES):
        before = np.array([motion.friction, motion.gain])
        motion, transient, found = least_quadratic(motion, transient, noise)
        moved = np.abs(np.array([motion.friction, motion.gain]) - before)
        settled = found and bool((moved <= STILL * np.abs(before)).all())
        if settled:
            break
        noise = fitted_noise(motion, _residual(motion, transient), noise, pilot.prior)
    told = told_noises(motion, _residual(motion, transient), noise, pilot.prior, MEASURE)
    return Likelihood(motion, transient, noise, settled, told)


def _residual(motion: SampledMotion, transient: float) -> Pair:
    return motion.whole(np.array([transient]), motion.nuisance_shapes(False))


def least_quadratic(
    motion: SampledMotion, transient: float, noise: KnownSpectra
) -> tuple[SampledMotion, float, bool]:
    """Minimum of Q at given noises, by least squares of the whitened residuals; and whether it is one."""
    from scipy.optimize import least_squares

    units = np.array([motion.friction, motion.gain, max(abs(transient), 1e-3 * abs(motion.gain))])

    def at(x: Float[np.ndarray, " 3"]) -> tuple[SampledMotion, float]:
        friction, gain, t = (x * units).tolist()
        return replace(motion, friction=friction, gain=gain), t

    def whitened(x: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " rows"]:
        moved, t = at(x)
        pair = noise.spectrum(moved).whitened(_residual(moved, t)).ravel()
        return np.concatenate([pair.real, pair.imag])

    first = np.array([1.0, 1.0, transient / units[2]])
    found = least_squares(
        whitened, first, method="lm", max_nfev=EVALUATIONS * first.size, xtol=1e-9, ftol=1e-10
    )
    return *at(found.x), bool(found.success)
