"""Flights of known truth, as firmwares of ArduPilot log them: identified, and the intervals hold it."""

import pytest
from dataflash_writer import flight_log, simulated

import eivor as ev
from eivor.errors import EivorError
from eivor.inference.verdict import Status


@pytest.mark.thorough
@pytest.mark.parametrize("dialect", ["3.4", "4.6"])
def test_the_truth_is_in_the_intervals(tmp_path, dialect):
    flight = simulated(seed=3, duration=60.0)
    path = tmp_path / "flight.bin"
    path.write_bytes(flight_log(flight, dialect).bytes())
    fit = ev.identify_flight(ev.read_log(path))
    assert fit.verdict.status is Status.IDENTIFIED
    truth = {"viscous_friction": 0.4, "input_gain": 39.2266, "effective_lag": 0.04, "hover_input": 0.25}
    for name, value in truth.items():
        low, high = fit.quantities[name].interval
        assert low <= value <= high, name


def test_a_plane_is_refused(tmp_path):
    path = tmp_path / "plane.bin"
    path.write_bytes(
        flight_log(simulated(seed=3, duration=5.0), vehicle="ArduPlane V4.5.7 (0358a9c2)").bytes()
    )
    with pytest.raises(EivorError, match="fixed wing"):
        ev.identify_flight(ev.read_log(path))
