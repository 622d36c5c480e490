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
    from eivor.logs.mapping import recording_from_columns
    from eivor.logs.read import example_flight, read_log
    from eivor.logs.table.delimited import read_chunks
    from eivor.models.regression import Column, Regression, lags, regression
    from eivor.models.separable import Bounds, Prior
    from eivor.models.signal_regression import SignalRegression
    from eivor.motions.identify import identify_flight, log_signals
    from eivor.motions.table import motion_by_name
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

#: Public names by the module where they live.
_PLACES = {
    "eivor.errors": "WeakInstrumentsWarning",
    "eivor.estimation.bootstrap": "bootstrap",
    "eivor.estimation.derived": "derived ratio",
    "eivor.estimation.diagnose": "Diagnostics diagnose",
    "eivor.estimation.estimate": "Estimate",
    "eivor.estimation.methods": "identify",
    "eivor.estimation.recursive": "ChangeDetector RecursiveIdentification identify_recursively",
    "eivor.estimation.streaming": "identify_chunks moments",
    "eivor.estimation.weak_identification": "AndersonRubinSet AutocorrelatedErrors HomoskedasticErrors "
    "SignPerturbedSet anderson_rubin_set sign_perturbed_set",
    "eivor.fleet": "fleet",
    "eivor.flights.options": "FlightOptions",
    "eivor.flights.pooling": "bootstrap_flights",
    "eivor.flights.result": "FlightEstimate",
    "eivor.inference.confidence_set": "ConfidenceSet",
    "eivor.inference.covariance": "covariances",
    "eivor.inference.regions": "ConfidenceRegion",
    "eivor.lab.cramer_rao": "bounds",
    "eivor.lab.fractional_model": "FractionalDerivative FractionalDifference "
    "FractionalDifferenceModel FractionalTerm UnknownOrder",
    "eivor.lab.records": "Scenario simulate",
    "eivor.linalg.total_least_squares": "weighted_total_least_squares",
    "eivor.logs.mapping": "recording_from_columns",
    "eivor.logs.read": "example_flight read_log",
    "eivor.logs.table.delimited": "read_chunks",
    "eivor.methods": "methods",
    "eivor.models.regression": "Column Regression lags regression",
    "eivor.models.separable": "Bounds Prior",
    "eivor.models.signal_regression": "SignalRegression",
    "eivor.motions.table": "motion_by_name",
    "eivor.motions.identify": "identify_flight log_signals",
    "eivor.motions.vertical.model": "VerticalMotion",
    "eivor.planning.plan": "FlightPlan",
    "eivor.planning.vehicle": "FlightLimits VehicleGuess",
    "eivor.report.other_results": "plan",
    "eivor.report.saved_fit": "SavedFit load_fit",
    "eivor.report.validation": "Validation validate",
    "eivor.signals.noise": "AutoregressiveNoise FractionalNoise HeavyTailedNoise "
    "RoundingNoise WhiteNoise estimate_long_memory",
    "eivor.signals.recording": "Recording",
    "eivor.signals.signals": "Signals",
}
_HOMES = {name: module for module, names in _PLACES.items() for name in names.split()}

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
    if name == "__version__":
        from importlib.metadata import version

        value: object = version("eivor")
    else:
        value = import_module(_HOMES[name]) if name in _MODULES else _late(name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
