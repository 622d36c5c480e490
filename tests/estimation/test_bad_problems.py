"""Problems that have no honest answer: each is refused with the reason and the remedy."""

from __future__ import annotations

import numpy as np
import pytest

import eivor as ev
from eivor.errors import (
    CollinearError,
    CovarianceError,
    InstrumentError,
    MissingNoiseError,
    NonFiniteError,
    NoUniqueSolutionError,
    ShapeError,
    TooFewSamplesError,
)

RNG = np.random.default_rng(0)
ROWS = 50
PHI = RNG.standard_normal((ROWS, 2))
Y = PHI @ [1.0, 2.0] + 0.1 * RNG.standard_normal(ROWS)
PSI = PHI @ [[1.0, 0.0, 1.0], [0.0, 1.0, -1.0]] + 0.1 * RNG.standard_normal((ROWS, 3))


def spoiled(array, value):
    copy = np.array(array)
    copy.flat[3] = value
    return copy


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("where", ["response", "regressors", "instruments"])
def test_not_finite(where, value):
    arrays = {"response": Y, "regressors": PHI, "instruments": PSI}
    with pytest.raises(NonFiniteError, match=f"Expected finite {where}; received 1 NaN or infinite"):
        ev.regression(**{**arrays, where: spoiled(arrays[where], value)})


def test_unequal_lengths():
    with pytest.raises(ShapeError, match="equally many rows"):
        ev.regression(response=Y[:-1], regressors=PHI)
    with pytest.raises(ShapeError, match="equally many rows"):
        ev.regression(response=Y, regressors=PHI, instruments=PSI[:-1])


def test_wrong_dimensions():
    with pytest.raises(ShapeError, match="two dimensions"):
        ev.regression(response=Y, regressors=PHI[:, 0])
    with pytest.raises(ShapeError, match=r"shape \(rows,\)"):
        ev.regression(response=Y[:, None], regressors=PHI)


def test_too_few_samples():
    with pytest.raises(TooFewSamplesError, match="at least 2 rows for 2 unknowns; received 1"):
        ev.regression(response=Y[:1], regressors=PHI[:1])
    signals = ev.Signals(5.0, {"velocity_z": Y[:5], "specific_force_z": Y[:5], "input": Y[:5]})
    with pytest.raises(TooFewSamplesError, match="samples"):
        ev.identify(
            ev.VerticalMotion().regression(signals, ev.lags("input", 1, 10)), ev.methods.extended_iv()
        )


def test_fewer_instruments_than_parameters():
    with pytest.raises(InstrumentError, match="at least 2 instruments for 2 parameters; received 1"):
        ev.identify(
            ev.regression(response=Y, regressors=PHI, instruments=PSI[:, :1]), ev.methods.extended_iv()
        )


@pytest.mark.parametrize("name", ["least_squares", "total_least_squares"])
def test_collinear_regressors(name):
    Phi = np.column_stack([PHI, PHI.sum(axis=1)])
    with pytest.raises(CollinearError, match="linearly independent regressors"):
        ev.identify(ev.regression(response=Y, regressors=Phi), getattr(ev.methods, name)())


def test_total_least_squares_without_a_unique_solution():
    """A response that is orthogonal to regressors of equal size leaves no smallest direction to it."""
    A = np.zeros((4, 2))
    A[0, 0] = A[1, 1] = 1.0
    b = np.array([0.0, 0.0, 2.0, 0.0])
    with pytest.raises(NoUniqueSolutionError, match=r"sigma_min\(\[A b\]\) below sigma_min\(A\)"):
        ev.identify(ev.regression(response=b, regressors=A), ev.methods.total_least_squares())


def test_total_least_squares_with_as_many_equations_as_unknowns():
    problem = ev.regression(response=Y, regressors=PHI, instruments=PSI[:, :2])
    with pytest.raises(TooFewSamplesError, match="at least 3 equations for total least squares"):
        ev.identify(problem, ev.methods.extended_iv_tls())


@pytest.mark.parametrize("name", ["bias_compensated_least_squares", "generalized_iv", "generalized_iv_tls"])
def test_a_noise_that_is_not_declared_is_never_zero(name):
    method = getattr(ev.methods, name)()
    with pytest.raises(MissingNoiseError, match="covariance"):
        ev.identify(ev.regression(response=Y, regressors=PHI, instruments=PSI), method)
    signals = ev.Signals(5.0, {"velocity_z": PHI[:, 0], "specific_force_z": Y, "input": PHI[:, 1]})
    with pytest.raises(MissingNoiseError, match="declared noise of channel"):
        ev.identify(ev.VerticalMotion().regression(signals, ev.lags("input", 0, 4)), method)


@pytest.mark.parametrize(
    ("covariance", "match"),
    [
        (np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), "positive semidefinite"),
        (np.array([[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), "symmetric"),
    ],
)
def test_a_covariance_that_is_none(covariance, match):
    with pytest.raises(CovarianceError, match=match):
        ev.regression(response=Y, regressors=PHI, noise_covariance=covariance)


def test_covariances_of_the_wrong_size():
    with pytest.raises(ShapeError, match="3 x 3 covariance"):
        ev.regression(response=Y, regressors=PHI, noise_covariance=np.eye(2))
    with pytest.raises(ShapeError, match="3 x 3 covariance of the instruments"):
        ev.regression(
            response=Y, regressors=PHI, instruments=PSI, instrument_noise_covariance=np.zeros((2, 3))
        )


@pytest.mark.parametrize("dtype", [np.float32, np.int64, np.int16])
def test_other_number_types_are_computed_in_double_precision(dtype):
    Phi = (100.0 * PHI).astype(dtype)
    y = Phi.astype(np.float64) @ [1.0, 2.0]
    before = Phi.copy()
    fit = ev.identify(ev.regression(response=y.astype(dtype), regressors=Phi), ev.methods.least_squares())
    np.testing.assert_array_equal(Phi, before)
    assert Phi.dtype == dtype
    assert fit.residuals.dtype == np.float64
    assert fit.parameters["theta_2"] == pytest.approx(2.0, rel=1e-6)


@pytest.mark.parametrize(
    "name", ["least_squares", "total_least_squares", "extended_iv", "extended_iv_tls", "generalized_iv"]
)
def test_nothing_is_modified(name):
    arrays = [Y.copy(), PHI.copy(), PSI.copy()]
    problem = ev.regression(
        response=arrays[0],
        regressors=arrays[1],
        instruments=arrays[2],
        noise_covariance=np.eye(3),
        instrument_noise_covariance=None if name != "generalized_iv" else np.full((3, 3), 1e-3),
    )
    ev.identify(problem, getattr(ev.methods, name)()).summary()
    for array, original in zip(arrays, (Y, PHI, PSI), strict=True):
        np.testing.assert_array_equal(array, original)


class TestWhiteInput:
    """Strictly delayed inputs say nothing of a white input's gain."""

    @staticmethod
    def problem(count, *, exact):
        rng = np.random.default_rng(12)
        u = np.zeros(count)
        u[20] = 1.0
        if not exact:
            u = rng.standard_normal(count)
        v = np.zeros(count)
        for k in range(count - 1):
            v[k + 1] = 0.9 * v[k] + 0.1 * u[k]
        signals = ev.Signals(5.0, {"velocity_z": v, "input": u, "specific_force_z": 0.5 * u - 0.3 * v})
        return ev.VerticalMotion(intercept=False).regression(signals, ev.lags("input", 1, 6))

    def test_singular_equations_are_refused(self):
        """A single impulse: no lagged input is ever nonzero together with the input."""
        with pytest.raises(InstrumentError, match="numerical rank below 2"):
            ev.identify(self.problem(200, exact=True), ev.methods.extended_iv())

    def test_nearly_singular_ones_are_weak(self):
        with pytest.warns(ev.WeakInstrumentsWarning, match="singular values"):
            fit = ev.identify(self.problem(4000, exact=False), ev.methods.extended_iv())
        assert fit.status.value == "weak"

    def test_lag_zero_with_its_noise_declared_is_strong(self):
        problem = self.problem(4000, exact=False)
        signals = ev.Signals(5.0, problem.signals.channels, noise={"input": ev.WhiteNoise(std=0.0)})
        fit = ev.identify(
            ev.VerticalMotion(intercept=False).regression(signals, ev.lags("input", 0, 6)),
            ev.methods.generalized_iv(),
        )
        assert fit.status.value == "identified"
        assert fit.parameters["input_gain"] == pytest.approx(0.5, rel=1e-9)
