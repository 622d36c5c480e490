"""Equations of one parameter among those of several axes.

Each axis has rows, instruments and parameters of its own, and shares nuisances with the others. A criterion
that divides by the variance of all residuals together is small wherever parameters of *any* axis leave large
ones, and nothing else does that as well as those of an axis that nothing tells: a set of a parameter of
another axis would have no bounds. It is therefore made of the equations that the parameter stands in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.models.regression import Regression
from eivor.shapes import Bool, Float, Int

#: Instruments that move the rows by less than this share are none of them.
INDEPENDENT = 1e-6


@dataclass(frozen=True)
class OwnEquations:
    """Rows, regressors and instruments that go with one parameter.

    Parameters
    ----------
    rows : ndarray of bool, shape (rows,)
        In which its regressor is not zero.
    regressors : ndarray of int
        Numbers of those that are not zero there, the parameter's own first.
    instruments : ndarray, shape (own rows, q)
        Orthonormal.
    """

    rows: Bool[np.ndarray, " rows"]
    regressors: Int[np.ndarray, " own"]
    instruments: Float[np.ndarray, "own_rows q"]

    @property
    def rank(self) -> int:
        """Number of independent instruments."""
        return int(self.instruments.shape[1])

    def columns(
        self, columns: Float[np.ndarray, "points rows n_plus_1"], theta: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, "points own_rows own_plus_1"]:
        """Residual at some parameters, and the regressors, of [phi y] of the same rows at several points."""
        own = columns[:, self.rows]
        residual = own[:, :, -1] - own[:, :, :-1] @ theta
        return np.concatenate([residual[:, :, None], own[:, :, self.regressors]], axis=2)


def own_equations(rows: Regression, place: int) -> OwnEquations:
    """Equations of the parameter of some number.

    Parameters
    ----------
    rows : Regression
        With orthonormal instruments.
    place : int
        Number of the parameter.
    """
    own = rows.regressors[:, place] != 0.0
    others = [j for j in range(rows.regressors.shape[1]) if j != place and rows.regressors[own, j].any()]
    instruments = rows.instruments
    if not own.all():
        basis, sizes, _ = np.linalg.svd(instruments[own], full_matrices=False)
        instruments = basis[:, sizes > INDEPENDENT]
    return OwnEquations(own, np.array([place, *others]), instruments)
