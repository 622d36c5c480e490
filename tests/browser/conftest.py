"""A browser to look at pages with: Chromium, driven by Playwright; tests are skipped where there is none."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from itertools import count
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
#: Policies that are broken, as the browser tells it.
WATCH = (
    "window.broken = [];"
    "addEventListener('securitypolicyviolation', (event) => broken.push(event.violatedDirective));"
)

#: How long anything is waited for [ms]: a machine that has much else to do makes no page wrong.
PATIENCE_MS = 120_000.0

Opener = Callable[..., Any]


@pytest.fixture(scope="module")
def chromium():
    """The browser, one for all tests of a file.

    Its driver keeps an event loop of this thread while it lives, and tests of other files run loops of their
    own.
    """
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="no Playwright: pip install eivor[browser] runs the tests of pages"
    )
    result = next((path for name in NAMES if (path := shutil.which(name))), None)
    if result is None:
        pytest.skip(f"no browser: none of {', '.join(NAMES)} is installed")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=result, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@pytest.fixture
def watched(chromium):
    """Open a window at an address; what it asks for and says is kept beside it."""
    contexts = []

    def opening(address, *, width=1280, scheme="light", offline=False):
        context = chromium.new_context(
            offline=offline, viewport={"width": width, "height": 900}, color_scheme=scheme
        )
        context.set_default_timeout(PATIENCE_MS)
        contexts.append(context)
        page = context.new_page()
        page.asked, page.said = [], []
        page.on("request", lambda request: page.asked.append(request.url))
        page.on("console", lambda message: page.said.append(message.text))
        page.on("pageerror", lambda error: page.said.append(str(error)))
        page.on("dialog", lambda dialog: (page.said.append(dialog.message), dialog.dismiss()))
        page.add_init_script(WATCH)
        page.goto(address)
        return page

    yield opening
    for context in contexts:
        context.close()


@pytest.fixture
def opened(watched, tmp_path):
    """Open the text of a page from a file, without a network."""
    paths = (tmp_path / f"page-{number}.html" for number in count())

    def opening(text, **look):
        path = next(paths)
        path.write_text(text, encoding="utf-8")
        return watched(path.as_uri(), offline=True, **look)

    return opening
