"""Eivor: the parameters of moving machines from noisy recordings, with honest intervals and a verdict.

Public names are loaded when they are first used, so that ``import eivor`` costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from eivor.late import late_names

if TYPE_CHECKING:
    from eivor.errors import WeakInstrumentsWarning
    from eivor.estimation import methods
    from eivor.estimation.chunked_fit import identify_chunks
    from eivor.estimation.derived import derived, ratio
    from eivor.estimation.diagnose import Diagnostics, diagnose
    from eivor.estimation.error_assumptions import AutocorrelatedErrors, HomoskedasticErrors
    from eivor.estimation.estimate import Estimate
    from eivor.estimation.fit import identify
    from eivor.estimation.recursive.change_detector import ChangeDetector
    from eivor.estimation.recursive.recursion import RecursiveIdentification, identify_recursively
    from eivor.estimation.resampling import bootstrap
    from eivor.estimation.streaming import moments
    from eivor.estimation.weak_identification import (
        AndersonRubinSet,
        SignPerturbedSet,
        anderson_rubin_set,
        sign_perturbed_set,
    )
    from eivor.fleets import fleet
    from eivor.flights.bootstrap import bootstrap_flights
    from eivor.flights.options import FlightOptions
    from eivor.flights.result import FlightEstimate
    from eivor.inference import covariances
    from eivor.inference.sets.confidence_region import ConfidenceRegion
    from eivor.inference.sets.confidence_set import ConfidenceSet
    from eivor.linalg.weighted_total_least_squares import weighted_total_least_squares
    from eivor.logs import read_log, recording_from_columns
    from eivor.logs.example import example_flight
    from eivor.logs.table.chunks import read_chunks
    from eivor.models.column import Column, lags
    from eivor.models.fractional.model import FractionalDifferenceModel
    from eivor.models.fractional.operator import FractionalDerivative, FractionalDifference
    from eivor.models.fractional.terms import FractionalTerm, UnknownOrder
    from eivor.models.regression import Regression, regression
    from eivor.models.separable import Bounds, Prior
    from eivor.models.signal_regression import SignalRegression
    from eivor.motions import motion_by_name
    from eivor.motions.identify import identify_flight
    from eivor.motions.vertical.model import VerticalMotion
    from eivor.planning.limits import FlightLimits
    from eivor.planning.plan import FlightPlan
    from eivor.planning.vehicle import VehicleGuess
    from eivor.report.planned import plan
    from eivor.report.read_fit import load_fit
    from eivor.report.saved_fit import SavedFit
    from eivor.report.validation import Validation, validate
    from eivor.signals.further_noises import AutoregressiveNoise, HeavyTailedNoise, RoundingNoise
    from eivor.signals.long_memory import estimate_long_memory
    from eivor.signals.noise import FractionalNoise, WhiteNoise
    from eivor.signals.recording import Recording
    from eivor.signals.signals import Signals
    from eivor.simulation.records.scenario import Scenario
    from eivor.simulation.records.simulate import simulate
    from eivor.studies import bounds

    __version__: str

#: Where each public name lives.
_HOMES = {
    "AndersonRubinSet": "eivor.estimation.weak_identification",
    "AutocorrelatedErrors": "eivor.estimation.error_assumptions",
    "ChangeDetector": "eivor.estimation.recursive.change_detector",
    "AutoregressiveNoise": "eivor.signals.further_noises",
    "Column": "eivor.models.column",
    "ConfidenceRegion": "eivor.inference.sets.confidence_region",
    "ConfidenceSet": "eivor.inference.sets.confidence_set",
    "Diagnostics": "eivor.estimation.diagnose",
    "Estimate": "eivor.estimation.estimate",
    "FlightEstimate": "eivor.flights.result",
    "FlightLimits": "eivor.planning.limits",
    "FlightPlan": "eivor.planning.plan",
    "FlightOptions": "eivor.flights.options",
    "FractionalDerivative": "eivor.models.fractional.operator",
    "FractionalDifference": "eivor.models.fractional.operator",
    "FractionalDifferenceModel": "eivor.models.fractional.model",
    "FractionalNoise": "eivor.signals.noise",
    "FractionalTerm": "eivor.models.fractional.terms",
    "HeavyTailedNoise": "eivor.signals.further_noises",
    "HomoskedasticErrors": "eivor.estimation.error_assumptions",
    "Bounds": "eivor.models.separable",
    "Prior": "eivor.models.separable",
    "Recording": "eivor.signals.recording",
    "RecursiveIdentification": "eivor.estimation.recursive.recursion",
    "Regression": "eivor.models.regression",
    "RoundingNoise": "eivor.signals.further_noises",
    "SavedFit": "eivor.report.saved_fit",
    "Scenario": "eivor.simulation.records.scenario",
    "SignPerturbedSet": "eivor.estimation.weak_identification",
    "SignalRegression": "eivor.models.signal_regression",
    "Signals": "eivor.signals.signals",
    "UnknownOrder": "eivor.models.fractional.terms",
    "Validation": "eivor.report.validation",
    "VehicleGuess": "eivor.planning.vehicle",
    "VerticalMotion": "eivor.motions.vertical.model",
    "WeakInstrumentsWarning": "eivor.errors",
    "WhiteNoise": "eivor.signals.noise",
    "anderson_rubin_set": "eivor.estimation.weak_identification",
    "bootstrap": "eivor.estimation.resampling",
    "bootstrap_flights": "eivor.flights.bootstrap",
    "bounds": "eivor.studies.bounds",
    "covariances": "eivor.inference.covariances",
    "derived": "eivor.estimation.derived",
    "diagnose": "eivor.estimation.diagnose",
    "estimate_long_memory": "eivor.signals.long_memory",
    "example_flight": "eivor.logs.example",
    "fleet": "eivor.fleets.fleet",
    "identify": "eivor.estimation.fit",
    "identify_chunks": "eivor.estimation.chunked_fit",
    "identify_flight": "eivor.motions.identify",
    "identify_recursively": "eivor.estimation.recursive.recursion",
    "lags": "eivor.models.column",
    "load_fit": "eivor.report.read_fit",
    "methods": "eivor.estimation.methods",
    "moments": "eivor.estimation.streaming",
    "motion_by_name": "eivor.motions",
    "plan": "eivor.report.planned",
    "ratio": "eivor.estimation.derived",
    "read_chunks": "eivor.logs.table.chunks",
    "read_log": "eivor.logs",
    "recording_from_columns": "eivor.logs",
    "regression": "eivor.models.regression",
    "sign_perturbed_set": "eivor.estimation.weak_identification",
    "simulate": "eivor.simulation.records.simulate",
    "validate": "eivor.report.validation",
    "weighted_total_least_squares": "eivor.linalg.weighted_total_least_squares",
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
