"""Flights of known truth, as firmwares of ArduPilot log them: identified, and the intervals hold it."""

import numpy as np
import pytest
from dataflash_writer import flight_log, simulated

import eivor as ev
from eivor.cli.main import app
from eivor.inference.verdict import Status
from eivor.signals.recording import Channel, Recording

TRUTH = {"viscous_friction": 0.4, "input_gain": 39.2266, "effective_lag": 0.04, "hover_input": 0.25}
LOITER, SYSTEM_IDENTIFICATION, THROTTLE_AXIS = 5, 25, 13


def identified(tmp_path, writer):
    """The fit of a log, which must be told and hold the truth."""
    path = tmp_path / "flight.bin"
    path.write_bytes(writer.bytes())
    fit = ev.identify_flight(ev.read_log(path))
    assert fit.verdict.status is Status.IDENTIFIED
    for name, value in TRUTH.items():
        low, high = fit.quantities[name].interval
        assert low <= value <= high, name
    return fit


@pytest.mark.thorough
@pytest.mark.parametrize("dialect", ["3.4", "4.1", "4.6"])
def test_the_truth_is_in_the_intervals(tmp_path, dialect):
    identified(tmp_path, flight_log(simulated(seed=3, duration=60.0), dialect))


def swept(seconds=80.0, start=12.0, end=70.0):
    """A flight that holds its height in gusts, and in between sweeps the throttle of a resting stick."""
    rng, step, gain, lag = np.random.default_rng(0), 0.0025, TRUTH["input_gain"], TRUTH["effective_lag"]
    time = np.arange(round(seconds / step)) * step
    within = (time >= start) & (time < end)
    sweep = 0.08 * np.sin(2.0 * np.pi * (0.05 * (time - start) + 0.98 / (end - start) * (time - start) ** 2))
    sweep = np.where(within, sweep, 0.0)
    kept, gust, height, speed, state, rows = np.exp(-step), 0.0, 5.0, 0.0, 0.25, []
    gusts = 0.3 * np.sqrt(1.0 - kept**2) * rng.standard_normal(time.size)
    for k in range(time.size):
        if k % 4 == 0:
            gains = (0.003, 0.002) if within[k] else (0.02, 0.04)
            requested = 0.25 + gains[0] * (5.0 - height) - gains[1] * speed + sweep[k]
        gust = kept * gust + gusts[k]
        climb = gain * state - 9.80665 - TRUTH["viscous_friction"] * (speed - gust)
        rows.append((height, speed, climb + 9.80665, requested))
        state += (requested - state) * (1.0 - np.exp(-step / lag))
        speed, height = speed + step * climb, height + step * speed
    time, sweep, within = time[::4], sweep[::4], within[::4]
    height, speed, force, requested = np.array(rows[::4]).T
    values = {"position_z": height, "velocity_z": speed + 0.02 * rng.standard_normal(time.size)}
    values |= {
        "specific_force_z": force + 0.3 * rng.standard_normal(time.size),
        "cos_tilt": np.ones(time.size),
    }
    values |= {"rotor_command_1": np.sqrt(requested), "reference_position_z": np.full(time.size, 5.0)}
    values |= dict.fromkeys(("reference_velocity_z", "reference_acceleration_z"), np.zeros(time.size))
    channels = {name: Channel(name, time, value, "") for name, value in values.items()}
    return Recording("swept", "simulated", channels), time[within], sweep[within]


@pytest.mark.thorough
def test_a_sweep_into_the_throttle_is_the_instrument(tmp_path):
    flight, time, sweep = swept()
    writer = flight_log(flight, "4.6", modes={0.0: LOITER, time[0]: SYSTEM_IDENTIFICATION, time[-1]: LOITER})
    writer.add("SIDS", time[0], "Bf", Ax=THROTTLE_AXIS, Mag=0.08)
    writer.add("SIDD", time, "ff", Time=time - time[0], Targ=sweep)
    fit = identified(tmp_path, writer)
    assert fit.prepared[0].usable_references == ("injected_throttle",)


@pytest.mark.parametrize(
    ("firmware", "kind"), [("ArduPlane V4.5.7 (0358a9c2)", "fixed wing"), ("ArduRover V4.2.3", "rover")]
)
def test_other_vehicles_are_refused(tmp_path, capsys, monkeypatch, firmware, kind):
    monkeypatch.setenv("COLUMNS", "200")
    path = tmp_path / "flight.bin"
    path.write_bytes(flight_log(simulated(seed=3, duration=2.0), vehicle=firmware).bytes())
    for model, wanted in (
        ("vertical", "a vehicle that hovers on its rotors"),
        ("rates", "a log of a multirotor"),
    ):
        with pytest.raises(SystemExit) as left:
            app(["identify", str(path), "--model", model], prog_name="eivor")
        text = " ".join(capsys.readouterr().err.split())
        assert left.value.code == 1
        assert wanted in text
        assert f"which says that it is of a {kind}" in text
