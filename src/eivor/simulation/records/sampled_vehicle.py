"""Vertical motion z'' = -K z' + a from one sample to the next, exact for an acceleration a held between.

    v+ = decay v + held a                decay = exp(-K T)
    z+ = z + held v + rise a             held = (1 - exp(-K T))/K,  rise = (T - held)/K

`ramp` = rise/T is what of `held` is due to the second half of an acceleration that grows linearly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: K T below which the gains are summed as series: their closed forms would cancel.
SMALL = 1e-2


@dataclass(frozen=True, slots=True)
class SampledVehicle:
    """Coefficients of the step, see this module.

    Parameters
    ----------
    input_gain : float
        K_u [m/s^2 per unit of input].
    step_s : float
        T [s].
    decay : float
        Of the velocity [-].
    held : float
        Velocity per held acceleration [s].
    ramp : float
        Velocity per acceleration that grows from 0 to 1 over the step [s].
    """

    input_gain: float
    step_s: float
    decay: float
    held: float
    ramp: float

    @property
    def rise(self) -> float:
        """Altitude per held acceleration [s^2]."""
        return self.step_s * self.ramp


def sampled_vehicle(viscous_friction: float, input_gain: float, step_s: float) -> SampledVehicle:
    """Step of a vehicle.

    Parameters
    ----------
    viscous_friction : float
        K [1/s], zero or more.
    input_gain : float
        K_u [m/s^2 per unit of input].
    step_s : float
        T [s].

    Notes
    -----
    held = T (1 - e^-x)/x and ramp = T (e^-x - 1 + x)/x^2 at x = K T. Performs no checks.
    """
    x = viscous_friction * step_s
    if x < SMALL:
        held = 1.0 - x / 2.0 * (1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0))))
        ramp = 0.5 * (1.0 - x / 3.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0))))
    else:
        held = -float(np.expm1(-x)) / x
        ramp = (float(np.expm1(-x)) + x) / x**2
    return SampledVehicle(input_gain, step_s, float(np.exp(-x)), step_s * held, step_s * ramp)
