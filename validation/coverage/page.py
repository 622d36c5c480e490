"""The coverage study as Markdown tables."""

from __future__ import annotations

import polars as pl

from eivor.lab.experiments import markdown
from validation.coverage.requirements import JUDGED, coverage_of, requirements

#: Name of the generated part of the page.
PART = "coverage"
COMMAND = "python -m validation.coverage.study"
SYMBOLS = {"viscous_friction": "K", "input_gain": "K_u"}
#: What covariances are called in a table.
NAMES = {
    "default": "EWC, 8 averages (default)",
    "widest": "widest of EWC and classical (flights)",
    "bartlett_fixed_b": "Bartlett, 1.3 sqrt(N), fixed-b",
    "andrews": "quadratic spectral, Andrews",
    "newey_west": "Bartlett, Newey and West",
    "heteroskedasticity_robust": "heteroskedasticity-robust",
    "classical": "classical",
}


def coverage_tables(rows: pl.DataFrame) -> str:
    """All tables of a run."""
    first = rows.row(0, named=True)
    level = f"{100 * first['level']:g} %"
    requested = [
        (item.what, item.asked, item.measured, "yes" if item.met else "no") for item in requirements(rows)
    ]
    parts = [
        f"Made by `{COMMAND}` with {first['versions']}: {first['runs']} records of each scenario and length, "
        f"seed {first['seed']}, intervals at {level}. In brackets: the 95 % Wilson interval of a share.",
        "## What is asked, and what came out",
        markdown(("coverage of the default intervals", "asked", "measured", "met"), requested),
    ]
    for samples in rows["samples"].unique(maintain_order=True):
        here = rows.filter(pl.col("samples") == samples)
        parts += [
            f"## N = {samples}",
            _default_table(here.filter(pl.col("method") == JUDGED)),
            "And the rivals, on the same estimates; each cell is K / K_u:",
            _rival_table(here),
        ]
    return "\n\n".join(parts)


def _default_table(rows: pl.DataFrame) -> str:
    lines = []
    for scenario in rows["scenario"].unique(maintain_order=True):
        cells = [scenario]
        for row in rows.filter(pl.col("scenario") == scenario).iter_rows(named=True):
            low, high = coverage_of(row).interval
            cells += [
                f"{coverage_of(row).value:.3f} [{low:.3f}, {high:.3f}]",
                f"{row['length']:.2f}",
                f"{row['bias']:+.2f}",
            ]
        lines.append(cells)
    names = [SYMBOLS.get(name, name) for name in rows["parameter"].unique(maintain_order=True)]
    header = ["scenario"]
    for name in names:
        header += [f"{name}: coverage", "length", "bias / SD"]
    return markdown(header, lines)


def _rival_table(rows: pl.DataFrame) -> str:
    methods = rows["method"].unique(maintain_order=True).to_list()
    lines = []
    for scenario in rows["scenario"].unique(maintain_order=True):
        index = rows.filter(pl.col("scenario") == scenario)
        lines.append([scenario, *(_pair(index.filter(pl.col("method") == method)) for method in methods)])
    worst = ["least", *(f"{min(_shares(rows, method)):.3f}" for method in methods)]
    length = ["mean length", *(f"{_mean_length(rows, method):.2f}" for method in methods)]
    header = ["scenario", *(NAMES.get(method, method) for method in methods)]
    return markdown(header, [*lines, worst, length])


def _shares(rows: pl.DataFrame, method: str) -> list[float]:
    return [coverage_of(row).value for row in rows.filter(pl.col("method") == method).iter_rows(named=True)]


def _mean_length(rows: pl.DataFrame, method: str) -> float:
    return float(rows.filter(pl.col("method") == method)["length"].to_numpy().mean())


def _pair(rows: pl.DataFrame) -> str:
    return " / ".join(f"{coverage_of(row).value:.3f}" for row in rows.iter_rows(named=True))
