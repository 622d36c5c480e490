"""`--noise`: what may be typed."""

import pytest

from eivor.cli.parsing import declared_noise
from eivor.errors import UsageError
from eivor.signals.recording import DataSheet


def test_numbers_units_sheets_and_the_word():
    assert declared_noise([]) is None
    assert declared_noise(["estimate"]) == "estimate"
    assert declared_noise(["velocity_z=0.02"]) == {"velocity_z": 0.02}
    assert declared_noise(["velocity_z=2 cm/s,specific_force_z=30mg"]) == {
        "velocity_z": pytest.approx(0.02),
        "specific_force_z": pytest.approx(0.2942, rel=1e-3),
    }
    assert declared_noise(
        ["velocity_z=density:0.002m/s/sqrt(Hz),bandwidth:50Hz,step:1cm/s", "rotor_speed=3"]
    ) == {
        "velocity_z": DataSheet(0.002, 50.0, 0.01),
        "rotor_speed": 3.0,
    }


@pytest.mark.parametrize(
    ("texts", "words"),
    [
        (["velocity_z"], "NAME=STD"),
        (["velocity_z="], "NAME=STD"),
        (["velocity_z=-1"], "zero or more for velocity_z"),
        (["velocity_z=nan"], "zero or more for velocity_z"),
        (["velocity_z=lots"], "zero or more for velocity_z"),
        (["velocity_z=1 m"], "in m/s, or a unit of that kind"),
        (["velocity_z=1 parsec"], "in m/s, or a unit of that kind"),
        (["velocity_z=1", "velocity_z=2"], "twice"),
        (["velocity_z=densty:1"], "density"),
        (["velocity_z=bandwidth:50"], "sheet of velocity_z; received 'bandwidth:50'. Give --noise"),
        (["velocity_z=density:0,bandwidth:50"], "above zero of the data sheet of velocity_z"),
        (["estimate", "velocity_z=2"], "estimate alone"),
    ],
)
def test_noises_that_are_none(texts, words):
    with pytest.raises(UsageError, match=words):
        declared_noise(texts)
