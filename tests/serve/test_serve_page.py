"""The text of the page of `eivor serve`: what its policy allows, and that text in it stays text."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from importlib import resources
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from eivor.cli.main import application
from eivor.inference.verdict import Status
from eivor.report.html import report_sources
from eivor.serve.app import PARTS, page_text
from eivor.serve.jobs import File, KeptLog, Task, work
from eivor.serve.requests import RefusedError, parse_job
from eivor.serve.worker import outcome_of
from report.parsed_page import parsed

#: What would make HTML or code of a string.
NEVER = (
    *("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "DOMParser", "srcdoc", "eval("),
    *("new Function", 'setTimeout("'),
)


@pytest.fixture(scope="module")
def page():
    return parsed(page_text())


def test_the_policy_allows_the_page_its_reports_and_its_own_server(page):
    (policy,) = (item.attributes["content"] for item in page.all("meta") if "http-equiv" in item.attributes)
    rules = dict(item.split(" ", 1) for item in policy.split("; "))
    (style,) = page.all("style")
    (script,) = (item for item in page.all("script") if item.attributes.get("type") != "application/json")
    report = report_sources()
    assert rules == {
        "default-src": "'none'",
        "script-src": f"{checksum(script.text)} {checksum(report.script)}",
        "style-src": f"{checksum(style.text)} {checksum(report.style)}",
        "img-src": "data:",
        "connect-src": "'self'",
        "frame-src": "blob:",
        "base-uri": "'none'",
        "form-action": "'none'",
        "require-trusted-types-for": "'script'",
    }


def checksum(source):
    return f"'sha256-{base64.b64encode(hashlib.sha256(source.encode()).digest()).decode()}'"


def test_nothing_in_it_is_fetched_or_handled_inline(page):
    for item in page.all():
        assert not {"style", "src", "srcset"} & item.attributes.keys()
        assert not any(key.startswith("on") for key in item.attributes)
        assert item.attributes.get("href", "data:,") == "data:,"
    assert page.all("noscript")


def test_text_never_becomes_markup():
    folder = resources.files("eivor.serve").joinpath("static")
    files = [item for item in folder.iterdir() if item.name.endswith(".js")]
    scripts = {item.name: item.read_text(encoding="utf-8") for item in files}
    assert set(scripts) == {f"{name}.js" for name in PARTS}
    for name, script in scripts.items():
        assert [item for item in NEVER if item in script] == [], name
        assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", script), name


def test_every_verdict_and_every_stage_has_a_shape_of_its_own(page):
    (embedded,) = page.all("script", id="shapes")
    shapes = json.loads(embedded.text)
    assert {status.value for status in Status} | {"contradicted", "over", "now", "ahead"} == set(shapes)
    assert len(set(shapes.values())) == len(shapes)


def test_what_the_script_looks_for_is_there(page):
    folder = resources.files("eivor.serve").joinpath("static")
    scripts = " ".join(folder.joinpath(f"{part}.js").read_text(encoding="utf-8") for part in PARTS)
    names = set(re.findall(r'found\("([\w-]+)"\)', scripts))
    assert names
    for name in names:
        assert len(page.all(id=name)) == 1, name


@pytest.fixture(scope="module")
def content():
    """The first 30 s of the example flight as the bytes of a log."""
    with resources.as_file(resources.files("eivor.data") / "example_flight.parquet") as path:
        table = pl.read_parquet(path).head(3000)
    return table.write_csv().encode()


def identified(folder, logs, **options):
    """Outcome of identifying logs that are kept under other names, and what was told."""
    kept = {}
    for number, (name, log) in enumerate(logs.items()):
        path = folder / f"{number}a5b6c7{number}{Path(name).suffix}"
        path.write_bytes(log)
        kept[str(number)] = KeptLog(path, name, len(log))
    requested = parse_job(json.dumps({"logs": list(kept), "options": options}).encode())
    reported: list[Any] = []
    task = Task("identify", {"request": requested, "logs": kept, "folder": folder})
    return outcome_of(task, reported.append), reported


@pytest.mark.usefixtures("coarse_search")
@pytest.mark.thorough
def test_a_result_is_that_of_the_command_line(tmp_path, content, monkeypatch):
    outcome, reported = identified(
        tmp_path, {"my flight.csv": content}, window="1:29.5", lag="60:20", max_tilt=20
    )
    assert outcome is None
    stages = ["reading", "preparing", "identifying", "diagnosing", "writing"]
    assert reported[:-1] == [{"stage": name} for name in stages]
    path = json.loads((tmp_path / "result.json").read_bytes())["motions"]["vertical"]
    assert reported[-1] == {"done": {"status": path["verdict"]}}
    (tmp_path / "typed").mkdir()
    monkeypatch.chdir(tmp_path / "typed")
    Path("my flight.csv").write_bytes(content)
    options = ["--window", "1:29.5", "--lag", "60:20", "--max-tilt", "20"]
    with pytest.raises(SystemExit):
        application("identify")(
            ["identify", "my flight.csv", *options, "--json", "fit.json", "--html", "page.html"]
        )
    assert (tmp_path / "result.json").read_bytes() == Path("fit.json").read_bytes()
    assert (tmp_path / "report.html").read_bytes() == Path("page.html").read_bytes()

    given: dict[str, Any] = {"folder": tmp_path, "stem": "x"}
    listed = outcome_of(Task("list_exports", {**given, "words": {}}), reported.append)
    assert isinstance(listed, list)
    ready = {item["name"] for item in listed if not item["reason"]}
    assert "statespace" in ready
    assert all(item["file"].startswith(f"x-{item['name']}.") for item in listed)
    for entry in listed:
        task = Task("export", {**given, "words": {"target": entry["name"]}})
        made = outcome_of(task, reported.append)
        assert isinstance(made, RefusedError if entry["reason"] else File)
        assert entry["reason"] == (str(made) if isinstance(made, RefusedError) else "")
    known = "inertia_xx=1e-5\ninertia_yy=1e-5\ninertia_zz=1.5e-5\ntorque_ratio=.006\nlargest_command=2500"
    body = {"mass": "0.03", "vehicle": "crazyflie-2x", "prior": known}
    for entry in outcome_of(Task("list_exports", {**given, "words": body}), reported.append):
        # what a target lacks is beside it
        assert entry["name"] != "urdf" or "no lag of the rotors, and" in " ".join(entry["left_out"])
    refused = outcome_of(Task("plan", {**given, "words": {"form": "qgc"}}), reported.append)
    assert isinstance(refused, RefusedError)
    assert "--home" in str(refused)


@pytest.mark.usefixtures("coarse_search")
@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"window": "67:4"}, "a window START:END with START before END"),
        ({"lag": "x"}, "a lag MS:STD"),
        ({"method": "magic"}, "a method out of"),
        ({"model": "rocket"}, "a motion out of"),
        ({"mass": "heavy"}, "VALUE or VALUE:STD for --mass"),
        ({"map": "rotorp"}, "Did you mean 'rotorpy'"),
        ({"map": "result.json"}, "a shipped map"),
        ({"model": "rigid-body", "vehicle": "crazyfly"}, "a shipped vehicle"),
        ({"model": "rigid-body", "vehicle": "vehicle.toml"}, "a shipped vehicle"),
        ({"model": "rigid-body", "vehicle": "/etc/passwd"}, "vehicle.toml"),
        ({"model": "rigid-body", "vehicle": "[rotors]\nmany = 1"}, "vehicle.toml"),
        ({"map": "name = 3"}, "map.toml"),
        ({"noise": ["velocity_z"]}, "a noise NAME=STD"),
        ({"instruments": "nothing"}, "channels of hidden.csv as instruments"),
        ({"window": "500:600"}, "window"),
    ],
)
def test_what_makes_no_sense_is_told_as_on_the_command_line(tmp_path, content, options, sentence):
    outcome, _ = identified(tmp_path, {"hidden.csv": content}, **options)
    assert isinstance(outcome, RefusedError)
    assert outcome.status == 400
    assert sentence in str(outcome)
    assert str(tmp_path) not in str(outcome)


@pytest.mark.usefixtures("coarse_search")
@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("empty.ulg", b""),
        ("damaged.ulg", b"ULog\x01\x125\x01" + bytes(100)),
        ("page.html", b"<script>alert(1)</script>"),
        ("<script>alert(1)</script>.csv", b"a,b\n1,2\n"),
        ("\u202egpj" * 60, b"\x89PNG"),
    ],
)
def test_a_damaged_log_is_a_sentence_with_its_own_name(tmp_path, name, said):
    outcome, reported = identified(tmp_path, {name: said})
    assert isinstance(outcome, RefusedError)
    assert reported == [{"stage": "reading"}]
    assert name in str(outcome)
    assert "a5b6c7" not in str(outcome)
    assert str(tmp_path) not in str(outcome)


@pytest.mark.usefixtures("coarse_search")
def test_choices_are_those_that_there_are():
    outcome = work(Task("choices"), lambda _: None)
    assert isinstance(outcome, dict)
    known = dict(outcome)
    folders = known.pop("folders")
    assert {".ulg", ".bin", ".csv", ".mcap"} <= set(folders["endings"])
    assert {".db3", ".mcap"} <= set(folders["bags"])
    assert re.fullmatch(folders["tables"], "my_log_sensor_combined_0.csv")[1] == "my_log"
    assert re.fullmatch(folders["tables"], "flight.csv") is None
    assert folders["metadata"] == "metadata.yaml"
    assert set(known) == {"models", "methods", "maps", "vehicles", "targets", "plans"}
    for entries in known.values():
        assert all(entry["name"] and entry["words"] for entry in entries)
    assert [item["needs"] for item in outcome["plans"] if item["name"] == "qgc"] == [["home"]]
