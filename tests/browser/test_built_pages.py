"""The documentation as it was built, opened from disk and from a server of this machine, without a network.

`.ci/run` builds it once and names its folder in EIVOR_SITE.
"""

from __future__ import annotations

import os
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from browser.conftest import PATIENCE_MS

SITE = os.environ.get("EIVOR_SITE", "")
pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(
        not SITE, reason="EIVOR_SITE names no documentation: mkdocs build --site-dir FOLDER makes it"
    ),
]
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


@pytest.fixture
def watched(chromium):
    """Open a page, and keep what it asks for and says; offline, but for a server of this machine."""
    contexts = []

    def opening(*, offline):
        context = chromium.new_context(offline=offline, viewport={"width": 1440, "height": 900})
        context.set_default_timeout(PATIENCE_MS)
        contexts.append(context)
        page = context.new_page()
        page.asked, page.said = [], []
        page.on("request", lambda request: page.asked.append(request.url))
        page.on("console", lambda message: page.said.append(message.text))
        page.on("pageerror", lambda error: page.said.append(str(error)))
        return page

    yield opening
    for context in contexts:
        context.close()


@pytest.fixture
def served():
    """Address of a server of the pages."""
    handler = partial(QuietHandler, directory=SITE)
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()


class QuietHandler(SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


def outside(page, origin):
    return [url for url in page.asked if not url.startswith((f"{origin}/", "data:"))]


def test_every_page_from_disk(watched):
    """Nothing is asked of a network, nothing is missing, and every equation is drawn."""
    page = watched(offline=True)
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


def test_search_from_disk(watched):
    page = watched(offline=True)
    page.goto((Path(SITE) / "studies" / "coverage.html").as_uri())
    for word, about in WORDS.items():
        assert about in searched(page, word), word
    page.locator(".md-search-result__link").first.click()
    page.wait_for_url("file://**/*.html*")
    assert page.url.partition("?")[0] != (Path(SITE) / "studies" / "coverage.html").as_uri()
    assert outside(page, f"file://{SITE}") == []
    assert page.said == []


def test_search_and_equations_from_a_server(watched, served):
    page = watched(offline=False)
    page.goto(f"{served}/studies/coverage.html")
    seen = page.evaluate(EQUATIONS)
    assert seen["drawn"] == seen["all"] > 0
    assert "efficiency.html" in searched(page, "Whittle")
    assert outside(page, served) == []
    assert page.said == []
