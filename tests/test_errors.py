"""What errors are made of."""

from __future__ import annotations

import pickle

from eivor.errors import CorruptLogError, did_you_mean


def test_the_nearest_name_is_proposed():
    known = ("velocity_z", "position_z", "input")
    assert did_you_mean("velocty_z", known, "Name one.") == "Did you mean 'velocity_z'?"
    assert did_you_mean("battery", known, "Name one.") == "Name one."
    both = ("velocity_z", "velocity_x", "input")
    assert did_you_mean("velocity", both, "", most=3) == "Did you mean 'velocity_z' or 'velocity_x'?"
    assert did_you_mean("battery", [], "Name one.") == "Name one."


def test_errors_come_back_from_another_process():
    """Workers raise them too."""
    error = CorruptLogError("a log", "a cut one", "Copy it again.")
    back = pickle.loads(pickle.dumps(error))  # noqa: S301 - made here
    assert (type(back), str(back)) == (CorruptLogError, "Expected a log; received a cut one. Copy it again.")
