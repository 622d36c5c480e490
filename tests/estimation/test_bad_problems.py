"""Problems that have no honest answer, and calls that do not fit: refused with the reason and the remedy."""

from __future__ import annotations

import itertools
import subprocess
import sys
from dataclasses import replace
from functools import cache, partial

import numpy as np
import polars as pl
import pytest
import test_dense_total_least_squares as dense
import test_nuisances as nuisances
import test_paper_methods as paper
import test_recursive as stream
import test_spectral_methods as spectral
import test_weak_identification as weak
from scipy.signal import lfilter
from test_recursive import chunks_of

import eivor as ev
from eivor.errors import (
    ChannelMapError,
    CollinearError,
    ConvergenceError,
    CovarianceError,
    EstimationError,
    InputError,
    InstrumentError,
    MissingNoiseError,
    NonFiniteError,
    ParameterError,
    TooFewSamplesError,
    UsageError,
)
from eivor.estimation.bootstrap import bootstrap, pool_flights
from eivor.estimation.linear import refined_nuisances
from eivor.models.regression import SampleRows
from flights.flight_logs import Noise, flights
from flights.flight_logs import problem as flight_problem
from refusal_rows import calls, rows, table

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


def test_a_given_parameter_needs_no_equation_left_over():
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


LS, GIV, EIV, SPECTRAL = M.least_squares(), M.generalized_iv(), M.extended_iv(), M.spectral_giv()
BCLS, TLS, VERTICAL = M.bias_compensated_least_squares(), M.total_least_squares(), ev.VerticalMotion()
UNKNOWN = M.generalized_iv_unknown_noise
identify = ev.identify


def of_arrays(method, **changes):
    return identify(ev.regression(**({"response": Y, "regressors": PHI} | changes)), method)


def not_finite(name, made, value):
    of_arrays(EIV, **{"instruments": PSI, name: spoiled(made, value)})


def of_signals(method, first, last=4, rows=ROWS):
    channels = {"velocity_z": PHI[:rows, 0], "specific_force_z": Y[:rows], "input": PHI[:rows, 1]}
    return identify(VERTICAL.regression(ev.Signals(5.0, channels), ev.lags("input", first, last)), method)


def as_many_rows_as_unknowns(method, door):
    """Anything fits them: standard errors of 6e-17 of nothing."""
    noise = {"noise_covariance": np.diag([0.0, 0.0, 1.0]), "instrument_noise_covariance": np.zeros((3, 3))}
    problem = ev.regression(response=Y[:2], regressors=PHI[:2], instruments=PSI[:2], **noise)
    if door == "bootstrap":
        return ev.bootstrap(problem, method, runs=2)
    if door == "moments":
        record = quiet(PHI[:6, 1], PHI[:6, 0], Y[:6], specific_force_z=0.1)
        problem = ev.moments([record], model=MOTION, method=method, instruments=ev.lags("input", 1, 4))
    return identify(problem, method)


def too_noisy(regressors, noise):
    """What is left would be negative: (-.010, -.019) for (1, 2) with errors to match."""
    return of_arrays(BCLS, regressors=regressors, noise_covariance=noise)


def too_noisy_in_chunks(regressors, noise):
    record = quiet(regressors[:, 1], regressors[:, 0], Y, velocity_z=10.0)
    return ev.identify_chunks(lambda: [record], model=MOTION, method=BCLS)


TOO_NOISY = (
    (PHI, np.diag([100.0, 100.0, 0.0])),
    (PHI, np.diag([0.0, 100.0, 0.0])),
    # each less than the moments, and more than their sum's
    (PHI @ [[1.0, 1.0], [0.0, 0.1]], np.array([[0.3, -0.25, 0.0], [-0.25, 0.3, 0.0], [0.0, 0.0, 0.0]])),
    (np.zeros((ROWS, 2)), np.diag([1.0, 1.0, 0.0])),
)


def impulse():
    """No lagged input is ever nonzero together with the input."""
    u = (np.arange(200) == 20).astype(float)
    v = lfilter([0.0, 0.1], [1.0, -0.9], u)
    signals = ev.Signals(5.0, {"velocity_z": v, "input": u, "specific_force_z": 0.5 * u - 0.3 * v})
    identify(MOTION.regression(signals, ev.lags("input", 1, 6)), EIV)


def fractional(method, instruments=(), model=dense.MODEL, made=None, **options):
    return identify(model.problem(made or dense.record(**options), instruments), method)


BARE = ev.Signals(1.0, dense.record().channels)
FLAT = ev.Signals(1.0, dict(BARE.channels) | {"output": np.zeros(1500)})  # no order explains it better
NARROW = ev.FractionalDifferenceModel((0.0, ev.UnknownOrder("order", 0.2, 0.5)), (0.0,))
DIFFERENCE = ev.FractionalDifferenceModel((0.0, dense.ORDER), (0.0, 0.5))  # with the noise of all past inputs


def steps_that_never_end():
    changes = itertools.cycle((-0.1, 0.1))

    def wandering(linear):
        solved = LS.solve(linear)
        if len(linear.parameters) == 3:
            solved.solution.theta[-1] = next(changes)
        return solved

    refined_nuisances(dense.MODEL.problem(dense.record(noise_ratio=0.0)), wandering, {"order": 0.7})


def of_unknown_noise(method, *instruments):
    identify(dense.undeclared(dense.record_unknown(samples=200), *instruments), method)


@cache
def of_a_flight():
    return identify(flight_problem(*flights(1, seconds=8.0, noise=Noise(), seed=6)), LS)


def level_of_a_flight(level):
    of_a_flight().interval("viscous_friction", level)


RESAMPLED = nuisances.rows_of(np.arange(nuisances.ROWS), compensated=True)
POOLED = replace(RESAMPLED, layout=SampleRows(np.arange(nuisances.ROWS) // 500))


@cache
def replicates():
    return bootstrap(RESAMPLED, LS, runs=5)


def drawn_again(which, method):
    problem = nuisances.pool(which, nuisances.lag(), nuisances.PRIOR_OF_SHARE)
    pool_flights(problem, identify(problem, method))


def of_moments(made_by, method):
    identify(moments_by(made_by), stream.METHODS[method][0])


def moments_by(name, rates=(1.0,)):
    method, instruments = stream.METHODS[name]
    made = stream.flight_record()
    chunks = [ev.Signals(rate * made.rate_hz, made.channels, noise=made.noise) for rate in rates]
    return ev.moments(chunks, model=stream.STREAM_MOTION, method=method, instruments=instruments)


def recursion(method, instruments=stream.INSTRUMENTS, last=50):
    made = ev.RecursiveIdentification(MOTION, method, instruments)
    return (made.update(stream.part(stream.record(50), 0, last)) if last else made).estimate()


RECORD = spectral.problem_of("rich", 500, 1)
LONG_MEMORY = {**RECORD.signals.noise, "input": ev.FractionalNoise(0.1, -0.3)}
COLOURED = replace(RECORD, signals=replace(RECORD.signals, noise=LONG_MEMORY))
MIXED = (*ev.lags("input", 0, 3), ev.Column("velocity_z", 1))


def sign_perturbed(problem, method, **options):
    ev.sign_perturbed_set(problem, method, np.random.default_rng(0), **options)


def weak_problem(first, last, seed=37):
    return MOTION.regression(weak.simulated("white", 300, [seed]), ev.lags("input", first, last))


def ones(**noise):
    column = np.ones((30, 1))
    return ev.regression(response=np.arange(30.0), regressors=column, instruments=column, **noise)


def endless(p):
    return float("inf") if p["a"] < 0.0 else 1.0 / p["a"]


def region(method=GIV, last=3, **options):
    return ev.anderson_rubin_set(weak_problem(0, last), method, **options)


SHARED_NOISE, _ = paper.noisy_problem(instruments=3)
AT_END = r"inside the range of order; received one at its end, 0\.5"
SQUARE = r"more equations than the 2 unknowns .*moments count, not rows"
UNDIAGNOSED = "an estimate with its rows available, for diagnostics"
SOLVED_BY = "solved by least squares or total least squares; received fuller"
DIAGNOSTIC = "a diagnostic out of first_stage, over_identification"
MERGED = "Merge moments that one method made"
FIRST_STEP = "errors' covariance was estimated"
METHOD = r"eivor.methods.least_squares\(\) for method; received 'least_squ"
SHARES = "no regressor and no response shares"
OF_OTHERS = "whose measurement noise no regressor and no response"
DERIVED = weak.fit_of(4.0)
NOTHING = {"regressors": np.zeros((ROWS, 2)), "noise_covariance": np.zeros((3, 3))}
COLLINEAR = np.column_stack([PHI, PHI.sum(axis=1)])
EXACT = {"response": PHI @ [1.0, 2.0], "regressors": PHI, "instruments": PSI}
INDEPENDENT = "linearly independent regressors"
LEFT, EXCEED = r"exceed their declared noise.*eigenvalue -.*generalized_iv", "exceed their declared noise"
OF_CHANNEL = "declared noise of channel"
collinear, undeclared = partial(of_arrays, regressors=COLLINEAR), partial(of_arrays, instruments=PSI)
LEVEL = "Expected a confidence level between 0 and 1"
UNDECLARED = (BCLS, GIV, M.generalized_iv_tls())
FEW_ROWS = calls("few rows", TooFewSamplesError,
    (lambda: of_arrays(LS, response=Y[:1], regressors=PHI[:1]), "at least 2 rows for 2 unknowns; received 1"),
    (lambda: of_signals(EIV, 1, 10, rows=5), "samples"),
    (lambda: fractional(LS, count=3), "more rows than the 3 unknowns"),
    (lambda: fractional(GIV, dense.FRACTIONAL_LAGS, count=8), "Give a longer record"),
    (lambda: recursion(GIV, last=0), "none so far"),
    (lambda: recursion(GIV, last=5), "not forgotten"),
    (lambda: moments_by("generalized_iv", ()), "largest lag"),
    (lambda: region(averages=3), "as many cosine averages as equations"),
)  # fmt: skip
INSTRUMENTS = calls("instruments", InstrumentError,
    (impulse, "numerical rank below 2"),
    (lambda: of_arrays(BCLS, **NOTHING), "rank below 2, by the columns of theta_2"),
    (lambda: of_arrays(EIV, instruments=PSI[:, :1]), "at least 2 instruments for 2 parameters; received 1"),
    (lambda: fractional(EIV, ev.lags("input", 1, 10), DIFFERENCE), "whose measurement noise no regressor"),
    (lambda: fractional(GIV, dense.FRACTIONAL_LAGS[:2], made=BARE), "3 independent instruments for 3 unk"),
    (lambda: of_unknown_noise(M.bias_eliminating_least_squares(), ()), "4 unknowns"),
    (lambda: identify(SHARED_NOISE, EIV), OF_OTHERS),
    (lambda: identify(SHARED_NOISE, M.extended_iv_tls()), OF_OTHERS),
    (lambda: recursion(EIV), SHARES),
    (lambda: identify(replace(RECORD, instrument_columns=MIXED), SPECTRAL), "of the input alone"),
    (lambda: sign_perturbed(weak_problem(0, 3, 36), GIV), "independent of the errors, without compensation"),
    (lambda: sign_perturbed(weak_problem(1, 3, 36), EIV), "noise is in the errors of other rows"),
    (lambda: sign_perturbed(ones(instrument_noise_covariance=[[0.1, 0.0]]), EIV), SHARES),
    (lambda: region(last=0), "at least 2 independent instruments"),
)  # fmt: skip
NOISES = calls("noise", MissingNoiseError,
    (lambda: fractional(GIV, dense.FRACTIONAL_LAGS, made=BARE), "a declared noise of channel 'input'"),
    (lambda: fractional(BCLS, made=BARE), "a declared noise of channel"),
    (lambda: recursion(GIV, ev.lags("velocity_z", 0, 2)), "velocity_z"),
    (lambda: identify(spectral.without_noise(RECORD, "input", "velocity_z"), M.whittle_ml()),
        r"noise of input.*spectral_giv"),
)  # fmt: skip
NUISANCES = calls("nuisance", ParameterError,
    (lambda: ev.Prior(0.1, 0.0), "positive standard error"),
    (lambda: ev.Prior(np.inf, 1.0), "finite mean"),
    (lambda: nuisances.lag(grid=np.array([0.2, 0.1])), "values of actuator_lag, increasing"),
    (lambda: nuisances.lag(grid=np.empty(0)), "one or more finite values of actuator_lag"),
    (lambda: nuisances.lag(grid=np.array([0.1, np.nan])), "finite values of actuator_lag"),
    (lambda: nuisances.lag(tolerance=0.0), "positive tolerance of actuator_lag"),
    (lambda: sign_perturbed(ones(), EIV, level=0.975), "whole number"),
)  # fmt: skip
SEARCHES = calls("search", ConvergenceError,
    (lambda: fractional(TLS, model=NARROW), AT_END),
    (steps_that_never_end, "steps of order that end"),
)  # fmt: skip
ESTIMATES = calls("estimate", EstimationError,
    (lambda: identify(problem_of(3), M.regularised(BCLS)), SQUARE),
    (lambda: ev.diagnose(replace(identify(problem_of(14), GIV), problem=None)), UNDIAGNOSED),
    (lambda: of_arrays(M.liml(), **EXACT), "a response that is a combination of regressors"),
)  # fmt: skip
WORDS = calls("words and numbers", UsageError,
    (lambda: M.regularised(M.fuller(), towards=LS), SOLVED_BY),
    (lambda: M.regularised(M.regularised(GIV)), "solved by least squares"),
    (lambda: fractional(M.whitened_least_squares(), made=BARE), "a flight, whose runs have spectra"),
    (lambda: of_arrays(UNKNOWN()), "regression of signals"),
    (lambda: of_unknown_noise(UNKNOWN(orders=("height",))), "height"),
    (lambda: of_a_flight().interval("K"), r"Expected a parameter out of viscous_friction, .*; received 'K'"),
    (lambda: ev.diagnose(of_arrays(LS))["first_stag"], DIAGNOSTIC),
    (lambda: identify(RESAMPLED, "least_squares"), METHOD),
    (lambda: identify(RESAMPLED, M.least_squares), r"a method, such as .*; received <function"),
    (lambda: identify(np.zeros((10, 2)), LS), r"a problem: .*; received ndarray"),
    (lambda: bootstrap(RESAMPLED, LS, runs=1), "two runs"),
    (lambda: bootstrap(RESAMPLED, LS, block_length=0), "block length from 1"),
    (lambda: bootstrap(POOLED, LS), "bootstrap_flights"),
    (lambda: replicates().std_error("theta_9"), "quantity out of theta_1"),
    (lambda: replicates().interval("theta_1", 95.0), "between 0 and 1"),
    (lambda: drawn_again([0, 1], LS), "one by least_squares"),
    (lambda: drawn_again([0], M.reference_iv()), "two flights or more with usable runs; received 1"),
    (lambda: of_arrays(replace(EIV, solver=M.fuller().solver), instruments=PHI), FIRST_STEP),
    (lambda: M.fuller(-1.0), "strength between 0 and"),
    (lambda: recursion(LS, ()), "mean cross-products"),
    (lambda: recursion(M.reference_iv()), "forgotten row by row"),
    (lambda: stream.after(stream.record(50), memory=1.0), "memory of 10"),
    (lambda: ev.ChangeDetector(limit=0.5), "limit above the drift"),
    (lambda: ev.ChangeDetector(threshold=0.0), "above zero"),
    (lambda: moments_by("least_squares").merge(moments_by("generalized_iv")), MERGED),
    (lambda: of_moments("least_squares", "generalized_iv"), "cross moments"),
    (lambda: of_moments("generalized_iv", "least_squares"), "triangular moments"),
    (lambda: moments_by("generalized_iv", (1.0, 2.0)), "chunks of one record"),
    (lambda: identify(VERTICAL.regression(RECORD.signals), SPECTRAL), "without an intercept"),
    (lambda: identify(RECORD.rows(), SPECTRAL), "a record of one motion"),
    (lambda: identify(COLOURED, SPECTRAL), "white noise of input"),
    (lambda: region(LS), "a method with instruments; received least_squares"),
    (lambda: region(level=1.0), "between 0 and 1"),
    (lambda: region().interval("lag"), "out of viscous_friction, input_gain"),
    (lambda: ev.derived(DERIVED, endless), "finite within the interval; received"),
    (lambda: ev.ratio(DERIVED, "b", "a", 0.0), "level between 0 and 1"),
    (lambda: ev.ratio(DERIVED, "b", "a", 1.0), "level between 0 and 1"),
    (lambda: ev.ratio(DERIVED, "c", "a"), "a parameter out of a, b; received 'c'"),
    (lambda: DERIVED.ellipse("a", "a"), "two parameters; received 'a' twice"),
)  # fmt: skip


def of_table(content, tmp_path, channels=None):
    path = tmp_path / "record.parquet"
    path.write_bytes(content) if isinstance(content, bytes) else pl.DataFrame(content).write_parquet(path)
    list(ev.read_chunks(path, rate_hz=5.0, channels=channels))


TABLES = calls("table", None,
    (partial(of_table, b"not a table"), InputError, "Parquet"),
    (partial(of_table, {"velocity_z": ["up"]}), InputError, "whose columns are numbers"),
    (partial(of_table, {"velocity_z": [0.0]}, channels={"velocity_z": "speed"}), ChannelMapError,
        "Expected columns out of"),
)  # fmt: skip
test_refused = table(
    *(FEW_ROWS, INSTRUMENTS, NOISES, NUISANCES, SEARCHES, ESTIMATES, WORDS, TABLES),
    rows("not finite", NonFiniteError, not_finite, *(
        (name, made, value, f"Expected finite {name}; received 1 NaN or infinite")
        for value in (np.nan, np.inf, -np.inf)
        for name, made in (("response", Y), ("regressors", PHI), ("instruments", PSI))
    )),
    rows("as many rows as unknowns", TooFewSamplesError, as_many_rows_as_unknowns, *(
        (method, door, "more rows than the 2 unknowns.*received 2")
        for method in EVERY_METHOD
        for door in ("rows", "moments", "bootstrap")
    )),
    rows("collinear", CollinearError, collinear, (LS, INDEPENDENT), (TLS, INDEPENDENT)),
    rows("no output", CollinearError, fractional, (LS, (), dense.MODEL, FLAT, "is zero")),
    rows("noise of arrays", MissingNoiseError, undeclared, *((m, "covariance") for m in UNDECLARED)),
    rows("noise of signals", MissingNoiseError, of_signals, *((m, 0, OF_CHANNEL) for m in UNDECLARED)),
    rows("too noisy", CovarianceError, too_noisy, *((*x, LEFT) for x in TOO_NOISY)),
    rows("too noisy in chunks", CovarianceError, too_noisy_in_chunks, *((*x, EXCEED) for x in TOO_NOISY)),
    rows("level", UsageError, level_of_a_flight, *((level, LEVEL) for level in (0.0, 1.0, 95.0))),
)  # fmt: skip
