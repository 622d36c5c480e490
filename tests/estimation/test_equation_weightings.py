"""Two-stage and two-step weightings against linearmodels and Stata."""

from __future__ import annotations

from importlib import resources

import numpy as np
import pytest

import eivor as ev
from reference import constants as truth

linearmodels = pytest.importorskip("linearmodels")


@pytest.fixture(scope="module")
def housing():
    """Rents on house values (endogenous), share of city dwellers and a constant."""
    polars = pytest.importorskip("polars")
    path = resources.files("linearmodels.tests.iv.results").joinpath("housing.csv")
    table = polars.read_csv(path.read_bytes())
    regions = sorted(set(table["region"]))[1:]
    constant = np.ones(table.height)
    exogenous = np.column_stack([table["pcturban"], constant])
    excluded = np.column_stack(
        [table["faminc"], *[(table["region"] == region).cast(int) for region in regions]]
    )
    return (
        table["rent"].to_numpy().astype(float),
        table["hsngval"].to_numpy().astype(float),
        exogenous,
        excluded,
    )


def problem_of(housing):
    y, endogenous, exogenous, excluded = housing
    return ev.regression(
        response=y,
        regressors=np.column_stack([endogenous, exogenous]),
        instruments=np.column_stack([exogenous, excluded]),
        names=["hsngval", "pcturban", "const"],
    )


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
class TestAgainstPeers:
    def test_two_stage_least_squares(self, housing):
        fit = ev.identify(problem_of(housing), ev.methods.extended_iv(ev.methods.TwoStage()))
        y, endogenous, exogenous, excluded = housing
        peer = linearmodels.IV2SLS(y, exogenous, endogenous, excluded).fit().params.to_numpy()
        np.testing.assert_allclose(
            [fit.parameters[name] for name in ("pcturban", "const", "hsngval")], peer, rtol=1e-8
        )
        for name, published in truth.STATA_2SLS.items():
            assert fit.parameters[name] == pytest.approx(published, rel=1e-7)

    def test_limited_information(self, housing):
        """Stata's manual, ivregress: `ivregress liml rent pcturban (hsngval = faminc i.region)`."""
        fit = ev.identify(problem_of(housing), ev.methods.liml())
        for name, printed in truth.STATA_LIML.items():
            assert fit.parameters[name] == pytest.approx(printed, rel=2e-5)

    @pytest.mark.parametrize("bandwidth", [0, 1, 4])
    def test_two_step_gmm(self, housing, bandwidth):
        method = ev.methods.extended_iv(ev.methods.TwoStepRobust(bandwidth=bandwidth))
        fit = ev.identify(problem_of(housing), method)
        y, endogenous, exogenous, excluded = housing
        weights = (
            {"weight_type": "robust"}
            if bandwidth == 0
            else {"weight_type": "kernel", "kernel": "bartlett", "bandwidth": bandwidth}
        )
        peer = linearmodels.IVGMM(y, exogenous, endogenous, excluded, **weights).fit(iter_limit=2)
        np.testing.assert_allclose(
            [fit.parameters[name] for name in ("pcturban", "const", "hsngval")],
            peer.params.to_numpy(),
            rtol=1e-8,
        )

    def test_two_step_gmm_prints_stata_s_numbers(self, housing):
        fit = ev.identify(problem_of(housing), ev.methods.extended_iv(ev.methods.TwoStepRobust(bandwidth=0)))
        for name, published in truth.STATA_GMM.items():
            assert fit.parameters[name] == pytest.approx(published, rel=1e-7)
        J = problem_of(housing).response.size * fit.best.solution.objective
        assert pytest.approx(truth.STATA_GMM_J, rel=1e-9) == J


def test_weak_instruments_are_told():
    rng = np.random.default_rng(3)
    n = 500
    x, z = rng.standard_normal(n), rng.standard_normal((n, 3))
    problem = ev.regression(response=x + rng.standard_normal(n), regressors=x[:, None], instruments=z)
    with pytest.warns(UserWarning, match="singular values"):
        fit = ev.identify(problem, ev.methods.extended_iv())
    assert fit.status.value == "weak"
    assert "first-stage F" in fit.summary()


def test_strong_instruments_are_not_called_weak():
    rng = np.random.default_rng(4)
    z = rng.standard_normal((500, 3))
    x = z.sum(axis=1) + rng.standard_normal(500)
    fit = ev.identify(
        ev.regression(response=2.0 * x, regressors=x[:, None], instruments=z), ev.methods.extended_iv()
    )
    assert fit.status.value == "identified"
