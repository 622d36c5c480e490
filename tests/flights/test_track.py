"""The gain over a flight: a drop is told where it is, hover tells it by its level, gaps say why it is not."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from flight_logs import GAIN, flown

import eivor as ev
from eivor.errors import UsageError
from eivor.flights.track import Moment, Track, track
from eivor.report.other_results import marks, report_changes, track_document, track_figure, track_json, untold
from eivor.report.terminal import on_terminal


def weakened(log, at_s, factor):
    """The log of a vehicle whose thrust drops by a factor at a time: it commands as much more."""
    command = log.channels["rotor_command_1"]
    values = np.where(command.time_s >= at_s, command.values / np.sqrt(factor), command.values)
    return replace(log, channels={**log.channels, "rotor_command_1": replace(command, values=values)})


@pytest.fixture(scope="module")
def hover():
    return flown(amplitude=0.0, gust=0.3, seed=3)[0]


@pytest.fixture(scope="module")
def dropped(hover):
    return track(ev.identify_flight(weakened(hover, 20.0, 0.8)))


@pytest.mark.thorough
def test_a_drop_is_told_where_it_is_and_by_how_much(dropped):
    (change,) = dropped.changes
    assert change.change == -1
    assert 20.0 < change.time_s < 23.0
    (sentence,) = report_changes(dropped)
    assert re.search("input gain K_u fell by 20 %", sentence)
    early = [item for item in dropped.precise_moments if item.time_s < 20.0]
    late = [item for item in dropped.precise_moments if item.time_s > 25.0]
    for moments, truth in ((early, GAIN), (late, 0.8 * GAIN)):
        assert len(moments) > 5
        assert all(abs(moment.value - truth) < moment.half_width < 0.05 * truth for moment in moments)


@pytest.mark.thorough
def test_nothing_is_told_of_a_flight_that_stays_as_it_is(hover):
    result = track(ev.identify_flight(hover))
    assert result.changes == ()
    assert "None" in next(iter(report_changes(result)))


@pytest.mark.thorough
def test_hover_tells_nothing_when_nothing_is_known_of_the_intercept(hover):
    result = track(ev.identify_flight(hover, accelerometer_bias=float("inf")))
    assert result.precise_moments == ()
    assert "wider than ±20 %" in " ".join(untold(result))
    assert "only movement identifies" in result.known[1]
    figure = track_figure(result)
    assert "reported at no moment" in figure.get_suptitle()


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
    screen = capsys.readouterr().out
    assert "K_u  ··█" in screen
    assert "fell" in screen
    document = track_json(dropped)
    assert document["schema"] == "eivor.track/1"
    assert document["changes"] == [{"time_s": dropped.changes[0].time_s, "upwards": False}]
    assert len(document["moments"]) == len(dropped.moments)
    (axes,) = track_figure(dropped).axes
    assert len(axes.lines) == 2
    assert len(axes.collections) == 1


def test_marks_span_what_is_told_and_a_tenth_at_least():
    assert marks([1.0, 2.0, 5.0], [True, True, False]) == "▁█·"
    assert marks([1.0, 1.001], [True, True]) in ("▄▅", "▅▅", "▄▄")
    assert marks([1.0], [False]) == "·"


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
