"""The picture in the README is the one that the code draws."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "examples" / "draw_example.py"
PICTURE = ROOT / "docs" / "images" / "example.png"
#: Squares whose mean grey is compared [pixels], and how far it may be off, of 255. Letters that are drawn
#: a pixel further on change it by 20 at most, a legend or a curve at another place by 50 and more.
SQUARE, TOLERANCE = 10, 30.0


def squares(path: Path) -> np.ndarray:
    grey = np.asarray(Image.open(path).convert("L"), dtype=float)
    height, width = (size // SQUARE for size in grey.shape)
    whole = grey[: height * SQUARE, : width * SQUARE]
    return whole.reshape(height, SQUARE, width, SQUARE).mean(axis=(1, 3))


@pytest.mark.thorough
def test_the_picture_is_what_is_drawn(tmp_path):
    runpy.run_path(str(SCRIPT))["main"](tmp_path)
    drawn, displayed = squares(tmp_path / "example.png"), squares(PICTURE)
    assert drawn.shape == displayed.shape
    assert np.abs(drawn - displayed).max() <= TOLERANCE, f"run {SCRIPT.relative_to(ROOT)}"


def test_what_the_pages_say_of_it():
    text = " ".join((ROOT / "docs" / "getting-started.md").read_text(encoding="utf-8").split())
    assert (
        "The figure has five panels: measured against predicted response, the residual, its autocorrelation, "
        "the profile of the lag, and what the flight excited." in text
    )
