"""What a study measures: the paper's NRMSE, bias, RMSE, and the coverage of intervals.

NRMSE of a trial, in percent: 100 |estimate - truth| / |truth| for one parameter, and with Euclidean norms
of the vectors for all together. Mean and standard deviation are over the trials in which the method gave
an estimate; how many did not is told beside them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars as pl

from eivor.inference.verdict import Status
from eivor.shapes import Float
from eivor.studies.run import StudyResult
from eivor.studies.share import Share
from eivor.studies.trial import FAILED

#: What scores of all parameters together are called.
TOGETHER = "together"


@dataclass(frozen=True, slots=True)
class Spread:
    """Mean and sample standard deviation; NaN where there are too few values.

    Parameters
    ----------
    mean, std : float
        Over trials.
    """

    mean: float
    std: float


@dataclass(frozen=True, slots=True)
class ParameterScore:
    """How a method did on one parameter.

    Parameters
    ----------
    name : str
        The parameter.
    truth : float
        Its value.
    estimate : Spread
        Of the estimates.
    nrmse : Spread
        In percent.
    bias, rmse : float
        Mean error and root mean square error, in the parameter's unit.
    coverage : Share or None
        Of the intervals that held the truth; None when the study records no intervals.
    """

    name: str
    truth: float
    estimate: Spread
    nrmse: Spread
    bias: float
    rmse: float
    coverage: Share | None


@dataclass(frozen=True, slots=True)
class MethodScore:
    """How a method did.

    Parameters
    ----------
    label : str
        The method.
    trials, failed, weak : int
        Trials, those in which it gave no estimate, and those whose estimate it called weak.
    first_failure : int or None
        First trial in which it gave no estimate.
    parameters : tuple of ParameterScore
        In the order of the equation.
    together : Spread
        NRMSE of the vector of parameters, in percent.
    """

    label: str
    trials: int
    failed: int
    weak: int
    first_failure: int | None
    parameters: tuple[ParameterScore, ...]
    together: Spread


def scores(result: StudyResult) -> tuple[MethodScore, ...]:
    """Score of each method of a study, in its order."""
    return tuple(_score(result, choice.label) for choice in result.study.methods)


def trial_nrmse(result: StudyResult, label: str, parameter: str = TOGETHER) -> Float[np.ndarray, " trials"]:
    """NRMSE of each trial in which a method gave an estimate, in percent: what histograms show.

    Parameters
    ----------
    result : StudyResult
        A finished study.
    label : str
        The method.
    parameter : str
        One parameter, or all of them together.
    """
    truth = dict(result.study.experiment.truth)
    names = tuple(truth) if parameter == TOGETHER else (parameter,)
    kept = result.trials.filter(pl.col(f"{label}.status") != FAILED)
    errors = np.column_stack([kept[f"{label}.{name}"].to_numpy() - truth[name] for name in names])
    size = np.linalg.norm([truth[name] for name in names])
    with np.errstate(divide="ignore", invalid="ignore"):  # a truth of zero has no relative error
        relative: Float[np.ndarray, " trials"] = 100.0 * np.linalg.norm(errors, axis=1) / size
    return relative


def _score(result: StudyResult, label: str) -> MethodScore:
    status = result.trials[f"{label}.status"]
    failed = result.trials.filter(status == FAILED)["trial"]
    return MethodScore(
        label,
        len(status),
        len(failed),
        int((status == Status.WEAK.value).sum()),
        int(failed[0]) if len(failed) else None,
        tuple(_parameter_score(result, label, name) for name in result.study.parameters),
        _spread(trial_nrmse(result, label)),
    )


def _parameter_score(result: StudyResult, label: str, name: str) -> ParameterScore:
    truth = result.study.experiment.truth[name]
    kept = result.trials.filter(pl.col(f"{label}.status") != FAILED)
    values = kept[f"{label}.{name}"].to_numpy()
    error = _spread(values - truth)
    coverage = None
    if result.study.intervals:
        low, high = (kept[f"{label}.{name}.{end}"].to_numpy() for end in ("low", "high"))
        coverage = Share(int(((low <= truth) & (truth <= high)).sum()), len(values))
    rmse = float(np.sqrt(np.mean((values - truth) ** 2))) if len(values) else float("nan")
    nrmse = _spread(trial_nrmse(result, label, name))
    return ParameterScore(name, truth, _spread(values), nrmse, error.mean, rmse, coverage)


def _spread(values: Float[np.ndarray, " n"]) -> Spread:
    nan = float("nan")
    return Spread(
        float(values.mean()) if values.size else nan,
        float(values.std(ddof=1)) if values.size > 1 else nan,
    )
