"""What a command writes: over nothing that it reads, whole or not at all, and never before it has printed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from eivor.cli.outputs import deliver, figure_file, keep_apart, output_file, same_file, writing
from eivor.errors import InputError, UsageError

Caller = Callable[..., Any]
pytestmark = pytest.mark.usefixtures("coarse_search")

MAP = """
name = "mine"
[time]
column = "time"
[channels.velocity_z]
column = "v"
[channels.specific_force_z]
column = "a"
[channels.input]
column = "u"
"""
STUDY = """
runs = 2
seed = 3
scenario = "scene.toml"
[[methods]]
name = "least_squares"
"""
SCENE = """
viscous_friction = 0.3
input_gain = 2.0
samples = 60
[excitation]
kind = "series"
values = { file = "drive.csv", column = "u" }
"""


def test_an_output_must_not_overwrite_what_is_read(tmp_path: Path) -> None:
    log = tmp_path / "flight.csv"
    log.touch()
    (tmp_path / "link.csv").symlink_to(log)
    os.link(log, tmp_path / "twin.csv")
    for name in ("./flight.csv", "link.csv", "twin.csv"):
        with pytest.raises(UsageError, match=r"a file for --json other than the logs.*it would be lost"):
            keep_apart({"--json": tmp_path / name}, {"the map": [], "the logs": [log]})
    keep_apart({"--json": tmp_path / "other.csv"}, {"the logs": [log]})


def test_outputs_are_different_files(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="two files for --json and --figure"):
        keep_apart({"--json": tmp_path / "x.svg", "--figure": tmp_path / "." / "x.svg"}, {})
    (tmp_path / "folder").mkdir()
    (tmp_path / "link").symlink_to("folder")
    assert same_file(tmp_path / "link" / "new", tmp_path / "folder" / "new")
    keep_apart({"--out": Path("/dev/null"), "--truth": Path("/dev/null")}, {})


def test_an_output_needs_a_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        output_file(str(tmp_path / "no" / "x.json"), option="--json")
    with pytest.raises(UsageError, match="the folder"):
        output_file(str(tmp_path), option="--json")
    with pytest.raises(InputError, match="File name too long"):
        output_file(str(tmp_path / ("x" * 300)), option="--json")
    (tmp_path / "dangling").symlink_to("no/x.json")
    with pytest.raises(InputError, match="No such file"):
        output_file(str(tmp_path / "dangling"), option="--json")
    assert output_file(str(tmp_path / "x.json"), option="--json") == tmp_path / "x.json"
    assert [path.name for path in tmp_path.iterdir()] == ["dangling"]


def test_eivor_s_own_files_are_no_outputs() -> None:
    import eivor

    example = Path(eivor.__file__).parent / "data" / "example_flight.parquet"
    with pytest.raises(UsageError, match="belongs to Eivor"):
        output_file(str(example), option="--json")


def test_a_figure_has_a_format(tmp_path: Path) -> None:
    assert figure_file(str(tmp_path / "x.PNG")) == tmp_path / "x.PNG"
    with pytest.raises(UsageError, match=r"\.png, \.svg, \.pdf"):
        figure_file(str(tmp_path / "x.jpg"))


def test_the_system_s_refusal_to_write_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No space left"), writing(tmp_path / "x"):
        raise OSError(28, "No space left on device")


def test_every_part_is_delivered_whatever_happens_to_others(capsys: pytest.CaptureFixture[str]) -> None:
    done: list[int] = []

    def refused(number: int) -> None:
        done.append(number)
        raise InputError("a file", f"number {number}", "Choose another.")

    with pytest.raises(InputError, match="number 1"):
        deliver(lambda: done.append(0), lambda: refused(1), lambda: refused(2), lambda: done.append(3))
    assert done == [0, 1, 2, 3]
    assert capsys.readouterr().err == "eivor: Expected a file; received number 2. Choose another.\n"


@pytest.fixture
def mapped(log: Path) -> Path:
    """A table of other names beside its map."""
    import polars

    table = polars.read_csv(log)
    table.select("time", v="velocity_z", a="specific_force_body_z", u="rotor_command_1").write_csv(log)
    path = log.parent / "map.toml"
    path.write_text(MAP, encoding="utf-8")
    return path


@pytest.mark.parametrize("option", ["--json", "--figure"])
def test_identify_keeps_what_it_reads(eivor: Caller, log: Path, mapped: Path, option: str) -> None:
    link = mapped.with_name("link.svg")
    for source, what in ((log, "the logs"), (mapped, "the channel map")):
        before = source.read_bytes()
        link.unlink(missing_ok=True)
        link.symlink_to(source)
        run = eivor("identify", log, "--map", mapped, option, link)
        assert (run.code, run.out) == (2, "")
        assert f"a file for {option} other than {what}" in run.err
        assert source.read_bytes() == before
        assert link.is_symlink()


def test_inspect_keeps_what_it_reads(eivor: Caller, log: Path, mapped: Path) -> None:
    for source in (log, mapped):
        before = source.read_bytes()
        assert eivor("inspect", log, "--map", mapped, "--json", source).code == 2
        assert source.read_bytes() == before


def test_outputs_of_identify_do_not_replace_each_other(eivor: Caller, log: Path) -> None:
    same = log.parent / "same.svg"
    run = eivor("identify", log, "--json", same, "--figure", same)
    assert (run.code, run.out) == (2, "")
    assert "two files for --json and --figure" in run.err
    assert not same.exists()


@pytest.fixture
def study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study that names a scenario that names a table."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    drive = "\n".join(str(number % 7) for number in range(60))
    (tmp_path / "drive.csv").write_text(f"u\n{drive}\n", encoding="utf-8")
    return tmp_path / "study.toml"


def test_study_keeps_every_file_that_it_names(eivor: Caller, study: Path) -> None:
    sources = [study, study.with_name("scene.toml"), study.with_name("drive.csv")]
    before = [source.read_bytes() for source in sources]
    for source in sources:
        run = eivor("study", study, "--workers", 1, "--json", source)
        assert (run.code, run.out) == (2, "")
        assert "a file for --json other than the study's files" in run.err
    assert [source.read_bytes() for source in sources] == before
    assert not Path("study-study").exists()


@pytest.mark.thorough
def test_study_keeps_its_trials(eivor: Caller, study: Path) -> None:
    assert eivor("study", study, "--workers", 1, "--figures").code == 0
    files = [path for path in Path("study-study").rglob("*") if path.is_file()]
    assert {path.name for path in files} >= {"study.json", "trials.parquet", "000000.parquet", "nrmse.svg"}
    before = [path.read_bytes() for path in files]
    for path in files:
        assert eivor("study", study, "--workers", 1, "--figures", "--json", path).code == 2
    assert [path.read_bytes() for path in files] == before
    text = study.read_text(encoding="utf-8")
    study.rename("study.json")
    run = eivor("study", "study.json", "--out", ".")
    assert (run.code, run.out) == (2, "")
    assert "a file for study.json in --out other than the study's files" in run.err
    assert Path("study.json").read_text(encoding="utf-8") == text


def test_simulate_keeps_every_file_that_it_names(eivor: Caller, study: Path) -> None:
    for name in ("scene.toml", "drive.csv"):
        source = study.with_name(name)
        before = source.read_bytes()
        run = eivor("simulate", "scene.toml", "-o", "log.parquet", "--truth", source)
        assert (run.code, run.out) == (2, "")
        assert "a file for --truth other than the scenario's files" in run.err
        assert source.read_bytes() == before
        assert not Path("log.parquet").exists()
    assert eivor("simulate", "scene.toml", "-o", "drive.csv").code == 2


def test_outputs_of_paper_do_not_replace_each_other(
    eivor: Caller, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("eivor.studies.paper.examples.run_paper", None)
    page = tmp_path / "page.md"
    page.write_text("mine", encoding="utf-8")
    assert "two files for --json and --page" in eivor("paper", "--json", page, "--page", page).err
    run = eivor("paper", "--out", tmp_path, "--json", tmp_path / "figure-2.svg")
    assert "a file for --json other than the figures of --out" in run.err
    assert "unreadable: No such file" in eivor("paper", "--page", tmp_path / "none.md").err
    assert page.read_text(encoding="utf-8") == "mine"


def limited(*arguments: str, bytes_: int, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run with a limit on the size of files, as a full disk would have it."""
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        # compiled modules are files as well, and cut short they would stay behind
        "sys.dont_write_bytecode = True;"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({bytes_}, resource.RLIM_INFINITY));"
        "from eivor.cli.main import run; run()"
    )
    return subprocess.run(
        [sys.executable, "-c", code, *arguments],
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
    )


@pytest.mark.thorough
def test_a_file_that_does_not_fit_leaves_the_earlier_one_and_the_numbers(tmp_path: Path) -> None:
    """The earlier JSON and figure stay whole, nothing is left beside them, and the table is printed."""
    for name in ("fit.json", "fit.svg"):
        (tmp_path / name).write_text("good\n", encoding="utf-8")
    run = limited(
        "identify", "--example", "--json", "fit.json", "--figure", "fit.svg", bytes_=1024, folder=tmp_path
    )
    assert run.returncode == 1
    assert "viscous friction" in run.stdout
    assert run.stderr.count("Expected a file that can be written") == 2
    assert "Traceback" not in run.stderr
    assert {path.name: path.read_text() for path in tmp_path.iterdir() if path.is_file()} == {
        "fit.json": "good\n",
        "fit.svg": "good\n",
    }


@pytest.mark.thorough
def test_files_are_written_when_nobody_reads_the_report(tmp_path: Path) -> None:
    command = f"{sys.executable} -c 'from eivor.cli.main import run; run()' inspect --example --json x.json"
    run = subprocess.run(  # noqa: S602 - a pipe is the point
        f"{command} | exec >&-",
        shell=True,
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert run.stderr == ""
    assert json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))["schema"] == "eivor.inspect/1"


@pytest.mark.thorough
def test_a_log_that_does_not_fit_leaves_the_earlier_one(tmp_path: Path) -> None:
    for name in ("log.csv", "log.parquet"):
        (tmp_path / name).write_text("good\n", encoding="utf-8")
        run = limited("simulate", "rich", "-o", name, bytes_=1024, folder=tmp_path)
        assert run.returncode == 1
        assert "File too large" in run.stderr
        assert (tmp_path / name).read_text(encoding="utf-8") == "good\n"
    assert len([path for path in tmp_path.iterdir() if path.is_file()]) == 2


@pytest.mark.thorough
def test_inspect_and_study_print_what_their_file_does_not_hold(study: Path) -> None:
    folder = study.parent
    for name, arguments in (
        ("inspect.json", ("inspect", "drive.parquet")),
        ("study-found.json", ("study", "study.toml", "--workers", "1")),
    ):
        if arguments[0] == "inspect":
            from eivor.logs import write_recording
            from eivor.logs.example import example_flight

            write_recording(example_flight(), folder / "drive.parquet")
        (folder / name).symlink_to("/dev/full")
        run = subprocess.run(
            [sys.executable, "-c", "from eivor.cli.main import run; run()", *arguments, "--json", name],
            capture_output=True,
            text=True,
            check=False,
            cwd=folder,
        )
        assert run.returncode == 1
        assert len(run.stdout.splitlines()) > 5
        assert "No space left" in run.stderr


@pytest.mark.thorough
def test_what_is_written_is_readable_under_a_link(eivor: Caller, log: Path, tmp_path: Path) -> None:
    """A link stays a link, and the permissions of an earlier file stay."""
    target = tmp_path / "target.json"
    target.write_text("old", encoding="utf-8")
    target.chmod(0o600)
    (tmp_path / "link.json").symlink_to(target)
    assert eivor("inspect", log, "--json", tmp_path / "link.json").code == 0
    assert (tmp_path / "link.json").is_symlink()
    assert json.loads(target.read_text(encoding="utf-8"))["schema"] == "eivor.inspect/1"
    assert target.stat().st_mode & 0o777 == 0o600
