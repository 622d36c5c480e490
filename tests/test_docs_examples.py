"""The Python blocks of the documentation's pages run as they stand, page by page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGES = sorted((Path(__file__).parents[1] / "docs").rglob("*.md"))
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
RUN = [page for page in PAGES if page.name == "estimators.md"]


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.parametrize("page", RUN, ids=lambda page: page.name)
def test_blocks_run(page):
    blocks = BLOCK.findall(page.read_text(encoding="utf-8"))
    assert blocks
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, page.name, "exec"), names)  # noqa: S102 - the project's own pages
    assert set(names["fit"].parameters) == {"viscous_friction", "input_gain"}
    assert names["problem"].instrument_noise_covariance()[0, 1] == pytest.approx(0.0025)
