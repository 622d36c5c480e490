"""The study of regularisation as Markdown tables: methods in rows, scenarios in columns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import polars as pl

from eivor.studies.generated_page import markdown
from validation.suites import Row

#: Name of the generated part of the page.
PART = "regularisation"
COMMAND = "python -m validation.efficiency.regularisation"
Cell = Callable[[Row], str]


def regularisation_tables(rows: pl.DataFrame) -> str:
    """All tables of a run."""
    first = rows.row(0, named=True)
    base = first["method"]
    keys = ["scenario", "samples", "parameter"]
    plain = rows.filter(pl.col("method") == base).select(*keys, plain="rmse")
    joined = rows.join(plain, on=keys, maintain_order="left").with_columns(
        over=pl.col("rmse") / pl.col("plain")
    )
    parts = [
        f"Made by `{COMMAND}` with {first['versions']}: {first['runs']} records of each scenario and length, "
        f"seed {first['seed']}.",
        f"RMSE over that of `{base}`, over all scenarios, lengths and both parameters:",
        _ranges(joined, base),
    ]
    for samples in rows["samples"].unique(maintain_order=True):
        here = joined.filter(pl.col("samples") == samples)
        parts += [
            f"### Regularisation, N = {samples}",
            f"RMSE over that of `{base}`, K / K_u:",
            _table(here, _over_base),
            "RMSE over the Cramer-Rao bound, K / K_u:",
            _table(here, _over_bound),
            "Coverage of the 95 % intervals, K / K_u:",
            _table(here, _covered),
        ]
    return "\n\n".join(parts)


def _ranges(joined: pl.DataFrame, base: str) -> str:
    lines = []
    for method in joined["method"].unique(maintain_order=True):
        over = joined.filter(pl.col("method") == method)["over"].to_numpy()
        if method != base:
            typical = float(np.exp(np.mean(np.log(over))))
            lines.append((str(method), f"{over.min():.2f}", f"{typical:.2f}", f"{over.max():.3g}"))
    return markdown(("method", "least", "typical (geometric mean)", "largest"), lines)


def _table(here: pl.DataFrame, cell: Cell) -> str:
    scenarios = here["scenario"].unique(maintain_order=True).to_list()
    lines = []
    for method in here["method"].unique(maintain_order=True):
        at = here.filter(pl.col("method") == method)
        pairs = [at.filter(pl.col("scenario") == scenario).iter_rows(named=True) for scenario in scenarios]
        lines.append([str(method), *(" / ".join(cell(row) for row in pair) for pair in pairs)])
    return markdown(["method", *scenarios], lines)


def _over_base(row: Row) -> str:
    return f"{float(row['over']):.2f}"


def _over_bound(row: Row) -> str:
    return f"{float(row['rmse']) / float(row['bound']):.2f}"


def _covered(row: Row) -> str:
    return f"{int(row['hits']) / int(row['count']):.2f}" if row["count"] else "-"
