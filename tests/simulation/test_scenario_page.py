"""The page of the scenario files holds what the registry holds, and what it shows can be read."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from eivor.lab.experiments import page_with
from eivor.lab.records import simulate
from eivor.lab.scenario_files import KINDS, read_flight, read_rigid_body_flight, read_scenario
from eivor.simulation.rigid_body import simulate_rigid_body_flights
from eivor.simulation.vertical import simulate_vertical_flights

pytest.importorskip("griffe")

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGE = (DOCS / "studies" / "scenarios.md").read_text(encoding="utf-8")


def test_tables_are_fresh():
    parts = runpy.run_path(str(DOCS / "scenario_tables.py"))["parts"]()
    assert page_with(PAGE, parts) == PAGE, "run docs/scenario_tables.py"


def test_every_kind_has_a_row():
    rows = re.findall(r"^\| `(\w+)` \|", PAGE, flags=re.MULTILINE)
    for kinds in KINDS.values():
        assert set(kinds) <= set(rows)


@pytest.mark.thorough
def test_examples_are_read_and_simulated(tmp_path):
    examples = re.findall(r"^```toml\n(.*?)^```", PAGE, flags=re.MULTILINE | re.DOTALL)
    about_hover, trends, flight, whole = examples[:4]  # then those of studies
    path = tmp_path / "mine.toml"
    (tmp_path / "mine.csv").write_text("a1\n" + "0.5\n-0.5\n" * 50, encoding="utf-8")
    path.write_text(f"viscous_friction = 0.3\ninput_gain = 0.02\nsamples = 100\n{trends}", encoding="utf-8")
    assert simulate(read_scenario(path), np.random.default_rng(0)).signals.sample_count == 100
    path.write_text(about_hover, encoding="utf-8")
    record = simulate(read_scenario(path), np.random.default_rng(0))
    assert record.signals.sample_count == 4000
    path.write_text(flight, encoding="utf-8")
    (flights,) = simulate_vertical_flights([read_flight(path)])
    assert flights.flew
    path.write_text(whole.replace("duration = 30.0", "duration = 2.0"), encoding="utf-8")
    (flight_of_all,) = simulate_rigid_body_flights([read_rigid_body_flight(path)])
    assert flight_of_all.flew
