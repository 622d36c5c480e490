"""Members of families of channels, and their order."""

from __future__ import annotations

import pytest

from eivor.signals.channels import family_members


@pytest.mark.parametrize(
    ("name", "among", "members"),
    [
        ("input", ["input", "input_1"], ["input"]),
        ("rotor_command", ["rotor_command_10", "rotor_command_2", "rotor_command_x1"], ["2", "10"]),
        ("rotor_command_*", ["rotor_command_1", "other_2"], ["1"]),
        ("torque_setpoint", ["torque_setpoint_z", "torque_setpoint_x", "torque_setpoint_w"], ["x", "z"]),
        ("nothing", ["something_1"], []),
    ],
)
def test_numbers_come_in_their_order_and_axes_in_theirs(name, among, members):
    stem = name.removesuffix("_*")
    expected = members if members == ["input"] else [f"{stem}_{member}" for member in members]
    assert family_members(name, among) == expected
