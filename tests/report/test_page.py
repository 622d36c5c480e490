"""The page of a result: its order, numbers, policy and drawings, and that nothing breaks out of it."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import tomllib
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coarse_search import coarse
from eivor.flights.options import FlightOptions
from eivor.flights.result import FlightEstimate, LogEstimate
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.verdict import Reason, Status, Verdict
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.motion import Vertical
from eivor.report.document import Cell, Document, Facts, Section, table
from eivor.report.figure_panels import Chart, Line, PlottedInterval, draw_forest, forest_picture
from eivor.report.flight import log_documents, result_card
from eivor.report.flight_page import MISSING, drawing, flight_page, pack
from eivor.report.html import rendered
from eivor.signals.recording import Finding, Recording
from report.parsed_page import Element, numbers_in, parsed

IMAGE = "data:image/svg+xml;base64,"
HOSTILE = (
    "</script><script>alert(1)</script><!--<img src=x onerror=alert(1)>",
    "\"'><svg onload=alert(1)>&lt;&amp;\u2028\u2029",
    "\u202egnp.exe\u0000\ud800\x1b[31m",
    "x" * 10_000,
)


@pytest.fixture(scope="module")
def weak(recording: Recording) -> FlightEstimate:
    with coarse():
        return identify_flight(recording, FlightOptions(window=(0.0, 15.0)))


@pytest.fixture(scope="module")
def provisional(recording: Recording) -> FlightEstimate:
    with coarse():
        return identify_flight(recording, FlightOptions(method="least_squares", window=(0.0, 15.0)))


NAMES = ("fit", "pool", "still", "weak", "provisional")
RESULTS = [pytest.param(name, marks=pytest.mark.thorough) if name == "pool" else name for name in NAMES]


@dataclass(frozen=True)
class Twin(Vertical):
    """The same motion by another name."""

    name = "twin"


@pytest.fixture(scope="module")
def both(fit: FlightEstimate) -> LogEstimate:
    return LogEstimate(
        {"vertical": fit, "twin": replace(fit, motion=Twin())}, {"rates": "There is no gyroscope."}
    )


class Pages(dict[str, tuple[FlightEstimate, str, Element]]):
    """Results by their names, each with its page, made when it is asked for."""

    def __init__(self, request: pytest.FixtureRequest) -> None:
        self.request = request

    def __missing__(self, name: str) -> tuple[FlightEstimate, str, Element]:
        result = self.request.getfixturevalue(name)
        text = flight_page(result)
        self[name] = (result, text, parsed(text))
        return self[name]


@pytest.fixture(scope="module")
def pages(request: pytest.FixtureRequest) -> Pages:
    """Five results, each with its page."""
    return Pages(request)


def data_of(page: Element, name: str) -> Any:
    (result,) = page.all("script", id=name)
    return json.loads(result.text)


@pytest.mark.parametrize("name", RESULTS)
def test_the_page_is_told_in_order(pages, name):
    result, _, page = pages[name]
    (main,) = page.all("main")
    (sentence,) = main.all("p", class_="said")
    assert sentence.text == result_card((result,)).title
    assert main.children[0].classes[0] == "verdict"
    headings = [item.text for item in page.all("h2")]
    order = "Why, What to do, Checks, Flights one by one, Methods side by side, Flight card, Pictures"
    wanted = [item for item in order.split(", ") if item in headings]
    assert [heading for heading in headings if heading in wanted] == wanted
    assert {"Pictures", "Provenance"} <= set(headings)
    assert len(page.all("h1")) == 1
    assert not [item.text for item in page.all("dd") if "K_u" in item.text]


@pytest.mark.parametrize("name", [*RESULTS, "both"])
def test_names_of_elements_are_unique_and_lead_somewhere(pages, name):
    _, _, page = pages[name]
    names = [item.attributes["id"] for item in page.all() if "id" in item.attributes]
    assert len(names) == len(set(names))
    for entry in page.all():
        for key in ("aria-labelledby", "aria-describedby"):
            assert set(entry.attributes.get(key, "").split()) <= set(names)
        if entry.tag == "a" and entry.attributes["href"].startswith("#"):
            assert entry.attributes["href"][1:] in names
    charts = data_of(page, "charts")
    assert {item.attributes["id"] for item in page.all("div", class_="chart")} == set(charts)


def test_motions_of_a_log_have_one_card(pages, both):
    result, _, page = pages["both"]
    (box,) = page.all("div", class_="verdict")
    words = [item.all("p", class_="name")[0].text for item in box.all("div", class_="reading")]
    assert "effective lag (vertical) τ + d" in words
    assert "effective lag (twin) τ + d" in words
    documents = log_documents(result)
    assert [document.card is None for document in documents] == [False, True, True]
    assert documents[-1].sections[-1].parts == (Facts((("rates", "There is no gyroscope."),)),)
    assert str(documents).count("Noticed in the log") <= 1


@pytest.mark.parametrize("name", [*RESULTS, "both"])
def test_the_json_in_the_page_is_that_of_the_command_line(pages, name):
    result, _, page = pages[name]
    assert data_of(page, "result") == json.loads(result.to_json())


@pytest.mark.parametrize("name", RESULTS)
def test_numbers_are_those_of_the_json(pages, name):
    result, _, page = pages[name]
    reported = json.loads(result.to_json())
    known = {**reported["parameters"], **reported["derived"]}
    by_words = {words.words: key for key, words in result.motion.quantities.items()}
    rows = [row for row in page.all("tr") if row.all("th") and row.all("th")[0].text in by_words]
    in_card = {item.attributes["data-quantity"] for item in page.all("div", class_="reading")}
    numbers = {key for key, item in known.items() if item["value"] is not None}
    assert {by_words[row.all("th")[0].text] for row in rows} | in_card >= numbers
    for row in rows[: len(known) - len(in_card)]:
        key = by_words[row.all("th")[0].text]
        cells = [child.text for child in row.children if isinstance(child, Element)]
        check(known[key], result.motion.quantities[key].scale, cells[2], cells[3])
        is_bound = cells[3].startswith(("below", "size below")) and known[key]["verdict"] == "identified"
        assert cells[-1] == ("bound" if is_bound else Status(known[key]["verdict"]).label)
        low, high = known[key]["interval"] or (1.0, 1.0)
        assert is_bound == (known[key]["verdict"] == "identified" and low <= 0.0 <= high)
    for reading in page.all("div", class_="reading"):
        key = reading.attributes["data-quantity"]
        value = reading.all("span", class_="value")[0].text
        interval = reading.all("p", class_="interval")[0].text
        check(known[key], result.motion.quantities[key].scale, value, interval)


def check(record: dict[str, Any], scale: float, value: str, interval: str) -> None:
    """Shown numbers are those told, rounded."""
    if record["value"] is None:
        assert value == "–"
        return
    ((displayed, half),) = numbers_in(value)
    assert displayed == pytest.approx(scale * record["value"], abs=1.001 * half)
    if interval.startswith("["):
        for (end, half), wanted in zip(numbers_in(interval), record["interval"], strict=True):
            assert end == pytest.approx(scale * wanted, abs=1.001 * half)


@pytest.mark.parametrize("name", RESULTS)
def test_the_verdict_is_there_for_pages_of_several_reports(pages, name):
    _, _, page = pages[name]
    verdict = data_of(page, "verdict")
    (box,) = page.all("div", class_="verdict")
    (title,) = box.all("p", class_="said")
    assert title.text == verdict["card"]["title"]
    assert box.classes == ["verdict", verdict["status"]]
    displayed = [
        (
            item.attributes["data-quantity"],
            item.all(class_="value")[0].text,
            item.all(class_="interval")[0].text,
        )
        for item in box.all("div", class_="reading")
    ]
    lines = [line for group in verdict["card"]["groups"] for line in group["lines"]]
    assert displayed == [(x["quantity"], x["text"], x["interval"]) for x in lines if x["quantity"]]
    reasons = [f"{line['words']}: {line['text']}{line['remark']}" for line in lines if not line["quantity"]]
    assert [item.text for item in box.all("li")] == reasons
    for entry in verdict["readings"]:
        numbers = numbers_in(" ".join(entry["shown"]))
        drawn = [number for number in (entry["at"], *entry["interval"]) if number is not None]
        for number, (written, half) in zip(drawn, numbers, strict=True):
            assert number == pytest.approx(written, abs=1.001 * half)


@pytest.mark.parametrize("name", RESULTS)
def test_the_policy_allows_what_is_in_the_page_and_nothing_else(pages, name):
    _, text, page = pages[name]
    (policy,) = (item.attributes["content"] for item in page.all("meta") if "http-equiv" in item.attributes)
    assert text.index("Content-Security-Policy") < text.index("<style")
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    styles = [item.text for item in page.all("style")]
    scripts = [item.text for item in page.all("script") if item.attributes.get("type") != "application/json"]
    assert len(styles) == len(scripts) == 1
    for source, rule in ((styles[0], "style-src"), (scripts[0], "script-src")):
        digest = base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()
        assert f"{rule} 'sha256-{digest}'" in policy
    for entry in page.all():
        assert not {key for key in entry.attributes if key.startswith("on") or key in {"style", "srcset"}}
        assert entry.attributes.get("src", IMAGE).startswith(IMAGE)
        assert entry.attributes.get("href", "#")[0] == "#" or entry.attributes["href"] == "data:,"
    assert not re.search(
        r"@import|url\(|\beval\b|new Function|innerHTML|document\.write", styles[0] + scripts[0]
    )


@pytest.mark.parametrize(
    "text", [HOSTILE[0], *(pytest.param(t, marks=pytest.mark.thorough) for t in HOSTILE[1:])]
)
def test_what_a_log_says_stays_text(fit, recording, pages, text):
    flight = replace(fit.prepared[0], recording=replace(recording, name=text, format=text))
    reasons = (Reason(Status.REFUSED, f"It says {text}.", f"Do {text}."),)
    hostile = replace(
        fit,
        prepared=(flight,),
        verdict=Verdict(Status.REFUSED, reasons),
        findings=(Finding("a_finding", f"{text} was seen."),),
    )
    made = flight_page(hostile)
    made.encode("utf-8")
    page, plain = parsed(made), pages["fit"][2]
    for tag in ("script", "svg", "img"):
        assert len(page.all(tag)) == len(plain.all(tag))
    assert data_of(page, "result")["logs"][0]["name"] == text
    body = made.partition("<body>")[2]
    assert not re.search("[\u0000-\u0009\u000b-\u001f\u2028-\u202e\ud800-\udfff]", body)
    assert body.count("<script") == plain.all("body")[0].all("script").__len__()
    assert len(page.all("h1")[0].text) <= 120


@pytest.mark.parametrize("name", ["katex", "uplot"])
def test_what_is_vendored_is_the_release(name):
    folder = Path(str(resources.files("eivor.report").joinpath("vendored", name)))
    release = tomllib.loads((folder / "release.toml").read_text(encoding="utf-8"))
    here = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert here == {"release.toml", release["licence"], *release["sha256"]}
    for file, digest in release["sha256"].items():
        assert hashlib.sha256((folder / file).read_bytes()).hexdigest() == digest
    assert "MIT" in (folder / release["licence"]).read_text(encoding="utf-8")


def chart(time_s: np.ndarray, values: np.ndarray) -> Chart:
    return Chart("a", "m", time_s, (Line("height", "measured", values),), (0.0, 1.0), (0.0, 1.0), ())


def unpacked(packed: dict) -> tuple[np.ndarray, np.ndarray]:
    """Times and values as the page's script has them."""
    (line,) = packed["lines"]
    codes = np.frombuffer(base64.b64decode(line["codes"]), dtype="<u2")
    values = np.where(codes == MISSING, np.nan, line["low"] + codes * line["step"])
    times = np.concatenate([start + step * np.arange(count) for start, step, count in packed["stretches"]])
    return times, values


def test_a_long_series_keeps_its_extremes_where_they_are():
    time_s = 0.01 * np.arange(50_000)
    values = np.random.default_rng(0).standard_normal(time_s.size)
    values[[12_345, 30_001]] = 40.0, -50.0
    times, back = unpacked(pack(chart(time_s, values), 2000))
    assert times.size <= 2010
    assert times[np.argmax(back)] == pytest.approx(123.45, abs=0.5)
    assert times[np.argmin(back)] == pytest.approx(300.01, abs=0.5)
    assert np.max(back) == pytest.approx(40.0, abs=1e-2)
    assert np.min(back) == pytest.approx(-50.0, abs=1e-2)


def test_a_set_without_a_value_is_explained(pages):
    result = pages["fit"][0]
    name, sets = next(iter(result.fit.sets.items()))
    empty = {name: replace(sets, anderson_rubin=ConfidenceSet(()))}
    page = flight_page(replace(result, fit=replace(result.fit, sets=empty)))
    assert "empty: the instruments contradict each other at every value" in page


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
    image = drawing(picture.drawn, "p", picture.height).removeprefix(IMAGE)
    svg = parsed("<svg" + base64.b64decode(image).decode().partition("<svg")[2])
    texts = [item.text for item in svg.all("text")]
    ticks = [float(text.replace("−", "-")) for text in texts[: texts.index("K [1/s]")]]
    assert min(ticks) >= -1.0
    assert max(ticks) <= 4.0
    assert [text for text in texts if text in {row.numbers for row in rows}] == [row.numbers for row in rows]
    assert texts[-2].endswith("…")
    assert len(texts[-2]) < 60
    made = []
    drawing(lambda axes: (draw_forest(axes, rows, "K"), made.append(axes)), "p", 3.0)
    points = [line for line in made[0].lines if line.get_marker() in {"o", "x", "D"}]
    assert [line.get_marker() for line in points] == ["o", "o", "x", "D"]
    arrows = [line.get_marker() for line in made[0].lines if line.get_marker() in {"<", ">"}]
    assert arrows == ["<", ">", "<", ">"]


@pytest.mark.parametrize("values", [np.full(5, np.nan), np.full(5, 1800.0), np.array([3.0])])
def test_a_series_without_a_range_is_packed_too(values):
    _, back = unpacked(pack(chart(0.01 * np.arange(values.size), values), 1000))
    np.testing.assert_array_equal(back, values)


def test_text_and_attributes_are_escaped():
    made = table(["name"], [[Cell("<i>&amp;\u202e", link='"><b>')]])
    document = Document("", "", (Section("", (made,)),))
    page = rendered("fleet.html", title="", motions=[(document, "", {})])
    assert '<a href="&#34;&gt;&lt;b&gt;">&lt;i&gt;&amp;amp;\\u202e</a>' in page
