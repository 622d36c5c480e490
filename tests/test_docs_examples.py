"""The Python blocks of the documentation's pages run as they stand, page by page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

PAGES = sorted((Path(__file__).parents[1] / "docs").rglob("*.md"))
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
RUN = [page for page in PAGES if page.name in {"estimators.md", "weak-identification.md"}]


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.parametrize("page", RUN, ids=lambda page: page.name)
def test_blocks_run(page):
    blocks = BLOCK.findall(page.read_text(encoding="utf-8"))
    assert blocks
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, page.name, "exec"), names)  # noqa: S102 - the project's own pages
    if page.name == "weak-identification.md":
        assert all(found.is_bounded for found in names["known"].intervals.values())
        assert not names["unknown"].interval("input_gain").is_bounded
        assert names["sets"].region.contains([0.3, 0.5])
        return
    assert CHECKS[page.name](names)
