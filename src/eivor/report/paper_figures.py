"""Counterparts of the paper's figures 2 to 8 under one reading, as SVG and PNG."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from matplotlib.figure import Figure

from eivor.report.flight_figure import save_figure
from eivor.report.given_axes import GivenAxes
from eivor.report.signal_figures import signals_figure
from eivor.report.study_figures import nrmse_figure
from eivor.signals.signals import Signals
from eivor.studies.paper.examples import PaperResult, trial_generator
from eivor.studies.paper.readings import EXAMPLES, PRINTED_METHODS, SCORES, Example, Reading
from eivor.studies.paper.trials import integrated_height, record

FORMATS = ("svg", "png")
NAMES = tuple(f"figure-{number}" for number in range(2, 9))
#: What the columns of the printed tables are called in figures.
WORDS = {"LS": "least squares", "IV": "extended IV", "GIV": "generalized IV"}


def write_figures(results: Sequence[PaperResult], folder: Path) -> tuple[Path, ...]:
    """Write figures 2 to 8, each as SVG and PNG.

    Parameters
    ----------
    results : sequence of PaperResult
        Both examples under one reading.
    folder : Path
        Where to; it exists.

    Returns
    -------
    tuple of Path
        What was written.

    Raises
    ------
    OSError
        When a file cannot be written.
    """
    written = []
    for name, figure in paper_figures(results):
        for path in figure_files(folder, name):
            save_figure(figure, path)
            written.append(path)
    return tuple(written)


def figure_files(folder: Path, *names: str) -> tuple[Path, ...]:
    """Files of the figures of these names; without names, of all."""
    return tuple(folder / f"{name}.{ending}" for name in names or NAMES for ending in FORMATS)


def paper_figures(results: Sequence[PaperResult]) -> Iterator[tuple[str, Figure]]:
    """Figures 2 to 8 by name."""
    first = results[0]
    yield "figure-2", signal_figure(first.reading, first.example)
    number = 3
    for result in results:
        for column in PRINTED_METHODS:
            yield f"figure-{number}", histogram_figure(result, column)
            number += 1


def signal_figure(
    reading: Reading, example: Example = EXAMPLES[0], *, axes: GivenAxes | None = None
) -> Figure:
    """Input u(t) and height z(t) of the first run, without noise: the paper's figure 2.

    `axes` are for "input" and "position_z", see `signals_figure`.
    """
    exact = replace(reading, motion=type(reading.motion).SOLUTION)
    truth = record(exact, example, trial_generator(0)).truth
    drive, velocity = truth.channels["input"], truth.channels["velocity_z"]
    height = integrated_height(velocity, drive, intersample=reading.intersample)
    shown = Signals(truth.rate_hz, {"input": drive, "position_z": height})
    title = f"Reading {reading.name}: input and height of the first run"
    return signals_figure(shown, title="" if axes is not None else title, axes=axes)


def histogram_figure(result: PaperResult, column: str, *, axes: GivenAxes | None = None) -> Figure:
    """Histograms of NRMSE of one column of the printed tables: the paper's figures 3 to 8.

    `axes` are for K, K_u and both together, in this order; see `nrmse_figure`.
    """
    method = PRINTED_METHODS[column]
    scores = result.nrmse(method)
    words = WORDS[column]
    printed = dict(zip(SCORES, result.example.printed[method], strict=True))
    title = (
        f"Example {result.example.number}, {words}, reading {result.reading.name} "
        f"({len(result.estimates)} runs; red: printed mean ± SD)"
    )
    return nrmse_figure(
        {words: {name: scores[:, place] for place, name in enumerate(SCORES)}},
        printed={words: printed},
        title=title if axes is None else "",
        axes=axes,
    )
