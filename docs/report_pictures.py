"""Take the pictures of docs/report.md: reports of the example flight in a browser.

    python docs/report_pictures.py

Needs Chromium, and Playwright out of `pip install -e ".[browser]"`.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

from eivor.flights.options import FlightOptions
from eivor.logs.read import example_flight
from eivor.motions.identify import identify_flight
from eivor.report.flight_page import flight_page

IMAGES = Path(__file__).parent / "images" / "report"
#: Name, which result, theme, width and height of the window, and what is at its top.
PICTURES = (
    ("verdict", "whole", "light", 1000, 640, "header"),
    ("verdict-dark", "whole", "dark", 1000, 640, "header"),
    ("charts", "whole", "light", 1000, 760, "#pictures"),
    ("charts-dark", "whole", "dark", 1000, 760, "#pictures"),
    ("fit", "whole", "light", 1000, 880, ".plots"),
    ("fit-dark", "whole", "dark", 1000, 880, ".plots"),
    ("phone", "short", "light", 390, 760, "header"),
    ("phone-dark", "short", "dark", 390, 760, "header"),
)


def main() -> None:
    """Write every picture."""
    log = example_flight()
    results = {
        "whole": identify_flight(log),
        "short": identify_flight(log, FlightOptions(window=(0.0, 6.0))),
    }
    IMAGES.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        for name, result in results.items():
            (Path(folder) / f"{name}.html").write_text(flight_page(result), encoding="utf-8")
        browser = launched(driver)
        for name, result, *look in PICTURES:
            take(browser, Path(folder) / f"{result}.html", IMAGES / f"{name}.png", *look)
        browser.close()


def launched(driver: Any) -> Any:
    """Launch the system's browser."""
    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    return driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])


def take(browser: Any, page: Path, image: Path, theme: str, width: int, height: int, top: str) -> None:
    """Take one picture."""
    context = browser.new_context(
        offline=True, viewport={"width": width, "height": height}, color_scheme=theme
    )
    window = context.new_page()
    window.goto(page.as_uri())
    first = window.locator(top).first.bounding_box()["y"] - 24
    window.screenshot(
        path=image, full_page=True, clip={"x": 0, "y": max(first, 0), "width": width, "height": height}
    )
    context.close()


if __name__ == "__main__":
    main()
