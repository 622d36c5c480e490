"""Problems that have no honest answer: each is refused with the reason and the remedy."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from test_recursive import chunks_of

import eivor as ev
from eivor.errors import (
    CollinearError,
    CovarianceError,
    EstimationError,
    InstrumentError,
    MissingNoiseError,
    NonFiniteError,
    TooFewSamplesError,
    UsageError,
)

RNG = np.random.default_rng(0)
ROWS = 50
M = ev.methods
MOTION = ev.VerticalMotion(intercept=False)
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


def test_too_few_samples():
    with pytest.raises(TooFewSamplesError, match="at least 2 rows for 2 unknowns; received 1"):
        ev.regression(response=Y[:1], regressors=PHI[:1])
    signals = ev.Signals(5.0, {"velocity_z": Y[:5], "specific_force_z": Y[:5], "input": Y[:5]})
    with pytest.raises(TooFewSamplesError, match="samples"):
        ev.identify(
            ev.VerticalMotion().regression(signals, ev.lags("input", 1, 10)), ev.methods.extended_iv()
        )


EVERY_METHOD = (
    ev.methods.least_squares(),
    ev.methods.total_least_squares(),
    ev.methods.bias_compensated_least_squares(),
    ev.methods.extended_iv(),
    ev.methods.extended_iv(ev.methods.TwoStage()),
    ev.methods.extended_iv(ev.methods.TwoStepRobust()),
    ev.methods.extended_iv_tls(),
    ev.methods.generalized_iv(),
    ev.methods.generalized_iv_tls(),
)


@pytest.mark.parametrize("method", EVERY_METHOD, ids=lambda method: method.name)
def test_as_many_rows_as_unknowns(method):
    """Anything fits them: standard errors of 6e-17 of nothing."""
    problem = ev.regression(
        response=Y[:2],
        regressors=PHI[:2],
        instruments=PSI[:2],
        noise_covariance=np.diag([0.0, 0.0, 1.0]),
        instrument_noise_covariance=np.zeros((3, 3)),
    )
    with pytest.raises(TooFewSamplesError, match=r"more rows than the 2 unknowns.*received 2"):
        ev.identify(problem, method)
    record = quiet(PHI[:6, 1], PHI[:6, 0], Y[:6], specific_force_z=0.1)
    moments = ev.moments([record], model=MOTION, method=method, instruments=ev.lags("input", 1, 4))
    with pytest.raises(TooFewSamplesError, match=r"more rows than the 2 unknowns.*received 2"):
        ev.identify(moments, method)
    with pytest.raises(TooFewSamplesError, match="more rows than the 2 unknowns"):
        ev.bootstrap(problem, method, runs=2)


@pytest.mark.parametrize("name", ["least_squares", "total_least_squares"])
def test_collinear_regressors(name):
    Phi = np.column_stack([PHI, PHI.sum(axis=1)])
    with pytest.raises(CollinearError, match="linearly independent regressors"):
        ev.identify(ev.regression(response=Y, regressors=Phi), getattr(ev.methods, name)())


@pytest.mark.parametrize("name", ["bias_compensated_least_squares", "generalized_iv", "generalized_iv_tls"])
def test_a_noise_that_is_not_declared_is_never_zero(name):
    method = getattr(ev.methods, name)()
    with pytest.raises(MissingNoiseError, match="covariance"):
        ev.identify(ev.regression(response=Y, regressors=PHI, instruments=PSI), method)
    signals = ev.Signals(5.0, {"velocity_z": PHI[:, 0], "specific_force_z": Y, "input": PHI[:, 1]})
    with pytest.raises(MissingNoiseError, match="declared noise of channel"):
        ev.identify(ev.VerticalMotion().regression(signals, ev.lags("input", 0, 4)), method)


@pytest.mark.parametrize(
    ("regressors", "noise"),
    [
        (PHI, np.diag([100.0, 100.0, 0.0])),
        (PHI, np.diag([0.0, 100.0, 0.0])),
        # each less than the moments, and more than their sum's
        (PHI @ [[1.0, 1.0], [0.0, 0.1]], np.array([[0.3, -0.25, 0.0], [-0.25, 0.3, 0.0], [0.0, 0.0, 0.0]])),
        (np.zeros((ROWS, 2)), np.diag([1.0, 1.0, 0.0])),
    ],
)
def test_noise_above_the_regressors_own_moments(regressors, noise):
    """What is left would be negative: (-.010, -.019) for (1, 2) with errors to match."""
    problem = ev.regression(response=Y, regressors=regressors, noise_covariance=noise)
    with pytest.raises(CovarianceError, match=r"exceed their declared noise.*eigenvalue -.*generalized_iv"):
        ev.identify(problem, ev.methods.bias_compensated_least_squares())
    record = quiet(regressors[:, 1], regressors[:, 0], Y, velocity_z=10.0)
    method = ev.methods.bias_compensated_least_squares()
    with pytest.raises(CovarianceError, match="exceed their declared noise"):
        ev.identify_chunks(lambda: [record], model=MOTION, method=method)


@pytest.mark.parametrize(("over", "told"), [(0.9, False), (1.1, True)])
def test_more_noise_than_there_is_of_a_column_that_is_its_own_instrument(over, told):
    """Of an instrument that is another column nothing of the kind can be seen, nor said."""
    noise = np.zeros((3, 3))
    noise[0, 0] = over * np.mean(PHI[:, 0] ** 2)
    instruments = np.column_stack([-2.0 * PHI[:, 0], PSI[:, 1:]])
    shared = np.diag([-2.0, 1.0, 1.0]) @ noise
    result = ev.identify(
        ev.regression(
            response=Y, regressors=PHI, instruments=instruments, instrument_noise_covariance=shared
        ),
        ev.methods.generalized_iv(),
    )
    assert ("1.05 times its root mean square" in result.summary()) is told
    other = np.zeros((3, 3))
    other[1, 0] = 10.0
    elsewhere = ev.regression(
        response=Y, regressors=PHI, instruments=instruments, instrument_noise_covariance=other
    )
    assert "root mean square" not in ev.identify(elsewhere, ev.methods.generalized_iv()).summary()


CALLER = """
import warnings
import numpy as np
import eivor as ev

rng = np.random.default_rng(3)
x, noise = rng.standard_normal((2, 200))
problem = ev.regression(response=x + noise, regressors=x[:, None], instruments=noise[::-1, None])
signals = ev.Signals(1.0, {"velocity_z": x, "input": noise, "specific_force_z": x + noise})
motion, instruments = ev.VerticalMotion(intercept=False), ev.lags("input", 1, 3)
method = ev.methods.extended_iv()
total = ev.moments([signals], model=motion, method=method, instruments=instruments)

def of_rows():
    ev.identify(problem, method)  # of_rows

def of_moments():
    ev.identify(total, method)  # of_moments

def of_chunks():
    ev.identify_chunks(lambda: [signals], model=motion, method=method, instruments=instruments)  # of_chunks

for function in (of_rows, of_moments, of_chunks):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        function()
    (one,) = told
    print(function.__name__, one.category.__name__, one.filename, one.lineno)
"""


@pytest.mark.thorough
def test_the_warning_of_weak_instruments_points_to_the_users_line(tmp_path):
    """In a process of its own: the checks of shapes in this one are frames between the two."""
    file = tmp_path / "caller.py"
    file.write_text(CALLER, encoding="utf-8")
    done = subprocess.run([sys.executable, str(file)], capture_output=True, text=True, check=True)
    lines = CALLER.splitlines()
    for splitline in done.stdout.splitlines():
        name, category, filename, number = splitline.split()
        assert category == "WeakInstrumentsWarning"
        assert filename == str(file)
        assert lines[int(number) - 1].endswith(f"# {name}")
    assert len(done.stdout.splitlines()) == 3


def test_singular_equations_are_refused():
    """A single impulse: no lagged input is ever nonzero together with the input; and no regressors at all."""
    u = (np.arange(200) == 20).astype(float)
    v = np.zeros(200)
    for k in range(199):
        v[k + 1] = 0.9 * v[k] + 0.1 * u[k]
    impulse = ev.Signals(5.0, {"velocity_z": v, "input": u, "specific_force_z": 0.5 * u - 0.3 * v})
    with pytest.raises(InstrumentError, match="numerical rank below 2"):
        ev.identify(MOTION.regression(impulse, ev.lags("input", 1, 6)), ev.methods.extended_iv())
    nothing = ev.regression(response=Y, regressors=np.zeros((ROWS, 2)), noise_covariance=np.zeros((3, 3)))
    with pytest.raises(InstrumentError, match="numerical rank below 2"):
        ev.identify(nothing, ev.methods.bias_compensated_least_squares())
    few = ev.regression(response=Y, regressors=PHI, instruments=PSI[:, :1])
    with pytest.raises(InstrumentError, match="at least 2 instruments for 2 parameters; received 1"):
        ev.identify(few, ev.methods.extended_iv())


def quiet(x, v, y, **stds):
    """Signals of three columns with declared noises, none unless said."""
    channels = {"velocity_z": v, "input": x, "specific_force_z": y}
    return ev.Signals(5.0, channels, noise={name: ev.WhiteNoise(stds.get(name, 0.0)) for name in channels})


def signals(seed, rows=400):
    """A record with noise of every channel and an input with memory."""
    rng = np.random.default_rng(seed)
    u = np.convolve(rng.standard_normal(rows + 2), [0.5, 1.0, 0.5], mode="valid")
    v = np.zeros(rows)
    for k in range(1, rows):
        v[k] = 0.9 * v[k - 1] + 0.3 * u[k - 1]
    stds = {"velocity_z": 0.1, "input": 0.2, "specific_force_z": 0.3}
    errors = (stds[name] * rng.standard_normal(rows) for name in ("velocity_z", "input", "specific_force_z"))
    velocity, drive, response = (x + e for x, e in zip((v, u, 1.5 * u - 0.8 * v), errors, strict=True))
    return quiet(drive, velocity, response, **stds)


def problem_of(seed, first=0, last=6):
    return MOTION.regression(signals(seed), ev.lags("input", first, last))


def test_moments_without_an_equation_left_over_tell_no_noise():
    square = M.regularised(M.bias_compensated_least_squares())
    with pytest.raises(
        EstimationError, match=r"more equations than the 2 unknowns .*moments count, not rows"
    ):
        ev.identify(problem_of(3), square)
    ev.identify(problem_of(3), M.regularised(M.bias_compensated_least_squares(), parameter=0.1))


@pytest.mark.parametrize(
    "name", ["least_squares", "total_least_squares", "generalized_iv", "generalized_iv_tls"]
)
def test_nothing_is_changed_by_a_parameter_of_zero(name):
    method, made = getattr(M, name)(), problem_of(4)
    plain = ev.identify(made, method)
    result = ev.identify(made, M.regularised(method, parameter=0.0))
    np.testing.assert_allclose(result.values, plain.values, rtol=1e-9)
    np.testing.assert_allclose(result.covariance, plain.covariance, rtol=1e-7)
    assert result.status is plain.status
    assert result.method == f"{name}_tikhonov"


def test_towards_the_estimate_of_another_method():
    """All the way it is that estimate; the input's gain of a white input is then that of least squares."""
    made, least = problem_of(7), M.least_squares()
    result = ev.identify(made, M.regularised(M.generalized_iv(), parameter=1e9, towards=least))
    wanted = ev.identify(made, least)
    np.testing.assert_allclose(result.values, wanted.values, rtol=1e-6)
    assert result.status is ev.Status.WEAK
    given = M.regularised(M.generalized_iv(), parameter=0.5, towards=wanted.theta)
    named = M.regularised(M.generalized_iv(), parameter=0.5, towards=least)
    np.testing.assert_allclose(ev.identify(made, given).values, ev.identify(made, named).values, rtol=1e-12)
    assert named.needs_instruments


def test_chunks_are_the_whole_record():
    record, columns = signals(8), ev.lags("input", 0, 6)
    for method in (M.regularised(M.least_squares()), M.regularised(M.generalized_iv())):
        whole = ev.identify(MOTION.regression(record, columns), method)
        parts = ev.identify_chunks(
            lambda: chunks_of(record, [90, 200]), model=MOTION, method=method, instruments=columns
        )
        np.testing.assert_allclose(parts.values, whole.values, rtol=1e-9)
        assert parts.interval("input_gain") == pytest.approx(whole.interval("input_gain"), rel=1e-6)


def test_what_cannot_be_regularised_is_refused():
    with pytest.raises(UsageError, match="solved by least squares or total least squares; received fuller"):
        M.regularised(M.fuller(), towards=M.least_squares())
    with pytest.raises(UsageError, match="solved by least squares"):
        M.regularised(M.regularised(M.generalized_iv()))
