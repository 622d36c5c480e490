"""Printable text, notebook output, progress messages, dataclasses, and annotations of array shapes."""

from __future__ import annotations

import dataclasses
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import MISSING, FrozenInstanceError, field, fields
from enum import StrEnum
from html import escape
from typing import TYPE_CHECKING, Any, ClassVar, dataclass_transform

# -- Text --

#: A symbol, alone or before its value: it stays as it is.
_SYMBOL = re.compile(r"\w{1,2}( [-−–±\d].*)?$|[a-z]_")


def capitalised(words: str) -> str:
    """Words with a capital letter first, but for symbols."""
    return words if _SYMBOL.match(words) else f"{words[:1].upper()}{words[1:]}"


def plain(value: float, digits: int = 2) -> str:
    """So many digits of a number, however large it is, without a power of ten."""
    return f"{float(f'{value:.{digits}g}'):.15g}"


def printable(text: str) -> str:
    """`text` with what a terminal or a figure would act on as backslash escapes; letters stay."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in text)


# -- Stages --


class Stage(StrEnum):
    """What an identification is at."""

    PREPARING = "preparing"
    IDENTIFYING = "identifying"
    DIAGNOSING = "diagnosing"


#: Called with each stage when it begins.
Progress = Callable[[Stage], None]


def no_stage_callback(_stage: Stage, /) -> None:
    """Report to no one."""


#: Called with the number of items that are done, and that of all; first with what was done before.
ItemsDone = Callable[[int, int], None]


def no_items_callback(_done: int, _total: int, /) -> None:
    """Report to no one."""


# -- Notebook --


def html_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], note: str = "") -> str:
    """Table in HTML."""
    head = "".join(f"<th>{escape(column)}</th>" for column in columns)
    body = "".join("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>" for cells in rows)
    below = f"<p>{escape(note)}</p>" if note else ""
    return (
        f"<div><strong>{escape(title)}</strong><table><thead><tr>{head}</tr></thead>"
        f"<tbody>{body}</tbody></table>{below}</div>"
    )


# -- Dataclasses --


#: In the place of an argument that is made.
_MADE = type("", (), {"__repr__": lambda _: "<factory>"})()


def _initialiser(kind: Any) -> Any:
    """Compile what sets the fields of a new object."""
    known: dict[str, Any] = {"set__": object.__setattr__, "none__": _MADE}
    arguments, named, lines = ["self"], ["*"], []
    for item in fields(kind):
        name, factory, default = item.name, item.default_factory, item.default
        is_made = factory is not MISSING
        given = "=none__" if is_made else "" if default is MISSING else f"={name}__"
        value = f"{name}__() if {name} is none__ else {name}" if is_made else name
        known[f"{name}__"] = factory if is_made else default
        if item.init:
            (named if item.kw_only else arguments).append(f"{name}{given}")
        if item.init or given:
            lines.append(
                f"set__(self, '{name}', {value if item.init else f'{name}__()' if is_made else f'{name}__'})"
            )
    lines += ["self.__post_init__()"] if hasattr(kind, "__post_init__") else [] if lines else ["pass"]
    arguments, body = [*arguments, *(named if len(named) > 1 else [])], "\n  ".join(lines)
    text = (
        f"def made({', '.join(known)}):\n def __init__({', '.join(arguments)}):\n  {body}\n return __init__"
    )
    results: dict[str, Any] = {}
    exec(text, vars(sys.modules[kind.__module__]), results)  # noqa: S102 - names of fields alone
    made = results["made"](*known.values())
    made.__qualname__ = f"{kind.__qualname__}.__init__"
    made.__annotations__ = {item.name: item.type for item in fields(kind) if item.init} | {"return": None}
    return made


def _compared(made: Any) -> tuple[Any, ...]:
    return tuple([getattr(made, name) for name in made.__compared__])


@dataclass_transform(frozen_default=True, field_specifiers=(field,))
class Frozen:
    """Base of frozen dataclasses: what the decorator compiles for each, in half a millisecond, they share."""

    __dataclass_fields__: ClassVar[dict[str, Any]]
    __compared__: ClassVar[tuple[str, ...]]

    def __init_subclass__(cls, *, kw_only: bool = False, **options: Any) -> None:
        super().__init_subclass__(**options)
        cls.__doc__ = cls.__doc__ or cls.__name__  # else its signature, which takes as long as all else
        bases: list[Any] = [base for base in cls.__mro__[1:] if "__dataclass_params__" in vars(base)]
        for base in bases:  # the standard library extends what is not frozen by what is not
            base.__dataclass_params__.frozen = False
        dataclasses.dataclass(init=False, repr=False, eq=False, kw_only=kw_only)(cls)
        for base in (cls, *bases):
            base.__dataclass_params__.frozen = True
        cls.__compared__ = tuple([item.name for item in fields(cls) if item.compare])
        type.__setattr__(cls, "__init__", _initialiser(cls))

    def __eq__(self, other: object) -> bool:
        return _compared(self) == _compared(other) if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        return hash(_compared(self))

    def __repr__(self) -> str:
        values = (f"{item.name}={getattr(self, item.name)!r}" for item in fields(self) if item.repr)
        return f"{type(self).__qualname__}({', '.join(values)})"

    def __setattr__(self, name: str, _value: object = None) -> None:
        raise FrozenInstanceError(f"cannot assign to field '{name}'")

    __delattr__ = __setattr__


# -- Shapes --

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Complex, Float, Int
else:

    class _Unchecked:
        def __class_getitem__(cls, kind_and_shape: tuple[Any, str]) -> Any:
            return kind_and_shape[0]

    Bool = Complex = Float = Int = _Unchecked

__all__ = ["Bool", "Complex", "Float", "Int"]
