"""The table of a fleet: its columns, its parts, and the questions of the page."""

from __future__ import annotations

import io
import os
import re
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Any

import polars as pl
import pytest
from polars.testing import assert_frame_equal

import eivor as ev
from eivor.atomic_file import parquet_bytes
from eivor.cli.parsing import log_argument
from eivor.errors import InputError, UsageError
from eivor.fleet.logs import given_covariates, logs_found, path_fields, with_covariates
from eivor.fleet.run import compact_fleet, run_fleet
from eivor.fleet.table import FleetFolder, FleetOptions, reports_there
from eivor.logs.read import here, path_of
from fleets.fleet_rows import row, rows_of, write_fleet, write_logs
from refusal_rows import calls, rows, table, without
from validation.simulated_fleets import FleetSpec, fleet_rows


def test_parts_of_several_motions_are_put_together_by_name(tmp_path):
    other = {name.replace("gain.", "drag."): value for name, value in row("a", motion="rates").items()}
    fleet = ev.fleet.open(write_fleet(tmp_path / "fleet", [row("b"), row("a")], [other]))
    assert fleet.flights.select("motion", "name", "gain.value", "drag.value").rows() == [
        ("rates", "a", None, 1.0),
        ("vertical", "a", 1.0, None),
        ("vertical", "b", 1.0, None),
    ]
    assert fleet.quantities.select("motion", "name", "quantity", "value").rows() == [
        ("rates", "a", "drag", 1.0),
        ("vertical", "a", "gain", 1.0),
        ("vertical", "b", "gain", 1.0),
    ]


def test_queries(tmp_path, command_line):
    rows = [
        row("a", vehicle="one", type="quad"),
        row("b", vehicle="one", type="quad", verdict="identified"),
        row("c", vehicle="two", type="quad", verdict="refused", reason="Never airborne."),
        row("d", verdict="failed", reason="It is empty."),
        row("e", verdict="copy", sha256="a" * 8, copy_of="a" * 8, duration_s=None),
    ]
    folder = write_fleet(tmp_path / "fleet", rows)

    def query(what):
        run = command_line("fleet", "query", folder, what, "--csv", "-")
        assert run.code == 0, run.err
        table = pl.read_csv(io.StringIO(run.out))
        assert table.columns[0] == "motion"
        return table

    assert dict(query("verdicts").select("verdict", "logs").rows())["copy"] == 1
    vehicles = query("vehicles").select("vehicle", "logs", "with_result", "identified", "hours")
    assert vehicles.rows()[0] == ("one", 2, 2, 1, 1.0)
    assert query("failed")["reason"].to_list() == ["It is empty."]
    assert query("refused")["name"].to_list() == ["c"]
    assert query("copies").rows() == [("vertical", "e", "a")]
    assert query("gain")["value"].to_list() == [1.0, 1.0, 1.0]
    run = command_line("fleet", "query", folder, "gian")
    assert run.code == 2
    assert "Did you mean 'gain'?" in run.err


PAGE = Path(__file__).parents[2] / "docs" / "fleet.md"
BLOCK = re.compile(r"^```sql\n(.*?)^```", re.MULTILINE | re.DOTALL)


def test_the_questions_of_the_page(tmp_path, monkeypatch):
    duckdb = pytest.importorskip("duckdb")
    table = fleet_rows(FleetSpec(vehicles=3, flights=4))
    write_fleet(tmp_path / "fleet", [row("a", verdict="failed", reason="It is empty.")])
    table.write_parquet(tmp_path / "fleet" / "flights" / "part-1.parquet")
    compact_fleet(tmp_path / "fleet")
    monkeypatch.chdir(tmp_path)
    questions = [text for block in BLOCK.findall(PAGE.read_text("utf-8")) for text in block.split(";")]
    fixed, failed, over_time = (duckdb.sql(text) for text in questions if text.strip())
    weight = 1.0 / pl.col("input_gain.std_error") ** 2
    expected = table.group_by("vehicle").agg(
        pl.len(), (pl.col("input_gain.value") * weight).sum() / weight.sum()
    )
    assert fixed.fetchall() == [pytest.approx(item) for item in expected.sort("vehicle").rows()]
    assert failed.fetchall() == [("a", "It is empty.")]
    assert over_time.shape == (table.height, 5)
    (code,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {}
    exec(compile(code, PAGE.name, "exec"), names)  # noqa: S102 - the project's own page
    assert names["fleet"].flights.height == table.height + 1
    assert set(names["fleet"].quantities["name"]) == set(table["name"])


@pytest.fixture
def bucket(monkeypatch):
    """Address of a bucket of a local S3 server."""
    pytest.importorskip("upath")
    pytest.importorskip("s3fs").S3FileSystem.clear_instance_cache()  # of a server that has stopped
    server = pytest.importorskip("moto.server").ThreadedMotoServer(
        ip_address="127.0.0.1", port=0, verbose=False
    )
    server.start()
    host, port = server.get_host_and_port()
    monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "testing")
    yield "s3://bucket"
    server.stop()


def elsewhere(test):
    """Marks of a test of a server for addresses, whose paths do as paths do, and are none."""
    unchecked = os.environ.get("EIVOR_SHAPE_CHECKS") == "0"
    categories = ("DeprecationWarning", "ResourceWarning", "pytest.PytestUnraisableExceptionWarning")
    marked = pytest.mark.filterwarnings(*(f"ignore::{name}" for name in categories))(test)
    return pytest.mark.thorough(pytest.mark.skipif(not unchecked, reason="shapes are checked")(marked))


@elsewhere
def test_logs_and_fleets_elsewhere(bucket, tmp_path, monkeypatch):
    """The rows are those of the same logs here; what was cut off is gone on with; reports are there, too."""
    rows_of(monkeypatch)
    texts = {"logs/a.csv": "one", "logs/b/c.csv": "two!", "logs/b/d.csv": "one", "logs/README": "no log"}
    write_logs(tmp_path, texts)
    path_of(bucket).mkdir(exist_ok=True)
    for name, text in texts.items():
        path_of(f"{bucket}/{name}").write_text(text)

    def rows(logs, folder, **choices):
        done = run_fleet(logs_found(logs), path_of(folder), FleetOptions(), **choices)
        return done, ev.fleet.open(folder).flights

    done, table = rows(f"{bucket}/logs", f"{bucket}/fleet", page_of=str)
    assert (done.logs, done.before, done.others) == (3, 0, 1)
    assert_frame_equal(table, rows(str(tmp_path / "logs"), str(tmp_path / "fleet"))[1])
    assert_frame_equal(table, rows((tmp_path / "logs").as_uri(), (tmp_path / "other").as_uri())[1])
    FleetFolder(path_of(f"{bucket}/fleet")).begin().write([row("z", sha256="z" * 64)])
    done, table = rows(f"{bucket}/logs/**/*.csv", f"{bucket}/fleet")
    assert (done.before, done.elsewhere, table.height) == (3, 1, 4)
    assert len(set(reports_there(path_of(f"{bucket}/fleet")))) == 2
    assert compact_fleet(path_of(f"{bucket}/fleet")) == (4, 1)
    part = path_of(f"{bucket}/fleet/flights/part-000000.parquet")
    part.write_bytes(part.read_bytes()[:-9])
    assert rows(f"{bucket}/logs", f"{bucket}/fleet")[1].height == 3
    with here(f"{bucket}/logs/a.csv") as local:
        assert local.read_text() == "one"
    with pytest.raises(InputError, match="an address with files"):
        logs_found(f"{bucket}/nothing")
    with pytest.raises(InputError, match="whose files can be listed"):
        logs_found("s3://no-such-bucket/logs")


@elsewhere
def test_logs_elsewhere_are_read_as_here(bucket, tmp_path, command_line):
    """The same result from an address, whole or in part; outputs beside it are written here."""
    flight = pl.read_parquet(resources.files("eivor.data").joinpath("example_flight.parquet"))
    (tmp_path / "x.parquet").write_bytes(parquet_bytes(flight))
    path_of(bucket).mkdir(exist_ok=True)
    path_of(f"{bucket}/x.parquet").write_bytes(parquet_bytes(flight))
    local = tmp_path / "x.parquet"
    for number, log in enumerate((str(local), local.as_uri(), f"{bucket}/x.parquet")):
        for command in ("identify", "inspect"):
            made = tmp_path / f"{command}-{number}.json"
            run = command_line(command, f"{log}@5:60", "--json", made)
            assert run.code == 0, run.err
            assert made.read_bytes() == (tmp_path / f"{command}-0.json").read_bytes()
    run = command_line("identify", f"{bucket}/nothing.ulg")
    assert run.code == 1
    assert "Expected an address that can be read; received 's3://bucket/nothing.ulg'" in run.err


def of_list(text, tmp_path, name="list.csv"):
    (tmp_path / name).write_text(text, encoding="utf-8")
    logs_found(str(tmp_path / name))


def of_covariates(text, tmp_path):
    (tmp_path / "masses.csv").write_text(text)
    with_covariates(fleet_rows(FleetSpec(vehicles=1, flights=2)), given_covariates(tmp_path / "masses.csv"))


def of_a_damaged_part(tmp_path):
    (write_fleet(tmp_path, [row("a")]) / "flights" / "part-9.parquet").write_bytes(b"PAR1 and nothing else")
    ev.fleet.open(tmp_path)


test_refused = table(
    rows("list", None, of_list,
        ("path,tail\na.csv,N1\nb.csv\n", InputError, r"2 columns in each line .*; received 1 in line 3"),
        ('path,tail\n"a"b.csv,N1\n', InputError, r"that can be read; received line 2: .*expected after"),
        ("path,path\na.csv,b.csv\n", UsageError, "a list whose columns have different names"),
        ("path,tail\n", UsageError, "which names none"),
    ),
    rows("covariates", InputError, of_covariates,
        ("", "a CSV of covariates"),
        ("flight,mass\na,1\n", "a column sha256 or name"),
        ("name,mass\na,heavy\n", "columns of numbers"),
        ("name,mass\na,1\na,2\n", "every flight once"),
        ("name,mass\nnone,1\n", "covariates of flights of the fleet"),
        ("name,input_gain.value\nv0000-0000.ulg,1\n", "names of covariates"),
    ),
    rows("pattern", UsageError, path_fields,
        *((text, r"a pattern with \{vehicle\}") for text in ("{}", "{serial}/*", "{vehicle}/{vehicle}")),
    ),
    calls("call", None,
        (lambda tmp_path: ev.fleet.open(tmp_path / ""), InputError, "the folder of a fleet.*eivor fleet run"),
        (partial(of_list, "# nothing\n", name="list.txt"), UsageError, "which names none"),
        (of_a_damaged_part, InputError, "can be read.*sets damaged parts aside"),
        (lambda: logs_found("nowhere"), InputError, "received '.*nowhere', which does not exist"),
        (lambda: pytest.importorskip("upath") and path_of("s4://a"), UsageError,
            "a scheme that fsspec knows"),
        *((without("upath", lambda _, read=read: read("s3://bucket/a.ulg")), UsageError,
            r"packages for addresses s3://.*eivor\[cloud\]") for read in (logs_found, log_argument)),
    ),
)  # fmt: skip
