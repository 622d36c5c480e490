"""Count what the package is built of: files, functions, names, imports, and what a run enters.

    python -m validation.house [--package FOLDER] [--no-walks] [--page docs/architecture.md]

prints the table of `docs/architecture.md`: the counts of a checkout beside those before the redesign. The
walks run public doors under `sys.setprofile`, each in a process of its own; that of a PX4 log needs the
recordings (EIVOR_DATA, or ../shared/data).
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import os
import re
import statistics
import subprocess
import sys
import tokenize
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from validation.pages import markdown, page_with

ROOT = Path(__file__).resolve().parents[1]
FUNCTIONS = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda
#: Lines from which a file is large, and below which it is small.
LARGE, SMALL = 900, 60
#: Rooms that a single flight does not need.
LEAF_ROOMS = frozenset({"lab", "fleet", "serve"})


@dataclass(frozen=True)
class Module:
    name: str  # As it is imported
    text: str  # Its source
    tree: ast.Module  # Its syntax
    path: Path  # Where it stands

    @property
    def lines(self) -> int:
        return self.text.count("\n")

    @property
    def is_package(self) -> bool:
        return self.path.name == "__init__.py"


def modules(package: Path) -> list[Module]:
    results = []
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package.parent).with_suffix("").parts
        name = ".".join(parts).removesuffix(".__init__")
        text = path.read_text(encoding="utf-8")
        results.append(Module(name, text, ast.parse(text), path))
    return results


def imports(module: Module, known: set[str], nodes: Iterable[ast.AST] | None = None) -> list[set[str]]:
    """Modules of the package that each import statement of a module names."""
    results = []
    for node in ast.walk(module.tree) if nodes is None else nodes:
        if isinstance(node, ast.Import):
            results.append({alias.name for alias in node.names} & known)
        elif isinstance(node, ast.ImportFrom):
            results.append(_imported_from(node, module, known) & known)
    return [names for names in results if names]


def in_functions(module: Module) -> list[ast.AST]:
    functions = [node for node in ast.walk(module.tree) if isinstance(node, FUNCTIONS)]
    return list({id(node): node for function in functions for node in ast.walk(function)}.values())


def _imported_from(node: ast.ImportFrom, module: Module, known: set[str]) -> set[str]:
    """Modules that `from M import n` names: M.n where it is a module, else M."""
    base = node.module or ""
    if node.level:
        package = module.name.split(".")[: None if module.is_package else -1]
        base = ".".join([*package[: len(package) - node.level + 1], *([base] if base else [])])
    members = (f"{base}.{alias.name}" for alias in node.names)
    return {member if member in known else base for member in members}


def import_graph(result: list[Module], *, at_start: bool = False) -> dict[str, set[str]]:
    """The modules that each module imports, itself left out."""
    known = {module.name for module in result}
    graph = {}
    for module in result:
        named = imports(module, known, module.tree.body if at_start else None)
        graph[module.name] = set().union(*named) - {module.name}
    return graph


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Circles of imports: strongly connected sets of at least two modules, largest first."""
    names = list(graph)
    edges = [(names.index(name), names.index(other)) for name in names for other in graph[name]]
    rows, columns = np.array(edges or [(0, 0)]).T
    shape = (len(names), len(names))
    _, label = connected_components(
        coo_array((np.ones(rows.size), (rows, columns)), shape), connection="strong"
    )
    parts = [[names[j] for j in np.flatnonzero(label == part)] for part in np.unique(label)]
    return sorted((part for part in parts if len(part) > 1), key=len, reverse=True)


def code_lines(module: Module) -> int:
    """Lines with code that are no docstring and no import."""
    ignored = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT}
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(module.text).readline):
        if token.type not in ignored and token.type != tokenize.ENDMARKER:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(module.tree):
        if isinstance(node, ast.stmt) and (isinstance(node, ast.Import | ast.ImportFrom) or _is_text(node)):
            lines.difference_update(range(node.lineno, (node.end_lineno or 0) + 1))
    return len(lines)


def _is_text(node: ast.stmt) -> bool:
    """Whether a statement is a text alone: a docstring, also of an attribute."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def motion_members(result: list[Module]) -> int:
    """Members of the protocol of motions: the largest class that is named Motion."""
    members = [0]
    for module in result:
        for motion in module.tree.body:
            if isinstance(motion, ast.ClassDef) and motion.name == "Motion":
                names = {
                    target.id
                    for item in motion.body
                    for target in getattr(item, "targets", [getattr(item, "target", None)])
                    if isinstance(target, ast.Name)
                }
                methods = [item for item in motion.body if isinstance(item, ast.FunctionDef)]
                members.append(len(names.union(method.name for method in methods)))
    return max(members)


def architecture(package: Path) -> dict[str, int]:
    result = modules(package)
    known = {module.name for module in result}
    knots = circles(import_graph(result))
    folders = Counter(module.path.parent for module in result)
    words = (re.findall(r"\b(?:told|tells)\b", module.text, re.IGNORECASE) for module in result)
    plain = [module for module in result if not module.is_package]
    library = [module for module in result if not LEAF_ROOMS & set(module.name.split("."))]
    return {
        "files": len(result),
        "lines": sum(module.lines for module in result),
        "files of the library": len(library),
        "lines of the library": sum(module.lines for module in library),
        "lines of code without docstrings and imports": sum(map(code_lines, result)),
        "circles of imports": len(knots),
        "files in circles of imports": sum(map(len, knots)),
        "files in the largest circle": max(map(len, knots), default=0),
        "imports of the package inside functions": sum(
            len(imports(module, known, in_functions(module))) for module in result
        ),
        "imports of the package for type checking only": sum(
            len(imports(module, known))
            - len(imports(module, known, module.tree.body))
            - len(imports(module, known, in_functions(module)))
            for module in result
        ),
        f"files of fewer than {SMALL} lines": sum(module.lines < SMALL for module in plain),
        f"files of more than {LARGE} lines": sum(module.lines > LARGE for module in plain),
        "files in the largest folder": max(folders.values()),
        "the words told and tells": sum(map(len, words)),
        "members of the protocol of motions": motion_members(result),
    }


#: Modules that are public doors, beside the public names of `eivor`; the last one is the command line.
PUBLIC_MODULES = frozenset({"eivor", "eivor.methods", "eivor.errors", "eivor.cli.main"})


def by_public_doors(tree: ast.Module, public: set[str]) -> bool:
    """Whether a module imports nothing of the package but public names."""
    named = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            named |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module == "eivor":
            named |= {f"eivor.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            named.add(node.module)
    return {name for name in named if name.startswith("eivor.")} <= PUBLIC_MODULES | public


def rover(root: Path) -> tuple[int, int]:
    """Lines of the own motion of the examples, and names of the package that it imports."""
    texts = [path.read_text(encoding="utf-8") for path in (root / "examples/motions/rover/src").rglob("*.py")]
    names = {
        alias.name
        for text in texts
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "eivor"
        for alias in node.names
    }
    return sum(text.count("\n") for text in texts), len(names)


#: Pages whose text is made when the documentation is built.
GENERATED_PAGES = frozenset({"api.md", "changelog.md", "cli.md"})


def words(page: str) -> int:
    """Words of a page without its tables."""
    return sum(len(line.split()) for line in page.splitlines() if not line.startswith("|"))


def project(root: Path) -> dict[str, int]:
    """Counts of tests, studies and pages of a checkout."""
    import eivor

    public = {f"eivor.{name}" for name in dir(eivor)}
    tests = [path.read_text(encoding="utf-8") for path in sorted((root / "tests").rglob("*.py"))]
    studies = (path.read_text(encoding="utf-8") for path in (root / "validation").rglob("*.py"))
    pages = [path for path in (root / "docs").rglob("*.md") if path.name not in GENERATED_PAGES]
    return {
        "files of tests": len(tests),
        "lines of tests": sum(text.count("\n") for text in tests),
        "files of tests by internal doors": sum(
            not by_public_doors(ast.parse(text), public) for text in tests
        ),
        "lines of `validation/`": sum(text.count("\n") for text in studies),
        "pages of `docs/`": len(pages),
        "words of `docs/`": sum(words(path.read_text(encoding="utf-8")) for path in pages),
    }


def spread(numbers: list[int]) -> str:
    """Median, 90th percentile and largest of some numbers."""
    ordered = sorted(numbers)
    return f"{statistics.median(ordered):.0f} / {ordered[int(0.9 * len(ordered))]} / {ordered[-1]}"


@dataclass
class Walk:
    """What a run enters: functions and files of the package, depth of their calls, types that are made."""

    package: str
    functions: set[tuple[str, str, int]]
    types: set[str]
    deepest: int = 0
    depth: int = 0

    def profile(self, frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_name in {"__init__", "__new__", "__post_init__"} and code.co_argcount:
            made = frame.f_locals[code.co_varnames[0]]
            made = made if isinstance(made, type) else type(made)
            if made.__module__.partition(".")[0] == "eivor":
                self.types.add(f"{made.__module__}.{made.__qualname__}")
        if not code.co_filename.startswith(self.package) or code.co_name.startswith("<"):
            return  # of others, or a module, comprehension or lambda
        if event == "call":
            self.depth += 1
            self.deepest = max(self.deepest, self.depth)
            self.functions.add((code.co_filename, code.co_name, code.co_firstlineno))
            self._count_structs(frame)
        elif event == "return":
            self.depth -= 1

    def _count_structs(self, frame: FrameType) -> None:
        """Count arguments that are structs of msgspec: they are made without a function of Python."""
        struct = getattr(sys.modules.get("msgspec"), "Struct", ())
        for value in frame.f_locals.values():
            if isinstance(value, struct) and type(value).__module__.partition(".")[0] == "eivor":
                self.types.add(f"{type(value).__module__}.{type(value).__qualname__}")


def from_arrays() -> None:
    import eivor as ev

    rng = np.random.default_rng(1)
    instruments = rng.normal(size=(500, 3))
    regressors = instruments[:, :2] + 0.1 * rng.normal(size=(500, 2))
    problem = ev.regression(
        response=regressors @ [1.0, 2.0] + rng.normal(size=500),
        regressors=regressors,
        instruments=instruments,
        noise_covariance=np.zeros((3, 3)),
        instrument_noise_covariance=np.zeros((3, 3)),
    )
    _ = ev.identify(problem, ev.methods.extended_iv()).covariance


def px4_log() -> Path:
    data = Path(os.environ.get("EIVOR_DATA") or ROOT.parent / "shared" / "data")
    return data / "px4" / "ekf_failure.ulg"


def from_example() -> None:
    import eivor as ev

    ev.identify_flight(ev.example_flight(), model="vertical").to_json()


def from_px4_log() -> None:
    import eivor as ev

    ev.identify_flight(ev.read_log(px4_log()), model="vertical").to_json()


WALKS: dict[str, Callable[[], None]] = {
    "arrays": from_arrays,
    "example": from_example,
    "px4": from_px4_log,
}


def walk(name: str, package: Path) -> dict[str, int]:
    """What a run enters, the second time: what is imported late is imported by then."""
    run = WALKS[name]
    run()
    taken = Walk(str(package), set(), set())
    sys.setprofile(taken.profile)
    try:
        run()
    finally:
        sys.setprofile(None)
    files = {file for file, _, _ in taken.functions}
    numbers = {"functions": len(taken.functions), "files": len(files), "depth": taken.deepest}
    return numbers | {"types": len(taken.types)}


def walks(package: Path) -> Iterator[dict[str, int]]:
    """What each run enters, in a process of its own that imports this package; nothing without its log."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(package.parent), str(ROOT)])}
    for name in WALKS:
        if name == "px4" and not px4_log().exists():
            yield {}
            continue
        command = [sys.executable, "-m", "validation.house", "--package", str(package), "--walk", name]
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
        yield json.loads(done.stdout)


BEFORE: Mapping[str, str] = {
    "files / lines": "732 / 92.1k",
    "without `lab`, `fleet` and `serve`: files / lines": "659 / 82.0k",
    "lines of code without docstrings and imports": "47.1k",
    "lines of a file: median / p90 / max": "106 / - / 461",
    "circles of imports / files in them / in the largest": "6 / 125 / 105",
    "imports of Eivor inside functions / for type checking only": "214 / 119",
    "files of fewer than 60 lines / of more than 900 / in the largest folder": "145 / 0 / 52",
    "members of `Motion`": "60",
    "own motion of the rover: lines / names imported": "353 / 39",
    "walk from arrays to a covariance: functions / files / depth / types": "101 / 29 / 11 / 24",
    "walk from the example flight to JSON": "805 / 159 / 29 / 118",
    "walk from a PX4 log to JSON": "868 / 163 / 29 / 120",
    "tests: files / lines / files that use internal doors": "358 / 51.8k / 303",
    "lines of `validation/`": "10.7k",
    "pages / words of `docs/` without tables and generated pages": "43 / 52.8k",
}
PART = "counts"


def table(package: Path, walked: Iterable[Mapping[str, int]]) -> str:
    """Rows of `BEFORE` with the counts of today."""
    result = modules(package)
    a, p = architecture(package), project(package.parents[1])

    def each(counted: Mapping[str, int], *names: str) -> str:
        return " / ".join(_thousands(counted[name]) for name in names)

    now = [
        each(a, "files", "lines"),
        each(a, "files of the library", "lines of the library"),
        each(a, "lines of code without docstrings and imports"),
        spread([module.lines for module in result]),
        each(a, "circles of imports", "files in circles of imports", "files in the largest circle"),
        each(a, "imports of the package inside functions", "imports of the package for type checking only"),
        each(
            a,
            f"files of fewer than {SMALL} lines",
            f"files of more than {LARGE} lines",
            "files in the largest folder",
        ),
        each(a, "members of the protocol of motions"),
        " / ".join(map(str, rover(package.parents[1]))),
        *(" / ".join(map(str, numbers.values())) for numbers in walked),
        each(p, "files of tests", "lines of tests", "files of tests by internal doors"),
        each(p, "lines of `validation/`"),
        each(p, "pages of `docs/`", "words of `docs/`"),
    ]
    rows = [(name, before, value) for (name, before), value in zip(BEFORE.items(), now, strict=True)]
    return markdown(("", "before the redesign", "now"), rows)


def _thousands(number: int) -> str:
    return f"{number / 1000:.1f}k" if number >= 10_000 else f"{number}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--package", type=Path, default=ROOT / "src" / "eivor")
    parser.add_argument("--no-walks", action="store_true", help="count only, run nothing")
    parser.add_argument("--page", type=Path, metavar="FILE.md", help="put the table between the page's marks")
    parser.add_argument("--walk", choices=WALKS, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    package = chosen.package.resolve()
    if chosen.walk:
        print(json.dumps(walk(chosen.walk, package)))
        return
    result = table(package, [{}] * len(WALKS) if chosen.no_walks else walks(package))
    if chosen.page:
        page = page_with(chosen.page.read_text(encoding="utf-8"), {PART: result})
        chosen.page.write_text(page, encoding="utf-8")
    print(result)


if __name__ == "__main__":
    main()
