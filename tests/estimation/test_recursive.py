"""Recursive identification equals the exponentially weighted batch, however its record is cut."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import eivor as ev
from eivor.errors import EstimationError, InputError
from eivor.estimation.moments import CrossMoments, TriangularMoments
from eivor.estimation.recursive import newest_reference
from eivor.lab.scenario_files import shipped_scenario
from eivor.linalg.total_least_squares import AugmentedLeastSquares
from eivor.models.signal_regression import shared_noise_of_rows

MOTION = ev.VerticalMotion(intercept=False)
INSTRUMENTS = ev.lags("input", 0, 10)
FACTOR = 0.995


def record(count, *, seed=0, masked=False, fractional=False):
    rng = np.random.default_rng(seed)
    u = np.convolve(rng.standard_normal(count + 2), [0.7, 0.49], "valid")[:count]
    v = np.zeros(count)
    steps = 0.02 * u
    for k in range(1, count):
        v[k] = 0.94 * v[k - 1] + steps[k - 1]
    noise = {"input": ev.FractionalNoise(0.1, -0.3) if fractional else ev.WhiteNoise(0.1)}
    channels = {
        "velocity_z": v + 0.01 * rng.standard_normal(count),
        "acceleration_z": 0.1 * u - 0.3 * v + 0.01 * rng.standard_normal(count),
        "input": u + noise["input"].sample(count, rng),
    }
    valid = None
    if masked:
        valid = rng.random(count) > 0.01
        channels["velocity_z"] = np.where(valid, channels["velocity_z"], np.nan)
    return ev.Signals(5.0, channels, noise=noise, valid=valid)


def part(signals, first, last):
    return replace(
        signals,
        channels={name: values[first:last] for name, values in signals.channels.items()},
        valid=None if signals.valid is None else signals.valid[first:last],
        offset=first,
    )


def after(signals, cuts=(), **options):
    recursion = ev.RecursiveIdentification(MOTION, ev.methods.generalized_iv(), INSTRUMENTS, **options)
    for first, last in pairwise([0, *map(int, cuts), signals.sample_count]):
        recursion = recursion.update(part(signals, first, last))
    return recursion


def batch(signals):
    """Dense generalized IV of weighted rows, its compensation averaged with the same weights."""
    problem = MOTION.regression(signals, INSTRUMENTS)
    rows = problem.rows()
    used = np.ones(signals.sample_count - problem.first, bool) if problem.used is None else problem.used
    w = (FACTOR ** np.arange(used.size - 1, -1, -1.0))[used]
    table = (rows.instruments * w[:, None]).T @ np.column_stack([rows.regressors, rows.response])
    columns = (*problem.regressor_columns, problem.equation.response)
    noise = shared_noise_of_rows(INSTRUMENTS, columns, signals, problem.first)
    for name, series in noise.items():
        table[name] -= w @ series[used]
    return np.linalg.lstsq(table[:, :2] / w.sum(), table[:, 2] / w.sum(), rcond=None)[0]


def values(estimate):
    return np.array(list(estimate.parameters.values()))


def test_equals_the_weighted_batch_over_two_hundred_thousand_samples():
    signals = record(200_010)
    cuts = np.unique(np.random.default_rng(1).integers(1, signals.sample_count, 60))
    recursion = after(signals, cuts)
    assert recursion.samples == 200_000
    np.testing.assert_allclose(values(recursion.estimate()), batch(signals), rtol=1e-12)


@pytest.mark.parametrize("fractional", [False, True])
def test_equals_the_weighted_batch_where_samples_are_missing(fractional):
    signals = record(900, masked=True, fractional=fractional)
    np.testing.assert_allclose(values(after(signals).estimate()), batch(signals), rtol=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "cuts", [range(1, 420), (5, 9, 11, 400), np.arange(7, 420, 7)], ids=["single samples", "few", "sevens"]
)
def test_chunks_of_any_size_give_the_same_estimate_and_intervals(cuts):
    signals = record(420, masked=True, fractional=True)
    whole, cut = after(signals).estimate(), after(signals, cuts).estimate()
    ends = [[each.parameters[name], *each.interval(name)] for each in (cut, whole) for name in whole.names]
    np.testing.assert_allclose(ends[:2], ends[2:], rtol=1e-10)


@pytest.mark.parametrize("memory", [200.0, 10.0])
def test_changes_do_not_depend_on_chunks(memory):
    signals = dropped(record(1500), 900)
    given = {"detector": ev.ChangeDetector(), "memory": memory}
    selected, recursion = [], after(part(signals, 0, 1), **given)
    for first, last in pairwise(range(1, 1501, 13)):
        recursion = recursion.update(part(signals, first, last))
        selected += recursion.changes
    assert tuple(selected) == after(part(signals, 0, last), **given).changes
    assert selected


def dropped(signals, sample):
    """The same where the input does 30 % less from a sample on."""
    channels = dict(signals.channels)
    late = np.arange(signals.sample_count) >= sample
    channels["acceleration_z"] = channels["acceleration_z"] - late * 0.03 * signals.channels["input"]
    return replace(signals, channels=channels)


def test_a_drop_is_told_and_what_lay_before_it_forgotten():
    signals = dropped(record(1400), 1000)
    recursion = after(part(signals, 0, 1000), detector=ev.ChangeDetector())
    assert recursion.changes == ()
    recursion = recursion.update(part(signals, 1000, 1150))
    (change,) = recursion.changes
    assert (change.parameter, change.upwards) == ("input_gain", False)
    assert 1000 < change.sample + 10 <= 1150
    without = after(part(signals, 0, 1150)).estimate().parameters["input_gain"]
    assert abs(recursion.estimate().parameters["input_gain"] - 0.07) < 0.5 * abs(without - 0.07)


def test_a_reference_solves_the_equations_of_all_full_blocks():
    weighted = after(record(700, masked=True))._products
    equations, reference = weighted.compensated(weighted.full)[0], newest_reference(weighted)
    solution = np.linalg.lstsq(equations[:, :-1], equations[:, -1], rcond=None)[0]
    np.testing.assert_allclose(reference.theta[0], solution, rtol=1e-9)
    means = equations / weighted.full.products.count
    np.testing.assert_allclose(reference.mapped[0] @ means[:, :-1], np.eye(2), atol=1e-9)


@pytest.mark.thorough
def test_memory_does_not_grow_with_the_stream():
    signals = record(9000)

    def held(recursion):
        weighted, tail = recursion._products, recursion._tail
        sums = (part.products.sums.nbytes for part in (weighted.closed, weighted.full))
        return *sums, weighted.waiting.columns.shape[1], tail.sample_count

    early = after(part(signals, 0, 3000), (1000, 2000), detector=ev.ChangeDetector())
    late = after(signals, range(1000, 9000, 1000), detector=ev.ChangeDetector())
    assert held(early) == held(late)
    assert late._products.waiting.count < 10
    assert late._watch.history.shape[0] <= 80
    assert late._watch.references.theta.shape[0] <= 16


def test_effective_rows_are_twice_the_memory():
    assert after(record(4000)).effective_rows == pytest.approx((1 + FACTOR) / (1 - FACTOR), rel=1e-6)


def test_both_covariances_are_alike_for_white_errors_and_know_their_degrees():
    parts = [after(record(6000, seed=seed)).estimate().joint_covariance.parts for seed in range(30)]
    variances = np.array([[np.diag(part.matrix) for part in each] for each in parts])
    cosines, blocks = variances.mean(axis=0)
    np.testing.assert_allclose(cosines / blocks, 1.0, atol=0.35)
    # squares of weights that fall by a factor: (1 + q) / (1 - q) blocks count, less one for each parameter
    forgetting = after(record(400))._products.forgetting
    q = FACTOR ** (2 * forgetting.block)
    assert parts[0][1].degrees == pytest.approx((1.0 + q) / (1.0 - q) - 2.0, rel=0.05)


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
def test_estimates_follow_the_stream():
    signals = record(600)
    chunks = [part(signals, k, k + 50) for k in range(0, 600, 50)]
    begun = ev.RecursiveIdentification(MOTION, ev.methods.generalized_iv(), INSTRUMENTS)
    results = list(ev.identify_recursively(chunks, begun))
    assert [recursion.samples for recursion, _ in results] == [*range(40, 600, 50)]
    low, high = results[-1][1].interval("input_gain")
    assert low < 0.1 < high


def test_bias_compensated_least_squares_needs_no_instruments():
    signals, others = record(2000), ("velocity_z", "acceleration_z")
    signals = replace(signals, noise=signals.noise | dict.fromkeys(others, ev.WhiteNoise(0.01)))
    recursion = ev.RecursiveIdentification(MOTION, ev.methods.bias_compensated_least_squares())
    assert recursion.update(signals).estimate().parameters["input_gain"] == pytest.approx(0.1, rel=0.05)


# Moments of any split equal those of the whole, whatever a record is cut into and wherever it is read.

STREAM_MOTION = ev.VerticalMotion(intercept=True)
COUNT, ORDER = 600, 7


def flight_record(seed=0, count=COUNT, *, masked=False):
    """A record whose input has fractional noise, which remembers where its record began."""
    rng = np.random.default_rng(seed)
    channels = {name: rng.standard_normal(count).cumsum() for name in ("velocity_z", "input")}
    force = 0.5 * channels["input"] - 0.3 * channels["velocity_z"] + 9.8
    channels["specific_force_z"] = force + 0.1 * rng.standard_normal(count)
    valid = None
    if masked:
        valid = np.ones(count, dtype=bool)
        valid[100:117] = valid[300] = False
    noise = dict.fromkeys(("velocity_z", "specific_force_z"), ev.WhiteNoise(std=0.1))
    noise |= {"input": ev.FractionalNoise(std=0.2, order=-0.4)}
    return ev.Signals(rate_hz=5.0, channels=channels, noise=noise, valid=valid)


def chunks_of(signals, cuts):
    edges = [0, *sorted(cuts), signals.sample_count]
    for first, last in pairwise(edges):
        if last > first:
            yield ev.Signals(
                signals.rate_hz,
                {name: values[first:last] for name, values in signals.channels.items()},
                noise=signals.noise,
                valid=None if signals.valid is None else signals.valid[first:last],
            )


def normalised(moments):
    """Moments that can be compared: R'R / rows for a root, whose signs are free."""
    if isinstance(moments, TriangularMoments):
        parts = [moments.root.T @ moments.root / moments.rows, moments.noise]
    else:
        assert isinstance(moments, CrossMoments)
        parts = [moments.equations, moments.noise, moments.instruments, moments.columns]
    return [part for part in parts if part is not None]


METHODS = {
    "least_squares": (ev.methods.least_squares(), ()),
    "total_least_squares": (ev.methods.total_least_squares(), ()),
    "bias_compensated_least_squares": (ev.methods.bias_compensated_least_squares(), ()),
    "generalized_iv": (ev.methods.generalized_iv(), ev.lags("input", 0, ORDER)),
    "generalized_iv, two-stage": (
        ev.methods.generalized_iv(ev.methods.TwoStage()),
        ev.lags("input", 0, ORDER),
    ),
}


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("name", METHODS)
@settings(max_examples=15)
@given(cuts=st.lists(st.integers(1, COUNT - 1), max_size=6))
def test_any_split_equals_the_whole(name, masked, cuts):
    method, instruments = METHODS[name]
    signals = flight_record(masked=masked)
    whole = ev.moments([signals], model=STREAM_MOTION, method=method, instruments=instruments)
    split = ev.moments(chunks_of(signals, cuts), model=STREAM_MOTION, method=method, instruments=instruments)
    assert split.moments.rows == whole.moments.rows
    for a, b in zip(normalised(split.moments), normalised(whole.moments), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12 * np.abs(b).max())
    fits = [ev.identify(moments, method) for moments in (whole, split)]
    batch = ev.identify(STREAM_MOTION.regression(signals, instruments), method)
    for parameter, value in batch.parameters.items():
        for fit in fits:
            assert fit.parameters[parameter] == pytest.approx(value, rel=1e-12 * max(batch.condition, 10.0))


@pytest.mark.parametrize("name", METHODS)
def test_merge_is_associative_and_weighted_by_rows(name):
    method, instruments = METHODS[name]
    a, b, c = (
        ev.moments([flight_record(seed, count)], model=STREAM_MOTION, method=method, instruments=instruments)
        for seed, count in ((1, 100), (2, 250), (3, 470))
    )
    for item, other in zip(
        normalised(a.merge(b).merge(c).moments), normalised(a.merge(b.merge(c)).moments), strict=True
    ):
        np.testing.assert_allclose(item, other, rtol=1e-12, atol=1e-12 * np.abs(other).max())
    assert a.merge(b).moments.rows == a.moments.rows + b.moments.rows


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")  # weak they are
def test_an_estimate_from_moments_says_that_its_rows_are_gone():
    method, instruments = METHODS["generalized_iv"]
    fit = ev.identify(
        ev.moments([flight_record()], model=STREAM_MOTION, method=method, instruments=instruments), method
    )
    assert set(fit.to_frame().columns) == {"parameter", "value", "unit"}
    assert "from moments" in fit.summary()
    with pytest.raises(EstimationError, match="rows available"):
        fit.interval("viscous_friction")
    with pytest.raises(EstimationError, match="rows available"):
        _ = fit.residuals


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
class TestParquet:
    @pytest.fixture
    def table(self, tmp_path):
        polars = pytest.importorskip("polars")
        signals = flight_record()
        path = tmp_path / "record.parquet"
        time = np.arange(COUNT) / 5.0
        polars.DataFrame({"time": time, **signals.channels}).write_parquet(path, row_group_size=64)
        return path, signals

    def test_a_table_read_in_chunks_equals_the_whole(self, table):
        path, signals = table
        method, instruments = METHODS["generalized_iv"]
        chunks = ev.read_chunks(path, rate_hz=5.0, noise=signals.noise, rows=97)
        streamed = ev.identify(
            ev.moments(chunks, model=STREAM_MOTION, method=method, instruments=instruments), method
        )
        batch = ev.identify(STREAM_MOTION.regression(signals, instruments), method)
        for name, value in batch.parameters.items():
            assert streamed.parameters[name] == pytest.approx(value, rel=1e-10)

    def test_channels_by_other_names(self, table):
        path, _ = table
        (chunk,) = ev.read_chunks(path, rate_hz=5.0, channels={"velocity_z": "input"})
        assert set(chunk.channels) == {"velocity_z"}

    @pytest.mark.parametrize("stage", ["collect_schema", "collect"])
    def test_a_decoders_panic_is_told(self, table, monkeypatch, stage):
        """It is no Exception, and would end the program with a traceback, after some chunks too."""
        polars = pytest.importorskip("polars")

        def panic(*_parts: object, **_options: object) -> None:
            raise polars.exceptions.PanicException("index out of bounds")

        path, _ = table
        chunks = ev.read_chunks(path, rate_hz=5.0, rows=97)
        if stage == "collect":
            next(chunks)
        monkeypatch.setattr(polars.LazyFrame, stage, panic)
        with pytest.raises(InputError, match=r"record\.parquet: index out of bounds"):
            next(chunks)


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.parametrize("weighting", [ev.methods.Unweighted(), ev.methods.TwoStage()])
def test_the_moments_of_chunks_are_solved_once(weighting, monkeypatch):
    sizes, solve = [], AugmentedLeastSquares.solve

    def counted(self, system):
        sizes.append(system.matrix.shape)
        return solve(self, system)

    monkeypatch.setattr(AugmentedLeastSquares, "solve", counted)
    method, signals = ev.methods.generalized_iv(weighting), flight_record()
    given = {"model": STREAM_MOTION, "method": method, "instruments": ev.lags("input", 0, ORDER)}
    fit = ev.identify_chunks(lambda: chunks_of(signals, [200, 400]), **given)
    assert sizes == [(ORDER + 2, 3)]
    whole = ev.identify(STREAM_MOTION.regression(signals, given["instruments"]), method)
    assert fit.parameters == pytest.approx(whole.parameters, rel=1e-9)


MODEL = ev.VerticalMotion(intercept=False)
m = ev.methods
DECLARED = (m.bias_compensated_least_squares(), m.spectral_giv(), m.whittle_ml())
SOUGHT = (
    m.generalized_iv_unknown_noise(),
    m.generalized_iv_unknown_noise(orders=("velocity_z",)),
    m.bias_eliminating_least_squares(),
    m.frisch_scheme(),
)


@pytest.fixture(scope="module")
def signals():
    scenario = replace(shipped_scenario("rich"), samples=400)
    return ev.simulate(scenario, np.random.default_rng(5)).signals


def told(signals, method, of_input=1.0, of_motion=1.0):
    """K, K_u and the ends of their intervals, in units of the signals that are given."""
    units = {"input": of_input, "velocity_z": of_motion, "acceleration_z": of_motion}
    channels = {name: unit * signals.channels[name] for name, unit in units.items()}
    noise = {name: replace(item, std=units[name] * item.std) for name, item in signals.noise.items()}
    scaled = replace(signals, channels=channels, noise={} if method in SOUGHT else noise)
    estimate = ev.identify(MODEL.regression(scaled, ev.lags("input", 0, 10)), method)
    names, units = ("viscous_friction", "input_gain"), np.array([[1.0], [of_motion / of_input]])
    return np.array([[estimate.parameters[name], *estimate.interval(name)] for name in names]) / units


@pytest.mark.parametrize("method", [*DECLARED, *SOUGHT], ids=lambda method: method.name)
@pytest.mark.parametrize(("of_input", "of_motion"), [(1e-9, 1e9), (1e9, 1e-9)])
def test_units_change_nothing(signals, method, of_input, of_motion):
    in_others = told(signals, method, of_input, of_motion)
    np.testing.assert_allclose(in_others, told(signals, method), rtol=1e-6 if method in SOUGHT else 1e-8)
