"""The weights of nodes are those of SciPy's cubic spline."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from eivor.estimation.products.cubic import slopes_of_nodes, spline_weights


@pytest.mark.parametrize("count", [4, 5, 17, 40])
def test_weights_are_those_of_scipy(count):
    rng = np.random.default_rng(count)
    nodes = np.cumsum(rng.uniform(0.1, 1.0, count))
    places = np.concatenate([nodes, rng.uniform(nodes[0], nodes[-1], 50), [nodes[0] - 0.2, nodes[-1] + 0.3]])
    weights = spline_weights(nodes, slopes_of_nodes(nodes), places)
    np.testing.assert_allclose(weights, CubicSpline(nodes, np.eye(count))(places), rtol=0.0, atol=1e-10)


def test_nodes_keep_their_values_and_cubics_are_met():
    nodes = np.geomspace(0.002, 0.3, 17)
    slopes = slopes_of_nodes(nodes)
    np.testing.assert_array_equal(spline_weights(nodes, slopes, nodes), np.eye(17))
    places = np.linspace(0.002, 0.3, 101)
    found = spline_weights(nodes, slopes, places) @ (nodes**3 - 0.1 * nodes)
    np.testing.assert_allclose(found, places**3 - 0.1 * places, atol=1e-14)
