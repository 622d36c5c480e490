"""Joint ellipses: their geometry, their quantile, and how often they hold the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats
from scipy.signal import lfilter

from eivor.errors import ShapeError, UsageError
from eivor.inference.covariance import COSINE_AVERAGES, cosine_covariance
from eivor.inference.distributions import chi_square_quantile, t_quantile
from eivor.inference.regions import Ellipse, hotelling_quantile, joint_ellipse

COVARIANCE = np.array([[0.04, -0.9 * 0.2 * 30.0], [-0.9 * 0.2 * 30.0, 900.0]])
CENTRE = np.array([0.4, 1.2e3])


def test_quantile_of_one_dimension_is_that_of_t_squared() -> None:
    assert hotelling_quantile(0.95, 1, 8.0) == pytest.approx(t_quantile(0.95, 8) ** 2)


def test_quantile_of_two_dimensions_follows_hotelling() -> None:
    assert hotelling_quantile(0.9, 2, 8.0) == pytest.approx(2 * 8 / 7 * stats.f.ppf(0.9, 2, 7))


def test_quantile_tends_to_chi_square() -> None:
    assert hotelling_quantile(0.95, 2, 1e8) == pytest.approx(chi_square_quantile(0.95, 2), rel=1e-6)
    assert hotelling_quantile(0.95, 2) == chi_square_quantile(0.95, 2)


@pytest.mark.parametrize(("level", "degrees"), [(0.0, 8.0), (1.0, 8.0), (0.95, 1.0), (0.95, math.nan)])
def test_impossible_levels_and_degrees_are_refused(level: float, degrees: float) -> None:
    with pytest.raises(UsageError):
        Ellipse(CENTRE, COVARIANCE, level, degrees)


@pytest.mark.parametrize(
    "matrix", [[[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.4, 1.0]], [[-1.0, 0.0], [0.0, 1.0]]]
)
def test_what_is_no_covariance_is_refused(matrix: list[list[float]]) -> None:
    with pytest.raises(UsageError, match="positive semidefinite"):
        Ellipse(CENTRE, np.array(matrix))


def test_every_point_of_the_outline_has_the_quantile_as_its_distance() -> None:
    ellipse = Ellipse(CENTRE, COVARIANCE, 0.9, 8.0)
    away = ellipse.outline(41) - CENTRE
    distance = np.einsum("ij,ij->i", away, np.linalg.solve(COVARIANCE, away.T).T)
    assert distance == pytest.approx(np.full(41, ellipse.squared_radius), rel=1e-9)
    assert ellipse.distance(ellipse.outline(41)) == pytest.approx(distance, rel=1e-9)
    assert ellipse.outline(41)[0] == pytest.approx(ellipse.outline(41)[-1])


def test_points_just_inside_are_contained_and_points_just_outside_are_not() -> None:
    ellipse = Ellipse(CENTRE, COVARIANCE)
    away = ellipse.outline() - CENTRE
    assert ellipse.contains(CENTRE + 0.999 * away).all()
    assert not ellipse.contains(CENTRE + 1.001 * away).any()


def test_bounds_area_and_axes_agree_with_the_outline() -> None:
    ellipse = Ellipse(CENTRE, COVARIANCE)
    outline = ellipse.outline(20_001)
    assert ellipse.bounds == pytest.approx(
        np.column_stack([outline.min(axis=0), outline.max(axis=0)]), rel=1e-6
    )
    x, y = (outline - CENTRE).T
    polygon = 0.5 * abs(float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])))
    assert ellipse.area == pytest.approx(polygon, rel=1e-6)
    lengths = np.linalg.norm(ellipse.semi_axes, axis=1)
    assert math.pi * float(np.prod(lengths)) == pytest.approx(ellipse.area)
    assert lengths[0] > lengths[1]
    assert ellipse.distance(CENTRE + ellipse.semi_axes) == pytest.approx(np.full(2, ellipse.squared_radius))


def test_an_exact_parameter_leaves_a_segment() -> None:
    ellipse = Ellipse(np.zeros(2), np.diag([1.0, 0.0]))
    assert ellipse.contains(np.array([[1.0, 0.0], [1.0, 1e-9], [9.0, 0.0]])).tolist() == [True, False, False]
    assert ellipse.area == 0.0


def test_full_correlation_leaves_a_line() -> None:
    ellipse = Ellipse(np.zeros(2), np.array([[1.0, -2.0], [-2.0, 4.0]]))
    assert ellipse.contains(np.array([[1.0, -2.0], [1.0, 2.0]])).tolist() == [True, False]


def test_a_pair_of_a_longer_vector_and_two_combinations_of_it() -> None:
    random = np.random.default_rng(1)
    root = random.normal(size=(3, 3))
    C, values = root @ root.T, np.array([1.0, 2.0, 3.0])
    pair = joint_ellipse(values, C, np.eye(3)[[0, 2]], degrees=8.0)
    assert pair.centre == pytest.approx([1.0, 3.0])
    assert pair.covariance == pytest.approx(C[np.ix_([0, 2], [0, 2])])
    sums = joint_ellipse(values, C, np.array([[1.0, 1.0, 0.0], [0.0, 1.0, 1.0]]), degrees=8.0)
    assert sums.centre == pytest.approx([3.0, 5.0])
    assert sums.covariance[0, 0] == pytest.approx(C[0, 0] + 2 * C[0, 1] + C[1, 1])
    with pytest.raises(ShapeError):
        joint_ellipse(values, C, np.eye(2))
    with pytest.raises(ShapeError):
        Ellipse(values, C)


@pytest.mark.calibration
def test_means_of_autocorrelated_pairs_are_covered_as_often_as_promised() -> None:
    """Cosine averages of AR(1) pairs with Hotelling's quantile: binomial error about the level."""
    random, runs, length = np.random.default_rng(7), 2_000, 1_000
    held = chi_square = 0
    for _ in range(runs):
        shocks = random.normal(size=(length + 500, 2)) @ np.array([[1.0, 0.6], [0.0, 0.8]])
        series = lfilter([1.0], [1.0, -0.5], shocks, axis=0)[500:]
        centred = series - series.mean(axis=0)
        C = cosine_covariance([centred], length) / length**2
        zero = np.zeros((1, 2))
        held += int(Ellipse(series.mean(axis=0), C, 0.95, float(COSINE_AVERAGES)).contains(zero)[0])
        chi_square += int(Ellipse(series.mean(axis=0), C, 0.95).contains(zero)[0])
    error = 3.0 * np.sqrt(0.95 * 0.05 / runs)
    assert abs(held / runs - 0.95) < error
    assert chi_square / runs < 0.95 - 4.0 * error  # without Hotelling's correction it does not cover
