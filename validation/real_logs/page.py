"""The study as Markdown: tables made from its rows, put into a page between two marks."""

from __future__ import annotations

import numpy as np
import polars as pl

from eivor.lab.experiments import markdown
from eivor.lab.study import Share
from eivor.motions.vertical.verdict import HOVER_FLOOR
from validation.flight_recipe.metrics import accepted_share, flown, score
from validation.flight_recipe.page import verdict_table
from validation.flight_recipe.trials import QUANTITIES, RECIPE
from validation.real_logs.grid import Grid
from validation.real_logs.named import NAMES
from validation.real_logs.requirements import LAG, far_off, judged, requirements, said
from validation.study_folder import StudyTable

#: Name of the generated part of the page.
PART = "real logs"
HOVER = "hover_input"
COMMAND = "python -m validation.real_logs.study"


def study_tables(table: StudyTable, grid: Grid) -> str:
    """All tables of a run, as Markdown."""
    rows, origin = table.rows, table.origin
    lost = rows.height - flown(rows).height
    return "\n\n".join(
        [
            f"Made by `{COMMAND}` with {origin['made with']}: grid *{origin['grid']}*, {origin['flights']} "
            f"flights, {lost} of which lost their vehicle in the simulator and are left out. Brackets hold "
            "the 99 % Wilson interval of a share.",
            "## By family",
            "Accepted flights, coverage of the 95 % intervals that are identified in them, mean error of the "
            "lag, and accepted flights with an interval that misses by more than its half-width.",
            family_table(rows, grid),
            "## What was said of the flights",
            "Share of the flights of which each thing was said, rightly or not.",
            said_table(rows, grid),
            "## Verdicts",
            verdict_table(rows),
            "## What is asked, and what came out",
            requirement_table(rows, grid),
            *hover_sentence(rows, grid),
        ]
    )


def family_table(rows: pl.DataFrame, grid: Grid) -> str:
    """One row for each family that was flown."""
    header = ["family", "flown", "accepted", "K", "K_u", "lag", "hover", "bias of the lag", "far off"]
    lines = []
    for name, here in _families(rows, grid):
        covered = [_value(score(judged(here, quantity), quantity).coverage) for quantity in QUANTITIES]
        lag = score(judged(here, LAG), LAG)
        bias = f"{lag.bias * 1e3:+.2f} ms" if lag.coverage.count else "-"
        share = accepted_share(here)
        lines.append(
            [name, str(share.count), f"{share.hits} ({_value(share)})", *covered, bias, _value(far_off(here))]
        )
    return markdown(header, lines)


def said_table(rows: pl.DataFrame, grid: Grid) -> str:
    """How often each thing was said, for each family."""
    lines = [
        [name, *(_value(said(flown(here), what)) for what in NAMES)] for name, here in _families(rows, grid)
    ]
    return markdown(("family", *NAMES), lines)


def requirement_table(rows: pl.DataFrame, grid: Grid) -> str:
    """One row for each requirement."""
    lines = [
        (item.what, item.asked, item.measured, "yes" if item.met else "**no**")
        for item in requirements(rows, grid)
    ]
    return markdown(("what", "asked", "measured", "met"), lines)


def hover_sentence(rows: pl.DataFrame, grid: Grid) -> list[str]:
    """Errors of hover inputs beside the floor of their interval; nothing where none is identified."""
    held = [family.name for family in grid.families if family.holds == "yes"]
    reported = judged(rows.filter(pl.col("class").is_in(held)), HOVER)
    if not reported.height:
        return []
    true = reported[f"truth.{HOVER}"]
    off = ((reported[f"{RECIPE}.{HOVER}.value"] - true) / true).abs().to_numpy()
    return [
        "The hover inputs of all families that the model holds are off by less than "
        f"{np.quantile(off, 0.95):.3%} in 95 % of {off.size} flights, and by {off.max():.3%} at most; the "
        f"floor of their interval is {HOVER_FLOOR:.1%} either way."
    ]


def _families(rows: pl.DataFrame, grid: Grid) -> list[tuple[str, pl.DataFrame]]:
    results = [(family.name, rows.filter(pl.col("class") == family.name)) for family in grid.families]
    return [(name, here) for name, here in results if here.height]


def _value(share: Share) -> str:
    return f"{share.value:.3f}" if share.count else "-"
