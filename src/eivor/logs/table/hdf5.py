"""HDF5 files, those of MATLAB 7.3 among them, by h5py: vectors and matrices, also in groups (``log.vz``)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from eivor.errors import LogTooLargeError, MissingReaderError
from eivor.logs.table.child import BEGINNING, REFUSED, decode_in_child
from eivor.logs.table.parquet import FREE_CELLS, MAX_CELLS, MAX_CELLS_PER_BYTE
from eivor.logs.table.source import MAX_COLUMNS, TableSource, corrupt_table
from eivor.logs.table.variables import variables_source

#: Memory that the decoder may take [bytes]: for itself, and for each number of the largest variable.
DECODER_BYTES, BYTES_PER_CELL = 1 << 30, 16
TIMEOUT_S = 120.0
#: Kinds of MATLAB's variables that are no numbers, although they are stored as such.
_NO_NUMBERS = (b"char", b"cell", b"function_handle", b"FileWrapper__")
_DAMAGE = (ValueError, TypeError, KeyError, OSError, RuntimeError, OverflowError, MemoryError, RecursionError)
_CODE = f"""{BEGINNING}
import h5py
def visit(name, one):
    if isinstance(one, h5py.Dataset) and one.dtype.kind in "iufb" and not (one.is_virtual or one.external):
        if (one.size or 0) <= asked["most"]:
            one[()]
try:
    with h5py.File(asked["path"], "r") as file:
        file.visititems(visit)
except BaseException as error:
    print(type(error).__name__, str(error)[:500])
    sys.exit({REFUSED})
"""


def open_hdf5(file: Path) -> TableSource:
    """Name the variables of an HDF5 file.

    Raises
    ------
    MissingReaderError
        When h5py is not installed.
    CorruptLogError
        When it cannot be read.
    EmptyLogError
        When it holds no vectors of numbers.
    """
    try:
        import h5py
    except ImportError as error:
        raise MissingReaderError(
            "h5py, which reads HDF5 and MATLAB 7.3",
            f"an installation without it ({error})",
            "Install it: pip install 'eivor[hdf5]'. Or save with '-v7' in MATLAB.",
        ) from error
    size = file.stat().st_size
    most = min(MAX_CELLS, max(FREE_CELLS, MAX_CELLS_PER_BYTE * size))
    limit = DECODER_BYTES + BYTES_PER_CELL * most
    asked = {"most": most}
    decode_in_child(file, _CODE, asked, max_bytes=limit, timeout_s=TIMEOUT_S, kind="an HDF5 file")
    try:
        with h5py.File(file, "r") as content:
            found = _datasets(h5py, content)
    except _DAMAGE as error:
        raise corrupt_table(
            file.name, f"an HDF5 file that cannot be read: {error}", "The file is damaged; write it again."
        ) from error
    places = {path.replace("/", "."): path for path in found}

    def values(names: Sequence[str]) -> dict[str, np.ndarray]:
        for name in names:
            _check_size(file, found[places[name]], most)
        with h5py.File(file, "r") as content:
            return {name: np.asarray(content[places[name]][()]) for name in names}

    return variables_source(file.name, {name: found[path] for name, path in places.items()}, values)


def _datasets(h5py: Any, content: Any) -> dict[str, tuple[int, ...]]:
    """Shapes of the vectors and matrices of numbers in the file itself, by their path."""
    found: dict[str, tuple[int, ...]] = {}

    def visit(path: str, one: Any) -> None:
        if not isinstance(one, h5py.Dataset) or path.startswith("#") or len(found) > MAX_COLUMNS:
            return
        # other files are none of this one's business
        if one.is_virtual or one.external or one.attrs.get("MATLAB_class") in _NO_NUMBERS:
            return
        # one without a space has no shape
        if one.dtype.kind in "iufb" and one.size and len(one.shape) in (1, 2):
            found[path] = tuple(int(size) for size in one.shape)

    content.visititems(visit)
    return found


def _check_size(file: Path, shape: tuple[int, ...], most: int) -> None:
    cells = math.prod(shape)
    if cells > most:
        raise LogTooLargeError(
            f"at most {most} numbers in a variable of this file",
            f"'{file.name}' with {cells}",
            "Such a file repeats itself, which no flight does; check what wrote it.",
        )
