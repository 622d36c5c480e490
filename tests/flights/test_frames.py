"""Frames: what is logged with z down, or along a tilted body, gives what z up gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flight_logs import STEP_S, changed, channel, flown, prepare_vertical, recording
from scipy.spatial.transform import Rotation

from eivor.errors import ShapeError
from eivor.flights.grid import upward
from eivor.flights.options import FlightOptions
from eivor.motions.identify import identify_flight
from eivor.motions.vertical.select import vertical_row
from eivor.signals.recording import Frame

#: Turns z-up axes (world and body alike) into z-down ones.
DOWN = np.diag([1.0, -1.0, -1.0])


def tilted(seed: int = 0, count: int = 600):
    """Attitudes and world specific forces of a vehicle that leans about, z up."""
    rng = np.random.default_rng(seed)
    time = STEP_S * np.arange(count)
    lean = [0.2 * np.sin(w * time + p) for w, p in ((2.0, 0.3), (3.1, 1.0), (0.7, 0.0))]
    turns = Rotation.from_euler("xyz", np.column_stack(lean))
    force = np.column_stack([np.sin(time), np.cos(time), 9.8 + rng.standard_normal(count)])
    return time, turns, force


def body_log(turns: Rotation, body_force: np.ndarray, frame: Frame, scale: float = 1.0):
    x, y, z, w = turns.as_quat().T * scale
    columns = {
        "velocity_z": np.zeros(len(turns)),
        "input": 0.5 + 0.1 * np.sin(np.arange(len(turns))),
        **{f"attitude_{axis}": part for axis, part in zip("wxyz", (w, x, y, z), strict=True)},
        **{f"specific_force_body_{axis}": body_force[:, i].copy() for i, axis in enumerate("xyz")},
    }
    return replace(recording(columns), frame=frame)


@pytest.mark.parametrize("frame", list(Frame))
@pytest.mark.parametrize("scale", [1.0, -1.0, 3.0])
def test_world_force_comes_from_the_bodys_and_the_attitude(frame, scale):
    """An attitude and its negative are one rotation, and its length does not count."""
    _, turns, force = tilted()
    if frame is Frame.NED:
        matrices = DOWN @ turns.as_matrix() @ DOWN
        logged = Rotation.from_matrix(matrices)
        body = logged.inv().apply(force @ DOWN)
    else:
        logged, body = turns, turns.inv().apply(force)
    prepared = prepare_vertical(body_log(logged, body, frame, scale), FlightOptions())
    np.testing.assert_allclose(prepared.signals.channel("specific_force_z"), force[:, 2], atol=1e-9)
    np.testing.assert_allclose(prepared.signals.channel("cos_tilt"), turns.as_matrix()[:, 2, 2], atol=1e-12)


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
@pytest.mark.usefixtures("unchecked_shapes")
def test_z_down_log_gives_the_answers_of_the_z_up_log():
    (log,) = flown(seconds=12.0)
    _, turns, _ = tilted(count=1200)
    x, y, z, w = turns.as_quat().T
    leaning = changed(log, "cos_tilt", attitude_w=w, attitude_x=x, attitude_y=y, attitude_z=z)
    down = dict(leaning.channels)
    for name in ("position_z", "velocity_z", "specific_force_z", "reference_position_z",
                 "reference_velocity_z", "attitude_y", "attitude_z"):  # fmt: skip
        down[name] = replace(down[name], values=-down[name].values)
    flight = identify_flight(leaning)
    mirrored = identify_flight(replace(leaning, channels=down, frame=Frame.NED))
    for name, quantity in flight.quantities.items():
        assert mirrored.quantities[name].value == pytest.approx(quantity.value, rel=1e-9)
        assert mirrored.quantities[name].interval == pytest.approx(quantity.interval, rel=1e-6)
    np.testing.assert_array_equal(down["velocity_z"].values, -leaning.channels["velocity_z"].values)


def test_turning_twice_is_turning_once_and_leaves_the_log_alone():
    _, turns, force = tilted()
    log = body_log(turns, force, Frame.NED)
    before = {name: c.values.copy() for name, c in log.channels.items()}
    once = upward(log)
    assert once.frame is Frame.Z_UP
    assert upward(once) is once
    for name, values in before.items():
        np.testing.assert_array_equal(log.channels[name].values, values)
    np.testing.assert_array_equal(once.channels["attitude_w"].values, before["attitude_w"])
    np.testing.assert_array_equal(
        once.channels["specific_force_body_z"].values, -before["specific_force_body_z"]
    )


def test_attitudes_that_are_none_give_no_value():
    zero = [channel(f"attitude_{axis}", np.arange(3.0), [0.0, 1.0, np.nan]) for axis in "wxyz"]
    row = vertical_row(zero)[1]
    assert np.isnan(row[[0, 2]]).all()
    assert np.isfinite(row[1]).all()


def test_attitudes_on_several_clocks_are_refused():
    parts = [channel(f"attitude_{axis}", np.arange(3.0) + (axis == "y"), np.ones(3)) for axis in "wxyz"]
    with pytest.raises(
        ShapeError, match=r"Expected the four parts of an attitude on one clock; received 3 stamps"
    ):
        vertical_row(parts)


def test_axes_of_the_accelerometer_may_have_their_own_clocks():
    time, turns, force = tilted()
    log = body_log(turns, turns.inv().apply(force), Frame.Z_UP)
    z = log.channels["specific_force_body_z"]
    smooth = turns.inv().apply(np.column_stack([np.sin(time), np.cos(time), 9.8 + 0.0 * time]))
    later = time[:-1] + 0.5 * STEP_S
    moved = {
        f"specific_force_body_{axis}": channel(
            f"specific_force_body_{axis}", later, np.interp(later, time, smooth[:, i])
        )
        for i, axis in enumerate("xy")
    }
    flown_with = changed(log, **moved, specific_force_body_z=replace(z, values=smooth[:, 2].copy()))
    result = prepare_vertical(flown_with, FlightOptions()).signals.channel("specific_force_z")
    np.testing.assert_allclose(result[2:-2], 9.8, atol=2e-3)
    # An axis without a sample is no accelerometer.
    empty = changed(log, specific_force_body_x=channel("specific_force_body_x", [], []))
    names = [finding.name for finding in prepare_vertical(empty, FlightOptions()).findings]
    assert "no_accelerometer" in names
