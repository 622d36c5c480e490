"""The table of files that a plan is written as, by their words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from eivor.planning.plan import FlightPlan
from eivor.planning.written.mission import qgc_text
from eivor.planning.written.offboard import mavsdk_text
from eivor.planning.written.table import csv_text
from eivor.planning.written.trajectory import rotorpy_text

#: Latitude and longitude [deg].
Place = tuple[float, float]


@dataclass(frozen=True, slots=True)
class WrittenPlan:
    """A kind of file.

    Parameters
    ----------
    name : str
        Its word on the command line.
    words : str
        What the file is.
    file : str
        How such a file may be called.
    of_plan : callable or None
        From a plan to the file's text; None of a mission.
    of_place : callable or None
        From a plan of steps and a place to the text, of a mission, which has levels only and is at a place.
    """

    name: str
    words: str
    file: str
    of_plan: Callable[[FlightPlan], str] | None = None
    of_place: Callable[[FlightPlan, Place], str] | None = None

    def text(self, plan: FlightPlan, place: Place | None) -> str:
        """Content of the file; a mission has the place too."""
        if self.of_place is not None and place is not None:
            return self.of_place(plan, place)
        if self.of_plan is None:
            raise TypeError(f"a plan for {self.name} without a place")
        return self.of_plan(plan)


WRITTEN: dict[str, WrittenPlan] = {
    one.name: one
    for one in (
        WrittenPlan("csv", "table of setpoints", "setpoints.csv", csv_text),
        WrittenPlan("mavsdk", "MAVSDK program that flies it", "fly_plan.py", mavsdk_text),
        WrittenPlan("qgc", "QGroundControl plan", "flight.plan", of_place=qgc_text),
        WrittenPlan("rotorpy", "trajectory of RotorPy", "trajectory.py", rotorpy_text),
    )
}
