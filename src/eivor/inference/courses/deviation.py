"""Members that deviate from the course of their group, each held against what all others say."""

from __future__ import annotations

import numpy as np
from scipy import special

from eivor.inference.courses.ordered import Ordered
from eivor.shapes import Float

#: Rows within so many standard errors of their course do not deviate.
NEAR = 2.0


def deviation_p_values(
    ordered: Ordered,
    line: Float[np.ndarray, " rows"],
    leverage: Float[np.ndarray, " rows"],
    parameters: Float[np.ndarray, " groups"],
) -> Float[np.ndarray, " rows"]:
    """P-value of each row by its residual over what the other rows scatter. Performs no checks.

    An isolated row counts little in its course and in what others scatter, and is judged by its own variance.

    Parameters
    ----------
    ordered : Ordered
        The estimates.
    line, leverage : ndarray, shape (rows,)
        Their course, and what each row has of it.
    parameters : ndarray, shape (groups,)
        Of the course.

    Returns
    -------
    ndarray, shape (rows,)
        One where too few rows are left, or the row is near; nothing is corrected for their number.
    """
    groups, w = ordered.groups, ordered.weights
    own = np.maximum(1.0 - leverage, 1e-9)
    off = (ordered.y - line) ** 2
    square = w * off
    degrees = groups.spread(groups.sizes - parameters - 1.0)
    others = groups.spread(groups.sums(square)) - square / own
    scale = np.maximum(others / np.maximum(degrees, 1.0), groups.spread(ordered.least_scale))
    score = np.sqrt(ordered.own_weights * off / own / scale)
    p_values = np.ones(w.size)
    far = (degrees >= 1.0) & (score > NEAR)
    p_values[far] = 2.0 * special.stdtr(degrees[far], -score[far])
    return p_values
