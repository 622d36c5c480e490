"""A search through every combination of what the paper's text leaves open.

    python -m validation.paper.search [--runs 10] [--workers N] [--page FILE.md]

runs example 1 under each of them and prints, as Markdown, those that come nearest to the printed table 1,
and how far extended IV gets where least squares is as printed; `--page` puts it between the page's marks.
No number is fitted: the axes below hold alternatives only. A few minutes on two cores.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np
from jaxtyping import Float

from eivor.lab.paper import (
    EXAMPLES,
    PRINTED_METHODS,
    SOURCES,
    Input,
    MotionSource,
    PaperReading,
    PaperResult,
    Ratio,
    RatioOf,
    Weights,
    estimates,
    record,
    trial_generator,
)
from eivor.lab.records import Intersample
from eivor.process_pool import in_order, local_executor
from validation.pages import markdown
from validation.studies import WORKERS, Option, StudyCommand

RUNS = 10
PLOTTED = 6
#: Least squares is as printed when its means are off by less than this factor.
AS_PRINTED = 1.1
#: n of (21) and (28), and whether generalized IV has as many instruments as extended IV.
INSTRUMENTS = ((2, True), (2, False), (3, False), (5, False), (10, False), (20, False))


@dataclass(frozen=True, slots=True)
class Tried:
    """A combination, and how far it is from table 1."""

    reading: PaperReading  # The combination
    means: Float[np.ndarray, "columns parameters"]  # NRMSE of K and K_u in percent, for LS, IV and GIV
    spreads: Float[np.ndarray, "columns parameters"]
    total_least_squares: bool  # IV and GIV in the forms that are solved by total least squares

    def off_by(self, columns: Sequence[int], *, spreads: bool) -> float:
        """Typical factor between measured and printed in some columns of the table."""
        rows, (means, stds) = list(columns), printed_table()
        logs = [np.log(self.means[rows] / means[rows])]
        if spreads:
            logs.append(np.log(self.spreads[rows] / stds[rows]))
        return float(np.exp(np.mean(np.abs(logs))))


def printed_table() -> tuple[
    Float[np.ndarray, "columns parameters"], Float[np.ndarray, "columns parameters"]
]:
    """Means and SDs of table 1 for K and K_u."""
    rows = [EXAMPLES[0].printed[method][:2] for method in PRINTED_METHODS.values()]
    means = np.array([[spread.mean for spread in row] for row in rows])
    return means, np.array([[spread.std for spread in row] for row in rows])


def simulations() -> Iterator[PaperReading]:
    axes = product(Input, MotionSource, Intersample, (0.02, 0.02**2), Ratio, SOURCES, RatioOf, Weights)
    for drive, motion, between, variance, ratio, larger, of, weights in axes:
        if drive is Input.WHITE:
            continue  # the text has (35)
        yield PaperReading(
            "",
            "",
            input=drive,
            motion=motion,
            intersample=between,
            input_variance=variance,
            ratio=ratio,
            larger_on=larger,
            ratio_of=of,
            weights=weights,
        )


def try_simulation(reading: PaperReading, runs: int) -> list[Tried]:
    """Every choice of instruments on the same records; those with which every method gives estimates."""
    signals = [record(reading, EXAMPLES[0], trial_generator(index)).signals for index in range(runs)]
    trieds: list[Tried] = []
    for lags, as_many in INSTRUMENTS:
        chosen = replace(reading, lags=lags, as_many=as_many)
        each = [estimates(chosen, signal) for signal in signals]
        theta, weak = np.array([item.theta for item in each]), np.array([item.weak for item in each])
        trieds.extend(_tried(PaperResult(chosen, EXAMPLES[0], theta, weak)))
    return trieds


def _tried(result: PaperResult) -> Iterator[Tried]:
    for offset in (0, 1):
        rows = [
            result.spreads(method.replace("_iv", "_iv_tls") if offset else method)[:2]
            for method in PRINTED_METHODS.values()
        ]
        means = np.array([[spread.mean for spread in row] for row in rows])
        stds = np.array([[spread.std for spread in row] for row in rows])
        if np.isfinite(means).all() and np.isfinite(stds).all():
            yield Tried(result.reading, means, stds, bool(offset))


def search(runs: int = RUNS, workers: int | None = None) -> list[Tried]:
    readings = list(simulations())
    parts = local_executor(workers, len(readings)).map(partial(try_simulation, runs=runs), readings)
    return [tried for part in in_order(parts) for tried in part]


def search_page(tried: Sequence[Tried], runs: int) -> str:
    whole, some = (0, 1, 2), (0, 2)
    near = [item for item in tried if item.off_by((0,), spreads=False) < AS_PRINTED]
    parts = [
        f"Made by `python -m validation.paper.search`: {len(tried)} combinations of record, instruments "
        f"and solver, {runs} runs of example 1 each.",
        "**Nearest in the means of all three columns**",
        _table(tried, lambda item: item.off_by(whole, spreads=False)),
        "**Nearest in means and SDs of all three columns**",
        _table(tried, lambda item: item.off_by(whole, spreads=True)),
        "**Nearest in means and SDs of LS and GIV, whatever IV does**",
        _table(tried, lambda item: item.off_by(some, spreads=True)),
        f"**Worst extended IV among the {len(near)} combinations whose LS means are as printed (to 10 %)**",
        _table(near, lambda item: item.off_by((1,), spreads=False)),
    ]
    return "\n\n".join(parts)


def _table(tried: Sequence[Tried], off: Callable[[Tried], float]) -> str:
    header = ("combination", "LS K / K_u", "IV K / K_u", "GIV K / K_u", "off by")
    means, spreads = printed_table()
    rows = [("**printed**", *(_cell(means[i], spreads[i]) for i in range(3)), "")]
    for item in sorted(tried, key=off)[:PLOTTED]:
        cells = (_cell(item.means[i], item.spreads[i]) for i in range(3))
        rows.append((_words(item), *cells, f"{off(item):.3g}"))
    return markdown(header, rows)


def _cell(means: Float[np.ndarray, " parameters"], spreads: Float[np.ndarray, " parameters"]) -> str:
    return " / ".join(f"{mean:.3g} ± {std:.2g}" for mean, std in zip(means, spreads, strict=True))


def _words(tried: Tried) -> str:
    reading = tried.reading
    last = reading.lags - 1 if reading.as_many else reading.lags
    larger = {"velocity_z": "z'", "acceleration_z": "z''", "input": "u"}.get(reading.larger_on, "e")
    return "; ".join(
        [
            reading.motion.value,
            f"input {'held' if reading.intersample is Intersample.HOLD else 'linear'}, {reading.input.value}",
            f"0.02 the {'variance' if reading.input_variance == 0.02 else 'SD'}",
            f"ratios of {reading.ratio.value}, 1e-2 on {larger}",
            f"of {'the white sequence' if reading.ratio_of is RatioOf.WHITE else 'the fractional noise'}",
            f"weights {reading.weights.value}",
            f"lags 1-{reading.lags} and 0-{last}",
            "TLS" if tried.total_least_squares else "LS",
        ]
    )


OPTIONS: dict[str, Option] = {
    "--runs": {"type": int, "default": RUNS, "help": "of each combination"},
    "--workers": WORKERS,
}
main = StudyCommand(
    "validation.paper.search",
    __doc__,
    "search",
    lambda chosen: (search_page(search(chosen.runs, chosen.workers), chosen.runs), ()),
    OPTIONS,
).main

if __name__ == "__main__":
    sys.exit(main())
