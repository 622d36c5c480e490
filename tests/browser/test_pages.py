"""Built documentation and reports in a browser, without a network."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

import eivor as ev
from coarse_search import coarse
from eivor.inference.verdict import Reason, Verdict
from eivor.report.flight_page import flight_page
from validation import frequency_responses as simulated

SITE = os.environ.get("EIVOR_SITE", "")
#: How many equations there are, how many are drawn, and what KaTeX did not understand.
EQUATIONS = """() => {
  const found = [...document.querySelectorAll(".arithmatex")];
  return {
    all: found.length,
    drawn: found.filter((one) => one.querySelector(".katex-html")?.getBoundingClientRect().width > 0).length,
    wrong: [...document.querySelectorAll(".katex-error")].map((one) => one.textContent),
    fonts: found.length === 0 || document.fonts.check("16px KaTeX_Main"),
  };
}"""
#: A word, and a page that is about it.
WORDS = {"Whittle": "efficiency.html", "battery_brownout": "getting-started.html"}


def searched(page, word):
    """Names of the pages that a search finds."""
    page.locator(".md-search__input").fill("")
    page.locator(".md-search__input").press_sequentially(word)
    locator = page.locator(".md-search-result__link", has_text=word)
    locator.first.wait_for(state="attached")
    return {item.get_attribute("href").partition("#")[0].rpartition("/")[2] for item in locator.all()}


def outside(page, origin):
    return [url for url in page.asked if not url.startswith((f"{origin}/", "data:"))]


needs_site = pytest.mark.skipif(not SITE, reason="EIVOR_SITE is to name what mkdocs build --site-dir makes")


@pytest.mark.thorough
@needs_site
def test_every_page_from_disk(watched):
    """Nothing is asked of a network, nothing is missing, and every equation is drawn."""
    page = watched("about:blank", offline=True)
    paths = sorted(path for path in Path(SITE).rglob("*.html") if path.name != "404.html")
    assert len(paths) > 28
    equations = 0
    for path in paths:
        page.goto(path.as_uri())
        page.evaluate("document.fonts.ready")
        seen = page.evaluate(EQUATIONS)
        assert seen == {"all": seen["all"], "drawn": seen["all"], "wrong": [], "fonts": True}, path.name
        equations += seen["all"]
    assert equations > 600
    assert outside(page, f"file://{SITE}") == []
    assert page.said == []


@pytest.mark.thorough
@needs_site
def test_search_from_disk(watched):
    page = watched("about:blank", offline=True)
    page.goto((Path(SITE) / "studies" / "coverage.html").as_uri())
    for word, about in WORDS.items():
        assert about in searched(page, word), word
    page.locator(".md-search-result__link").first.click()
    page.wait_for_url("file://**/*.html*")
    assert page.url.partition("?")[0] != (Path(SITE) / "studies" / "coverage.html").as_uri()
    assert outside(page, f"file://{SITE}") == []
    assert page.said == []


LOOKS = (Path(__file__).parent / "looks.js").read_text(encoding="utf-8")
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\u202e\u2066" + 10_000 * "W"
PLOTTED = ".charts .shown"
UNFOLD = "document.querySelectorAll('details').forEach((one) => { one.open = true; })"
KINDS = ("fit", "pool", "refused", "hostile", "turning")


@pytest.fixture(scope="module")
def fit():
    with coarse():
        return ev.identify_flight(ev.example_flight(), ev.FlightOptions(window=(10.0, 50.0)))


@pytest.fixture(scope="module")
def pages(fit):
    log = fit.prepared[0].recording
    flights = [replace(log, name=name, sha256=name) for name in ("first", f"second-{60 * 'long'}")]
    with coarse():
        pool = ev.identify_flight(
            flights, ev.FlightOptions(compare=True), windows=[(0.0, 20.0), (20.0, 40.0)]
        )
    reasons = (Reason(ev.Status.REFUSED, f"It says {HOSTILE}.", f"Do {HOSTILE}."),)
    flight = replace(fit.prepared[0], recording=replace(log, name=HOSTILE, format=HOSTILE))
    refused = replace(fit, fit=None, verdict=Verdict(ev.Status.REFUSED, reasons[:1]))
    _, r, u, y = simulated.flights(2, "chirp", 2.0, 1, 0, 30.0)
    columns = {"torque_setpoint_x": u[:, 0], "angular_rate_x": y[:, 0], "injected_torque_x": r[:, 0]}
    sweep = ev.recording_from_columns({"time": simulated.STEP_S * np.arange(len(u)), **columns}, name="sweep")
    results = {
        "fit": fit,
        "turning": ev.identify_flight(sweep, model="rates"),
        "pool": pool,
        "refused": replace(
            refused, verdict=Verdict(ev.Status.REFUSED, (Reason(ev.Status.REFUSED, "It is still."),))
        ),
        "hostile": replace(fit, prepared=(flight,), verdict=Verdict(ev.Status.REFUSED, reasons)),
    }
    return {name: flight_page(result) for name, result in results.items()}


@pytest.mark.thorough
@pytest.mark.parametrize("kind", KINDS)
def test_it_is_legible_and_asks_for_nothing(opened, pages, kind):
    page = opened(pages[kind], width=390)
    assert page.evaluate(LOOKS) == []
    page.evaluate(UNFOLD)
    for width in (360, 390, 768, 1280):
        page.set_viewport_size({"width": width, "height": 900})
        page.wait_for_timeout(100)
        assert page.evaluate(LOOKS) == [], width
    assert [url for url in page.asked if not url.startswith(("file:", "data:,"))] == []
    assert sum(url.startswith("file:") for url in page.asked) == 1
    assert (page.said, page.evaluate("broken")) == ([], [])


@pytest.mark.thorough
def test_the_policy_holds(opened, pages):
    page = opened(pages["fit"])
    page.evaluate(
        "document.body.append(Object.assign(document.createElement('img'), {src: 'https://eivor.invalid/'}))"
    )
    page.wait_for_function("broken.length > 0")
    assert page.evaluate("broken") == ["img-src"]
    with pytest.raises(Exception, match="TrustedHTML"):
        page.evaluate("document.body.innerHTML = '<b>no</b>'")


@pytest.mark.thorough
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
    first, last = ends(locator.text_content())
    assert first == pytest.approx(8.4 + 0.25 * 43.2, abs=0.3)
    assert last == pytest.approx(8.4 + 0.5 * 43.2, abs=0.3)
    assert page.locator(".legend output").first.text_content().endswith("m/s²")
    chart.dblclick()
    assert locator.text_content() == text_content
    page.locator(".chart").nth(1).focus()
    page.keyboard.press("+")
    assert ends(locator.text_content()) == pytest.approx((19.2, 40.8), abs=0.11)
    page.keyboard.press("ArrowRight")
    assert ends(locator.text_content()) == pytest.approx((24.6, 46.2), abs=0.11)
    page.keyboard.press("0")
    assert ends(locator.text_content()) == pytest.approx((0.0, 60.0), abs=0.11)
    page.get_by_role("button", name="Show what is used").click()
    assert locator.text_content() == text_content


@pytest.mark.thorough
def test_responses_zoom_over_frequency(opened, pages):
    page = opened(pages["turning"])
    charts = page.locator(".charts[data-group=response-roll]")
    charts.locator(".chart").first.focus()
    page.keyboard.press("0")
    low, high = ends(charts.locator(".shown").text_content(), "Hz")
    page.keyboard.press("+")
    zoomed = ends(charts.locator(".shown").text_content(), "Hz")
    assert zoomed == pytest.approx((low**0.75 * high**0.25, low**0.25 * high**0.75), rel=0.01)


def ends(text, unit="s"):
    return tuple(float(item.removesuffix(f" {unit}")) for item in text.split(" to "))


@pytest.mark.thorough
def test_what_a_log_says_stays_text(opened, pages):
    page = opened(pages["hostile"])
    assert "<script>alert(1)</script>" in page.locator("h1").text_content()
    assert page.locator("img").count() == page.locator("img.drawn").count()
    assert page.evaluate("JSON.parse(document.getElementById('result').textContent).logs[0].name") == HOSTILE
    assert page.said == []


@pytest.mark.thorough
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


@pytest.mark.thorough
def test_it_saves_its_numbers(opened, pages, fit, tmp_path):
    page = opened(pages["fit"])
    with page.expect_download() as saved:
        page.locator("#save").click()
    saved.value.save_as(tmp_path / "saved.json")
    assert json.loads((tmp_path / "saved.json").read_text()) == json.loads(fit.to_json())


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("kind", "scheme", "rules"),
    [("pool", "light", "{}"), ("refused", "dark", "{runOnly: ['color-contrast']}")],
)
def test_nothing_stands_in_anybodys_way(opened, pages, kind, scheme, rules):
    axe = resources.files(pytest.importorskip("axe_playwright_python")).joinpath("axe.min.js")
    page = opened(pages[kind], scheme=scheme)
    page.evaluate(UNFOLD)
    page.evaluate(axe.read_text(encoding="utf-8"))
    evaluate = page.evaluate(f"axe.run(document, {rules}).then((done) => done.violations)")
    assert [(item["id"], item["nodes"][0]["html"]) for item in evaluate] == []
