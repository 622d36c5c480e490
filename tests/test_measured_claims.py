"""Numbers that the README and the pages state of the example flight are what the code gives."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import eivor as ev
from benchmarks import check
from eivor.motions.vertical.regression import VerticalFlights

ROOT = Path(__file__).resolve().parents[1]


def words(*path: str) -> str:
    return " ".join(ROOT.joinpath(*path).read_text(encoding="utf-8").split())


@pytest.fixture(scope="module")
def example() -> ev.FlightEstimate:
    return ev.identify_flight(ev.example_flight())


def fitted(example: ev.FlightEstimate, lag_s: float) -> tuple[float, float]:
    """Friction by least squares of all samples with that lag, and its R squared."""
    assert example.fit is not None
    problem = example.fit.problem
    assert isinstance(problem, VerticalFlights)
    (flight,) = problem.flights
    mapped = flight.mapped_input(problem.motion, lag_s, 0.0)
    rows = np.column_stack([-flight.velocity, mapped, np.ones(mapped.size)])
    theta = np.linalg.lstsq(rows, flight.acceleration, rcond=None)[0]
    residual = flight.acceleration - rows @ theta
    return float(theta[0]), 1.0 - float(residual.var() / flight.acceleration.var())


@pytest.mark.thorough
def test_least_squares_without_the_lag_is_negative(example):
    friction, explained = fitted(example, 0.0)
    readme, page = words("README.md"), words("docs", "method.md")
    share, stated = re.findall(r"explains (\d+) % of the acceleration .* friction of (-[\d.]+) 1/s", readme)[
        0
    ]
    assert (float(share), float(stated)) == pytest.approx((100.0 * explained, friction), rel=0.02)
    stated, share = re.findall(r"friction of (-[\d.]+) 1/s at \$R\^2 = ([\d.]+)\$", page)[0]
    assert (float(stated), float(share)) == pytest.approx((friction, explained), rel=0.02)
    with_lag = re.findall(r"With the lag \$R\^2\$ is ([\d.]+)", page)[0]
    assert float(with_lag) == pytest.approx(fitted(example, 0.072)[1], abs=0.006)


@pytest.mark.thorough
def test_a_wrong_map_shows_in_the_intercept(example):
    wrong = ev.identify_flight(ev.example_flight(), ev.FlightOptions(input_map="power:1.5"))
    stated = re.findall(
        r"`power:1.5` for `square` gives the example flight (-[\d.]+)", words("docs", "method.md")
    )[0]
    assert wrong.parameters["intercept"] == pytest.approx(float(stated), abs=0.06)
    assert abs(example.parameters["intercept"]) < 0.1


def test_the_check_of_benchmarks_reads_every_row_and_sees_what_is_slower(capsys):
    written = check.written_ratios(ROOT.joinpath("benchmarks", "README.md").read_text(encoding="utf-8"))
    for script, rows in check.RATIOS.items():
        assert ROOT.joinpath("benchmarks", f"{script}.py").exists()
        for begins in rows:
            assert any(of == script and row.startswith(begins) for of, row in written), begins
    rows = ["| `python benchmarks/report.py` | the page of a report | 1 s | | 0.1-0.2 | | |"]
    rows += ["| | with every method | 1 s | | 1/4 | | |"]
    written_ratios = check.written_ratios("\n".join(rows))
    assert written_ratios == {("report", "the page of a report"): 0.2, ("report", "with every method"): 0.25}
    printed = "one method: page; ratio 0.29; x\nevery method: page; ratio 0.38; x\n"
    assert check.exceeded("report", printed, written_ratios) == ["report, with every method"]
