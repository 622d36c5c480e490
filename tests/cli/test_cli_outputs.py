"""What a command writes: over nothing that it reads, whole or not at all, and never before it has printed."""

from __future__ import annotations

import inspect
import json
import os
import subprocess
import sys
from fnmatch import fnmatch
from functools import partial
from itertools import combinations, cycle
from pathlib import Path
from typing import get_args

import pytest
import typer

from eivor.cli import outputs
from eivor.cli.main import app
from eivor.errors import InputError

pytestmark = pytest.mark.usefixtures("coarse_search")

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
kind = "white"
"""

#: Parameters with a text that names no file. Every other text declares which files it names.
WORDS = frozenset(
    (
        *("--window", "--axis", "--reference", "--input", "--input-map", "--instruments", "--model"),
        *("--method", "--lag", "--order", "--parameter", "--pool-friction", "--term", "--noise", "--for"),
        *("--accept", "--like", "--height", "--shape", "--home", "--to", "--mass", "--prior", "--dask"),
        *("--readings", "--limit", "--vehicle-from", "[WHAT]", "NAME"),
    )
)
#: What the installation of completions brings.
COMPLETION = frozenset({"install_completion", "show_completion"})


def commands():
    """Every command and group, by the words that name it."""

    def below(words, command):
        yield words, command
        for name, part in getattr(command, "commands", {}).items():
            yield from below((*words, name), part)

    return dict(below((), typer.main.get_command(app)))


COMMANDS = commands()


def named(words, kind):
    """Parameters of a command that declare one kind of file."""
    positions = outputs.declarations(COMMANDS[words])
    return [param for param in COMMANDS[words].params if isinstance(positions.get(param.name), kind)]


def label(parameter):
    is_argument = parameter.param_type_name == "argument"
    return str(parameter.metavar) if is_argument else str(max(parameter.opts, key=len))


#: Names that one file may have; the pairs take them in turn.
ALIASES = cycle(("itself", "dots", "symbolic link", "hard link"))
PAIRS = [
    pytest.param(words, source, output, alias, id=f"{' '.join(words)} {label(source)} {label(output)}")
    for words in COMMANDS
    for source in (*named(words, outputs.Reads), *named((), outputs.Reads))
    for output, alias in zip(named(words, outputs.Writes), ALIASES, strict=False)
]
OUTPUTS = [
    pytest.param(words, *pair, id=f"{' '.join(words)} {label(pair[0])} {label(pair[1])}")
    for words in COMMANDS
    for pair in combinations(named(words, outputs.Writes), 2)
]


def position_of(words, parameter):
    return {**outputs.declarations(COMMANDS[()]), **outputs.declarations(COMMANDS[words])}[parameter.name]


def called(words, given, folder):
    """Arguments of a command with some parameters; other required ones have files of their own."""
    before: list[str] = []
    after: list[str] = []
    for parameter in (*COMMANDS[()].params, *COMMANDS[words].params):
        text = given.get(parameter.name, (None, ""))[1]
        if not text and parameter.required:
            other = folder / f"other-{parameter.name}"
            if parameter.name == "out":
                text = f"{other}.csv"
            else:
                other.touch()
                text = str(other)
        if text and parameter.param_type_name == "argument":
            after.append(text)
        elif text:
            (before if parameter.name == "config" else after).extend((parameter.opts[-1], text))
    return [*before, *words, *after]


def contents(folder):
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_every_text_of_a_command_declares_its_files():
    """A new option fails here until it declares `Reads` or `Writes`, or stands in `WORDS`."""
    unguarded = []
    for words, command in COMMANDS.items():
        guards_outputs = isinstance(command, outputs.ReadableCommand)
        assert hasattr(command, "commands") or guards_outputs
        positions = outputs.declarations(command)
        known = inspect.signature(command.callback, eval_str=True).parameters if command.callback else {}
        for parameter in command.params:
            if parameter.name in COMPLETION:
                continue
            kind = known[parameter.name].annotation
            kinds = str(get_args(kind)[0] if hasattr(kind, "__metadata__") else kind)
            is_text = any(word in kinds for word in ("str", "Path"))
            if is_text and parameter.name not in positions and label(parameter) not in WORDS:
                unguarded.append((*words, label(parameter)))
    assert unguarded == []
    assert len(PAIRS) > 40


@pytest.mark.parametrize(("words", "source", "output", "alias"), PAIRS)
def test_no_output_replaces_an_input(eivor, tmp_path, monkeypatch, words, source, output, alias):
    reads, writes = position_of(words, source), position_of(words, output)
    assert isinstance(reads, outputs.Reads)
    assert isinstance(writes, outputs.Writes)
    (tmp_path / "sub").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    inside = Path(writes.patterns[0].replace("*", "0")) if writes.patterns else Path()
    target = tmp_path / "target.toml" / inside
    read = tmp_path / "read"
    if reads.paths is outputs.fleet_paths:
        read = read / "flights" / "part-0.parquet"
    if alias in ("itself", "dots") and reads.paths is outputs.fleet_paths:
        target = read
    elif alias in ("itself", "dots"):
        read = target
    for path in (read, target):
        path.parent.mkdir(parents=True, exist_ok=True)
    read.touch()
    if alias == "symbolic link":
        target.symlink_to(read)
    elif alias == "hard link":
        os.link(read, target)
    typed = "read" if reads.paths is outputs.fleet_paths else os.path.relpath(read)
    where = target.parents[len(inside.parts) - 1] if inside.parts else target
    written = f"sub/../{where.relative_to(tmp_path)}" if alias == "dots" else str(where)
    given = {source.name: (source, typed), output.name: (output, written)}
    arguments = called(words, given, tmp_path)
    before = contents(tmp_path)
    run = eivor(*arguments)
    assert (run.code, run.out) == (2, ""), run.err
    assert "which would replace" in run.err
    assert label(output).strip("[]") in run.err
    assert label(source).strip("[]") in run.err
    assert contents(tmp_path) == before


@pytest.mark.parametrize(("words", "first", "second"), OUTPUTS)
def test_two_outputs_are_two_files(eivor, tmp_path, monkeypatch, words, first, second):
    (tmp_path / "sub").mkdir()
    monkeypatch.chdir(tmp_path)
    folders = [item for item in (first, second) if position_of(words, item).patterns]  # type: ignore[union-attr]
    inside = position_of(words, folders[0]).patterns[0].replace("*", "0") if folders else ""  # type: ignore[union-attr]
    for text in ("target.x", "sub/../target.x", "TARGET.X", str(tmp_path / "target.x")):
        texts = {
            item.name: (item, "target.x" if item in folders else f"{text}/{inside}".rstrip("/"))
            for item in (first, second)
        }
        if not folders:
            texts[first.name] = (first, "target.x")
        arguments = called(words, texts, tmp_path)
        before = contents(tmp_path)
        run = eivor(*arguments)
        assert (run.code, run.out) == (2, ""), run.err
        assert f"different files for {label(first)} and {label(second)}" in run.err
        assert contents(tmp_path) == before


def test_devices_and_streams_are_no_files(eivor, log):
    run = eivor("inspect", log, "--json", "/dev/null")
    assert run.code == 0
    run = eivor("identify", log, "--json", "-", "--html", "-")
    assert "different files for --json and --html" in run.err
    assert eivor("identify", log, "--json", "/dev/null", "--html", "/dev/null").code in (0, 3)


def test_windows_and_folders_are_read(eivor, log, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "would replace" in eivor("inspect", f"{log}@1:9", "--json", log).err
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_text("x", encoding="utf-8")
    run = eivor("track", "bag", "--json", bag / "metadata.yaml")
    assert "would replace 'bag/metadata.yaml' of LOG" in run.err
    fleet = tmp_path / "fleet" / "reports"
    fleet.mkdir(parents=True)
    log.rename(fleet / "flight.html")
    (tmp_path / "logs.txt").write_text("fleet/reports/flight.html", encoding="utf-8")
    run = eivor("fleet", "run", "logs.txt", "--out", "fleet")
    assert (run.code, run.out) == (2, "")
    assert "would replace 'fleet/reports/flight.html' of the logs of logs.txt" in run.err


def test_the_files_of_folders_are_those_that_are_written(tmp_path):
    from eivor.fleet.table import COLUMNS, FLIGHTS, IDENTITY, PART, PENDING, RUN, UNOPENED, report_path
    from eivor.lab.figures import figure_files
    from eivor.lab.study import IDENTITY_FILE, TABLE_FILE

    fleet = {IDENTITY, RUN, COLUMNS, f"{FLIGHTS}/{PART}", f"{FLIGHTS}/{UNOPENED}", f"{PENDING}/{PART}"}
    fleet.add(report_path(Path(), "0").as_posix())
    study = {IDENTITY_FILE, TABLE_FILE, "shards/000000.parquet"}
    study.update(map(str, figure_files(Path(), "nrmse", "coverage")))
    for names, patterns in (
        (fleet, (*outputs.FLEET_FILES, *outputs.FLEET_PARTS)),
        (study, outputs.STUDY_FILES),
        (set(map(str, figure_files(Path()))), outputs.PAPER_FILES),
    ):
        assert not [name for name in names if not any(fnmatch(name, pattern) for pattern in patterns)]


def test_a_figure_has_a_format(tmp_path):
    assert outputs.figure_file(str(tmp_path / "x.PNG")) == tmp_path / "x.PNG"


def test_the_system_s_refusal_to_write_is_told(tmp_path):
    with pytest.raises(InputError, match="No space left"), outputs.writing(tmp_path / "x"):
        raise OSError(28, "No space left on device")


def test_every_part_is_delivered_whatever_happens_to_others(capsys):
    done: list[int] = []

    def refused(number):
        done.append(number)
        raise InputError("a file", f"number {number}", "Choose another.")

    parts = partial(done.append, 0), partial(refused, 1), partial(refused, 2), partial(done.append, 3)
    with pytest.raises(InputError, match="number 1"):
        outputs.deliver(*parts)
    assert done == [0, 1, 2, 3]
    assert capsys.readouterr().err == "eivor: Expected a file; received number 2. Choose another.\n"


@pytest.fixture
def study(tmp_path, monkeypatch):
    """A study that names a scenario."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "study.toml").write_text(STUDY, encoding="utf-8")
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    return tmp_path / "study.toml"


def test_study_keeps_every_file_that_it_names(eivor, study):
    sources = [study, study.with_name("scene.toml")]
    before = [source.read_bytes() for source in sources]
    for source in sources:
        run = eivor("study", study, "--workers", 1, "--json", source)
        assert (run.code, run.out) == (2, "")
        assert f"'{source}', which would replace" in run.err
    assert [source.read_bytes() for source in sources] == before
    assert not Path("study-study").exists()


@pytest.mark.thorough
def test_study_keeps_its_trials(eivor, study):
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
    assert "'study.json', which would replace 'study.json' of STUDY.toml" in run.err
    assert Path("study.json").read_text(encoding="utf-8") == text


def test_simulate_keeps_every_file_that_it_names(eivor, study):
    source = study.with_name("scene.toml")
    before = source.read_bytes()
    run = eivor("simulate", "scene.toml", "-o", "log.parquet", "--truth", source)
    assert (run.code, run.out) == (2, "")
    assert f"'{source}', which would replace 'scene.toml' of " in run.err
    assert source.read_bytes() == before
    assert not Path("log.parquet").exists()


def limited(*arguments, bytes_, folder):
    """Run with a limit on the size of files, as a full disk would have it."""
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        # compiled modules are files as well, and cut short they would stay behind
        "sys.dont_write_bytecode = True;"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({bytes_}, resource.RLIM_INFINITY));"
        "from eivor.cli.main import run; run()"
    )
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False, cwd=folder
    )


@pytest.mark.thorough
def test_a_file_that_does_not_fit_leaves_the_earlier_one_and_the_numbers(tmp_path):
    """The earlier JSON and figure stay whole, nothing is left beside them, and the table is printed."""
    for name in ("fit.json", "fit.svg"):
        (tmp_path / name).write_text("good\n", encoding="utf-8")
    options = ("--json", "fit.json", "--figure", "fit.svg")
    run = limited("identify", "--example", *options, bytes_=1024, folder=tmp_path)
    assert run.returncode == 1
    assert "viscous friction" in run.stdout
    assert run.stderr.count("Expected a file that can be written") == 2
    assert "Traceback" not in run.stderr
    left = {path.name: path.read_text() for path in tmp_path.iterdir() if path.is_file()}
    assert left == dict.fromkeys(("fit.json", "fit.svg"), "good\n")


@pytest.mark.thorough
def test_files_are_written_when_nobody_reads_the_report(tmp_path):
    command = f"{sys.executable} -c 'from eivor.cli.main import run; run()' inspect --example --json x.json"
    run = subprocess.run(  # noqa: S602 - a pipe is the point
        f"{command} | exec >&-", shell=True, capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert run.stderr == ""
    assert json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))["schema"] == "eivor.inspect/1"


@pytest.mark.thorough
def test_what_is_written_is_readable_under_a_link(eivor, log, tmp_path):
    """A link stays a link, and the permissions of an earlier file stay."""
    target = tmp_path / "target.json"
    target.write_text("old", encoding="utf-8")
    target.chmod(0o600)
    (tmp_path / "link.json").symlink_to(target)
    assert eivor("inspect", log, "--json", tmp_path / "link.json").code == 0
    assert (tmp_path / "link.json").is_symlink()
    assert json.loads(target.read_text(encoding="utf-8"))["schema"] == "eivor.inspect/1"
    assert target.stat().st_mode & 0o777 == 0o600
