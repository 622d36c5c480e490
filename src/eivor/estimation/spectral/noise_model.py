r"""Spectra of what is measured and of what disturbs.

    C = S_u (..) + S_v (..) + S_a (..) + S_e (..)

see `SampledMotion.shapes`: S_u is flat, S_v = s_v^2 |2 sin(w/2)|^(2 alpha), and S_a and S_e alike with beta
and gamma, the spectra of fractional noises.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from eivor.estimation.spectral.pair_spectrum import PairSpectrum
from eivor.shapes import Float

#: Order that is expected where nothing else is known of it.
USUAL_ORDER = -0.2


@runtime_checkable
class PairedEquations(Protocol):
    """Residuals of two equations, bin by bin, of one motion."""

    @property
    @abstractmethod
    def log_scale(self) -> Float[np.ndarray, " bins"]:
        """Logarithm of what a noise of the order one grows by: its spectrum is exp(2 log_scale)."""

    @abstractmethod
    def shapes(self) -> tuple[PairSpectrum, PairSpectrum, PairSpectrum, PairSpectrum]:
        """C of one unit of noise of the input, of z', of z'' and of a disturbance that moves the vehicle."""


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Strengths and orders.

    Parameters
    ----------
    input_variance : float
        sigma_u^2.
    velocity_variance, acceleration_variance : float
        s_v^2 and s_a^2, of the white noise before the operator.
    disturbance_variance : float
        S_e.
    velocity_order, acceleration_order, disturbance_order : float
        alpha, beta and gamma.
    """

    input_variance: float
    velocity_variance: float
    acceleration_variance: float
    disturbance_variance: float
    velocity_order: float = USUAL_ORDER
    acceleration_order: float = USUAL_ORDER
    disturbance_order: float = 0.0

    def spectrum(self, pairs: PairedEquations) -> PairSpectrum:
        """C at parameters of the motion."""
        of_input, of_velocity, of_acceleration, of_disturbance = pairs.shapes()

        def coloured(variance: float, order: float) -> Float[np.ndarray, " bins"]:
            return np.asarray(variance * np.exp(2.0 * order * pairs.log_scale))

        return (
            of_input * self.input_variance
            + of_velocity * coloured(self.velocity_variance, self.velocity_order)
            + of_acceleration * coloured(self.acceleration_variance, self.acceleration_order)
            + of_disturbance * coloured(self.disturbance_variance, self.disturbance_order)
        )
