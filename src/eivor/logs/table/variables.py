"""Tables whose columns are variables of a file: vectors, and matrices of which each row is an instant."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from eivor.errors import ChannelMapError, EmptyLogError
from eivor.logs.columns import Columns
from eivor.logs.elements import element_of
from eivor.logs.table.source import MAX_COLUMNS, TableSource, corrupt_table


def variables_source(
    name: str,
    shapes: Mapping[str, tuple[int, ...]],
    values: Callable[[Sequence[str]], Mapping[str, np.ndarray]],
) -> TableSource:
    """Return the table of a file's variables.

    Parameters
    ----------
    name : str
        What to call the file.
    shapes : mapping of str to tuple of int
        Of the variables that hold numbers.
    values : callable
        Gives some, by their names.

    Raises
    ------
    EmptyLogError
        When there are none.
    CorruptLogError
        When there are too many.
    """
    if not shapes:
        raise EmptyLogError(
            "a file with vectors or matrices of numbers",
            f"'{name}' without any",
            "Save each signal as a vector of its own; objects (timeseries, tables) are not read.",
        )
    if len(shapes) > MAX_COLUMNS:
        raise corrupt_table(name, f"with {len(shapes)} variables", f"At most {MAX_COLUMNS} are read.")

    def read(columns: Sequence[str]) -> Columns:
        return _columns(name, shapes, values, columns)

    return TableSource(tuple(shapes), read)


def _columns(
    name: str,
    shapes: Mapping[str, tuple[int, ...]],
    values: Callable[[Sequence[str]], Mapping[str, np.ndarray]],
    columns: Sequence[str],
) -> Columns:
    found: dict[str, np.ndarray] = {}
    unreadable: dict[str, int] = {}
    lists: dict[str, str] = {}
    elements = {column: element_of(column, list(shapes)) for column in columns}
    whole = {column: element[0] if element else column for column, element in elements.items()}
    arrays = values(list(dict.fromkeys(whole.values())))
    for column, element in elements.items():
        array = np.squeeze(np.asarray(arrays[whole[column]], dtype=np.float64))
        if array.ndim == 2:
            # one row of a matrix for each instant, whichever way it was saved
            array = array if array.shape[0] >= array.shape[1] else array.T
            if element is None:
                lists[column], unreadable[column] = f"a matrix of {shapes[column]}", array.shape[0]
                array = np.full(array.shape[0], np.nan)
            else:
                missing = np.full(array.shape[0], np.nan)
                array = array[:, element[1]] if element[1] < array.shape[1] else missing
        found[column] = np.atleast_1d(array)
    lengths = {column: array.size for column, array in found.items()}
    if len(set(lengths.values())) > 1:
        told = ", ".join(f"'{column}' {size}" for column, size in list(lengths.items())[:8])
        raise ChannelMapError(
            "variables of one length, with one clock",
            f"'{name}' with {told}",
            "Name those of one clock in a channel map (--map).",
        )
    return Columns(found, unreadable, lists=lists)
