"""Compressed parts of bags, into so many bytes at most: a few of them may say far more than a log does."""

from __future__ import annotations

import sys
from bz2 import BZ2Decompressor
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

#: What a bag may become by decompression: so many times its size, and so much more [bytes].
TIMES, MORE = 64, 64 << 20


class TooLargeError(ValueError):
    """A bag that becomes too large by decompression."""


@dataclass(slots=True)
class Budget:
    """How much may still be decompressed [bytes]."""

    left: int

    @classmethod
    def of(cls, size: int) -> Budget:
        """Return the budget of a bag of so many bytes."""
        return cls(TIMES * size + MORE)

    def spent(self, made: bytes) -> bytes:
        """Return what was made, which is taken off."""
        self.left -= len(made)
        if self.left < 0:
            raise TooLargeError("it repeats itself far more often than a flight does")
        return made

    def plain(self, data: bytes) -> bytes:
        """Return what is not compressed."""
        return self.spent(data)

    def zstd(self, data: bytes) -> bytes:
        """Decompress by zstd."""
        return self._made(data, _zstd_decompressor())

    def lz4(self, data: bytes) -> bytes:
        """Decompress by lz4."""
        from lz4.frame import LZ4FrameDecompressor

        return self._made(data, LZ4FrameDecompressor)

    def bz2(self, data: bytes) -> bytes:
        """Decompress by bzip2."""
        return self._made(data, BZ2Decompressor)

    def _made(self, data: bytes, decompressor: Callable[[], Any]) -> bytes:
        """All frames of compressed data."""
        parts = []
        while data:
            one = decompressor()
            parts.append(self.spent(one.decompress(data, max_length=self.left + 1)))
            if not one.eof:
                raise EOFError("compressed data that end within a frame, or go on for too long")
            data = one.unused_data or b""
        return b"".join(parts)


def _zstd_decompressor() -> Callable[[], Any]:
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd.ZstdDecompressor


@contextmanager
def bounded_chunks(budget: Budget) -> Iterator[None]:
    """Let rosbags decompress chunks of MCAP within a budget, while the context lasts."""
    from rosbags.rosbag2 import storage_mcap

    table: dict[str, Callable[[bytes, int], bytes]] = storage_mcap.DECOMPRESSORS
    kept = dict(table)
    table.update(
        {
            "": lambda data, _: budget.plain(data),
            "lz4": lambda data, _: budget.lz4(data),
            "zstd": lambda data, _: budget.zstd(data),
        }
    )
    try:
        yield
    finally:
        table.update(kept)


def zstd_error() -> type[Exception]:
    """Return what zstd raises for damaged data."""
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    error: type[Exception] = zstd.ZstdError
    return error
