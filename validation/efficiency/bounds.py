"""Bounds of finished rows, computed anew, and the command that does it.

    python -m validation.efficiency.bounds FILE.parquet --out FILE.parquet

flies nothing: errors stay as they were measured, and stand over the bound as it is computed now.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import polars as pl

from eivor.errors import EivorError
from eivor.lab.study_files import Suite
from validation.efficiency.study import COLUMNS, bounds_of, efficiency_suite
from validation.studies import WRONG, read_rows, write_rows


def with_bounds(rows: pl.DataFrame, suite: Suite) -> pl.DataFrame:
    """Rows with the bounds of a suite's scenarios; those of other scenarios and lengths stay as they are."""
    keys = ["scenario", "samples", "parameter"]
    result = pl.DataFrame(
        [
            (study.scenario, study.samples, name, bound)
            for study in suite.studies
            for name, bound in bounds_of(study).items()
        ],
        schema={**{key: rows.schema[key] for key in keys}, "now": pl.Float64},
        orient="row",
    )
    joined = rows.join(result, on=keys, how="left", maintain_order="left")
    return joined.with_columns(pl.coalesce("now", "bound").alias("bound")).drop("now")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m validation.efficiency.bounds", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("rows", type=Path, metavar="FILE.parquet", help="of a finished run")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE.parquet", help="write the rows")
    chosen = parser.parse_args(arguments)
    try:
        rows = read_rows(chosen.rows, COLUMNS, "efficiency")
        write_rows(with_bounds(rows, efficiency_suite()), chosen.out)
    except EivorError as error:
        sys.stderr.write(f"{error}\n")
        return WRONG
    return 0


if __name__ == "__main__":
    sys.exit(main())
