"""What pooling does where the truth is known, and the command that finds out how well it does.

    python -m validation.pooling.study --kept FILE.jsonl [--size small|full] [--page docs/studies/pooling.md]

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
    told = {(one.flights, one.heterogeneity, one.replications): one for one in kept_lines(kept, Told)}
    found = []
    for flights, heterogeneity, replications, std_errors in _asked(grid, size):
        key = (flights, heterogeneity, replications)
        if key not in told:
            told[key] = cell(flights, heterogeneity, replications, std_errors)
            keep(kept, [told[key]])
        found.append(told[key])
    requirements = tuple(_requirements(found))
    return _tables(found, requirements), requirements


def _asked(grid: Path, size: str) -> Iterator[tuple[int, float, int, tuple[float, float]]]:
    root = read_toml(grid, "grid of cells")
    replications = {name: root.whole(name) for name in ("small", "full")}[size]
    low, high = root.numbers("std_errors")
    flights, heterogeneity = root.numbers("flights"), root.numbers("heterogeneity")
    root.finish()
    for count in flights:
        for between in heterogeneity:
            yield int(count), between, replications, (low, high)


def _requirements(found: list[Told]) -> Iterator[Requirement]:
    clear = [one.mean for one in found if one.heterogeneity > one.std_error]
    for what, asked, measured, met in (
        ("coverage of the mean in every cell", f"at least {MEAN:g}", min(one.mean for one in found), MEAN),
        (
            "coverage of the next flight in every cell",
            f"at least {FOLLOWING:g}",
            min(one.following for one in found),
            FOLLOWING,
        ),
    ):
        yield Requirement(what, asked, f"{measured:.3f}", measured >= met)
    if clear:
        yield Requirement(
            "coverage of the mean where the heterogeneity exceeds the mean standard error",
            f"at most {NOT_ABOVE:g}",
            f"{max(clear):.3f}",
            max(clear) <= NOT_ABOVE,
        )


def _tables(found: list[Told], requirements: tuple[Requirement, ...]) -> str:
    asked = [(one.what, one.asked, one.measured, "yes" if one.met else "no") for one in requirements]
    return "\n\n".join(
        (
            f"Made by `python -m validation.pooling.study` with {versions()}: {found[0].replications:,} "
            f"vehicles in each cell, seed {SEED}.",
            markdown(("what", "asked", "measured", "met"), asked),
            markdown(HEADER, map(_line, found)),
        )
    )


def _line(one: Told) -> tuple[str, ...]:
    shares = (one.mean, one.knapp, one.fixed, one.moments, one.following, one.plain)
    return (
        f"{one.flights}",
        f"{one.heterogeneity:g}",
        *(f"{share:.3f}" for share in shares),
        f"{one.wider:.2f}",
        f"{one.spread:.3f}",
    )


COMMAND = KeptStudyCommand("validation.pooling.study", __doc__, GRID, PART, answer)
main = COMMAND.main


if __name__ == "__main__":
    sys.exit(main())
