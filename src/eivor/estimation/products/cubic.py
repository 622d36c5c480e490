"""The cubic spline through nodes, as the weights that it gives them.

It is that of SciPy's `CubicSpline`, ends not a knot; `scipy.interpolate` alone takes as long to load as a
flight takes to be identified.
"""

from __future__ import annotations

import numpy as np

from eivor.shapes import Float


def slopes_of_nodes(nodes: Float[np.ndarray, " T"]) -> Float[np.ndarray, "T T"]:
    """Slope of the spline at each node for a one at each of them; four nodes or more. Performs no checks.

    At inner nodes the second derivative is continuous, at the first and last of these the third is too.
    """
    count, h = nodes.size, np.diff(nodes)
    chords = np.diff(np.eye(count), axis=0) / h[:, None]
    inner = np.arange(1, count - 1)
    left, right = np.zeros((count, count)), np.zeros((count, count))
    left[inner, inner - 1], left[inner, inner + 1] = h[1:], h[:-1]
    left[inner, inner] = 2.0 * (h[:-1] + h[1:])
    right[1:-1] = 3.0 * (h[1:, None] * chords[:-1] + h[:-1, None] * chords[1:])
    for end, beside, first, second in ((0, 1, h[0], h[1]), (-1, -2, h[-1], h[-2])):
        both = first + second
        left[end, end], left[end, beside] = second, both
        near, far = (chords[0], chords[1]) if end == 0 else (chords[-1], chords[-2])
        right[end] = ((first + 2.0 * both) * second * near + first**2 * far) / both
    return np.linalg.solve(left, right)


def spline_weights(
    nodes: Float[np.ndarray, " T"], slopes: Float[np.ndarray, "T T"], places: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k T"]:
    """What each node counts at places, beyond the ends by the last piece. Performs no checks."""
    piece = np.clip(np.searchsorted(nodes, places, side="right") - 1, 0, nodes.size - 2)
    h = nodes[piece + 1] - nodes[piece]
    t = (places - nodes[piece]) / h
    rows = np.arange(places.size)
    weights = (h * t * (1.0 - t) ** 2)[:, None] * slopes[piece]
    weights -= (h * t**2 * (1.0 - t))[:, None] * slopes[piece + 1]
    weights[rows, piece] += (1.0 + 2.0 * t) * (1.0 - t) ** 2
    weights[rows, piece + 1] += t**2 * (3.0 - 2.0 * t)
    return weights
