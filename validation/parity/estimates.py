"""Estimates of the record: every method and every covariance on a problem, and what rests on them."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import eivor as ev
from validation.parity.problems import PEARSON_X, PEARSON_Y, YORK_X, YORK_Y, Case, Problem, noisy_input
from validation.parity.where import EXAMPLE, linear_system

M, C = ev.methods, ev.covariances

#: Methods by name; those of the second table take off what instruments share with regressors.
CLEAN: Mapping[str, Callable[[], Any]] = {
    "reference_iv": M.reference_iv,
    "extended_iv": M.extended_iv,
    "extended_iv_two_stage": lambda: M.extended_iv(M.TwoStage()),
    "extended_iv_two_step": lambda: M.extended_iv(M.TwoStepRobust()),
    "extended_iv_tls": M.extended_iv_tls,
}
SHARED: Mapping[str, Callable[[], Any]] = {
    "least_squares": M.least_squares,
    "total_least_squares": M.total_least_squares,
    "bias_compensated_least_squares": M.bias_compensated_least_squares,
    "generalized_iv": M.generalized_iv,
    "generalized_iv_two_stage": lambda: M.generalized_iv(M.TwoStage()),
    "generalized_iv_two_step": lambda: M.generalized_iv(M.TwoStepRobust()),
    "generalized_iv_tls": M.generalized_iv_tls,
}
COVARIANCES: Mapping[str, Any] = {
    "cosines": C.EqualWeightedCosines(),
    "classical": C.Classical(),
    "white": C.HeteroskedasticityRobust(),
    "clustered": C.ClusteredByFlight(least_flights=5),
    "newey_west": C.KernelRobust(C.Bartlett(), C.NeweyWestRule(), fixed_b=False),
    "andrews": C.KernelRobust(C.QuadraticSpectral(), C.AndrewsRule(), fixed_b=False),
    "bartlett_fixed_b": C.KernelRobust(C.Bartlett(), C.SquareRootRule()),
    "parzen_fixed": C.KernelRobust(C.Parzen(), C.FixedBandwidth(12)),
    "widest": C.Widest((C.EqualWeightedCosines(), C.Classical(), C.ClusteredByFlight(least_flights=5))),
}


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
    return {
        name: attempted(lambda method=method, problem=problem: estimate_record(problem, method()))
        for problem, table in ((case.shared, SHARED), (case.clean, CLEAN))
        for name, method in table.items()
    }


def estimate_record(problem: Problem, method: Any) -> dict[str, Any]:
    """Estimate with every covariance; intervals are kept as their lower and upper ends."""
    fit = ev.identify(problem, method)
    return {
        "status": fit.status.value,
        "reasons": [reason.sentence for reason in fit.reasons],
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


def york_record() -> dict[str, Any]:
    """York's line: the solver for rows of different accuracies, on plain arrays."""
    errors = np.zeros((PEARSON_X.size, 3, 3))
    errors[:, 1, 1], errors[:, 2, 2] = 1.0 / YORK_X, 1.0 / YORK_Y
    system = linear_system(np.column_stack([np.ones_like(PEARSON_X), PEARSON_X]), PEARSON_Y)
    return {"values": numbers(ev.weighted_total_least_squares(system, errors).theta)}


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
    """Rows of the table of diagnostics: a number and what it is held against, by what it is of.

    Of the autocorrelation the first lag, and no spectrum: they are many, and follow from the residual.
    """
    rows = ev.diagnose(fit).to_frame().iter_rows()
    return {
        f"{what}: {of}": [number(value) for value in values]
        for what, of, *values in rows
        if what != "band_power" and (what != "autocorrelation" or of == "lag 1")
    }


def set_record(found: Any) -> dict[str, Any]:
    """Intervals of a set, each a list of its pieces."""
    return {name: [numbers(piece) for piece in one.intervals] for name, one in found.intervals.items()}


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
        ev.moments(chunks(), model=motion, method=M.generalized_iv(), instruments=lags),
        M.generalized_iv(),
    )
    return {
        "condition": number(chunked.condition),
        "values": numbers(list(chunked.parameters.values())),
        "covariance": numbers(chunked.covariance),
        "merged_values": numbers(list(merged.parameters.values())),
    }


def flight_record(pool: Sequence[Path]) -> dict[str, Any]:
    """The example flight from Python, whose rows are in frequency, and the bootstrap of a pool."""
    fit = ev.identify_flight(ev.read_log(EXAMPLE)).estimate
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
