"""Flights of the record, each as `eivor identify --json` tells it: the whole document and the exit code."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from validation.parity.where import Done, eivor

NANOBENCH = (
    "B2_circle_fast_rep1",
    "B3_figure8_medium_rep1",
    "B5_helix_fast_rep1",
    "B9_trefoil_fast_rep14",
    "B9_trefoil_slow_rep13",
)
ULOGS = ("ekf_failure", "battery_brownout", "sample_px4_events", "sample_appended_multiple")


def nanobench(data: Path) -> list[Path]:
    """The five flights without faults."""
    return [data / "nanobench" / f"{name}.csv" for name in NANOBENCH]


def cases(data: Path) -> dict[str, tuple[object, ...]]:
    """Arguments of `eivor identify` by the case's name."""
    px4 = data / "px4"
    return {
        "example": ("--example",),
        "example-compare": ("--example", "--compare"),
        "example-lags": ("--example", "--instruments", "lags"),
        "example-linear-map": ("--example", "--input-map", "linear"),
        "example-window": ("--example", "--window", "10:50", "--max-tilt", "15"),
        **{path.stem: (path,) for path in nanobench(data)},
        "nanobench-pool": tuple(nanobench(data)),
        **{name: (px4 / f"{name}.ulg",) for name in ULOGS},
        "ekf_failure-4-67": (f"{px4 / 'ekf_failure.ulg'}@4:67", "--compare"),
    }


def told(done: Done) -> dict[str, Any]:
    """Exit code and document; without a document, what was said."""
    document = done.document
    if document is None:
        return {"exit_code": done.code, "message": done.err.strip()}
    # The version is that of the day, and the hashes are those of the files.
    document["provenance"] = {"options": document["provenance"]["options"]}
    document["findings"] = by_name(document["findings"])
    return {"exit_code": done.code, "document": document}


def by_name(findings: list[Mapping[str, str]]) -> dict[str, list[str]]:
    """Messages of the findings by their names."""
    found: dict[str, list[str]] = {}
    for finding in findings:
        found.setdefault(finding["name"], []).append(finding["message"])
    return dict(sorted(found.items()))


def key_paths(document: object, at: str = "") -> Iterator[str]:
    """Path of every key of a document; the items of a list share one."""
    if isinstance(document, Mapping):
        for key, value in document.items():
            path = f"{at}.{key}" if at else key
            yield path
            yield from key_paths(value, path)
    elif isinstance(document, list):
        for value in document:
            yield from key_paths(value, f"{at}[]")


def flights(data: Path) -> dict[str, Any]:
    """Every flight of the record, and the key paths that their documents have."""
    keys: set[str] = set()
    found = {}
    for name, arguments in cases(data).items():
        done = eivor("identify", *arguments, "--json", "-")
        keys.update(key_paths(done.document))
        found[name] = told(done)
    return {"flights": found, "keys": sorted(keys)}
