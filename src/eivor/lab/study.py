"""A Monte Carlo study: its definition and one trial."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import Enum

import numpy as np

from eivor.errors import UsageError
from eivor.estimation import methods
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import LinearMethod
from eivor.estimation.method import Method
from eivor.estimation.methods import identify
from eivor.estimation.weighting import EquationWeighting
from eivor.inference import covariance as covariances
from eivor.lab.experiments import Experiment
from eivor.lab.regularised import ShrunkTowards, regularised
from eivor.models.regression import Column, lags
from eivor.process_pool import check_among
from eivor.signals.signals import Signals

# -- Study --

#: Methods that need no instruments.
DIRECT: Mapping[str, Callable[[], LinearMethod]] = {
    "least_squares": methods.least_squares,
    "total_least_squares": methods.total_least_squares,
    "bias_compensated_least_squares": methods.bias_compensated_least_squares,
}
#: Methods with instruments whose equations can be weighted.
WEIGHTED: Mapping[str, Callable[[EquationWeighting | None], LinearMethod]] = {
    "extended_iv": methods.extended_iv,
    "generalized_iv": methods.generalized_iv,
}
#: Methods with instruments whose equations cannot.
UNWEIGHTED: Mapping[str, Callable[[], Method]] = {
    "extended_iv_tls": methods.extended_iv_tls,
    "generalized_iv_tls": methods.generalized_iv_tls,
    "liml": methods.liml,
    "generalized_liml": methods.generalized_liml,
    "spectral_giv": methods.spectral_giv,
    "spectral_giv_combined": methods.spectral_giv_combined,
    "whittle_ml": methods.whittle_ml,
    "generalized_iv_unknown_noise": methods.generalized_iv_unknown_noise,
    "bias_eliminating_least_squares": methods.bias_eliminating_least_squares,
    "frisch_scheme": methods.frisch_scheme,
}
#: Methods with instruments and a strength.
STRENGTHS: Mapping[str, Callable[[float], Method]] = {
    "fuller": methods.fuller,
    "generalized_fuller": methods.generalized_fuller,
}
#: Methods that need instruments.
INSTRUMENTAL = (*WEIGHTED, *UNWEIGHTED, *STRENGTHS)
#: Every method of a study.
METHODS = (*DIRECT, *INSTRUMENTAL)
#: Weightings of equations by name.
WEIGHTINGS: Mapping[str, Callable[[], EquationWeighting]] = {
    "unweighted": methods.Unweighted,
    "two_stage": methods.TwoStage,
    "two_step_robust": methods.TwoStepRobust,
}
#: What regularisation may pull a solution towards.
TARGETS: Mapping[str, Method | None] = {"zero": None, "least_squares": methods.least_squares()}
#: Largest number of runs: above it a study is more likely a mistake.
MOST_RUNS = 10_000_000


@dataclass(frozen=True, slots=True)
class Regularisation:
    """Tikhonov's regularisation of a method."""

    parameter: float | None = None
    towards: str = "zero"

    def __post_init__(self) -> None:
        check_among("a vector to be shrunk towards", self.towards, TARGETS)
        regularised(methods.least_squares(), self.parameter)


@dataclass(frozen=True, slots=True)
class MethodChoice:
    """A method and its options in a study.

    Parameters
    ----------
    name : str
        One of `METHODS`.
    lags : tuple of int, optional
        First and last lag of the instruments, both included; for methods that need them.
    channel : str
        Channel that the instruments are lags of.
    weighting : str
        Of the equations, one of `WEIGHTINGS`.
    covariance : str
        What intervals rest on: "default", or one of `eivor.inference.covariance.TABLE`.
    known_noise : tuple of str, optional
        Channels whose true noise the method is identified; None for all of them.
    label : str
        What results call it; default: its name.
    strength : float
        Of `fuller` and `generalized_fuller`.
    regularisation : Regularisation, optional
        Tikhonov's, of a linear method; none by default.

    Raises
    ------
    UsageError
        When a name is unknown, or an option does not fit the method.
    """

    name: str
    lags: tuple[int, int] | None = None
    channel: str = "input"
    weighting: str = "unweighted"
    known_noise: tuple[str, ...] | None = None
    label: str = ""
    covariance: str = "default"
    strength: float = 1.0
    regularisation: Regularisation | None = None

    def __post_init__(self) -> None:
        check_among("a method", self.name, METHODS)
        check_among("a weighting", self.weighting, WEIGHTINGS)
        check_among("a covariance", self.covariance, ("default", *covariances.TABLE))
        if not self.label:
            object.__setattr__(self, "label", self.name)
        if (self.lags is None) != (self.name in DIRECT):
            raise UsageError(
                f"lags = [first, last] for {', '.join(INSTRUMENTAL)}, and for no other method",
                f"'{self.name}' with " + ("none" if self.lags is None else f"{list(self.lags)}"),
                "The paper's extended IV has [1, 10], generalized IV [0, 10].",
            )
        if self.lags is not None:
            lags(self.channel, *self.lags)
        if self.weighting != "unweighted" and self.name not in WEIGHTED:
            raise UsageError(
                f"a weighting for {' or '.join(WEIGHTED)} only",
                f"'{self.weighting}' for '{self.name}'",
                "Leave it out.",
            )
        if self.strength != 1.0 and self.name not in STRENGTHS:
            raise UsageError(
                f"a strength for {' or '.join(STRENGTHS)} only",
                f"{self.strength:g} for '{self.name}'",
                "Leave it out.",
            )
        made = self.method  # refuses a strength out of range, and what cannot be regularised
        if self.regularisation is not None and not isinstance(made, LinearMethod | ShrunkTowards):
            raise UsageError("a regularisation of a linear method", f"one of '{self.name}'", "Leave it out.")

    @property
    def method(self) -> Method:
        """The method itself."""
        made = self._plain_method
        if self.regularisation is None or not isinstance(made, LinearMethod):
            return made
        return regularised(made, self.regularisation.parameter, TARGETS[self.regularisation.towards])

    @property
    def _plain_method(self) -> Method:
        if self.name in WEIGHTED:
            return WEIGHTED[self.name](WEIGHTINGS[self.weighting]())
        if self.name in STRENGTHS:
            return STRENGTHS[self.name](self.strength)
        return {**DIRECT, **UNWEIGHTED}[self.name]()

    def with_covariance(self, estimate: Estimate) -> Estimate:
        """Estimate whose intervals rest on the covariance chosen."""
        if self.covariance == "default":
            return estimate
        return estimate.with_covariance(covariances.TABLE[self.covariance]())

    @property
    def instruments(self) -> tuple[Column, ...]:
        """Columns of the instruments; none for direct methods."""
        return () if self.lags is None else lags(self.channel, *self.lags)


@dataclass(frozen=True, slots=True)
class Study:
    """A Monte Carlo study.

    Parameters
    ----------
    name : str
        What reports call it.
    experiment : Experiment
        What each trial repeats.
    methods : tuple of MethodChoice
        What is tried on each record, with labels of their own.
    runs : int
        Number of trials.
    seed : int
        Of all randomness; trial `index` draws from the seed sequence's child of that number.
    intervals : bool
        Record standard errors and intervals as well.
    level : float
        Confidence level of the intervals.

    Raises
    ------
    UsageError
        When a number is out of range, there is no method, two methods share a label, or a method names a
        channel that the experiment does not record.
    """

    name: str
    experiment: Experiment
    methods: tuple[MethodChoice, ...]
    runs: int = 100
    seed: int = 0
    intervals: bool = False
    level: float = 0.95

    def __post_init__(self) -> None:
        check_runs(self.runs)
        if self.seed < 0:
            raise UsageError("a seed of zero or more", f"{self.seed}", "Any such integer will do.")
        if not 0.0 < self.level < 1.0:
            raise UsageError("a level between 0 and 1", f"{self.level}", "Use 0.95, for example.")
        labels = [choice.label for choice in self.methods]
        if not labels or len(set(labels)) < len(labels) or any("." in label for label in labels):
            raise UsageError(
                "one method or more, with labels of their own that have no dot in them",
                f"labels {', '.join(labels) or 'of no method'}",
                'Give a method that appears twice a label, such as label = "giv_20_lags".',
            )
        for choice in self.methods:
            named = (choice.channel,) if choice.lags else ()
            for channel in (*named, *(choice.known_noise or ())):
                check_among(f"a channel for '{choice.label}'", channel, self.experiment.channels)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(self.experiment.truth)

    def rng(self, index: int) -> np.random.Generator:
        """Generator of one trial."""
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence(self.seed, spawn_key=(index,))))

    @property
    def identity(self) -> str:
        """Hash of everything that trials depend on: two studies of one identity have the same trials."""
        parts = (self.experiment, self.methods, self.parameters, self.seed, self.intervals, self.level)
        text = json.dumps(_plain(parts), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()


def check_runs(runs: int) -> None:
    """Refuse a number of runs that is none."""
    if not 1 <= runs <= MOST_RUNS:
        raise UsageError(f"runs from 1 to {MOST_RUNS}", f"{runs}", "Ask for a number of trials.")


def _plain(value: object) -> object:
    """Value in terms of JSON, exact and with the kind of every object."""
    if is_dataclass(value) and not isinstance(value, type):
        parts = {item.name: _plain(getattr(value, item.name)) for item in fields(value)}
        return {"kind": type(value).__name__} | parts
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    return _plain_atom(value)


def _plain_atom(value: object) -> object:
    if isinstance(value, Enum):
        return {"kind": type(value).__name__, "value": value.value}
    if isinstance(value, np.ndarray):
        digest = hashlib.sha256(np.ascontiguousarray(value).tobytes()).hexdigest()
        return {"dtype": str(value.dtype), "shape": list(value.shape), "sha256": digest}
    if isinstance(value, float | np.floating):
        return float(value).hex()
    if value is None or isinstance(value, bool | int | str):
        return value
    raise TypeError(f"a study cannot hold a {type(value).__name__}")


# -- Trial --

#: Status of a method that raised.
FAILED = "failed"


@dataclass(frozen=True, slots=True)
class ParameterRecord:
    """What a method found for one parameter."""

    value: float
    std_error: float | None = None
    low: float | None = None
    high: float | None = None


@dataclass(frozen=True, slots=True)
class MethodRecord:
    """What a method did on one record."""

    status: str  # The estimate's status, or `FAILED`
    error: str = ""  # Name of the exception of a method that failed
    parameters: tuple[ParameterRecord, ...] = ()


@dataclass(frozen=True, slots=True)
class TrialRecord:
    """One trial. It holds nothing that differs from one computation of it to the next, such as a time."""

    index: int  # Number of the trial
    methods: tuple[MethodRecord, ...]


def trial(study: Study, index: int) -> TrialRecord:
    """Compute a trial, a pure function of study and index."""
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
    results = []
    for name in study.parameters:
        value = estimate.parameters[name]
        if study.intervals:
            low, high = estimate.interval(name, study.level)
            results.append(ParameterRecord(value, estimate.std_error(name), low, high))
        else:
            results.append(ParameterRecord(value))
    return MethodRecord(estimate.status.value, "", tuple(results))
