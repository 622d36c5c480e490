"""What pooling does where the truth is known, and the command that finds out how well it does.

    python -m validation.pooling.study --kept FILE.jsonl [--size small|full] [--page docs/studies/coverage.md]

draws the grid beside this file, keeps every cell in the file, and prints its table: coverage of a vehicle's
mean, of its next flight, and of the heterogeneity, nominal 95 %. The exit code is 0 when every requirement is
met, 3 when one is not, 2 for an input of no use.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from eivor.lab.experiments import markdown
from eivor.strict_toml import read_toml
from validation.kept_study import Answer, KeptStudyCommand, keep, kept_lines
from validation.pooling.trials import SEED, Told, cell
from validation.requirement import Requirement
from validation.suites import versions

PART = "pooling"
GRID = Path(__file__).with_name("grid.toml")
#: Asked: coverage of the mean at least; at most where the heterogeneity exceeds the mean standard error; and
#: of the next flight at least.
MEAN, NOT_ABOVE, FOLLOWING = 0.93, 0.98, 0.90
HEADER = (
    "flights",
    "heterogeneity",
    "mean",
    "Hartung-Knapp alone",
    "fixed effect",
    "DerSimonian-Laird",
    "next flight",
    "plain, t of n - 2",
    "its length over the plain one's",
    "heterogeneity's interval",
)


def answer(grid: Path, size: str, kept: Path) -> Answer:
    """Draw what the file does not have yet, and judge all of it."""
    selected = {
        (kept_line.flights, kept_line.heterogeneity, kept_line.replications): kept_line
        for kept_line in kept_lines(kept, Told)
    }
    results = []
    for flights, heterogeneity, replications, std_errors in _parsed(grid, size):
        key = (flights, heterogeneity, replications)
        if key not in selected:
            selected[key] = cell(flights, heterogeneity, replications, std_errors)
            keep(kept, [selected[key]])
        results.append(selected[key])
    requirements = tuple(_requirements(results))
    return _tables(results, requirements), requirements


def _parsed(grid: Path, size: str) -> Iterator[tuple[int, float, int, tuple[float, float]]]:
    root = read_toml(grid, "grid of cells")
    replications = {name: root.whole(name) for name in ("small", "full")}[size]
    low, high = root.numbers("std_errors")
    flights, heterogeneity = root.numbers("flights"), root.numbers("heterogeneity")
    root.finish()
    for count in flights:
        for between in heterogeneity:
            yield int(count), between, replications, (low, high)


def _requirements(tolds: list[Told]) -> Iterator[Requirement]:
    clear = [item.mean for item in tolds if item.heterogeneity > item.std_error]
    for what, entry, measured, met in (
        ("coverage of the mean in every cell", f"at least {MEAN:g}", min(item.mean for item in tolds), MEAN),
        (
            "coverage of the next flight in every cell",
            f"at least {FOLLOWING:g}",
            min(item.following for item in tolds),
            FOLLOWING,
        ),
    ):
        yield Requirement(what, entry, f"{measured:.3f}", measured >= met)
    if clear:
        yield Requirement(
            "coverage of the mean where the heterogeneity exceeds the mean standard error",
            f"at most {NOT_ABOVE:g}",
            f"{max(clear):.3f}",
            max(clear) <= NOT_ABOVE,
        )


def _tables(tolds: list[Told], requirements: tuple[Requirement, ...]) -> str:
    requested = [
        (requirement.what, requirement.asked, requirement.measured, "yes" if requirement.met else "no")
        for requirement in requirements
    ]
    return "\n\n".join(
        (
            f"Made by `python -m validation.pooling.study` with {versions()}: {tolds[0].replications:,} "
            f"vehicles in each cell, seed {SEED}.",
            markdown(("what", "asked", "measured", "met"), requested),
            markdown(HEADER, map(_line, tolds)),
        )
    )


def _line(first: Told) -> tuple[str, ...]:
    shares = (first.mean, first.knapp, first.fixed, first.moments, first.following, first.plain)
    return (
        f"{first.flights}",
        f"{first.heterogeneity:g}",
        *(f"{share:.3f}" for share in shares),
        f"{first.wider:.2f}",
        f"{first.spread:.3f}",
    )


COMMAND = KeptStudyCommand("validation.pooling.study", __doc__, GRID, PART, answer)
main = COMMAND.main


if __name__ == "__main__":
    sys.exit(main())
