"""What a page draws: series that are packed and thinned, scales with their ticks, forests."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from eivor.inference.verdict import Status
from eivor.report import flight_page
from eivor.report.html import element
from eivor.report.svg import (
    LARGEST,
    MISSING,
    WIDTH,
    Chart,
    Curve,
    Forest,
    ForestRow,
    Line,
    Linear,
    LinearBelow,
    Logarithmic,
    Plot,
    margined,
    stretches_of,
)
from report.parsed_page import parsed


def chart(time_s: np.ndarray, values: np.ndarray) -> Chart:
    return Chart("a", "m", time_s, (Line("height", "measured", values),), (0.0, 1.0), (0.0, 1.0), ())


def unpacked(packed: dict) -> tuple[np.ndarray, np.ndarray]:
    """Times and values as the page's script has them."""
    (line,) = packed["lines"]
    codes = np.frombuffer(base64.b64decode(line["codes"]), dtype="<u2")
    values = np.where(codes == MISSING, np.nan, line["low"] + codes * line["step"])
    times = np.concatenate([start + step * np.arange(count) for start, step, count in packed["stretches"]])
    return times, values


def test_a_short_series_comes_back_as_it_was():
    time_s = np.concatenate([np.arange(0.0, 1.0, 0.01), np.arange(2.0, 2.5, 0.01)])
    values = np.sin(7.0 * time_s)
    values[17] = np.nan
    packed = chart(time_s, values).packed(1000)
    times, back = unpacked(packed)
    assert len(packed["stretches"]) == 2
    np.testing.assert_allclose(times, time_s, atol=1e-9)
    np.testing.assert_allclose(back, values, atol=0.51 * 2.0 / LARGEST)


def test_a_long_series_keeps_its_extremes_where_they_are():
    time_s = 0.01 * np.arange(50_000)
    values = np.random.default_rng(0).standard_normal(time_s.size)
    values[[12_345, 30_001]] = 40.0, -50.0
    times, back = unpacked(chart(time_s, values).packed(2000))
    assert times.size <= 2010
    assert times[np.argmax(back)] == pytest.approx(123.45, abs=0.5)
    assert times[np.argmin(back)] == pytest.approx(300.01, abs=0.5)
    assert np.max(back) == pytest.approx(40.0, abs=1e-2)
    assert np.min(back) == pytest.approx(-50.0, abs=1e-2)


@pytest.mark.parametrize("values", [np.full(5, np.nan), np.full(5, 1800.0), np.array([3.0])])
def test_a_series_without_a_range_is_packed_too(values):
    _, back = unpacked(chart(0.01 * np.arange(values.size), values).packed(1000))
    np.testing.assert_array_equal(back, values)


def test_stretches_are_those_of_the_mask():
    mask = np.array([True, True, False, False, True])
    assert stretches_of(mask, np.arange(5.0)) == ((0.0, 1.0), (4.0, 4.0))


@pytest.mark.parametrize(
    ("scale", "least"),
    [
        (Linear("x", 0.161, 0.210), 3),
        (Linear("x", -1e-8, 3e-8), 3),
        (Linear("x", 3.02e-6, 3.09e-6), 3),
        (Linear("x", -4e7, 9e7), 3),
        (Linear("x", 1778.9, 1796.7), 3),
        (Logarithmic("x", 0.9, 320.0), 3),
        (Logarithmic("x", 60.0, 80.0), 3),
        (Logarithmic("x", 1e-9, 1e4), 3),
        (LinearBelow("x", 3.84, 1e6), 2),
        (margined("x", np.array([2.0, 2.0])), 2),
        (margined("x", np.array([np.nan])), 2),
    ],
)
def test_ticks_are_within_the_scale_and_say_what_they_are(scale, least):
    ticks = scale.ticks(6)
    assert least <= len(ticks) <= 9
    assert len({tick.words for tick in ticks}) == len(ticks)
    for tick in ticks:
        assert float(tick.words.replace("−", "-")) == pytest.approx(
            tick.value, rel=1e-9, abs=1e-12 * abs(scale.high)
        )
    shares = scale.share(np.array([tick.value for tick in ticks]))
    assert ((shares >= -1e-9) & (shares <= 1.0 + 1e-9)).all()
    assert (np.diff(shares) > 0.0).all()


def test_words_of_ticks_do_not_touch():
    plot = Plot(
        Linear("x", 10_000.0, 10_006.0),
        Linear("y", 0.0, 1.0),
        (Curve("c", "first", np.arange(3.0), np.zeros(3)),),
    )
    (svg,) = parsed(plot.drawn("p", "A title").html).all("svg")
    index = [(float(item.attributes["x"]), len(item.text)) for item in svg.all("text", class_="middle")[:-1]]
    ends = [(x - 3.7 * letters, x + 3.7 * letters) for x, letters in index]
    assert len(index) >= 3
    assert all(item[1] < other[0] for item, other in pairwise(ends))
    assert ends[-1][1] <= WIDTH


def test_a_line_is_broken_where_there_is_no_value():
    curve = Curve("c", "first", np.arange(5.0), np.array([0.0, 1.0, np.nan, 1.0, 0.0]))
    drawn = Plot(Linear("x", 0.0, 4.0), Linear("y", 0.0, 1.0), (curve,)).drawn("p", "t")
    (path,) = re.findall(r' d="([^"]*)"', drawn.html)
    assert path.count("M") == 2


def test_a_forest_is_made_for_what_is_known_and_cuts_the_rest():
    rows = (
        ForestRow("one", "1 [0, 2]", 1.0, ((0.0, 2.0),), Status.IDENTIFIED),
        ForestRow("two", "2 [1, 3]", 2.0, ((1.0, 3.0),), Status.WEAK),
        ForestRow("wide", "500 [-900, 1900]", 500.0, ((-900.0, 1900.0),), Status.REFUSED),
        ForestRow("open", "–", 1.0, ((-np.inf, np.inf),), Status.REFUSED),
        ForestRow("none", "–", np.nan, (), Status.REFUSED),
        ForestRow("a name of " + 80 * "m", "1 [0, 2]", 1.0, ((0.0, 2.0),), None, whole=True),
    )
    root = parsed(Forest("K [1/s]", rows).drawn("p", "t").html)
    ticks = [float(item.text.replace("−", "-")) for item in root.all("text", class_="tick")]
    assert min(ticks) >= -1.0
    assert max(ticks) <= 4.0
    points = [item.classes[1] for item in root.all() if "point" in item.classes]
    assert points == ["identified", "weak", "refused", "whole"]
    last = root.all("text", class_="row")[-2].text
    assert last.endswith("…")
    assert len(last) < 60


def test_text_and_attributes_are_escaped():
    made = element("p", {"title": '"><b>'}, "<i>&amp;", element("b", None, "\u202e"))
    assert made.html == '<p title="&quot;&gt;&lt;b&gt;">&lt;i&gt;&amp;amp;<b>\\u202e</b></p>'


def test_a_spectrum_of_many_bins_is_drawn_in_few_points_of_the_same_power():
    frequency = np.arange(1, 5001) / 10.0
    banded, amplitude = flight_page._banded(frequency, np.full(5000, 3.0))
    assert banded.size < 350
    assert (np.diff(banded) > 0.0).all()
    np.testing.assert_allclose(amplitude, 3.0)


def test_an_axis_that_no_input_moves_has_no_spectrum(fit, monkeypatch):
    (trace,) = fit.fit.traces(fit.motion)
    still = replace(trace, axis="side", driven=np.zeros_like(trace.driven))
    monkeypatch.setattr(type(fit.fit), "traces", lambda *_: (trace, still))
    titles = [picture.title for picture in flight_page.pictures_of_fit(fit, fit.fit).pictures]
    assert [title for title in titles if "excites" in title] == [f"What excites the {trace.axis}"]
