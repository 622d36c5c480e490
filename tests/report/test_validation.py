"""A result predicts another flight: errors by number, by run, in text, JSON and figure."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import eivor as ev
from eivor.errors import InputError, UsageError
from eivor.flights.result import FlightEstimate
from eivor.motions.vertical.motion import Vertical
from eivor.report.outputs import saved_fit
from eivor.report.terminal import on_terminal
from eivor.report.validation import Validation, validation_document
from eivor.signals.recording import Recording

DOCS = Path(__file__).parents[2] / "docs"
KEYS = {
    "schema",
    "log",
    "fit",
    "predicts",
    "sentence",
    "runs",
    "samples",
    "rate_hz",
    "band",
    "predictions",
    "ahead",
    "provenance",
}


@pytest.fixture(scope="module")
def found(fit: FlightEstimate, recording: Recording) -> Validation:
    """The example's first half by its own result, in two runs."""
    gap = {
        name: replace(channel, time_s=channel.time_s[kept], values=channel.values[kept])
        for name, channel in recording.channels.items()
        for kept in [(channel.time_s < 15.0) | (channel.time_s > 17.0)]
    }
    return ev.validate(fit, replace(recording, channels=gap), window=(0.0, 30.0))


def test_the_fit_predicts_better_than_simpler_models(found: Validation) -> None:
    assert [prediction.model for prediction in found.predictions] == ["fit", "least_squares", "hover"] * 2
    assert [prediction.horizon.value for prediction in found.predictions] == ["one_step"] * 3 + [
        "open_loop"
    ] * 3
    assert found.predicts
    assert "leaves less than the simpler models" in found.sentence
    for models in found.by_quantity:
        assert models[0].error.rms < min(model.error.rms for model in models[1:])
        assert 0.5 < models[0].error.explained < 1.0


def test_errors_of_runs_make_those_of_the_flight(found: Validation) -> None:
    assert len(found.spans_s) == 2
    lengths = np.array([run.stop - run.start for run in found.flight.runs])
    for prediction in found.predictions:
        squares = np.array([run.rms**2 for run in prediction.by_run])
        assert prediction.error.rms == pytest.approx(np.sqrt(squares @ lengths / lengths.sum()))


def test_json_holds_what_the_page_says(found: Validation) -> None:
    document = json.loads(found.to_json())
    assert set(document) == KEYS
    assert document["schema"] == "eivor.validate/1"
    assert document["predicts"] is True
    first = document["predictions"][0]
    assert set(first) == {"model", "horizon", "quantity", "unit", "rms", "explained", "by_run"}
    assert len(first["by_run"]) == len(document["runs"]) == 2
    page = (DOCS / "json.md").read_text(encoding="utf-8")
    assert all(f"`{key}`" in page for key in (*document, *first, *document["fit"]))


def test_text_and_tables_tell_the_same(found: Validation) -> None:
    rms = f"{found.predictions[0].error.rms:.3g}"
    assert rms in found.summary()
    assert rms in found._repr_html_()
    assert "Validation of" in repr(found)
    sections = validation_document(found).sections
    assert [section.heading for section in sections] == ["", "Of the fit, run by run", "Figure"]
    assert on_terminal(validation_document(found)).renderables


def test_the_figure_has_two_panels_for_each_quantity(found: Validation) -> None:
    figure = found.plot()
    assert len(figure.axes) == 4
    assert len(figure.axes[0].lines) == 4
    assert len(figure.axes[1].lines) == 4
    assert "climb rate" in figure.axes[2].get_ylabel()


def test_a_result_read_back_predicts_the_same(
    fit: FlightEstimate, recording: Recording, tmp_path: Path
) -> None:
    path = tmp_path / "fit.json"
    path.write_text(fit.to_json())
    window = (10.0, 25.0)
    first = ev.validate(path, recording, window=window)
    second = ev.validate(fit, recording, window=window)
    assert first.to_json() == second.to_json()
    older = json.loads(fit.to_json())
    del older["prediction"]["beside"]  # as it was written before validation
    path.write_text(json.dumps(older))
    alone = ev.validate(path, recording, window=window, max_tilt_deg=20.0)
    assert [prediction.model for prediction in alone.predictions] == ["fit", "fit"]
    assert alone.predicts


def test_a_wrong_fit_does_not_predict(fit: FlightEstimate, recording: Recording) -> None:
    saved = saved_fit(fit)
    (best,) = [candidate for candidate in saved.candidates if candidate.best]
    wrong = replace(saved, candidates=(replace(best, values=best.values * [-5.0, 0.5, 1.0]),))
    validate = ev.validate(wrong, recording, window=(0.0, 30.0))
    assert not validate.predicts
    assert "leave less" in validate.sentence


def test_what_cannot_be_validated_is_told(
    fit: FlightEstimate, still: FlightEstimate, recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UsageError, match="a result with an estimate"):
        ev.validate(still, recording)
    with pytest.raises(InputError, match="three seconds in the air"):
        ev.validate(fit, recording, window=(10.0, 11.0))
    other = saved_fit(fit)
    other.document["model"]["name"] = "submarine"
    with pytest.raises(UsageError, match="'submarine'"):
        ev.validate(other, recording)
    monkeypatch.setattr(Vertical, "predictions", lambda *_: ())
    with pytest.raises(UsageError, match="a motion that predicts"):
        ev.validate(fit, recording)
