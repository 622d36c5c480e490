"""Logs as they are: the simulator's physics and loggers, the study's requirements, bounds of pools."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace as struct_replace

from flights.flight_logs import recording
from validation.real_logs import scoreboard, study
from validation.real_logs.study import far_off
from validation.real_logs.trials import folder_of, published_grid

GRID = published_grid()


@pytest.mark.calibration
def test_small_size(tmp_path):
    """A few flights of the families of clocks: accepted, and few intervals miss."""
    grid = study.part_of(GRID, 0.012, "r")
    families = tuple(
        family
        for family in grid.families
        if family.holds == "yes" and family.flight(0).duration < 100.0 and not family.flight(0).multirotor
    )
    folder = folder_of(tmp_path, struct_replace(grid, families=families[:3]))
    folder.run(1)
    table = folder.gathered().rows
    assert table.height >= 6
    assert (table["verdict"] == "identified").mean() > 0.6
    assert far_off(table).value < 0.2


def test_the_scoreboard_counts_what_was_flown_and_names_what_fell():
    time = 0.1 * np.arange(400)
    columns = {"position_z": 2.0 * (abs(time - 20.0) < 12.0), "input": 0.5 * (abs(time - 20.0) < 15.0)}
    assert scoreboard.flown_s(recording(columns, time_s=time)) == pytest.approx(24.0, abs=0.3)
    rows = [
        scoreboard.Row("px4/a.ulg", "alone", (("hover_input", "identified", 0.5, 0.49, 0.51),)),
        scoreboard.Row("px4/b.ulg", "alone"),
    ]
    floors = [scoreboard.Floor(measure="hover identified", least=0.6, least_small=0.4, target=0.9)]
    assert list(scoreboard.below(rows, floors, small=True)) == []
    (sentence,) = scoreboard.below(rows, floors, small=False)
    assert sentence == "hover identified: 50% of 2, and 60% is the floor."
