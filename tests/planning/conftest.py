"""A plan without its simulations: shapes and limits, and half-widths that were written down."""

from __future__ import annotations

from importlib.util import module_from_spec, spec_from_file_location

import pytest

import eivor as ev
from eivor.planning.plan import ExpectedInterval, mavsdk_text
from eivor.planning.vehicle import candidates

LIMITS = ev.FlightLimits(duration_s=30.0)


def planned(kind):
    """The first shape of that kind."""
    shape = next(candidates(LIMITS, (kind,), 0))
    predicted = {
        word: ExpectedInterval(width, value, (ev.Status.IDENTIFIED, ev.Status.WEAK))
        for word, width, value in (("friction", 0.05, 0.3), ("gain", 1.2, 100.0), ("lag", 3.0, 50.0))
    }
    return ev.FlightPlan(ev.VehicleGuess(), LIMITS, "friction", shape, predicted, (4.0, 7.0, 1.5))


def program_text(plan):
    """The program that `eivor plan -o flight.py` writes."""
    return mavsdk_text(plan)


def written_module(text, folder):
    """The text as a module, from a file."""
    path = folder / "written.py"
    path.write_text(text, encoding="utf-8")
    spec = spec_from_file_location("written", path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def multisine():
    return planned("multisine")


@pytest.fixture(scope="session")
def steps():
    return planned("steps")
