"""Results in Python: at the prompt, in a notebook, in a frame, in a file, and in another process."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import eivor as ev
from eivor.errors import EstimationError, InputError, UsageError
from eivor.flights.result import FlightEstimate

LONGEST_LINE = 300


def travelled(result: Any) -> Any:
    """The same after a journey to another process."""
    return pickle.loads(pickle.dumps(result))  # noqa: S301 - what was written a moment ago


def test_one_line_for_the_prompt(fit: FlightEstimate, still: FlightEstimate):
    log = fit.prepared[0].recording
    for item in (repr(log), repr(fit), repr(fit.estimate), repr(still)):
        assert "\n" not in item
        assert len(item) < LONGEST_LINE
    assert "identified" in repr(fit)
    assert "refused" in repr(still)
    assert log.name in repr(log)


def test_a_table_for_a_notebook_escapes_what_a_log_says(fit: FlightEstimate):
    hostile = "<script>alert(1)</script>"
    log = fit.prepared[0].recording
    channels = {name: replace(channel, source=hostile) for name, channel in log.channels.items()}
    repr_html_ = replace(log, name=hostile, channels=channels)._repr_html_()
    assert "<script>" not in repr_html_
    assert "&lt;script&gt;" in repr_html_
    for table in (fit._repr_html_(), fit.estimate._repr_html_()):  # type: ignore[union-attr]
        assert table.count("<tr>") == table.count("</tr>") > 2
        assert "viscous_friction" in table


def test_frames_hold_every_quantity(fit: FlightEstimate, still: FlightEstimate):
    frame = fit.to_frame()
    assert frame["quantity"].to_list() == list(fit.quantities)
    friction = frame.row(0, named=True)
    assert friction["value"] == fit.quantities["viscous_friction"].value
    assert (friction["low"], friction["high"]) == fit.interval("viscous_friction")
    empty = still.to_frame()
    assert empty["low"].null_count() == empty.height
    assert set(empty["verdict"]) == {"refused"}


def test_results_travel_to_other_processes(fit: FlightEstimate):
    for result in (fit, fit.estimate, ev.diagnose(fit.estimate), fit.prepared[0].recording):  # type: ignore[arg-type]
        back = travelled(result)
        assert repr(back) == repr(result)
    back = travelled(fit)
    np.testing.assert_array_equal(back.covariance, fit.covariance)
    assert back.interval("viscous_friction", 0.9) == fit.interval("viscous_friction", 0.9)
    assert ev.diagnose(back.estimate).summary() == ev.diagnose(fit.estimate).summary()  # type: ignore[arg-type]


def test_an_estimate_of_arrays_travels_and_writes_itself():
    rng = np.random.default_rng(1)
    X = rng.standard_normal((100, 2))
    fit = ev.identify(
        ev.regression(response=X @ [1.0, 2.0] + rng.standard_normal(100), regressors=X),
        ev.methods.least_squares(),
    )
    assert travelled(fit).interval("theta_1") == fit.interval("theta_1")
    document = json.loads(fit.to_json())
    assert document["parameters"][0]["value"] == fit.parameters["theta_1"]
    np.testing.assert_allclose(document["covariance"], fit.covariance)


def test_a_fit_is_read_back(fit: FlightEstimate, tmp_path: Path):
    file = tmp_path / "fit.json"
    file.write_text(fit.to_json())
    saved = ev.load_fit(file)
    assert saved.verdict is fit.verdict.status
    assert saved.parameters == fit.parameters
    np.testing.assert_array_equal(saved.covariance, fit.covariance)
    assert saved.names == fit.names
    for level in (0.5, 0.95, 0.999):
        for name in saved.names:
            # the result cuts lags at zero, which no sensible one of this flight reaches
            assert saved.interval(name, level) == pytest.approx(fit.interval(name, level), rel=1e-12)
    assert saved.interval("hover_input") == fit.interval("hover_input")
    assert saved.prediction["input_map"] == fit.prepared[0].input_map
    assert saved.prediction["by_run"]["intercept"] == list(fit.quantities["intercept"].by_run)
    with pytest.raises(UsageError, match="a quantity out of viscous_friction"):
        saved.interval("friction")
    with pytest.raises(UsageError, match="or of the joint vector"):
        saved.interval("hover_input", 0.9)


def test_a_refusal_is_read_back(still: FlightEstimate, tmp_path: Path):
    file = tmp_path / "fit.json"
    file.write_text(still.to_json())
    saved = ev.load_fit(file)
    assert saved.verdict is still.verdict.status
    assert saved.reasons == still.verdict.sentences
    assert saved.names == ()
    with pytest.raises(EstimationError, match="one without"):
        saved.covariance  # noqa: B018 - reading it raises


@pytest.mark.parametrize(
    "text",
    ["", "[1]", "{}", '{"schema": "eivor.inspect/1"}', '{"schema": "eivor.identify/1"}', "[" * 100_000],
)
@pytest.mark.usefixtures("unchecked_shapes")
def test_what_is_no_fit_is_refused(text: str, tmp_path: Path):
    file = tmp_path / "x.json"
    file.write_text(text)
    with pytest.raises(InputError, match=r"a document of schema eivor\.identify/1 in x\.json"):
        ev.load_fit(file)
    with pytest.raises(InputError, match="a result that can be read"):
        ev.load_fit(tmp_path / "absent.json")
    with pytest.raises(UsageError, match="the path of a JSON file"):
        ev.load_fit(3)  # type: ignore[arg-type]


def test_parts_that_lie_are_refused(fit: FlightEstimate, tmp_path: Path):
    """Every key of the covariance, left out or replaced, is told and ends in no error of Python's."""
    document = json.loads(fit.to_json())
    file = tmp_path / "x.json"
    for key in ("verdict", "reasons", "parameters", "derived"):
        for wrong in ({**document, key: 3}, {name: value for name, value in document.items() if name != key}):
            file.write_text(json.dumps(wrong))
            with pytest.raises(InputError, match="one that lacks parts"):
                ev.load_fit(file)
    document["covariance"]["candidates"][0]["parts"][0]["matrix"] = [[1.0]]
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match="one that lacks parts"):
        ev.load_fit(file)


@pytest.mark.thorough
def test_choices_are_named_one_by_one(fit: FlightEstimate):
    log = ev.example_flight()
    named = ev.identify_flight(log, window=(5.0, 50.0), max_tilt_deg=20.0)
    given = ev.identify_flight(log, ev.FlightOptions(window=(5.0, 50.0), max_tilt_deg=20.0))
    assert named.parameters == given.parameters
    assert named.parameters != fit.parameters
    with pytest.raises(UsageError, match="each choice once; received method in options= and by name"):
        ev.identify_flight(log, ev.FlightOptions(method="least_squares"), method="reference_iv")
    with pytest.raises(UsageError, match="Did you mean 'window'"):
        ev.identify_flight(log, windw=(1.0, 2.0))  # type: ignore[call-arg]
    with pytest.raises(UsageError, match="Give either window= or windows="):
        ev.identify_flight(log, window=(1.0, 2.0), windows=[None])
