"""What a data sheet says of a sensor's noise."""

import pytest

from eivor.errors import UsageError
from eivor.signals.recording import DataSheet


def test_density_over_a_bandwidth_and_the_rounding_of_a_step_add_up():
    assert DataSheet(density=0.002, bandwidth_hz=50.0).std(200.0) == pytest.approx(0.002 * 50.0**0.5)
    assert DataSheet(density=0.002).std(200.0) == pytest.approx(0.02)
    assert DataSheet(step=0.12).std(1.0) == pytest.approx(0.12 / 12.0**0.5)


@pytest.mark.parametrize(
    "stated", [{}, {"density": -1.0}, {"step": float("inf")}, {"density": 1.0, "bandwidth_hz": -1.0}]
)
def test_sheets_that_say_nothing(stated):
    with pytest.raises(UsageError):
        DataSheet(**stated)
