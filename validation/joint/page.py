"""The study as Markdown tables, and what is asked of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from eivor.inference.verdict import Status
from eivor.lab.experiments import markdown
from eivor.lab.study import Share
from validation.joint.trials import ALONE, GIVEN, JOINT, LOST, TURNING, Told
from validation.requirement import Requirement

#: Name of the generated part of the page.
PART = "joint"
#: What the interval of the coverage must meet, and its confidence level.
COVERAGE, LEVEL = (0.92, 0.98), 0.99


def requirements(tolds: Sequence[Told]) -> Iterator[Requirement]:
    """What is asked, held against a run."""
    by = {formula: [item for item in tolds if item.formula == formula] for formula in (JOINT, GIVEN)}
    joint, given = (sum(item.accepted for item in by[formula]) for formula in (JOINT, GIVEN))
    yield Requirement(
        "flights whose K is identified",
        f"at least {given}, as with the lag given",
        f"{joint}",
        joint >= given,
    )
    ratio = float(np.median(_lengths(tolds, JOINT)))
    yield Requirement(
        "length of K's interval over that with the lag given, median",
        "at most 1",
        f"{ratio:.2f}",
        ratio <= 1.0,
    )
    covered = _coverage(by[JOINT])
    low, high = covered.interval
    yield Requirement(
        "coverage of K where it is identified",
        f"99 % interval meets {COVERAGE[0]} to {COVERAGE[1]}",
        _share(covered),
        low <= COVERAGE[1] and high >= COVERAGE[0],
    )


def tables(tolds: Sequence[Told]) -> str:
    """What is asked, and each way beside the others."""
    requested = [
        (requirement.what, requirement.asked, requirement.measured, "yes" if requirement.met else "no")
        for requirement in requirements(tolds)
    ]
    names = dict.fromkeys(item.flight for item in tolds)
    header = (
        "",
        "K identified",
        "flight identified",
        "length over lag given",
        "median size of error",
        "coverage",
    )
    rows = [(formula, *_cells(tolds, formula)) for formula in (JOINT, GIVEN, TURNING, ALONE)]
    lost = len({item.flight for item in tolds if item.verdict == LOST})
    return "\n\n".join(
        (
            f"Made by `python -m validation.joint.study` of {len(names)} flights, of which {lost} were lost.",
            markdown(("K in gusts, attitude and height excited", "asked", "measured", "met"), requested),
            markdown(header, rows),
        )
    )


def _cells(tolds: Sequence[Told], formula: str) -> tuple[str, ...]:
    selected = [item for item in tolds if item.formula == formula]
    errors = [abs(item.value / item.truth - 1.0) for item in selected if np.isfinite(item.length)]
    flights = sum(item.of_flight == Status.IDENTIFIED.value for item in selected)
    return (
        f"{sum(item.accepted for item in selected)} of {len(selected)}",
        f"{flights} of {len(selected)}",
        f"{float(np.median(_lengths(tolds, formula))):.2f}",
        f"{float(np.median(errors)):.1%}".replace("%", " %"),
        _share(_coverage(selected)),
    )


def _lengths(tolds: Sequence[Told], formula: str) -> list[float]:
    """Length of K's interval over that with the lag given, of every flight that has both."""
    given = {item.flight: item.length for item in tolds if item.formula == GIVEN}
    return [
        item.length / given[item.flight]
        for item in tolds
        if item.formula == formula and np.isfinite(item.length) and np.isfinite(given[item.flight])
    ]


def _coverage(tolds: Sequence[Told]) -> Share:
    held = [item.held for item in tolds if item.accepted]
    return Share(sum(held), len(held), LEVEL)


def _share(share: Share) -> str:
    low, high = share.interval
    return f"{share.value:.2f} [{low:.2f}, {high:.2f}] of {share.count}"
