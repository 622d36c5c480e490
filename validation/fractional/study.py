"""Study: bias, spread and coverage of fractional difference equations' coefficients and orders.

    python -m validation.fractional.study --runs 1000 [--sharper] [--page docs/fractional-equations.md]

Every run draws a record of a known equation with noise on input and output, 40 dB below each signal, and
asks each method of the paper for coefficients, order and 95 % intervals.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from eivor.atomic_file import write_atomically
from eivor.errors import EstimationError, WeakInstrumentsWarning
from eivor.lab.experiments import markdown, page_text, page_with
from eivor.tools import Float
from validation.fractional.records import Cell, Formula, KnownEquation, Relaxation, formulas, sharper_ways

PART, SHARPER_PART = "fractional study", "sharper orders"
SCENARIOS: tuple[KnownEquation, ...] = (Relaxation(), Cell())
HEADER = ("method", "answers", "parameter", "truth", "bias %", "sd %", "largest error", "coverage")


def answers(
    scenario: KnownEquation, formula: Formula, seeds: Sequence[int]
) -> Float[np.ndarray, "answers parameters 2"]:
    """Error of each parameter, and whether its interval covers the truth; one line for each answer."""
    lines = []
    for seed in seeds:
        try:
            result = formula.estimate(scenario, scenario.record(seed))
        except EstimationError:
            continue
        line = []
        for name, value in scenario.truth.items():
            low, high = result.interval(name)
            line.append((result.parameters[name] - value, float(low <= value <= high)))
        lines.append(line)
    return np.array(lines).reshape(-1, len(scenario.truth), 2)


def lines_of(scenario: KnownEquation, runs: int, chosen: Mapping[str, Formula]) -> Iterator[tuple[str, ...]]:
    """Lines of a scenario's table."""
    for name, formula in chosen.items():
        result = answers(scenario, formula, range(runs))
        for index, (parameter, value) in enumerate(scenario.truth.items()):
            errors, covered = result[:, index, 0], result[:, index, 1]
            yield (
                f"`{name}`" if index == 0 else "",
                f"{len(result)}" if index == 0 else "",
                f"`{parameter}`",
                f"{value:.4g}",
                f"{100.0 * errors.mean() / value:+.2f}",
                f"{100.0 * errors.std() / abs(value):.2f}",
                f"{np.abs(errors).max():.4f}",
                f"{100.0 * covered.mean():.1f} %",
            )


def tables(runs: int) -> str:
    """Tables of all scenarios."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WeakInstrumentsWarning)
        return "\n\n".join(
            f"**{scenario.name}**: {scenario.about}; {runs:,} runs.\n\n"
            + markdown(HEADER, lines_of(scenario, runs, formulas()))
            for scenario in SCENARIOS
        )


def sharper(runs: int) -> str:
    """Table of the cell by ways that tell its order better."""
    cell = Cell()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", WeakInstrumentsWarning)
        return f"**cell**, {runs:,} runs.\n\n" + markdown(HEADER, lines_of(cell, runs, sharper_ways()))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m validation.fractional.study", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--runs", type=int, default=20, help="seeds of each scenario")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="put the tables between its marks")
    parser.add_argument(
        "--sharper", action="store_true", help="the cell with further lags, or a second round"
    )
    chosen = parser.parse_args(arguments)
    part, make = (SHARPER_PART, sharper) if chosen.sharper else (PART, tables)
    page = page_text(chosen.page, part) if chosen.page else ""
    made = make(chosen.runs)
    if chosen.page:
        write_atomically(chosen.page, page_with(page, {part: made}))
    sys.stdout.write(made + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
