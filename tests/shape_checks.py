"""The checks of every annotation, quick enough for a whole test run.

jaxtyping's import hook decorates each function with `jaxtyping.jaxtyped`, which binds the arguments by name
and checks them twice, also where no annotation is an array: three quarters of the time of `identify_flight`.
`jaxtyped` of this module checks the same annotations once. Where one of them is an array, it does so in a
context of jaxtyping, in which the same letter is the same length; elsewhere beartype suffices. Annotations
are read at the first call, as one test file calls few functions of the package.

A search calls the same functions with the same shapes a thousand times, which would take most of the time of
a flight. In each test the first calls of a function are checked one by one, and later ones now and then.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import is_dataclass
from functools import partial, wraps
from types import FunctionType
from typing import Any, get_args, get_type_hints
from warnings import catch_warnings, simplefilter

import jaxtyping
from beartype import BeartypeConf, beartype
from beartype.roar import BeartypeDecorHintPep585DeprecationWarning
from jaxtyping import AbstractArray, config

#: The decorator that this module's takes the place of.
THEIRS = jaxtyping.jaxtyped
_CONTEXT = THEIRS("context")
#: In each test, the first so many calls of a function are checked, and of those that follow one in so many.
FIRST, ONE_IN = 6, 200

#: As the type checker reads annotations: an integer is a number wherever a float is asked for. beartype looks
#: at one entry of a list, by chance, and would else refuse `[3, 1.5]` in one run of two.
typechecker = beartype(conf=BeartypeConf(is_pep484_tower=True))


class _Test:
    """Which test runs: calls are counted anew in each."""

    number = 0


def begin_test():
    """Count the calls of every function from none."""
    _Test.number += 1


def wanted():
    """Say whether this run checks shapes: EIVOR_SHAPE_CHECKS=0 switches them off from the start."""
    return os.environ.get("EIVOR_SHAPE_CHECKS", "") != "0"


def install():
    """Check every annotation of the package, and of `validation/`, in this process and in no user's."""
    jaxtyping.jaxtyped = jaxtyped  # the hook takes the decorator from there
    jaxtyping.install_import_hook(["eivor", "validation"], "shape_checks.typechecker")


@contextmanager
def unchecked():
    """Calls go through to the library's own checks, as they do for users."""
    before = config.jaxtyping_disable
    config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        config.update("jaxtyping_disable", before)


def jaxtyped(what=None, *, typechecker):
    """As `jaxtyping.jaxtyped`: a function that checks its annotations, or a dataclass that does when made."""
    if what is None:
        return partial(jaxtyped, typechecker=typechecker)
    if isinstance(what, FunctionType):
        return _checked(what, typechecker)
    if isinstance(what, type) and is_dataclass(what) and "__init__" in vars(what):
        what.__init__ = _checked(what.__init__, typechecker)
    return what


def _checked(function, typechecker):
    checking: Callable[..., Any] | None = None
    test = calls = 0

    @wraps(function)
    def checked(*args, **kwargs):
        nonlocal checking, test, calls
        if config.jaxtyping_disable:
            return function(*args, **kwargs)
        if test != _Test.number:
            test, calls = _Test.number, 0
        calls += 1
        if calls > FIRST and calls % ONE_IN:
            return function(*args, **kwargs)
        if checking is None:
            checking = _checking(function, typechecker)
        return checking(*args, **kwargs)

    return checked


def _checking(function, typechecker):
    if inspect.isgeneratorfunction(function):  # what it yields is not checked, as in jaxtyping
        return THEIRS(function, typechecker=typechecker)
    hints = {name: _hint(function, text) for name, text in function.__annotations__.items()}
    written, function.__annotations__ = function.__annotations__, hints
    with catch_warnings():
        # Types of other packages may be written in the words of yesterday.
        simplefilter("ignore", BeartypeDecorHintPep585DeprecationWarning)
        typed = typechecker(function)
    function.__annotations__ = written
    if not any(map(_has_array, hints.values())):
        return typed

    def in_context(*args, **kwargs):
        with _CONTEXT:
            return typed(*args, **kwargs)

    return in_context


def _hint(function, written):
    """Return the type that an annotation stands for; anything where it cannot be told, as in jaxtyping."""

    def holder(): ...

    holder.__annotations__ = {"value": written}
    try:
        return get_type_hints(holder, function.__globals__, include_extras=True)["value"]
    except Exception:  # noqa: BLE001 - whatever a name that is not there raises
        return Any


def _has_array(hint):
    if isinstance(hint, type) and issubclass(hint, AbstractArray):
        return True
    parts = hint if isinstance(hint, list) else get_args(hint)  # arguments of a Callable are a list
    return any(map(_has_array, parts))
