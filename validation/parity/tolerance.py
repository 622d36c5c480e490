"""How far two numbers of the record may differ, by where they stand.

Array problems agree to 1e-9, or to the rounding unit times the condition of their equations where that is
larger; a value and the ends of its interval are measured by its standard error where that is larger than
they are, as an end may be zero. Of flights the lag is searched for, and every number follows from it: they
agree to 1e-3 of their standard error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

#: A number, a word, or nothing.
Leaf = float | int | str | bool | None
Leaves = Mapping[tuple[str, ...], Leaf]

RELATIVE = 1e-9
ROUNDING_UNIT = 2.0**-52
#: Of numbers that follow from a search: a share of the standard error, or of the number where it has none.
SEARCHED = 1e-3
#: Of a p-value that follows from a search: far in the tail it changes more than its statistic.
SEARCHED_P_VALUE = 2e-2
#: Trials of the flight study are kept to 17 binary digits.
KEPT = 2.0**-16
#: Parts of the record in which a nuisance is searched for.
SEARCHED_PARTS = frozenset({"identify", "from_python", "flight_study"})
#: Standard errors of a problem's values are those of this covariance.
LEADING = "cosines"


def allowed(path: tuple[str, ...], old: Leaves) -> float:
    """Largest difference that the number at `path` may have.

    Parameters
    ----------
    path : tuple of str
        Where it stands in the record.
    old : mapping
        All numbers of the older record.
    """
    part = path[0]
    if part == "flight_study":
        return _of_trial(path, old)
    if part in SEARCHED_PARTS:
        return _of_search(path, old)
    share = RELATIVE
    if part in {"problems", "streamed"}:
        depth = 3 if part == "problems" else 1
        condition = _number(old.get((*path[:depth], "condition")))
        share = max(RELATIVE, ROUNDING_UNIT * condition)
    return share * max(_size(path, old), _standard_error(path, old))


def _number(leaf: Leaf) -> float:
    return abs(float(leaf)) if isinstance(leaf, int | float) else 0.0


def _size(path: tuple[str, ...], old: Leaves) -> float:
    """Size of a number; of the ends of an interval, that of the larger one."""
    sizes = [_number(old.get(path))]
    if path[0] == "inference" and path[-1] in {"0", "1"} and "diagnose" not in path[2]:
        sizes += [_number(old.get((*path[:-1], end))) for end in ("0", "1")]
    return max(sizes)


def _standard_error(path: tuple[str, ...], old: Leaves) -> float:
    """Standard error that belongs to a value or an end; zero when there is none."""
    if path[-2:-1] in {("low",), ("high",), ("std_error",)}:
        return _number(old.get((*path[:-2], "std_error", path[-1])))
    if path[-2:-1] == ("values",):
        return _number(old.get((*path[:-2], "covariances", LEADING, "std_error", path[-1])))
    return 0.0


def _of_search(path: tuple[str, ...], old: Leaves) -> float:
    for depth in range(len(path) - 1, 0, -1):  # a quantity of a document, with its own standard error
        error = old.get((*path[:depth], "std_error"))
        if error is not None:
            return SEARCHED * _number(error)
    own = _standard_error(path, old)
    if own:
        return SEARCHED * own
    if "bootstrap" in path:
        return SEARCHED * _number(old.get((*path[:-1], "0")))
    if "diagnostics" in path or "diagnose" in path:
        second = "diagnose" in path and path[-1] == "1"
        share = SEARCHED_P_VALUE if second or "p_value" in path[-1] else SEARCHED
        return share * _number(old.get(path))
    return RELATIVE * _number(old.get(path))


def _of_trial(path: tuple[str, ...], old: Leaves) -> float:
    size = _number(old.get(path))
    if path[1:2] != ("trials",):
        return 0.0
    column = old.get(("flight_study", "columns", path[-1]))
    name = column if isinstance(column, str) else ""
    if name.endswith("p_value"):
        return SEARCHED_P_VALUE * size
    if name.endswith("first_stage_F"):
        return SEARCHED * size
    if not name.endswith((".value", ".low", ".high")):
        return KEPT * size
    ends = _interval_of(name.rpartition(".")[0], path, old)
    return SEARCHED * (ends[1] - ends[0]) / 4.0 + KEPT * size


def _interval_of(quantity: str, path: tuple[str, ...], old: Leaves) -> Sequence[float]:
    """Interval of a quantity in the same trial."""
    places = {leaf: where[-1] for where, leaf in old.items() if where[:2] == ("flight_study", "columns")}
    found = [old.get((*path[:-1], places[f"{quantity}.{end}"])) for end in ("low", "high")]
    return [float(end) if isinstance(end, int | float) else 0.0 for end in found]
