"""The study as Markdown tables, and what is asked of it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from eivor.inference.verdict import Status
from eivor.lab.experiments import markdown
from eivor.lab.study_run import Share
from validation.joint.trials import ALONE, GIVEN, JOINT, LOST, TURNING, Told
from validation.requirement import Requirement

#: Name of the generated part of the page.
PART = "joint"
#: What the interval of the coverage must meet, and its confidence level.
COVERAGE, LEVEL = (0.92, 0.98), 0.99


def requirements(found: Sequence[Told]) -> Iterator[Requirement]:
    """What is asked, held against a run."""
    by = {way: [one for one in found if one.way == way] for way in (JOINT, GIVEN)}
    joint, given = (sum(one.accepted for one in by[way]) for way in (JOINT, GIVEN))
    yield Requirement(
        "flights whose K is identified",
        f"at least {given}, as with the lag given",
        f"{joint}",
        joint >= given,
    )
    ratio = float(np.median(_lengths(found, JOINT)))
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


def tables(found: Sequence[Told]) -> str:
    """What is asked, and each way beside the others."""
    asked = [(one.what, one.asked, one.measured, "yes" if one.met else "no") for one in requirements(found)]
    names = dict.fromkeys(one.flight for one in found)
    header = (
        "",
        "K identified",
        "flight identified",
        "length over lag given",
        "median size of error",
        "coverage",
    )
    rows = [(way, *_cells(found, way)) for way in (JOINT, GIVEN, TURNING, ALONE)]
    lost = len({one.flight for one in found if one.verdict == LOST})
    return "\n\n".join(
        (
            f"Made by `python -m validation.joint.study` of {len(names)} flights, of which {lost} were lost.",
            markdown(("K in gusts, attitude and height excited", "asked", "measured", "met"), asked),
            markdown(header, rows),
        )
    )


def _cells(found: Sequence[Told], way: str) -> tuple[str, ...]:
    own = [one for one in found if one.way == way]
    errors = [abs(one.value / one.truth - 1.0) for one in own if np.isfinite(one.length)]
    flights = sum(one.of_flight == Status.IDENTIFIED.value for one in own)
    return (
        f"{sum(one.accepted for one in own)} of {len(own)}",
        f"{flights} of {len(own)}",
        f"{float(np.median(_lengths(found, way))):.2f}",
        f"{float(np.median(errors)):.1%}".replace("%", " %"),
        _share(_coverage(own)),
    )


def _lengths(found: Sequence[Told], way: str) -> list[float]:
    """Length of K's interval over that with the lag given, of every flight that has both."""
    given = {one.flight: one.length for one in found if one.way == GIVEN}
    return [
        one.length / given[one.flight]
        for one in found
        if one.way == way and np.isfinite(one.length) and np.isfinite(given[one.flight])
    ]


def _coverage(own: Sequence[Told]) -> Share:
    held = [one.held for one in own if one.accepted]
    return Share(sum(held), len(held), LEVEL)


def _share(share: Share) -> str:
    low, high = share.interval
    return f"{share.value:.2f} [{low:.2f}, {high:.2f}] of {share.count}"
