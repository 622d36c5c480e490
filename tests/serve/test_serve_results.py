"""What the page is given is what the command line gives."""

from __future__ import annotations

import json
from importlib import resources
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from eivor.cli.main import application
from eivor.serve.jobs import (
    Begin,
    Export,
    File,
    Identify,
    KeptLog,
    ListExports,
    Plan,
    Refused,
    Supply,
    Work,
)
from eivor.serve.requests import parse_job
from eivor.serve.worker import outcome_of

pytestmark = pytest.mark.usefixtures("coarse_search")


@pytest.fixture(scope="module")
def content() -> bytes:
    """The first 30 s of the example flight as the bytes of a log."""
    with resources.as_file(resources.files("eivor.data") / "example_flight.parquet") as path:
        table = pl.read_parquet(path).head(3000)
    return table.write_csv().encode()


def identified(folder: Path, logs: dict[str, bytes], **options: Any) -> tuple[Any, list[Any]]:
    """Outcome of identifying logs that are kept under other names, and what was told."""
    kept = {}
    for number, (name, log) in enumerate(logs.items()):
        path = folder / f"{number}a5b6c7{number}{Path(name).suffix}"
        path.write_bytes(log)
        kept[str(number)] = KeptLog(path, name, len(log))
    requested = parse_job(json.dumps({"logs": list(kept), "options": options}).encode())
    lag_measurements: list[Any] = []
    return outcome_of(Identify(requested, kept, folder), lag_measurements.append), lag_measurements


@pytest.mark.thorough
def test_a_result_is_that_of_the_command_line(tmp_path, content, monkeypatch):
    outcome, reported = identified(
        tmp_path, {"my flight.csv": content}, window=[1, 29.5], lag="60:20", max_tilt=20
    )
    assert outcome is None
    stages = ["reading", "preparing", "identifying", "diagnosing", "writing"]
    assert reported[:-1] == [{"stage": name} for name in stages]
    path = json.loads((tmp_path / "result.json").read_bytes())
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

    listed = outcome_of(ListExports(tmp_path, Supply(), "x"), reported.append)
    assert isinstance(listed, list)
    ready = {item["name"] for item in listed if not item["reason"]}
    assert "statespace" in ready
    assert all(item["file"].startswith(f"x-{item['name']}.") for item in listed)
    for entry in listed:
        made = outcome_of(Export(tmp_path, Supply(), "x", entry["name"]), reported.append)
        assert isinstance(made, Refused if entry["reason"] else File)
        assert entry["reason"] == (made.error_parts["sentence"] if isinstance(made, Refused) else "")
    refused = outcome_of(Plan(tmp_path, "x", "qgc"), reported.append)
    assert isinstance(refused, Refused)
    assert "--home" in refused.error_parts["sentence"]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"window": "67:4"}, "a window START:END with START before END"),
        ({"lag": "x"}, "a lag MS:STD"),
        ({"method": "magic"}, "a method out of"),
        ({"model": "rover"}, "a motion out of"),
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
        ({"window": [500, 600]}, "window"),
    ],
)
def test_what_makes_no_sense_is_told_as_on_the_command_line(tmp_path, content, options, sentence):
    outcome, _ = identified(tmp_path, {"hidden.csv": content}, **options)
    assert isinstance(outcome, Refused)
    assert outcome.status == 400
    assert sentence in outcome.error_parts["sentence"]
    assert str(tmp_path) not in outcome.error_parts["sentence"]


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
    assert isinstance(outcome, Refused)
    assert reported == [{"stage": "reading"}]
    assert name in outcome.error_parts["sentence"]
    assert "a5b6c7" not in outcome.error_parts["sentence"]
    assert str(tmp_path) not in outcome.error_parts["sentence"]


def test_choices_are_those_that_there_are():
    work = Work()(Begin(), lambda _: None)
    assert isinstance(work, dict)
    known = dict(work)
    folders = known.pop("folders")
    assert {".ulg", ".bin", ".csv", ".mcap"} <= set(folders["endings"])
    assert folders["metadata"] == "metadata.yaml"
    assert set(known) == {"models", "methods", "maps", "vehicles", "targets", "plans"}
    for entries in known.values():
        assert all(entry["name"] and entry["words"] for entry in entries)
    assert [item["needs"] for item in work["plans"] if item["name"] == "qgc"] == [["home"]]


@pytest.mark.thorough
def test_several_logs_are_pooled_and_told_apart(tmp_path, content):
    other = content + content.splitlines(keepends=True)[-1].replace(b"29.99", b"30.00", 1)
    outcome, _ = identified(tmp_path, {"a.csv": content, "b.csv": other})
    assert outcome is None
    path = json.loads((tmp_path / "result.json").read_bytes())
    assert [item["name"] for item in path["logs"]] == ["a.csv", "b.csv"]
