"""Scoreboard of the recordings: what is identified of them, and whether halves, repeats and autopilots agree.

    python -m validation.real_logs.scoreboard [--small] [--list] [--page docs/studies/real-logs.md]

identifies the recordings of `EIVOR_DATA` that `scoreboard.toml` lists: alone, by halves of the time used,
and those of the vehicle with a known lag with that lag. Two values agree when they differ by at most the root
sum of squares of their half-widths, 1.96 joint standard errors. `--small` takes a few; the exit code is 3
where a share is below its floor. `--list` prints the list anew: a log is flown when for 20 s its motors ran
more than half a metre above where they were off, or throughout the log, whatever the estimator says.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

import eivor as ev
from eivor.errors import EivorError
from eivor.flights.grid import upward
from eivor.motions.vertical.select import INPUTS
from eivor.motions.vertical.verdict import comparable_estimates, is_setpoint
from validation.pages import markdown, page_text, page_with
from validation.studies import GridStruct, read_as

SYMBOLS = {"viscous_friction": "K", "input_gain": "K_u", "effective_lag": "lag", "hover_input": "hover"}
#: Lag of the Crazyflie and its standard error [s].
LAG = ev.Prior(0.065, 0.015)
CORPORA = {"trefoil": "trefoils", "nanobench": "other NanoBench", "px4": "PX4", "ardupilot": "ArduPilot"}
IDENTIFIED, ROUGH = "identified", "weak"
#: A log is flown above this height [m] for so long [s].
FLOWN_M, FLOWN_S = 0.5, 20.0
PART = "scoreboard"


class Log(GridStruct, frozen=True):
    """A recording that counts."""

    name: str
    sha256: str
    flown_s: float
    small: bool = False  # Whether it is among the few of `--small`


class Floor(GridStruct, frozen=True):
    """The least that a share may be, of all logs and of the few, and what it is to become."""

    measure: str
    least: float
    least_small: float
    target: float


class Board(GridStruct, frozen=True):
    floors: tuple[Floor, ...]
    logs: tuple[Log, ...]


@dataclass(frozen=True, slots=True)
class Row:
    """One identification; without quantities where there is none."""

    log: str
    mode: Literal["alone", "lag", "half"]
    quantities: Sequence[Sequence[Any]] = ()  # Name, verdict, value, low, high
    own_hover: float | None = None  # The autopilot's estimate, away from its start and limits

    @property
    def corpus(self) -> str:
        return next(name for word, name in CORPORA.items() if word in self.log) + f", {self.mode}"

    @property
    def pair(self) -> str:
        """What it shares with those that it should agree with: its log, or the kind of flight."""
        return self.log if self.mode == "half" else re.sub(r"_rep\d+", "", Path(self.log).stem)

    def of(self, name: str) -> tuple[str, float, float]:
        """Verdict, value and half-width of a quantity."""
        known = (
            (verdict, value, 0.5 * (high - low))
            for item, verdict, value, low, high in self.quantities
            if item == name
        )
        return next(known, ("refused", np.nan, np.nan))


def row_of(
    log: ev.Recording,
    name: str,
    mode: Literal["alone", "lag", "half"],
    lag: ev.Prior | None = None,
    window: tuple[float, float] | None = None,
) -> tuple[Row, tuple[float, float] | None]:
    """An identification, and the seconds that it used."""
    try:
        result = ev.identify_flight(log, ev.FlightOptions(lag=lag, window=window))
    except EivorError:
        return Row(name, mode), None
    flight = result.prepared[0]
    known = {word: result.quantities[word] for word in SYMBOLS}
    quantities = tuple((word, item.verdict.value, item.value, *item.interval) for word, item in known.items())
    own = comparable_estimates(flight) if flight.runs and is_setpoint(flight) else np.empty(0)
    own_hover = float(np.median(own)) if own.size else None
    return Row(name, mode, quantities, own_hover), result.window_s


def rows_of(name: str, path: Path) -> Iterator[Row]:
    log = ev.read_log(path)
    row, used = row_of(log, name, "alone")
    yield row
    if used is not None:
        ends = (used[0], 0.5 * sum(used), used[1])
        yield from (row_of(log, name, "half", window=window)[0] for window in pairwise(ends))
    if "nanobench" in name:
        yield row_of(log, name, "lag", LAG)[0]


def flown_s(log: ev.Recording) -> float:
    """Seconds with motors on, more than half a metre above where they were off."""
    log = upward(log)
    height = log.channels.get("position_z")
    families = [log.family(family.name) for family in INPUTS if not family.measured]
    members = next((members for members in families if members), [])
    if height is None or not members or not np.isfinite(height.values).any():
        return 0.0
    known = np.isfinite(height.values)
    times, values = height.time_s[known], height.values[known]
    level = np.mean([np.interp(times, item.time_s, np.nan_to_num(item.values)) for item in members], axis=0)
    off = level < 0.1 * np.percentile(level, 95)
    on = np.flatnonzero(~off)
    ends = np.concatenate([values[: on[0]], values[on[-1] + 1 :]]) if on.size else values
    up = ~off & (values > (np.quantile(ends, 0.25) + FLOWN_M if ends.size else -np.inf))
    return float(np.minimum(np.diff(times), 1.0)[up[:-1]].sum())


def files(folder: Path) -> dict[str, tuple[Path, str]]:
    """Recordings of a folder by name, each content once, with its hash."""
    results: dict[str, tuple[Path, str]] = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix in (".csv", ".ulg", ".bin", "") and path.stem != "LICENSE":
            sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
            results.setdefault(sha256, (path, str(path.relative_to(folder))))
    return {name: (path, sha256) for sha256, (path, name) in results.items()}


def listed(folder: Path, small: set[str]) -> Iterator[str]:
    """Lines of the list, as the file has them."""
    for name, (path, sha256) in files(folder).items():
        try:
            seconds = flown_s(ev.read_log(path))
        except EivorError:
            continue
        if seconds >= FLOWN_S:
            few = ", small = true" if name in small else ""
            yield f'    {{ name = "{name}", sha256 = "{sha256}", flown_s = {seconds:.0f}{few} }},'


# -- Shares --


def cell(rows: list[Row], name: str) -> str:
    """Counts of verdicts, and pairs that agree of those that are identified or rough."""
    verdicts = [row.of(name)[0] for row in rows]
    identified, rough = (verdicts.count(word) for word in (IDENTIFIED, ROUGH))
    agreed = agreeing(rows, name)
    pairs = f"; {sum(agreed)} of {len(agreed)}" if agreed else ""
    return f"{identified} / {rough} / {len(rows) - identified - rough}{pairs}"


def agreeing(rows: list[Row], name: str) -> list[bool]:
    """Whether pairs agree, of those that are identified or rough."""
    pairs = [[row.of(name) for row in pair] for pair in combinations(rows, 2) if pair[0].pair == pair[1].pair]
    known = [(a, b) for a, b in pairs if {a[0], b[0]} <= {IDENTIFIED, ROUGH}]
    return [bool(abs(a[1] - b[1]) <= np.hypot(a[2], b[2])) for a, b in known]


def measures(rows: list[Row]) -> dict[str, list[bool]]:
    """What the floors speak of, by the words of the file: one answer for each log or pair."""
    alone = [row for row in rows if row.mode == "alone"]
    hover = [row.of("hover_input") for row in alone]
    return {
        "hover identified": [verdict == IDENTIFIED for verdict, *_ in hover],
        "hover identified or within 5 %": [verdict in (IDENTIFIED, ROUGH) for verdict, *_ in hover],
        "hover within 3 % of the autopilot's own": [
            abs(value / row.own_hover - 1.0) <= 0.03
            for row, (verdict, value, _) in zip(alone, hover, strict=True)
            if row.own_hover and verdict != "refused"
        ],
        "a quantity identified": [any(row.of(name)[0] == IDENTIFIED for name in SYMBOLS) for row in alone],
        "hover of halves agrees": agreeing([row for row in rows if row.mode == "half"], "hover_input"),
        "hover of repeats agrees": agreeing([row for row in alone if "nanobench" in row.log], "hover_input"),
    }


def below(rows: list[Row], floors: Sequence[Floor], *, small: bool) -> Iterator[str]:
    """Sentences of the shares that fell below their floor."""
    shares = measures(rows)
    for floor in floors:
        least, answers = floor.least_small if small else floor.least, shares[floor.measure]
        if answers and np.mean(answers) < least:
            yield f"{floor.measure}: {np.mean(answers):.0%} of {len(answers)}, and {least:.0%} is the floor."


def tables(rows: list[Row], floors: Sequence[Floor], *, small: bool = False) -> str:
    corpora, answers = defaultdict[str, list[Row]](list), measures(rows)
    for row in rows:
        corpora[row.corpus].append(row)
    lines = [[corpus, *(cell(here, name) for name in SYMBOLS)] for corpus, here in corpora.items()]
    shares = [
        [floor.measure, f"{sum(yes)} of {len(yes)}", f"{least:.0%}", f"{floor.target:.0%}"]
        for floor in floors
        for yes, least in [(answers[floor.measure], floor.least_small if small else floor.least)]
    ]
    title = "Identified / rough / not; pairs of repeats or halves that agree."
    head = ["share of logs flown, or of pairs", "now", "floor", "target"]
    return "\n\n".join([markdown(head, shares), title, markdown(["logs", *SYMBOLS.values()], lines)])


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser("validation.real_logs.scoreboard", description=__doc__)
    parser.add_argument("--small", action="store_true", help="the few logs that are marked so")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="page with the marks of the tables")
    parser.add_argument("--list", action="store_true", help="print the list of logs flown")
    chosen, known = parser.parse_args(arguments), read_as(Board, Path(__file__).with_suffix(".toml"))
    logs = [log for log in known.logs if log.small or not chosen.small]
    folder = Path(os.environ["EIVOR_DATA"])
    if chosen.list:
        print("\n".join(listed(folder, {log.name for log in known.logs if log.small})))
        return 0
    paths = {sha256: path for path, sha256 in files(folder).values()}
    rows = [row for log in logs if log.sha256 in paths for row in rows_of(log.name, paths[log.sha256])]
    text = tables(rows, known.floors, small=chosen.small)
    if chosen.page:
        chosen.page.write_text(page_with(page_text(chosen.page, PART), {PART: text}), encoding="utf-8")
    print(text)
    failures = [f"{log.name} is not in {folder}." for log in logs if log.sha256 not in paths]
    failures += below(rows, known.floors, small=chosen.small)
    print("\n".join(failures))
    return 3 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
