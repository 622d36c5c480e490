"""The page of the documentation that shows every mutant and what noticed it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from eivor.lab.experiments import markdown, page_with

if TYPE_CHECKING:
    from validation.mutation.check import Outcome

#: The part of the page that is generated.
PART = "mutants"


def write_page(path: Path, outcomes: Sequence[Outcome]) -> None:
    """Put the tables between the marks of a page."""
    text = path.read_text(encoding="utf-8")
    path.write_text(page_with(text, {PART: "\n\n".join(parts(outcomes))}), encoding="utf-8")


def parts(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """How many were noticed, and a table for each area."""
    noticed = sum(outcome.noticed for outcome in outcomes)
    yield f"{noticed} of {len(outcomes)} swapped lines were noticed."
    areas = list(dict.fromkeys(outcome.mutant.area for outcome in outcomes))
    for area in areas:
        here = [outcome for outcome in outcomes if outcome.mutant.area == area]
        yield f"## {area.capitalize()}"
        yield markdown(("what the swap does", "line", "becomes", "noticed by"), map(_row, here))


def _row(outcome: Outcome) -> tuple[str, ...]:
    mutant = outcome.mutant
    tests = (test.removeprefix("tests/") for test in mutant.tests)
    by = f"{outcome.failed} of " if outcome.noticed else "**not by** "
    where = mutant.file.removeprefix("src/eivor/")
    return (
        f"{_plain(mutant.what)}<br>`{where}`",
        _code(mutant.line),
        _code(mutant.replacement),
        by + "<br>".join(_codes(tests)),
    )


def _plain(text: str) -> str:
    return text.replace("|", "\\|")


def _code(text: str) -> str:
    return f"`{text}`".replace("|", "\\|")


def _codes(texts: Iterable[str]) -> Iterator[str]:
    return map(_code, texts)
