"""Trials: one record, every method on it. A trial never fails; a method, or the simulation, may."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from eivor.estimation.fit import identify
from eivor.signals.signals import Signals
from eivor.studies.study import MethodChoice, Study

#: Status of a method that raised.
FAILED = "failed"


@dataclass(frozen=True, slots=True)
class ParameterRecord:
    """What a method found for one parameter.

    Parameters
    ----------
    value : float
        Estimate.
    std_error, low, high : float or None
        Standard error and interval; None when they were not asked for.
    """

    value: float
    std_error: float | None = None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, slots=True)
class MethodRecord:
    """What a method did on one record.

    Parameters
    ----------
    status : str
        The estimate's status, or `FAILED`.
    error : str
        Name of the exception of a method that failed; empty otherwise.
    parameters : tuple of ParameterRecord
        One for each parameter of the study; empty when the method failed.
    """

    status: str
    error: str = ""
    parameters: tuple[ParameterRecord, ...] = ()


@dataclass(frozen=True, slots=True)
class TrialRecord:
    """One trial. It holds nothing that differs from one computation of it to the next, such as a time.

    Parameters
    ----------
    index : int
        Number of the trial.
    methods : tuple of MethodRecord
        One for each method of the study.
    """

    index: int
    methods: tuple[MethodRecord, ...]


def trial(study: Study, index: int) -> TrialRecord:
    """Compute a trial, a pure function of study and index.

    Raises
    ------
    MemoryError
        The only error that is not recorded: it belongs to the computer, not to the trial.
    """
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")  # weak instruments are recorded as a status
        try:
            signals = study.experiment.record(study.rng(index))
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - whatever breaks a trial is its result
            failed = MethodRecord(FAILED, type(error).__name__)
            return TrialRecord(index, (failed,) * len(study.methods))
        return TrialRecord(index, tuple(_tried(study, choice, signals) for choice in study.methods))


def failure(study: Study, index: int, label: str) -> str:
    """Return what a method of that label said when it failed in a trial, by computing it once more."""
    choice = next(choice for choice in study.methods if choice.label == label)
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            _estimated(study, choice, study.experiment.record(study.rng(index)))
        except Exception as error:  # noqa: BLE001 - its message is what is asked for
            return f"{type(error).__name__}: {error}"
    return ""


def _tried(study: Study, choice: MethodChoice, signals: Signals) -> MethodRecord:
    try:
        return _estimated(study, choice, signals)
    except MemoryError:
        raise
    except Exception as error:  # noqa: BLE001 - whatever breaks a method is its result
        return MethodRecord(FAILED, type(error).__name__)


def _estimated(study: Study, choice: MethodChoice, signals: Signals) -> MethodRecord:
    if choice.known_noise is not None:
        signals = replace(signals, noise={name: signals.noise[name] for name in choice.known_noise})
    estimate = identify(study.experiment.problem(signals, choice.instruments), choice.method)
    if study.intervals:
        estimate = choice.with_covariance(estimate)
    found = []
    for name in study.parameters:
        value = estimate.parameters[name]
        if study.intervals:
            low, high = estimate.interval(name, study.level)
            found.append(ParameterRecord(value, estimate.std_error(name), low, high))
        else:
            found.append(ParameterRecord(value))
    return MethodRecord(estimate.status.value, "", tuple(found))
