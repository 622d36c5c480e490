"""Printable text, notebook output, progress messages, and annotations of array shapes."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Sequence
from enum import StrEnum
from html import escape
from typing import TYPE_CHECKING, Any

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


# -- Shapes --

if TYPE_CHECKING or "jaxtyping" in sys.modules:
    from jaxtyping import Bool, Complex, Float, Int
else:

    class _Unchecked:
        def __class_getitem__(cls, kind_and_shape: tuple[Any, str]) -> Any:
            return kind_and_shape[0]

    Bool = Complex = Float = Int = _Unchecked

__all__ = ["Bool", "Complex", "Float", "Int"]
