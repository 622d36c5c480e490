"""The study of efficiency as Markdown tables."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import polars as pl

from eivor.lab.experiments import markdown
from validation.efficiency.requirements import requirements
from validation.suites import Row

#: Name of the generated part of the page.
PART = "efficiency"
COMMAND = "python -m validation.efficiency.study"
#: Share of weak estimates from which on a coverage is marked.
MOSTLY = 0.9
Cell = Callable[[Row], str]


def efficiency_tables(rows: pl.DataFrame) -> str:
    """All tables of a run."""
    first = rows.row(0, named=True)
    requested = [
        (item.what, item.asked, item.measured, "yes" if item.met else "no") for item in requirements(rows)
    ]
    parts = [
        f"Made by `{COMMAND}` with {first['versions']}: {_number(rows)} records of each scenario and length, "
        f"seed {first['seed']}. Each cell is K / K_u.",
        markdown(("what", "asked", "measured", "met"), requested),
    ]
    methods = rows["method"].unique(maintain_order=True).to_list()
    for samples in rows["samples"].unique(maintain_order=True):
        here = rows.filter(pl.col("samples") == samples)
        parts += [f"## N = {samples}", "RMSE over the Cramer-Rao bound; without one, RMSE in per cent:"]
        parts.append(_table(here, methods, {"bound, %": _bound}, _over_bound))
        parts.append("Coverage of the 95 % intervals, *weak* where nine in ten estimates or more are:")
        parts.append(_table(here, methods, {}, _covered))
    return "\n\n".join(parts)


def _table(here: pl.DataFrame, methods: list[str], columns: Mapping[str, Cell], cell: Cell) -> str:
    """A row for each scenario: columns that no method changes, and a cell for each method."""
    lines: list[list[str]] = []
    for scenario in here["scenario"].unique(maintain_order=True):
        index = here.filter(pl.col("scenario") == scenario)
        first = index.filter(pl.col("method") == methods[0])
        neighbours = [_pair(first, column) for column in columns.values()]
        cells = [_pair(index.filter(pl.col("method") == method), cell) for method in methods]
        lines.append([str(scenario), _number(index), *neighbours, *cells])
    return markdown(["scenario", "records", *columns, *methods], lines)


def _number(rows: pl.DataFrame) -> str:
    """Number of records, or from which to which it goes."""
    runs = rows["runs"].unique().sort().to_list()
    return f"{runs[0]}" if len(runs) == 1 else f"{runs[0]} to {runs[-1]}"


def _pair(rows: pl.DataFrame, cell: Cell) -> str:
    return " / ".join(cell(row) for row in rows.iter_rows(named=True)) or "-"


def _bound(row: Row) -> str:
    bound = float(row["bound"])
    return "-" if math.isnan(bound) else f"{100.0 * bound:.3g}"


def _over_bound(row: Row) -> str:
    rmse, bound = float(row["rmse"]), float(row["bound"])
    if math.isnan(rmse):
        return "-"
    return f"({100.0 * rmse:.2f} %)" if math.isnan(bound) else f"{rmse / bound:.2f}"


def _covered(row: Row) -> str:
    if not row["count"]:
        return "-"
    weak = "*weak* " if int(row["weak"]) >= MOSTLY * int(row["runs"]) else ""
    return f"{weak}{int(row['hits']) / int(row['count']):.3f}"
