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
        (requirement.what, requirement.asked, requirement.measured, "yes" if requirement.met else "no")
        for requirement in requirements(rows, grid)
    ]
    return markdown(("what", "asked", "measured", "met"), lines)


def score_table(rows: pl.DataFrame, grid: Grid) -> str:
    """One row for each scenario, vehicle and method."""
    lines = []
    for scenario in grid.scenarios:
        for vehicle, method, item in parts_of(rows, scenario):
            name = scenario.name if len(scenario.vehicles) == 1 else f"{scenario.name}: {vehicle}"
            result = scores(item)
            flights = item["number"].n_unique()
            lines.append(
                (f"{name}, {method}", f"{flights}", *(cell(result, names) for names in GROUPS.values()))
            )
    return markdown(("flights", "number", *GROUPS), lines)


def cell(result: dict[str, Score], names: tuple[str, ...]) -> str:
    """Bias, root mean square error and coverage of a group: the worst of each number."""
    selected = [result[name] for name in names if name in result and result[name].count]
    if not selected:
        return "-"
    bias = max((item.bias for item in selected), key=abs)
    rmse = float(np.max([item.rmse for item in selected]))
    covered = min(item.covered.value for item in selected)
    return f"{'+' if bias >= 0.0 else '-'}{percent(abs(bias))}, {percent(rmse)} [{covered:.2f}]"
