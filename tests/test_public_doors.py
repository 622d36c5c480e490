"""Wrong types at every public door: each is told in a sentence, and none ends in an error of Python's own."""

from __future__ import annotations

import inspect
import json
from functools import cache
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

import eivor as ev
from eivor import methods
from eivor.errors import EivorError
from eivor.linalg import LinearSystem
from eivor.models.regression import Parameter, SampleRows
from eivor.signals.recording import Frame, LogOrigin
from eivor.signals.thrust_map import Power
from fleets.fleet_rows import row, write_fleet

#: What is given in place of a right argument, each under the name that `ACCEPTED` calls it.
WRONG = {
    "none": None,
    "whole": 3,
    "negative": -1,
    "number": 1.5,
    "nan": float("nan"),
    "huge": 10**400,
    "complex": 1.0 + 2.0j,
    "flag": True,
    "text": "x",
    "bytes": b"x",
    "list": [],
    "texts": ["a", "b"],
    "pair": ("a", 1),
    "mixed": [1, "a", None],
    "mapping": {},
    "mapping of texts": {"input": "x"},
    "array": np.arange(3.0),
    "complex array": np.arange(3) + 1j,
    "object": object(),
    "function": len,
    "type": int,
}
NUMBER = {"whole", "number"}
ANY_NUMBER = {*NUMBER, "negative"}
#: Parameters of the fractional difference equation.
FRACTIONAL = {"output_coefficient_2": 2.0, "input_coefficient_1": 1.0}
#: What a door takes after all; nothing else.
ACCEPTED = {
    ("anderson_rubin_set", "errors"): {"none"},
    ("AutocorrelatedErrors", "averages"): {"none", "whole"},
    ("bootstrap", "runs"): {"whole"},
    ("bootstrap", "block_length"): {"none", "whole"},
    ("bootstrap", "seed"): {"whole", "huge"},
    ("ChangeDetector", "threshold"): NUMBER,
    ("ChangeDetector", "drift"): NUMBER,
    ("ChangeDetector", "limit"): NUMBER,
    ("ChangeDetector", "scale_looks"): {"whole"},
    ("ChangeDetector", "least_looks"): {"whole"},
    ("ChangeDetector", "kept_looks"): {"whole"},
    ("ChangeDetector", "held_looks"): {"whole"},
    ("RecursiveIdentification", "instruments"): {"list"},
    ("RecursiveIdentification", "detector"): {"none"},
    # a stream is looked at as it comes
    ("identify_recursively", "chunks"): {
        *("text", "bytes", "list", "texts", "pair", "mixed", "mapping", "mapping of texts"),
        *("array", "complex array"),
    },
    ("Column", "channel"): {"text"},
    ("Column", "lag"): {"whole"},
    ("Column", "gain"): ANY_NUMBER,
    ("Column", "gain_channel"): {"text"},
    ("lags", "channel"): {"text"},
    ("lags", "last"): {"whole"},
    ("derived", "function"): {"function", "type"},  # what they raise is theirs
    ("plan", "limits"): {"none"},
    ("plan", "seed"): {"whole"},
    ("ratio", "numerator"): ANY_NUMBER,
    ("ratio", "denominator"): ANY_NUMBER,
    ("estimate_long_memory", "bandwidth"): {"none"},
    ("identify_chunks", "chunks"): {"function", "type"},
    ("identify_flight", "options"): {"none"},
    ("identify_flight", "windows"): {"none"},
    ("identify_flight", "progress"): {"function", "type"},
    ("validate", "window"): {"none"},
    ("validate", "max_tilt_deg"): {"none"},
    ("FlightOptions", "window"): {"none"},
    ("FlightOptions", "max_tilt_deg"): NUMBER,
    ("FlightOptions", "input"): {"text"},
    ("FlightOptions", "input_map"): {"text"},
    ("FlightOptions", "instruments"): {"list", "texts"},
    ("FlightOptions", "method"): {"text"},
    ("FlightOptions", "compare"): {"flag"},
    ("FlightOptions", "align"): {"flag"},
    ("FlightOptions", "lag"): {"none"},
    ("FlightOptions", "accelerometer_bias"): NUMBER,
    ("FlightOptions", "terms"): {"list", "texts"},
    ("FlightOptions", "rotor_radius"): {*NUMBER, "none"},
    ("FlightOptions", "noise"): {"none", "mapping"},
    ("Bounds", "low"): ANY_NUMBER,
    ("Bounds", "high"): ANY_NUMBER,
    ("FlightLimits", "speed"): NUMBER,
    ("FlightLimits", "acceleration"): NUMBER,
    ("VehicleGuess", "viscous_friction"): {"number"},
    ("VehicleGuess", "gust_rms"): NUMBER,
    ("VehicleGuess", "acceleration_noise"): NUMBER,
    ("VehicleGuess", "densities"): {"none"},
    ("VehicleGuess", "controller"): {"none"},
    ("VehicleGuess", "requested"): {"text"},
    ("Prior", "mean"): ANY_NUMBER,
    ("Prior", "std"): NUMBER,
    ("FractionalNoise", "std"): NUMBER,
    ("FractionalDifferenceModel", "output_channel"): {"text"},
    ("FractionalDifferenceModel", "input_channel"): {"text"},
    ("FractionalTerm", "order"): ANY_NUMBER,
    ("FractionalTerm", "lag"): {"whole"},
    ("UnknownOrder", "name"): {"text"},
    ("UnknownOrder", "low"): {"negative"},
    ("UnknownOrder", "high"): NUMBER,
    ("FractionalDifferenceModel.problem", "instruments"): {"list"},
    ("FractionalDifferenceModel.problem", "divided_by_output_at"): {"none"},
    ("FractionalDifferenceModel.impulse_response", "count"): {"whole"},
    ("FractionalDifferenceModel.impulse_response", "rate_hz"): NUMBER,
    ("FractionalDifferenceModel.simulate", "driven"): {"array"},
    ("FractionalDifferenceModel.simulate", "rate_hz"): NUMBER,
    ("FractionalDifferenceModel.frequency_response", "frequency_hz"): {"list"},
    ("FractionalDifferenceModel.frequency_response", "rate_hz"): NUMBER,
    ("FractionalNoise", "order"): {"negative"},
    ("AutoregressiveNoise", "std"): NUMBER,
    ("HeavyTailedNoise", "degrees"): {"whole"},
    ("HeavyTailedNoise", "std"): NUMBER,
    ("RoundingNoise", "std"): NUMBER,
    ("WhiteNoise", "std"): NUMBER,
    ("regression", "names"): {"none", "texts"},
    ("regression", "noise_covariance"): {"none"},
    ("regression", "instrument_noise_covariance"): {"none"},
    ("Regression", "regressor_noise"): {"none"},
    ("Regression", "instrument_noise"): {"none"},
    ("Scenario", "viscous_friction"): NUMBER,
    ("Scenario", "input_gain"): ANY_NUMBER,
    ("Scenario", "rate_hz"): NUMBER,
    ("Scenario", "samples"): {"whole"},
    ("Scenario", "noise"): {"mapping"},
    ("Scenario", "noise_to_signal"): {"mapping"},
    ("Scenario", "disturbance"): {"none"},
    ("Scenario", "disturbance_to_signal"): {"none"},
    ("SignalRegression", "instrument_columns"): {"list"},
    ("Signals", "rate_hz"): NUMBER,
    ("Signals", "noise"): {"mapping"},
    ("Signals", "valid"): {"none"},
    ("Signals", "start_s"): ANY_NUMBER,
    ("Signals", "offset"): {"whole"},
    ("VerticalMotion", "intercept"): {"flag"},
    ("VerticalMotion.regression", "instruments"): {"list"},
    ("read_log", "channel_map"): {"none"},
    ("read_chunks", "path"): {"text"},  # opened when the first chunk is asked for
    ("read_chunks", "rate_hz"): {*ANY_NUMBER, "nan"},  # and judged then
    ("read_chunks", "channels"): {"none", "mapping", "mapping of texts"},
    ("read_chunks", "noise"): {"none", "mapping"},
    ("read_chunks", "rows"): {"whole"},
    ("recording_from_columns", "name"): {"text"},
    ("recording_from_columns", "input_map"): {"text"},
    ("recording_from_columns", "parameters"): {"none", "mapping"},
    ("recording_from_columns", "estimated"): {"list"},
    ("Recording", "name"): {"text"},
    ("Recording", "vehicle"): {"text"},
    ("Recording", "format"): {"text"},
    ("Recording", "channels"): {"mapping"},
    ("Recording", "sha256"): {"text"},
    ("Recording", "parameters"): {"mapping"},
    ("Recording", "input_map"): {"text"},
    ("Recording", "looked_for"): {"mapping"},
    ("Recording", "findings"): {"list"},
    ("ConfidenceSet", "intervals"): {"list"},
    ("ConfidenceSet.contains", "value"): {*ANY_NUMBER, "nan"},
    ("ConfidenceRegion.outline", "window"): {"none"},
    ("methods.extended_iv", "weighting"): {"none"},
    ("methods.generalized_iv", "weighting"): {"none"},
    ("methods.TwoStepRobust", "bandwidth"): {"none", "whole"},
    ("methods.regularised", "parameter"): {"none", *NUMBER},
    ("methods.regularised", "towards"): {"none", "list", "array"},
    ("methods.fuller", "strength"): NUMBER,
    ("methods.generalized_fuller", "strength"): NUMBER,
    ("bounds.cramer_rao", "runs"): {"whole"},
    ("bounds.cramer_rao", "seed"): {"whole"},
    ("covariances.EqualWeightedCosines", "averages"): {"whole"},
    ("covariances.ClusteredByFlight", "least_flights"): {"whole", "negative"},
    ("covariances.KernelRobust", "fixed_b"): {"flag"},
    ("covariances.FixedBandwidth", "bandwidth"): NUMBER,
}
#: Doors that take seconds; right arguments are given to them elsewhere.
FLIGHTS = {"bootstrap_flights", "identify_flight", "plan", "validate"}
#: Public names that nobody calls: results, what warnings are of, and rooms.
NOT_DOORS = {
    "AndersonRubinSet",
    "ConfidenceRegion",
    "Diagnostics",
    "Estimate",
    "FlightEstimate",
    "FlightPlan",
    "SavedFit",
    "FractionalDerivative",
    "FractionalDifference",
    "HomoskedasticErrors",
    "SignPerturbedSet",
    "Validation",
    "WeakInstrumentsWarning",
    "__version__",
    "bounds",
    "covariances",
    "fleet",
    "methods",
}


#: Channels of a scenario in open loop.
NOISY = ("input", "velocity_z", "acceleration_z")


@cache
def made():
    """Right arguments."""
    rng = np.random.default_rng(0)
    X = rng.standard_normal((60, 2))
    y = X @ [1.0, 2.0] + 0.1 * rng.standard_normal(60)
    Z = X + 0.1 * rng.standard_normal((60, 2))
    rows = ev.regression(response=y, regressors=X, instruments=Z)
    signals = ev.Signals(5.0, {"velocity_z": X[:, 0], "input": X[:, 1], "specific_force_z": y})
    iv = ev.methods.extended_iv()
    fit = ev.identify(rows, iv)
    scenario = ev.Scenario(0.3, 0.02, samples=50)
    time = np.arange(0.0, 12.0, 0.2)
    return SimpleNamespace(
        X=X,
        y=y,
        Z=Z,
        rng=rng,
        rows=rows,
        signals=signals,
        iv=iv,
        fit=fit,
        scenario=scenario,
        motion=ev.VerticalMotion(intercept=False),
        fractional=ev.FractionalDifferenceModel((0.0, 0.5), (0.0,), input_channel="input"),
        fractional_signals=ev.Signals(1.0, {"output": y, "input": X[:, 1]}),
        recording=ev.recording_from_columns({"time": time, "velocity_z": y}),
        drawn=ev.bootstrap(rows, iv, runs=49),
        found=ev.anderson_rubin_set(rows, iv),
    )


def doors(folder):
    """Every door with right arguments, the wrong ones of which are replaced one by one."""
    m = made()
    noisy = ev.Scenario(0.3, 0.02, samples=50, noise=dict.fromkeys(NOISY, ev.WhiteNoise(0.1)))
    model = {"model": m.motion, "method": m.iv, "instruments": ev.lags("input", 0, 2)}
    parquet = folder / "rows.parquet"
    fit_file = folder / "fit.json"
    empty = {
        "schema": "eivor.identify/1",
        "verdict": "refused",
        "reasons": [],
        "parameters": {},
        "derived": {},
    }
    fit_file.write_text(json.dumps(empty))
    pl.DataFrame({"time": np.arange(60.0), "velocity_z": m.y}).write_parquet(parquet)
    fleet = write_fleet(folder / "fleet", [row("a")])
    log = folder / "log.csv"
    log.write_text("time,velocity_z\n0,1\n1,2\n", encoding="utf-8")
    matrix = {"response": m.y, "regressors": m.X, "instruments": m.Z}
    name, level = {"name": "theta_1"}, {"level": 0.9}
    return {
        "AutocorrelatedErrors": (ev.AutocorrelatedErrors, {"averages": 9}),
        "ChangeDetector": (
            ev.ChangeDetector,
            {
                "threshold": 13.0,
                "drift": 0.75,
                "limit": 4.0,
                "scale_looks": 80,
                "least_looks": 20,
                "kept_looks": 3,
                "held_looks": 16,
            },
        ),
        "Column": (ev.Column, {"channel": "input", "lag": 1, "gain": 1.0, "gain_channel": ""}),
        "ConfidenceSet": (ev.ConfidenceSet, {"intervals": ((0.0, 1.0),)}),
        "FlightOptions": (
            ev.FlightOptions,
            {
                "window": (0.0, 1.0),
                "max_tilt_deg": 20.0,
                "input": "",
                "input_map": "",
                "instruments": (),
                "method": "reference_iv",
                "compare": False,
                "lag": None,
                "align": False,
                "accelerometer_bias": 0.1,
                "pool_friction": "auto",
                "terms": (),
                "rotor_radius": 0.1,
                "noise": {"velocity_z": 0.02},
            },
        ),
        "FlightLimits": (
            ev.FlightLimits,
            {"height_m": (3.0, 8.0), "speed": 2.0, "acceleration": 3.0, "tilt_deg": 20.0, "duration_s": 60.0},
        ),
        "VehicleGuess": (
            ev.VehicleGuess,
            {
                "hover_input": 0.5,
                "viscous_friction": 0.3,
                "lag_s": 0.05,
                "gust_rms": 0.3,
                "acceleration_noise": 0.4,
                "velocity_noise": 0.03,
                "tilt_rms": 0.05,
                "densities": None,
                "controller": None,
                "requested": "",
            },
        ),
        "FractionalNoise": (ev.FractionalNoise, {"std": 1.0, "order": 0.2}),
        "AutoregressiveNoise": (ev.AutoregressiveNoise, {"std": 1.0, "coefficient": 0.9}),
        "HeavyTailedNoise": (ev.HeavyTailedNoise, {"std": 1.0, "degrees": 3.0}),
        "RoundingNoise": (ev.RoundingNoise, {"std": 1.0}),
        "Recording": (
            ev.Recording,
            {
                "name": "a",
                "format": "csv",
                "channels": m.recording.channels,
                "frame": Frame.Z_UP,
                "sha256": "",
                "parameters": {},
                "input_map": "",
                "looked_for": {},
                "findings": (),
                "origin": LogOrigin(),
                "vehicle": "",
            },
        ),
        "RecursiveIdentification": (ev.RecursiveIdentification, {**model, "memory": 100.0, "detector": None}),
        "Regression": (
            ev.Regression,
            {
                **matrix,
                "parameters": (Parameter("a"), Parameter("b")),
                "layout": SampleRows(np.zeros(60, dtype=np.int64)),
                "regressor_noise": np.eye(3),
                "instrument_noise": np.zeros((2, 3)),
            },
        ),
        "Scenario": (
            ev.Scenario,
            {
                "viscous_friction": 0.3,
                "input_gain": 0.02,
                "rate_hz": 5.0,
                "samples": 100,
                "excitation": m.scenario.excitation,
                "noise": {},
                "noise_to_signal": {},
                "disturbance": None,
                "disturbance_to_signal": None,
                "route": m.scenario.route,
                "intersample": m.scenario.intersample,
                "control": m.scenario.control,
            },
        ),
        "SignalRegression": (
            ev.SignalRegression,
            {"signals": m.signals, "equation": m.motion.equation(), "instrument_columns": ()},
        ),
        "Signals": (
            ev.Signals,
            {
                "rate_hz": 5.0,
                "channels": {"input": m.y},
                "noise": {"input": ev.WhiteNoise(1.0)},
                "valid": np.ones(60, dtype=bool),
                "start_s": 0.0,
                "offset": 0,
            },
        ),
        "VerticalMotion": (ev.VerticalMotion, {"input_map": Power(1.0), "intercept": False}),
        "FractionalDifferenceModel": (
            ev.FractionalDifferenceModel,
            {
                "output": (0.0, ev.UnknownOrder("order", 0.2, 0.9)),
                "input": (ev.FractionalTerm(0.0),),
                "operator": ev.FractionalDerivative(),
                "output_channel": "output",
                "input_channel": "input",
            },
        ),
        "FractionalTerm": (ev.FractionalTerm, {"order": 0.5, "lag": 1}),
        "UnknownOrder": (ev.UnknownOrder, {"name": "order", "low": 0.2, "high": 0.9}),
        "Bounds": (ev.Bounds, {"low": -2.0, "high": 4.0}),
        "Prior": (ev.Prior, {"mean": 0.07, "std": 0.015}),
        "WhiteNoise": (ev.WhiteNoise, {"std": 1.0}),
        "anderson_rubin_set": (
            ev.anderson_rubin_set,
            {"problem": m.rows, "method": m.iv, "errors": None, **level},
        ),
        "bootstrap": (
            ev.bootstrap,
            {
                "problem": m.rows,
                "method": m.iv,
                "runs": 3,
                "block_length": 2,
                "scheme": "circular",
                "seed": 0,
            },
        ),
        "bootstrap_flights": (ev.bootstrap_flights, {"fit": None, "runs": 3, "seed": 0}),
        "derived": (ev.derived, {"estimate": m.fit, "function": lambda p: p["theta_1"], **level}),
        "diagnose": (ev.diagnose, {"estimate": m.fit}),
        "estimate_long_memory": (ev.estimate_long_memory, {"values": m.y, "bandwidth": 20}),
        "identify": (ev.identify, {"problem": m.rows, "method": m.iv}),
        "identify_chunks": (
            ev.identify_chunks,
            {"chunks": lambda: [m.signals], **model, "covariance": ev.covariances.Classical()},
        ),
        "identify_flight": (
            ev.identify_flight,
            {
                "recordings": m.recording,
                "options": None,
                "windows": None,
                "model": "vertical",
                "vehicle": "",
                "progress": print,
            },
        ),
        "identify_recursively": (
            ev.identify_recursively,
            {"chunks": [m.signals], "recursion": ev.RecursiveIdentification(**model)},
        ),
        "example_flight": (ev.example_flight, {}),
        "load_fit": (ev.load_fit, {"file": fit_file}),
        "log_signals": (
            ev.log_signals,
            {"log": ev.example_flight(), "actuator_lag": 0.05, "delay": 0.0, "model": "vertical"},
        ),
        "lags": (ev.lags, {"channel": "input", "first": 0, "last": 2}),
        "moments": (ev.moments, {"chunks": [m.signals], **model}),
        "motion_by_name": (ev.motion_by_name, {"name": "vertical"}),
        "plan": (
            ev.plan,
            {"source": ev.VehicleGuess(), "target": "lag", "limits": None, "shape": "", "seed": 0},
        ),
        "ratio": (ev.ratio, {"estimate": m.fit, "numerator": "theta_1", "denominator": "theta_2", **level}),
        "read_chunks": (
            ev.read_chunks,
            {"path": parquet, "rate_hz": 5.0, "channels": None, "noise": None, "rows": 100},
        ),
        "read_log": (ev.read_log, {"path": log, "channel_map": None, "max_bytes": 1000}),
        "recording_from_columns": (
            ev.recording_from_columns,
            {
                "columns": {"time": np.arange(60.0), "velocity_z": m.y},
                "name": "a",
                "frame": Frame.Z_UP,
                "input_map": "",
                "parameters": None,
                "estimated": (),
            },
        ),
        "regression": (
            ev.regression,
            {
                **matrix,
                "names": ["a", "b"],
                "noise_covariance": np.eye(3),
                "instrument_noise_covariance": np.zeros((2, 3)),
            },
        ),
        "sign_perturbed_set": (
            ev.sign_perturbed_set,
            {"problem": m.rows, "method": m.iv, "rng": m.rng, "level": 0.95, "sums": 100},
        ),
        "simulate": (ev.simulate, {"scenario": m.scenario, "rng": m.rng}),
        "validate": (
            ev.validate,
            {"fit": fit_file, "recording": m.recording, "window": None, "max_tilt_deg": None},
        ),
        "weighted_total_least_squares": (
            ev.weighted_total_least_squares,
            {"system": LinearSystem(m.X, m.y), "row_covariances": np.tile(np.eye(3), (60, 1, 1))},
        ),
        # methods of what they give, and of the rooms
        "VerticalMotion.regression": (m.motion.regression, {"signals": m.signals, "instruments": ()}),
        "FractionalDifferenceModel.problem": (
            m.fractional.problem,
            {"signals": m.fractional_signals, "instruments": (), "divided_by_output_at": FRACTIONAL},
        ),
        "FractionalDifferenceModel.impulse_response": (
            m.fractional.impulse_response,
            {"parameters": FRACTIONAL, "count": 9, "rate_hz": 1.0},
        ),
        "FractionalDifferenceModel.simulate": (
            m.fractional.simulate,
            {"parameters": FRACTIONAL, "driven": m.y, "rate_hz": 1.0},
        ),
        "FractionalDifferenceModel.frequency_response": (
            m.fractional.frequency_response,
            {"parameters": FRACTIONAL, "frequency_hz": np.array([0.1]), "rate_hz": 1.0},
        ),
        "Estimate.interval": (m.fit.interval, {**name, **level}),
        "Estimate.std_error": (m.fit.std_error, name),
        "Estimate.ellipse": (m.fit.ellipse, {**name, "other": "theta_2", **level}),
        "Estimate.with_covariance": (m.fit.with_covariance, {"estimator": ev.covariances.Classical()}),
        "Bootstrap.interval": (m.drawn.interval, {**name, "level": 0.9, "kind": "percentile"}),
        "Bootstrap.std_error": (m.drawn.std_error, name),
        "AndersonRubinSet.interval": (m.found.interval, name),
        "ConfidenceRegion.interval": (m.found.region.interval, name),
        "ConfidenceRegion.contains": (m.found.region.contains, {"theta": [1.0, 2.0]}),
        "ConfidenceRegion.outline": (m.found.region.outline, {"window": ((0.0, 2.0), (1.0, 3.0))}),
        "ConfidenceSet.contains": (ev.ConfidenceSet(((0.0, 1.0),)).contains, {"value": 0.5}),
        "Signals.channel": (m.signals.channel, {"name": "input"}),
        "Recording.channel": (m.recording.channel, {"name": "velocity_z"}),
        "methods.extended_iv": (methods.extended_iv, {"weighting": methods.TwoStage()}),
        "methods.generalized_iv": (methods.generalized_iv, {"weighting": methods.TwoStage()}),
        "methods.by_name": (methods.by_name, {"name": "reference_iv"}),
        "methods.regularised": (
            methods.regularised,
            {"method": m.iv, "parameter": 0.1, "towards": np.array([1.0, 2.0])},
        ),
        "methods.fuller": (methods.fuller, {"strength": 4.0}),
        "methods.generalized_fuller": (methods.generalized_fuller, {"strength": 4.0}),
        "methods.TwoStepRobust": (methods.TwoStepRobust, {"bandwidth": 3}),
        "bounds.cramer_rao": (ev.bounds.cramer_rao, {"scenario": noisy, "runs": 1, "seed": 0}),
        "fleet.open": (ev.fleet.open, {"folder": fleet}),
        "covariances.EqualWeightedCosines": (ev.covariances.EqualWeightedCosines, {"averages": 8}),
        "covariances.ClusteredByFlight": (ev.covariances.ClusteredByFlight, {"least_flights": 8}),
        "covariances.KernelRobust": (
            ev.covariances.KernelRobust,
            {"kernel": ev.covariances.Parzen(), "bandwidth": ev.covariances.NeweyWestRule(), "fixed_b": True},
        ),
        "covariances.FixedBandwidth": (ev.covariances.FixedBandwidth, {"bandwidth": 3.0}),
        "covariances.Widest": (ev.covariances.Widest, {"estimators": (ev.covariances.Classical(),)}),
    }


#: Methods of what doors give, and doors of the rooms.
MORE = (
    "VerticalMotion.regression",
    "FractionalDifferenceModel.problem",
    "FractionalDifferenceModel.impulse_response",
    "FractionalDifferenceModel.simulate",
    "FractionalDifferenceModel.frequency_response",
    "Estimate.interval",
    "Estimate.std_error",
    "Estimate.ellipse",
    "Estimate.with_covariance",
    "Bootstrap.interval",
    "Bootstrap.std_error",
    "AndersonRubinSet.interval",
    "ConfidenceRegion.interval",
    "ConfidenceRegion.contains",
    "ConfidenceRegion.outline",
    "ConfidenceSet.contains",
    "Signals.channel",
    "Recording.channel",
    "methods.extended_iv",
    "methods.generalized_iv",
    "methods.by_name",
    "methods.regularised",
    "methods.fuller",
    "methods.generalized_fuller",
    "methods.TwoStepRobust",
    "bounds.cramer_rao",
    "covariances.EqualWeightedCosines",
    "covariances.ClusteredByFlight",
    "covariances.KernelRobust",
    "covariances.FixedBandwidth",
    "covariances.Widest",
    "fleet.open",
)
NAMES = (*sorted(set(ev.__all__) - NOT_DOORS), *MORE)


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.parametrize("door", NAMES)
def test_wrong_types_are_told_in_a_sentence(door, tmp_path):
    call, right = doors(tmp_path)[door]
    # No argument is left out.
    parameters = inspect.signature(call).parameters
    assert set(right) == {
        name for name, parameter in parameters.items() if parameter.kind is not parameter.VAR_KEYWORD
    }
    if door not in FLIGHTS:
        call(**right)
    for argument in right:
        accepted = ACCEPTED.get((door, argument), set())
        for kind, wrong in WRONG.items():
            arguments = {**right, argument: wrong}
            if kind in accepted:
                if kind not in {"function", "type"} and door not in FLIGHTS:
                    call(**arguments)
            else:
                with pytest.raises(EivorError) as reported:
                    call(**arguments)
                assert all((reported.value.expected, reported.value.received, reported.value.remedy)), (
                    argument,
                    kind,
                )
                assert len(str(reported.value)) < 2000, (argument, kind)


@pytest.mark.usefixtures("unchecked_shapes")
def test_messages_say_what_to_do():
    m = made()
    for call, item in (
        (lambda: ev.identify(m.rows, "least_squares"), r"least_squares\(\); received 'least_squares'. Call"),
        (lambda: ev.bootstrap(m.rows, "least_squares"), r"least_squares\(\) for method; received 'least"),
        (lambda: ev.identify(m.signals, m.iv), r"a model's regression, .*; received Signals"),
        (lambda: ev.read_log(3), r"a path, as a text or a Path for path; received 3 \(int\).*\"flight.ulg\""),
        (lambda: ev.identify_flight(3), r"received 3 \(int\).*ev.read_log"),
        (lambda: ev.identify_flight("flight.ulg"), r"received str.*ev.read_log"),
        (lambda: ev.Signals("5", {"input": m.y}), r"a number for rate_hz; received '5' \(str\)"),
        (lambda: ev.regression(response=m.y, regressors=m.X, names="ab"), r"several texts for names"),
        (lambda: ev.estimate_long_memory(m.X), r"a record of shape \(n,\); received shape \(60, 2\)"),
        (lambda: ev.derived(m.fit, lambda _: "x"), "a number for what the function gives; received 'x'"),
        (lambda: m.fit.with_covariance("classical"), r"ev.covariances.Classical\(\)"),
        (lambda: ev.WhiteNoise(1e200), "a standard deviation up to 1e"),
        (
            lambda: ev.regression(response=m.y, regressors=m.X, noise_covariance=1e308 * np.eye(3)),
            r"variances up to 1e\+150; received 1e\+308",
        ),
    ):
        with pytest.raises(EivorError, match=item):
            call()
