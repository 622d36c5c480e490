"""Eivor: the parameters of moving machines from noisy recordings, with honest intervals and a verdict.

Public names are loaded when they are first used, so that ``import eivor`` costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from eivor.errors import WeakInstrumentsWarning
    from eivor.estimation import methods
    from eivor.estimation.chunked_fit import identify_chunks
    from eivor.estimation.derived import derived, ratio
    from eivor.estimation.diagnose import Diagnostics, diagnose
    from eivor.estimation.estimate import Estimate
    from eivor.estimation.fit import identify
    from eivor.estimation.resampling import bootstrap
    from eivor.estimation.streaming import moments
    from eivor.estimation.weak_identification import (
        AndersonRubinSet,
        AutocorrelatedErrors,
        HomoskedasticErrors,
        SignPerturbedSet,
        anderson_rubin_set,
        sign_perturbed_set,
    )
    from eivor.flights.options import FlightOptions
    from eivor.flights.recipe import identify_flight
    from eivor.flights.resampling import bootstrap_flights
    from eivor.flights.result import FlightEstimate
    from eivor.inference import covariances
    from eivor.inference.sets.confidence_region import ConfidenceRegion
    from eivor.inference.sets.confidence_set import ConfidenceSet
    from eivor.linalg.weighted_total_least_squares import weighted_total_least_squares
    from eivor.logs import read_log, recording_from_columns
    from eivor.logs.chunks import read_chunks
    from eivor.models.column import Column, lags
    from eivor.models.regression import Regression, regression
    from eivor.models.scenario import Scenario
    from eivor.models.signal_regression import SignalRegression
    from eivor.models.simulation import simulate
    from eivor.models.vertical import VerticalMotion
    from eivor.signals.long_memory import estimate_long_memory
    from eivor.signals.noise import FractionalNoise, WhiteNoise
    from eivor.signals.recording import Recording
    from eivor.signals.signals import Signals

#: Where each public name lives.
_HOMES = {
    "AndersonRubinSet": "eivor.estimation.weak_identification",
    "AutocorrelatedErrors": "eivor.estimation.weak_identification",
    "Column": "eivor.models.column",
    "ConfidenceRegion": "eivor.inference.sets.confidence_region",
    "ConfidenceSet": "eivor.inference.sets.confidence_set",
    "Diagnostics": "eivor.estimation.diagnose",
    "Estimate": "eivor.estimation.estimate",
    "FlightEstimate": "eivor.flights.result",
    "FlightOptions": "eivor.flights.options",
    "FractionalNoise": "eivor.signals.noise",
    "HomoskedasticErrors": "eivor.estimation.weak_identification",
    "Recording": "eivor.signals.recording",
    "Regression": "eivor.models.regression",
    "Scenario": "eivor.models.scenario",
    "SignPerturbedSet": "eivor.estimation.weak_identification",
    "SignalRegression": "eivor.models.signal_regression",
    "Signals": "eivor.signals.signals",
    "VerticalMotion": "eivor.models.vertical",
    "WeakInstrumentsWarning": "eivor.errors",
    "WhiteNoise": "eivor.signals.noise",
    "anderson_rubin_set": "eivor.estimation.weak_identification",
    "bootstrap": "eivor.estimation.resampling",
    "bootstrap_flights": "eivor.flights.resampling",
    "covariances": "eivor.inference.covariances",
    "derived": "eivor.estimation.derived",
    "diagnose": "eivor.estimation.diagnose",
    "estimate_long_memory": "eivor.signals.long_memory",
    "identify": "eivor.estimation.fit",
    "identify_chunks": "eivor.estimation.chunked_fit",
    "identify_flight": "eivor.flights.recipe",
    "lags": "eivor.models.column",
    "methods": "eivor.estimation.methods",
    "moments": "eivor.estimation.streaming",
    "ratio": "eivor.estimation.derived",
    "read_chunks": "eivor.logs.chunks",
    "read_log": "eivor.logs",
    "recording_from_columns": "eivor.logs",
    "regression": "eivor.models.regression",
    "sign_perturbed_set": "eivor.estimation.weak_identification",
    "simulate": "eivor.models.simulation",
    "weighted_total_least_squares": "eivor.linalg.weighted_total_least_squares",
}

#: Public names that are modules themselves.
_MODULES = frozenset({"covariances", "methods"})

__version__ = version("eivor")
__all__ = [
    "AndersonRubinSet",
    "AutocorrelatedErrors",
    "Column",
    "ConfidenceRegion",
    "ConfidenceSet",
    "Diagnostics",
    "Estimate",
    "FlightEstimate",
    "FlightOptions",
    "FractionalNoise",
    "HomoskedasticErrors",
    "Recording",
    "Regression",
    "Scenario",
    "SignPerturbedSet",
    "SignalRegression",
    "Signals",
    "VerticalMotion",
    "WeakInstrumentsWarning",
    "WhiteNoise",
    "__version__",
    "anderson_rubin_set",
    "bootstrap",
    "bootstrap_flights",
    "covariances",
    "derived",
    "diagnose",
    "estimate_long_memory",
    "identify",
    "identify_chunks",
    "identify_flight",
    "lags",
    "methods",
    "moments",
    "ratio",
    "read_chunks",
    "read_log",
    "recording_from_columns",
    "regression",
    "sign_perturbed_set",
    "simulate",
    "weighted_total_least_squares",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'eivor' has no attribute '{name}'")
    home = import_module(_HOMES[name])
    value: object = home if name in _MODULES else getattr(home, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
