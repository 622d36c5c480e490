"""The study of the rigid body, and the command that runs it.

    python -m validation.rigid_body.study [--folder FOLDER] [--out FILE.parquet] [--page FILE.md]

flies the published grid (`grid.toml`), identifies every log, and prints the tables. Finished parts are kept
in the folder: a run that was interrupted goes on there, and `--tables` makes the tables of what is done.
`--share` flies only the first flights of each scenario, `--scenarios` only those whose name holds a word.
`--from FILE.parquet` makes the tables anew from a finished run.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import polars as pl

from eivor.lab.study import Share
from validation.pages import markdown
from validation.rigid_body.trials import GROUPS, Grid, Scenario, folder_of, published_grid, unit_of_error
from validation.studies import Answer, Requirement, StudyTable, folder_command, requirement_table

#: Of the interval of a share that is compared with what is asked.
LEVEL = 0.99
#: What flights of families are judged by, and what decides their verdict.
FAMILY_GROUPS = tuple(group for group in GROUPS if group != "translational lift")
HEADLINES = (*GROUPS["torque gains"][:2], *GROUPS["lag"], *GROUPS["thrust gain"])


@dataclass(frozen=True, slots=True)
class Score:
    """How well a quantity is told, over flights."""

    count: int  # Flights that tell it
    # Mean of the errors, root of the mean of their squares, and the largest, relative to the truth
    bias: float
    rmse: float
    largest: float
    covered: Share  # Intervals that hold the truth


def score(rows: pl.DataFrame) -> Score:
    """Score of one quantity by one method of one vehicle; a flight that told nothing missed."""
    truth, value = rows["truth"].to_numpy(), rows["value"].to_numpy()
    reported = np.isfinite(value)
    errors = (value - truth)[reported] / unit_of_error(str(rows["quantity"][0]), float(truth[0]))
    if not errors.size:
        errors = np.array([np.nan])
    return Score(
        int(reported.sum()),
        float(errors.mean()),
        float(np.sqrt(np.mean(errors**2))),
        float(np.abs(errors).max()),
        held(rows),
    )


def held(rows: pl.DataFrame) -> Share:
    """Share of intervals that hold the truth."""
    hits = (rows["low"] <= rows["truth"]) & (rows["truth"] <= rows["high"])
    return Share(int(hits.sum()), rows.height, LEVEL)


def scores(rows: pl.DataFrame) -> dict[str, Score]:
    """Score of every quantity whose error can be told relative to its truth."""
    return {
        str(name): score(item)
        for (name,), item in rows.group_by(["quantity"], maintain_order=True)
        if unit_of_error(str(name), float(item["truth"][0])) > 0.0
    }


def parts_of(rows: pl.DataFrame, scenario: Scenario) -> Iterator[tuple[str, str, pl.DataFrame]]:
    """Rows of a scenario by vehicle and method, in the order of the grid."""
    for vehicle in scenario.vehicles:
        for method in scenario.methods:
            current = rows.filter(
                (pl.col("scenario") == scenario.name)
                & (pl.col("vehicle") == str(vehicle))
                & (pl.col("method") == method)
            )
            if current.height:
                yield str(vehicle), method, current


def requirements(rows: pl.DataFrame, grid: Grid) -> tuple[Requirement, ...]:
    """Judge a run of the study by the first method of each scenario."""
    return tuple(
        item
        for scenario in grid.scenarios
        for vehicle, method, entry in parts_of(rows, scenario)
        if method == scenario.methods[0]
        for item in _of_part(scenario, vehicle, scores(entry))
    ) + tuple(
        item
        for scenario in grid.scenarios
        if scenario.coverage_pooled and len(scenario.vehicles) > 1
        for item in _of_families(rows, scenario)
    )


def _of_families(rows: pl.DataFrame, scenario: Scenario) -> Iterator[Requirement]:
    """Coverage of each group, of all families and of each, and headlines that are far from the truth."""
    part, (low, high) = rows.filter(pl.col("scenario") == scenario.name), scenario.coverage_pooled
    for group in FAMILY_GROUPS if part.height else ():
        of_group = part.filter(pl.col("quantity").is_in(GROUPS[group]))
        pooled, by_family = held(of_group), of_group.group_by("vehicle", maintain_order=True)
        families = {str(family): held(item).value for (family,), item in by_family}
        missed = [family for family, value in families.items() if value < scenario.coverage_each]
        yield Requirement.by_all(
            f"{scenario.name}: coverage, {group}",
            f"{low:g} to {high:g}, of each {scenario.coverage_each:g}",
            f"{share_text(pooled)}, {min(families.values()):.2f} at least",
            missed + ["all"] * (not low <= pooled.value <= high),
        )
    judged = part.filter(pl.col("quantity").is_in(HEADLINES) & (pl.col("verdict") == "identified"))
    far = judged.filter((pl.col("value") - pl.col("truth")).abs() > pl.col("high") - pl.col("low"))
    name, share = "identified headlines, off by over two half-widths", far.height / max(judged.height, 1)
    measured = f"{percent(share)} of {judged.height}"
    yield Requirement(f"{scenario.name}: {name}", "<= 1 %", measured, share <= 0.01)


def _of_part(scenario: Scenario, vehicle: str, result: dict[str, Score]) -> Iterator[Requirement]:
    name = scenario.name if len(scenario.vehicles) == 1 else f"{scenario.name}, {vehicle}"
    for word, bounds, number in (
        ("largest error", scenario.largest, "largest"),
        ("RMSE", scenario.rmse, "rmse"),
        ("bias", scenario.bias, "bias"),
    ):
        for group, bound in bounds.items():
            sizes = [abs(getattr(result[item], number)) for item in GROUPS[group] if item in result]
            if sizes:
                worst = float(np.max(sizes))
                yield Requirement(
                    f"{name}: {word}, {group}", f"<= {percent(bound)}", percent(worst), worst <= bound
                )
    judged = {
        item: result[item].covered for group in scenario.groups for item in GROUPS[group] if item in result
    }
    if scenario.coverage_each and judged:
        below = [item for item, share in judged.items() if share.interval[1] < scenario.coverage_each]
        least = min(judged.values(), key=lambda share: share.value)
        yield Requirement(
            f"{name}: coverage of each",
            f"{scenario.coverage_each:g} in its 99 % interval",
            share_text(least) + (f"; below: {', '.join(below)}" if below else " at least"),
            not below,
        )
    if scenario.coverage_pooled and judged:
        low, high = scenario.coverage_pooled
        hits, count = (sum(getattr(share, of) for share in judged.values()) for of in ("hits", "count"))
        pooled = Share(hits, count, LEVEL)
        met = low <= pooled.value <= high
        yield Requirement(f"{name}: coverage of all", f"{low:g} to {high:g}", share_text(pooled), met)


def percent(value: float) -> str:
    return f"{100.0 * value:.2g} %" if np.isfinite(value) else "-"


def share_text(share: Share) -> str:
    low, high = share.interval
    return f"{share.value:.3f} [{low:.2f}, {high:.2f}]"


def score_table(rows: pl.DataFrame, grid: Grid) -> str:
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


def answer(table: StudyTable) -> Answer:
    """Tables of a run, and what is asked of it."""
    rows, origin, grid = table.rows, table.origin, published_grid()
    parts = [
        f"Made by `python -m validation.rigid_body.study` with {origin['made with']}: grid "
        f"*{origin['grid']}*, {origin['flights']} flights. Brackets hold 99 % Wilson intervals of shares.",
        "## What is asked, and what came out",
        requirement_table(requirements(rows, grid)),
        "## Errors and coverage",
        "Bias and root mean square error, in brackets the coverage of 95 % intervals; of groups the worst of "
        "each number.",
        score_table(rows, grid),
    ]
    return "\n\n".join(parts), requirements(rows, grid)


main = folder_command(
    "validation.rigid_body.study",
    __doc__,
    "rigid body",
    "--scenarios",
    lambda chosen: folder_of(chosen.folder, published_grid(), chosen.share, chosen.word),
    answer,
).main

if __name__ == "__main__":
    sys.exit(main())
