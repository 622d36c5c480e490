"""Intervals of functions that are far from linear: the function's range over the confidence ellipsoid.

With w on the unit ball and C = L L', the vectors theta + t L w are those within t standard errors in their
own direction. The least and greatest value of a function over them make its profile interval by Wald's
criterion. For a linear function it is that of the delta method; for another one it follows the bend, and
does not change when the function is replaced by a monotone one of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from eivor.shapes import Float

#: Relative half-step of numerical derivatives, in half-widths.
DIFFERENCE = 1e-3
#: Where the search for an end stops, in half-widths of the delta method.
TOLERANCE = 1e-9

Function = Callable[[Float[np.ndarray, " n"]], float]


def gradient_of(
    function: Function, values: Float[np.ndarray, " n"], scale: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Gradient by central differences, each over `DIFFERENCE` times a scale; zero where the scale is."""
    gradient = np.zeros(values.size)
    for i in np.flatnonzero(scale):
        step = DIFFERENCE * scale[i] * np.eye(values.size)[i]
        gradient[i] = (function(values + step) - function(values - step)) / (2.0 * DIFFERENCE * scale[i])
    return gradient


def profile_interval(
    function: Function,
    values: Float[np.ndarray, " n"],
    covariance: Float[np.ndarray, "n n"],
    half_widths: float,
) -> tuple[float, float]:
    """Least and greatest value of a function over the ellipsoid of `half_widths` standard errors.

    Parameters
    ----------
    function : callable
        Of the vector of estimates; finite and smooth over the ellipsoid.
    values : ndarray, shape (n,)
        Estimates.
    covariance : ndarray, shape (n, n)
        Their covariance.
    half_widths : float
        t.
    """
    from scipy.optimize import minimize

    L = principal_axes(covariance, half_widths)
    centre = function(values)
    slope = L.T @ gradient_of(function, values, half_widths * np.sqrt(np.diag(covariance)))
    size = float(np.linalg.norm(slope))
    # A function may bend across its slope: each axis is a start of its own.
    starts = [sign * unit for unit in np.eye(values.size) for sign in (-1.0, 1.0)]
    if size > 0.0:
        starts += [-slope / size, slope / size]
    reach = max(abs(function(values + L @ w) - centre) for w in starts)
    if reach == 0.0:
        return centre, centre
    ends = []
    for sign in (-1.0, 1.0):

        def objective(w: Float[np.ndarray, " n"], sign: float = sign) -> float:
            inside = w / max(1.0, float(np.linalg.norm(w)))  # a search may try what lies outside
            return -sign * (function(values + L @ inside) - centre) / reach

        found = list(starts)
        for start in starts:
            # Strictly inside, where the boundary is no obstacle to the first line search.
            climbed = minimize(
                objective,
                0.9 * start,
                method="SLSQP",
                constraints={"type": "ineq", "fun": lambda w: 1.0 - w @ w, "jac": lambda w: -2.0 * w},
                options={"ftol": TOLERANCE, "maxiter": 200},
            )
            found.append(climbed.x / max(1.0, float(np.linalg.norm(climbed.x))))
        ends.append(function(values + L @ min(found, key=objective)))
    return min(*ends, centre), max(*ends, centre)


def principal_axes(covariance: Float[np.ndarray, "n n"], half_widths: float) -> Float[np.ndarray, "n n"]:
    """Vectors (columns) from the middle of the ellipsoid of `half_widths` standard errors to its ends."""
    eigenvalues, vectors = np.linalg.eigh(covariance)
    axes: Float[np.ndarray, "n n"] = half_widths * vectors * np.sqrt(np.maximum(eigenvalues, 0.0))
    return axes
