"""From rows or moments to a solution: assembler, weighting, solver, in that order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.errors import InstrumentError
from eivor.estimation.method import Method
from eivor.estimation.moments import Moments
from eivor.estimation.weighting import UnweightedEquations
from eivor.linalg.system import LinearSystem, Solution
from eivor.models.regression import LinearProblem


@dataclass(frozen=True)
class SolvedEquations:
    """A solution and the equations it belongs to.

    Parameters
    ----------
    system : LinearSystem
        Equations before their weighting.
    factor : ndarray, shape (p, p), optional
        Factor L of the weighting; None for the identity.
    solution : Solution
        What the solver found.
    """

    system: LinearSystem
    factor: Float[np.ndarray, "p p"] | None
    solution: Solution


def solve(method: Method, problem: LinearProblem) -> SolvedEquations:
    """Solve for the linear parameters of a problem with its rows at hand."""
    own = method.weighting.needs_instrument_products
    return solve_moments(method, method.assembler.moments(problem, instrument_products=own), problem)


def solve_moments(method: Method, moments: Moments, problem: LinearProblem | None) -> SolvedEquations:
    """Solve for the linear parameters from moments, in as many passes as the weighting asks for.

    A weighting of rows asks for passes too, but those are made where its rows are.

    Raises
    ------
    EstimationError
        When the equations have no unique solution.
    """
    system = method.assembler.system(moments)
    theta = None
    passes = method.weighting.passes if method.weighting.needs_instrument_products else 1
    for _ in range(passes):
        weighted = method.weighting.equations(UnweightedEquations(system, moments, problem, theta))
        solution = method.solver.solve(weighted.system)
        theta = solution.theta
    return SolvedEquations(system, weighted.factor, solution)


def check_rank(system: LinearSystem) -> None:
    """Refuse moment equations that rounding alone keeps from being singular.

    Raises
    ------
    InstrumentError
        With the singular values after columns were scaled to unit length.
    """
    lengths = np.sqrt(np.einsum("ij,ij->j", system.matrix, system.matrix))
    singular = np.linalg.svd(system.matrix / np.where(lengths > 0.0, lengths, 1.0), compute_uv=False)
    if not lengths.all() or singular[-1] <= singular[0] * max(system.matrix.shape) * np.finfo(np.float64).eps:
        raise InstrumentError(
            "instruments that move every regressor in a way of its own",
            f"equations of numerical rank below {system.matrix.shape[1]} (singular values {singular})",
            "A white input cannot be instrumented by strictly delayed inputs: use generalized_iv with lag 0, "
            "other instruments, or an input with memory.",
        )
