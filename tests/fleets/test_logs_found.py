"""Which files are logs, what they are called, and whose they are."""

from __future__ import annotations

import os
from dataclasses import replace

import pytest

from eivor.errors import InputError, UsageError
from eivor.fleet.logs import PathPattern, logs_found
from eivor.fleet.run import hashed
from eivor.logs.common import folder_sha256
from fleets.fleet_tasks import write_logs

CANONICAL = "time,velocity_z,input\n0,0,0\n"


def names(result):
    return [log.name for log in result.logs]


def test_content_or_ending_makes_a_log(tmp_path):
    logs = {"b/flight.CSV": "a,b\n1,2\n", "a.ulg": "", "table": CANONICAL, "old.bag": ""}
    others = {"README.md": "Logs, and more\nof them\n", "b/notes": "a, b", "image.png": "\x00", "empty": ""}
    result = logs_found(str(write_logs(tmp_path, {**logs, **others})))
    assert names(result) == ["a.ulg", "b/flight.CSV", "old.bag", "table"]
    assert result.others == len(others)
    (tmp_path / "flight").write_bytes(b"ULog\x01\x12\x35\x01")
    assert "flight" in names(logs_found(str(tmp_path)))


def test_globs_and_lists(tmp_path, monkeypatch):
    write_logs(tmp_path, {"x/1/a.csv": "", "x/2/a.csv": "", "x/2/b.txt": "", "y/a.csv": ""})
    assert names(logs_found(f"{tmp_path}/x/**/*")) == ["1/a.csv", "2/a.csv"]
    assert names(logs_found(f"{tmp_path}/*/a.csv")) == ["y/a.csv"]
    (tmp_path / "list.txt").write_text("# mine\ny/a.csv\n\nx/1/a.csv\ny/a.csv\nnowhere\n")
    path = logs_found(str(tmp_path / "list.txt"))
    assert names(path) == ["nowhere", "x/1/a.csv", "y/a.csv"]
    assert list(path.logs)[2].path == str(tmp_path / "y/a.csv")
    (tmp_path / "list.csv").write_text("path,tail\ny/a.csv,N1\nx/1/a.csv,\n")
    assert [log.metadata for log in logs_found(str(tmp_path / "list.csv")).logs] == [
        {"tail": ""},
        {"tail": "N1"},
    ]
    assert names(logs_found(str(tmp_path / "y/a.csv"))) == ["a.csv"]


def told(tmp_path, name, text):
    (tmp_path / name).write_text(text, encoding="utf-8")
    return [(log.name, dict(log.metadata)) for log in logs_found(str(tmp_path / name)).logs]


def test_lists_of_other_makings(tmp_path):
    """Separated by semicolons, with quotes and blank lines, with the mark that Excel writes."""
    expected = [("a.csv", {"tail": "N;1"}), ("b.csv", {"tail": ""})]
    assert told(tmp_path, "list.csv", 'path;tail\r\na.csv;"N;1"\r\n\r\nb.csv;\r\n;N2\r\n') == expected
    assert told(tmp_path, "list.csv", '\ufefftail\tpath\n"N;1"\ta.csv\n\tb.csv\n') == expected
    assert told(tmp_path, "list.txt", "\ufeffa.csv\r\n#b.csv\r\n") == [("a.csv", {})]
    assert told(tmp_path, "flight.csv", CANONICAL) == [("flight.csv", {})]
    (tmp_path / "other.csv").write_bytes(b"\xff\xfep\x00a\x00")
    assert names(logs_found(str(tmp_path / "other.csv"))) == ["other.csv"]


@pytest.mark.parametrize(
    ("text", "error", "match"),
    [
        ("path,tail\na.csv,N1\nb.csv\n", InputError, r"2 columns in each line .*; received 1 in line 3"),
        ('path,tail\n"a"b.csv,N1\n', InputError, r"that can be read; received line 2: .*expected after"),
        ("path,path\na.csv,b.csv\n", UsageError, "a list whose columns have different names"),
        ("path,tail\n", UsageError, "which names none"),
    ],
)
def test_lists_that_cannot_be_read_are_told(tmp_path, text, error, match):
    with pytest.raises(error, match=match):
        told(tmp_path, "list.csv", text)


@pytest.mark.skipif(os.name == "nt", reason="paths are shorter there")
def test_deep_folders_and_links(tmp_path):
    """Many folders in each other; links to files are files, those to folders are not followed."""
    path = tmp_path / "/".join("d" * 200)
    made = tmp_path
    for part in path.relative_to(tmp_path).parts:
        made /= part
        made.mkdir()
    (path / "a.csv").touch()
    (tmp_path / "loop").symlink_to(tmp_path)
    (tmp_path / "b.csv").symlink_to(path / "a.csv")
    logs = logs_found(str(tmp_path))
    assert names(logs) == ["b.csv", f"{'d/' * 200}a.csv"]
    assert (logs.others, logs.unread_folders) == (0, ())


def test_what_is_not_there_is_told(tmp_path):
    with pytest.raises(InputError, match=r"received '.*nowhere', which does not exist"):
        logs_found(str(tmp_path / "nowhere"))
    assert names(logs_found(f"{tmp_path}/*.ulg")) == []
    (tmp_path / "list.txt").write_text("# nothing\n")
    with pytest.raises(UsageError, match="which names none"):
        logs_found(str(tmp_path / "list.txt"))


def test_files_that_are_one_log_together_count_once(tmp_path):
    """Those that ROS 2 wrote into a folder, and those that `ulog2csv` made of a log."""
    write_logs(
        tmp_path,
        {
            "bag/metadata.yaml": "",
            "bag/flight_0.db3": "",
            "bag/flight_1.db3": "",
            "bag/other.ulg": "",
            "x/bag_2026/bag_2026_0.mcap.zstd": "",
            "x/bag_2026/bag_2026_1.mcap.zstd": "",
            "several/one_1.mcap": "",
            "several/one_2.mcap": "",
            "tables/a_vehicle_attitude_0.csv": "",
            "tables/a_esc_status_0.csv": "",
            "tables/notes_1.csv": "",
            "beside/b_vehicle_attitude_0.csv": "",
            "beside/b.ulg": "",
        },
    )
    logs = logs_found(str(tmp_path))
    assert names(logs) == [
        "bag",
        "bag/other.ulg",
        "beside/b.ulg",
        "several/one_1.mcap",
        "several/one_2.mcap",
        "tables",
        "tables/notes_1.csv",
        "x/bag_2026",
    ]
    assert logs.others == 1
    assert names(logs_found(f"{tmp_path}/*/*.db3")) == names(logs_found(f"{tmp_path}/ba*")) == ["bag"]
    assert names(logs_found(str(tmp_path / "bag"))) == ["bag", "other.ulg"]
    (log, _) = logs_found(str(tmp_path / "bag")).logs
    assert hashed(log).sha256 == folder_sha256(tmp_path / "bag")
    assert hashed(replace(log, path=str(tmp_path))).problem == "It is no regular file."


@pytest.mark.skipif(os.name == "nt", reason="names are text there")
def test_strange_names_and_files(tmp_path):
    (tmp_path / os.fsdecode(b"\xff.ulg")).touch()
    os.mkfifo(tmp_path / "pipe.ulg")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "broken.csv").symlink_to("nowhere")
    logs = logs_found(str(tmp_path))
    assert names(logs) == [r"\udcff.ulg", "broken.csv", "pipe.ulg"]


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="this user may read everything")
def test_closed_folders_are_told(tmp_path):
    write_logs(tmp_path, {"a.csv": "", "closed/b.csv": ""})
    (tmp_path / "closed").chmod(0)
    try:
        logs = logs_found(str(tmp_path))
    finally:
        (tmp_path / "closed").chmod(0o700)
    assert names(logs) == ["a.csv"]
    assert "Permission denied" in logs.unread_folders[0]


@pytest.mark.parametrize(
    ("pattern", "name", "told"),
    [
        ("{vehicle}/*.ulg", "N1/a.ulg", {"vehicle": "N1"}),
        ("{vehicle}/*.ulg", "x/N1/a.ulg", {}),
        ("**/{type}/{vehicle}/*", "x/y/quad/N1/a.ulg", {"vehicle": "N1", "type": "quad"}),
        ("{type}-{vehicle}_*.csv", "deep/quad-N1_2026_3.csv", {"vehicle": "N1", "type": "quad"}),
        ("flight.{vehicle}?.csv", "flightxN12.csv", {}),
    ],
)
def test_vehicles_by_path(pattern, name, told):
    assert PathPattern(pattern).fields_of(name) == told


@pytest.mark.parametrize("pattern", ["{}", "{serial}/*", "{type}/*", "{vehicle}/{vehicle}"])
def test_patterns_that_cannot_be(pattern):
    if pattern == "{type}/*":
        assert PathPattern(pattern).fields_of("quad/a.csv") == {"type": "quad"}
        return
    with pytest.raises(UsageError, match=r"a pattern with \{vehicle\}"):
        PathPattern(pattern)
