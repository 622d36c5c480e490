"""Rows of the study in a folder."""

from __future__ import annotations

from pathlib import Path

from validation.real_logs.grid import Grid
from validation.real_logs.trials import Task, interleaved
from validation.study_folder import StudyFolder


def folder_of(path: Path, grid: Grid) -> StudyFolder[Task]:
    """Folder that keeps the rows of the grid's tasks."""
    planned = sum(family.count * family.pool for family in grid.families)
    return StudyFolder(
        path, interleaved(grid.families), grid.name, grid.text, "validation.real_logs", planned
    )
