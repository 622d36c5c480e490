"""Eivor: the parameters of moving machines from noisy recordings, with honest intervals and a verdict."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from eivor.tools import late_names

if TYPE_CHECKING:
    from eivor import fleet, methods
    from eivor.errors import WeakInstrumentsWarning
    from eivor.estimation.bootstrap import bootstrap
    from eivor.estimation.derived import derived, ratio
    from eivor.estimation.diagnose import Diagnostics, diagnose
    from eivor.estimation.estimate import Estimate
    from eivor.estimation.methods import identify
    from eivor.estimation.recursive import ChangeDetector, RecursiveIdentification, identify_recursively
    from eivor.estimation.streaming import identify_chunks, moments
    from eivor.estimation.weak_identification import (
        AndersonRubinSet,
        AutocorrelatedErrors,
        HomoskedasticErrors,
        SignPerturbedSet,
        anderson_rubin_set,
        sign_perturbed_set,
    )
    from eivor.flights.options import FlightOptions
    from eivor.flights.pooling import bootstrap_flights
    from eivor.flights.result import FlightEstimate
    from eivor.inference import covariance as covariances
    from eivor.inference.confidence_set import ConfidenceSet
    from eivor.inference.regions import ConfidenceRegion
    from eivor.lab import cramer_rao as bounds
    from eivor.lab.fractional_model import (
        FractionalDerivative,
        FractionalDifference,
        FractionalDifferenceModel,
        FractionalTerm,
        UnknownOrder,
    )
    from eivor.lab.records import Scenario, simulate
    from eivor.linalg.total_least_squares import weighted_total_least_squares
    from eivor.logs import read_log, recording_from_columns
    from eivor.logs.read import example_flight
    from eivor.logs.table.delimited import read_chunks
    from eivor.models.regression import Column, Regression, lags, regression
    from eivor.models.separable import Bounds, Prior
    from eivor.models.signal_regression import SignalRegression
    from eivor.motions import motion_by_name
    from eivor.motions.identify import identify_flight, log_signals
    from eivor.motions.vertical.model import VerticalMotion
    from eivor.planning.plan import FlightPlan
    from eivor.planning.vehicle import FlightLimits, VehicleGuess
    from eivor.report.other_results import plan
    from eivor.report.saved_fit import SavedFit, load_fit
    from eivor.report.validation import Validation, validate
    from eivor.signals.noise import (
        AutoregressiveNoise,
        FractionalNoise,
        HeavyTailedNoise,
        RoundingNoise,
        WhiteNoise,
        estimate_long_memory,
    )
    from eivor.signals.recording import Recording
    from eivor.signals.signals import Signals


if TYPE_CHECKING:
    __version__: str

#: Where each public name lives.
_HOMES = {
    "AndersonRubinSet": "eivor.estimation.weak_identification",
    "AutocorrelatedErrors": "eivor.estimation.weak_identification",
    "ChangeDetector": "eivor.estimation.recursive",
    "AutoregressiveNoise": "eivor.signals.noise",
    "Column": "eivor.models.regression",
    "ConfidenceRegion": "eivor.inference.regions",
    "ConfidenceSet": "eivor.inference.confidence_set",
    "Diagnostics": "eivor.estimation.diagnose",
    "Estimate": "eivor.estimation.estimate",
    "FlightEstimate": "eivor.flights.result",
    "FlightLimits": "eivor.planning.vehicle",
    "FlightPlan": "eivor.planning.plan",
    "FlightOptions": "eivor.flights.options",
    "FractionalDerivative": "eivor.lab.fractional_model",
    "FractionalDifference": "eivor.lab.fractional_model",
    "FractionalDifferenceModel": "eivor.lab.fractional_model",
    "FractionalNoise": "eivor.signals.noise",
    "FractionalTerm": "eivor.lab.fractional_model",
    "HeavyTailedNoise": "eivor.signals.noise",
    "HomoskedasticErrors": "eivor.estimation.weak_identification",
    "Bounds": "eivor.models.separable",
    "Prior": "eivor.models.separable",
    "Recording": "eivor.signals.recording",
    "RecursiveIdentification": "eivor.estimation.recursive",
    "Regression": "eivor.models.regression",
    "RoundingNoise": "eivor.signals.noise",
    "SavedFit": "eivor.report.saved_fit",
    "Scenario": "eivor.lab.records",
    "SignPerturbedSet": "eivor.estimation.weak_identification",
    "SignalRegression": "eivor.models.signal_regression",
    "Signals": "eivor.signals.signals",
    "UnknownOrder": "eivor.lab.fractional_model",
    "Validation": "eivor.report.validation",
    "VehicleGuess": "eivor.planning.vehicle",
    "VerticalMotion": "eivor.motions.vertical.model",
    "WeakInstrumentsWarning": "eivor.errors",
    "WhiteNoise": "eivor.signals.noise",
    "anderson_rubin_set": "eivor.estimation.weak_identification",
    "bootstrap": "eivor.estimation.bootstrap",
    "bootstrap_flights": "eivor.flights.pooling",
    "bounds": "eivor.lab.cramer_rao",
    "covariances": "eivor.inference.covariance",
    "derived": "eivor.estimation.derived",
    "diagnose": "eivor.estimation.diagnose",
    "estimate_long_memory": "eivor.signals.noise",
    "example_flight": "eivor.logs.read",
    "fleet": "eivor.fleet",
    "identify": "eivor.estimation.methods",
    "identify_chunks": "eivor.estimation.streaming",
    "identify_flight": "eivor.motions.identify",
    "log_signals": "eivor.motions.identify",
    "identify_recursively": "eivor.estimation.recursive",
    "lags": "eivor.models.regression",
    "load_fit": "eivor.report.saved_fit",
    "methods": "eivor.methods",
    "moments": "eivor.estimation.streaming",
    "motion_by_name": "eivor.motions",
    "plan": "eivor.report.other_results",
    "ratio": "eivor.estimation.derived",
    "read_chunks": "eivor.logs.table.delimited",
    "read_log": "eivor.logs",
    "recording_from_columns": "eivor.logs",
    "regression": "eivor.models.regression",
    "sign_perturbed_set": "eivor.estimation.weak_identification",
    "simulate": "eivor.lab.records",
    "validate": "eivor.report.validation",
    "weighted_total_least_squares": "eivor.linalg.total_least_squares",
}

#: Public names that are modules themselves.
_MODULES = frozenset({"bounds", "covariances", "fleet", "methods"})

__all__ = [
    "AndersonRubinSet",
    "AutocorrelatedErrors",
    "AutoregressiveNoise",
    "Bounds",
    "ChangeDetector",
    "Column",
    "ConfidenceRegion",
    "ConfidenceSet",
    "Diagnostics",
    "Estimate",
    "FlightEstimate",
    "FlightLimits",
    "FlightOptions",
    "FlightPlan",
    "FractionalDerivative",
    "FractionalDifference",
    "FractionalDifferenceModel",
    "FractionalNoise",
    "FractionalTerm",
    "HeavyTailedNoise",
    "HomoskedasticErrors",
    "Prior",
    "Recording",
    "RecursiveIdentification",
    "Regression",
    "RoundingNoise",
    "SavedFit",
    "Scenario",
    "SignPerturbedSet",
    "SignalRegression",
    "Signals",
    "UnknownOrder",
    "Validation",
    "VehicleGuess",
    "VerticalMotion",
    "WeakInstrumentsWarning",
    "WhiteNoise",
    "__version__",
    "anderson_rubin_set",
    "bootstrap",
    "bootstrap_flights",
    "bounds",
    "covariances",
    "derived",
    "diagnose",
    "estimate_long_memory",
    "example_flight",
    "fleet",
    "identify",
    "identify_chunks",
    "identify_flight",
    "identify_recursively",
    "lags",
    "load_fit",
    "log_signals",
    "methods",
    "moments",
    "motion_by_name",
    "plan",
    "ratio",
    "read_chunks",
    "read_log",
    "recording_from_columns",
    "regression",
    "sign_perturbed_set",
    "simulate",
    "validate",
    "weighted_total_least_squares",
]


_late = late_names(__name__, _HOMES)


def __getattr__(name: str) -> object:
    value = globals()[name] = _version() if name == "__version__" else _public(name)
    return value


def _version() -> str:
    from importlib.metadata import version

    return version("eivor")


def _public(name: str) -> object:
    return import_module(_HOMES[name]) if name in _MODULES else _late(name)


def __dir__() -> list[str]:
    return __all__
