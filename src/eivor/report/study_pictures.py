"""The pictures that `eivor study --figures` leaves beside the trials."""

from __future__ import annotations

from pathlib import Path

from eivor.report.coverage_figures import study_coverage_figure
from eivor.report.flight_figure import save_figure
from eivor.report.study_figures import study_figure
from eivor.studies.run import StudyResult

FORMATS = ("svg", "png")


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
        for ending in FORMATS:
            written.append(result.folder / f"{name}.{ending}")
            save_figure(figure, written[-1])
    return tuple(written)
