"""MATLAB files up to version 7.2, by SciPy: vectors, matrices, and those in structures (``log.vz``)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from eivor.errors import CorruptLogError
from eivor.logs.table.child import BEGINNING, REFUSED, decode_in_child
from eivor.logs.table.source import TableSource, corrupt_table
from eivor.logs.table.variables import variables_source

#: Memory that the decoder may take [bytes]: for itself, and for each byte of the file.
DECODER_BYTES, BYTES_PER_BYTE = 1 << 30, 32
TIMEOUT_S = 120.0
#: How deep structures may stand in each other.
MAX_NESTING = 4
_DAMAGE = (
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    NotImplementedError,
    OSError,
    EOFError,
    OverflowError,
    MemoryError,
    RecursionError,
    struct.error,
    zlib.error,
)
_CODE = f"""{BEGINNING}
from scipy.io import loadmat
try:
    loadmat(asked["path"], squeeze_me=True)
except BaseException as error:
    print(type(error).__name__, str(error)[:500])
    sys.exit({REFUSED})
"""


def open_matlab(file: Path) -> TableSource:
    """Read the variables of a MATLAB file.

    Raises
    ------
    CorruptLogError
        When it cannot be read.
    EmptyLogError
        When it holds no vectors of numbers.
    """
    from scipy.io import loadmat

    limit = DECODER_BYTES + BYTES_PER_BYTE * file.stat().st_size
    decode_in_child(file, _CODE, {}, max_bytes=limit, timeout_s=TIMEOUT_S, kind="a MATLAB file")
    try:
        content = loadmat(file, squeeze_me=True)
    except _DAMAGE as error:
        raise _unreadable(file, error) from error
    found = {
        name: array
        for key, value in content.items()
        if not key.startswith("__")
        for name, array in _numbers(key, value, MAX_NESTING)
    }
    shapes = {name: one.shape for name, one in found.items()}
    return variables_source(file.name, shapes, lambda names: {name: found[name] for name in names})


def _unreadable(file: Path, error: Exception) -> CorruptLogError:
    return corrupt_table(
        file.name, f"a MATLAB file that cannot be decoded: {error}", "The file is damaged; save it again."
    )


def _numbers(name: str, value: Any, depth: int) -> Iterator[tuple[str, np.ndarray]]:
    """The arrays of numbers of a variable, and of the fields of a structure."""
    array = np.asarray(value)
    if array.dtype.names and array.ndim == 0 and depth:
        for field in array.dtype.names:
            yield from _numbers(f"{name}.{field}", array[field].item(), depth - 1)
    elif array.dtype.kind in "iufb" and array.ndim in (1, 2) and array.size:
        yield name, array
