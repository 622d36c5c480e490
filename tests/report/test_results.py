"""Results in Python: at the prompt, in a notebook, in a frame, in a file, and for another flight."""

from __future__ import annotations

import json
import pickle
import runpy
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from importlib import resources
from pathlib import Path
from xml.etree import ElementTree

import msgspec
import numpy as np
import polars as pl
import pytest
from PIL import Image

import eivor as ev
from coarse_search import coarse
from eivor.errors import EivorError, InputError, MissingReaderError, UsageError
from eivor.report.other_results import residual_files


def travelled(result):
    """The same after a journey to another process."""
    return pickle.loads(pickle.dumps(result))  # noqa: S301 - what was written a moment ago


def test_a_table_for_a_notebook_escapes_what_a_log_says(fit):
    hostile = "<script>alert(1)</script>"
    log = fit.prepared[0].recording
    channels = {name: replace(channel, source=hostile) for name, channel in log.channels.items()}
    repr_html_ = replace(log, name=hostile, channels=channels)._repr_html_()
    assert "<script>" not in repr_html_
    assert "&lt;script&gt;" in repr_html_
    table = fit.estimate._repr_html_()
    assert table.count("<tr>") == table.count("</tr>") > 2
    assert "viscous_friction" in table
    card = fit._repr_html_()
    assert 'data-quantity="viscous_friction"' in card
    assert type(card) is str
    assert "<button" not in card.replace("button { display: none; }", "")
    assert hostile not in replace(fit, prepared=(replace(fit.prepared[0], recording=log),))._repr_html_()
    assert fit.plot()._repr_png_().startswith(b"\x89PNG")


@pytest.mark.usefixtures("coarse_search")
def test_residuals_are_a_table_a_log_and_two_layouts(recording, command_line, tmp_path):
    """Layouts draw what the files hold."""
    fit = ev.identify_flight(recording, window=(5.0, 20.0))
    command_line("identify", "--example", "--window", "5:20", "--residuals", tmp_path)
    files = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    table = pl.read_csv(files["residuals.csv"])
    left = table["vertical_acceleration/measured"] - table["vertical_acceleration/predicted"]
    assert left.to_numpy() == pytest.approx(table["vertical_acceleration/residual"].to_numpy(), abs=1e-12)
    assert table.height == fit.prepared[0].used.sum()
    layout = ElementTree.fromstring(files["plotjuggler.xml"])  # noqa: S314 - Eivor's own
    for key in ("name", "field"):  # of PlotJuggler 3, and of 4, whose topic is the file
        assert {item.get(key) for item in layout.iter("curve")} == set(table.columns) - {"time"}
    assert [item.get("time_axis") for item in layout.iterfind("Plugins/plugin/*")] == ["time", "time"]
    assert json.loads(layout.findtext(".//fileInfo/plugin"))["time_column_index"] == 0
    foxglove = json.loads(files["foxglove.json"])
    panels = foxglove["configById"]
    (tab,) = panels[foxglove["layout"]]["tabs"]
    paths = [path["value"] for place in ("first", "second") for path in panels[tab["layout"][place]]["paths"]]
    assert paths == [f"/{name.replace('/', '.')}" for name in table.columns[1:]]
    assert foxglove["playbackConfig"]["speed"] == 1
    log, kinds, place = files["residuals.mcap"], list[int](), 8
    while place < len(log) - 8:
        kinds.append(log[place])
        place += 9 + int.from_bytes(log[place + 1 : place + 9], "little")
    assert log[:8] == log[-8:] == b"\x89MCAP0\r\n"
    assert kinds == [1, 3, 4, *[5] * table.height, 15, 2]


def test_residuals_of_a_pool_have_a_topic_for_each_flight(pool, monkeypatch):
    """Also where logs have one name; PlotJuggler takes a column that begins with 1e-9 for words."""
    tiny = lambda _, run: np.full((run.time_s.size, 2), 1e-9)  # noqa: E731
    monkeypatch.setattr("eivor.report.other_results.within_band", tiny)
    flights = [replace(item, recording=replace(item.recording, name="x.ulg")) for item in pool.prepared]
    header, first = residual_files(replace(pool, prepared=tuple(flights)))["residuals.csv"].splitlines()[:2]
    assert (header.count("measured"), first.count("0.000000001")) == (2, 2)


def test_no_line_crosses_what_was_not_logged(fit):
    """Rows that a table lacks are rows of no series, that of the setpoint among them."""
    flight = fit.prepared[0]
    log = flight.recording

    def cut(channel):
        kept = (channel.time_s < 5.0) | (channel.time_s > 9.0)
        if channel.name.startswith("reference"):  # not in force
            return replace(channel, values=np.where(kept, channel.values, np.nan))
        return replace(channel, time_s=channel.time_s[kept], values=channel.values[kept])

    channels = {name: cut(channel) for name, channel in log.channels.items()}
    flight = replace(flight, recording=replace(log, channels=channels))
    inside = (flight.grid.time_s > 5.01) & (flight.grid.time_s < 8.99)
    height, climb = fit.motion.view(flight).panels
    for values in (height.values, height.reference, climb.values, climb.reference, flight.logged_input):
        assert np.isnan(values[inside]).all()
        assert np.isfinite(values[flight.grid.time_s < 5.0]).all()


def test_without_matplotlib_a_page_has_its_tables(fit, command_line, monkeypatch, tmp_path):
    for name in ("matplotlib", "matplotlib.figure", "matplotlib.backends.backend_agg"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingReaderError, match=r"Install it: pip install 'eivor\[plot\]'"):
        fit.plot()
    with coarse():
        command_line("identify", "--example", "--window", "5:20", "--html", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "The drawing needs Matplotlib" in page
    assert page.count('class="chart"') > 1
    assert '<img class="drawn"' not in page


def test_frames_hold_every_quantity(fit, still):
    frame = fit.to_frame()
    assert frame["quantity"].to_list() == list(fit.quantities)
    friction = frame.row(0, named=True)
    assert friction["value"] == fit.quantities["viscous_friction"].value
    assert (friction["low"], friction["high"]) == fit.interval("viscous_friction")
    empty = still.to_frame()
    assert empty["low"].null_count() == empty.height
    assert set(empty["verdict"]) == {"refused"}


def test_results_travel_to_other_processes(fit):
    for result in (fit, fit.estimate, ev.diagnose(fit.estimate), fit.prepared[0].recording):  # type: ignore[arg-type]
        assert repr(travelled(result)) == repr(result)
    assert "\n" not in repr(fit)
    assert "identified" in repr(fit)
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


def test_a_fit_is_read_back(fit, tmp_path):
    file = tmp_path / "fit.json"
    file.write_text(fit.to_json())
    saved = ev.load_fit(file)
    assert saved.verdict is fit.verdict.status
    assert saved.parameters == fit.parameters
    np.testing.assert_array_equal(saved.covariance, fit.covariance)
    assert saved.names == fit.names
    for name in saved.names:
        # the result cuts lags at zero, which no sensible one of this flight reaches
        assert saved.interval(name) == pytest.approx(fit.interval(name), rel=1e-12)
    assert saved.interval("hover_input") == fit.interval("hover_input")
    assert saved.document.prediction.input_map == fit.prepared[0].input_map
    assert saved.document.prediction.by_run["intercept"] == list(fit.quantities["intercept"].by_run)


def test_a_refusal_is_read_back(still, tmp_path):
    file = tmp_path / "fit.json"
    file.write_text(still.to_json())
    saved = ev.load_fit(file)
    assert saved.verdict is still.verdict.status
    assert (saved.reasons, saved.names) == (still.verdict.sentences, ())


def places(value, place=()):
    """Every place in a document; of a list and of quantities the first."""
    first = isinstance(value, list) or place in {("parameters",), ("derived",)}
    keys = list(value) if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in keys[:1] if first else keys:
        yield (*place, key)
        yield from places(value[key], (*place, key))


USES: tuple[Callable[[ev.SavedFit], object], ...] = (
    lambda fit: fit.fitted,
    lambda fit: fit.sample(3),
    lambda fit: [fit.interval(name, 0.9) for name in fit.names],
    lambda fit: fit._repr_html_(),
)


@pytest.mark.usefixtures("unchecked_shapes")
def test_a_damaged_document_ends_in_a_sentence(fit, recording, tmp_path):
    """Finding 27: a part that is left out or replaced ends in no error of Python's, wherever it is used."""
    text = fit.to_json()
    spared, file = ("diagnostics", "findings", "prediction"), tmp_path / "x.json"
    for place in (place for place in places(json.loads(text)) if place[0] not in spared):
        for wrong in (..., 3, []):
            document = holder = json.loads(text)
            for key in place[:-1]:
                holder = holder[key]
            if wrong is ...:
                del holder[place[-1]]
            else:
                holder[place[-1]] = wrong
            file.write_text(json.dumps(document))
            try:
                saved = ev.load_fit(file)
            except InputError:
                continue
            for use in USES:
                with suppress(EivorError):
                    use(saved)
    document = json.loads(text)
    del document["prediction"]["at"]["delay"], document["prediction"]["beside"]["hover"]["values"]["delay"]
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match="a value for each parameter of its models"):
        ev.validate(file, recording, window=(10.0, 15.0))
    huge = json.loads(text)
    next(iter(huge["parameters"].values()))["std_error"] = 1e200  # which has no square
    file.write_text(json.dumps(huge))
    with pytest.raises(InputError, match=r"a result that can be read|one that lacks parts"):
        ev.load_fit(file)
    file.write_text(json.dumps({**document, "verdict": 3}))
    with pytest.raises(InputError, match="one that lacks parts"):
        ev.load_fit(file)


@pytest.mark.thorough
def test_choices_are_named_one_by_one(fit):
    log = ev.example_flight()
    named = ev.identify_flight(log, window=(5.0, 50.0), max_tilt_deg=20.0)
    given = ev.identify_flight(log, ev.FlightOptions(window=(5.0, 50.0), max_tilt_deg=20.0))
    assert named.parameters == given.parameters
    assert named.parameters != fit.parameters


DOCS = Path(__file__).parents[2] / "docs"

KEYS = {
    *("schema", "log", "fit", "predicts", "sentence", "runs", "samples", "rate_hz", "band", "predictions"),
    *("ahead", "comparisons", "contradicted", "provenance"),
}


@pytest.fixture(scope="module")
def found(fit, recording):
    """The example's first half by its own result, in two runs."""
    gap = {
        name: replace(channel, time_s=channel.time_s[kept], values=channel.values[kept])
        for name, channel in recording.channels.items()
        for kept in [(channel.time_s < 15.0) | (channel.time_s > 17.0)]
    }
    return ev.validate(fit, replace(recording, channels=gap), window=(0.0, 30.0))


def test_the_fit_predicts_better_than_simpler_models(found):
    assert [prediction.model for prediction in found.predictions] == ["fit", "least_squares", "hover"] * 2
    horizons = [prediction.horizon.value for prediction in found.predictions]
    assert horizons == ["one_step"] * 3 + ["open_loop"] * 3
    assert found.predicts
    assert "leaves less than the simpler models" in found.sentence
    for models in found.by_quantity:
        assert models[0].rms < min(model.rms for model in models[1:])
        assert 0.5 < models[0].explained < 1.0


def test_json_holds_what_the_page_says(found):
    document = json.loads(found.to_json())
    assert set(document) == KEYS
    assert document["schema"] == "eivor.validate/1"
    assert document["predicts"] is True
    assert document["contradicted"] == []
    compared = [item["quantity"] for item in document["comparisons"]]
    assert compared == ["viscous_friction", "input_gain", "hover_input", "effective_lag"]
    first = document["predictions"][0]
    assert set(first) == {"model", "horizon", "quantity", "unit", "rms", "explained"}
    assert len(document["runs"]) == 2
    page = (DOCS / "json.md").read_text(encoding="utf-8")
    keys = (*document, *first, *document["fit"], *document["comparisons"][0])
    assert all(f"`{key}`" in page for key in keys)


def test_text_and_tables_tell_the_same(found, fit, tmp_path, command_line):
    (tmp_path / "fit.json").write_text(fit.to_json())
    with resources.as_file(resources.files("eivor.data") / "example_flight.parquet") as example:
        gap = pl.read_parquet(example).filter(~pl.col("time").is_between(15.0, 17.0))
    gap.write_csv(tmp_path / "flight.csv")
    run = command_line("validate", tmp_path / "fit.json", tmp_path / "flight.csv", "--window", "0:30")
    assert run.code == 0
    assert f"{found.predictions[0].rms:.3g}" in run.out
    assert "Validation of" in repr(found)
    figure = found.plot()
    assert [len(axes.lines) for axes in figure.axes[:2]] == [4, 4]
    assert "climb rate" in figure.axes[2].get_ylabel()


def test_a_result_read_back_predicts_the_same(fit, recording, tmp_path):
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


@pytest.mark.parametrize(
    ("name", "factor"), [("viscous_friction", 2.0), ("input_gain", 0.85), ("actuator_lag", 1.6)]
)
def test_a_quantity_that_the_flight_contradicts(fit, recording, tmp_path, name, factor):
    """Numbers that predict better than no model, and are not those of the flight."""
    document = json.loads(fit.to_json())
    document["parameters"][name]["value"] *= factor
    (tmp_path / "fit.json").write_text(json.dumps(document))
    validation = ev.validate(tmp_path / "fit.json", recording, window=(0.0, 30.0))
    words = name.replace("_", " ").replace("actuator", "effective")
    assert f"The flight contradicts the {words}." in validation.sentence
    channels = {name: item for name, item in recording.channels.items() if not name.startswith("reference")}
    without = replace(recording, channels=channels)
    validation = ev.validate(tmp_path / "fit.json", without, window=(0.0, 30.0))
    assert not validation.contradictions  # without an instrument it identifies its hover alone
    assert "not identify it: viscous friction, input gain, effective lag." in validation.sentence
    p_values = [item["p_value"] for item in json.loads(validation.to_json())["comparisons"]]
    assert [p_value is None for p_value in p_values] == [True, True, False, True]


def test_motions_that_do_not_predict_are_told(fit, recording, tmp_path, monkeypatch):
    (tmp_path / "fit.json").write_text(fit.to_json())
    other = ev.load_fit(tmp_path / "fit.json")
    other.document.model = msgspec.structs.replace(other.document.model, name="submarine")
    with pytest.raises(UsageError, match="'submarine'"):
        ev.validate(other, recording)
    monkeypatch.setattr(type(fit.motion), "abilities", type(fit.motion.abilities)())
    with pytest.raises(UsageError, match="a motion that predicts"):
        ev.validate(fit, recording)


ROOT = Path(__file__).resolve().parents[2]
SCRIPT = ROOT / "examples" / "draw_example.py"
PICTURE = ROOT / "docs" / "images" / "example.png"

#: Squares whose mean grey is compared [pixels], and how far it may be off, of 255. Letters that are drawn
#: a pixel further on change it by 20 at most, a legend or a curve at another place by 50 and more.
SQUARE, TOLERANCE = 10, 30.0


def squares(path):
    grey = np.asarray(Image.open(path).convert("L"), dtype=float)
    height, width = (size // SQUARE for size in grey.shape)
    whole = grey[: height * SQUARE, : width * SQUARE]
    return whole.reshape(height, SQUARE, width, SQUARE).mean(axis=(1, 3))


@pytest.mark.thorough
def test_the_picture_is_what_is_drawn(tmp_path):
    runpy.run_path(str(SCRIPT))["main"](tmp_path)
    drawn, displayed = squares(tmp_path / "example.png"), squares(PICTURE)
    assert drawn.shape == displayed.shape
    assert np.abs(drawn - displayed).max() <= TOLERANCE, f"run {SCRIPT.relative_to(ROOT)}"
