"""A result read back from the JSON document that was written of it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from eivor.errors import InputError, UsageError
from eivor.flights.allowance import Allowance, Counts
from eivor.flights.quantity import Quantity
from eivor.inference.covariances.covariance import CovariancePart, JointCovariance
from eivor.inference.verdict import Reason, Status
from eivor.report.drawn_candidates import SavedCandidate
from eivor.report.identify_schema import SCHEMA
from eivor.report.saved_fit import SavedFit

if TYPE_CHECKING:
    from eivor.flights.result import FlightEstimate

#: Larger files are no result.
LARGEST_BYTES = 100_000_000


def load_fit(file: str | Path) -> SavedFit:
    """Read back a result that ``eivor identify --json FILE`` or ``fit.to_json()`` wrote.

    Parameters
    ----------
    file : str or Path
        A document of schema ``eivor.identify/1``.

    Returns
    -------
    SavedFit
        Quantities with intervals and verdicts, the joint covariance, and what is needed to predict.

    Raises
    ------
    InputError
        When the file cannot be read, or is no such document.
    """
    if not isinstance(file, str | Path):
        raise UsageError("the path of a JSON file", type(file).__name__, 'Such as ev.load_fit("fit.json").')
    path = Path(file)
    try:
        if path.stat().st_size > LARGEST_BYTES:
            raise _no_document(path, f"a file of {path.stat().st_size} bytes")
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            "a result that can be read", f"'{path}': {error.strerror or error}", "Check the path."
        ) from error
    except (ValueError, RecursionError) as error:
        raise _no_document(path, "content that is not JSON") from error
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise _no_document(path, "another document")
    try:
        return _fit_of(document)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _no_document(path, f"one that lacks parts ({error})") from error


def saved_fit(result: FlightEstimate) -> SavedFit:
    """Return what would be read back of a result that is at hand."""
    from eivor.report.json_document import json_document, json_text  # late: a document at hand needs neither

    return _fit_of(json.loads(json_text(json_document(result))))


def _no_document(path: Path, received: str) -> InputError:
    return InputError(
        f"a document of schema {SCHEMA} in {path.name}",
        received,
        "Write one with: eivor identify LOG --json FILE.",
    )


def _fit_of(document: Mapping[str, Any]) -> SavedFit:
    told = {**document["parameters"], **document["derived"]}
    covariance = document.get("covariance") or {"names": [], "candidates": []}
    return SavedFit(
        verdict=Status(document["verdict"]),
        reasons=tuple(str(reason) for reason in document["reasons"]),
        quantities={str(name): _quantity(one) for name, one in told.items()},
        names=tuple(str(name) for name in covariance["names"]),
        candidates=tuple(_candidate(one) for one in covariance["candidates"]),
        prediction=dict(document.get("prediction") or {}),
        document=document,
        by_flight={
            str(row["log"]): {
                str(name): _quantity(one) for name, one in {**row["parameters"], **row["derived"]}.items()
            }
            for row in document.get("by_flight") or ()
        },
    )


def _quantity(one: Mapping[str, Any]) -> Quantity:
    low, high = one["interval"]
    status = Status(one["verdict"])
    return Quantity(
        value=_number(one["value"], math.nan),
        unit=str(one["unit"]),
        std_error=_number(one["std_error"], math.nan),
        interval=(_number(low, -math.inf), _number(high, math.inf)),
        verdict=status,
        by_run=tuple(_number(value, math.nan) for value in one.get("by_segment", ())),
        reasons=tuple(Reason(status, str(sentence)) for sentence in one.get("reasons", ())),
        allowances=tuple(_allowance(part) for part in one.get("systematic", ())),
    )


def _allowance(one: Mapping[str, Any]) -> Allowance:
    return Allowance(Counts(one["counts"]), float(one["below"]), float(one["above"]), str(one["sentence"]))


def _candidate(one: Mapping[str, Any]) -> SavedCandidate:
    values = np.array([_number(value, math.nan) for value in one["values"]])
    parts = tuple(
        CovariancePart(
            str(part["name"]),
            np.array([[_number(value, math.nan) for value in row] for row in part["matrix"]]).reshape(
                values.size, values.size
            ),
            _number(part["degrees"], math.inf),
            float(part["share"]),
        )
        for part in one["parts"]
    )
    if not parts:
        raise ValueError("a covariance without parts")
    at = {str(name): _number(value, math.nan) for name, value in one["at"].items()}
    excess = _number(one.get("excess", 0.0), math.inf)
    return SavedCandidate(at, bool(one["best"]), values, JointCovariance(parts), excess)


def _number(value: float | None, missing: float) -> float:
    return missing if value is None else float(value)
