"""Lagged runs against what is written out: a rover in twenty lines, axes, candidates for a response."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from eivor.errors import InstrumentError, ShapeError, TooFewSamplesError
from eivor.models.lagged_runs import ACTUATOR_LAG, AxisColumns, LaggedRuns, nothing_moves
from eivor.models.regression import AxisRows, Parameter
from eivor.models.separable import Nuisance
from eivor.models.spectral import BinRows, SpectralRegression, SpectralRun
from eivor.signals.filters import first_order_lag

STEP_S = 0.02
AT = {"actuator_lag": 0.1}
LAG = Nuisance(ACTUATOR_LAG, np.geomspace(0.02, 0.5, 12))


@dataclass(frozen=True)
class Throttle:
    """The column of a rover's throttle behind its lag."""

    throttle: np.ndarray

    def __call__(self, nuisance_values):
        return first_order_lag(self.throttle, step_s=STEP_S, lag_s=nuisance_values["actuator_lag"])[:, None]


def columns(seed, *, candidates=1, instruments=4, **more):
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((600, 2 + candidates + instruments))
    return AxisColumns(
        STEP_S,
        more.pop("runs", (slice(0, 250), slice(300, 600))),
        values[:, :candidates],
        values[:, candidates : candidates + 1],
        Throttle(np.cumsum(values[:, -1]) * 0.1),
        values[:, candidates + 1 : -1],
        **more,
    )


PAIR = (Parameter("a"), Parameter("b"))


def test_rows_of_an_axis_are_cut_from_its_grid_and_lose_the_means_of_their_run():
    item = columns(1, candidates=2)
    for intercepts in (True, False):
        rows = LaggedRuns((item,), PAIR, (LAG,), intercepts).rows(AT)
        moved, start = item.moving(AT)[:, 0], 0
        for run in item.runs:
            here = slice(start, start + run.stop - run.start)
            start = here.stop
            parts = (
                (rows.response[here], item.responses[run, 0]),
                (rows.regressors[here, 0], item.fixed[run, 0]),
                (rows.regressors[here, 1], moved[run]),
                (rows.instruments[here, 2], item.instruments[run, 2]),
            )
            for entry, wanted in parts:
                mean = wanted.mean() if intercepts else 0.0
                np.testing.assert_allclose(entry, wanted - mean, atol=1e-13)
        assert start == rows.response.size


def test_instruments_of_an_axis_are_not_those_of_another():
    """Each axis has equations of its own; the parameters may be shared."""
    item, other = columns(1), columns(2, instruments=3, axis=4)
    problem = LaggedRuns((item, other), PAIR, (LAG,))
    assert problem.axes == (0, 4)
    alone = [LaggedRuns((each,), PAIR, (LAG,)) for each in (item, other)]
    for rows, parts in (
        (problem.rows(AT).instruments, [each.rows(AT).instruments for each in alone]),
        (problem.bins(AT).instruments, [each.bins(AT).instruments for each in alone]),
    ):
        first = parts[0].shape[0]
        np.testing.assert_allclose(rows[:first, :4], parts[0], rtol=1e-12)
        np.testing.assert_allclose(rows[first:, 4:], parts[1], rtol=1e-12)
        assert not rows[:first, 4:].any()
        assert not rows[first:, :4].any()
    layout = problem.bins(AT).layout
    np.testing.assert_array_equal(np.unique(layout.axis_of_row), [0, 4])
    assert layout.axis_of_row.shape == layout.flight_of_row.shape


def test_scores_of_one_time_are_added_over_the_axes():
    rng = np.random.default_rng(3)
    item, other = columns(1), columns(2, axis=1)
    late = columns(4, flight=1, axis=1, runs=(slice(10, 50),))
    rows = LaggedRuns((item, other, late), PAIR, (LAG,)).rows(AT)
    assert isinstance(rows.layout, AxisRows)
    test, e = rng.standard_normal((rows.response.size, 2)), rng.standard_normal(rows.response.size)
    scores = rows.layout.scores(test, e)
    assert scores.shape == (550 + 40, 2)
    np.testing.assert_allclose(
        scores[:550], test[:550] * e[:550, None] + test[550:1100] * e[550:1100, None], atol=1e-13
    )
    np.testing.assert_allclose(scores[550:], test[1100:] * e[1100:, None], atol=1e-13)


@pytest.mark.parametrize(
    ("which", "error", "said"),
    [
        ((columns(1, runs=()),), TooFewSamplesError, "at least one usable run"),
        ((columns(1), columns(2, instruments=3, flight=1)), InstrumentError, r"\[4, 3\] columns"),
        ((columns(1, candidates=3),), ShapeError, "one or two candidates.*received 3"),
    ],
)
def test_columns_that_make_no_problem_are_refused(which, error, said):
    with pytest.raises(error, match=said):
        LaggedRuns(which, PAIR, (LAG,))


def test_every_parameter_has_a_column():
    problem = LaggedRuns((columns(1),), (*PAIR, Parameter("c")), (LAG,))
    with pytest.raises(
        ShapeError, match="a fixed or moving column for each of 3 parameters; received 1 and 1"
    ):
        problem.rows(AT)


@pytest.mark.parametrize(("seconds", "degree"), [(14.9, 0), (15.0, 1), (40.0, 1)])
def test_long_runs_lose_a_line_in_time_and_short_ones_a_constant(seconds, degree):
    """Thrust of one command falls during a flight, for any weights and in rows of either kind."""
    count, rng = round(seconds / 0.05), np.random.default_rng(3)
    counted = rng.random(count) < 0.9
    time = np.arange(count) * 0.05
    moved = rng.standard_normal((count, 2))
    drifting = moved + np.column_stack([3.0 - 0.2 * time, 1e3 + time])
    for valid in (None, counted):
        run = SpectralRun(0, count, 0.05, (0.04, 5.0), counted=valid)
        left = run.spectrum(drifting) - run.spectrum(moved)
        assert (np.abs(left).max() < 1e-9) == bool(degree)
        here = AxisColumns(0.05, (slice(0, count),), drifting[:, :1], moved[:, :1], nothing_moves(count),
                           drifting[:, 1:], valid=valid)  # fmt: skip
        still = replace(here, responses=moved[:, :1], instruments=moved[:, 1:])
        rows, flat = (LaggedRuns((item,), PAIR[:1], ()).rows({}) for item in (here, still))
        assert np.allclose(rows.response, flat.response, atol=1e-9) == bool(degree)
        assert np.allclose(rows.instruments, flat.instruments, atol=1e-9) == bool(degree)


def test_band_without_a_bin_is_empty():
    run = SpectralRun(0, 20, 0.01, (0.04, 5.0))
    assert run.count == 0
    assert run.spectrum(np.random.default_rng(0).standard_normal((20, 2))).shape == (0, 2)


def test_whitening_divides_every_column_and_blends_the_responses():
    run = SpectralRun(0, 400, 0.01, (0.04, 5.0))
    rng = np.random.default_rng(2)
    parts = rng.standard_normal((run.count, 4)) + 1j * rng.standard_normal((run.count, 4))
    layout = BinRows((run,))
    bins = SpectralRegression(
        parts[:, :2], parts[:, 2:], parts[:, :0], (Parameter("a"), Parameter("b")), layout
    )
    blend, power = rng.uniform(0.0, 1.0, run.count), rng.uniform(0.5, 2.0, run.count)
    theta = np.array([0.7, -0.3])
    rows = bins.whitened(blend, power, np.empty((2 * run.count, 0)))
    item, other = bins.residuals(theta).T
    wanted = ((1.0 - blend) * item + blend * other) / np.sqrt(power)
    np.testing.assert_allclose(
        rows.response - rows.regressors @ theta, np.concatenate([wanted.real, wanted.imag]), atol=1e-12
    )
