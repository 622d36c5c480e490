"""Covariance estimators against linearmodels and Stata, on the whole record and in chunks."""

from __future__ import annotations

from dataclasses import replace
from importlib import resources

import linearmodels
import numpy as np
import polars as pl
import pytest

import eivor as ev
from eivor.errors import UsageError
from eivor.inference.covariances import TABLE
from eivor.studies.scenario_file import shipped_scenario
from reference import constants as truth

cov = ev.covariances
METHODS = (
    (ev.methods.least_squares(), ()),
    (ev.methods.total_least_squares(), ()),
    (ev.methods.bias_compensated_least_squares(), ()),
    (ev.methods.extended_iv(), ev.lags("input", 1, 10)),
    (ev.methods.extended_iv(ev.methods.TwoStage()), ev.lags("input", 1, 10)),
    (ev.methods.generalized_iv(), ev.lags("input", 0, 10)),
    (ev.methods.generalized_iv_tls(), ev.lags("input", 0, 10)),
)
MOTION = ev.VerticalMotion(intercept=False)


@pytest.fixture(scope="module")
def housing():
    """Rents on house values (endogenous), share of city dwellers and a constant, in Stata's order."""
    path = resources.files("linearmodels.tests.iv.results").joinpath("housing.csv")
    table = pl.read_csv(path.read_bytes())
    regions = sorted(set(table["region"]))[1:]
    exogenous = np.column_stack([table["pcturban"], np.ones(table.height)]).astype(float)
    excluded = np.column_stack([table["faminc"], *[(table["region"] == r).cast(int) for r in regions]])
    y, endogenous = (table[name].to_numpy().astype(float) for name in ("rent", "hsngval"))
    problem = ev.regression(
        response=y,
        regressors=np.column_stack([endogenous, exogenous]),
        instruments=np.column_stack([exogenous, excluded]),
        names=["hsngval", "pcturban", "const"],
    )
    fit = ev.identify(problem, ev.methods.extended_iv(ev.methods.TwoStage()))
    peer = linearmodels.IV2SLS(y, exogenous, endogenous[:, None], excluded)
    return fit, peer


def in_our_order(covariance):
    order = [2, 0, 1]
    return covariance.to_numpy()[np.ix_(order, order)]


@pytest.mark.parametrize(
    ("estimator", "published"),
    [(cov.Classical(), truth.STATA_CLASSICAL), (cov.HeteroskedasticityRobust(), truth.STATA_ROBUST)],
    ids=["classical", "robust"],
)
def test_stata_s_printed_covariances(housing, estimator, published):
    found = housing[0].with_covariance(estimator).covariance
    np.testing.assert_allclose(found, published, rtol=2e-7)


def test_linearmodels_robust_covariance(housing):
    fit, peer = housing
    found = fit.with_covariance(cov.HeteroskedasticityRobust()).covariance
    np.testing.assert_allclose(found, in_our_order(peer.fit(cov_type="robust").cov), rtol=1e-8)


@pytest.mark.parametrize("bandwidth", [0, 1, 5, 20])
@pytest.mark.parametrize(
    ("kernel", "name"),
    [(cov.Bartlett(), "bartlett"), (cov.Parzen(), "parzen"), (cov.QuadraticSpectral(), "qs")],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_linearmodels_kernel_covariances(housing, kernel, name, bandwidth):
    fit, peer = housing
    estimator = cov.KernelRobust(kernel, cov.FixedBandwidth(float(bandwidth)))
    wanted = peer.fit(cov_type="kernel", kernel=name, bandwidth=bandwidth).cov
    np.testing.assert_allclose(fit.with_covariance(estimator).covariance, in_our_order(wanted), rtol=1e-8)


def test_critical_values_follow_the_covariance(housing):
    fit, _ = housing
    widths = {}
    for fixed_b in (False, True):
        chosen = cov.KernelRobust(cov.Bartlett(), cov.FixedBandwidth(9.0), fixed_b=fixed_b)
        low, high = fit.with_covariance(chosen).interval("pcturban")
        widths[fixed_b] = 0.5 * (high - low) / fit.with_covariance(chosen).std_error("pcturban")
    assert widths[False] == pytest.approx(1.959964, rel=1e-6)
    # The record has 50 rows: b = 0.2.
    assert widths[True] == pytest.approx(2.6, rel=1e-3)


# -- signals, chunks -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def record():
    scenario = replace(shipped_scenario("rich-high"), samples=3000)
    return ev.simulate(scenario, np.random.default_rng(1)).signals


def chunks_of(record, size, last=None):
    def chunks():
        for start in range(0, last or record.sample_count, size):
            channels = {name: values[start : start + size] for name, values in record.channels.items()}
            yield ev.Signals(record.rate_hz, channels, noise=record.noise, offset=start)

    return chunks


@pytest.mark.parametrize(("method", "instruments"), METHODS, ids=lambda value: getattr(value, "name", ""))
def test_chunks_give_the_covariance_of_the_whole_record(record, method, instruments):
    whole = ev.identify(MOTION.regression(record, instruments), method)
    for name, make in TABLE.items():
        found = ev.identify_chunks(
            chunks_of(record, 457), model=MOTION, method=method, instruments=instruments, covariance=make()
        )
        wanted = whole.with_covariance(make())
        np.testing.assert_allclose(found.covariance, wanted.covariance, rtol=1e-6, err_msg=name)
        for parameter in whole.names:
            assert found.interval(parameter) == pytest.approx(wanted.interval(parameter), rel=1e-7)
    assert "std. error" in found.summary()


@pytest.mark.parametrize(("method", "instruments"), METHODS, ids=lambda value: getattr(value, "name", ""))
def test_scores_add_up_to_zero_and_sensitivity_is_their_derivative(record, method, instruments):
    """At the solution the scores sum to nothing, and M is minus the derivative of their sum."""
    from eivor.estimation.equation_rows import MethodEquations, estimating_equation

    problem = MOTION.regression(record, instruments)
    fit = ev.identify(problem, method)
    equation, solved = fit.best.equation, fit.best.solved
    scale = np.abs(equation.scores).sum(axis=0)
    # Total least squares of moment equations solves them to second order only.
    exact = 1e-3 if fit.method == "generalized_iv_tls" else 1e-9
    assert np.all(np.abs(equation.scores.sum(axis=0)) < exact * scale)
    if method.assembler.moment_equations:

        def total(theta):
            moved = replace(solved.solution, theta=theta)
            constant = method.assembler.score_constants(problem, theta)
            pieces = MethodEquations(method, solved.system, solved.factor, moved)
            return estimating_equation(
                pieces, constant, problem.blocks, solved.count, np.empty((0, 0))
            ).scores.sum(axis=0)

        step = 1e-3 * fit.best.values
        columns = [
            (total(fit.best.values - step * unit) - total(fit.best.values + step * unit)) / (2 * step[i])
            for i, unit in enumerate(np.eye(2))
        ]
        np.testing.assert_allclose(np.column_stack(columns), equation.sensitivity, rtol=1e-6)


def test_blocks_of_rows_are_the_rows(record):
    masked = replace(record, valid=np.random.default_rng(0).random(record.sample_count) > 0.02)
    for signals in (record, masked):
        problem = MOTION.regression(signals, ev.lags("input", 0, 4))
        rows = problem.rows()
        for made in (list(problem.blocks(700)), list(rows.blocks(700))):
            np.testing.assert_array_equal(np.concatenate([block.response for block in made]), rows.response)
            np.testing.assert_array_equal(
                np.concatenate([block.regressors for block in made]), rows.regressors
            )
            np.testing.assert_array_equal(
                np.concatenate([block.instruments for block in made]), rows.instruments
            )


def test_passes_over_other_chunks_are_refused(record):
    calls = []

    def chunks():
        calls.append(1)
        return chunks_of(record, 500, None if len(calls) == 1 else 2000)()

    with pytest.raises(UsageError, match="of 2990 rows in every pass; received 1990"):
        ev.identify_chunks(
            chunks, model=MOTION, method=ev.methods.generalized_iv(), instruments=ev.lags("input", 0, 10)
        )


def test_covariances_that_cannot_be_are_refused(record):
    fit = ev.identify(MOTION.regression(record), ev.methods.least_squares())
    with pytest.raises(UsageError, match="ClusteredByFlight can use; received too few flights"):
        fit.with_covariance(cov.ClusteredByFlight()).interval("input_gain")
    with pytest.raises(UsageError, match="one cosine average or more; received 0"):
        cov.EqualWeightedCosines(0)
