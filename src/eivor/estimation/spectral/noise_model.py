r"""Spectra of what is measured and of what disturbs.

    C = S_u (..) + S_v (..) + S_a (..) + S_e (..)

see `SampledMotion.shapes`: S_u and S_e are flat, S_v = s_v^2 |2 sin(w/2)|^(2 alpha) and S_a alike with beta,
the spectra of fractional noises.
"""

from __future__ import annotations

from dataclasses import dataclass

from eivor.estimation.spectral.pair_spectrum import PairSpectrum
from eivor.estimation.spectral.sampled_motion import SampledMotion

#: Order that is expected where nothing else is known of it.
USUAL_ORDER = -0.2


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
    velocity_order, acceleration_order : float
        alpha and beta.
    """

    input_variance: float
    velocity_variance: float
    acceleration_variance: float
    disturbance_variance: float
    velocity_order: float = USUAL_ORDER
    acceleration_order: float = USUAL_ORDER

    def spectrum(self, motion: SampledMotion) -> PairSpectrum:
        """C at parameters of the motion."""
        record = motion.record
        of_input, of_velocity, of_acceleration, of_disturbance = motion.shapes()
        return (
            of_input * self.input_variance
            + of_velocity * (self.velocity_variance * record.power(self.velocity_order))
            + of_acceleration * (self.acceleration_variance * record.power(self.acceleration_order))
            + of_disturbance * self.disturbance_variance
        )
