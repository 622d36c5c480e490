"""Study: bias, spread and coverage of fractional difference equations' coefficients and orders.

    python -m validation.fractional.study --runs 1000 [--page docs/fractional-equations.md]

Every run draws a record of a known equation with noise on input and output, 40 dB below each signal, and
asks each method of the paper for coefficients, order and 95 % intervals.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

import eivor as ev
from eivor.errors import EstimationError, WeakInstrumentsWarning
from eivor.shapes import Float
from eivor.studies.generated_page import markdown, page_text, page_with
from eivor.whole_file import write_whole
from validation.fractional.records import Cell, KnownEquation, Relaxation, Way, ways

PART = "fractional study"
SCENARIOS: tuple[KnownEquation, ...] = (Relaxation(), Cell())
HEADER = ("method", "answers", "parameter", "truth", "bias %", "sd %", "largest error", "coverage")


def answers(
    scenario: KnownEquation, way: Way, seeds: Sequence[int]
) -> Float[np.ndarray, "answers parameters 2"]:
    """Error of each parameter, and whether its interval covers the truth; one line for each answer."""
    lines = []
    for seed in seeds:
        problem = scenario.model.problem(
            scenario.record(seed), way.instruments, divided_by_output_at=scenario.guess
        )
        try:
            found = ev.identify(problem, way.method)
        except EstimationError:
            continue
        line = []
        for name, value in scenario.truth.items():
            low, high = found.interval(name)
            line.append((found.parameters[name] - value, float(low <= value <= high)))
        lines.append(line)
    return np.array(lines).reshape(-1, len(scenario.truth), 2)


def lines_of(scenario: KnownEquation, runs: int) -> Iterator[tuple[str, ...]]:
    """Lines of a scenario's table."""
    for name, way in ways().items():
        found = answers(scenario, way, range(runs))
        for place, (parameter, value) in enumerate(scenario.truth.items()):
            errors, covered = found[:, place, 0], found[:, place, 1]
            yield (
                f"`{name}`" if place == 0 else "",
                f"{len(found)}" if place == 0 else "",
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
            + markdown(HEADER, lines_of(scenario, runs))
            for scenario in SCENARIOS
        )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m validation.fractional.study", description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--runs", type=int, default=20, help="seeds of each scenario")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="put the tables between its marks")
    chosen = parser.parse_args(arguments)
    page = page_text(chosen.page, PART) if chosen.page else ""
    made = tables(chosen.runs)
    if chosen.page:
        write_whole(chosen.page, page_with(page, {PART: made}))
    sys.stdout.write(made + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
