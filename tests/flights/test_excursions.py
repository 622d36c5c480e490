"""Short excursions beyond a limit do not end a run, and what is measured during them counts for nothing."""

from __future__ import annotations

import numpy as np
import pytest
from flight_logs import GAIN, STEP_S, changed, flown, prepare_vertical

from eivor.flights.options import FlightOptions
from eivor.motions.identify import identify_flight
from eivor.signals.filters import fast_length
from eivor.signals.recording import Recording

LEVEL, TILTED = 1.0, 0.8


def tilting(log: Recording, *excursions: tuple[float, float]) -> Recording:
    """The log with a tilt beyond the limit between some times [s]."""
    time = log.channels["cos_tilt"].time_s
    cosine = np.full(time.size, LEVEL)
    for start, end in excursions:
        cosine[(time >= start - STEP_S / 2) & (time < end - STEP_S / 2)] = TILTED
    return changed(log, cos_tilt=cosine)


@pytest.fixture(scope="module")
def log() -> Recording:
    return flown(seconds=20.0, seed=3)[0]


def test_short_excursions_are_left_out_of_a_run_and_long_ones_end_it(log):
    flight = prepare_vertical(
        tilting(log, (0.0, 0.5), (4.0, 4.6), (6.0, 7.0), (11.0, 12.1), (13.5, 14.0)), FlightOptions()
    )
    time = flight.grid.time_s
    spans = [(time[run.start], time[run.stop - 1] + STEP_S) for run in flight.runs]
    # 790 samples are 784 and a few, which are left out for the sake of transforms
    end = 12.1 + fast_length(790) * STEP_S
    np.testing.assert_allclose(spans, [(0.5, 11.0), (12.1, end)], atol=1e-9)
    assert flight.used_s == pytest.approx(10.5 - 1.6 + end - 12.1 - 0.5)
    assert not flight.used[flight.signals.channel("cos_tilt") < 0.9].any()


def test_runs_of_a_second_serve_and_those_mostly_beyond_the_limit_do_not(log):
    separated = [(1.3 + 2.5 * i, 2.5 + 2.5 * i) for i in range(8)]
    assert len(prepare_vertical(tilting(log, *separated), FlightOptions()).runs) == 8
    shaken = [(0.4 * i, 0.4 * i + 0.25) for i in range(50)]
    assert prepare_vertical(tilting(log, *shaken), FlightOptions()).runs == ()
    short = [(1.3 + 2.5 * i, 3.4 + 2.5 * i) for i in range(8)]  # a run of 1.3 s, the others too short
    assert prepare_vertical(tilting(log, *short), FlightOptions()).runs == ()


@pytest.mark.thorough
@pytest.mark.parametrize("method", ["reference_iv", pytest.param("extended_iv", marks=pytest.mark.thorough)])
@pytest.mark.usefixtures("coarse_search")
def test_what_is_measured_beyond_a_limit_counts_for_nothing(log, method):
    tilted = tilting(log, (4.0, 4.6), (9.0, 9.8))
    force = tilted.channel("specific_force_z").values.copy()
    spoilt = changed(tilted, specific_force_z=np.where(tilted.channel("cos_tilt").values < 0.9, 1e3, force))
    options = FlightOptions(method=method)
    was, flight = identify_flight(tilted, options), identify_flight(spoilt, options)
    for name, quantity in was.quantities.items():
        assert flight.quantities[name].value == pytest.approx(quantity.value, rel=1e-9)
        assert flight.quantities[name].interval == pytest.approx(quantity.interval, rel=1e-9)


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_a_flight_that_tilts_now_and_then_tells_what_it_tells_level(log):
    # the tilt is made up: the cosine of those samples is wrong, and would be seen in the gain
    excursions = [(1.0 + i, 1.2 + i) for i in range(18)]
    quantity = identify_flight(tilting(log, *excursions)).quantities["input_gain"]
    assert abs(quantity.value - GAIN) < 3.0 * quantity.std_error
    assert quantity.half_width < 0.1 * GAIN


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_pictures_and_predictions_leave_them_out(log):
    from eivor.report.flight import flight_runs

    result = identify_flight(tilting(log, (4.0, 4.6), (9.0, 9.8)))
    assert result.fit is not None
    trace = result.motion.traces(result.fit.problem, result.fit.estimate)[0]
    (run,) = flight_runs(result)
    assert run.time_s.size == trace.measured.size == 2000 - 140
    passed = run.spectral.band_passed(trace.measured[:, None])
    assert passed.shape == (2000 - 140, 1)
    predicted = result.motion.predictions(
        result.fit.problem, dict(result.fit.estimate.best.nuisances) | result.parameters
    )
    assert {item.measured.size for item in predicted} == {2000 - 140}
