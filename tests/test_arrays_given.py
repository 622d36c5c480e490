"""Arrays as they are given: masked, complex, of texts; names and lags; what errors are made of."""

from __future__ import annotations

import numpy as np
import pandas as pd
import polars as pl
import pytest
from linearmodels.iv import IV2SLS

import eivor as ev
from eivor.errors import EivorError, did_you_mean
from refusal_rows import calls, rows, table

RNG = np.random.default_rng(0)
PHI = RNG.standard_normal((60, 2))
Y = PHI @ [1.0, 2.0] + 0.1 * RNG.standard_normal(60)
PSI = PHI + 0.1 * RNG.standard_normal((60, 2))
ROWS = ev.regression(response=Y, regressors=PHI, instruments=PSI)
PARAMETERS = ROWS.parameters
REGION = ev.anderson_rubin_set(ROWS, ev.methods.extended_iv()).region


def hidden(values, *positions):
    """A masked array, with 1e9 where the mask is."""
    data = np.array(values)
    mask = np.zeros(data.shape, dtype=bool)
    for position in positions:
        data[position], mask[position] = 1e9, True
    return np.ma.masked_array(data, mask)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.parametrize("argument", ["response", "regressors", "instruments"])
def test_what_a_mask_hides_is_no_value_of_a_regression(argument):
    right = {"response": Y, "regressors": PHI, "instruments": PSI}
    position = (7,) if argument == "response" else (7, 0)
    for call in (ev.regression, lambda **given: ev.Regression(**given, parameters=PARAMETERS)):
        with pytest.raises(EivorError, match=f"finite {argument}.*1 NaN or infinite, the first in row 7"):
            call(**{**right, argument: hidden(right[argument], position)})
        kept = call(**{**right, argument: np.ma.masked_array(right[argument])})
        assert type(getattr(kept, argument)) is np.ndarray
        np.testing.assert_array_equal(getattr(kept, argument), right[argument])


@pytest.mark.usefixtures("unchecked_shapes")
def test_what_a_mask_hides_is_no_value_of_signals():
    values = hidden(Y, (7,))
    valid = np.arange(60) != 7
    for mask in (valid, np.ma.masked_array(np.ones(60, dtype=bool), ~valid)):
        signals = ev.Signals(5.0, {"input": values}, valid=mask)
        assert np.isnan(signals.channels["input"][7])
        np.testing.assert_array_equal(signals.valid, valid)
    assert values.data[7] == 1e9


@pytest.mark.usefixtures("unchecked_shapes")
def test_numbers_of_other_kinds_are_converted():
    for kind in (np.float32, np.int16, np.uint8, np.bool_, object):
        values = (10.0 * np.abs(Y)).astype(np.uint8).astype(kind)
        channel = ev.Signals(5.0, {"input": values}).channels["input"]
        assert channel.dtype == np.float64
        np.testing.assert_array_equal(channel, values.astype(np.float64))
    series = pl.Series([1, None, 3])
    channel = ev.recording_from_columns({"time": [0, 1, 2], "velocity_z": series}).channels["velocity_z"]
    np.testing.assert_array_equal(channel.values, [1.0, np.nan, 3.0])


@pytest.mark.parametrize("table", [pd.DataFrame, pl.DataFrame])
def test_names_of_tables_are_kept(table):
    columns = {"slope": PHI[:, 0], "offset": PHI[:, 1]}
    fit = ev.iv(table({"y": Y})["y"], table(columns), PSI)
    assert tuple(fit.params) == fit.names == ("slope", "offset")
    assert ev.iv(Y, table(columns)["offset"]).names == ("offset",)
    assert ev.iv(Y, table(columns), PSI, names=("a", "b")).names == ("a", "b")
    assert ev.regression(Y, PHI).names == ("theta_1", "theta_2")


def test_two_stage_least_squares_is_that_of_another_package():
    fit = ev.iv(Y, PHI, PSI)
    theirs = IV2SLS(Y, None, PHI, PSI).fit(cov_type="robust")
    robust = fit.with_covariance(ev.covariances.HeteroskedasticityRobust())
    np.testing.assert_allclose(list(fit.params.values()), theirs.params, rtol=1e-9)
    np.testing.assert_allclose(list(robust.std_errors.values()), theirs.std_errors, rtol=0.05)
    unrelated = ev.iv(RNG.standard_normal(60), PHI, PSI)
    for name, p_value in unrelated.pvalues.items():
        low, high = unrelated.conf_int(1.0 - p_value)[name]
        assert min(abs(low), abs(high)) < 1e-9
    assert "60 rows; covariance: equal weighted cosines\n" in fit.summary()
    assert "first-stage F" in fit.summary()
    assert fit.to_html() == fit._repr_html_()


@pytest.mark.usefixtures("unchecked_shapes")
def test_lags_are_whole_numbers_of_any_type():
    assert ev.Column("a", np.int64(2)).name == "a(k-2)"


def test_the_nearest_name_is_proposed():
    known = ("velocity_z", "position_z", "input")
    assert did_you_mean("velocty_z", known, "Name one.") == "Did you mean 'velocity_z'?"
    assert did_you_mean("battery", known, "Name one.") == "Name one."
    both = ("velocity_z", "velocity_x", "input")
    assert did_you_mean("velocity", both, "", most=3) == "Did you mean 'velocity_z' or 'velocity_x'?"
    assert did_you_mean("battery", [], "Name one.") == "Name one."
    methods = ("reference_iv", "total_least_squares", "generalized_iv", "spectral_giv", "quadratic-drag")
    for short, meant in (
        ("giv", "generalized_iv"),
        ("TLS", "total_least_squares"),
        ("drag", "quadratic-drag"),
    ):
        assert did_you_mean(short, methods, "Name one.") == f"Did you mean '{meant}'?"


SIGNALS, FIT = ev.Signals(5.0, {"input": Y}), ev.identify(ROWS, ev.methods.least_squares())
E, IV = np.eye(3), ev.methods.extended_iv()
#: Imaginary parts were dropped, and texts read as numbers.
NO_NUMBERS = (
    (lambda x: x + 0j, "received complex ones. Take their real part"),
    (lambda x: np.ma.masked_array(x + 0j), "complex ones"),
    (lambda x: [complex(value) for value in np.ravel(x)], "complex ones"),
    (lambda x: x.astype(str).astype(object), "received values of the type object"),
    (lambda x: np.full(x.shape, 1j, dtype=object), "real numbers in"),
    (lambda _: [[1.0, 2.0], [3.0]], "real numbers in"),
)
DOORS = (
    (lambda x: ev.regression(response=x, regressors=PHI), Y),
    (lambda x: ev.regression(response=Y, regressors=x), PHI),
    (lambda x: ev.regression(response=Y, regressors=PHI, noise_covariance=x), E),
    (lambda x: ev.Signals(5.0, {"input": x}), Y),
    (lambda x: ev.recording_from_columns({"time": np.arange(60), "velocity_z": x}), Y),
    (ev.estimate_long_memory, Y),
    (REGION.contains, np.ones(2)),
)
test_refused = table(
    rows("no numbers", EivorError, lambda door, right, spoil: door(spoil(right)),
        *((*door, *spoilt) for door in DOORS for spoilt in NO_NUMBERS)),
    rows("rows", EivorError, lambda options: ev.regression(**({"response": Y, "regressors": PHI} | options)),
        # rows of it are columns; nothing is lost
        ({"regressors": [hidden(PHI[:, 0], (7,)), PHI[:, 1]]}, "equally many rows"),
        ({"names": ["a", "a"]}, "a name of its own for every parameter; received 'a' more than once"),
        ({"names": "ab"}, "several texts for names"),
        ({"noise_covariance": 1e308 * E}, r"variances up to 1e\+150; received 1e\+308"),
        ({"noise_covariance": 1e-320 * E}, "variances of zero, or from 1e-150; received 9.99989e-321"),
    ),
    calls("call", EivorError,
        (lambda: ev.Signals(5.0, {"input": hidden(Y, (7,))}),
            "'input' at every valid sample; received 1 .* at sample 7"),
        (lambda: ev.Column("a", 1.5), r"a whole number for lag; received 1.5 \(float\)"),
        (lambda: ev.identify(ROWS, "least_squares"), r"least_squares\(\) for method; received 'least"),
        (lambda: ev.bootstrap(ROWS, "least_squares"), r"least_squares\(\) for method; received 'least"),
        (lambda: ev.identify(SIGNALS, IV), "a model's regression, .*; received Signals"),
        (lambda: ev.read_log(3), r"a path, as a text or a Path for path; received 3 \(int\).*\"flight.ulg\""),
        (lambda: ev.identify_flight(3), r"received 3 \(int\).*ev.read_log"),
        (lambda: ev.identify_flight("flight.ulg"), "received str.*ev.read_log"),
        (lambda: ev.Signals("5", {"input": Y}), r"a number for rate_hz; received '5' \(str\)"),
        (lambda: ev.estimate_long_memory(PHI), r"a record of shape \(n,\); received shape \(60, 2\)"),
        (lambda: ev.derived(FIT, lambda _: "x"), "a number for what the function gives; received 'x'"),
        (lambda: FIT.with_covariance("classical"), r"ev.covariances.Classical\(\)"),
        (lambda: ev.WhiteNoise(1e200), "a standard deviation up to 1e"),
    ),
)  # fmt: skip
