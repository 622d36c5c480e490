"""Pages and tables that the documentation takes from the code, so that they cannot differ from it."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable

ROOT = Path(__file__).resolve().parent.parent
KATEX = ROOT / "src" / "eivor" / "report" / "vendored" / "katex"
NOTES = "<!-- towncrier release notes start -->"


def on_config(config: Any) -> Any:
    """Put every study's page into the navigation; a study is a file in docs/studies/."""
    pages = [
        path.relative_to(ROOT / "docs").as_posix()
        for path in sorted((ROOT / "docs" / "studies").glob("*.md"))
    ]
    pages.sort(key=lambda page: page != "studies/index.md")
    for part in config.nav:
        for name, entries in part.items():
            listed = [{"Studies": pages} if entry == {"Studies": "studies"} else entry for entry in entries]
            part[name] = [entry for entry in listed if entry != {"Studies": []}]
    return config


def on_files(files: Any, *, config: Any) -> Any:
    """Put KaTeX, which draws the equations, and the JSON Schema of the options beside the pages."""
    from mkdocs.structure.files import File

    from eivor.cli.options import options_schema

    files.append(
        File.generated(config, "options.schema.json", content=json.dumps(options_schema(), indent=2))
    )

    for path in KATEX.rglob("*"):
        if path.is_file():
            name = (Path("assets") / "katex" / path.relative_to(KATEX)).as_posix()
            files.append(File.generated(config, name, abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Fill in what is generated."""
    source = page.file.src_uri
    if source == "changelog.md":
        return changelog()
    if source == "cli.md":
        return markdown + "\n" + commands()
    return markdown


def table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Markdown table."""
    lines = [list(header)]
    lines += [["---"] * len(lines[0]), *(list(row) for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def code(words: Iterable[str], joint: str = ", ") -> str:
    """Words as inline code."""
    return joint.join(f"`{word}`" for word in words)


def changelog() -> str:
    """CHANGELOG.md with the fragments that no release has yet."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    draft = subprocess.run(
        [sys.executable, "-m", "towncrier", "build", "--draft", "--version", "next"],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    ).stdout
    heading, _, body = draft.partition("\n")
    coming = f"## Not yet released\n{body}" if heading.startswith("## ") and body.strip() else ""
    return text.replace(NOTES, coming)


def commands() -> str:
    """Every command with its arguments and options."""
    import typer

    from eivor.cli.main import app

    root = typer.main.get_command(app)
    return "\n".join(_command(f"eivor {name}", command) for name, command in _leaves(root, ()))


def _leaves(command: Any, path: tuple[str, ...]) -> Iterable[tuple[str, Any]]:
    for name, child in getattr(command, "commands", {}).items():
        if getattr(child, "commands", None):
            yield from _leaves(child, (*path, name))
        elif not child.hidden:
            yield " ".join((*path, name)), child


def _command(name: str, command: Any) -> str:
    rows = []
    for parameter in command.params:
        if getattr(parameter, "hidden", False):
            continue
        if parameter.param_type_name == "argument":
            label = code([parameter.metavar or str(parameter.name).upper()])
        else:
            value = "" if parameter.is_flag else f" {parameter.metavar or parameter.type.name.upper()}"
            label = code(f"{option}{value}" for option in (*parameter.opts, *parameter.secondary_opts))
        default = parameter.default
        displayed = (
            "" if default in (None, "", (), [], False) or callable(default) else f" Default: `{default}`."
        )
        rows.append((label, f"{(parameter.help or '').replace(chr(10), ' ')}{displayed}"))
    text = (command.help or "").replace("\f", "").replace("\b", "")
    listed = table(("argument or option", "meaning"), rows) if rows else ""
    return f"## {name}\n\n{text}\n\n{listed}\n"
