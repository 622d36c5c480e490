"""Addresses of logs and fleets in other file systems, through fsspec."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import copyfileobj
from tempfile import TemporaryDirectory
from typing import cast
from urllib.parse import urlsplit

from eivor.errors import InputError, UsageError

_ADDRESS = re.compile(r"([a-z][a-z0-9+.-]*)://")


def is_address(text: str) -> bool:
    """Whether a text is an address of another file system, such as s3://bucket/logs."""
    return _ADDRESS.match(text) is not None and not text.startswith("file://")


def is_local(path: object) -> bool:
    """Whether what `path_of` gave is a path of this machine."""
    return isinstance(path, Path)


def path_of(text: str) -> Path:
    """Path of a text; of an address one that does the same as far as logs and fleets need it."""
    if text.startswith("file://"):
        from urllib.request import url2pathname  # with encryption and protocols, which few logs need

        return Path(url2pathname(urlsplit(text).path))
    if not is_address(text):
        return Path(text)
    scheme = text.partition("://")[0]
    try:
        import upath

        remote = upath.UPath(text, use_listings_cache=False)
        remote.fs  # noqa: B018 - loads what the scheme needs
    except ImportError as error:
        expected = f"the packages for addresses {scheme}://"
        remedy = "Install them: pip install 'eivor[cloud]'."
        raise UsageError(expected, f"an installation without them ({error})", remedy) from error
    except ValueError as error:
        remedy = "Give a path, or an address such as s3://bucket/logs or gs://bucket/logs."
        raise UsageError("a scheme that fsspec knows", f"'{text}'", remedy) from error
    return cast("Path", remote)


@contextmanager
def here(path: str) -> Iterator[Path]:
    """A log as a local file, which is fetched when it is elsewhere."""
    if not is_address(path):
        yield Path(path)
        return
    with TemporaryDirectory(prefix="eivor-") as folder:
        local = Path(folder) / path.rpartition("/")[2]
        remote = path_of(path)
        try:
            with remote.open("rb") as source, local.open("wb") as target:
                copyfileobj(source, target)
        except Exception as error:
            received = f"'{path}', for which {type(error).__name__} says: {error}"
            remedy = "Check the address, and the credentials of this machine."
            raise InputError("an address that can be read", received, remedy) from error
        yield local
