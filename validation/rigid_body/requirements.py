"""What the identification of the rigid body must reach, and whether a run of the study says that it does."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import polars as pl

from eivor.lab.study_run import Share
from validation.requirement import Requirement
from validation.rigid_body.grid import Grid
from validation.rigid_body.quantities import GROUPS, unit_of_error
from validation.rigid_body.scenario import Scenario

#: Of the interval of a share that is compared with what is asked.
LEVEL = 0.99


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
    held = (rows["low"].to_numpy() <= truth) & (truth <= rows["high"].to_numpy())
    if not errors.size:
        errors = np.array([np.nan])
    return Score(
        int(reported.sum()),
        float(errors.mean()),
        float(np.sqrt(np.mean(errors**2))),
        float(np.abs(errors).max()),
        Share(int(held.sum()), rows.height, LEVEL),
    )


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
    )


def _of_part(scenario: Scenario, vehicle: str, result: dict[str, Score]) -> Iterator[Requirement]:
    requested = scenario.asked
    name = scenario.name if len(scenario.vehicles) == 1 else f"{scenario.name}, {vehicle}"
    for word, bounds, number in (
        ("largest error", requested.largest, "largest"),
        ("RMSE", requested.rmse, "rmse"),
        ("bias", requested.bias, "bias"),
    ):
        for group, bound in bounds.items():
            sizes = [abs(getattr(result[item], number)) for item in GROUPS[group] if item in result]
            if sizes:
                worst = float(np.max(sizes))
                yield Requirement(
                    f"{name}: {word}, {group}", f"<= {percent(bound)}", percent(worst), worst <= bound
                )
    judged = {
        item: result[item].covered for group in requested.groups for item in GROUPS[group] if item in result
    }
    if requested.coverage_each and judged:
        below = [item for item, share in judged.items() if share.interval[1] < requested.coverage_each]
        least = min(judged.values(), key=lambda share: share.value)
        yield Requirement(
            f"{name}: coverage of each",
            f"{requested.coverage_each:g} in its 99 % interval",
            share_text(least) + (f"; below: {', '.join(below)}" if below else " at least"),
            not below,
        )
    if requested.coverage_pooled and judged:
        low, high = requested.coverage_pooled
        pooled = Share(
            sum(item.hits for item in judged.values()), sum(item.count for item in judged.values()), LEVEL
        )
        yield Requirement(
            f"{name}: coverage of all",
            f"{low:g} to {high:g}",
            share_text(pooled),
            low <= pooled.value <= high,
        )


def percent(value: float) -> str:
    """A share in percent."""
    return f"{100.0 * value:.2g} %" if np.isfinite(value) else "-"


def share_text(share: Share) -> str:
    """A share with its interval."""
    low, high = share.interval
    return f"{share.value:.3f} [{low:.2f}, {high:.2f}]"
