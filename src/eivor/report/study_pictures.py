"""The pictures that `eivor study --figures` leaves beside the trials."""

from __future__ import annotations

from pathlib import Path

from eivor.report.coverage_figures import study_coverage_figure
from eivor.report.flight_figure import save_figure
from eivor.report.study_figures import study_figure
from eivor.studies.run import StudyResult

FORMATS = ("svg", "png")
NAMES = ("nrmse", "coverage")


def write_study_figures(result: StudyResult) -> tuple[Path, ...]:
    """Write histograms of NRMSE and, where intervals were recorded, their coverage, as SVG and PNG.

    Parameters
    ----------
    result : StudyResult
        A finished study; the files go into its folder.

    Returns
    -------
    tuple of Path
        What was written.

    Raises
    ------
    OSError
        When a file cannot be written.
    """
    figures = {"nrmse": study_figure(result)}
    if result.study.intervals:
        figures["coverage"] = study_coverage_figure([result], title=f"Coverage: {result.study.name}")
    written = []
    for name, figure in figures.items():
        for path in picture_files(result.folder, name):
            save_figure(figure, path)
            written.append(path)
    return tuple(written)


def picture_files(folder: Path, *names: str) -> tuple[Path, ...]:
    """Files of the pictures of these names; without names, of all that there can be."""
    return tuple(folder / f"{name}.{ending}" for name in names or NAMES for ending in FORMATS)
