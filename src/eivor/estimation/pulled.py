"""What is told of an estimate that regularisation has pulled."""

from __future__ import annotations

from eivor.inference.verdict import Reason, Status
from eivor.linalg.system import Solution
from eivor.models.equation import Parameter

#: An estimate of which less than this share is left is weak.
MOSTLY_LEFT = 0.99


def pulled(solution: Solution, parameters: tuple[Parameter, ...]) -> tuple[Reason, ...]:
    """Ground that says how far the estimate was moved; none without regularisation."""
    done = solution.shrinkage
    if done is None:
        return ()
    moves = ", ".join(
        f"{parameter.name} by {move:.3g} {parameter.unit}".rstrip()
        for parameter, move in zip(parameters, done.shift, strict=True)
    )
    status = Status.IDENTIFIED if done.kept >= MOSTLY_LEFT * done.shift.size else Status.WEAK
    return (
        Reason(
            status,
            f"Regularised ({done.scheme}, parameter {done.parameter:.3g} by {done.choice}): "
            f"{done.kept:.3g} of {done.shift.size} parameters are left, and it moved {moves}.",
            "A pulled estimate is biased; intervals count the whole move.",
        ),
    )
