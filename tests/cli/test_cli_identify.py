"""`eivor identify`: every option, the exit codes, the outputs."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import numpy as np
import polars
import pytest

import eivor as ev
from eivor.errors import UsageError

pytestmark = pytest.mark.usefixtures("unchecked_shapes", "coarse_search")


def test_the_table_has_every_quantity_in_80_columns(eivor, log, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    run = eivor("identify", log, "--compare")
    for word in ("viscous friction", "input gain", "hover input", "effective lag", "delay", "intercept"):
        assert word in run.out
    assert max(len(line) for line in run.out.splitlines()) <= 80
    assert "…" not in run.out
    assert "\x1b" not in run.out
    assert all(method in run.out for method in ("reference_iv", "total_least_squares", "extended_iv"))


@pytest.mark.thorough
def test_json_on_standard_output_is_nothing_but_json_and_the_example_s_intervals_hold_the_truth(shell):
    run = shell("identify", "--example", "--json", "-")
    document = json.loads(run.out)
    assert run.code == 0
    assert document["schema"] == "eivor.identify/2"
    assert run.err == ""
    vertical = document["motions"]["vertical"]
    low, high = vertical["parameters"]["viscous_friction"]["interval"]
    assert low < 0.180 < high
    low, high = vertical["derived"]["effective_lag"]["interval"]
    assert low < 0.072 < high


@pytest.mark.thorough
def test_the_window_is_used(eivor, log, flight, tmp_path):
    early = tmp_path / "early.csv"
    flight.with_columns(polars.col("time") - 10.0).write_csv(early)
    for arguments, window in (
        (("--window", "5:20", log), (5.0, 20.0)),
        ((f"{log}@5:20",), (5.0, 20.0)),
        (("--window", "0:9", f"{log}@5:20"), (5.0, 20.0)),
        (("--window", "-8:15", early), (-8.0, 15.0)),
    ):
        document = json.loads(eivor("identify", *arguments, "--json", "-").out)["motions"]["vertical"]
        assert document["window"] == pytest.approx(window, abs=0.02)


def test_tilt_method_map_and_input_are_passed_on(eivor, log):
    run = eivor(
        *("identify", log, "--max-tilt", "15", "--method", "least_squares", "--input-map", "power:1.9"),
        *("--input", "rotor_command", "--json", "-"),
    )
    document = json.loads(run.out)
    assert run.code == 0  # hover alone
    vertical = document["motions"]["vertical"]
    assert (vertical["method"], vertical["model"]["input_map"]) == ("least_squares", "power:1.9")
    assert document["provenance"]["options"]["max_tilt_deg"] == 15.0
    assert vertical["verdict"] == "provisional"


@pytest.mark.thorough
def test_instruments_can_be_chosen(eivor, log):
    by_name, by_family, by_lags = (
        json.loads(eivor("identify", log, "--instruments", word, "--json", "-").out)["motions"]["vertical"]
        for word in ("reference_position_z", "rotor_command", "lags")
    )
    assert by_name["instruments"] == "reference_position_z"
    assert by_family["instruments"].startswith("rotor_command_1")
    assert "lagged" in by_lags["instruments"]
    assert by_lags["verdict"] != "identified"


@pytest.mark.thorough
def test_a_pool_has_a_row_for_each_flight(eivor, flight, tmp_path):
    """Logs of one name are named by their paths, parts of one by their windows, a copy is used once."""
    paths = [tmp_path / str(number) / "log.csv" for number in range(2)]
    for number, path in enumerate(paths):
        path.parent.mkdir()
        flight.slice(1500 * number, 1500).write_csv(path)
    run = eivor("identify", *paths, "--json", tmp_path / "pool.json", "--figure", tmp_path / "pool.png")
    document = json.loads((tmp_path / "pool.json").read_text())["motions"]["vertical"]
    assert "Flights one by one" in run.out
    assert [row["log"] for row in document["flights"]] == [str(path) for path in paths]
    assert document["window"] is None
    assert len(document["parameters"]["intercept"]["by_segment"]) == 2
    parts = json.loads(eivor("identify", f"{paths[0]}@0:7", f"{paths[0]}@7:14", "--json", "-").out)
    assert [row["log"] for row in parts["motions"]["vertical"]["flights"]] == ["log.csv@0:7", "log.csv@7:14"]
    shutil.copy(paths[0], tmp_path / "copy.csv")
    run = eivor("identify", paths[0], tmp_path / "copy.csv")
    assert "same content" in run.out
    assert "Flights one by one" not in run.out


@pytest.mark.parametrize(
    "grounded", [pytest.param(True, marks=pytest.mark.thorough), False], ids=["grounded", "constant"]
)
def test_a_flight_that_tells_nothing_is_refused_not_failed(eivor, flight, tmp_path, *, grounded):
    level = np.where(flight["time"] < 2.0, 0.0, 1800.0) if grounded else np.full(flight.height, 1800.0)
    table = flight.with_columns(*[polars.Series(f"rotor_command_{n}", level) for n in range(1, 5)])
    if grounded:
        table = table.with_columns(polars.lit(0.0).alias("position_z"))
    path = tmp_path / "still.csv"
    table.write_csv(path)
    run = eivor("identify", path, "--json", tmp_path / "x.json", "--figure", tmp_path / "x.png", "--compare")
    document = json.loads((tmp_path / "x.json").read_text())
    assert run.code == 3
    assert "Not identified" in run.out
    assert ("never takes off" if grounded else "constant") in run.out
    assert "Flight card" not in run.out
    assert "with --card" in run.out
    assert "Flight card" in eivor("identify", path, "--card").out
    assert "Flight card" in eivor("inspect", path).out
    assert document["motions"]["vertical"]["parameters"]["viscous_friction"]["interval"] == [None, None]
    assert (tmp_path / "x.png").stat().st_size > 10_000


@pytest.mark.thorough
def test_a_full_disk_is_told(eivor, log):
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    run = eivor("identify", log, "--json", "/dev/full")
    assert run.code == 1
    assert "No space left" in run.err


@pytest.mark.thorough
def test_a_lag_is_taken_from_another_flight(eivor, log, tmp_path):
    other = tmp_path / "other.json"
    assert eivor("identify", log, "--json", other).code == 0
    document = json.loads(other.read_text())
    reported = document["motions"]["vertical"]["derived"]["effective_lag"]
    run = eivor("identify", log, "--lag-from", other, "--json", "-")
    given = json.loads(run.out)["motions"]["vertical"]["given_lag"]
    assert given["mean"] == reported["value"]
    low, high = reported["interval"]
    assert given["std"] == pytest.approx(max((high - low) / 4.0, reported["std_error"]))
    reported["verdict"] = "refused"
    other.write_text(json.dumps(document))
    run = eivor("identify", log, "--lag-from", other)
    assert run.code == 2
    assert "one whose lag is refused" in run.err


@pytest.mark.thorough
def test_track_prints_draws_and_writes(eivor, tmp_path):
    figure, out = tmp_path / "gain.png", tmp_path / "gain.json"
    run = eivor("track", "--example", "--figure", figure, "--json", out)
    assert run.code == 0
    assert "input gain K_u over the log" in run.out
    assert figure.stat().st_size > 10_000
    document = json.loads(out.read_text())
    assert (document["parameter"], document["changes"]) == ("input_gain", [])


@pytest.mark.thorough
def test_a_short_track_says_what_is_missing(eivor):
    run = eivor("track", "--example", "--memory", "900")
    assert (run.code, "the length of the flight" in run.err) == (2, True)
    run = eivor("track", "--example", "--window", "10:12")
    assert (run.code, "no moment identifies it" in run.out) == (3, True)


@pytest.mark.parametrize(
    ("needs", "code"),
    [
        ("", 0),
        ("hover,lag,gain,friction", 0),
        ("hover_input,vertical.effective_lag", 0),
        ("hover,torque", 3),
        ("roll_effectiveness", 3),
    ],
)
def test_what_is_needed_decides_the_exit_code(eivor, needs, code):
    run = eivor("identify", "--example", *(("--for", needs) if needs else ()))
    assert run.code == code
    assert run.out


@pytest.mark.thorough
def test_results_of_both_schemas_serve_every_command(eivor, log, tmp_path):
    """A motion is chosen where one serves; where several do, it is to be named."""
    result = ev.identify_log(ev.read_log(log))
    assert list(result.motions) == ["vertical"]
    assert "torque_setpoint" in result.left_out["rates"]
    both = ev.LogEstimate({**result.motions, "rates": result.first})
    files = {"1": result.first.to_json(), "2": result.to_json(), "several": both.to_json()}
    answers = {}
    for name, text in files.items():
        file = tmp_path / f"{name}.json"
        file.write_text(text)
        model = ("--model", "vertical") if name == "several" else ()
        answers[name] = [
            eivor("export", file, "--to", "px4"),
            eivor("export", file, "--draws", "3", "-o", tmp_path / "draws.parquet", *model),
            eivor("validate", file, log, *model),
            eivor("plan", file, "--time", "20"),
            eivor("identify", log, "--lag-from", file, "--json", "-"),
            eivor("track", log, "--lag-from", file),
        ]
        assert ev.load_fit(file, "vertical").parameters["hover_input"] == pytest.approx(
            result.first.parameters["hover_input"]
        )
    assert [answers["1"][place].code for place in (1, 4, 5)] == [0, 0, 0]
    printed = [[(run.code, run.out.replace(str(tmp_path), "")) for run in runs] for runs in answers.values()]
    assert printed[0][:4] == printed[1][:4] == printed[2][:4]
    assert printed[0][5] == printed[1][5] == printed[2][5]
    several = tmp_path / "several.json"
    first = eivor("validate", several, log)
    assert first.code == answers["1"][2].code
    assert "first motion of several.json; others: --model rates" in first.err
    with pytest.raises(UsageError, match=r"Did you mean 'rates'\?"):
        ev.load_fit(several, "rate")


@pytest.mark.thorough
def test_another_flight_is_predicted(eivor, log, tmp_path):
    fit, figure = tmp_path / "fit.json", tmp_path / "fit.svg"
    assert eivor("identify", f"{log}@0:25", "--json", fit).code == 0
    run = eivor("validate", fit, f"{log}@15:30", "--figure", figure)
    assert run.code == 0
    assert "leaves less than the simpler models" in " ".join(run.out.split())
    assert figure.stat().st_size > 1000
    reported = eivor("validate", fit, log, "--window", "15:30", "--json", "-")
    assert json.loads(reported.out)["schema"] == "eivor.validate/1"

    document = json.loads(fit.read_text())
    vertical = document["motions"]["vertical"]
    vertical["covariance"]["values"] = [9.0, 1.0, 0.2, 0.0]
    fit.write_text(json.dumps(document))
    wrong = eivor("validate", fit, log)
    assert (wrong.code, "leave less" in " ".join(wrong.out.split())) == (3, True)
    vertical["prediction"] = None
    fit.write_text(json.dumps(document))
    refused = eivor("validate", fit, log)
    assert refused.code == 2
    assert "a result with an estimate" in refused.err
    assert eivor("validate", fit, log, "--json", fit).code == 2


def embedded(page):
    text = page.read_text(encoding="utf-8")
    return json.loads(re.search(r'<script type="application/json" id="result">(.*?)</script>', text)[1])


@pytest.mark.thorough
def test_a_report_is_what_identify_finds(eivor, log, tmp_path):
    page, path = tmp_path / "flight.html", tmp_path / "flight.json"
    reported = eivor("report", log, "-o", page)
    other = eivor("identify", log, "--json", path, "--html", tmp_path / "other.html")
    assert reported.code == other.code == 0
    assert "Identified" in reported.out
    assert str(page) in re.sub(r"\s", "", reported.out)
    assert embedded(page) == json.loads(path.read_text()) == embedded(tmp_path / "other.html")
    assert page.read_bytes() == (tmp_path / "other.html").read_bytes()


def test_a_report_on_standard_output_is_nothing_else(eivor, log):
    reported = eivor("report", log, "--window", "0:4", "--for", "friction", "-o", "-")
    assert reported.code == 3
    assert reported.out.startswith("<!DOCTYPE html>")
    assert reported.out.endswith("</html>\n")
