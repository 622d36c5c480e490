"""Take the pictures of docs/getting-started.md, of its public logs.

    python docs/tutorial_pictures.py

Fetches the logs once. Needs Chromium, and Playwright out of `pip install -e ".[browser]"`.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import pooch
from playwright.sync_api import sync_playwright
from report_pictures import launched, take

import eivor as ev
from eivor.cli.tools import local_file, public_logs
from eivor.report.flight_page import flight_page

IMAGES = Path(__file__).parent / "images" / "tutorial"


def main() -> None:
    """Write every picture."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    hover = ev.identify_log(public_log("battery_brownout"))
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        page = Path(folder) / "hover.html"
        page.write_text(flight_page(hover), encoding="utf-8")
        browser = launched(driver)
        take(browser, page, IMAGES / "report.png", "light", 1000, 900, "header")
        browser.close()
    given = ev.FlightOptions(lag=ev.Prior(0.065, 0.015))
    trefoil = ev.identify_flight(public_log("B9_trefoil_fast_rep14"), given)
    validate = ev.validate(trefoil, public_log("B9_trefoil_slow_rep13"))
    validate.plot().savefig(IMAGES / "slow.png", dpi=100)


def public_log(name: str) -> ev.Recording:
    """Read one of the public logs."""
    return ev.read_log(local_file(public_logs()[name], folder=Path(pooch.os_cache("eivor"))))


if __name__ == "__main__":
    main()
