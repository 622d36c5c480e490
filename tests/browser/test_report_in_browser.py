"""The page of a result in a real browser, from a file and without a network."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import resources
from pathlib import Path

import pytest

from coarse_search import coarse
from eivor.flights.options import FlightOptions
from eivor.flights.result import FlightEstimate
from eivor.inference.verdict import Reason, Status, Verdict
from eivor.logs.read import example_flight
from eivor.motions.identify import identify_flight
from eivor.report.flight_page import flight_page

pytestmark = pytest.mark.thorough

LOOKS = (Path(__file__).parent / "looks.js").read_text(encoding="utf-8")
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\u202e\u2066" + 10_000 * "W"
PLOTTED = ".charts .shown"
UNFOLD = "document.querySelectorAll('details').forEach((one) => { one.open = true; })"
KINDS = ("fit", "pool", "refused", "hostile")


@pytest.fixture(scope="module")
def fit() -> FlightEstimate:
    with coarse():
        return identify_flight(example_flight(), FlightOptions(window=(10.0, 50.0)))


@pytest.fixture(scope="module")
def pages(fit: FlightEstimate) -> dict[str, str]:
    log = fit.prepared[0].recording
    flights = [replace(log, name=name, sha256=name) for name in ("first", f"second-{60 * 'long'}")]
    with coarse():
        pool = identify_flight(flights, FlightOptions(compare=True), windows=[(0.0, 20.0), (20.0, 40.0)])
    reasons = (Reason(Status.REFUSED, f"It says {HOSTILE}.", f"Do {HOSTILE}."),)
    flight = replace(fit.prepared[0], recording=replace(log, name=HOSTILE, format=HOSTILE))
    refused = replace(fit, fit=None, verdict=Verdict(Status.REFUSED, reasons[:1]))
    results = {
        "fit": fit,
        "pool": pool,
        "refused": replace(
            refused, verdict=Verdict(Status.REFUSED, (Reason(Status.REFUSED, "It is still."),))
        ),
        "hostile": replace(fit, prepared=(flight,), verdict=Verdict(Status.REFUSED, reasons)),
    }
    return {name: flight_page(result) for name, result in results.items()}


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_legible_and_asks_for_nothing(opened, pages, kind):
    page = opened(pages[kind], width=360)
    assert page.evaluate(LOOKS) == []
    page.evaluate(UNFOLD)
    for width in (360, 768, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        page.wait_for_timeout(100)
        assert page.evaluate(LOOKS) == [], width
    assert [url for url in page.asked if not url.startswith(("file:", "data:,"))] == []
    assert sum(url.startswith("file:") for url in page.asked) == 1
    assert page.said == []
    assert page.evaluate("broken") == []


def test_the_policy_holds(opened, pages):
    page = opened(pages["fit"])
    page.evaluate(
        "document.body.append(Object.assign(document.createElement('img'), {src: 'https://eivor.invalid/'}))"
    )
    page.wait_for_function("broken.length > 0")
    assert page.evaluate("broken") == ["img-src"]
    with pytest.raises(Exception, match="TrustedHTML"):
        page.evaluate("document.body.innerHTML = '<b>no</b>'")


def test_it_zooms_by_pointer_keys_and_buttons(opened, pages):
    page = opened(pages["fit"])
    locator = page.locator(PLOTTED)
    text_content = locator.text_content()
    assert text_content == "8.4 s to 51.6 s"
    chart = page.locator(".chart .u-over").first
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    middle = box["y"] + 0.5 * box["height"]
    page.mouse.move(box["x"] + 0.25 * box["width"], middle)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.5 * box["width"], middle, steps=5)
    page.mouse.up()
    first, last = seconds(locator.text_content())
    assert first == pytest.approx(8.4 + 0.25 * 43.2, abs=0.3)
    assert last == pytest.approx(8.4 + 0.5 * 43.2, abs=0.3)
    assert page.locator(".legend output").first.text_content().endswith("m/s²")
    chart.dblclick()
    assert locator.text_content() == text_content
    page.locator(".chart").nth(1).focus()
    page.keyboard.press("+")
    assert seconds(locator.text_content()) == pytest.approx((19.2, 40.8), abs=0.11)
    page.keyboard.press("ArrowRight")
    assert seconds(locator.text_content()) == pytest.approx((24.6, 46.2), abs=0.11)
    page.keyboard.press("0")
    assert seconds(locator.text_content()) == pytest.approx((0.0, 60.0), abs=0.11)
    page.get_by_role("button", name="Show what is used").click()
    assert locator.text_content() == text_content


def seconds(text: str) -> tuple[float, ...]:
    return tuple(float(item.removesuffix(" s")) for item in text.split(" to "))


def test_what_a_log_says_stays_text(opened, pages):
    page = opened(pages["hostile"])
    assert "<script>alert(1)</script>" in page.locator("h1").text_content()
    assert page.locator("img").count() == 0
    assert page.evaluate("JSON.parse(document.getElementById('result').textContent).logs[0].name") == HOSTILE
    assert page.said == []


def test_the_theme_changes_and_paper_is_light(opened, pages):
    page = opened(pages["fit"], scheme="dark")
    paper = "getComputedStyle(document.body).backgroundColor"
    dark = page.evaluate(paper)
    page.locator("#theme").click()
    assert page.evaluate(paper) != dark
    page.locator("#theme").click()
    assert page.evaluate(paper) == dark
    page.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert page.evaluate(paper) != dark
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert page.evaluate(paper) == dark


def test_it_saves_its_numbers(opened, pages, fit, tmp_path):
    page = opened(pages["fit"])
    with page.expect_download() as saved:
        page.locator("#save").click()
    saved.value.save_as(tmp_path / "saved.json")
    assert json.loads((tmp_path / "saved.json").read_text()) == json.loads(fit.to_json())


@pytest.mark.parametrize(
    ("kind", "scheme", "rules"),
    [("pool", "light", "{}"), ("refused", "dark", "{runOnly: ['color-contrast']}")],
)
def test_nothing_serious_stands_in_anybodys_way(opened, pages, kind, scheme, rules):
    axe = resources.files(pytest.importorskip("axe_playwright_python")).joinpath("axe.min.js")
    page = opened(pages[kind], scheme=scheme)
    page.evaluate(UNFOLD)
    page.evaluate(axe.read_text(encoding="utf-8"))
    evaluate = page.evaluate(f"axe.run(document, {rules}).then((done) => done.violations)")
    selected = [
        (item["id"], item["nodes"][0]["html"])
        for item in evaluate
        if item["impact"] in {"serious", "critical"}
    ]
    assert selected == []
