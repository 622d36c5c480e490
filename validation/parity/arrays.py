"""Array problems of the record, and every method, covariance, set and bootstrap on them.

Published data, the paper's first example and simulated motion. Each problem has two sets of rows: `shared`
for methods that take off what the instruments share with the regressors, `clean` for those that need
instruments that share nothing.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

import eivor as ev
from validation.parity.record import Folder

Problem = ev.Regression | ev.SignalRegression


@dataclass(frozen=True)
class Case:
    """Rows with the instruments of compensated methods, and with those of the other methods."""

    shared: Problem
    clean: Problem


def array_problems(folder: Folder) -> dict[str, Case]:
    return {
        "housing": housing(),
        "dynamic": dynamic(),
        "paper-1": Case(*simulated(folder, "scenarios/paper-1.toml")),
        "closed-loop": Case(*simulated(folder, "closed-loop", "reference_velocity_z")),
        "noisy-input": noisy_input(),
    }


def housing() -> Case:
    """Stata's example of instrumental variables, as rows of ten flights; the data ship with linearmodels."""
    table = pl.read_csv(resources.files("linearmodels.tests.iv.results").joinpath("housing.csv").read_bytes())
    regions = [(table["region"] == name).cast(int) for name in sorted(set(table["region"]))[1:]]
    exogenous = np.column_stack([table["pcturban"], np.ones(table.height)])
    regressors = np.column_stack([table["hsngval"], exogenous]).astype(float)
    instruments = np.column_stack([exogenous, table["faminc"], *regions]).astype(float)
    response = table["rent"].to_numpy().astype(float)
    noise = 0.01 * np.diag([regressors[:, 0].var(), 0.0, 0.0, response.var()])
    problem = ev.regression(
        response=response,
        regressors=regressors,
        instruments=instruments,
        noise_covariance=noise,
        instrument_noise_covariance=np.zeros((instruments.shape[1], 4)),
    )
    layout = type(problem.layout)(np.arange(table.height) * 10 // table.height)
    problem = replace(problem, layout=layout)
    return Case(problem, problem)


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
    return Case(shared, clean)


def simulated(folder: Folder, scenario: str, instrument: str = "input") -> tuple[Problem, Problem]:
    """Motion of a scenario as `eivor simulate` logs it: lags 0 to 10 of the instrument, and 1 to 10."""
    done = folder.eivor("simulate", scenario, "--seed", 3, "--out", "log.csv", "--truth", "document.json")
    if done["exit_code"]:
        raise RuntimeError(done["message"])
    table, noises = pl.read_csv(folder.path / "log.csv"), done["document"]["noise"]
    signals = ev.Signals(
        rate_hz=5.0,
        channels={name: table[name].to_numpy() for name in table.columns if name != "time"},
        noise={
            name: ev.FractionalNoise(noise["std"], noise["order"])
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
        channels={"velocity_z": v, "acceleration_z": force, "input": u + rng.normal(scale=0.3, size=count)},
        noise={
            "velocity_z": ev.WhiteNoise(std=0.0),
            "acceleration_z": ev.WhiteNoise(std=0.001),
            "input": ev.WhiteNoise(std=0.3),
        },
    )
    motion = ev.VerticalMotion(intercept=True)
    return Case(
        motion.regression(signals, ev.lags("input", 0, 10)),
        motion.regression(signals, ev.lags("input", 1, 10)),
    )


M, C = ev.methods, ev.covariances

CONFIGURED: Mapping[str, Mapping[str, Callable[[], Any]]] = {
    "clean": {
        "extended_iv_two_stage": lambda: M.extended_iv(M.TwoStage()),
        "extended_iv_two_step": lambda: M.extended_iv(M.TwoStepRobust()),
    },
    "shared": {
        "generalized_iv_two_stage": lambda: M.generalized_iv(M.TwoStage()),
        "generalized_iv_two_step": lambda: M.generalized_iv(M.TwoStepRobust()),
        "regularised": lambda: M.regularised(M.generalized_iv(), 0.01),
    },
}
COVARIANCES: Mapping[str, Any] = {name: make() for name, make in C.TABLE.items()}


def number(value: float | None) -> float | str | None:
    """A number as JSON has it: NaN is null, infinities are words."""
    if value is None:
        return None
    value = float(value)
    if math.isnan(value):
        return None
    return value if math.isfinite(value) else ("inf" if value > 0.0 else "-inf")


def numbers(values: Any) -> Any:
    """Numbers of an array, row by row."""
    values = np.asarray(values, dtype=float)
    return number(float(values)) if values.ndim == 0 else [numbers(value) for value in values]


def attempted(make: Callable[[], Any]) -> Any:
    """What `make` gives; of what it raises, the kind."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return make()
    except Exception as error:  # noqa: BLE001 - which error it is belongs to the record
        return {"error": type(error).__name__}


def problem_record(case: Case) -> dict[str, Any]:
    """Every method and covariance on a problem."""
    results: dict[str, Any] = {}
    for kind, problem in (("shared", case.shared), ("clean", case.clean)):
        plain = {name: lambda name=name: getattr(M, name)() for name in sorted(M.__all__)}
        results[kind] = {
            name: attempted(lambda method=method, problem=problem: estimate_record(problem, method()))
            for name, method in (plain | CONFIGURED[kind]).items()
        }
    return results


def estimate_record(problem: Problem, method: Any) -> dict[str, Any]:
    """Estimate with every covariance, each with standard errors and 95 % intervals."""
    fit = ev.identify(problem, method)
    return {
        "status": fit.status.value,
        "reasons": [reason.sentence for reason in fit.reasons],
        "names": list(fit.names),
        "condition": number(fit.condition),
        "values": numbers(list(fit.parameters.values())),
        "covariances": {
            name: attempted(lambda covariance=covariance: interval_record(fit.with_covariance(covariance)))
            for name, covariance in COVARIANCES.items()
        },
    }


def interval_record(fit: Any) -> dict[str, Any]:
    """Standard errors and 95 % intervals."""
    intervals = np.array([fit.interval(name) for name in fit.names])
    return {
        "std_error": numbers([fit.std_error(name) for name in fit.names]),
        "low": numbers(intervals[:, 0]),
        "high": numbers(intervals[:, 1]),
    }


def inference_record(case: Case) -> dict[str, Any]:
    """What else is said of a problem: diagnostics, sets that need no strength, the bootstrap."""
    extended, generalized = M.extended_iv(), M.generalized_iv()
    return {
        "diagnose": attempted(lambda: diagnostics_record(ev.identify(case.clean, extended))),
        "diagnose_generalized": attempted(lambda: diagnostics_record(ev.identify(case.shared, generalized))),
        "anderson_rubin": attempted(lambda: set_record(ev.anderson_rubin_set(case.clean, extended))),
        "anderson_rubin_classical": attempted(
            lambda: set_record(ev.anderson_rubin_set(case.clean, extended, errors=ev.HomoskedasticErrors()))
        ),
        "sign_perturbed": attempted(
            lambda: set_record(ev.sign_perturbed_set(case.clean, extended, np.random.default_rng(5)))
        ),
        "bootstrap": attempted(lambda: bootstrap_record(case.clean, extended)),
        "bootstrap_generalized": attempted(lambda: bootstrap_record(case.shared, generalized)),
    }


def diagnostics_record(fit: Any) -> dict[str, Any]:
    """Rows of the table of diagnostics: a number and what it is held against, by what it is of."""
    rows = ev.diagnose(fit).to_frame().iter_rows()
    return {
        f"{what}: {of}": [number(value) for value in values]
        for what, of, *values in rows
        if what != "band_power" and (what != "autocorrelation" or of == "lag 1")
    }


def set_record(result: Any) -> dict[str, Any]:
    """Intervals of a set, each a list of its pieces."""
    return {
        name: [numbers(piece) for piece in interval.intervals] for name, interval in result.intervals.items()
    }


def bootstrap_record(problem: Problem, method: Any) -> dict[str, Any]:
    """Standard errors and percentile intervals of 99 replicates."""
    made = ev.bootstrap(problem, method, runs=99, block_length=20, seed=6)
    return {name: [number(made.std_error(name)), *numbers(made.interval(name))] for name in made.names}


def streamed_record() -> dict[str, Any]:
    """Chunks and merged moments of the noisy input: what never holds the record in memory."""
    case = noisy_input()
    signals = case.shared.signals
    motion, lags = ev.VerticalMotion(intercept=True), ev.lags("input", 0, 10)

    def chunks() -> Iterator[Any]:
        for start in range(0, signals.sample_count, 700):
            cut = {name: values[start : start + 700] for name, values in signals.channels.items()}
            yield ev.Signals(signals.rate_hz, cut, noise=signals.noise, offset=start)

    chunked = ev.identify_chunks(chunks, model=motion, method=M.generalized_iv(), instruments=lags)
    merged = ev.identify(
        ev.moments(chunks(), model=motion, method=M.generalized_iv(), instruments=lags), M.generalized_iv()
    )
    return {
        "condition": number(chunked.condition),
        "values": numbers(list(chunked.parameters.values())),
        "covariance": numbers(chunked.covariance),
        "merged_values": numbers(list(merged.parameters.values())),
    }


def flight_record(pool: Sequence[Path]) -> dict[str, Any]:
    """The example flight from Python, whose rows are in frequency, and the bootstrap of a pool."""
    fit = ev.identify_flight(ev.example_flight()).estimate
    made = ev.bootstrap_flights(ev.identify_flight([ev.read_log(path) for path in pool]), runs=39, seed=7)
    return {
        "names": list(fit.names),
        "values": numbers(list(fit.parameters.values())),
        "covariances": {
            name: attempted(lambda covariance=covariance: interval_record(fit.with_covariance(covariance)))
            for name, covariance in COVARIANCES.items()
        },
        "diagnose": diagnostics_record(fit),
        "bootstrap": {
            name: [number(made.std_error(name)), *numbers(made.interval(name))] for name in made.names
        },
    }


def inference(cases: Mapping[str, Case]) -> Iterator[tuple[str, Any]]:
    """Entries of diagnostics, sets and the bootstrap."""
    for name, case in cases.items():
        yield name, inference_record(case)


def from_python(pool: Sequence[Path]) -> Iterator[tuple[str, Any]]:
    """Entries that only Python has: chunks, the example's covariances, a pool's bootstrap."""
    yield "streamed", attempted(streamed_record)
    yield "flight", flight_record(pool)
