"""A fleet's run: every log once, each with a row, whatever happens on the way."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from polars.testing import assert_frame_equal
from rich.console import Console
from statsmodels.stats.meta_analysis import combine_effects

from eivor.atomic_file import folder_lock, parquet_bytes
from eivor.errors import InputError, UsageError
from eivor.fleet.analysis import STEADY, STEPS, across_of, fleet_report, fleet_reports, report_columns
from eivor.fleet.logs import LogList, logs_found, path_fields, with_covariates
from eivor.fleet.report import fleet_document, flight_links, interval_text, linked
from eivor.fleet.run import compact_fleet, hashed, run_fleet
from eivor.fleet.table import (
    COLUMNS,
    IDENTITY,
    RUN,
    FleetFolder,
    FleetOptions,
    _column_words,
    flight_frame,
    part_files,
    read_flights,
    report_path,
    reports_there,
    write_report,
)
from eivor.logs.common import folder_sha256
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.table import motion_by_name
from eivor.process_pool import Limits
from eivor.report.terminal import on_terminal
from fleets.fleet_rows import row, rows_of, write_fleet, write_logs
from validation.simulated_fleets import FleetSpec, fleet_rows
from worker_answers import SOURCES

OPTIONS = FleetOptions()


@pytest.fixture
def logs(tmp_path):
    texts = {"d.csv": "four", "a.csv": "one", "b.csv": "two!!", "copies/a.csv": "one", "README": "no log"}
    return write_logs(tmp_path / "logs", texts)


@pytest.fixture(autouse=True)
def _quick(monkeypatch):
    rows_of(monkeypatch)


def run(logs, folder, options=OPTIONS, **choices):
    return run_fleet(logs_found(str(logs)), folder, options, **choices)


def content(folder):
    return parquet_bytes(read_flights(folder))


def parts(folder):
    return {path: path.stat().st_mtime_ns for path in part_files(folder)}


def test_every_log_has_a_row_and_a_copy_no_numbers(logs, tmp_path):
    selected: list[tuple[int, int]] = []
    done = run(logs, tmp_path / "fleet", progress=lambda *numbers: selected.append(numbers))
    table = read_flights(tmp_path / "fleet")
    expected = [("a.csv", "weak", 3.0), ("b.csv", "weak", 5.0), ("copies/a.csv", "copy", None)]
    assert table.select("name", "verdict", "gain.value").rows() == [*expected, ("d.csv", "weak", 4.0)]
    copy = table.row(2, named=True)
    assert copy["copy_of"] == copy["sha256"] == table["sha256"][0]
    assert copy["reason"] == "A copy of a.csv, whose row has the numbers."
    assert (done.logs, done.before, done.others, done.elsewhere) == (4, 0, 1, 0)
    assert done.verdicts == {"weak": 3, "copy": 1}
    assert (selected[0], selected[-1]) == ((0, 4), (4, 4))
    assert set(table["options_hash"]) == {OPTIONS.hash}


def test_what_is_there_is_not_made_again(logs, tmp_path):
    folder = tmp_path / "fleet"
    run(logs, folder)
    before, made = content(folder), parts(folder)
    assert run(logs, folder).before == 4
    assert parts(folder) == made
    write_logs(logs, {"e.csv": "four"})
    done = run(logs, folder)
    assert (done.logs, done.before) == (5, 4)
    assert read_flights(folder)["reason"].to_list()[-1] == "A copy of d.csv, whose row has the numbers."
    (logs / "e.csv").unlink()
    assert run(logs, folder).elsewhere == 1
    assert content(folder) != before


def test_an_interrupt_keeps_what_was_done(logs, tmp_path, monkeypatch):
    run(logs, tmp_path / "expected")
    folder, count = tmp_path / "fleet", [0]

    def stopped(options):
        row = expected(options)

        def made(log):
            count[0] += 1
            if count[0] == 3:
                raise KeyboardInterrupt
            return row(log)

        return made

    from eivor.fleet import table

    expected = table.RowOfLog
    rows_of(monkeypatch, stopped)
    monkeypatch.setattr("eivor.fleet.run.TASKS", 1)
    with pytest.raises(KeyboardInterrupt):
        run(logs, folder)
    assert read_flights(folder)["name"].to_list() == ["a.csv", "b.csv"]
    rows_of(monkeypatch, expected)
    assert run(logs, folder).before == 2
    assert content(folder) == content(tmp_path / "expected")


def test_ten_thousand_copies_are_identified_once(tmp_path, monkeypatch):
    path = logs_found(str(write_logs(tmp_path / "logs", {"a.csv": "one"})))
    (first,) = path.logs
    copies = (replace(first, name=f"{number:05d}.csv") for number in range(10_000))
    many = replace(path, logs=LogList.of(copies))
    once = hashed(first)
    monkeypatch.setattr("eivor.fleet.run.hashed", lambda log: replace(log, sha256=once.sha256))
    done = run_fleet(many, tmp_path / "fleet", OPTIONS)
    assert done.verdicts == {"weak": 1, "copy": 9999}
    assert len(part_files(tmp_path / "fleet")) == 1
    assert read_flights(tmp_path / "fleet", ["name", "verdict"]).row(0) == ("00000.csv", "weak")


def test_logs_that_cannot_be_opened_have_rows_until_they_can(logs, tmp_path, monkeypatch):
    folder = tmp_path / "fleet"
    (logs / "gone.ulg").symlink_to("nowhere")
    with (logs / "huge.bin").open("wb") as stream:
        stream.truncate((1 << 30) + 1)
    (logs / "folder.ulg").mkdir()
    run(logs, folder)
    failed = {row["name"]: row for row in read_flights(folder).rows(named=True) if row["verdict"] == "failed"}
    assert failed["gone.ulg"]["reason"] == "It cannot be opened: No such file or directory."
    assert failed["huge.bin"]["reason"].startswith("It has 1073741825 bytes, more than")
    assert len(failed) == 2
    assert {row["sha256"] for row in failed.values()} == {None}
    (logs / "gone.ulg").unlink()
    write_logs(logs, {"gone.ulg": "here"})
    assert run(logs, folder).verdicts == {"weak": 4, "failed": 1, "copy": 1}
    assert read_flights(folder).filter(name="gone.ulg")["verdict"].to_list() == ["weak"]
    (logs / "huge.bin").unlink()
    write_logs(logs, {"huge.bin": "small"})
    run(logs, folder)
    assert not any("unopened" in path.name for path in part_files(folder))


def test_every_row_has_the_vehicle_that_its_path_or_the_list_tells(logs, tmp_path):
    """Also of logs that cannot be opened, and of copies."""
    (logs / "gone.csv").symlink_to("nowhere")
    listed = tmp_path / "list.csv"
    listed.write_text("path;tail\nlogs/gone.csv;N1\nlogs/a.csv;N2\nlogs/copies/a.csv;\n", encoding="utf-8")
    by_path = [("weak", "a"), ("weak", "b"), ("copy", "a"), ("weak", "d"), ("failed", "gone")]
    for where, vehicle_from, expected in (
        (listed, "tail", [("weak", "N2"), ("copy", None), ("failed", "N1")]),
        (logs, "**/{vehicle}.csv", by_path),
    ):
        folder = tmp_path / f"fleet by {where.name}"
        run(where, folder, FleetOptions(vehicle_from=vehicle_from))
        assert read_flights(folder, ["verdict", "vehicle"]).rows() == expected


def test_damaged_parts_are_set_aside_and_made_anew(logs, tmp_path):
    folder = tmp_path / "fleet"
    run(logs, folder)
    expected = content(folder)
    damaged = part_files(folder)[0]
    damaged.write_bytes(damaged.read_bytes()[:-20])
    run(logs, folder)
    assert content(folder) == expected
    assert (folder / f"damaged-{damaged.name}").exists()


def in_parts_of(monkeypatch, rows):
    monkeypatch.setattr("eivor.fleet.table.PART_ROWS", rows)


def test_wherever_rows_are_taken_into_the_table_no_reader_misses_one_or_has_one_twice(
    logs, tmp_path, monkeypatch
):
    """Each file that is put in place or removed may be the last; parts of before have other columns."""
    in_parts_of(monkeypatch, 3)
    rows = [row(name, sha256=name * 64) for name in "abcdefg"]
    other = [{"drag.value": 1.0, "drag.verdict": "weak", **row("z", sha256="z" * 64, motion="rates")}]
    for last in range(40):
        folder = write_fleet(tmp_path / str(last), rows[:2], other, rows[2:4])
        expected = content(write_fleet(tmp_path / f"{last} whole", rows, other))
        fleet = FleetFolder(folder).begin()
        for each in rows[4:]:
            fleet.write([each])
        steps = [0]

        def cut_off(whole, steps=steps, last=last):
            def step(*given, **options):
                steps[0] += 1
                if steps[0] > last:
                    raise KeyboardInterrupt
                return whole(*given, **options)

            return step

        with monkeypatch.context() as patched:
            for name in ("replace", "unlink"):
                patched.setattr(Path, name, cut_off(getattr(Path, name)))
            with suppress(KeyboardInterrupt):
                fleet.merge()
        assert content(folder) == expected
        compact_fleet(folder)
        assert content(folder) == expected
        assert [pl.read_parquet(path).height for path in part_files(folder)] in ([4, 4], [3, 3, 2])
        if steps[0] <= last:
            break
    assert last > 10


def test_other_readers_read_the_folder_without_options(tmp_path, monkeypatch):
    duckdb, pandas = pytest.importorskip("duckdb"), pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    in_parts_of(monkeypatch, 2)
    other = [{"drag.value": 1.0, "drag.verdict": "weak", **row("b", motion="rates")}]
    folder = write_fleet(tmp_path / "fleet", [row("a")], other, [row("c"), row("d")])
    (folder / "flights" / "part-unopened-rates.parquet").write_bytes(parquet_bytes(flight_frame([])))
    assert compact_fleet(folder) == (4, 3)
    expected = read_flights(folder)
    flights = folder / "flights"
    assert_frame_equal(pl.read_parquet(flights), expected, check_row_order=False)
    assert_frame_equal(pl.read_parquet(flights / "*.parquet"), expected, check_row_order=False)
    assert pandas.read_parquet(flights).shape == expected.shape
    assert duckdb.sql(f"FROM read_parquet('{flights}/*.parquet')").columns == expected.columns
    described = json.loads((folder / COLUMNS).read_text("utf-8"))["properties"]
    assert list(described) == expected.columns
    assert described["duration_s"]["unit"] == "s"
    # what comes later has other columns, which earlier parts get
    (flights / "part-7.parquet").write_bytes(parquet_bytes(flight_frame([{"new.value": 1.0, **row("e")}])))
    assert compact_fleet(folder)[0] == 5
    assert pl.read_parquet(flights / "*.parquet")["new.value"].count() == 1


def test_columns_have_words_and_units_and_rows_join_the_table_as_the_run_goes(logs, tmp_path, monkeypatch):
    folder, seen = tmp_path / "fleet", []
    monkeypatch.setattr("eivor.fleet.run.MERGE_S", 0.0)
    monkeypatch.setattr("eivor.fleet.run.MERGE_TIMES", 0.0)

    def progress(_done, _total):
        flights = list((folder / "flights").glob("*.parquet"))
        seen.append(sum(pl.read_parquet(path).height for path in flights))

    run(logs, folder, progress=progress)
    assert [seen[0], *seen[-2:]] == [0, 2, 4]
    assert not list((folder / "pending").iterdir())
    properties = json.loads((folder / COLUMNS).read_text("utf-8"))["properties"]
    assert properties["gain.value"] == {"type": ["number", "null"], "description": "estimate"}
    assert all(item["description"] for item in properties.values())
    about = _column_words({"viscous_friction.low": pl.Float64()}, motion_by_name("vertical"))
    assert about["viscous_friction.low"]["unit"] == "1/s"


def test_a_full_disk_loses_nothing_that_was_written(logs, tmp_path, monkeypatch):
    from eivor.fleet import table

    folder, whole = tmp_path / "fleet", table.write_atomically
    run(logs, tmp_path / "expected")

    def full(path, data):
        if len(part_files(folder)) == 2 and path.suffix == ".parquet":
            raise OSError(errno.ENOSPC, "No space left on device")
        whole(path, data)

    monkeypatch.setattr(table, "write_atomically", full)
    with pytest.raises(InputError, match=r"No space left on device.*Rows that were written are kept"):
        run(logs, folder)
    assert read_flights(folder).height == 2
    monkeypatch.setattr(table, "write_atomically", whole)
    assert run(logs, folder).before == 2
    assert content(folder) == content(tmp_path / "expected")


def test_a_folder_of_other_options_or_versions_is_refused(logs, tmp_path):
    folder = tmp_path / "fleet"
    run(logs, folder)
    with pytest.raises(UsageError, match=r"begun with for the motion 'vertical'; received others \(limits\)"):
        run(logs, folder, replace(OPTIONS, limits=Limits(time_s=1.0)))
    document = json.loads((folder / IDENTITY).read_text())
    (folder / IDENTITY).write_text(json.dumps({**document, "versions": {"eivor": "0.0.1"}}))
    assert run(logs, folder).before == 4  # nothing is left to do
    write_logs(logs, {"e.csv": "five?"})
    with pytest.raises(InputError, match=r"the versions that made the rows .*eivor 0\.0\.1"):
        run(logs, folder)
    (folder / IDENTITY).write_text(json.dumps({**document, "schema": "eivor.fleet/9"}))
    with pytest.raises(InputError, match=r"a folder of the format eivor\.fleet/1; received .*eivor\.fleet/9"):
        run(logs, folder)
    (folder / IDENTITY).write_text("[]")
    with pytest.raises(InputError, match="which is another file"):
        run(logs, folder)
    (folder / IDENTITY).unlink()
    with pytest.raises(UsageError, match=r"which has parts of flights and no fleet\.json"):
        run(logs, folder)
    with pytest.raises(UsageError, match="a folder for the fleet"):
        run(logs, logs / "a.csv")


def test_one_run_at_a_time(logs, tmp_path):
    folder = tmp_path / "fleet"
    run(logs, folder)
    with folder_lock(folder), pytest.raises(InputError, match="a folder that no other run works on"):
        run(logs, folder)


def test_a_run_that_another_follows_writes_nothing_more(logs, tmp_path, monkeypatch):
    """Workers of a cluster do not know that who asked was killed, and that the same is asked again."""
    folder = tmp_path / "fleet"

    def taken_over(options):
        (folder / RUN).write_text("another")
        return lambda _log: {}

    rows_of(monkeypatch, taken_over)
    with pytest.raises(InputError, match="which another run has begun on"):
        run(logs, folder)
    assert part_files(folder) == []


def test_nothing_to_do_is_told(tmp_path):
    (tmp_path / "logs").mkdir()
    with pytest.raises(InputError, match=r"received none \(0 other files\)"):
        run(tmp_path / "logs", tmp_path / "fleet")
    assert not (tmp_path / "fleet").exists()


def test_flights_have_reports_of_their_own_where_they_are_asked_for(logs, tmp_path):
    """Also those whose rows are there already, and only those: rows stay, and failed logs have none."""
    folder = tmp_path / "fleet"
    run(logs, folder)
    before, reported = parts(folder), content(folder)
    assert not set(reports_there(folder))
    run(logs, folder, page_of=str)
    table = read_flights(folder)
    assert set(reports_there(folder)) == set(table["sha256"])
    first = table.row(0, named=True)
    assert report_path(folder, first["sha256"]).read_text() == "page of one"
    assert (parts(folder), content(folder)) == (before, reported)
    written = {path: path.stat().st_mtime_ns for path in (folder / "reports").iterdir()}
    run(logs, folder, page_of=str)
    assert {path: path.stat().st_mtime_ns for path in (folder / "reports").iterdir()} == written
    run(logs, tmp_path / "new", page_of=str)
    assert set(reports_there(tmp_path / "new")) == set(reports_there(folder))
    assert content(tmp_path / "new") == reported


def test_a_report_that_cannot_be_written_is_no_fault_of_its_log(logs, tmp_path):
    (tmp_path / "fleet").mkdir()
    (tmp_path / "fleet" / "reports").write_text("in the way")
    with pytest.raises(InputError, match="can be written"):
        run(logs, tmp_path / "fleet", page_of=str)
    (tmp_path / "fleet" / "reports").unlink()
    run(logs, tmp_path / "fleet", page_of=str)
    assert "failed" not in set(read_flights(tmp_path / "fleet")["verdict"])


#: Of the plan by which processes are killed.
SEED = 0

#: Begins runs as children of a process that has loaded everything, and kills them, until it was often enough.
SCRIPT = """
import os, signal, sys, time
from pathlib import Path
import numpy as np
from eivor.fleet import run, table
from eivor.fleet.table import FleetOptions
from eivor.fleet.logs import logs_found
from fleets.fleet_rows import QuickRow
table.RowOfLog, run.kept_process = QuickRow, lambda function, _limits: function
run.TASKS, run.MOST_LOGS = 1, 3
logs, folder, kills, options = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), FleetOptions()
plan, killed, fleets = np.random.default_rng({seed}), 0, 1
while killed < kills:
    child = os.fork()
    if not child:
        run.run_fleet(logs_found(logs), folder / str(fleets), options)
        os._exit(0)
    time.sleep(plan.uniform(0.02, 1.2))
    os.kill(child, signal.SIGKILL)
    was_killed = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != 0
    killed, fleets = killed + was_killed, fleets + (not was_killed)
for fleet in range(fleets + 1):  # the first was never killed
    run.run_fleet(logs_found(logs), folder / str(fleet), options)
"""


@pytest.mark.parametrize(
    "kills", [pytest.param(3, marks=pytest.mark.thorough), pytest.param(50, marks=pytest.mark.long)]
)
def test_killed_at_random_instants(tmp_path, kills):
    """SIGKILL to who runs the fleet and begins it again; what is done is begun anew in another folder."""
    texts = {f"{number:03d}.csv": f"slow {number % 50}" for number in range(60)}
    logs = write_logs(tmp_path / "logs", texts)
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(seed=SEED), encoding="utf-8")
    fleets = tmp_path / "fleets"
    command = [sys.executable, str(script), str(logs), str(fleets), str(kills)]
    subprocess.run(command, env=os.environ | {"PYTHONPATH": SOURCES}, check=True)
    tables = {folder.name: content(folder) for folder in fleets.iterdir()}
    assert len(tables) >= 2
    assert read_flights(fleets / "0").height == len(texts)
    assert set(tables.values()) == {tables["0"]}


# Which files are logs, what they are called, and whose they are.

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
    expected = [("x/1/a.csv", {"tail": ""}), ("y/a.csv", {"tail": "N1"})]
    assert told(tmp_path, "list.csv", "path,tail\ny/a.csv,N1\nx/1/a.csv,\n") == expected
    assert names(logs_found(str(tmp_path / "y/a.csv"))) == ["a.csv"]
    assert names(logs_found(f"{tmp_path}/*.ulg")) == []


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


def test_files_that_are_one_log_together_count_once(tmp_path):
    """Those that ROS 2 wrote into a folder, and those that `ulog2csv` made of a log."""
    files = """bag/metadata.yaml bag/flight_0.db3 bag/flight_1.db3 bag/other.ulg
        x/bag_2026/bag_2026_0.mcap.zstd x/bag_2026/bag_2026_1.mcap.zstd several/one_1.mcap several/one_2.mcap
        tables/a_vehicle_attitude_0.csv tables/a_esc_status_0.csv tables/notes_1.csv
        beside/b_vehicle_attitude_0.csv beside/b.ulg"""
    write_logs(tmp_path, dict.fromkeys(files.split(), ""))
    logs = logs_found(str(tmp_path))
    found = "bag bag/other.ulg beside/b.ulg several/one_1.mcap several/one_2.mcap tables tables/notes_1.csv"
    assert names(logs) == [*found.split(), "x/bag_2026"]
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
        ("{type}/*", "quad/a.csv", {"type": "quad"}),
    ],
)
def test_vehicles_by_path(pattern, name, told):
    assert path_fields(pattern, name) == told


# Reports of fleets whose truth is known: what is pooled, left out, and told to change.

VERTICAL = motion_by_name("vertical")
GAIN, FRICTION, HOVER = "input_gain", "viscous_friction", "hover_input"


def reported(fleet):
    """Report of a table, or of the fleet of a specification."""
    return fleet_report(fleet_rows(fleet) if isinstance(fleet, FleetSpec) else fleet, VERTICAL)


def of(report, quantity):
    return report.vehicles.filter(pl.col("quantity") == quantity)


def plain(report):
    """Text of the report, as the terminal has it, in one line."""
    screen = Console(width=100)
    with screen.capture() as captured:
        screen.print(on_terminal(fleet_document(report, "fleet")))
    return " ".join(captured.get().split())


def at(table, column, rows):
    """Table with a column changed in some rows."""
    values = table[column].to_list()
    for name, value in rows.items():
        values[name] = value
    return table.with_columns(pl.Series(column, values, dtype=table.schema[column]))


def test_vehicles_are_pooled_as_statsmodels_does():
    table = fleet_rows(FleetSpec(vehicles=2, flights=9, between_flights=0.1, seed=1))
    report = reported(table)
    for vehicle in ("v0000", "v0001"):
        rows = table.filter(pl.col("vehicle") == vehicle)
        value, error = (rows[f"{GAIN}.{part}"].to_numpy() for part in ("value", "std_error"))
        truth = combine_effects(np.log(value), (error / value) ** 2, method_re="iterated", atol=1e-12)
        (identified,) = of(report, GAIN).filter(pl.col("vehicle") == vehicle).rows(named=True)
        assert np.log(identified["mean"]) == pytest.approx(truth.mean_effect_re, abs=1e-6)
        assert identified["between"] == pytest.approx(np.sqrt(truth.tau2), abs=1e-6)
        assert identified["pooled"] == 9
        ends = [identified[name] for name in ("next_low", "low", "mean", "high", "next_high")]
        assert ends == sorted(set(ends))
        assert identified["between_low"] <= identified["between"] <= identified["between_high"]


def test_pooling_identified_flights_only_would_bias_upward():
    """The trap: flights whose interval reaches zero are refused; without them the mean is too large."""
    errors = 0.2 * np.ones(400)
    result = 0.25 + errors * np.random.default_rng(0).standard_normal(400)
    rows = [
        row(f"{number:03d}", vehicle="one", type="quad")
        | {f"{FRICTION}.value": value, f"{FRICTION}.std_error": 0.2}
        | {f"{FRICTION}.verdict": "identified" if value > 0.4 else "refused"}
        for number, value in enumerate(result.tolist())
    ]
    report = reported(pl.DataFrame(rows))
    (identified,) = of(report, FRICTION).rows(named=True)
    assert identified["low"] < 0.25 < identified["high"]
    assert np.mean(result[result > 0.4]) > identified["next_high"]


def test_logs_without_a_vehicle_are_pooled_with_nothing():
    """Ten logs of nobody knows how many vehicles; three of them say their type, one path has two contents."""
    table = fleet_rows(FleetSpec(vehicles=3, flights=10, between_vehicles=0.3, weather=0.05, seed=6))
    without_vehicle = (pl.col("vehicle") == "v0001").alias("nobody")
    table = table.with_columns(
        vehicle=pl.when(without_vehicle).then(None).otherwise("vehicle"),
        type=pl.when(without_vehicle & (pl.col("name") > "v0001-0002.ulg")).then(None).otherwise("type"),
    )
    table = at(table, "name", {11: table["name"][10]})
    report = reported(table)
    alone = of(report, GAIN).filter(pl.col("vehicle").str.starts_with("log "))
    assert (alone["pooled"].to_list(), alone["vehicle"].n_unique()) == ([1] * 10, 10)
    assert alone["only_low"].null_count() == alone["low"].len() - alone["low"].null_count() == 0
    assert alone["differs"].sum() == 0
    (kind,) = report.types.filter(pl.col("quantity") == GAIN).rows(named=True)
    assert (kind["type"], kind["pooled"]) == ("quad", 2)
    known = reported(table.filter(pl.col("vehicle").is_not_null()))
    assert_frame_equal(report.types, known.types)
    assert_frame_equal(report.covariates, known.covariates)
    named = ~pl.col("vehicle").str.starts_with("log ")
    assert_frame_equal(report.vehicles.filter(named), known.vehicles)
    text = plain(report)
    assert "2 vehicles of 1 type; 10 logs without a vehicle, each by itself" in text
    assert "A log without a vehicle id stands alone under its own name" in text


def test_the_intervals_of_a_share_stay_within_its_bounds():
    """Two vehicles of a type that hover at .12 and at .93: by logarithms up to 140,000 times full command."""
    table = fleet_rows(FleetSpec(vehicles=2, flights=3, between_flights=0.2, seed=3))
    value = np.array([0.1, 0.15, 0.12, 0.9, 0.97, 0.93])
    ends = {
        "value": value,
        "std_error": 0.05 * value,
        "low": 0.9 * value,
        "high": np.minimum(1.1 * value, 1.0),
    }
    report = reported(table.with_columns(**{f"{HOVER}.{name}": pl.Series(x) for name, x in ends.items()}))
    for rows in (of(report, HOVER), report.types.filter(pl.col("quantity") == HOVER)):
        for name in ("mean", "low", "high", "next_low", "next_high"):
            assert rows[name].drop_nulls().is_between(0.0, 1.0).all(), name
        assert (rows["low"] < rows["mean"]).all()
        assert (rows["mean"] < rows["high"]).all()


def test_a_slope_that_the_flights_leave_as_expected_is_not_told():
    """Voltage that hardly varies: its slope is what was expected, 1 +- 1 of the gain; density is told."""
    spec = FleetSpec(vehicles=4, flights=12, weather=0.05, battery=1e-4, seed=2)
    report = reported(spec)
    identified = report.covariates.filter(pl.col("quantity") == GAIN)["covariate"].to_list()
    assert identified == ["air_density"]
    text = plain(report)
    assert "goes with battery voltage (type" not in text
    assert "do not identify how input gain, hover input or effective lag goes with battery voltage" in text
    assert "battery voltage is not known of enough flights" not in text
    table = fleet_rows(spec).with_columns(load=pl.lit(2.0))  # of which nothing was expected beforehand
    report = fleet_report(table, VERTICAL, ["load"])
    assert "load" not in report.covariates["covariate"].to_list()
    few = reported(FleetSpec(vehicles=5, flights=1, weather=0.05, battery=0.05))
    assert few.covariates.height == 0


def test_a_broken_propeller_is_dated_in_its_vehicle_and_nowhere_else():
    spec = FleetSpec(vehicles=6, flights=40, weather=0.05, battery=0.03, broken=((2, 17, 0.15),), seed=3)
    gains = of(reported(spec), GAIN)
    assert gains.filter(pl.col("course") != STEADY)["vehicle"].to_list() == ["v0002"]
    (identified,) = gains.filter(pl.col("vehicle") == "v0002").rows(named=True)
    assert identified["course"] == STEPS
    assert abs(identified["step_flight"] - 18) <= 3
    assert identified["step_flight_first"] <= 18 <= identified["step_flight_last"]
    assert identified["step_low"] < -0.15 < identified["step_high"] < 0.0
    assert identified["step_start"] == fleet_rows(spec)["start"][int(identified["step_flight"]) - 1]


def test_covariates_of_any_name_are_taken_out():
    """One of which nothing is known beforehand; what is given stands in place of what is logged."""
    spec = FleetSpec(vehicles=6, flights=30, seed=2)
    table = fleet_rows(spec)
    load = np.exp(0.2 * np.random.default_rng(3).standard_normal(table.height))
    table = table.with_columns(pl.col(f"{GAIN}.value") * load**0.5, air_density=pl.lit(1.0))
    given = table.select("name", rotor_age=pl.Series(load), air_density=pl.lit(1.2))
    joined = with_covariates(table, given)
    assert set(joined["air_density"]) == {1.2}
    report = fleet_report(joined, VERTICAL, given.columns[1:])
    (identified,) = report.covariates.filter(quantity=GAIN, covariate="rotor_age").rows(named=True)
    assert identified["slope"] == pytest.approx(0.5, abs=3.0 * identified["std_error"])
    assert identified["std_error"] < 0.05


def test_a_flight_and_a_vehicle_that_are_out_of_line_are_named():
    table = fleet_rows(FleetSpec(vehicles=9, flights=12, between_vehicles=0.02, seed=5))
    value = table[f"{GAIN}.value"].to_list()
    wrong = {30: 1.4 * value[30], **{index: 0.7 * value[index] for index in range(12)}}
    table = at(table, f"{GAIN}.value", wrong)
    report = reported(table)
    assert report.deviating.select("name", "quantity").rows() == [(table["name"][30], GAIN)]
    assert report.deviating["expected"][0] == pytest.approx(value[30], rel=0.15)
    assert report.vehicles.filter(pl.col("differs"))["vehicle"].to_list() == ["v0000"]


def test_a_folder_has_a_report_for_each_motion(tmp_path):
    numbers = {f"{FRICTION}.{part}": 0.4 for part in ("value", "std_error", "low", "high")}
    rows = [row(name, **numbers, **{f"{FRICTION}.verdict": "weak"}) for name in "ab"]
    fleet = write_fleet(tmp_path / "fleet", rows, [row("a", motion="rates")])
    reports = fleet_reports(fleet)
    assert [report.motion.name for report in reports] == ["rates", "vertical"]
    assert of(reports[1], FRICTION)["pooled"].to_list() == [1, 1]
    assert set(report_columns(across_of(VERTICAL))) >= {"air_density", f"{GAIN}.std_error"}


HASH = "0123456789abcdef" * 4


@pytest.mark.parametrize(
    ("page", "address"),
    [
        ("report.html", f"my%20fleet/reports/{HASH}.html"),
        ("my fleet/report.html", f"reports/{HASH}.html"),
        ("pages/report.html", f"../my%20fleet/reports/{HASH}.html"),
    ],
)
def test_addresses_are_relative_to_the_page_and_say_the_hash_alone(tmp_path, page, address):
    folder = tmp_path / "my fleet"
    folder.mkdir()
    assert flight_links(folder, tmp_path / page) == {}
    write_report(folder, HASH, "a page")
    (folder / "reports" / "javascript:alert(1).html").write_text("somebody else's")
    assert flight_links(folder, tmp_path / page) == {HASH: address}
    assert linked("a.ulg", HASH, {HASH: "there"}).link == "there"
    assert linked("a.ulg", "", {HASH: "there"}).below == "no report of its own"


def test_a_table_that_tells_nothing_is_reported():
    report = reported(pl.DataFrame([row("a", verdict="failed", reason="It is empty.")]))
    assert not report.vehicles.height
    assert not report.quantities


def test_a_mean_that_reaches_far_keeps_its_digits():
    wording, names = RigidBody.quantities["pitch_damping"], ("mean", "low", "high")
    far = interval_text({"mean": 0.2432, "low": 1.7e-5, "high": 3412.0}, wording, names)
    assert far == ("0.24", "[1.7e-05, 3400]")
    assert interval_text({"mean": 24.32, "low": 11.0, "high": 350.0}, wording, names)[0] == "20"
    assert interval_text({"mean": None, "low": None, "high": None}, wording, names) == ("–", "–")


def test_flights_without_a_time_are_pooled_and_have_no_course():
    table = fleet_rows(FleetSpec(vehicles=1, flights=12))
    for untimed in (12, 7):
        (identified,) = of(reported(at(table, "start", dict.fromkeys(range(untimed)))), GAIN).rows(named=True)
        assert (identified["pooled"], identified["course"], identified.get("change")) == (12, "", None)
