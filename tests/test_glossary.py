"""The glossary lists what is public, and words that the code has."""

from __future__ import annotations

import re
from pathlib import Path

import eivor

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")


def test_every_public_name_is_listed_once():
    public = {name for name in eivor.__all__ if not name.startswith("__")}
    listed = re.findall(r"^\| `(\w+)` \| (?:class|function|module) \|", PAGE, flags=re.MULTILINE)
    assert sorted(listed) == sorted(public), "run docs/public_names.py"


def test_words_in_code_are_words_of_the_code():
    rows = [line.split(" | ") for line in PAGE.partition("## Words")[2].splitlines() if line.startswith("| ")]
    words = {word for row in rows for word in re.findall(r"`(\w+)`", row[1])}
    code = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "src").rglob("*.py"))
    assert len(words) > 30
    assert [word for word in sorted(words) if not re.search(rf"\b{word}\b", code)] == []


def test_every_word_is_explained_once():
    first = re.findall(
        r"^\| ([^|]+) \| [^|]* \| [^|]* \| [^|]* \|$", PAGE.partition("## Words")[2], re.MULTILINE
    )
    terms = [term.strip() for cell in first[2:] for term in cell.split(",")]
    assert len(terms) == len(set(terms))
