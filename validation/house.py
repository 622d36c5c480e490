"""Count what the house is built of: files, functions, names, and who imports whom.

    python -m validation.house [--package FOLDER]

The counts of another checkout are those of its `src/eivor`. `docs/architecture.md` shows them beside those of
the version that the plan of the house was drawn from.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import statistics
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: Rooms that must not know a parameter of a motion, and what they must not know.
GENERAL_ROOMS = ("flights", "report", "cli", "estimation", "inference")
DELETED = re.compile(r"^ +del [a-z_, ]+$", re.MULTILINE)
A_PARAMETER = re.compile(r"viscous_friction|input_gain|hover_input")


@dataclass(frozen=True)
class Module:
    """One file.

    Parameters
    ----------
    name : str
        As it is imported.
    text : str
        Its source.
    tree : ast.Module
        Its syntax.
    """

    name: str
    text: str
    tree: ast.Module

    @property
    def lines(self) -> int:
        """Lines of the file."""
        return self.text.count("\n")


def modules(package: Path) -> list[Module]:
    """Every module of a package."""
    found = []
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package.parent).with_suffix("").parts
        name = ".".join(parts).removesuffix(".__init__")
        text = path.read_text(encoding="utf-8")
        found.append(Module(name, text, ast.parse(text)))
    return found


def function_lengths(tree: ast.Module) -> Iterator[int]:
    """Lines of every function without its docstring."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node) is not None else node.body
            yield (node.end_lineno or 0) - body[0].lineno + 1 if body else 0


def prose_lines(module: Module) -> tuple[int, int]:
    """Lines of docstrings, and lines with a comment."""
    docstrings = 0
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                docstrings += (first.end_lineno or 0) - first.lineno + 1
    tokens = tokenize.generate_tokens(io.StringIO(module.text).readline)
    return docstrings, sum(token.type == tokenize.COMMENT for token in tokens)


def public_names(tree: ast.Module) -> Iterator[str]:
    """Classes, functions and constants of a module that have no underscore."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            names = [node.name]
        elif isinstance(node, ast.Assign):
            names = [target.id for target in node.targets if isinstance(target, ast.Name)]
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names = [node.target.id]
        else:
            continue
        yield from (name for name in names if not name.startswith("_"))


def imports(module: Module, known: set[str], *, at_start: bool = False) -> set[str]:
    """Modules of the package that a module imports; only those at its start, when it is loaded."""
    nodes = module.tree.body if at_start else list(ast.walk(module.tree))
    found: set[str] = set()
    for node in nodes:
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.update(f"{node.module}.{alias.name}" for alias in node.names)
            found.add(node.module)
    return {name for name in found if name in known and name != module.name}


def circles(graph: dict[str, set[str]]) -> int:
    """Modules that import themselves by way of others."""

    def reached(start: str) -> set[str]:
        seen: set[str] = set()
        waiting = list(graph[start])
        while waiting:
            name = waiting.pop()
            if name not in seen:
                seen.add(name)
                waiting.extend(graph[name])
        return seen

    return sum(name in reached(name) for name in graph)


def only_forwards(tree: ast.Module) -> bool:
    """Whether a module has imports and a docstring only."""
    kept = [node for node in tree.body if not isinstance(node, ast.Import | ast.ImportFrom)]
    return len(kept) <= 1 and any(isinstance(node, ast.ImportFrom) for node in tree.body)


def counts(package: Path) -> dict[str, str]:
    """Every count, in words."""
    found = modules(package)
    known = {module.name for module in found}
    plain = [module for module in found if not module.name.endswith(package.name)]
    lengths = sorted(length for module in found for length in function_lengths(module.tree))
    total = sum(module.lines for module in found)
    docstrings, comments = (sum(part) for part in zip(*map(prose_lines, found), strict=True))
    graph = {module.name: imports(module, known) for module in found}
    loaded = {m.name: imports(m, known - {package.name}, at_start=True) for m in found}
    importers = Counter(name for imported in graph.values() for name in imported)
    files = [module.lines for module in found]
    rooms = dict.fromkeys(GENERAL_ROOMS, 0)
    for module in found:
        room = module.name.split(".")[1] if module.name.count(".") else ""
        if room in rooms and A_PARAMETER.search(module.text):
            rooms[room] += 1
    return {
        "files / lines": f"{len(found)} / {total / 1000:.1f}k",
        "file median / max": f"{statistics.median(files):.0f} / {max(files)}",
        "function median / p90 / max": f"{statistics.median(lengths):.0f} / "
        f"{lengths[int(0.9 * len(lengths))]} / {lengths[-1]}",
        "docstring / comment share": f"{docstrings / total:.0%} / {comments / total:.1%}",
        "public top-level names": f"{sum(len(list(public_names(module.tree))) for module in found)}",
        "modules that one other imports": f"{sum(importers[m.name] == 1 for m in plain)}",
        "modules that only forward": f"{sum(only_forwards(module.tree) for module in plain)}",
        "modules in circles of imports when they are loaded": f"{circles(loaded)}",
        "files of general rooms that name a parameter of a motion": f"{sum(rooms.values())}",
        "`del argument` lines": f"{sum(len(DELETED.findall(module.text)) for module in found)}",
        "types for sums of products": f"{len(product_types(found))}: {', '.join(product_types(found))}",
    }


def product_types(found: list[Module]) -> list[str]:
    """Classes that hold sums, means or roots of products of rows themselves; views of one do not count."""
    fields = re.compile(r"^    (?:cross|sums|products|root|table|own|moving)\b[^:]*: Float", re.MULTILINE)
    names = []
    for module in found:
        for node in module.tree.body:
            if isinstance(node, ast.ClassDef):
                text = ast.get_source_segment(module.text, node) or ""
                if fields.search(text) and re.search(
                    r"[Mm]oments|[Pp]roducts|Pieces|Blocks|Record", node.name
                ):
                    names.append(node.name)
    return names


def main() -> None:
    """Print the counts as a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--package", type=Path, default=ROOT / "src" / "eivor")
    for name, value in counts(parser.parse_args().package).items():
        print(f"| {name} | {value} |")


if __name__ == "__main__":
    main()
