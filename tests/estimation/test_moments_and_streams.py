"""Moments of any split equal those of the whole, whatever a record is cut into and wherever it is read."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import eivor as ev
from eivor.errors import ChannelMapError, EstimationError, InputError, TooFewSamplesError, UsageError
from eivor.estimation.moments import CrossMoments, TriangularMoments
from eivor.lab.scenario_files import shipped_scenario
from eivor.linalg import AugmentedLeastSquares

MOTION = ev.VerticalMotion(intercept=True)
COUNT, ORDER = 600, 7


def record(seed=0, count=COUNT, *, masked=False):
    """A record whose input has fractional noise, which remembers where its record began."""
    rng = np.random.default_rng(seed)
    channels = {name: rng.standard_normal(count).cumsum() for name in ("velocity_z", "input")}
    channels["specific_force_z"] = (
        0.5 * channels["input"] - 0.3 * channels["velocity_z"] + 9.8 + 0.1 * rng.standard_normal(count)
    )
    valid = None
    if masked:
        valid = np.ones(count, dtype=bool)
        valid[100:117] = valid[300] = False
    noise = {
        "input": ev.FractionalNoise(std=0.2, order=-0.4),
        "velocity_z": ev.WhiteNoise(std=0.1),
        "specific_force_z": ev.WhiteNoise(std=0.1),
    }
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
        parts = [moments.root.T @ moments.root / moments.count, moments.noise]
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
    signals = record(masked=masked)
    whole = ev.moments([signals], model=MOTION, method=method, instruments=instruments)
    split = ev.moments(chunks_of(signals, cuts), model=MOTION, method=method, instruments=instruments)
    assert split.moments.rows == whole.moments.rows
    for a, b in zip(normalised(split.moments), normalised(whole.moments), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12 * np.abs(b).max())
    fits = [ev.identify(moments, method) for moments in (whole, split)]
    batch = ev.identify(MOTION.regression(signals, instruments), method)
    for parameter, value in batch.parameters.items():
        for fit in fits:
            assert fit.parameters[parameter] == pytest.approx(value, rel=1e-12 * max(batch.condition, 10.0))


@pytest.mark.parametrize("name", METHODS)
def test_merge_is_associative_and_weighted_by_rows(name):
    method, instruments = METHODS[name]
    a, b, c = (
        ev.moments([record(seed, count)], model=MOTION, method=method, instruments=instruments)
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
    fit = ev.identify(ev.moments([record()], model=MOTION, method=method, instruments=instruments), method)
    assert set(fit.to_frame().columns) == {"parameter", "value", "unit"}
    assert "from moments" in fit.summary()
    with pytest.raises(EstimationError, match="rows available"):
        fit.interval("viscous_friction")
    with pytest.raises(EstimationError, match="rows available"):
        _ = fit.residuals


def test_moments_of_another_kind_are_refused():
    least_squares, giv = METHODS["least_squares"], METHODS["generalized_iv"]
    made = [ev.moments([record()], model=MOTION, method=m, instruments=z) for m, z in (least_squares, giv)]
    with pytest.raises(UsageError, match="Merge moments that one method made"):
        made[0].merge(made[1])
    with pytest.raises(UsageError, match="cross moments"):
        ev.identify(made[0], giv[0])
    with pytest.raises(UsageError, match="triangular moments"):
        ev.identify(made[1], least_squares[0])


def test_chunks_of_different_records_are_refused():
    method, instruments = METHODS["generalized_iv"]
    first = record()
    other = ev.Signals(2.0 * first.rate_hz, first.channels, noise=first.noise)
    with pytest.raises(UsageError, match="chunks of one record"):
        ev.moments([first, other], model=MOTION, method=method, instruments=instruments)
    with pytest.raises(TooFewSamplesError, match="largest lag"):
        ev.moments([], model=MOTION, method=method, instruments=instruments)


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
class TestParquet:
    @pytest.fixture
    def table(self, tmp_path):
        polars = pytest.importorskip("polars")
        signals = record()
        path = tmp_path / "record.parquet"
        time = np.arange(COUNT) / 5.0
        polars.DataFrame({"time": time, **signals.channels}).write_parquet(path, row_group_size=64)
        return path, signals

    def test_a_table_read_in_chunks_equals_the_whole(self, table):
        path, signals = table
        method, instruments = METHODS["generalized_iv"]
        chunks = ev.read_chunks(path, rate_hz=5.0, noise=signals.noise, rows=97)
        streamed = ev.identify(
            ev.moments(chunks, model=MOTION, method=method, instruments=instruments), method
        )
        batch = ev.identify(MOTION.regression(signals, instruments), method)
        for name, value in batch.parameters.items():
            assert streamed.parameters[name] == pytest.approx(value, rel=1e-10)

    def test_channels_by_other_names(self, table):
        path, _ = table
        (chunk,) = ev.read_chunks(path, rate_hz=5.0, channels={"velocity_z": "input"})
        assert set(chunk.channels) == {"velocity_z"}

    def test_a_column_that_is_not_there(self, table):
        path, _ = table
        with pytest.raises(ChannelMapError, match="Expected columns out of"):
            list(ev.read_chunks(path, rate_hz=5.0, channels={"velocity_z": "speed"}))

    def test_not_a_table(self, tmp_path):
        path = tmp_path / "no.parquet"
        path.write_bytes(b"not a table")
        with pytest.raises(InputError, match="Parquet"):
            list(ev.read_chunks(path, rate_hz=5.0))

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

    def test_a_column_of_words_is_told(self, tmp_path):
        polars = pytest.importorskip("polars")
        path = tmp_path / "words.parquet"
        polars.DataFrame({"velocity_z": ["up", "down"]}).write_parquet(path)
        with pytest.raises(InputError, match="whose columns are numbers"):
            next(ev.read_chunks(path, rate_hz=5.0))


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.parametrize("weighting", [ev.methods.Unweighted(), ev.methods.TwoStage()])
def test_the_moments_of_chunks_are_solved_once(weighting, monkeypatch):
    sizes, solve = [], AugmentedLeastSquares.solve

    def counted(self, system):
        sizes.append(system.matrix.shape)
        return solve(self, system)

    monkeypatch.setattr(AugmentedLeastSquares, "solve", counted)
    method, signals = ev.methods.generalized_iv(weighting), record()
    fit = ev.identify_chunks(
        lambda: chunks_of(signals, [200, 400]),
        model=MOTION,
        method=method,
        instruments=ev.lags("input", 0, ORDER),
    )
    assert sizes == [(ORDER + 2, 3)]
    whole = ev.identify(MOTION.regression(signals, ev.lags("input", 0, ORDER)), method)
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


def in_units(signals, of_input, of_motion):
    units = {"input": of_input, "velocity_z": of_motion, "acceleration_z": of_motion}
    return replace(
        signals,
        channels={name: units[name] * signals.channels[name] for name in units},
        noise={name: replace(item, std=units[name] * item.std) for name, item in signals.noise.items()},
    )


def told(signals, method, of_input=1.0, of_motion=1.0):
    """K, K_u and the ends of their intervals, in units of the signals that are given."""
    scaled = in_units(signals, of_input, of_motion)
    scaled = replace(scaled, noise={}) if method in SOUGHT else scaled
    estimate = ev.identify(MODEL.regression(scaled, ev.lags("input", 0, 10)), method)
    gain = of_motion / of_input
    names = (("viscous_friction", 1.0), ("input_gain", gain))
    return np.array(
        [
            [estimate.parameters[name] / unit, *np.divide(estimate.interval(name), unit)]
            for name, unit in names
        ]
    )


@pytest.mark.parametrize("method", [*DECLARED, *SOUGHT], ids=lambda method: method.name)
@pytest.mark.parametrize(("of_input", "of_motion"), [(1e-9, 1e9), (1e9, 1e-9)])
def test_units_change_nothing(signals, method, of_input, of_motion):
    in_others = told(signals, method, of_input, of_motion)
    np.testing.assert_allclose(in_others, told(signals, method), rtol=1e-6 if method in SOUGHT else 1e-8)
