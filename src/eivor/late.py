"""Public names of a package that are loaded when they are first used: what is not asked for costs nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module


def late_names(package: str, homes: Mapping[str, str]) -> Callable[[str], object]:
    """Return the `__getattr__` of a package or module.

    Parameters
    ----------
    package : str
        Its name.
    homes : mapping of str to str
        The module where each of its late names lives.

    Returns
    -------
    callable
        From a name to what it stands for. It raises an AttributeError for any other name.
    """

    def load(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        return getattr(import_module(homes[name]), name)

    return load
