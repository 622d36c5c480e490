"""Compare what two checkouts of Eivor answer.

    python -m validation.parity.compare OLD [NEW] [--exact [--reworded]] [--part NAME]

OLD and NEW are checkouts (NEW by default this one), whose records are made, or records. With --exact every
entry must have the SHA-256 of the old one; --reworded lets sentences and printed text differ. Without --exact
numbers agree as `allowed` says, and all else but sentences exactly. The exit code is 0 when nothing else
differs, else 3.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from validation.parity.record import PARTS, ROOT, SENTENCES, read_record, record_of_checkout

#: Exit code when the records differ.
DIFFERENT = 3
#: What stands for a value that the other record does not have.
NEW, GONE = "(new)", "(gone)"
#: A number, a word, or nothing.
Leaf = float | int | str | bool | None
Leaves = Mapping[tuple[str, ...], Leaf]

RELATIVE = 1e-9
ROUNDING_UNIT = 2.0**-52
#: Of numbers that follow from a search: a share of the standard error, or of the number where it has none.
SEARCHED = 1e-3
#: Of a p-value that follows from a search: far in the tail it changes more than its statistic.
SEARCHED_P_VALUE = 2e-2
#: Parts in which a nuisance is searched for, and keys of documents that do not follow from it.
SEARCHED_PARTS = frozenset({"flights", "rates", "rigid_body", "simulated", "commands", "python"})
NOT_SEARCHED = frozenset({"logs", "window", "rate_hz", "samples", "provenance", "model", "options"})


@dataclass(frozen=True, slots=True)
class Difference:
    """One value that differs: where, and what it was and is."""

    path: str
    old: str
    new: str

    def __str__(self) -> str:
        return f"{self.path}: {self.old} -> {self.new}"


@dataclass
class Comparison:
    """What differs between two records: entries that agree, rewordings, and the rest."""

    equal: int = 0
    reworded: list[Difference] = field(default_factory=list)
    different: list[Difference] = field(default_factory=list)


def leaves(content: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Leaf]]:
    """Every value of nested content with its path; an empty list or object is itself a value."""
    if isinstance(content, Mapping | list) and content:
        pairs = content.items() if isinstance(content, Mapping) else enumerate(content)
        for key, value in pairs:
            yield from leaves(value, (*path, str(key)))
    else:
        yield path, str(content) if isinstance(content, Mapping | list) else content


def compare(
    old: Mapping[str, Any], new: Mapping[str, Any], *, exact: bool = False, reworded: bool = False
) -> Comparison:
    result = Comparison()
    for name in [*old, *(name for name in new if name not in old)]:
        missing = next((word for word, record in ((NEW, old), (GONE, new)) if name not in record), "")
        results: list[tuple[tuple[str, ...], Difference]] = []
        if missing:
            results = [((name,), Difference(name, "entry", missing))]
        elif old[name]["sha256"] != new[name]["sha256"]:
            results = list(differences(name, old[name], new[name], exact=exact))
        result.equal += not results
        for path, difference in results:
            both = not {difference.old, difference.new} & {NEW, GONE}
            may_differ = both and is_sentence(path) and (reworded or not exact)
            (result.reworded if may_differ else result.different).append(difference)
    return result


def differences(
    name: str, old: Mapping[str, Any], new: Mapping[str, Any], *, exact: bool
) -> Iterator[tuple[tuple[str, ...], Difference]]:
    """Values of an entry that differ; with `exact` also a difference that the file's digits do not show."""
    before, after = dict(leaves(old["content"])), dict(leaves(new["content"]))
    numbers_differ = old["sha256_without_sentences"] != new["sha256_without_sentences"]
    displayed = not numbers_differ
    for path in [*before, *(path for path in after if path not in before)]:
        values = [record.get(path, missing) for record, missing in ((before, NEW), (after, GONE))]
        equal = type(values[0]) is type(values[1]) and values[0] == values[1]
        if not exact and not equal and all(map(_is_number, values)):
            off = abs(_number(values[1], signed=True) - _number(values[0], signed=True))
            equal = off <= allowed(name, path, before)
        if not equal:
            displayed = displayed or not is_sentence(path)
            yield path, Difference("/".join((name, *path)), *map(_text, values))
    if exact and not displayed:
        digits = Difference(
            f"{name}/sha256", old["sha256"][:12], f"{new['sha256'][:12]} (in the last digits)"
        )
        yield ("sha256",), digits


def is_sentence(path: tuple[str, ...]) -> bool:
    """Whether a value is a sentence or the hash of a text: its own key, or that of its list, says so."""
    keys = [key for key in path if not key.isdigit()]
    return bool(keys) and keys[-1] in SENTENCES


def _is_number(leaf: Leaf) -> bool:
    return isinstance(leaf, int | float) and not isinstance(leaf, bool)


def _number(leaf: Leaf, *, signed: bool = False) -> float:
    value = float(leaf) if isinstance(leaf, int | float) else 0.0
    return value if signed else abs(value)


def _text(leaf: Leaf) -> str:
    return f"{leaf:.10g}" if isinstance(leaf, float) else str(leaf)


def allowed(name: str, path: tuple[str, ...], old: Leaves) -> float:
    """Largest difference that a number of an entry may have."""
    size = _number(old.get(path))
    if isinstance(old.get(path), int) or not path:
        return 0.0
    if name.partition("/")[0] in SEARCHED_PARTS and name != "python/streamed":
        return _of_search(path, old, size)
    share = RELATIVE
    for depth in range(len(path)):
        share = max(share, ROUNDING_UNIT * _number(old.get((*path[:depth], "condition"))))
    if name.startswith("inference/") and "diagnose" not in path[0] and path[-1] in {"0", "1"}:
        # Of the ends of an interval the larger one.
        size = max(_number(old.get((*path[:-1], end))) for end in ("0", "1"))
    return share * max(size, _standard_error(path, old))


def _standard_error(path: tuple[str, ...], old: Leaves) -> float:
    """Standard error that belongs to a value or an end in a list; zero when there is none."""
    if path[-2:-1] in {("low",), ("high",), ("std_error",)}:
        return _number(old.get((*path[:-2], "std_error", path[-1])))
    if path[-2:-1] == ("values",):
        return _number(old.get((*path[:-2], "covariances", "cosines", "std_error", path[-1])))
    return 0.0


def _of_search(path: tuple[str, ...], old: Leaves, size: float) -> float:
    if "p_value" in path[-1] or ("diagnose" in path and path[-1] == "1"):
        return SEARCHED_P_VALUE * size
    for depth in range(len(path) - 1, 0, -1):  # a quantity of a document, with its own standard error
        number = _number(old.get((*path[:depth], "std_error")))
        if number:
            return SEARCHED * number
    if path[-3:-2] == ("matrix",):  # of a covariance, measured by its diagonal
        row, column = ((*path[:-2], j, j) for j in path[-2:])
        return SEARCHED * (_number(old.get(row)) * _number(old.get(column))) ** 0.5
    if "bootstrap" in path:
        return SEARCHED * _number(old.get((*path[:-1], "0")))
    share = RELATIVE if NOT_SEARCHED & set(path) else SEARCHED
    return share * size or SEARCHED * _standard_error(path, old)


def report(result: Comparison) -> Iterator[str]:
    if result.reworded:
        yield f"Sentences and texts that read differently: {len(result.reworded)}"
        yield from (f"    {difference}" for difference in result.reworded)
    yield from (f"DIFFERENT: {difference}" for difference in result.different)
    yield (
        f"{result.equal} entries agree; {len(result.reworded)} texts read differently, "
        f"{len(result.different)} values differ."
    )


def entries_of(path: Path, parts: Sequence[str]) -> dict[str, Any]:
    """Entries of a record, or of the record that is made of a checkout."""
    if path.is_dir():
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / "new.json"
            record_of_checkout(path, made, parts)
            return entries_of(made, parts)
    entries: dict[str, Any] = read_record(path)["entries"]
    return {name: value for name, value in entries.items() if name.partition("/")[0] in parts}


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m validation.parity.compare",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("old", type=Path, metavar="OLD", help="checkout or record")
    parser.add_argument("new", type=Path, nargs="?", default=ROOT, metavar="NEW", help="checkout or record")
    parser.add_argument("--exact", action="store_true", help="the same bytes, by SHA-256 of the content")
    parser.add_argument("--reworded", action="store_true", help="with --exact: texts may differ")
    parser.add_argument("--part", action="append", choices=PARTS, help="only this part; may be repeated")
    chosen = parser.parse_args(arguments)
    parts = chosen.part or PARTS
    old, new = (entries_of(path, parts) for path in (chosen.old, chosen.new))
    result = compare(old, new, exact=chosen.exact, reworded=chosen.reworded)
    print("\n".join(report(result)))
    return DIFFERENT if result.different else 0


if __name__ == "__main__":
    sys.exit(main())
