"""What a log says of its units, held against what its columns are read as.

Since firmware 3.6 a FMTU message gives each column of a type two letters, which UNIT explains as a unit and
MULT as a multiplier. It is a check and no source: a code that scales (c, C, e, E, L) has its multiplier in
itself, "?" means that nobody worked it out, and "-" that there is none.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from eivor.logs.dataflash.messages import Messages
from eivor.logs.dataflash.sources import ATTITUDE, CHANNEL_SOURCES, RATE_SETPOINTS, Source
from eivor.logs.units import UNITS
from eivor.signals.canonical import unit_of
from eivor.signals.recording import Finding

#: Labels of UNIT that are written otherwise here.
LABELS = {"m/s/s": "m/s^2", "degheading": "deg"}
#: Letters of multipliers that say nothing.
UNTOLD = "?-"
#: How far two factors may be apart, as a share: multipliers are logged in single precision.
SAME = 1e-3


def unit_findings(tables: Mapping[str, Messages]) -> list[Finding]:
    """Name the columns that the log declares to be in another unit than they are read in.

    Parameters
    ----------
    tables : mapping of str to Messages
        By name.
    """
    letters, units, multipliers = _letters(tables), _units(tables), _multipliers(tables)
    doubts = {}
    for source, unit in _columns_read():
        table = tables.get(source.message)
        if table is None or not unit or not table.has(source.column):
            continue
        of_unit, of_multiplier = letters.get(table.layout.number, {}).get(source.column, ("", ""))
        declared = units.get(of_unit)
        if declared is None:
            continue
        coded = table.layout.fields[source.column].factor
        told = coded if coded != 1.0 else multipliers.get(of_multiplier)
        read = abs(source.factor_in(table)) * coded
        if declared[0] != unit:
            doubts[source.label.removeprefix("-")] = f"in {declared[0] or 'no unit'}, read in {unit}"
        elif told is not None and abs(told * declared[1] / read - 1.0) > SAME:
            doubts[source.label.removeprefix("-")] = f"as {told * declared[1]:.4g} {unit}, read as {read:.4g}"
    if not doubts:
        return []
    sentence = "; ".join(f"{column} {doubt}" for column, doubt in doubts.items())
    return [
        Finding("declared_units", f"The log declares other units than are read (one stored): {sentence}.")
    ]


def _columns_read() -> Iterator[tuple[Source, str]]:
    """Columns that channels are made of, and the SI unit of those channels."""
    for name, sources in CHANNEL_SOURCES.items():
        for source in sources:
            yield source, unit_of(name)
    degree, turn = UNITS["deg"][1], UNITS["rpm"][1]
    for column in ATTITUDE:
        yield Source("ATT", column, degree), "rad"
    for column in RATE_SETPOINTS.values():
        yield Source("RATE", column, degree), "rad/s"
    yield Source("ESC", "RPM", turn), "rad/s"


def _letters(tables: Mapping[str, Messages]) -> dict[int, dict[str, tuple[str, str]]]:
    """Letters of unit and multiplier of each column, by number of the type."""
    told = tables.get("FMTU")
    if told is None or not told.has("FmtType", "UnitIds", "MultIds"):
        return {}
    columns = {table.layout.number: list(table.layout.fields) for table in tables.values()}
    rows = zip(told.values("FmtType").tolist(), told.texts("UnitIds"), told.texts("MultIds"), strict=True)
    return {
        int(number): {
            column: (unit, multiplier)
            for column, unit, multiplier in zip(columns[int(number)], of_unit, of_multiplier, strict=False)
        }
        for number, of_unit, of_multiplier in rows
        if int(number) in columns
    }


def _units(tables: Mapping[str, Messages]) -> dict[str, tuple[str, float]]:
    """SI unit and factor by letter, of those that are known."""
    told = tables.get("UNIT")
    if told is None or not told.has("Id", "Label"):
        return {}
    labels = zip(told.values("Id").tolist(), told.texts("Label"), strict=True)
    named = {int(letter): LABELS.get(label, label) for letter, label in labels}
    return {chr(letter): UNITS[label] for letter, label in named.items() if label in UNITS and letter > 0}


def _multipliers(tables: Mapping[str, Messages]) -> dict[str, float]:
    """Multiplier by letter, of those that say something."""
    told = tables.get("MULT")
    if told is None or not told.has("Id", "Mult"):
        return {}
    rows = zip(told.values("Id").tolist(), told.values("Mult").tolist(), strict=True)
    return {
        chr(int(letter)): value
        for letter, value in rows
        if 0 < letter < 128 and chr(int(letter)) not in UNTOLD and np.isfinite(value) and value > 0.0
    }
