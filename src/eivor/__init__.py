"""Eivor: the parameters of moving machines from noisy recordings, with honest intervals and a verdict."""

from __future__ import annotations

import re
from importlib import import_module
from pkgutil import get_data

#: The stub beside this file, which says where each public name lives, a line for each.
_STUB = (get_data(__name__, "__init__.pyi") or b"").decode()
#: Module of each public name, and its name there.
_HOMES = {
    public: (module, name)
    for module, name, public in re.findall(r"^from (\S+) import (\S+) as (\S+)$", _STUB, re.MULTILINE)
}
_HOMES |= {public: _HOMES.pop(name) for public, name in re.findall(r"^(\w+) = (\w+)$", _STUB, re.MULTILINE)}

__all__ = sorted([*_HOMES, "__version__"])  # noqa: PLE0605 - a sorted list is one


def __getattr__(name: str) -> object:
    if name == "__version__":
        from importlib.metadata import version

        value: object = version("eivor")
    elif name in _HOMES:
        module, attribute = _HOMES[name]
        home = import_module(module)
        is_package = hasattr(home, "__path__")  # of which a public name is a module
        value = import_module(f"{module}.{attribute}") if is_package else getattr(home, attribute)
    else:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
