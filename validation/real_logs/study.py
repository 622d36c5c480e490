"""The study of logs as they are, and the command that runs it.

    python -m validation.real_logs.study [--folder FOLDER] [--out FILE.parquet] [--page FILE.md]

flies the published grid (`grid.toml`), identifies every log, and prints the tables. Finished parts are kept
in the folder: a run that was interrupted goes on there, and `--tables` makes the tables of what is done.
`--share` flies only the first flights of each family, `--families` only those whose name holds a word.
`--from FILE.parquet` makes the tables anew from a finished run.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np
import polars as pl
from msgspec.structs import replace

from eivor.inference.verdict import Status
from eivor.lab.study import Share
from eivor.motions.vertical.verdict import HOVER_FLOOR
from validation.flight_recipe.study import (
    COVERAGE_BOUNDS,
    COVERED,
    LEVEL,
    accepted,
    accepted_share,
    flown,
    score,
    verdict_table,
)
from validation.flight_recipe.study import NAMES as SYMBOLS
from validation.flight_recipe.trials import QUANTITIES, RECIPE
from validation.pages import markdown
from validation.real_logs.trials import NAMES, Family, Grid, folder_of, published_grid
from validation.studies import Answer, Requirement, StudyTable, folder_command, requirement_table, share_text

#: Coverage of all accepted flights of families that the model holds, together; and of short flights.
POOLED_BOUNDS = (0.93, 0.97)
LEAST_SHORT = 0.90
#: Fewest accepted flights of a family that the model holds; of a smaller one.
LEAST_ACCEPTED = (150, 100)
#: Largest mean error of the lag where commands are logged at 100 Hz or more [s].
LARGEST_LAG_BIAS = 0.001
#: Share of accepted flights that may have an interval which misses by more than its own half-width.
MOST_FAR_OFF = 0.05
#: Of flights in gusts whose lag is given: identified, and identified or weak with friction above zero.
LEAST_IDENTIFIED, LEAST_TOLD = 0.80, 0.95
#: Largest median half-width of the lag [s] of pools with two frequencies.
POOL_LAG_HALF_WIDTH = 0.020

FRICTION, LAG = "viscous_friction", "effective_lag"


def requirements(rows: pl.DataFrame, grid: Grid) -> tuple[Requirement, ...]:
    result: list[Requirement] = []
    for family in grid.families:
        here = rows.filter(pl.col("class") == family.name)
        if here.height:
            result.extend(_of_family(family, here))
    held = [family.name for family in grid.families if family.holds == "yes"]
    together = rows.filter(pl.col("class").is_in(held))
    result.extend(_pooled(together, quantity) for quantity in COVERED)
    result.extend(_of_two_frequencies(grid, rows))
    return tuple(result)


def judged(rows: pl.DataFrame, quantity: str) -> pl.DataFrame:
    return accepted(rows).filter(pl.col(f"verdict.{quantity}") == Status.IDENTIFIED.value)


def far_off(rows: pl.DataFrame) -> Share:
    """Accepted flights with an identified interval that misses by more than its own half-width."""
    kept = accepted(rows)
    missed = np.zeros(kept.height, dtype=np.bool_)
    for quantity in COVERED:
        low, high = (kept[f"{RECIPE}.{quantity}.{end}"].to_numpy() for end in ("low", "high"))
        off = np.abs(kept[f"truth.{quantity}"].to_numpy() - 0.5 * (low + high)) > high - low
        missed |= off & (kept[f"verdict.{quantity}"].to_numpy() == Status.IDENTIFIED.value)
    return Share(int(missed.sum()), kept.height, LEVEL)


def said(rows: pl.DataFrame, name: str) -> Share:
    return Share(int(rows[f"named.{name}"].sum()), rows.height, LEVEL)


def _of_family(family: Family, rows: pl.DataFrame) -> Iterator[Requirement]:
    if family.pool > 1:
        yield from _of_pools(family, rows)
        return
    if family.holds != "no":
        if not family.given and family.holds != "short":
            yield _enough(family, accepted_share(rows))
        yield from (_covered(family, judged(rows, quantity), quantity) for quantity in COVERED)
    if family.lag_bias:
        yield _small_bias(family, judged(rows, LAG))
    if family.named:
        share = said(flown(rows), family.named)
        yield _at_least(family, f"named: {family.named}", share, family.share)
    if family.given == "truth":
        yield _at_least(family, "identified", accepted_share(rows), LEAST_IDENTIFIED)
        yield _at_least(family, "identified or weak, friction above zero", _report(rows), LEAST_TOLD)
    if family.refused:
        share = accepted_share(rows)
        yield Requirement(
            f"{family.name}: identified", "none", f"{share.hits} of {share.count}", share.hits == 0
        )
    elif not family.given:
        share = far_off(rows)
        yield Requirement(
            f"{family.name}: accepted, an interval misses by more than its half-width",
            f"at most {MOST_FAR_OFF}",
            share_text(share),
            not share.count or share.value <= MOST_FAR_OFF,
        )


def _of_pools(family: Family, rows: pl.DataFrame) -> Iterator[Requirement]:
    yield _covered(family, rows, FRICTION)
    if len(family.frequencies) == 1:
        yield _covered(family, _one_each(family, rows), LAG)
        share = said(_one_each(family, rows), family.named)
        yield _at_least(family, f"named: {family.named}", share, family.share)
        return
    yield _narrow(family.name, _one_each(family, rows))


def _of_two_frequencies(grid: Grid, rows: pl.DataFrame) -> Iterator[Requirement]:
    """Half-widths of the lag in all pools with two reference frequencies, whichever these are."""
    families = [family for family in grid.families if len(family.frequencies) == 2]
    flight = [_one_each(family, rows.filter(pl.col("class") == family.name)) for family in families]
    if all(pools.height for pools in flight) and len(flight) > 1:
        yield _narrow("all pools with two reference frequencies", pl.concat(flight))


def _narrow(what: str, pools: pl.DataFrame) -> Requirement:
    """Half-width of the lag in the median of pools, of each of which there is one row."""
    widths = 0.5 * (pools[f"{RECIPE}.{LAG}.high"] - pools[f"{RECIPE}.{LAG}.low"]).to_numpy()
    median = float(np.median(widths))
    return Requirement(
        f"{what}: half-width of the lag in the median",
        f"at most {POOL_LAG_HALF_WIDTH * 1e3:.0f} ms",
        f"{median * 1e3:.1f} ms of {widths.size} pools",
        median <= POOL_LAG_HALF_WIDTH,
    )


def _one_each(family: Family, rows: pl.DataFrame) -> pl.DataFrame:
    return rows.filter(pl.col("number") % family.pool == 0)


def _enough(family: Family, share: Share) -> Requirement:
    least = next(least for least in LEAST_ACCEPTED if least < family.count)
    return Requirement(
        f"{family.name}: accepted flights",
        f"at least {least}",
        f"{share.hits} of {share.count}",
        share.hits >= least,
    )


def _covered(family: Family, rows: pl.DataFrame, quantity: str) -> Requirement:
    coverage = score(rows, quantity).coverage
    least, most = coverage.interval
    low, high = COVERAGE_BOUNDS
    what = f"{family.name}: coverage of {SYMBOLS[quantity]}"
    if family.holds == "short":
        # what is never called identified claims no coverage
        met = not coverage.count or coverage.value >= LEAST_SHORT
        return Requirement(what, f"at least {LEAST_SHORT}, or weak", share_text(coverage), met)
    met = least <= high and most >= low
    return Requirement(what, f"99 % interval meets [{low}, {high}]", share_text(coverage), met)


def _pooled(rows: pl.DataFrame, quantity: str) -> Requirement:
    coverage = score(judged(rows, quantity), quantity).coverage
    low, high = POOLED_BOUNDS
    return Requirement(
        f"all families that the model holds: coverage of {SYMBOLS[quantity]}",
        f"{low} to {high}",
        share_text(coverage),
        low <= coverage.value <= high,
    )


def _small_bias(family: Family, rows: pl.DataFrame) -> Requirement:
    bias = score(rows, LAG).bias
    return Requirement(
        f"{family.name}: mean error of the lag",
        f"at most {LARGEST_LAG_BIAS * 1e3:.0f} ms either way",
        f"{bias * 1e3:+.2f} ms",
        abs(bias) <= LARGEST_LAG_BIAS,
    )


def _report(rows: pl.DataFrame) -> Share:
    """Flights that are identified or weak, with a friction whose interval is above zero."""
    all_flown = flown(rows)
    status = pl.col("verdict").is_in([Status.IDENTIFIED.value, Status.WEAK.value])
    hits = all_flown.filter(status & (pl.col(f"{RECIPE}.{FRICTION}.low") > 0.0)).height
    return Share(hits, all_flown.height, LEVEL)


def _at_least(family: Family, what: str, share: Share, least: float) -> Requirement:
    return Requirement(f"{family.name}: {what}", f"at least {least}", share_text(share), share.value >= least)


PART = "real logs"
HOVER = "hover_input"
COMMAND = "python -m validation.real_logs.study"


def study_tables(table: StudyTable, grid: Grid) -> str:
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
            requirement_table(requirements(rows, grid), not_met="**no**"),
            *hover_sentence(rows, grid),
        ]
    )


def family_table(rows: pl.DataFrame, grid: Grid) -> str:
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
    lines = [
        [name, *(_value(said(flown(here), what)) for what in NAMES)] for name, here in _families(rows, grid)
    ]
    return markdown(("family", *NAMES), lines)


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
        f"{np.quantile(off, 0.95):.3%} in 95 % of {off.size} flights, and by {off.max():.3%} at most. The "
        f"floor of their interval is {HOVER_FLOOR:.1%} either way."
    ]


def _families(rows: pl.DataFrame, grid: Grid) -> list[tuple[str, pl.DataFrame]]:
    results = [(family.name, rows.filter(pl.col("class") == family.name)) for family in grid.families]
    return [(name, here) for name, here in results if here.height]


def _value(share: Share) -> str:
    return f"{share.value:.3f}" if share.count else "-"


def part_of(grid: Grid, share: float, word: str) -> Grid:
    """First flights of the families whose name holds a word."""
    kept = [family for family in grid.families if word in family.name]
    return replace(
        grid, families=tuple(replace(item, count=max(1, round(share * item.count))) for item in kept)
    )


def answer(table: StudyTable) -> Answer:
    """Tables of a run, and what is asked of it."""
    return study_tables(table, published_grid()), requirements(table.rows, published_grid())


main = folder_command(
    "validation.real_logs.study",
    __doc__,
    PART,
    "--families",
    lambda chosen: folder_of(chosen.folder, part_of(published_grid(), chosen.share, chosen.word)),
    answer,
).main

if __name__ == "__main__":
    sys.exit(main())
