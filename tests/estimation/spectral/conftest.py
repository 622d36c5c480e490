"""Records of the scenarios that spectral methods are tried on."""

from __future__ import annotations

import numpy as np
import pytest

import eivor as ev
from eivor.lab.scenario_files import shipped_scenario

Problem = ev.SignalRegression


@pytest.fixture
def problem_of():
    """Problem of a shipped scenario's record: name, samples, seed."""
    from dataclasses import replace

    def made(name, samples, seed):
        scenario = replace(shipped_scenario(name), samples=samples)
        signals = ev.simulate(scenario, np.random.default_rng(seed)).signals
        channel = scenario.references[0] if scenario.references else "input"
        instruments = ev.lags(channel, 0, 10 if channel == "input" else 20)
        return ev.VerticalMotion(intercept=False).regression(signals, instruments)

    return made
