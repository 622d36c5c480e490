"""Pools: lag, delay and gain once for all flights, and a friction for each."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from flight_logs import FRICTION, GAIN, LAG_S, changed, flown, prepare_vertical
from scipy import stats

import eivor as ev
from eivor.errors import UsageError
from eivor.estimation.methods import identify, reference_iv
from eivor.estimation.profile_sets import ProfileSets
from eivor.estimation.recursive import Moment
from eivor.flights.estimate import with_systematic_uncertainties
from eivor.flights.motion import HorizonErrors, MultiStepPrediction, Starts, multi_step_predictions, starts_of
from eivor.flights.pooling import agreement, bootstrap_flights
from eivor.flights.prepare import prepare
from eivor.flights.quantity import (
    NAN,
    Counts,
    QuantityEstimate,
    QuantitySpec,
    QuantityTable,
    SystematicUncertainty,
    widened,
)
from eivor.flights.track import Track, track
from eivor.inference.diagnostics.excitation import Swing
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE, OverIdentification
from eivor.inference.verdict import Status, Verdict
from eivor.models.lagged_runs import lag_and_delay
from eivor.models.separable import NoInstruments
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.motion import Vertical
from eivor.report.flight import checks, result_card
from eivor.report.other_results import report_changes, track_document, track_figure, track_json, untold
from eivor.report.terminal import on_terminal
from eivor.signals.recording import Recording
from eivor.simulation.vertical import VerticalFlightSpec, simulate_vertical_flights
from flights.flight_logs import Noise, flights, problem
from motions.turning_logs import turned

K = "viscous_friction"


def named(logs):
    return [replace(log, name=f"flight {n}", sha256=f"flight {n}") for n, log in enumerate(logs)]


@pytest.fixture(scope="module")
def alike():
    """Two flights of one friction."""
    return ev.identify_flight(named(flown(2, seconds=15.0, seed=5)))


MORE = (-0.25, 0.1, 0.6)


@pytest.fixture(scope="module")
def one_sine():
    """Flights along one sine, in air that drags them differently."""
    how = {"seconds": 20.0, "hertz": (0.35,)}
    logs = [flown(1, seed=20 + n, friction=FRICTION + more, **how)[0] for n, more in enumerate(MORE)]
    return ev.identify_flight(named(logs))


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_flights_of_two_batteries_differ_in_the_gain_alone():
    first, second = named(flown(2, seconds=20.0, seed=9))
    commands = {k: c for k, c in second.channels.items() if k.startswith(("rotor_command", "input"))}
    weaker = changed(second, **{k: replace(c, values=1.06 * c.values) for k, c in commands.items()})
    single = ev.identify_flight(first)
    fit = ev.identify_flight([first, weaker])
    pool = fit.fit.pooled
    assert (pool.differing, pool.inflation) == (("input_gain",), 1.0)
    assert [item for item in fit.findings if item.name == "shared_differs"] == []
    (finding,) = [item for item in fit.findings if item.name == "flights_differ"]
    assert "input gain" in finding.message
    low, high = fit.quantities["input_gain"].interval
    assert low < GAIN / 1.06
    assert high > GAIN
    for name, value in {K: FRICTION, "effective_lag": LAG_S}.items():
        low, high = fit.quantities[name].interval
        assert low < value < high
        assert high - low < 1.2 * (single.quantities[name].interval[1] - single.quantities[name].interval[0])


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_flights_that_agree_have_one_friction_and_one_for_each(alike):
    assert [row.label for row in alike.by_flight] == ["flight 0", "flight 1"]
    truth = {K: FRICTION, "input_gain": GAIN, "effective_lag": LAG_S}
    for name, value in truth.items():
        low, high = alike.quantities[name].interval
        assert low < value < high
        for row in alike.by_flight:
            low, high = row.quantities[name].interval
            assert low < value < high
            assert row.quantities[name].verdict is Status.IDENTIFIED
    values = {row.quantities[K].value for row in alike.by_flight}
    assert len(values) == 2
    assert len({row.quantities["input_gain"].value for row in alike.by_flight}) == 1
    assert min(values) < alike.quantities[K].value < max(values)
    assert alike.diagnostics["pool_own_p_value"] > 0.05
    # flight by flight the pool tells the lag better than the flight does, and the friction no worse
    for row, flight in zip(alike.by_flight, alike.flights, strict=True):
        assert row.quantities["effective_lag"].half_width < flight.quantities["effective_lag"].half_width
        assert row.quantities[K].half_width < 1.1 * flight.quantities[K].half_width


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_common_and_separate_are_what_they_say(alike):
    logs = [flight.recording for flight in alike.prepared]
    common = ev.identify_flight(logs, pool_friction="common")
    assert common.by_flight == ()
    friction = common.quantities[K]
    assert friction.value == pytest.approx(alike.quantities[K].value, abs=0.5 * friction.std_error)
    separate = ev.identify_flight(logs, pool_friction="separate")
    assert separate.fit.estimate.joint_covariance.part("between_flights").degrees == 1.0
    assert [finding.name for finding in separate.findings].count("flights_differ") == 1


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_pool_without_a_solution_is_refused(alike, monkeypatch):
    """No common friction stands in: it would be identified, though flights may differ."""

    def fails(*_, **__):
        raise ev.errors.ConvergenceError("a search that settles", "one that still moves", "Log more.")

    monkeypatch.setattr("eivor.flights.pooling.pooled", fails)
    fit = ev.identify_flight([flight.recording for flight in alike.prepared])
    assert fit.verdict.status is ev.Status.REFUSED
    assert "no solution with viscous friction of each flight" in fit.verdict.sentences[0]
    assert "--pool-friction common" in fit.verdict.reasons[0].remedy


@pytest.mark.parametrize("options", [{}, {"pool_friction": "common"}])
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_flight_without_the_reference_of_the_others_is_left_out(options):
    moving, *others = named(flown(3, seconds=15.0, seed=5))
    held = {name: np.full(1500, 0.5) for name in ("reference_position_z", "reference_velocity_z")}
    resting, without = changed(others[0], **held), changed(others[1], *held)
    fit = ev.identify_flight([resting, moving, without], **options)
    alone = ev.identify_flight([moving])
    assert fit.quantities["input_gain"].value == pytest.approx(alone.quantities["input_gain"].value)
    assert [flight.recording.name for flight in fit.prepared] == [moving.name]
    omitted = [item.message.split(" is not")[0] for item in fit.findings if item.name == "left_out_of_pool"]
    assert omitted == [resting.name, without.name]
    assert len(fit.flights) == 3
    direct = ev.identify_flight([resting, moving], method="whitened_least_squares", **options)
    assert len(direct.prepared) == 2
    none = ev.identify_flight([resting, replace(resting, sha256="other")], **options)
    assert len(none.prepared) == 2
    assert "The reference never moved" in none.verdict.sentences[0]


class Laden(Vertical):
    """The same motion of a vehicle whose load is another one in each flight, in air that is not."""

    quantities = QuantityTable(
        {name: replace(spec, of_flight=name == "input_gain") for name, spec in Vertical.quantities.items()}
    )


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_motion_says_what_belongs_to_the_flight(alike):
    fit = ev.identify_flight([flight.recording for flight in alike.prepared], model=Laden())
    rows = [row.quantities for row in fit.by_flight]
    assert len({row["input_gain"].value for row in rows}) == 2
    assert len({row[K].value for row in rows}) == 1
    for name, value in {K: FRICTION, "input_gain": GAIN}.items():
        low, high = fit.quantities[name].interval
        assert low < value < high
    ends = fit.fit.sets[K].profile.hull
    assert ends[0] < fit.quantities[K].value < ends[1]


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_pool_is_told_and_read_back(one_sine, tmp_path):
    document = json.loads(one_sine.to_json())
    assert [row["log"] for row in document["by_flight"]] == [row.label for row in one_sine.by_flight]
    file = tmp_path / "fit.json"
    file.write_text(one_sine.to_json())
    read = ev.load_fit(file)
    for row in one_sine.by_flight:
        current = read.by_flight[row.label][K]
        assert (current.value, current.interval) == (row.quantities[K].value, row.quantities[K].interval)
    for level in (0.8, 0.95):
        assert read.interval(K, level) == pytest.approx(one_sine.interval(K, level))
    assert read.interval("actuator_lag") == one_sine.interval("actuator_lag")
    with pytest.raises(ev.errors.UsageError, match="a set for weak instruments or a pool"):
        read.interval("actuator_lag", 0.8)


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_instruments_of_a_pool_agree_when_those_of_half_its_flights_do(alike):
    def checks(p_value):
        return replace(alike.fit.checks, agreement=OverIdentification(9.0, 3, p_value))

    assert agreement([checks(p) for p in (1e-9, 0.4, 0.6, 0.8)]).p_value == pytest.approx(0.8)
    assert agreement([checks(p) for p in (1e-9, 1e-8, 0.6)]).p_value == pytest.approx(1.5e-8)
    assert agreement([checks(0.5)] * 3).J == 27.0
    assert agreement([]) is None


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_pool_has_the_verdict_of_its_own_quantities(alike, one_sine):
    """Each flight of `one_sine` has its friction identified, and their mean is not."""
    order = list(Status)
    for pool in (alike, one_sine):
        headline = [pool.quantities[name] for name in pool.motion.quantities.headline]
        assert pool.verdict.status is max((item.verdict for item in headline), key=order.index)
        assert bool(pool.verdict.reasons) == (pool.verdict.status is not Status.IDENTIFIED)
    assert {row.verdict for row in one_sine.by_flight} == {Status.IDENTIFIED}
    assert one_sine.quantities[K].verdict is not Status.IDENTIFIED
    assert "Viscous friction" in result_card((one_sine,)).groups[-1].lines[0].words


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_lag_that_is_given_counts_in_a_pool(alike):
    """Its interval was wider than what was given, and that of 7 ms for 70 went without a word."""
    logs = [flight.recording for flight in alike.prepared]
    pool = ev.identify_flight(logs, lag=ev.Prior(LAG_S, 0.0003))
    assert pool.by_flight
    lag, without = (item.quantities["effective_lag"] for item in (pool, alike))
    low, high = lag.interval
    assert lag.std_error < 0.9 * without.std_error
    assert high - low <= 2.0 * 1.96 * pool.fit.lag_prior.std * (1.0 + 1e-9)
    for row in pool.flights:
        assert pool.quantities["input_gain"].half_width < row.quantities["input_gain"].half_width
    wrong = ev.identify_flight(logs, lag=ev.Prior(3.0 * LAG_S, 0.005))
    assert wrong.quantities[K].verdict is not Status.IDENTIFIED
    assert any("contradicts the flight" in sentence for sentence in wrong.verdict.sentences)


def logs(pool, count, gusts=0.3):
    """Logs of simulated flights of one vehicle, each with a trajectory, wind and noise of its own."""
    specs = [VerticalFlightSpec(gust_rms=gusts, seed=1000 * pool + number) for number in range(count)]
    return named(flight.recording for flight in simulate_vertical_flights(specs))


@pytest.fixture(scope="module")
def pair():
    return identify_flight(logs(1, 2))


def pooled(pair, recordings):
    """Return what `identify_flight` makes of a pool, without each flight's own result."""
    prepared = tuple(prepare(log, pair.motion, pair.options) for log in recordings)
    problem = pair.fit.problem.of(prepared)
    estimate = identify(problem, reference_iv())
    quantities = {
        name: quantity.judged(Verdict(Status.IDENTIFIED), pair.motion.quantities[name])
        for name, quantity in pair.motion.derive(problem, estimate).items()
    }
    fit = replace(pair.fit, problem=problem, estimate=estimate)
    return replace(pair, prepared=prepared, fit=fit, quantities=quantities)


@pytest.fixture(scope="module")
def pool(pair):
    return pooled(pair, logs(1, 10))


@pytest.fixture(scope="module")
def found(pool):
    return bootstrap_flights(pool, runs=40, seed=4)


@pytest.mark.thorough
def test_the_seed_decides(pool, found):
    np.testing.assert_array_equal(bootstrap_flights(pool, runs=2, seed=4).replicates, found.replicates[:2])
    assert not np.array_equal(bootstrap_flights(pool, runs=2, seed=5).replicates, found.replicates[:2])


@pytest.mark.thorough
def test_replicates_are_what_the_recipe_makes_of_the_drawn_flights(pool):
    """The recipe renews its whitening in each replicate: a tenth of a standard error, no more."""
    alone = replace(pool.fit.problem, nuisances=lag_and_delay(delays_s=[0.0]))
    single = replace(pool, fit=replace(pool.fit, problem=alone, estimate=identify(alone, reference_iv())))
    random = np.random.default_rng(6)
    fast = bootstrap_flights(single, runs=4, seed=6)
    for replicate in fast.replicates:
        drawn = random.integers(0, 10, 10)
        flights = tuple(pool.fit.problem.flights[number] for number in drawn)
        full = identify(alone.of(flights), reference_iv())
        for name in ("viscous_friction", "input_gain", "actuator_lag"):
            away = replicate[fast.names.index(name)] - full.parameters[name]
            assert abs(away) < 0.25 * pool.quantities[name].std_error


@pytest.mark.thorough
def test_percentiles_of_few_flights_are_too_narrow_by_the_factor_that_is_told(found):
    column = found.replicates[:, found.names.index("viscous_friction")]
    narrow = np.quantile(column, [0.025, 0.975], method="weibull")
    wide = found.interval("viscous_friction")
    wanted = np.sqrt(10 / 9) * 2.26216 / 1.95996
    assert (wide[1] - wide[0]) / (narrow[1] - narrow[0]) == pytest.approx(wanted, rel=1e-4)


@pytest.mark.thorough
def test_what_cannot_be_resampled_is_refused(pool):
    item = replace(pool.fit.problem, columns=pool.fit.problem.columns[:1])
    alone = replace(pool, fit=replace(pool.fit, problem=item))
    with pytest.raises(UsageError, match="two flights or more"):
        bootstrap_flights(alone)
    by_another = replace(pool.fit.estimate, method="least_squares")
    direct = replace(pool, fit=replace(pool.fit, estimate=by_another))
    with pytest.raises(UsageError, match="one by least_squares"):
        bootstrap_flights(direct)
    with pytest.raises(UsageError, match="one without"):
        bootstrap_flights(replace(alone, fit=None))
    with pytest.raises(UsageError, match="two runs"):
        bootstrap_flights(pool, runs=1)


# Predictions of vertical motion: the truth predicts a noise-free flight, other numbers do not.

TRUTH = {"viscous_friction": FRICTION, "input_gain": GAIN, "actuator_lag": LAG_S, "delay": 0.0}


@pytest.fixture(scope="module")
def exact_problem():
    (log,) = flown(noise=0.0)
    return Vertical().problem((prepare_vertical(log, ev.FlightOptions()),), NoInstruments())


def left(problem, values):
    return [
        float(np.std(prediction.measured - prediction.predicted) / np.std(prediction.measured))
        for prediction in Vertical().abilities.prediction.another_flight(problem, values)
    ]


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.thorough
def test_the_truth_predicts(exact_problem):
    one_step, open_loop = Vertical().abilities.prediction.another_flight(exact_problem, TRUTH)
    assert (one_step.horizon.words, open_loop.horizon.words) == ("one step ahead", "in open loop")
    assert one_step.measured.shape == one_step.predicted.shape == open_loop.measured.shape
    # the rotors' state before the log is not known: they start at their first command
    one_step, open_loop = left(exact_problem, TRUTH)
    assert one_step < 0.02
    assert open_loop < 0.005


def error(model, quantity, size):
    return HorizonErrors(model, f"model {model}", quantity, "rad/s", np.full((4, 5), size), np.ones((4, 2)))


def test_states_are_carried_on_as_their_equation_says():
    samples = np.arange(0, 400, 40)
    starts = Starts(samples, (20, 40, 60), 0.005)
    time = 0.005 * np.arange(600)
    force, decay = np.sin(3.0 * time), 1.5

    def truth(at):
        return (decay * np.sin(3.0 * time[at]) - 3.0 * np.cos(3.0 * time[at])) / (decay**2 + 9.0)

    started = np.stack([truth(samples), truth(samples) + 1.0])
    driven = starts.over_step(force)
    carried = starts.propagate(started, lambda state, now: driven[now] - decay * state)
    assert np.allclose(carried[:, 0], truth(starts.ends), atol=2e-5)
    left = np.exp(-decay * 0.005 * np.array(starts.steps))[:, None]
    assert np.allclose(carried[:, 1], truth(starts.ends) + left, atol=3e-5)


@pytest.fixture(scope="module")
def broken():
    """A flight of 20 s with a gap of a second, and a hundredth of one that does not count."""
    log = turned(0, seconds=20.0)
    channels = {}
    for name, channel in log.channels.items():
        kept = (channel.time_s < 8.0) | (channel.time_s > 9.0)
        channels[name] = replace(channel, time_s=channel.time_s[kept], values=channel.values[kept])
    flight = prepare(replace(log, channels=channels), ev.motion_by_name("rates"), ev.FlightOptions())
    usable = flight.usable.copy()
    usable[600:602] = False
    return replace(flight, usable=usable)


def test_every_half_second_that_is_predicted_stands_on_data(broken):
    starts = starts_of(broken)
    assert starts.steps == (20, 40, 60, 80, 100)
    assert starts.samples.size > 200
    inside = [any(run.start <= sample < run.stop - 100 for run in broken.runs) for sample in starts.samples]
    assert all(inside)
    assert all(broken.usable[sample : sample + 101].all() for sample in starts.samples)


def test_errors_are_held_against_those_of_simpler_models():
    of_roll = error("fit", "roll rate", 1.0), error("other", "roll rate", 4.0)
    errors = (*of_roll, error("fit", "yaw rate", 1.0), error("other", "yaw rate", 0.5))
    prediction = MultiStepPrediction(errors, np.arange(4.0))
    assert prediction.ratios["model other"] == pytest.approx(np.sqrt(0.25 * 2.0))
    assert prediction.predicts
    assert "'model other' leaves less of yaw rate." in prediction.sentence
    assert "roll rate" not in prediction.sentence
    worse = replace(prediction, errors=(error("fit", "roll rate", 5.0), *errors[1:]))
    assert not worse.predicts
    alone = MultiStepPrediction(errors[:1], np.arange(4.0))
    assert "nothing to hold" in alone.sentence


def test_flights_follow_each_other_and_what_nobody_measured_is_left_out(broken):
    unmeasured = replace(error("fit", "position", 1.0), sizes=np.full((4, 5), np.nan))
    sizes = np.vstack([np.full((2, 5), 3.0), np.full((2, 5), np.nan)])
    half, whole = replace(error("fit", "roll rate", 3.0), sizes=sizes), error("fit", "roll rate", 1.0)
    flights = [(whole, unmeasured), (half, unmeasured), ()]
    result = multi_step_predictions([broken] * 3, lambda number, _: flights[number], ("said",))
    assert [each.quantity for each in result.errors] == ["roll rate"]
    assert result.errors[0].rms[0] == pytest.approx(np.sqrt((4 * 1.0 + 2 * 9.0) / 6))
    assert (result.start_s.size, result.omitted) == (3 * starts_of(broken).samples.size, ("said",))


@pytest.fixture(scope="module")
def hover():
    return flown(amplitude=0.0, gust=0.3, seed=3)[0]


@pytest.fixture(scope="module")
def dropped(hover):
    """Of a vehicle whose thrust drops to .8 at 20 s: it commands as much more."""
    command = hover.channels["rotor_command_1"]
    values = np.where(command.time_s >= 20.0, command.values / np.sqrt(0.8), command.values)
    channels = {**hover.channels, "rotor_command_1": replace(command, values=values)}
    return track(ev.identify_flight(replace(hover, channels=channels)))


@pytest.mark.thorough
def test_a_drop_is_told_where_it_is_and_by_how_much(dropped):
    (change,) = dropped.changes
    assert change.change == -1
    assert 20.0 < change.time_s < 23.0
    (sentence,) = report_changes(dropped)
    (by,) = re.findall(r"input gain K_u fell by ([\d.]+) ± ([\d.]+) %\.", sentence)
    assert abs(float(by[0]) - 20.0) < float(by[1]) < 6.0
    early = [item for item in dropped.precise_moments if item.time_s < 20.0]
    late = [item for item in dropped.precise_moments if item.time_s > 25.0]
    for moments, truth in ((early, GAIN), (late, 0.8 * GAIN)):
        assert len(moments) > 5
        assert all(abs(moment.value - truth) < moment.half_width < 0.05 * truth for moment in moments)


@pytest.mark.thorough
def test_nothing_is_told_of_a_flight_that_stays_as_it_is(hover):
    result = track(ev.identify_flight(hover))
    assert result.changes == ()
    (sentence,) = report_changes(result)
    assert re.search(r"No sudden change\. .* s it changed by [+-][\d.]+ ± [\d.]+ %\.", sentence)


@pytest.mark.thorough
def test_intervals_hold_the_gain_in_thermals():
    """Air of 1 m/s that changes in 20 s was read as a change of the gain: .75 of the intervals held it."""
    specs = [
        VerticalFlightSpec(seed=500 + n, duration=90.0, gust_rms=1.0, gust_correlation=20.0) for n in range(4)
    ]
    moments = [
        moment
        for flight in simulate_vertical_flights(specs)
        for moment in track(ev.identify_flight(flight.recording)).precise_moments
    ]
    assert len(moments) > 500
    assert np.mean([abs(each.value - specs[0].input_gain) < each.half_width for each in moments]) > 0.92


@pytest.mark.thorough
def test_a_gain_by_a_wrong_map_is_that_of_the_whole_flight():
    """With the intercept held at zero it was 21.4 ± .5 where the flight has 27.95 [27.4, 28.8]."""
    fit = ev.identify_flight(flown(seed=3)[0], input_map="power:1.5")
    values = [moment.value for moment in track(fit).precise_moments]
    gain = fit.quantities["input_gain"]
    assert fit.quantities["intercept"].interval[1] < -1.0
    assert np.median(values) == pytest.approx(gain.value, rel=0.03)


@pytest.mark.thorough
def test_hover_tells_nothing_when_nothing_is_known_of_the_intercept(hover):
    result = track(ev.identify_flight(hover, accelerometer_bias=float("inf")))
    assert result.precise_moments == ()
    assert "wider than ±20 %" in " ".join(untold(result))
    assert "only movement identifies" in result.known[1]
    assert "reported at no moment" in track_figure(result).get_suptitle()


@pytest.mark.thorough
def test_a_window_without_samples_is_not_told():
    moments = tuple(Moment(float(t), 40.0, 1.0, 0.1 if 3 <= t < 6 else 0.9) for t in range(10))
    result = ev.identify_flight(flown(seconds=10.0)[0])
    results = Track(result, "input_gain", "m/s^2", 5.0, {}, moments, ())
    (sentence,) = untold(results)
    assert sentence.startswith("3.0 to 5.0 s: hardly any sample")
    assert len(results.precise_moments) == 7


@pytest.mark.thorough
def test_documents_figure_and_json_agree(dropped, capsys):
    from rich.console import Console

    Console(width=80).print(on_terminal(track_document(dropped)))
    assert "fell" in capsys.readouterr().out
    document = track_json(dropped)
    assert document["schema"] == "eivor.track/1"
    (change,) = document["changes"]
    assert (change["time_s"], change["upwards"]) == (dropped.changes[0].time_s, False)
    assert abs(change["share"] + 0.2) < change["half_width"]
    assert len(document["moments"]) == len(dropped.moments)
    (axes,) = track_figure(dropped).axes
    assert (len(axes.lines), len(axes.collections)) == (2, 1)


@pytest.mark.thorough
def test_what_cannot_be_followed_is_refused(hover):
    result = ev.identify_flight(hover)
    with pytest.raises(UsageError, match=r"memory of 0.1 to 30 s, the length of the flight; received 99 s"):
        track(result, 99.0)
    with pytest.raises(UsageError, match="one flight to follow; received 2"):
        track(replace(result, prepared=result.prepared * 2))
    nothing = track(ev.identify_flight(hover, window=(1.0, 2.0)))
    assert nothing.moments == ()
    assert "three seconds" in " ".join(untold(nothing))


# Diagnostics of a flight: constancy, least squares beside the estimate, memory, leverage of runs.

LAGS = np.geomspace(0.02, 0.12, 5)


@pytest.fixture(scope="module")
def example() -> ev.FlightEstimate:
    return ev.identify_flight(ev.example_flight())


@pytest.mark.calibration
def test_constancy_keeps_its_size_in_flights():
    """Flights in gusts: no more of them change than the level says."""
    runs = 12
    each = [problem(*flights(1, seconds=40.0, noise=Noise(gust=0.5), seed=s), lags=LAGS) for s in range(runs)]
    p_values = [ev.diagnose(ev.identify(item, ev.methods.reference_iv())).constancy.p_value for item in each]
    assert sum(p < 0.05 for p in p_values) <= stats.binom.ppf(1.0 - 1e-4, runs, 0.06)


@pytest.mark.thorough
def test_a_change_between_flights_is_told():
    """A command that is scaled from the second flight on: the gain per command is another one."""
    first, second = flights(2, seconds=40.0, noise=Noise())
    channels = dict(second.signals.channels)
    channels["rotor_command_1"] = 1.1 * channels["rotor_command_1"]
    changed = replace(second, signals=replace(second.signals, channels=channels))
    fit = ev.identify(problem(first, changed, lags=LAGS), ev.methods.reference_iv())
    diagnose = ev.diagnose(fit)
    assert diagnose.constancy.p_value <= 0.01
    assert diagnose.constancy.break_at == pytest.approx(0.5, abs=0.05)
    gain = fit.names.index("input_gain")
    change = diagnose.constancy.change[gain] / fit.parameters["input_gain"]
    assert change == pytest.approx(1.0 / 1.21 - 1.0, abs=0.07)
    assert any("change during the record" in reason.sentence for reason in diagnose.reasons)


def test_checks_are_said_in_words(example):
    """Those of the example are in the README."""
    result = example.fit.checks
    index = example.names.index("viscous_friction")

    def moved(values: np.ndarray, by: float) -> np.ndarray:
        return np.where(np.arange(values.size) == index, by, values)

    def changed(into, **parts):
        return replace(into, **{name: replace(getattr(into, name), **part) for name, part in parts.items()})

    def said_of(checked):
        return dict(checks(replace(example, fit=replace(example.fit, checks=checked))))

    swing = Swing("viscous_friction", "1/s", 6.0, 0.1, 1e-6)
    worse = changed(
        result,
        agreement={"p_value": 1e-9},
        constancy={"p_value": 0.001, "break_at": 0.4, "change": moved(result.constancy.change, 0.1)},
        endogeneity={"p_value": 0.001, "difference": moved(result.endogeneity.difference, -0.3)},
        leverage={"in_std_errors": np.vstack([moved(row, -3.0) for row in result.leverage.in_std_errors])},
        memory={"memory": 0.9},
        periodicity={"parameters": (swing,), "left_over": ()},
    )
    sentence = said_of(worse)
    assert sentence["agreement"] == "the instruments disagree (p <= 0.001)"
    changes = "the parameters change (p <= 0.001), most likely 40% into the time used: K by +0.1 1/s"
    assert sentence["constancy"] == changes
    assert sentence["periods"] == "K varies by ±0.1 1/s with a period of 6 s (p <= 0.001)"
    left_over = replace(swing, of="acceleration", unit="m/s²", amplitude=0.3)
    push = {"parameters": result.periodicity.parameters, "left_over": (left_over,)}
    assert said_of(changed(worse, periodicity=push))["periods"] == (
        "what the model leaves over of the acceleration swings by ±0.3 m/s² with a period of 6 s "
        "(p <= 0.001), as by a wind or a supply that swings"
    )
    assert "standard errors off" in sentence["least squares"]
    assert sentence["residual"].endswith("(it drifts)")
    assert sentence["leverage"].endswith("-3.0 standard errors: inspect that part")


@pytest.mark.thorough
def test_a_direct_method_has_fewer_checks():
    fit = ev.identify_flight(ev.example_flight(), ev.FlightOptions(method="least_squares"))
    sentence = dict(checks(fit))
    assert "instruments" not in sentence
    assert "least squares" not in sentence
    assert "constancy" in sentence


@pytest.fixture(scope="module")
def gusty() -> Recording:
    """A flight in gusts."""
    return flown(seconds=15.0, gust=2.0, amplitude=0.5, seed=3)[0]


@pytest.fixture(scope="module")
def one_frequency() -> Recording:
    """A flight whose reference tells friction and lag together only."""
    return flown(seconds=30.0, gust=2.0, seed=1, hertz=(0.32,))[0]


@pytest.fixture(scope="module")
def two_frequencies() -> Recording:
    """A flight whose reference hardly tells its lag."""
    return flown(seconds=30.0, gust=3.0, amplitude=0.6, seed=1501, hertz=(0.3, 0.35))[0]


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_one_frequency_tells_no_friction_without_the_lag(one_frequency):
    alone = ev.identify_flight(one_frequency)
    sets = alone.fit.sets[K]
    assert not sets.anderson_rubin.is_bounded
    assert not sets.profile.is_bounded
    quantity = alone.quantities[K]
    assert quantity.interval == quantity.widened(sets.robust.hull)
    assert quantity.interval[0] < sets.robust.hull[0]
    assert alone.verdict.status is Status.REFUSED
    (reason,) = [item for item in alone.quantities[K].reasons if item.status is Status.REFUSED]
    assert "one frequency (0.3" in reason.sentence
    assert "leave the viscous friction anywhere above " in reason.sentence
    assert reason.remedy.endswith("--lag MS:STD or --lag LOW..HIGH.")
    assert json.loads(alone.to_json())["parameters"][K]["sets"]["anderson_rubin"][-1][1] is None
    known = ev.identify_flight(one_frequency, lag=ev.Prior(LAG_S, 0.015))
    sets = known.fit.sets[K]
    assert sets.anderson_rubin.is_bounded
    assert sets.anderson_rubin.hull[0] > 0.0
    assert sets.profile.contains(FRICTION)
    assert known.verdict.status in {Status.IDENTIFIED, Status.WEAK}


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_strong_instruments_at_a_wrong_lag_tell_nothing():
    """At the best lag, which is far too long, every F is above ten, and the interval there has two ends."""
    result = ev.identify_flight(flown(seconds=15.0, gust=1.0, seed=2, hertz=(0.32,))[0])
    assert min(result.fit.checks.first_stage.values()) >= STRONG_FIRST_STAGE
    sets = result.fit.sets[K]
    assert sets.wald.is_bounded
    assert not sets.profile.is_bounded
    assert sets.profile.contains(FRICTION)
    low, high = result.quantities[K].interval
    assert low < FRICTION < high == np.inf
    assert result.verdict.status is Status.REFUSED
    assert any("how long the lag is at most" in sentence for sentence in result.verdict.sentences)


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_weak_instruments_refuse_nothing_that_a_bounded_set_tells(two_frequencies):
    result = ev.identify_flight(two_frequencies)
    assert min(result.fit.checks.first_stage.values()) < 10.0
    sets, quantity = result.fit.sets[K], result.quantities[K]
    assert sets.wald.hull[0] < 0.0 < sets.anderson_rubin.hull[0]
    assert quantity.interval == quantity.widened(sets.robust.hull)
    (low, high), (outer_low, outer_high) = sets.robust.hull, sets.anderson_rubin.hull
    assert outer_low < low < high < outer_high  # the conditional set is the shorter one
    # the width of the set refuses, and not the first stage
    (reason,) = [item for item in quantity.reasons if item.status is Status.REFUSED]
    assert "interval of the viscous friction is ±" in reason.sentence
    assert "it needs ±100%" in reason.sentence
    assert quantity.half_width > quantity.value
    assert not any("First-stage F" in item.sentence for item in quantity.reasons)
    low, high = quantity.interval
    assert result.quantities["time_constant"].interval == (1.0 / high, 1.0 / low)
    narrow = result.interval(K, 0.9)
    assert result.interval(K) == quantity.interval
    assert low < narrow[0] < narrow[1] < high


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_methods_whose_rows_are_not_white_have_no_sets(gusty):
    result = ev.identify_flight(gusty, method="extended_iv")
    assert result.fit.sets == {}
    assert json.loads(result.to_json())["parameters"][K]["sets"] is None
    whitened = ev.identify_flight(gusty)
    problem, estimate = whitened.fit.problem, whitened.fit.estimate
    with pytest.raises(UsageError, match="viscous_friction, input_gain"):
        ProfileSets(problem, estimate).of_parameter("actuator_lag")


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.calibration
def test_sets_cover_and_tell_where_instruments_are_weak():
    logs = [
        log
        for first in range(2)
        for log in flown(10, seconds=30.0, gust=3.0, amplitude=0.7, seed=900 + first, hertz=(0.3, 0.35))
    ]
    results = [ev.identify_flight(log) for log in logs]
    weak = [result for result in results if min(result.fit.checks.first_stage.values()) < STRONG_FIRST_STAGE]
    assert len(weak) >= 5
    robust = [result.fit.sets[K].robust for result in weak]
    covered = sum(item.contains(FRICTION) for item in robust)
    assert covered >= stats.binom.ppf(1e-3, len(robust), 0.95)
    selected = [item.is_bounded and item.hull[0] > 0.0 for item in robust]
    assert np.mean(selected) >= 0.3
    assert np.mean([result.fit.sets[K].wald.hull[0] > 0.0 for result in weak]) < np.mean(selected)


LATE = SystematicUncertainty(Counts.ADDED, 0.0, 0.25, "late by up to a quarter")
BOTH = SystematicUncertainty(Counts.ADDED, 0.5, 0.5, "either way")
LEAST = SystematicUncertainty(Counts.AT_LEAST, 2.0, 2.0, "at least")
OWN = SystematicUncertainty(Counts.INDEPENDENT, 0.75, 2.4, "of its own")
TWICE = SystematicUncertainty(Counts.FACTOR, 2.0, 2.0, "twice as long")


@pytest.mark.parametrize(
    ("parts", "wanted"),
    [
        ((), (9.0, 11.0)),
        ((LATE,), (9.0, 11.25)),
        ((LATE, BOTH), (8.5, 11.75)),
        ((LEAST,), (8.0, 12.0)),
        ((LEAST, BOTH, LATE), (8.0, 12.0)),  # a least width is not added to what widens
        ((TWICE,), (8.0, 12.0)),
        ((TWICE, BOTH), (7.5, 12.5)),  # a factor comes first
        ((OWN,), (8.75, 12.6)),  # squares add up: 1, .75 and 1.25, 1, 2.4 and 2.6
        ((BOTH, OWN), (8.25, 13.1)),
    ],
)
def test_intervals_with_their_systematic_parts(parts, wanted):
    assert (widened((9.0, 11.0), 10.0, parts), widened((9.0, 11.0), NAN, parts)) == (wanted, (9.0, 11.0))


def test_what_follows_from_a_headline_follows_it_when_it_widens():
    quantities = {
        "viscous_friction": QuantityEstimate(0.5, "1/s", 0.05, (0.4, 0.6)),
        "hover_input": QuantityEstimate(10.0, "", 0.5, (9.0, 11.0)),
        "time_constant": QuantityEstimate(2.0, "s", 0.2, (1.6, 2.6)),
    }
    parts = {"viscous_friction": (), "hover_input": (LEAST,)}
    same = with_systematic_uncertainties(Vertical(), quantities, parts)
    assert same["time_constant"] == quantities["time_constant"]
    assert same["hover_input"].interval == (8.0, 12.0)
    part = SystematicUncertainty(Counts.ADDED, 0.15, 0.4, "more")
    wider = with_systematic_uncertainties(Vertical(), quantities, {"viscous_friction": (part,)})
    assert wider["viscous_friction"].interval == pytest.approx((0.25, 1.0))
    assert wider["time_constant"].interval == pytest.approx((1.0, 4.0))


LAG = QuantitySpec("lag", "τ", "s", lowest=0.0)


@pytest.mark.parametrize(
    ("interval", "possible"),
    [
        ((-1.0, 2.0), (0.0, 2.0)),
        ((0.5, 2.0), (0.5, 2.0)),
        ((-1.0, 0.0), (0.0, 0.0)),
        # Nothing possible is left, or nothing was said: cutting would say more than the data do.
        ((-2.0, -1.0), (-2.0, -1.0)),
        ((-float("inf"), float("inf")), (-float("inf"), float("inf"))),
    ],
)
def test_intervals_end_where_the_quantity_does(interval, possible):
    quantity = QuantityEstimate(1.0, "s", 0.5, interval).judged(Verdict(Status.WEAK), LAG)
    assert quantity.interval == possible
    assert quantity.verdict is Status.WEAK
    anything = replace(LAG, lowest=-float("inf"))
    estimate = QuantityEstimate(1.0, "s", 0.5, interval)
    assert estimate.judged(Verdict(Status.WEAK), anything).interval == interval
