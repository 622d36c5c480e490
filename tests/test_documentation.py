"""The README and the pages: their examples run, and say what they say."""

from __future__ import annotations

import ast
import importlib
import json
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import eivor
import eivor as ev
from eivor.motions.declaration import machine_of
from eivor.motions.vertical.regression import VerticalFlights, mapped_input
from eivor.strict_toml import toml_table

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(text, language):
    """Fenced blocks of a language, without a list's indentation."""
    match = re.findall(rf"^( *)```{language}\n(.*?)^ *```$", text, flags=re.MULTILINE | re.DOTALL)
    return [re.sub(rf"^{indent}", "", body, flags=re.MULTILINE) for indent, body in match]


@pytest.mark.usefixtures("unchecked_shapes")  # a reader's run checks none
@pytest.mark.parametrize("number", range(len(blocks(README, "python"))))
def test_python_example(number, tmp_path, monkeypatch, capsys):
    """Each block runs on its own; the example flight stands in for the reader's log."""
    monkeypatch.chdir(tmp_path)
    example = resources.files("eivor.data") / "example_flight.parquet"
    shutil.copy(str(example), tmp_path / "flight.ulg")
    scope: dict[str, object] = {}
    exec(compile(blocks(README, "python")[number], f"README.md, block {number + 1}", "exec"), scope)  # noqa: S102
    assert "viscous_friction" in capsys.readouterr().out
    if number == 0:
        assert scope["fit"].verdict.status.value == "identified"
    else:
        claims = re.findall(r"input_gain in \[([\d.]+), ([\d.]+)\]", blocks(README, "python")[number])
        for fit, claim in zip((scope["biased"], scope["fit"]), claims, strict=True):
            assert fit.interval("input_gain") == pytest.approx([float(end) for end in claim], abs=6e-5)
        assert not within(0.021, scope["biased"].interval("input_gain"))
        assert scope["biased"].status.value == "weak"
        assert scope["fit"].status.value == "identified"
        (match,) = re.findall(r"reasons\[0\].sentence  # (.*), \.\.\.", blocks(README, "python")[number])
        assert scope["biased"].reasons[0].sentence.startswith(match)
        truth = {"viscous_friction": 0.293, "input_gain": 0.021}
        code = blocks(README, "python")[number]
        assert all(f"{value} * " in code for value in truth.values())
        assert all(within(value, scope["fit"].interval(name)) for name, value in truth.items())


def within(value, interval):
    return interval[0] <= value <= interval[1]


def numbers(text):
    return [float(word) for word in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", text)]


def test_sample_output_is_what_is_printed():
    """The plain_words are the same; the last digit of a number may differ from machine to machine."""
    run = subprocess.run(
        [sys.executable, "-c", "from eivor.cli.main import run; run()", "identify", "--example"],
        capture_output=True,
        text=True,
        check=True,
        env={"COLUMNS": "80", "PATH": "", "NO_COLOR": "1"},
    )
    block = blocks(README, "text")[0]
    assert max(map(len, block.splitlines())) <= 80
    number = r"-?\d[\d.]*(e-?\d+)?"
    assert re.sub(number, "#", block).split() == re.sub(number, "#", run.stdout).split()
    assert numbers(block) == pytest.approx(numbers(run.stdout), rel=1e-2, abs=2e-3)


def test_channel_maps_in_the_pages_are_valid(tmp_path):
    from eivor.logs.channel_map import load_channel_map

    pages = [page for page in PAGES if page.parent != ROOT / "docs" / "studies"]
    others = (ROOT / "docs" / "rigid-body.md", ROOT / "docs" / "motions.md")
    maps = [
        block
        for page in pages
        if page not in others
        for block in blocks(page.read_text(encoding="utf-8"), "toml")
    ]
    assert len(maps) >= 2
    for block in maps:
        (tmp_path / "map.toml").write_text(block, encoding="utf-8")
        assert load_channel_map(tmp_path / "map.toml").rules


def test_vehicle_files_in_the_pages_are_valid(tmp_path):
    from eivor.motions.rigid_body.vehicle import load_vehicle

    page = (ROOT / "docs" / "rigid-body.md").read_text(encoding="utf-8")
    result = blocks(page, "toml")
    assert result
    for block in result:
        file = tmp_path / "vehicle.toml"
        file.write_text(block, encoding="utf-8")
        assert len(load_vehicle(file).spins) == 4


def test_the_study_in_the_pages_is_valid(tmp_path):
    from eivor.lab.scenario_files import read_study

    page = (ROOT / "docs" / "studies" / "scenarios.md").read_text(encoding="utf-8")
    page = page.partition("## Running a study")[2]
    path = tmp_path / "study.toml"
    path.write_text(blocks(page, "toml")[0], encoding="utf-8")
    assert read_study(path).runs == 200


def test_the_citation_is_of_this_version():
    yaml = pytest.importorskip("yaml")
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    project, wheel = settings["project"], settings["tool"]["hatch"]["build"]["targets"]["wheel"]
    licences = {path for pattern in project["license-files"] for path in ROOT.glob(pattern)}
    assert not licences & {ROOT / folder / "LICENSE" for folder in wheel["exclude"]}
    assert {"cff-version", "message", "title", "authors"} <= set(cited)  # what the format asks for
    assert (cited["version"], cited["license"]) == (project["version"], project["license"])
    assert cited["authors"] == project["authors"]
    (paper,) = cited["references"]
    assert paper["title"] in plain_words((ROOT / "docs" / "paper.md").read_text(encoding="utf-8"))


def plain_words(text):
    """Text in one line, without emphasis."""
    return " ".join(text.replace("*", "").split())


def test_first_command_is_one_line_each():
    """`.ci/run` takes its set-up and its tests from these lines."""
    commands = [line for line in README.splitlines() if line.startswith("python3 -m venv .venv && ")]
    assert [line.rpartition(" && ")[2] for line in commands] == [
        ".venv/bin/eivor identify --example",
        ".venv/bin/python -m pytest",
    ]
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert commands[1] in contributing
    assert commands[0] in (ROOT / "docs" / "getting-started.md").read_text(encoding="utf-8")


def test_links_between_files_lead_somewhere():
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            made = target == "options.schema.json"  # by docs/hooks.py
            assert made or (page.parent / target).exists(), f"{page.name}: {target}"
        named = r"`((?:src|tests|validation|examples|docs|benchmarks)/[\w./-]+)`(?!\s+at revision)"
        assert [
            path for path in re.findall(named, page.read_text("utf-8")) if not (ROOT / path).exists()
        ] == []


def test_every_channel_and_every_unit_is_documented():
    from eivor.signals.channels import BUILT_IN

    page = (ROOT / "docs" / "logs.md").read_text(encoding="utf-8")
    section = page.partition("## Channels")[2].partition("## PX4")[0]
    rows = [line for line in section.splitlines() if line.startswith("| `")]
    for channel in BUILT_IN:
        row = [line for line in rows if f"`{channel.name}`" in line.split("|")[1]]
        assert len(row) == 1, channel
        assert channel.unit in row[0].split("|")[2], channel


DOCS = Path(__file__).parents[1] / "docs"
BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def check_estimators(names):
    assert set(names["fit"].parameters) == {"viscous_friction", "input_gain"}
    assert names["problem"].instrument_noise_covariance()[0, 1] == pytest.approx(0.0025)


def check_from_arrays(names):
    page = (DOCS / "from-arrays.md").read_text(encoding="utf-8")
    displayed = [tuple(map(float, pair)) for pair in re.findall(r"# .*\[([\d.]+), ([\d.]+)\]", page)]
    fits = [names[name] for name in ("biased", "fit", "attenuated", "compensated", "orthogonal")]
    assert [fit.interval("slope") for fit in fits] == [pytest.approx(pair, abs=1e-3) for pair in displayed]


def check_diagnostics(names):
    name = names["diagnostics"]
    assert name.constancy.break_at == pytest.approx(0.6, abs=0.02)
    assert any("input_gain by +0.5" in reason.sentence for reason in name.reasons)
    page = (DOCS / "diagnostics.md").read_text(encoding="utf-8")
    assert all(line in page for line in name.summary().splitlines() if not line.startswith("- "))


def check_method(names):
    low, high = names["hac"].interval("input_gain", level=0.9)
    assert low < names["fit"].parameters["input_gain"] < high
    assert names["chunked"].interval("input_gain") == pytest.approx(names["fit"].interval("input_gain"))
    assert all(interval.is_bounded for interval in names["known"].intervals.values())
    assert not names["unknown"].interval("input_gain").is_bounded
    assert names["sets"].region.contains([0.3, 0.5])
    assert names["boot"].replicates.shape == (199, 2)
    low, high = names["flights"].interval("hover_input")
    assert low < names["pool"].quantities["hover_input"].value < high
    assert [len(names[figure].axes) for figure in ("comparison", "joint", "residual")] == [2, 1, 3]


def check_efficiency(names):
    assert names["spectral"].noises
    assert {"viscous_friction", "input_gain"} <= set(names["undeclared"].parameters)


def check_fractional_equations(names):
    low, high = names["fit"].interval("order")
    assert low < names["fit"].parameters["order"] < high
    assert names["fit"].parameters["order"] == pytest.approx(0.7, abs=0.02)


def check_exports(names):
    assert names["model"].states == ("actuator", "velocity_z")
    assert names["document"].startswith("{")
    assert 0.0005 < names["hover"].std() / names["hover"].mean() < 0.003


def check_motions(names: dict[str, Any]) -> None:
    fit = names["fit"]
    assert fit.verdict.status.value == "identified"
    assert all(within(true, fit.interval(name)) for name, true in {"a": 0.333, "g": 0.2}.items())
    (declared,) = blocks((DOCS / "motions.md").read_text(encoding="utf-8"), "toml")
    cart = machine_of(toml_table(declared, Path("cart.toml"), "a machine"))
    assert {name: cart.quantities[name].unit for name in ("drag", "gain")} == {"drag": "1/s", "gain": "m/s^2"}


#: What the blocks of each page must leave behind.
CHECKS: dict[str, Callable[[dict[str, Any]], None]] = {
    "diagnostics.md": check_diagnostics,
    "efficiency.md": check_efficiency,
    "estimators.md": check_estimators,
    "exports.md": check_exports,
    "fractional-equations.md": check_fractional_equations,
    "from-arrays.md": check_from_arrays,
    "method.md": check_method,
    "motions.md": check_motions,
}


@pytest.mark.filterwarnings("ignore::eivor.errors.WeakInstrumentsWarning")
@pytest.mark.usefixtures("unchecked_shapes")  # a reader's run checks none
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name, marks=[pytest.mark.thorough] if name in {"exports.md", "method.md", "motions.md"} else []
        )
        for name in CHECKS
    ],
)
def test_blocks_run(name):
    blocks = BLOCK.findall((DOCS / name).read_text(encoding="utf-8"))
    assert blocks
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, name, "exec"), names)  # noqa: S102 - the project's own pages
    CHECKS[name](names)


#: Pages whose commands are run elsewhere, with logs of their own or beside what they print.
ELSEWHERE = {"exports.md", "logs.md", "CONTRIBUTING.md"}
#: What pages name and a reader has: copies of a simulated flight with all rotors, and with their mean.
OF_ROTORS = "flight.parquet log15"
OF_THRUST = "flight.ulg other.ulg monday.ulg tuesday.ulg first.ulg second.ulg sweep.bin logs/one.parquet"
#: Pages whose Python is run behind their commands; that of others has checks of its own.
PYTHON_TOO = {"api.md", "getting-started.md", "plan.md", "rates.md", "scenarios.md"}
RIGID = "identify flight.parquet --model rigid-body --vehicle mine.toml --json rigid.json"


def commands_of_pages():
    """Words of the commands of each page; one that writes nothing that others read, once in all."""
    result, seen = {}, []
    for page in PAGES:
        kinds = ("sh",) if page.name == "getting-started.md" else ("sh", "console")
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        lines = [line for kind in kinds for block in blocks(text, kind) for line in block.splitlines()]
        every = [shlex.split(line.removeprefix("$ "), comments=True) for line in lines]
        own = [words[1:] for words in every if words[:1] == ["eivor"]]
        kept = {"run", "--json", "--out"}
        own = [words for words in own if words not in seen or kept & {*words}]
        if page.name not in ELSEWHERE and (own or page.name in PYTHON_TOO):
            result[page] = own
            seen += own
    return result


COMMANDS = commands_of_pages()


@pytest.fixture(scope="module")
def named_files(tmp_path_factory):
    """A folder with the files that the pages name."""
    folder = tmp_path_factory.mktemp("named")
    (folder / "logs").mkdir()
    made = ["simulate", "crazyflie", "--seed", "1", "--out", "log.parquet", "--vehicle", "mine.toml"]
    subprocess.run([sys.executable, "-m", "eivor", *made], cwd=folder, check=True, capture_output=True)
    table = pl.read_parquet(folder / "log.parquet")
    for name in OF_ROTORS.split():
        table.gather_every(2).write_parquet(folder / name)
    for name in OF_THRUST.split():
        table.gather_every(4).drop(pl.selectors.starts_with("rotor_command")).write_parquet(folder / name)
    (folder / "masses.csv").write_text("name,mass\none.parquet,0.03\n", encoding="utf-8")
    turned = np.repeat(np.sign(np.random.default_rng(0).normal(size=100)), 30)
    steered = {"rudder": 0.3 * turned, "reference_heading": turned}
    known = {"a": 0.3, "g": 0.2, "actuator_lag": 0.35, "delay": 0.2}
    boat = ev.load_machine("boat-yaw").simulate(known, steered, seconds=300.0, step_s=0.1)
    pl.DataFrame(boat).write_csv(folder / "boat.csv")
    return folder


def write_what_is_printed(text, folder):
    """Files whose content a page prints, and a record of the machine among them."""
    for line, name in re.findall(r"^printf '(.*)' > (\S+)$", text, re.MULTILINE):
        (folder / name).write_text(line.replace("\\n", "\n"), encoding="utf-8")
    for block in blocks(text, "toml")[:1]:
        (folder / "mine.toml").write_text(block, encoding="utf-8")
        (folder / "cart.toml").write_text(block, encoding="utf-8")
        if "response =" in block:
            machine = machine_of(toml_table(block, folder / "cart.toml", "a machine"))
            steps = np.repeat(np.sign(np.random.default_rng(0).normal(size=60)), 50)
            known = {"drag": 0.5, "friction": 0.1, "gravity": 1.0, "gain": 2.0} | {
                "actuator_lag": 0.05,
                "delay": 0.0,
            }
            inputs = {"motor": steps, "angle": 0.0 * steps, "speed_reference": steps}
            record = pl.DataFrame(machine.simulate(known, inputs, seconds=60.0, step_s=0.02))
            record.write_csv(folder / "cart.csv")


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
@pytest.mark.parametrize("page", COMMANDS, ids=lambda page: page.name)
def test_commands_of_the_pages_run(page, named_files, tmp_path, monkeypatch, command_line):
    shutil.copytree(named_files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    if page.parent.name in {"docs", "studies"} and page.name != "rigid-body.md":
        write_what_is_printed(page.read_text(encoding="utf-8"), tmp_path)
    for words in COMMANDS[page]:
        if words[0] in {"serve", "study", "paper"}:  # it does not end, or others run it smaller
            continue
        if "rigid.json" in words and not Path("rigid.json").exists():
            command_line(*RIGID.split())
        # a vehicle's file is there, with numbers
        ran = command_line(*(words[:2] if words[:2] == ["vehicle", "new"] else words))
        assert ran.code in {0, 3}, (words, ran.err)
    names: dict[str, Any] = {}
    for block in BLOCK.findall(page.read_text(encoding="utf-8")) if page.name in PYTHON_TOO else ():
        exec(compile(block, page.name, "exec"), names)  # noqa: S102 - the project's own page


EVERY = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
STUDIES = re.findall(r"^(?:nice )?python -m (validation.*)$", EVERY, re.MULTILINE)


@pytest.mark.thorough
@pytest.mark.parametrize("module", sorted({line.split()[0] for line in STUDIES}))
def test_studies_have_the_options_that_pages_give_them(module, capsys):
    with pytest.raises(SystemExit):
        importlib.import_module(module).main(["--help"])
    known = capsys.readouterr().out
    for line in STUDIES:
        words = shlex.split(line, comments=True)
        if words[0] == module:
            assert [word for word in words if word.startswith("--") and word not in known] == [], line
            assert all((ROOT / word).exists() for word in words if word.endswith((".toml", ".md"))), line


def cells_run(name, tmp_path, monkeypatch):
    """Names of a notebook after its cells have run."""
    monkeypatch.chdir(tmp_path)
    text = (DOCS.parent / "examples" / "notebooks" / f"{name}.ipynb").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    with warnings.catch_warnings():
        for cell in json.loads(text)["cells"]:
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), name, "exec"), names)  # noqa: S102 - the project's own
    return names


@pytest.mark.usefixtures("unchecked_shapes")
def test_the_notebook_of_arrays_runs(tmp_path, monkeypatch):
    low, high = cells_run("from-arrays", tmp_path, monkeypatch)["fit"].interval("slope")
    assert low < 0.5 < high


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes")
def test_notebooks_of_logs_run(tmp_path, monkeypatch):
    cells_run("from-a-log", tmp_path, monkeypatch)
    assert json.loads(Path("vertical.json").read_text(encoding="utf-8"))
    pytest.importorskip("mujoco")
    assert abs(cells_run("to-a-simulator", tmp_path, monkeypatch)["data"].qpos[:3]).max() < 1e-3


def test_every_option_that_is_named_exists():
    from typer.main import get_command

    from eivor.cli.main import app

    def options(command):
        selected = {option for parameter in command.params for option in parameter.opts}
        return selected.union(*(options(child) for child in getattr(command, "commands", {}).values()))

    pages = [DOCS / name for name in ("from-a-log.md", "getting-started.md", "to-a-simulator.md")]
    text = " ".join(re.sub(r"pip install.*", "", page.read_text(encoding="utf-8")) for page in pages)
    assert set(re.findall(r"(?<![\w-])--[a-z][a-z-]+", text)) <= options(get_command(app))


def long_sentences(text):
    """Sentences of more than 30 words; a link, a formula or a piece of code counts as its words or as one."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"`[^`]*`|\$[^$]*\$", "x", text)
    sentences = re.split(r"(?<=[.!?])[*_)\"]*\s+", text)
    return [one for one in sentences if sum(bool(re.search(r"\w", word)) for word in one.split()) > 30]


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=lambda page: page.name)
def test_sentences_of_the_pages_are_short(page):
    text = re.sub(
        r"```.*?```|<!--.*?-->|\$\$.*?\$\$", "\n\n", page.read_text(encoding="utf-8"), flags=re.DOTALL
    )
    lines = ("" if line.lstrip().startswith(("|", "#", "!", "<")) else line for line in text.splitlines())
    paragraphs = re.split(r"\n\s*\n|\n\s*(?:[*-]|\d+\.) ", "\n".join(lines))
    written = [part for part in paragraphs if not part.lstrip().startswith("Made by `")]
    assert [one for part in written for one in long_sentences(part)] == []


def test_sentences_of_the_help_are_short():
    from typer.main import get_command

    from eivor.cli.main import app

    def texts(command):
        own = [command.help, command.epilog, *(getattr(one, "help", None) for one in command.params)]
        below = [texts(child) for child in getattr(command, "commands", {}).values()]
        return [text for text in own if text] + [text for some in below for text in some]

    parts = [part for text in texts(get_command(app)) for part in re.split(r"\n\s*\n", text)]
    assert len(parts) > 100
    assert [one for part in parts for one in long_sentences(part)] == []


def written(node):
    """A text of the code, with x for what is filled in; None for what is no text."""
    if isinstance(node, ast.JoinedStr):
        return "".join(written(part) or "x" for part in node.values)
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else None


def test_sentences_of_the_messages_are_short():
    """Texts and docstrings of the package, and what an error received beside what it expected."""
    long = []
    for path in (ROOT / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            texts = [written(node)]
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("Error") and len(node.args) > 2:
                parts = [written(part) or "x" for part in node.args[-3:]]
                texts.append(f"Expected {parts[0]}; received {parts[1]}. {parts[2]}")
            paragraphs = (
                part for text in texts if text for part in re.split(r"\n\s*\n|\n.* : .*\n|\n *-+\n", text)
            )
            prose = (part for part in paragraphs if not re.search(r"\n.* = |\nimport", part))
            long += [(path.name, one) for part in prose for one in long_sentences(part)]
    assert long == []


GLOSSARY = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")


def test_every_public_name_is_listed_once():
    public = {name for name in eivor.__all__ if not name.startswith("__")}
    listed = re.findall(r"^\| `(\w+)` \| (?:class|function|module) \|", GLOSSARY, flags=re.MULTILINE)
    assert sorted(listed) == sorted(public), "run python -m docs.public_names"


def test_words_in_code_are_words_of_the_code():
    rows = [
        line.split(" | ") for line in GLOSSARY.partition("## Words")[2].splitlines() if line.startswith("| ")
    ]
    words = {word for row in rows for word in re.findall(r"`(\w+)`", row[1])}
    code = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "src").rglob("*.py"))
    assert len(words) > 30
    assert [word for word in sorted(words) if not re.search(rf"\b{word}\b", code)] == []


def test_every_word_is_explained_once():
    first = re.findall(
        r"^\| ([^|]+) \| [^|]* \| [^|]* \| [^|]* \|$", GLOSSARY.partition("## Words")[2], re.MULTILINE
    )
    terms = [term.strip() for cell in first[2:] for term in cell.split(",")]
    assert len(terms) == len(set(terms))


def words_of(*path):
    return " ".join(ROOT.joinpath(*path).read_text(encoding="utf-8").split())


@pytest.fixture(scope="module")
def example():
    return ev.identify_flight(ev.example_flight())


def fitted(example, lag_s):
    """Friction by least squares of all samples with that lag, and its R squared."""
    assert example.fit is not None
    problem = example.fit.problem
    assert isinstance(problem, VerticalFlights)
    (flight,) = problem.flights
    mapped, force = mapped_input(flight, lag_s=lag_s), flight.signals.channel("specific_force_z")
    rows = np.column_stack([-flight.signals.channel("velocity_z"), mapped, np.ones(mapped.size)])
    theta = np.linalg.lstsq(rows, force, rcond=None)[0]
    return float(theta[0]), 1.0 - float((force - rows @ theta).var() / force.var())


@pytest.mark.thorough
def test_least_squares_without_the_lag_is_negative(example):
    friction, explained = fitted(example, 0.0)
    readme, page = words_of("README.md"), words_of("docs", "method.md")
    share, stated = re.findall(r"explains (\d+) % of the acceleration .* friction of (-[\d.]+) 1/s", readme)[
        0
    ]
    assert (float(share), float(stated)) == pytest.approx((100.0 * explained, friction), rel=0.02)
    stated, share = re.findall(r"friction of (-[\d.]+) 1/s at \$R\^2 = ([\d.]+)\$", page)[0]
    assert (float(stated), float(share)) == pytest.approx((friction, explained), rel=0.02)
    with_lag = re.findall(r"With the lag \$R\^2\$ is ([\d.]+)", page)[0]
    assert float(with_lag) == pytest.approx(fitted(example, 0.072)[1], abs=0.006)


@pytest.mark.thorough
def test_a_wrong_map_shows_in_the_intercept(example):
    wrong = ev.identify_flight(ev.example_flight(), ev.FlightOptions(input_map="power:1.5"))
    stated = re.findall(
        r"`power:1.5` for `square` gives the example flight (-[\d.]+)", words_of("docs", "method.md")
    )[0]
    assert wrong.parameters["intercept"] == pytest.approx(float(stated), abs=0.06)
    assert abs(example.parameters["intercept"]) < 0.1


LOGS = (ROOT / "docs" / "logs.md").read_text(encoding="utf-8")


def test_formats_and_limits_are_named():
    from eivor.logs.common import CELLS_PER_BYTE, MAX_CELLS
    from eivor.logs.read import log_formats, readable_formats

    formats = LOGS.partition("## Formats")[2].partition("## Channels")[0]
    for row in readable_formats():
        assert re.search(rf"^\| .*{row.label}.* \| yes \|", formats, flags=re.MULTILINE), row.label
    unread = {"tlog": ".tlog", "dji": "DJI", "arrow": "Arrow"}
    assert set(unread) <= {row.name for row in log_formats() if not row.is_read}
    assert all(words in formats for words in unread.values())
    assert f"{CELLS_PER_BYTE} needed numbers for each" in " ".join(formats.split())
    assert f"{MAX_CELLS // 1_000_000} million needed numbers" in formats
