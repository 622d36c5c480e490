"""What no method estimates from: too few rows, equations of too low a rank, too few instruments."""

from __future__ import annotations

import numpy as np

from eivor.errors import InstrumentError, TooFewSamplesError
from eivor.linalg.least_squares import lost_to_rounding, row_lengths
from eivor.linalg.system import LinearSystem
from eivor.models.regression import Regression


def check_freedom(rows: int | float, unknowns: int) -> None:
    """Refuse rows that any parameters fit: their residual of zero would pass for no error at all.

    Raises
    ------
    TooFewSamplesError
        When no degree of freedom is left.
    """
    if rows <= unknowns:
        raise TooFewSamplesError(
            f"more rows than the {unknowns} unknowns, since the residual tells their errors",
            f"{rows:g}",
            "Give a longer record.",
        )


def check_rank(system: LinearSystem) -> None:
    """Refuse moment equations that rounding alone keeps from being singular.

    Raises
    ------
    InstrumentError
        With the singular values after columns were scaled to unit length, and rows of a square system.
    """
    lengths = np.sqrt(np.einsum("ij,ij->j", system.matrix, system.matrix))
    scaled = system.matrix / np.where(lengths > 0.0, lengths, 1.0)
    singular = np.linalg.svd(scaled / row_lengths(system.matrix)[:, None], compute_uv=False)
    if not lengths.all() or lost_to_rounding(singular, max(system.matrix.shape)):
        raise InstrumentError(
            "instruments that move every regressor in a way of its own",
            f"equations of numerical rank below {system.matrix.shape[1]} (singular values {singular})",
            "An input that never moves tells nothing, and a white one cannot be instrumented by strictly "
            "delayed inputs: use generalized_iv with lag 0, other instruments, or an input with memory.",
        )


def check_instruments(rows: Regression, nuisances: int, method: str) -> None:
    """Refuse fewer instruments than unknowns, the nuisances that are searched for among them.

    Raises
    ------
    InstrumentError
        With both numbers, and the name of the method that needs them.
    """
    needed, available = rows.regressors.shape[1] + nuisances, rows.instruments.shape[1]
    if available < needed:
        raise InstrumentError(
            f"at least {needed} independent instruments for {needed} unknowns and the method {method}",
            f"{available}",
            "Name exogenous signals that vary: instruments=..., or --instruments.",
        )
