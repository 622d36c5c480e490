"""The ten array problems of the record: published data, the paper's two examples, simulated motion.

Each poses its rows twice where methods ask for different instruments: `shared` for those that take off
what the instruments share with the regressors, `clean` for those that need instruments that share nothing.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import numpy as np
import polars as pl

import eivor as ev
from validation.parity.where import ACCELERATION, FILIP, LOGGED_ACCELERATION, SCENARIOS, eivor

Problem = ev.Regression | ev.SignalRegression


@dataclass(frozen=True)
class Case:
    """One problem.

    Parameters
    ----------
    name : str
        What the record calls it.
    shared, clean : Regression or SignalRegression
        Rows with the instruments of compensated methods, and with those of the other ones.
    """

    name: str
    shared: Problem
    clean: Problem


def array_problems() -> list[Case]:
    """All ten."""
    plain: dict[str, Callable[[], Problem]] = {
        "filip": filip,
        "norris": norris,
        "housing": housing,
        "griliches": griliches,
        "pearson-york": pearson,
    }
    cases = [Case(name, problem, problem) for name, make in plain.items() for problem in [make()]]
    return [
        *cases,
        dynamic(),
        Case("paper-1", *simulated(str(SCENARIOS / "paper-1.toml"))),
        Case("paper-2", *simulated(str(SCENARIOS / "paper-2.toml"))),
        Case("closed-loop", *simulated("closed-loop", "reference_velocity_z")),
        noisy_input(),
    ]


def grouped(problem: ev.Regression, flights: int) -> ev.Regression:
    """The same rows as those of several flights, one after the other."""
    rows = problem.response.size
    return replace(problem, layout=type(problem.layout)(np.arange(rows) * flights // rows))


def with_noise(
    response: np.ndarray, regressors: np.ndarray, instruments: np.ndarray | None, noisy: tuple[int, ...]
) -> ev.Regression:
    """Rows whose response and `noisy` columns are declared to have a noise of a hundredth of their variance.

    The instruments share nothing; without any, the regressors serve.
    """
    variances = np.append(
        [0.01 * column.var() if j in noisy else 0.0 for j, column in enumerate(regressors.T)],
        0.01 * response.var(),
    )
    instruments = regressors if instruments is None else instruments
    return ev.regression(
        response=response,
        regressors=regressors,
        instruments=instruments,
        noise_covariance=np.diag(variances),
        instrument_noise_covariance=np.zeros((instruments.shape[1], variances.size)),
    )


def filip() -> ev.Regression:
    """NIST's polynomial of degree ten, condition about 1.8e15."""
    x, y = np.loadtxt(FILIP, delimiter=",", skiprows=1, unpack=True)
    return with_noise(y, np.vander(x, 11, increasing=True), None, ())


def norris() -> ev.Regression:
    """NIST's straight line; the data ship with SciPy."""
    data = resources.files("scipy.stats.tests.data.nist_linregress").joinpath("Norris.dat").read_text()
    y, x = np.array([line.split() for line in data.splitlines()[60:] if line.strip()], dtype=float).T
    return with_noise(y, np.column_stack([np.ones_like(x), x]), None, (1,))


def housing() -> ev.Regression:
    """Stata's example of instrumental variables; the data ship with linearmodels."""
    table = pl.read_csv(resources.files("linearmodels.tests.iv.results").joinpath("housing.csv").read_bytes())
    regions = [(table["region"] == name).cast(int) for name in sorted(set(table["region"]))[1:]]
    exogenous = np.column_stack([table["pcturban"], np.ones(table.height)])
    regressors = np.column_stack([table["hsngval"], exogenous]).astype(float)
    instruments = np.column_stack([exogenous, table["faminc"], *regions]).astype(float)
    return grouped(with_noise(table["rent"].to_numpy().astype(float), regressors, instruments, (0,)), 10)


def griliches() -> ev.Regression:
    """Wages, schooling and IQ: ivreg2's example; the data ship with statsmodels."""
    import pandas as pd
    import statsmodels

    folder = Path(statsmodels.__file__).parent / "sandbox" / "regression" / "tests"
    table = pd.read_stata(folder / "griliches76.dta")
    years = [(table["year"] == year).to_numpy() for year in (67, 68, 69, 70, 71, 73)]
    exogenous = np.column_stack([table[["expr", "tenure", "rns", "smsa"]], *years, np.ones(len(table))])
    regressors = np.column_stack([table[["s", "iq"]], exogenous]).astype(float)
    instruments = np.column_stack([exogenous, table[["med", "kww", "age", "mrt"]]]).astype(float)
    return grouped(with_noise(table["lw"].to_numpy().astype(float), regressors, instruments, (1,)), 20)


#: Pearson's ten points with York's weights.
PEARSON_X = np.array([0, 0.9, 1.8, 2.6, 3.3, 4.4, 5.2, 6.1, 6.5, 7.4])
PEARSON_Y = np.array([5.9, 5.4, 4.4, 4.6, 3.5, 3.7, 2.8, 2.8, 2.4, 1.5])
YORK_X = np.array([1000, 1000, 500, 800, 200, 80, 60, 20, 1.8, 1])
YORK_Y = np.array([1, 1.8, 4, 8, 20, 20, 70, 70, 100, 500])


def pearson() -> ev.Regression:
    """Pearson's line with equal error variances."""
    regressors = np.column_stack([np.ones_like(PEARSON_X), PEARSON_X])
    problem = with_noise(PEARSON_Y, regressors, None, (1,))
    return replace(problem, regressor_noise=np.diag([0.0, 0.01, 0.01]))


def dynamic() -> Case:
    """y(k) = 0.5 y(k-1) + 2 u(k-1): errors in variables, a signal-to-noise ratio of 10 on both."""
    rng = np.random.default_rng(9)
    count = 1023
    u = rng.choice([-1.0, 1.0], count)
    y = np.zeros(count)
    for k in range(1, count):
        y[k] = 0.5 * y[k - 1] + 2.0 * u[k - 1]
    input_noise, output_noise = 0.1 * u.var(), 0.1 * y.var()
    u = u + np.sqrt(input_noise) * rng.standard_normal(count)
    y = y + np.sqrt(output_noise) * rng.standard_normal(count)
    first = 8

    def lagged(series: np.ndarray, lags: range) -> np.ndarray:
        return np.column_stack([series[first - lag : count - lag] for lag in lags])

    shared_noise = np.zeros((6, 3))
    shared_noise[0, 1] = input_noise
    parts = {
        "response": y[first:],
        "regressors": np.column_stack([lagged(y, range(1, 2)), lagged(u, range(1, 2))]),
        "noise_covariance": np.diag([output_noise, input_noise, output_noise]),
    }
    shared = ev.regression(
        **parts, instruments=lagged(u, range(1, 7)), instrument_noise_covariance=shared_noise
    )
    clean = ev.regression(
        **parts, instruments=lagged(u, range(2, 8)), instrument_noise_covariance=np.zeros((6, 3))
    )
    return Case("dynamic", shared, clean)


def simulated(scenario: str, instrument: str = "input") -> tuple[Problem, Problem]:
    """Motion of a scenario as `eivor simulate` logs it: lags 0 to 10 of the instrument, and 1 to 10."""
    with tempfile.TemporaryDirectory() as folder:
        log, truth = Path(folder) / "log.csv", Path(folder) / "truth.json"
        done = eivor("simulate", scenario, "--seed", 3, "--out", log, "--truth", truth)
        if done.code:
            raise RuntimeError(done.err)
        table, noises = pl.read_csv(log), json.loads(truth.read_text())["noise"]
    names = {name: ACCELERATION if name == LOGGED_ACCELERATION else name for name in table.columns}
    signals = ev.Signals(
        rate_hz=5.0,
        channels={names[name]: table[name].to_numpy() for name in table.columns if name != "time"},
        noise={
            names[name]: ev.FractionalNoise(noise["std"], noise["order"])
            if noise["order"]
            else ev.WhiteNoise(noise["std"])
            for name, noise in noises.items()
        },
    )
    motion = ev.VerticalMotion(intercept=False)
    return (
        motion.regression(signals, ev.lags(instrument, 0, 10)),
        motion.regression(signals, ev.lags(instrument, 1, 10)),
    )


def noisy_input() -> Case:
    """The array example of the README with an intercept: an input measured with much noise."""
    rng = np.random.default_rng(1)
    count = 4000
    u = np.convolve(rng.normal(size=count), [0.0, 0.7, 0.49])[:count]
    v = np.zeros(count)
    for k in range(count - 1):
        v[k + 1] = v[k] + 0.2 * (0.021 * u[k] - 0.293 * v[k])
    force = 0.021 * u - 0.293 * v + 0.5 + rng.normal(scale=0.001, size=count)
    signals = ev.Signals(
        rate_hz=5.0,
        channels={"velocity_z": v, ACCELERATION: force, "input": u + rng.normal(scale=0.3, size=count)},
        noise={
            "velocity_z": ev.WhiteNoise(std=0.0),
            ACCELERATION: ev.WhiteNoise(std=0.001),
            "input": ev.WhiteNoise(std=0.3),
        },
    )
    motion = ev.VerticalMotion(intercept=True)
    return Case(
        "noisy-input",
        motion.regression(signals, ev.lags("input", 0, 10)),
        motion.regression(signals, ev.lags("input", 1, 10)),
    )
