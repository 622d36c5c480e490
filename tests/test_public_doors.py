"""Wrong types at every public door: each is told in a sentence, and none ends in an error of Python's own."""

from __future__ import annotations

import inspect
import json
import warnings
from functools import cache
from operator import attrgetter
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest
from scipy.signal import lfilter

import eivor as ev
import shape_checks
from eivor.errors import EivorError
from eivor.estimation.estimate import Estimate
from eivor.flights.result import FlightEstimate
from eivor.models.frequency_response import FrequencyResponse
from eivor.planning.plan import FlightPlan, MachinePlan
from eivor.report.validation import Validation
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
TEXTS = {"text", "bytes", "texts"}
ANY_NUMBER = {*NUMBER, "negative"}
#: Parameters of the fractional difference equation.
FRACTIONAL = {"output_coefficient_2": 2.0, "input_coefficient_1": 1.0}
#: What a door takes after all, by the names of its arguments; nothing else.
ACCEPTED: dict[str, dict[str, set[str]]] = {
    "anderson_rubin_set": {"averages": {"none", "whole"}},
    "actuator": {"lag_s delay_s": {"list"}},  # read by the machine
    "behind": {"of actuator": {"text"}},
    "input": {"unit": {"text"}},
    "machine": {
        "name": {"text"},
        "actuators let derived axes": {"none", "mapping"},
        "instruments headline": {"list"},
        "band_hz": {"none"},
        "weak_half_width": NUMBER,
    },
    "reference": {"unit": {"text"}},
    "bootstrap": {"runs": {"whole"}, "block_length": {"none", "whole"}, "seed": {"whole"}},
    "ChangeDetector": {
        "threshold drift limit": NUMBER,
        "held_looks": {"whole"},
    },
    "RecursiveIdentification": {"instruments": {"list"}, "detector": {"none"}},
    # a stream is looked at as it comes
    "identify_recursively": {
        "chunks": {*TEXTS, "list", "pair", "mixed", "mapping", "mapping of texts", "array", "complex array"}
    },
    "Column": {"channel gain_channel": {"text"}, "lag": {"whole"}, "gain": ANY_NUMBER},
    "lags": {"channel": {"text"}, "last": {"whole"}},
    "derived": {"function": {"function", "type"}},  # what they raise is theirs
    "plan": {"limits": {"none"}, "seed": {"whole"}},
    "ratio": {"numerator denominator": ANY_NUMBER},
    "estimate_long_memory": {"bandwidth": {"none"}},
    "identify_chunks": {"chunks": {"function", "type"}},
    "identify_flight": {"options windows": {"none"}, "progress": {"function", "type"}},
    "identify_log": {"options windows": {"none"}, "progress": {"function", "type"}},
    "validate": {"window max_tilt_deg": {"none"}},
    "FlightOptions": {
        "window lag": {"none"},
        "max_tilt_deg accelerometer_bias": NUMBER,
        "input input_map method": {"text"},
        "instruments terms": {"list", "texts"},
        "compare align pool_anyway": {"flag"},
        "rotor_radius controller_rate_hz": {*NUMBER, "none"},
        "order": {"none", "whole"},
        "noise": {"none", "mapping"},
    },
    "Bounds": {"low high": ANY_NUMBER},
    "FlightLimits": {"speed acceleration": NUMBER},
    "VehicleGuess": {
        "issue_times_known": {"flag"},
        "viscous_friction": {"number"},
        "gust_rms acceleration_noise": NUMBER,
        "densities controller": {"none"},
        "requested": {"text"},
    },
    "Prior": {"mean": ANY_NUMBER, "std": NUMBER},
    "FractionalNoise": {"std": NUMBER, "order": {"negative"}},
    "FractionalTerm": {"order": ANY_NUMBER, "lag": {"whole"}},
    "UnknownOrder": {"name": {"text"}, "low": {"negative"}, "high": NUMBER},
    "FractionalDifferenceModel.problem": {"instruments": {"list"}, "divided_by_output_at": {"none"}},
    "FractionalDifferenceModel.impulse_response": {"count": {"whole"}, "rate_hz": NUMBER},
    "FractionalDifferenceModel.simulate": {"driven": {"array"}, "rate_hz": NUMBER},
    "FractionalDifferenceModel.frequency_response": {"frequency_hz": {"list"}, "rate_hz": NUMBER},
    "AutoregressiveNoise": {"std": NUMBER},
    "HeavyTailedNoise": {"degrees": {"whole"}, "std": NUMBER},
    "RoundingNoise": {"std": NUMBER},
    "WhiteNoise": {"std": NUMBER},
    "frequency_response": {
        "reference": {"none"},
        "rate_hz": NUMBER,
        "frequency_hz": {"none", *NUMBER},
        "period_s": {"none", *NUMBER},
    },
    "iv": {"names": {"none", "texts"}, "Z": {"none"}},
    "regression": {"names": {"none", "texts"}, "noise_covariance instrument_noise_covariance": {"none"}},
    "Regression": {"regressor_noise instrument_noise": {"none"}},
    "Scenario": {
        "viscous_friction rate_hz": NUMBER,
        "input_gain": ANY_NUMBER,
        "samples": {"whole"},
        "noise noise_to_signal": {"mapping"},
        "disturbance disturbance_to_signal control": {"none"},
    },
    "SignalRegression": {"instrument_columns": {"list"}},
    "Signals": {
        "rate_hz": NUMBER,
        "noise": {"mapping"},
        "valid": {"none"},
        "start_s": ANY_NUMBER,
        "offset": {"whole"},
    },
    "VerticalMotion": {"intercept": {"flag"}},
    "VerticalMotion.regression": {"instruments": {"list"}},
    "read_log": {"channel_map": {"none"}},
    "read_chunks": {
        "path": {"text"},  # opened when the first chunk is asked for
        "rate_hz": {*ANY_NUMBER, "nan"},  # and judged then
        "channels": {"none", "mapping", "mapping of texts"},
        "noise": {"none", "mapping"},
        "rows": {"whole"},
    },
    "recording_from_columns": {
        "name input_map": {"text"},
        "parameters": {"none", "mapping"},
        "estimated": {"list"},
    },
    "Recording": {
        "name vehicle format sha256 input_map": {"text"},
        "channels parameters looked_for": {"mapping"},
        "findings": {"list"},
    },
    "ConfidenceSet": {"intervals": {"list"}},
    "ConfidenceSet.contains": {"value": {*ANY_NUMBER, "nan"}},
    "methods.extended_iv": {"weighting": {"none"}},
    "methods.generalized_iv": {"weighting": {"none"}},
    "methods.TwoStepRobust": {"bandwidth": {"none", "whole"}},
    "methods.regularised": {"parameter": {"none", *NUMBER}, "towards": {"none", "list", "array"}},
    "methods.fuller": {"strength": NUMBER},
    "methods.generalized_fuller": {"strength": NUMBER},
    "bounds.cramer_rao": {"runs seed": {"whole"}},
    "covariances.EqualWeightedCosines": {"averages": {"whole"}},
    "covariances.KernelRobust": {"fixed_b": {"flag"}},
    "covariances.FixedBandwidth": {"bandwidth": NUMBER},
}
#: Doors that take seconds; right arguments are given to them elsewhere.
FLIGHTS = {"bootstrap_flights", "identify_flight", "identify_log", "plan", "validate"}
#: Public names that nobody calls: results, what warnings are of, and rooms.
NOT_DOORS = {
    *("AndersonRubinSet", "ConfidenceRegion", "Diagnostics", "Estimate", "FlightEstimate", "LogEstimate"),
    "FlightPlan",
    *("SavedFit", "FractionalDerivative", "FractionalDifference", "SignPerturbedSet"),
    *("Validation", "WeakInstrumentsWarning", "__version__", "bounds", "covariances", "fleet", "methods"),
    *("Frame", "Status"),
}

#: Doors of which every argument has a default.
WITHOUT_ARGUMENTS = {
    *("ChangeDetector", "FlightLimits", "VehicleGuess", "VerticalMotion"),
    *("example_flight", "actuator", "input", "reference", "covariances.KernelRobust"),
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
    m = SimpleNamespace(X=X, y=y, Z=Z, rng=rng, iv=ev.methods.extended_iv())
    m.rows = ev.regression(response=y, regressors=X, instruments=Z)
    m.signals = ev.Signals(5.0, {"velocity_z": X[:, 0], "input": X[:, 1], "specific_force_z": y})
    m.fit = ev.identify(m.rows, m.iv)
    m.scenario = ev.Scenario(0.3, 0.02, samples=50)
    m.motion = ev.VerticalMotion(intercept=False)
    m.fractional = ev.FractionalDifferenceModel((0.0, 0.5), (0.0,))
    m.fractional_signals = ev.Signals(1.0, {"output": y, "input": X[:, 1]})
    m.recording = ev.recording_from_columns({"time": np.arange(0.0, 12.0, 0.2), "velocity_z": y})
    m.drawn, m.found = ev.bootstrap(m.rows, m.iv, runs=49), ev.anderson_rubin_set(m.rows, m.iv)
    return m


def doors(folder):
    """Every door with right arguments: public names, then methods of what they give."""
    m = made()
    noisy = ev.Scenario(0.3, 0.02, samples=50, noise=dict.fromkeys(NOISY, ev.WhiteNoise(0.1)))
    model = {"model": m.motion, "method": m.iv, "instruments": ev.lags("input", 0, 2)}
    parquet, fit_file, log = (folder / name for name in ("rows.parquet", "fit.json", "log.csv"))
    empty = {"verdict": "refused", "reasons": [], "parameters": {}, "derived": {}}
    fit_file.write_text(json.dumps({"schema": "eivor.identify/1", **empty}))
    pl.DataFrame({"time": np.arange(60.0), "velocity_z": m.y}).write_parquet(parquet)
    log.write_text("time,velocity_z\n0,1\n1,2\n", encoding="utf-8")
    matrix = {"response": m.y, "regressors": m.X, "instruments": m.Z}
    # A type that has no public name.
    system = inspect.signature(ev.weighted_total_least_squares, eval_str=True).parameters["system"].annotation
    covariances = np.tile(np.eye(3), (60, 1, 1))
    name, std = {"name": "theta_1"}, {"std": 1.0}
    unknown = ev.UnknownOrder("order", 0.2, 0.9)
    region, of_fraction = m.found.region, {"parameters": FRACTIONAL}
    columns = {"time": np.arange(60.0), "velocity_z": m.y}
    u = np.random.default_rng(1).standard_normal(900)
    turned = lfilter([0.0, 0.2], [1.0, -0.9], u)
    response = {"u": u, "y": turned, "reference": u, "rate_hz": 20.0}
    measured = ev.frequency_response(**response)
    plain = {
        **{door: {} for door in WITHOUT_ARGUMENTS},
        "Column": {"channel": "input"},
        "ConfidenceSet": {"intervals": ((0.0, 1.0),)},
        "FlightOptions": {"noise": {"velocity_z": 0.02}, "rotor_radius": 0.1, "controller_rate_hz": 400.0},
        "FractionalNoise": {**std, "order": 0.2},
        "AutoregressiveNoise": {**std, "coefficient": 0.9},
        "HeavyTailedNoise": {**std, "degrees": 3.0},
        "RoundingNoise": std,
        "Recording": {name: getattr(m.recording, name) for name in ("name", "format", "channels", "frame")},
        "RecursiveIdentification": model,
        "Regression": {**matrix, "parameters": m.rows.parameters, "layout": m.rows.layout}
        | {"regressor_noise": np.eye(3), "instrument_noise": np.zeros((2, 3))},
        "Scenario": {"viscous_friction": 0.3, "input_gain": 0.02},
        "SignalRegression": {"signals": m.signals, "equation": m.motion.equation()},
        "Signals": {"rate_hz": 5.0, "channels": {"input": m.y}, "noise": {"input": ev.WhiteNoise(1.0)}},
        "FractionalDifferenceModel": {"output": (0.0, unknown), "input": (ev.FractionalTerm(0.0),)},
        "FractionalTerm": {"order": 0.5, "lag": 1},
        "UnknownOrder": {"name": "order", "low": 0.2, "high": 0.9},
        "Bounds": {"low": -2.0, "high": 4.0},
        "Prior": {"mean": 0.07, "std": 0.015},
        "WhiteNoise": std,
        "iv": {"y": m.rows.response, "X": m.rows.regressors, "Z": m.rows.instruments, "names": ("a", "b")},
        "frequency_response": response,
        "transfer_functions": {"response": measured},
        "loop_margins": {"loop": lambda s: 9.0 / (s * (0.1 * s + 1.0))},
        "margin_intervals": {
            "of": ev.transfer_functions(measured, orders=(1,)),
            "controller": lambda s: 0.1 + 0.0 * s,
        },
        "proposed_controllers": {"models": ev.transfer_functions(measured, orders=(1,))},
        "anderson_rubin_set": {"problem": m.rows, "method": m.iv},
        "bootstrap": {"problem": m.rows, "method": m.iv, "runs": 3, "block_length": 2},
        "bootstrap_flights": {"fit": None, "runs": 3},
        "derived": {"estimate": m.fit, "function": lambda p: p["theta_1"]},
        "diagnose": {"estimate": m.fit},
        "estimate_long_memory": {"values": m.y, "bandwidth": 20},
        "identify": {"problem": m.rows, "method": m.iv},
        "identify_chunks": {"chunks": lambda: [m.signals], **model},
        "identify_flight": {"recordings": m.recording, "progress": print},
        "identify_log": {"recordings": m.recording, "progress": print},
        "identify_recursively": {"chunks": [m.signals], "recursion": ev.RecursiveIdentification(**model)},
        "load_fit": {"file": fit_file},
        "lags": {"channel": "input", "first": 0, "last": 2},
        "moments": {"chunks": [m.signals], **model},
        "behind": {"of": "u", "actuator": "servo"},
        "load_machine": {"source": "rover"},
        "machine": {
            "name": "drag",
            "channels": {"drag_speed": "m/s", "drag_command": ev.input()},
            "response": "ddt(drag_speed)",
            "terms": {"c": "-drag_speed", "a": "drag_command"},
        },
        "motion_by_name": {"name": "vertical"},
        "plan": {"source": ev.VehicleGuess(), "target": "lag"},
        "ratio": {"estimate": m.fit, "numerator": "theta_1", "denominator": "theta_2"},
        "read_chunks": {"path": parquet, "rate_hz": 5.0},
        "read_log": {"path": log, "max_bytes": 1000},
        "recording_from_columns": {"columns": columns, "name": "a"},
        "regression": {**matrix, "names": ["a", "b"], "noise_covariance": np.eye(3)}
        | {"instrument_noise_covariance": np.zeros((2, 3))},
        "sign_perturbed_set": {"problem": m.rows, "method": m.iv, "rng": m.rng},
        "shipped_scenario": {"name": "v"},
        "simulate": {"scenario": m.scenario, "rng": m.rng},
        "validate": {"fit": fit_file, "recording": m.recording},
        "weighted_total_least_squares": {"system": system(m.X, m.y), "row_covariances": covariances},
        "methods.extended_iv": {"weighting": ev.methods.TwoStage()},
        "methods.generalized_iv": {"weighting": ev.methods.TwoStage()},
        "methods.by_name": {"name": "reference_iv"},
        "methods.regularised": {"method": m.iv, "parameter": 0.1},
        "methods.fuller": {"strength": 4.0},
        "methods.generalized_fuller": {"strength": 4.0},
        "methods.TwoStepRobust": {"bandwidth": 3},
        "bounds.cramer_rao": {"scenario": noisy, "runs": 1},
        "fleet.open": {"folder": write_fleet(folder / "fleet", [row("a")])},
        "covariances.EqualWeightedCosines": {"averages": 8},
        "covariances.FixedBandwidth": {"bandwidth": 3.0},
        "covariances.Widest": {"estimators": (ev.covariances.Classical(),)},
    }
    of_results = {
        "VerticalMotion.regression": (m.motion.regression, {"signals": m.signals}),
        "FractionalDifferenceModel.problem": (
            m.fractional.problem,
            {"signals": m.fractional_signals, "divided_by_output_at": FRACTIONAL},
        ),
        "FractionalDifferenceModel.impulse_response": (
            m.fractional.impulse_response,
            {**of_fraction, "count": 9, "rate_hz": 1.0},
        ),
        "FractionalDifferenceModel.simulate": (
            m.fractional.simulate,
            {**of_fraction, "driven": m.y, "rate_hz": 1.0},
        ),
        "FractionalDifferenceModel.frequency_response": (
            m.fractional.frequency_response,
            {**of_fraction, "frequency_hz": np.array([0.1]), "rate_hz": 1.0},
        ),
        "Estimate.interval": (m.fit.interval, name),
        "Estimate.std_error": (m.fit.std_error, name),
        "Estimate.ellipse": (m.fit.ellipse, {**name, "other": "theta_2"}),
        "Estimate.with_covariance": (m.fit.with_covariance, {"estimator": ev.covariances.Classical()}),
        "Bootstrap.interval": (m.drawn.interval, name),
        "Bootstrap.std_error": (m.drawn.std_error, name),
        "AndersonRubinSet.interval": (m.found.interval, name),
        "ConfidenceRegion.interval": (region.interval, name),
        "ConfidenceRegion.contains": (region.contains, {"theta": [1.0, 2.0]}),
        "ConfidenceSet.contains": (ev.ConfidenceSet(((0.0, 1.0),)).contains, {"value": 0.5}),
        "Signals.channel": (m.signals.channel, {"name": "input"}),
        "Recording.channel": (m.recording.channel, {"name": "velocity_z"}),
    }
    return {door: (attrgetter(door)(ev), given) for door, given in plain.items()} | of_results


def check(door, call, given):
    """Every argument of a door with every wrong value; none is left out."""
    parameters = [
        item for item in inspect.signature(call).parameters.values() if item.kind is not item.VAR_KEYWORD
    ]
    right = {item.name: given.get(item.name, item.default) for item in parameters}
    assert set(given) <= set(right)
    assert not any(value is inspect.Parameter.empty for value in right.values())
    accepted_by = {name: kinds for names, kinds in ACCEPTED.get(door, {}).items() for name in names.split()}
    if door not in FLIGHTS:
        call(**right)
    for argument in right:
        accepted = accepted_by.get(argument, set())
        for kind, wrong in WRONG.items():
            arguments = {**right, argument: wrong}
            if kind in accepted:
                if kind not in {"function", "type"} and door not in FLIGHTS:
                    call(**arguments)
            else:
                with pytest.raises(EivorError) as reported:
                    call(**arguments)
                told = reported.value
                assert all((told.expected, told.received, told.remedy)), (argument, kind)
                assert len(str(told)) < 2000, (argument, kind)


@pytest.fixture(scope="module")
def every_door(tmp_path_factory):
    with shape_checks.unchecked(), warnings.catch_warnings():
        warnings.simplefilter("ignore", ev.WeakInstrumentsWarning)
        return doors(tmp_path_factory.mktemp("doors"))


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.parametrize("door", sorted(set(ev.__all__) - NOT_DOORS))
def test_wrong_types_are_told_in_a_sentence(door, every_door):
    check(door, *every_door[door])


@pytest.mark.usefixtures("unchecked_shapes")
@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
def test_methods_of_results_and_rooms_tell_wrong_types_too(every_door):
    named = {door: parts for door, parts in every_door.items() if "." in door}
    assert len(named) >= 30
    for door, parts in named.items():
        check(door, *parts)


def test_results_are_text():
    results = (FlightPlan, MachinePlan, Validation, FrequencyResponse, FlightEstimate, Estimate)
    assert all(callable(getattr(item, "summary", None)) for item in results)
    assert callable(Validation._repr_html_)
