"""What a page draws: series that are packed and thinned, scales with their ticks, forests."""

from __future__ import annotations

import base64
from dataclasses import replace

import numpy as np
import pytest

from eivor.inference.verdict import Status
from eivor.report import flight_page
from eivor.report.figure_panels import PlottedInterval, draw_forest
from eivor.report.flight import banded, spans_of
from eivor.report.flight_page import LARGEST, MISSING, Chart, Line, drawing, forest_picture
from eivor.report.html import element
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
    assert spans_of(mask, np.arange(5.0)) == ((0.0, 1.0), (4.0, 4.0))


def test_a_drawing_has_names_of_its_own_and_no_style():
    def draw(axes):
        axes.semilogx([0.01, 1.0, 100.0], [1.0, 2.0, 3.0], "o-", label="<b>&amp;")
        axes.legend()

    text = drawing(draw, "p", "A <title>", 3.0)
    (svg,) = parsed(text).all("svg")
    assert text == drawing(draw, "p", "A <title>", 3.0)
    assert svg.all("title")[0].text == "A <title>"
    assert "<b>&amp;" in [item.text for item in svg.all("text")]
    assert {"0.01", "1", "100"} <= {item.text for item in svg.all("text")}
    names = [item.attributes["id"] for item in svg.all() if "id" in item.attributes]
    assert len(names) == len(set(names))
    assert all(name.startswith("p-") for name in names)
    for entry in svg.all():
        assert not {"style", "src"} & set(entry.attributes)
        assert not any(key.startswith("on") for key in entry.attributes)
        for key in ("href", "clip-path"):
            assert entry.attributes.get(key, "#p-").removeprefix("url(").startswith("#p-")


def test_a_forest_is_made_for_what_is_known_and_cuts_the_rest():
    rows = (
        PlottedInterval("one", 1.0, ((0.0, 2.0),), "1 [0, 2]", Status.IDENTIFIED),
        PlottedInterval("two", 2.0, ((1.0, 3.0),), "2 [1, 3]", Status.WEAK),
        PlottedInterval("wide", 500.0, ((-900.0, 1900.0),), "500 [-900, 1900]", Status.REFUSED),
        PlottedInterval("open", 1.0, ((-np.inf, np.inf),), "–", Status.REFUSED),
        PlottedInterval("none", np.nan, (), "–", Status.REFUSED),
        PlottedInterval("a name of " + 80 * "m", 1.0, ((0.0, 2.0),), "1 [0, 2]", None, whole=True),
    )
    picture = forest_picture("A title", "K [1/s]", rows)
    svg = parsed(drawing(picture.drawn, "p", picture.title, picture.height))
    texts = [item.text for item in svg.all("text")]
    ticks = [float(text.replace("−", "-")) for text in texts[: texts.index("K [1/s]")]]
    assert min(ticks) >= -1.0
    assert max(ticks) <= 4.0
    assert [text for text in texts if text in {row.numbers for row in rows}] == [row.numbers for row in rows]
    assert texts[-2].endswith("…")
    assert len(texts[-2]) < 60
    made = []
    drawing(lambda axes: (draw_forest(axes, rows, "K"), made.append(axes)), "p", "t", 3.0)
    points = [line for line in made[0].lines if line.get_marker() in {"o", "x", "D"}]
    assert [line.get_marker() for line in points] == ["o", "o", "x", "D"]
    arrows = [line.get_marker() for line in made[0].lines if line.get_marker() in {"<", ">"}]
    assert arrows == ["<", ">", "<", ">"]


def test_text_and_attributes_are_escaped():
    made = element("p", {"title": '"><b>'}, "<i>&amp;", element("b", None, "\u202e"))
    assert made == '<p title="&#34;&gt;&lt;b&gt;">&lt;i&gt;&amp;amp;<b>\\u202e</b></p>'


def test_a_spectrum_of_many_bins_is_drawn_in_few_points_of_the_same_power():
    frequency = np.arange(1, 5001) / 10.0
    bands, amplitude = banded(frequency, np.full(5000, 3.0), flight_page.BANDS_PER_DECADE)
    assert bands.size < 350
    assert (np.diff(bands) > 0.0).all()
    np.testing.assert_allclose(amplitude, 3.0)


def test_an_axis_that_no_input_moves_has_no_spectrum(fit, monkeypatch):
    (trace,) = fit.fit.traces(fit.motion)
    still = replace(trace, axis="side", driven=np.zeros_like(trace.driven))
    monkeypatch.setattr(type(fit.fit), "traces", lambda *_: (trace, still))
    titles = [picture.title for picture in flight_page.pictures_of_fit(fit, fit.fit).pictures]
    assert [title for title in titles if "excites" in title] == [f"What excites the {trace.axis}"]
