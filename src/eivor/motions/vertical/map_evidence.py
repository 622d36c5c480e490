"""Whether thrust goes with the command as the input map says: the intercept and the bend of the thrust curve.

A map that fits leaves an intercept b of at most `CLEAR_INTERCEPT` either way, the bias of an accelerometer,
and no bend. One that does not leaves both, with opposite signs: where thrust grows more slowly than the map
says, b is above zero and the curve bends down. The bend's score test is of what the residual holds beside the
estimate, hence independent of b, and the squared distance of both from what a fitting map leaves is

    q = z_b^2 + z_c^2,

z_b how far b is beyond the bound and z_c the bend's, in standard errors, each counted only in the direction
that a wrong map makes. At the edge of what fits, where each is as likely to either side, q is zero in a
quarter of all flights, chi-square with one degree of freedom in half of them and with two in the last quarter
(Kudo 1963; Gourieroux, Holly and Monfort 1982). Delays that fit less well add what their criterion is above
the least, and the nearest of all counts.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.flights.agreement import Difference
from eivor.inference.quantiles import chi_square_quantile, chi_square_tail
from eivor.motions.vertical.balance import balance, intercept
from eivor.motions.vertical.curve_rule import CLEAR_INTERCEPT
from eivor.motions.vertical.flights import VerticalFlights
from eivor.motions.vertical.left_out import CURVATURE
from eivor.motions.vertical.map_rule import LEAST_INTERCEPT, MAP_P_VALUE
from eivor.shapes import Float

#: Level of the set of the intercept.
SET_LEVEL = 0.95
#: Half-widths are not below this [m/s^2].
LEAST_HALF_WIDTH = 1e-9

PerDelay = Float[np.ndarray, " k"]


def map_numbers(
    problem: VerticalFlights, estimate: Estimate, left_out: Mapping[str, Difference]
) -> dict[str, float]:
    """Least intercept, and the p-value of the test that the input map fits.

    Parameters
    ----------
    problem : VerticalFlights
        What was estimated.
    estimate : Estimate
        Of it.
    left_out : mapping of str to Difference
        Terms that the model leaves out, the bend among them where the instruments tell it.
    """
    found = []
    for candidate in estimate.candidates:
        terms = balance(problem, candidate)
        value, gradient = intercept(candidate, terms)
        half = candidate.covariance.half_width(gradient, SET_LEVEL, terms.residual_variance)
        found.append((value, half))
    values, halves = np.array(found).T
    excesses = np.array(estimate.excesses)
    best = float(values[np.argmin(excesses)])
    return {
        LEAST_INTERCEPT: least_in_set(values, halves, excesses),
        MAP_P_VALUE: fitting_p_value(beyond(values, halves, excesses), best, left_out.get(CURVATURE)),
    }


def least_in_set(values: PerDelay, halves: PerDelay, excesses: PerDelay) -> float:
    """Least size of an intercept in the 95 % set of all delays together; zero where zero is in it.

    Parameters
    ----------
    values, halves : ndarray, shape (k,)
        Intercept and half-width of its 95 % interval at each delay [m/s^2].
    excesses : ndarray, shape (k,)
        What the criterion of each is above the least.
    """
    allowance = chi_square_quantile(SET_LEVEL, 1)
    fits = excesses <= allowance
    left = halves[fits] * np.sqrt(1.0 - excesses[fits] / allowance)
    return max(float(np.min(values[fits] - left)), -float(np.max(values[fits] + left)), 0.0)


def beyond(values: PerDelay, halves: PerDelay, excesses: PerDelay) -> float:
    """Squared distance of the same intercepts from what a fitting map leaves, in standard errors."""
    allowance = chi_square_quantile(SET_LEVEL, 1)
    away = np.maximum(np.abs(values) - CLEAR_INTERCEPT, 0.0) / np.maximum(halves, LEAST_HALF_WIDTH)
    return float(np.min(excesses + allowance * away**2))


def fitting_p_value(distance: float, value: float, bend: Difference | None) -> float:
    """P-value of the test that the input map fits; one where the intercept is within what it leaves.

    Parameters
    ----------
    distance : float
        Squared distance of the intercept from there, in standard errors.
    value : float
        The intercept [m/s^2].
    bend : Difference or None
        Of the thrust curve.
    """
    if not 0.0 < distance < np.inf:
        return 1.0
    bent = 0.0
    if bend is not None and bend.value * value < 0.0:
        bent = chi_square_quantile(1.0 - bend.p_value, 1)
    both = distance + bent
    return 0.5 * chi_square_tail(both, 1) + 0.25 * chi_square_tail(both, 2)
