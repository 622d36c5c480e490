"""Regressions of plain arrays: what they accept, and the sentences they refuse with."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from eivor.errors import CovarianceError, MissingNoiseError, NonFiniteError, ShapeError, TooFewSamplesError
from eivor.models.regression import SampleRows, check_covariance, regression

RNG = np.random.default_rng(0)
PHI, Y = RNG.standard_normal((10, 2)), RNG.standard_normal(10)


def test_arrays_of_any_number_are_taken_and_left_alone():
    phi = [[1, 2], [3, 4], [5, 7]]
    response = np.array([1, 2, 3], dtype=np.int32)
    made = regression(response=response, regressors=phi)
    assert made.response.dtype == np.float64
    assert made.names == ("theta_1", "theta_2")
    assert made.instruments.shape == (3, 0)
    np.testing.assert_array_equal(made.layout.flight_of_row, [0, 0, 0])
    assert response.dtype == np.int32
    named = regression(response=Y, regressors=PHI, names=["K", "K_u"])
    assert named.names == ("K", "K_u")
    assert named.rows() is named


@pytest.mark.parametrize("count", [0, 9, 11])
def test_a_layout_of_another_length_is_no_single_flight(count):
    """Rows of two flights would be clustered as one."""
    made = regression(response=Y, regressors=PHI)
    flights = np.arange(count) // 5
    with pytest.raises(ShapeError, match=rf"a layout of 10 rows.*; received one of shape \({count},\)"):
        replace(made, layout=SampleRows(flights))
    kept = replace(made, layout=SampleRows(np.arange(10) // 5))
    np.testing.assert_array_equal(kept.layout.flight_of_row, [0] * 5 + [1] * 5)
    with pytest.raises(ShapeError, match="a layout of 5 rows"):
        replace(kept, response=Y[:5], regressors=PHI[:5], instruments=np.empty((5, 0)))


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize(
    ("given", "error", "said"),
    [
        ({"response": Y[:, None]}, ShapeError, r"response of shape \(rows,\)"),
        ({"regressors": Y}, ShapeError, "regressors with two dimensions"),
        ({"response": Y[:5]}, ShapeError, "equally many rows"),
        ({"instruments": PHI[:4]}, ShapeError, "equally many rows"),
        ({"names": ["K"]}, ShapeError, "one name for each of 2 regressors"),
        ({"response": Y[:1], "regressors": PHI[:1]}, TooFewSamplesError, "at least 2 rows"),
        ({"response": np.where(Y[3] == Y, np.nan, Y)}, NonFiniteError, "first in row 3"),
        ({"regressors": np.where(PHI[7, 1] == PHI, np.inf, PHI)}, NonFiniteError, "first in row 7"),
        ({"noise_covariance": np.eye(2)}, ShapeError, "a 3 x 3 covariance"),
        ({"noise_covariance": np.triu(np.ones((3, 3)))}, CovarianceError, "symmetric"),
        ({"noise_covariance": np.diag([1.0, -1.0, 1.0])}, CovarianceError, "positive semidefinite"),
        ({"noise_covariance": np.full((3, 3), np.nan)}, NonFiniteError, "finite covariance"),
        ({"instruments": PHI, "instrument_noise_covariance": np.eye(3)}, ShapeError, "a 2 x 3 covariance"),
        (
            {"instruments": PHI, "instrument_noise_covariance": np.full((2, 3), np.inf)},
            NonFiniteError,
            "instrument noise covariance",
        ),
    ],
)
def test_what_does_not_fit_is_refused_with_the_reason(given, error, said):
    with pytest.raises(error, match=f"Expected .*{said}|{said}.*; received"):
        regression(**({"response": Y, "regressors": PHI} | given))


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
def test_covariances_are_judged_whatever_their_units(scale):
    units = np.diag([1.0, scale, 1.0])
    check_covariance(units @ np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 0.0]]) @ units)
    with pytest.raises(CovarianceError, match="positive semidefinite"):
        check_covariance(units @ np.array([[1.0, 1.1, 0.0], [1.1, 1.0, 0.0], [0.0, 0.0, 0.0]]) @ units)


def test_noise_that_was_not_given_is_asked_for():
    bare = regression(response=Y, regressors=PHI, instruments=PHI)
    for ask in (bare.regressor_noise_covariance, bare.instrument_noise_covariance):
        with pytest.raises(MissingNoiseError, match=r"Expected the covariance .*; received none"):
            ask()
    assert not bare.instruments_share_noise()
    zero = regression(
        response=Y, regressors=PHI, instruments=PHI, instrument_noise_covariance=np.zeros((2, 3))
    )
    assert not zero.instruments_share_noise()
