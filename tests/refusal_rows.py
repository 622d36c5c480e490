"""Rows of the tables of refusals: a name, what is called, the error, and the text that it matches."""

from __future__ import annotations

from functools import partial

import pytest


def rows(name, error, call, *cases):
    """A row for each case: what is given to `call`, its error where cases differ, and the text."""
    for number, (*given, text) in enumerate(cases):
        raised = error or given.pop()
        yield pytest.param(partial(call, *given), raised, text, id=f"{name} {number}")


def calls(name, error, *cases):
    """A row for each case: what is called, and the text."""
    return rows(name, error, lambda call, *given: call(*given), *cases)


def table(*parts):
    return pytest.mark.parametrize(("call", "error", "text"), [row for part in parts for row in part])
