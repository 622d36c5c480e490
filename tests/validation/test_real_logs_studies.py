"""Logs as they are: the simulator's physics and loggers, the study's requirements, bounds of pools."""

from __future__ import annotations

import pytest
from msgspec.structs import replace as struct_replace

from validation.real_logs import study
from validation.real_logs.study import far_off
from validation.real_logs.trials import folder_of, published_grid

GRID = published_grid()


@pytest.mark.calibration
def test_small_size(tmp_path):
    """A few flights of the families of clocks: accepted, and few intervals miss."""
    grid = study.part_of(GRID, 0.025, "r")
    families = tuple(
        family
        for family in grid.families
        if family.holds == "yes" and family.flight(0).duration < 100.0 and not family.flight(0).multirotor
    )
    folder = folder_of(tmp_path, struct_replace(grid, families=families[:3]))
    folder.run(1)
    table = folder.gathered().rows
    assert table.height >= 12
    assert (table["verdict"] == "identified").mean() > 0.6
    assert far_off(table).value < 0.2
