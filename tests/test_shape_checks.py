"""The quick checks of annotations refuse what jaxtyping's own refuse, and let through the rest."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import FunctionType
from typing import Any

import jaxtyping
import numpy as np
import pytest
from beartype import beartype
from jaxtyping import Float, config

import shape_checks

DECORATORS = {"ours": shape_checks.jaxtyped, "jaxtyping": shape_checks.THEIRS}
Vector = Float[np.ndarray, "n"]
A, B = np.zeros(3), np.zeros(4)


@dataclass(frozen=True)
class Pair:
    one: Vector
    other: Vector | None = None

    def __post_init__(self) -> None:
        _ = B.shape


def product(vector: Vector, other: Float[np.ndarray, "n m"], *, times: int = 1) -> Float[np.ndarray, "m"]:
    return times * (vector @ other)


def wrong_result(vector: Vector) -> Vector:
    return np.append(vector, 0.0)


def one_of(table: tuple[Vector, ...], which: Callable[[Vector], float] = np.sum) -> float:
    return which(table[0])


def name_of(word: str, *more: int) -> str:
    return word * len(more)


def parts(vector: Vector) -> Iterator[Vector]:
    yield B
    yield vector


REFUSED = [
    (product, (A, np.zeros((4, 2))), {}),  # the same letter, another length
    (product, (A.astype(int), np.zeros((3, 2))), {}),
    (product, (A, np.zeros(3)), {}),
    (product, (A, np.zeros((3, 2))), {"times": "two"}),
    (wrong_result, (A,), {}),
    (one_of, ((np.zeros((2, 2)),),), {}),
    (name_of, (3,), {}),
    (parts, (3,), {}),
    (Pair, (A, B), {}),
    (Pair, (A.tolist(),), {}),
]


def decorated(what: Any, decorator: Callable[..., Any]) -> Any:
    """Return a copy that is checked: the one of this module stays as it is."""
    if isinstance(what, FunctionType):
        copy = FunctionType(what.__code__, what.__globals__, what.__name__, what.__defaults__)
        copy.__kwdefaults__, copy.__annotations__ = what.__kwdefaults__, dict(what.__annotations__)
    else:
        copy = type(what.__name__, (), {"__module__": __name__, "__annotations__": what.__annotations__})
        copy.other = None
        copy = dataclass(frozen=True)(copy)
    return decorator(copy, typechecker=beartype)


@pytest.mark.parametrize("decorator", DECORATORS.values(), ids=list(DECORATORS))
@pytest.mark.parametrize(("what", "arguments", "named"), REFUSED)
def test_what_does_not_fit_is_refused(what, arguments, named, decorator):
    checked = decorated(what, decorator)
    for _ in range(2):
        with pytest.raises(Exception, match=r"violates|Type-check"):
            checked(*arguments, **named)
    with shape_checks.unchecked():
        if what is wrong_result:
            assert checked(*arguments, **named).size == 4


def test_the_package_is_checked_where_this_run_checks():
    import eivor

    assert (jaxtyping.jaxtyped is shape_checks.jaxtyped) == shape_checks.wanted()
    assert hasattr(eivor.Signals.channel, "__wrapped__") == shape_checks.wanted()
    assert not config.jaxtyping_disable


@pytest.mark.calibration
def test_calibrations_are_not_checked():
    assert config.jaxtyping_disable
