"""Definitions in the interface definition language, which rosbags parses."""

from __future__ import annotations

from typing import Any

from eivor.logs.bags.definitions import MAX_TEXT, MessageField, type_name

_SEPARATOR = "=" * 80 + "\n"


def idl_types(text: str) -> dict[str, tuple[MessageField, ...]]:
    """Return the types of a definition; none where it cannot be parsed."""
    from rosbags.typesys import TypesysError, get_types_from_idl

    parts = [part.partition("\n")[2] for part in text[:MAX_TEXT].split(_SEPARATOR) if part.startswith("IDL:")]
    types: dict[str, tuple[MessageField, ...]] = {}
    for part in parts or [text[:MAX_TEXT]]:
        try:
            parsed = get_types_from_idl(part)
        except (TypesysError, ValueError, TypeError, KeyError, IndexError, AttributeError, RecursionError):
            continue
        for name, (_, fields) in parsed.items():
            types[type_name(name)] = tuple(_field(one, described) for one, described in fields)
    return types


def _field(name: str, described: Any) -> MessageField:
    """A field of rosbags' parse tree: a node's number (base, name, array, sequence), and what it is of."""
    from rosbags.interfaces import Nodetype

    node, content = described
    if node in {Nodetype.ARRAY, Nodetype.SEQUENCE}:
        inner, count = content
        return MessageField(name, _kind(*inner), count if node == Nodetype.ARRAY else -1)
    return MessageField(name, _kind(node, content), None)


def _kind(node: Any, content: Any) -> str:
    from rosbags.interfaces import Nodetype

    return str(content[0]) if node == Nodetype.BASE else type_name(str(content))
