"""Rows of the tables of refusals: a name, what is called, the error, and the text that it matches."""

from __future__ import annotations

import inspect
import sys
from functools import partial

import pytest


def rows(name, error, call, *cases, marks=()):
    """A row for each case: what is given to `call`, its error where cases differ, and the text."""
    for number, (*given, text) in enumerate(cases):
        raised = error or given.pop()
        called = partial(call, *given) if call else partial(*given)
        yield pytest.param(called, raised, text, id=f"{name} {number}", marks=marks)


def calls(name, error, *cases, marks=()):
    """A row for each case: what is called, and the text."""
    return rows(name, error, None, *cases, marks=marks)


def without(package, call):
    """What is called, where a package is not installed."""

    def called(tmp_path, monkeypatch):
        monkeypatch.setitem(sys.modules, package, None)
        call(tmp_path)

    return called


def table(*parts, fixtures=(), begins=""):
    """The test of all refusals of a folder; what is called is given the fixtures that it names."""

    @pytest.mark.usefixtures("unchecked_shapes", *fixtures)
    @pytest.mark.parametrize(("call", "error", "text"), [row for part in parts for row in part])
    def test_refused(call, error, text, request):
        needed = [item for item in inspect.signature(call).parameters.values() if item.default is item.empty]
        names = [item.name for item in needed if item.kind is item.POSITIONAL_OR_KEYWORD]
        given = {name: request.getfixturevalue(name) for name in names}
        with pytest.raises(error, match=f"(?s){begins}{text}"):
            call(**given)

    return test_refused
