"""The study as Markdown: tables made from its rows, put into a page between two marks."""

from __future__ import annotations

import numpy as np
import polars as pl

from eivor.lab.experiments import markdown
from validation.rigid_body.grid import Grid
from validation.rigid_body.quantities import GROUPS
from validation.rigid_body.requirements import Score, parts_of, percent, requirements, scores
from validation.study_folder import StudyTable

#: Name of the generated part of the page.
PART = "rigid body"
COMMAND = "python -m validation.rigid_body.study"


def study_tables(table: StudyTable, grid: Grid) -> str:
    """All tables of a run, as Markdown."""
    rows, origin = table.rows, table.origin
    return "\n\n".join(
        [
            f"Made by `{COMMAND}` with {origin['made with']}: grid *{origin['grid']}*, {origin['flights']} "
            "flights. Brackets hold the 99 % Wilson interval of a share.",
            "## What is asked, and what came out",
            requirement_table(rows, grid),
            "## Errors and coverage",
            "Bias and root mean square error, in brackets the coverage of 95 % intervals; of groups the "
            "worst of each number.",
            score_table(rows, grid),
        ]
    )


def requirement_table(rows: pl.DataFrame, grid: Grid) -> str:
    """One row for each requirement."""
    lines = [
        (one.what, one.asked, one.measured, "yes" if one.met else "no") for one in requirements(rows, grid)
    ]
    return markdown(("what", "asked", "measured", "met"), lines)


def score_table(rows: pl.DataFrame, grid: Grid) -> str:
    """One row for each scenario, vehicle and method."""
    lines = []
    for scenario in grid.scenarios:
        for vehicle, method, own in parts_of(rows, scenario):
            name = scenario.name if len(scenario.vehicles) == 1 else f"{scenario.name}: {vehicle}"
            found = scores(own)
            flights = own["number"].n_unique()
            lines.append(
                (f"{name}, {method}", f"{flights}", *(cell(found, names) for names in GROUPS.values()))
            )
    return markdown(("flights", "number", *GROUPS), lines)


def cell(found: dict[str, Score], names: tuple[str, ...]) -> str:
    """Bias, root mean square error and coverage of a group: the worst of each number."""
    own = [found[name] for name in names if name in found and found[name].count]
    if not own:
        return "-"
    bias = max((one.bias for one in own), key=abs)
    rmse = float(np.max([one.rmse for one in own]))
    covered = min(one.covered.value for one in own)
    return f"{'+' if bias >= 0.0 else '-'}{percent(abs(bias))}, {percent(rmse)} [{covered:.2f}]"
