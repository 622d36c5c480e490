"""Take the pictures of docs/report.md: the page of `eivor serve` with parts of the example flight.

    python docs/serve_pictures.py

Needs Chromium, and Playwright out of `pip install -e ".[browser]"`.
"""

from __future__ import annotations

import io
import tempfile
from importlib import resources
from pathlib import Path
from typing import Any

import polars as pl
from PIL import Image
from playwright.sync_api import sync_playwright
from report_pictures import launched

from eivor.serve.app import Server

IMAGES = Path(__file__).parent / "images" / "serve"
#: Colours of a picture: more are not seen, and make it large.
COLOURS = 96
#: Parts of the example flight, in seconds.
PARTS = {"flight.parquet": (0.0, 60.0), "first.parquet": (0.0, 30.0), "second.parquet": (30.0, 60.0)}
SECOND = 1000


def main() -> None:
    """Write every picture."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    server = Server()
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        cut_flights(Path(folder))
        browser = launched(driver)
        for theme, ending in (("light", ""), ("dark", "-dark")):
            wide = window(browser, server.url, theme, (1000, 620))
            take(wide, f"drop{ending}")
            drop(wide, Path(folder), "flight.parquet")
            top(wide, "#flights")
            take(wide, f"verdict{ending}", height=900)
            wide.locator(".downloads > summary").click()
            wide.get_by_label("Mass [kg]").fill("1.53:0.02")
            wide.get_by_label("Mass [kg]").press("Tab")
            wide.locator(".files .why:not(:empty)").first.wait_for(timeout=60 * SECOND)
            top(wide, ".downloads")
            take(wide, f"downloads{ending}", height=860)
            phone = window(browser, server.url, theme, (390, 800))
            drop(phone, Path(folder), "flight.parquet")
            top(phone, "#result")
            take(phone, f"phone{ending}")
            several = window(browser, server.url, theme, (1000, 900))
            drop(several, Path(folder), "first.parquet", "second.parquet")
            several.locator("#pool").click()
            finished(several, 3)
            top(several, "#flights")
            take(several, f"compared{ending}", height=1060)
        browser.close()
    server.close()


def cut_flights(folder: Path) -> None:
    """Write the parts of the example flight."""
    with resources.as_file(resources.files("eivor.data").joinpath("example_flight.parquet")) as whole:
        flight = pl.read_parquet(whole)
    for name, (start, end) in PARTS.items():
        flight.filter(pl.col("time").is_between(start, end, closed="left")).write_parquet(folder / name)


def window(browser: Any, url: str, theme: str, size: tuple[int, int]) -> Any:
    """Open the page."""
    width, height = size
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=theme)
    page = context.new_page()
    page.goto(url)
    return page


def drop(page: Any, folder: Path, *names: str) -> None:
    """Drop logs and wait for their verdicts."""
    page.set_input_files("#files", [folder / name for name in names])
    finished(page, len(names))


def finished(page: Any, count: int) -> None:
    """Wait until so many flights have a result."""
    page.locator('[data-state="done"]').nth(count - 1).wait_for(timeout=120 * SECOND)
    page.wait_for_timeout(SECOND)


def top(page: Any, selector: str) -> None:
    """Bring a part of the page to the top of the window."""
    page.locator(selector).first.evaluate(
        "(one) => scrollTo(0, one.getBoundingClientRect().top + scrollY - 24)"
    )
    page.wait_for_timeout(SECOND // 2)


def take(page: Any, name: str, height: int | None = None) -> None:
    """Take a picture of the window, when it has so many pixels of height."""
    if height is not None:
        width = page.viewport_size["width"]
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_timeout(SECOND // 2)
    picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    picture.quantize(COLOURS, dither=Image.Dither.NONE).save(IMAGES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
