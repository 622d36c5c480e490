"""Compare two records of what Eivor says.

    python -m validation.parity.compare OLD.json NEW.json

Verdicts, statuses, exit codes and words are compared exactly, numbers as `tolerance.py` says. Sentences may
be reworded, and keys may be added: both are listed. What a mended defect changes is listed in changed.toml
with the defect and the reason; it is printed, old and new. The exit code is 0 when nothing else differs and
every entry of that list was met, else 3.
"""

from __future__ import annotations

import argparse
import json
import sys
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from validation.parity.tolerance import Leaf, allowed

CHANGED = Path(__file__).with_name("changed.toml")
#: Exit code when the records differ.
DIFFERENT = 3
#: Keys whose values are sentences for people.
SENTENCES = frozenset({"reasons", "message", "findings", "equation", "sentence"})


@dataclass(frozen=True, slots=True)
class Change:
    """A difference that a mended defect makes.

    Parameters
    ----------
    pattern : str
        Path of the record, with * for any run of characters.
    finding : int
        Number of the defect.
    why : str
        What the mend does to these numbers.
    """

    pattern: str
    finding: int
    why: str


@dataclass(frozen=True, slots=True)
class Difference:
    """One entry that differs.

    Parameters
    ----------
    path : str
        Where.
    old, new : str
        What stood and what stands there.
    """

    path: str
    old: str
    new: str

    def __str__(self) -> str:
        return f"{self.path}: {self.old} -> {self.new}"


@dataclass
class Comparison:
    """What differs between two records.

    Parameters
    ----------
    equal : int
        Entries that agree.
    added : list of str
        Paths of the newer record alone.
    reworded : list of Difference
        Sentences.
    explained : list of (Change, list of Difference)
        For each listed change, what it explains.
    unexplained : list of Difference
        The rest.
    """

    equal: int = 0
    added: list[str] = field(default_factory=list)
    reworded: list[Difference] = field(default_factory=list)
    explained: list[tuple[Change, list[Difference]]] = field(default_factory=list)
    unexplained: list[Difference] = field(default_factory=list)

    @property
    def unmet(self) -> list[Change]:
        """Listed changes that explain nothing."""
        return [change for change, differences in self.explained if not differences]

    @property
    def agrees(self) -> bool:
        """Whether nothing differs but what is listed, and all that is listed differs."""
        return not self.unexplained and not self.unmet


def changes(text: str) -> list[Change]:
    """Changes of a TOML text; each is a table `[[changed]]` of pattern, finding and why."""
    return [Change(**entry) for entry in tomllib.loads(text).get("changed", [])]


def leaves(record: Any, at: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Leaf]]:
    """Every entry of a record with its path; an empty list or object is one."""
    items: list[tuple[str, Any]]
    if isinstance(record, Mapping):
        items = list(record.items())
    elif isinstance(record, list):
        # The key paths of documents are a set: each is an entry of its own name.
        named = at[-1:] == ("keys",)
        items = [(name, True) if named else (str(j), name) for j, name in enumerate(record)]
    else:
        yield at, record
        return
    for key, value in items:
        yield from leaves(value, (*at, key))


def compare(old: Any, new: Any, listed: Sequence[Change]) -> Comparison:
    """Compare two records.

    Parameters
    ----------
    old, new : object
        As JSON gives them.
    listed : sequence of Change
        What may differ, and must.
    """
    before, after = dict(leaves(old)), dict(leaves(new))
    result = Comparison(explained=[(change, []) for change in listed])
    for path, leaf in before.items():
        other = after.get(path, "(gone)")
        if path in after and same(path, leaf, other, before):
            result.equal += 1
            continue
        difference = Difference("/".join(path), shown(leaf), shown(other))
        owners = [found for change, found in result.explained if fnmatchcase(difference.path, change.pattern)]
        for found in owners:
            found.append(difference)
        if not owners and SENTENCES & set(path):
            result.reworded.append(difference)
        elif not owners:
            result.unexplained.append(difference)
    result.added = ["/".join(path) for path in after if path not in before]
    return result


def same(path: tuple[str, ...], old: Leaf, new: Leaf, before: Mapping[tuple[str, ...], Leaf]) -> bool:
    """Whether an entry is as it was."""
    if _is_number(old) and _is_number(new):
        return abs(float(new or 0.0) - float(old or 0.0)) <= allowed(path, before)
    return type(old) is type(new) and old == new


def _is_number(leaf: Leaf) -> bool:
    return isinstance(leaf, int | float) and not isinstance(leaf, bool)


def shown(leaf: Leaf) -> str:
    """An entry as text: enough digits to see what changed."""
    return f"{leaf:.10g}" if isinstance(leaf, float) else str(leaf)


def report(result: Comparison) -> Iterator[str]:
    """Lines for people."""
    for change, differences in result.explained:
        yield f"Finding {change.finding}: {change.why} ({change.pattern}: {len(differences)} entries)"
        yield from (f"    {difference}" for difference in differences)
    if result.reworded:
        yield f"Sentences that read differently: {len(result.reworded)}"
        yield from (f"    {difference}" for difference in result.reworded)
    if result.added:
        yield f"Entries that were not there before: {len(result.added)}"
        yield from (f"    {path}" for path in result.added)
    for change in result.unmet:
        yield f"LISTED, BUT NOTHING DIFFERS: {change.pattern} (finding {change.finding})"
    yield from (f"DIFFERENT: {difference}" for difference in result.unexplained)
    yield (
        f"{result.equal} entries agree, {sum(len(found) for _, found in result.explained)} differ as listed, "
        f"{len(result.reworded)} sentences read differently, {len(result.unexplained)} entries differ."
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m validation.parity.compare",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("old", type=Path, metavar="OLD.json")
    parser.add_argument("new", type=Path, metavar="NEW.json")
    parser.add_argument("--changed", type=Path, default=CHANGED, metavar="FILE.toml")
    chosen = parser.parse_args(arguments)
    old, new = (json.loads(path.read_text(encoding="utf-8")) for path in (chosen.old, chosen.new))
    result = compare(old, new, changes(chosen.changed.read_text(encoding="utf-8")))
    print("\n".join(report(result)))
    return 0 if result.agrees else DIFFERENT


if __name__ == "__main__":
    sys.exit(main())
