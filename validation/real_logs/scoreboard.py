"""Scoreboard of the recordings: what is identified of them, and whether repeats and halves agree.

    python -m validation.real_logs.scoreboard [--only WORD] [--rows FILE.json] [--from FILE.json]

identifies every recording of `EIVOR_DATA` alone, those of the vehicle with a known lag with that lag as well,
and its trefoils by halves. Two values agree when they differ by at most the root sum of squares of their
half-widths, 1.96 joint standard errors. It takes two minutes; `--from` reads the rows of an earlier pass.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np

import eivor as ev
from eivor.errors import EivorError
from validation.pages import markdown

SYMBOLS = {"viscous_friction": "K", "input_gain": "K_u", "effective_lag": "lag", "hover_input": "hover"}
#: Lag of the Crazyflie and its standard error [s].
LAG = ev.Prior(0.065, 0.015)
CORPORA = {"trefoil": "trefoils", "nanobench": "other NanoBench", "px4": "PX4", "": "others"}
SUFFIXES = (".csv", ".ulg", ".bin", "")
LOW_P = 0.05
IDENTIFIED, ROUGH = "identified", "weak"


@dataclass(frozen=True, slots=True)
class Row:
    """One identification, or why there is none."""

    log: str
    mode: str  # alone, lag, or half (with the lag)
    error: str = ""
    p_value: float | None = None  # Of the over-identification test
    empty: bool = False  # The Anderson-Rubin set of friction
    seconds: float = 0.0
    quantities: Sequence[Sequence[Any]] = ()  # Name, verdict, value, low, high

    @property
    def corpus(self) -> str:
        return next(name for word, name in CORPORA.items() if word in self.log) + f", {self.mode}"

    @property
    def pair(self) -> str:
        """What it shares with those that it should agree with: its log, or the kind of flight."""
        return self.log if self.mode == "half" else re.sub(r"_rep\d+", "", Path(self.log).stem)

    def of(self, name: str) -> tuple[str, float, float]:
        """Verdict, value and half-width of a quantity."""
        known = {
            item: (verdict, value, 0.5 * (high - low)) for item, verdict, value, low, high in self.quantities
        }
        return known.get(name, ("refused", np.nan, np.nan))


def row_of(
    name: str,
    mode: str,
    log: ev.Recording,
    lag: ev.Prior | None = None,
    window: tuple[float, float] | None = None,
) -> tuple[Row, tuple[float, float] | None]:
    """An identification, and the seconds that it used."""
    begun = time.process_time()
    try:
        result = ev.identify_flight(log, ev.FlightOptions(lag=lag, window=window))
    except EivorError as error:
        return Row(name, mode, str(error)), None
    seconds = time.process_time() - begun
    if result.fit is None:
        return Row(name, mode, result.verdict.sentences[0], seconds=seconds), None
    sets, p_value = result.fit.sets, result.diagnostics.get("over_identification_p_value")
    empty = "viscous_friction" in sets and not sets["viscous_friction"].anderson_rubin.intervals
    known = {word: result.quantities[word] for word in SYMBOLS}
    quantities = tuple((word, item.verdict.value, item.value, *item.interval) for word, item in known.items())
    return Row(name, mode, "", p_value, empty, seconds, quantities), result.window_s


def rows_of(name: str, path: Path) -> Iterator[Row]:
    try:
        log = ev.read_log(path)
    except EivorError as error:
        yield Row(name, "alone", str(error))
        return
    yield row_of(name, "alone", log)[0]
    if "nanobench" not in name:
        return
    row, used = row_of(name, "lag", log, LAG)
    yield row
    if "trefoil" in name and used is not None:
        ends = (used[0], 0.5 * sum(used), used[1])
        yield from (row_of(name, "half", log, LAG, window)[0] for window in pairwise(ends))


def verdicts(rows: list[Row], name: str) -> str:
    """Counts of verdicts, and the median half-width of what is identified or rough."""
    results = [row.of(name) for row in rows]
    identified, rough = (sum(verdict == word for verdict, *_ in results) for word in (IDENTIFIED, ROUGH))
    widths = [half for verdict, _, half in results if verdict in (IDENTIFIED, ROUGH) and np.isfinite(half)]
    median = np.median(widths) if widths else np.nan
    return f"{identified}/{rough}/{len(rows) - identified - rough} ({median:.3g})"


def agreement(rows: list[Row], name: str, taken: tuple[str, ...]) -> str:
    """Pairs that agree, of those whose verdicts are among some."""
    pairs = [[row.of(name) for row in pair] for pair in combinations(rows, 2) if pair[0].pair == pair[1].pair]
    known = [(a, b) for a, b in pairs if a[0] in taken and b[0] in taken]
    return f"{sum(abs(a[1] - b[1]) <= np.hypot(a[2], b[2]) for a, b in known)}/{len(known)}"


def tables(rows: list[Row]) -> str:
    corpora, shares, pairs = defaultdict[str, list[Row]](list), [], []
    for row in rows:
        corpora[row.corpus].append(row)
    for corpus, here in corpora.items():
        tested = [row.p_value for row in here if row.p_value is not None]
        low, empty = f"{sum(p < LOW_P for p in tested)}/{len(tested)}", str(sum(row.empty for row in here))
        cells = [corpus, str(len(here)), low, empty, f"{sum(row.seconds for row in here):.0f}"]
        shares.append([*cells, *(verdicts(here, name) for name in SYMBOLS)])
        for words, taken in (("identified", (IDENTIFIED,)), ("or rough", (IDENTIFIED, ROUGH))):
            pairs.append([f"{corpus}, {words}", *(agreement(here, name, taken) for name in SYMBOLS)])
    shown = [row for row in pairs if any(not cell.endswith("/0") for cell in row[1:])]
    header = ["corpus", "n", "J p < .05", "empty", "CPU s", *SYMBOLS.values()]
    title = "Identified / rough / not (median half-width of both), and pairs of repeats or halves that agree."
    return "\n\n".join([title, markdown(header, shares), markdown(["pairs", *SYMBOLS.values()], shown)])


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser("validation.real_logs.scoreboard", description=__doc__)
    parser.add_argument("--only", default="", metavar="WORD", help="recordings whose name holds a word")
    parser.add_argument("--rows", type=Path, metavar="FILE", help="where the rows are written")
    parser.add_argument("--from", dest="kept", type=Path, metavar="FILE", help="rows of an earlier pass")
    chosen = parser.parse_args(arguments)
    if chosen.kept:
        rows = [Row(**item) for item in json.loads(chosen.kept.read_text(encoding="utf-8"))]
    else:
        folder = Path(os.environ["EIVOR_DATA"])
        files = [path for path in sorted(folder.rglob("*")) if path.is_file() and path.suffix in SUFFIXES]
        once = {path.read_bytes(): path for path in files if path.stem != "LICENSE"}
        names = {str(path.relative_to(folder)): path for path in once.values()}
        rows = [row for name, path in names.items() if chosen.only in name for row in rows_of(name, path)]
    if chosen.rows:
        chosen.rows.write_text(json.dumps([asdict(row) for row in rows]), encoding="utf-8")
    print(tables(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
