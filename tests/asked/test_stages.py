"""Those who wait are told what an identification is at."""

import pytest

import eivor as ev
from eivor.tools import Stage


@pytest.mark.usefixtures("coarse_search")
def test_stages_come_in_order():
    log = ev.example_flight()
    stages: list[Stage] = []
    ev.identify_flight(log, window=(0.0, 20.0), progress=stages.append)
    assert stages == list(Stage)
