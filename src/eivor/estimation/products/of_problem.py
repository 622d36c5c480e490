"""Products of the columns of a problem, and the triangular root of its rows."""

from __future__ import annotations

import numpy as np

from eivor.errors import InstrumentError, NonFiniteError
from eivor.estimation.products.long_records import products_of_long_record
from eivor.estimation.products.of_signals import products_of_signals, root_of_signals
from eivor.inference.products import Products, products_of_rows
from eivor.linalg.triangular import triangular_root
from eivor.models.regression import LinearProblem, Regression
from eivor.models.signal_regression import SignalRegression
from eivor.shapes import Float


def products_of(problem: LinearProblem, *, instruments: bool = True, whole: bool) -> Products:
    """Products of the columns [psi phi y] of a problem.

    Parameters
    ----------
    problem : LinearProblem
        Rows.
    instruments : bool
        False takes the regressors themselves as psi.
    whole : bool
        Also multiply instruments, and regressors and response, among themselves.

    Returns
    -------
    Products
        In many blocks where that costs nothing, as diagnostics read them; else in one.

    Raises
    ------
    InstrumentError
        When there are no instruments to multiply with.
    NonFiniteError
        When a product is not finite.
    """
    if instruments and not problem.instrument_count:
        raise InstrumentError(
            "instruments",
            "a problem without any",
            'Name them: regression(signals, ev.lags("input", 0, 10)), or regression(instruments=...).',
        )
    if isinstance(problem, SignalRegression):
        long_record = products_of_long_record(problem) if instruments and whole else None
        made = long_record or products_of_signals(problem, instruments=instruments, whole=whole)
    else:
        made = _of_arrays(problem.rows(), instruments=instruments, whole=whole)
    if not np.isfinite(made.sums).all():
        raise NonFiniteError(
            "finite cross-products", "NaN or infinity", "Check the channels for overflow or missing values."
        )
    return made


def _of_arrays(rows: Regression, *, instruments: bool, whole: bool) -> Products:
    psi = rows.instruments if instruments else rows.regressors
    edges = np.array([0, rows.response.size])
    return products_of_rows(psi, rows.regressors, rows.response, edges=edges, whole=whole)


def root_of_rows(problem: LinearProblem) -> tuple[int, Float[np.ndarray, "k n_plus_1"]]:
    """Number of rows and the triangular root of [phi y]."""
    if isinstance(problem, SignalRegression):
        return root_of_signals(problem)
    rows = problem.rows()
    return rows.response.size, triangular_root(np.column_stack([rows.regressors, rows.response]))
