"""`eivor identify`: every option, the exit codes, the outputs."""

from __future__ import annotations

import inspect
import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars
import pytest

from eivor.cli.identify import identify, report

# -- `eivor identify`: every option, the exit codes, the outputs --

Caller = Callable[..., Any]


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_the_example_is_identified(eivor: Caller) -> None:
    run = eivor("identify", "--example")
    assert run.code == 0
    assert run.err == ""
    assert "IDENTIFIED" in run.out
    assert "viscous friction" in run.out
    assert "Flight card" not in run.out


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.usefixtures("coarse_search")
def test_the_table_has_every_quantity_in_80_columns(
    eivor: Caller, log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    run = eivor("identify", log, "--compare")
    for word in ("viscous friction", "input gain", "hover input", "effective lag", "delay", "intercept"):
        assert word in run.out
    assert max(len(line) for line in run.out.splitlines()) <= 80
    assert "…" not in run.out
    assert "\x1b" not in run.out
    assert all(method in run.out for method in ("reference_iv", "total_least_squares", "extended_iv"))


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_json_on_standard_output_is_nothing_but_json_and_the_example_s_intervals_hold_the_truth(
    shell: Caller,
) -> None:
    run = shell("identify", "--example", "--json", "-")
    document = json.loads(run.out)
    assert run.code == 0
    assert document["schema"] == "eivor.identify/1"
    assert run.err == ""
    low, high = document["parameters"]["viscous_friction"]["interval"]
    assert low < 0.180 < high
    low, high = document["derived"]["effective_lag"]["interval"]
    assert low < 0.072 < high


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_json_and_figure_go_to_files(eivor: Caller, log: Path, tmp_path: Path) -> None:
    for ending, magic in ((".png", b"\x89PNG"), (".svg", b"<?xml"), (".pdf", b"%PDF")):
        figure = tmp_path / f"fit{ending}"
        run = eivor("identify", log, "--json", tmp_path / "fit.json", "--figure", figure)
        assert "viscous friction" in run.out
        assert figure.read_bytes().startswith(magic)
    assert json.loads((tmp_path / "fit.json").read_text())["logs"][0]["name"] == "flight.csv"


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_the_window_is_used(eivor: Caller, log: Path) -> None:
    for arguments in (("--window", "5:20", log), (f"{log}@5:20",), ("--window", "0:9", f"{log}@5:20")):
        document = json.loads(eivor("identify", *arguments, "--json", "-").out)
        assert document["window"] == pytest.approx([5.0, 20.0], abs=0.02)


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_a_window_may_begin_before_zero(eivor: Caller, flight: polars.DataFrame, tmp_path: Path) -> None:
    path = tmp_path / "early.csv"
    flight.with_columns(polars.col("time") - 10.0).write_csv(path)
    document = json.loads(eivor("identify", path, "--window", "-8:15", "--json", "-").out)
    assert document["window"] == pytest.approx([-8.0, 15.0], abs=0.02)


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_tilt_method_map_and_input_are_passed_on(eivor: Caller, log: Path) -> None:
    run = eivor(
        *("identify", log, "--max-tilt", "15", "--method", "least_squares", "--input-map", "power:1.9"),
        *("--input", "rotor_command", "--json", "-"),
    )
    document = json.loads(run.out)
    assert run.code == 3
    assert document["method"] == "least_squares"
    assert document["model"]["input_map"] == "power:1.9"
    assert document["provenance"]["options"]["max_tilt_deg"] == 15.0
    assert document["verdict"] == "provisional"


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_instruments_can_be_chosen(eivor: Caller, log: Path) -> None:
    document = json.loads(eivor("identify", log, "--instruments", "reference_position_z", "--json", "-").out)
    assert document["instruments"] == "reference_position_z"
    document = json.loads(eivor("identify", log, "--instruments", "lags", "--json", "-").out)
    assert "lagged" in document["instruments"]
    assert document["verdict"] != "identified"


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_a_pool_has_a_row_for_each_flight(eivor: Caller, flight: polars.DataFrame, tmp_path: Path) -> None:
    paths = []
    for number, part in enumerate((flight.slice(0, 1500), flight.slice(1500, 1500))):
        paths.append(tmp_path / f"part{number}.csv")
        part.write_csv(paths[-1])
    run = eivor("identify", *paths, "--json", tmp_path / "pool.json", "--figure", tmp_path / "pool.png")
    document = json.loads((tmp_path / "pool.json").read_text())
    assert "Flights one by one" in run.out
    assert [row["log"] for row in document["flights"]] == ["part0.csv", "part1.csv"]
    assert document["window"] is None
    assert len(document["parameters"]["intercept"]["by_segment"]) == 2


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_the_same_file_twice_is_used_once(eivor: Caller, log: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.csv"
    shutil.copy(log, copy)
    run = eivor("identify", log, copy)
    assert "same content" in run.out
    assert "Flights one by one" not in run.out


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_logs_of_one_name_are_told_by_their_paths(
    eivor: Caller, flight: polars.DataFrame, tmp_path: Path
) -> None:
    paths = []
    for number, part in enumerate((flight.slice(0, 1500), flight.slice(1500, 1500))):
        (tmp_path / str(number)).mkdir()
        paths.append(tmp_path / str(number) / "log.csv")
        part.write_csv(paths[-1])
    document = json.loads(eivor("identify", *paths, "--json", "-").out)
    assert [log["name"] for log in document["logs"]] == [str(path) for path in paths]


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_parts_of_one_log_are_told_by_their_windows(eivor: Caller, log: Path) -> None:
    document = json.loads(eivor("identify", f"{log}@0:14", f"{log}@15:29", "--json", "-").out)
    assert [row["log"] for row in document["flights"]] == ["flight.csv@0:14", "flight.csv@15:29"]


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_channel_map_is_used(eivor: Caller, flight: polars.DataFrame, tmp_path: Path) -> None:
    table, mapping = tmp_path / "mine.csv", tmp_path / "mine.toml"
    flight.rename({"velocity_z": "vz", "time": "t"}).write_csv(table)
    names = [name for name in flight.columns if name not in {"time", "velocity_z"}]
    channels = "\n".join(f'[channels.{name}]\ncolumn = "{name}"' for name in names)
    mapping.write_text(
        f'name = "mine"\n[time]\ncolumn = "t"\nunit = "s"\n[channels.velocity_z]\ncolumn = "vz"\n{channels}\n'
    )
    assert eivor("identify", table, "--map", mapping).code in {0, 3}
    mapping.write_text("name = [")
    run = eivor("identify", table, "--map", mapping)
    assert run.code == 1
    assert "mine.toml" in run.err


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_measured_rotor_speeds_have_no_lag(eivor: Caller, flight: polars.DataFrame, tmp_path: Path) -> None:
    path = tmp_path / "measured.csv"
    rotors = {f"rotor_command_{n}": f"rotor_speed_{n}" for n in range(1, 5)}
    flight.rename(rotors).write_csv(path)
    run = eivor("identify", path, "--json", tmp_path / "x.json", "--figure", tmp_path / "x.png")
    document = json.loads((tmp_path / "x.json").read_text())
    assert run.code in {0, 3}
    assert document["model"]["input_measured"] is True
    assert document["parameters"]["actuator_lag"]["value"] == 0.0
    # they are commands in truth, which the rotors follow 72 ms later
    assert document["parameters"]["delay"]["value"] > 0.04
    assert document["covariance"]["names"] == ["viscous_friction", "input_gain", "delay"]


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.usefixtures("coarse_search")
@pytest.mark.parametrize(
    "grounded", [pytest.param(True, marks=pytest.mark.thorough), False], ids=["grounded", "constant"]
)
def test_a_flight_that_tells_nothing_is_refused_not_failed(
    eivor: Caller, flight: polars.DataFrame, tmp_path: Path, *, grounded: bool
) -> None:
    level = np.where(flight["time"] < 2.0, 0.0, 1800.0) if grounded else np.full(flight.height, 1800.0)
    table = flight.with_columns(*[polars.Series(f"rotor_command_{n}", level) for n in range(1, 5)])
    if grounded:
        table = table.with_columns(polars.lit(0.0).alias("position_z"))
    path = tmp_path / "still.csv"
    table.write_csv(path)
    run = eivor("identify", path, "--json", tmp_path / "x.json", "--figure", tmp_path / "x.png", "--compare")
    document = json.loads((tmp_path / "x.json").read_text())
    assert run.code == 3
    assert "REFUSED" in run.out
    assert ("never takes off" if grounded else "constant") in run.out
    assert "Flight card" not in run.out
    assert "with --card" in run.out
    assert "Flight card" in eivor("identify", path, "--card").out
    assert "Flight card" in eivor("inspect", path).out
    assert document["parameters"]["viscous_friction"]["interval"] == [None, None]
    assert (tmp_path / "x.png").stat().st_size > 10_000


# -- wrong usage: 2 ----------------------------------------------------------------------------------


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "one or more logs"),
        (("--example", "LOG"), "received both"),
        (("LOG", "--window", "9:2"), "START before END"),
        (("LOG", "--window", "900:950"), "spans 0.00 to"),
        (("LOG@900:950",), "spans 0.00 to"),
        (("LOG", "--max-tilt", "0"), "between 0 and 90"),
        (("LOG", "--max-tilt", "nan"), "between 0 and 90"),
        (("LOG", "--max-tilt", "x"), "--max-tilt"),
        (("LOG", "--method", "magic"), "a method out of"),
        (("LOG", "--input-map", "cube"), "an input map"),
        (("LOG", "--input", "nothing"), "an input out of"),
        (("LOG", "--instruments", "nothing"), "'nothing'"),
        (("LOG", "--instruments", "lags,references"), "alone"),
        (("--example", "--map", "nofile.toml"), "--example with --map nofile.toml"),
        (("LOG", "--method", "least_squares", "--instruments", "lags"), "least_squares uses none"),
        (("--example", "--method", "total_least_squares", "--instruments", "references"), "uses none"),
        (("LOG", "--figure", "x.gif"), ".png"),
        (("LOG", "--json", "LOG"), "would replace"),
        (("LOG", "--nonsense"), "No such option"),
    ],
)
def test_wrong_usage(eivor: Caller, log: Path, arguments: tuple[str, ...], message: str) -> None:
    run = eivor("identify", *(argument.replace("LOG", str(log)) for argument in arguments))
    assert run.code == 2
    assert message in run.err
    assert run.out == ""
    assert "Traceback" not in run.err


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_map_for_a_ulog_is_wrong_usage(eivor: Caller, tmp_path: Path) -> None:
    path = tmp_path / "x.ulg"
    path.write_bytes(b"ULog\x01\x12\x35\x01" + bytes(8))
    run = eivor("identify", path, "--map", "nanobench")
    assert run.code == 2
    assert "channel map" in run.err


# -- unreadable input, unwritable output: 1 ----------------------------------------------------------


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"ULog\x01\x12\x35\x01", "x.log"),
        (b"\xa3\x95\x80\x80" * 100, "x.log"),
        (bytes(range(256)) * 8, "x.log"),
        (b"time,velocity_z\n0,x\n", "x.log"),
    ],
    ids=["empty", "cut ULog", "DataFlash", "noise", "no numbers"],
)
def test_an_unreadable_log(eivor: Caller, tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "x.log"
    path.write_bytes(content)
    run = eivor("identify", path)
    assert run.code == 1
    assert message in run.err
    assert run.out == ""
    assert "Traceback" not in run.err


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_no_such_log_and_a_folder(eivor: Caller, tmp_path: Path) -> None:
    assert eivor("identify", tmp_path / "none.ulg").code == 1
    assert eivor("identify", tmp_path).code == 1


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_one_bad_log_of_several_is_named(eivor: Caller, log: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.ulg"
    bad.write_bytes(b"ULog\x01\x12\x35")
    run = eivor("identify", log, bad)
    assert run.code == 1
    assert "bad.ulg" in run.err


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_one_bad_window_of_several_is_named(eivor: Caller, log: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.csv"
    shutil.copy(log, other)
    run = eivor("identify", log, f"{other}@500:600")
    assert run.code == 2
    assert "other.csv" in run.err


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_missing_channel_says_what_was_looked_for(
    eivor: Caller, flight: polars.DataFrame, tmp_path: Path
) -> None:
    path = tmp_path / "blind.csv"
    flight.drop("velocity_z").write_csv(path)
    run = eivor("identify", path)
    assert run.code == 1
    assert "velocity_z" in run.err
    assert "looked for" in run.err


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_an_output_that_cannot_be_written(eivor: Caller, log: Path, tmp_path: Path) -> None:
    for option in ("--json", "--figure"):
        run = eivor("identify", log, option, tmp_path / "none" / "x.png")
        assert run.code == 1
        assert "does not exist" in run.err
        assert run.out == ""


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_a_full_disk_is_told(eivor: Caller, log: Path) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full here")
    run = eivor("identify", log, "--json", "/dev/full")
    assert run.code == 1
    assert "No space left" in run.err


# -- What is known of the lag, on the command line --


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_a_lag_is_given_in_milliseconds(eivor: Caller, log: Path, tmp_path: Path) -> None:
    run = eivor("identify", log, "--lag", "70:15", "--json", tmp_path / "fit.json")
    document = json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))
    assert document["provenance"]["options"]["lag"] == {"mean": 0.07, "std": 0.015}
    assert document["given_lag"]["mean"] == 0.07
    assert "given 70 ± 15 ms" in run.out


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_bounds_of_a_lag_and_no_lag_are_given(eivor: Caller, log: Path) -> None:
    document = json.loads(eivor("identify", log, "--lag", "50..90", "--json", "-").out)
    assert document["provenance"]["options"]["lag"] == {"low": 0.05, "high": 0.09}
    given = document["given_lag"]
    assert [given[name] for name in ("mean", "std", "low", "high")] == [None, None, 0.05, 0.09]
    assert document["derived"]["effective_lag"]["interval"] == [0.05, 0.09]
    run = eivor("identify", log, "--lag", "none")
    assert "given neither lag nor delay; the flight alone says" in run.out.replace("\n", " ")
    assert "they contradict each other" in " ".join(run.out.split())


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_a_lag_is_taken_from_another_flight(eivor: Caller, log: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    assert eivor("identify", log, "--json", other).code == 0
    reported = json.loads(other.read_text())["derived"]["effective_lag"]
    given = json.loads(eivor("identify", log, "--lag-from", other, "--json", "-").out)["given_lag"]
    assert given["mean"] == reported["value"]
    low, high = reported["interval"]
    assert given["std"] == pytest.approx(max((high - low) / 4.0, reported["std_error"]))


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.parametrize(
    "text",
    [
        "70",
        "70:",
        ":15",
        "x:15",
        "70:0",
        "-70:15",
        "nan:15",
        "70:15:3",
        "90..70",
        "-5..10",
        "5..",
        "..5",
        "5..nan",
        "5...7..9",
        "no",
    ],
)
def test_a_lag_that_is_none_is_refused(eivor: Caller, log: Path, text: str) -> None:
    run = eivor("identify", log, f"--lag={text}")
    assert run.code == 2
    assert "a lag MS:STD" in run.err
    assert "Give 70:15 or 50..90" in " ".join(run.err.split())


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_one_of_the_two_is_given(eivor: Caller, log: Path) -> None:
    run = eivor("identify", log, "--lag", "70:15", "--lag-from", "other.json")
    assert run.code == 2
    assert "--lag or --lag-from" in run.err


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_a_result_that_does_not_tell_its_lag_is_refused(eivor: Caller, log: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.json"
    assert eivor("identify", log, "--json", other).code == 0
    document = json.loads(other.read_text())
    document["derived"]["effective_lag"]["verdict"] = "refused"
    other.write_text(json.dumps(document))
    run = eivor("identify", log, "--lag-from", other)
    assert run.code == 2
    assert "one whose lag is refused" in run.err
    missing = eivor("identify", log, "--lag-from", tmp_path / "none.json")
    assert missing.code == 1
    assert "none.json" in missing.err


# -- `eivor track` prints, draws and writes what is followed, and says what is wrong --


@pytest.mark.thorough
def test_track_prints_draws_and_writes(eivor, tmp_path):
    figure, out = tmp_path / "gain.png", tmp_path / "gain.json"
    run = eivor("track", "--example", "--figure", figure, "--json", out)
    assert run.code == 0
    assert "input gain K_u over the flight" in run.out
    assert figure.stat().st_size > 10_000
    document = json.loads(out.read_text())
    assert document["parameter"] == "input_gain"
    assert document["changes"] == []


@pytest.mark.thorough
def test_wrong_usage_is_told(eivor):
    assert eivor("track").code == 2
    run = eivor("track", "--example", "--memory", "900")
    assert (run.code, "the length of the flight" in run.err) == (2, True)
    run = eivor("track", "--example", "--window", "10:12")
    assert (run.code, "no moment identifies it" in run.out) == (3, True)


DAMAGED = """
kind = "flight"
trajectory = "steps"
gust_rms = 0.2
duration = 40.0
gain_after = 0.8
gain_changes_at = 25.0
"""


@pytest.mark.thorough
def test_a_damaged_propeller_is_told(eivor, tmp_path):
    scenario, log, known, gain = (tmp_path / f"damaged{end}" for end in (".toml", ".csv", ".json", "-k.json"))
    scenario.write_text(DAMAGED, encoding="utf-8")
    assert eivor("simulate", scenario, "-o", log, "--truth", known).code == 0
    assert json.loads(known.read_text())["gain_after"] == 0.8
    run = eivor("track", log, "--json", gain)
    assert run.code == 0
    (change,) = json.loads(gain.read_text())["changes"]
    assert not change["upwards"]
    assert 25.0 < change["time_s"] <= 29.0
    assert re.search(r"input gain K_u fell by (19|20|21)\s%", run.out)


# -- `eivor validate` as it is called --


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_search")
def test_another_flight_is_predicted(eivor: Caller, log: Path, tmp_path: Path) -> None:
    fit, figure = tmp_path / "fit.json", tmp_path / "fit.svg"
    assert eivor("identify", f"{log}@0:25", "--json", fit).code == 0
    run = eivor("validate", fit, f"{log}@15:30", "--figure", figure)
    assert run.code == 0
    assert "leaves less than the simpler models" in " ".join(run.out.split())
    assert "RMS error" in run.out
    assert figure.stat().st_size > 1000
    reported = eivor("validate", fit, log, "--window", "15:30", "--json", "-")
    assert json.loads(reported.out)["schema"] == "eivor.validate/1"

    document = json.loads(fit.read_text())
    document["covariance"]["candidates"][0]["values"] = [9.0, 1.0, 0.2]
    fit.write_text(json.dumps(document))
    assert eivor("validate", fit, log).code == 3
    document["prediction"] = None
    fit.write_text(json.dumps(document))
    refused = eivor("validate", fit, log)
    assert refused.code == 2
    assert "a result with an estimate" in refused.err
    assert eivor("validate", fit, log, "--json", fit).code == 2


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_files_that_are_no_results_are_told(eivor: Caller, log: Path, tmp_path: Path) -> None:
    assert eivor("validate", log, log).code == 1
    missing = eivor("validate", tmp_path / "none.json", log)
    assert missing.code == 1
    assert "none.json" in missing.err


# -- `eivor report` and `eivor identify --html`: the page is written, over nothing that is read --


def embedded(page: Path) -> dict:
    text = page.read_text(encoding="utf-8")
    return json.loads(re.search(r'<script type="application/json" id="result">(.*?)</script>', text)[1])


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_report_is_what_identify_finds(eivor, log, tmp_path):
    page, path = tmp_path / "flight.html", tmp_path / "flight.json"
    reported = eivor("report", log, "-o", page)
    other = eivor("identify", log, "--json", path, "--html", tmp_path / "other.html")
    assert reported.code == other.code == 0
    assert "IDENTIFIED" in reported.out
    assert str(page) in re.sub(r"\s", "", reported.out)
    assert embedded(page) == json.loads(path.read_text()) == embedded(tmp_path / "other.html")
    assert page.read_bytes() == (tmp_path / "other.html").read_bytes()


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.thorough
def test_a_refusal_is_a_report_too(eivor, log, tmp_path):
    page = tmp_path / "flight.html"
    assert eivor("report", log, "--window", "0:4", "-o", page).code == 3
    assert embedded(page)["verdict"] != "identified"


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_report_on_standard_output_is_nothing_else(eivor, log):
    reported = eivor("report", log, "--window", "0:4", "-o", "-")
    assert reported.out.startswith("<!DOCTYPE html>")
    assert reported.out.endswith("</html>\n")


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.parametrize("arguments", [("report", "-o"), ("identify", "--html")])
def test_a_report_is_written_over_no_log(eivor, log, arguments):
    command, option = arguments
    before = log.read_bytes()
    reported = eivor(command, log, option, log)
    assert reported.code == 2
    assert "would replace" in reported.err
    assert log.read_bytes() == before


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_report_needs_a_file(eivor, log):
    reported = eivor("report", log)
    assert reported.code == 2
    assert "-o flight.html" in reported.err


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_log_that_cannot_be_read_gives_a_sentence_and_no_page(eivor, tmp_path):
    broken, page = tmp_path / "broken.ulg", tmp_path / "flight.html"
    broken.write_bytes(b"ULog\x01\x12\x35 nothing")
    reported = eivor("report", broken, "-o", page)
    assert reported.code == 1
    assert reported.err.startswith("eivor: ")
    assert not page.exists()


@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_a_report_takes_what_identify_takes():
    current, known = (inspect.signature(item).parameters for item in (report, identify))
    assert set(current) - {"out"} == set(known) - {"json", "figure", "html", "card"}
