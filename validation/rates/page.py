"""The study as Markdown tables, and what is asked of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from eivor.inference.distributions import normal_quantile
from eivor.lab.experiments import markdown
from eivor.lab.study import Share
from validation.rates.grid import Grid
from validation.rates.trials import EFFECTIVENESS, INSTRUMENTS, LAG, LEAST_SQUARES, Told
from validation.requirement import Requirement

#: Name of the generated part of the page.
PART = "rates"
#: Largest median of the size of errors: of effectiveness (a share), of the lag [s].
LARGEST = {"50 Hz": (0.08, 0.006), "250 Hz": (0.02, 0.002)}
#: Coverage of what is accepted, and the confidence with which a share of few is compared with it.
COVERAGE, CHANCE_LEVEL = (0.90, 0.98), 0.999


def requirements(grid: Grid, tolds: Sequence[Told]) -> Iterator[Requirement]:
    """What is asked, held against a run."""
    for judged, (share, seconds) in LARGEST.items():
        names = {condition.name for condition in grid.conditions if condition.judged == judged}
        selected = [item for item in tolds if item.condition in names and item.method == INSTRUMENTS]
        effect, lag = (
            float(np.median(np.abs(_errors(selected, item) or [np.nan]))) for item in (EFFECTIVENESS, (LAG,))
        )
        yield Requirement(f"effectiveness, {judged}", f"<= {share:.0%}", f"{effect:.1%}", effect <= share)
        yield Requirement(
            f"lag, {judged}", f"<= {1e3 * seconds:.0f} ms", f"{1e3 * lag:.1f} ms", lag <= seconds
        )
    accepted = [item for item in tolds if item.accepted]
    large = {condition.name for condition in grid.conditions if condition.judged != "small"}
    held = [item.held for item in accepted if item.condition in large]
    covered, (low, high) = Share(sum(held), len(held)), COVERAGE
    yield Requirement(
        "coverage of what is accepted", f"{low:.2f} to {high:.2f}", _share(covered), _within(covered)
    )
    missed = sum(not item.held for item in accepted if item.condition not in large)
    yield Requirement("small steps and hover: accepted intervals that miss", "0", f"{missed}", missed == 0)


def _within(covered: Share) -> bool:
    """Whether a share is between the bounds, or may be but for chance."""
    slack = [normal_quantile(CHANCE_LEVEL) * (p * (1 - p) / max(covered.count, 1)) ** 0.5 for p in COVERAGE]
    return COVERAGE[0] - slack[0] <= covered.value <= COVERAGE[1] + slack[1]


def tables(grid: Grid, tolds: Sequence[Told]) -> str:
    """What is asked, and a table of every cell."""
    requested = [
        (requirement.what, requirement.asked, requirement.measured, "yes" if requirement.met else "no")
        for requirement in requirements(grid, tolds)
    ]
    header = ("flights", "effectiveness", "lag", "accepted", "intervals that hold", "least squares")
    rows = []
    for condition, vehicle in dict.fromkeys((item.condition, item.vehicle) for item in tolds):
        selected = [item for item in tolds if (item.condition, item.vehicle) == (condition, vehicle)]
        rows.append((f"{condition}: {vehicle}", *_cells(selected)))
    flights = len({(item.vehicle, item.condition, item.number) for item in tolds})
    return "\n\n".join(
        (
            f"Made by `python -m validation.rates.study` of {flights} flights of {grid.seconds:g} s.",
            markdown(("median size of errors, and coverage", "asked", "measured", "met"), requested),
            markdown(header, rows),
        )
    )


def _cells(tolds: Sequence[Told]) -> tuple[str, ...]:
    selected = [item for item in tolds if item.method == INSTRUMENTS]
    plain = [item for item in tolds if item.method == LEAST_SQUARES]
    accepted = [item for item in selected if item.accepted]
    return (
        _of(selected, EFFECTIVENESS, lambda bias, size: f"{bias:+.1%} ({size:.1%})"),
        _of(selected, (LAG,), lambda bias, size: f"{1e3 * bias:+.1f} ({1e3 * size:.1f}) ms"),
        f"{len(accepted)} of {len(selected)}",
        _share(Share(sum(item.held for item in accepted), len(accepted))) if accepted else "-",
        ", ".join(
            (
                _of(plain, EFFECTIVENESS, lambda bias, _: f"{bias:+.0%}"),
                _of(plain, (LAG,), lambda bias, _: f"{1e3 * bias:+.0f} ms"),
            )
        ),
    )


def _of(tolds: Sequence[Told], names: Sequence[str], words: Callable[[float, float], str]) -> str:
    """Median error, and median size of it, of what was told at all."""
    errors = _errors(tolds, names)
    return words(float(np.median(errors)), float(np.median(np.abs(errors)))) if errors else "-"


def _errors(tolds: Sequence[Told], names: Sequence[str]) -> list[float]:
    return [item.error for item in tolds if item.quantity in names and np.isfinite(item.error)]


def _share(share: Share) -> str:
    low, high = share.interval
    return f"{share.value:.2f} [{low:.2f}, {high:.2f}] of {share.count}"
