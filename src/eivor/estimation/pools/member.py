"""One flight of a pool at one combination of the discrete nuisances.

Each flight keeps instruments of its own, and is whitened by its own residual. Its rows are multiplied once
at every node of the continuous nuisances; whatever is shared, and whatever is not, a pool is made of these
products.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from eivor.estimation.products.nodes import Nodes
from eivor.estimation.weighting.rows import WeightedRows
from eivor.estimation.weighting.whitening import whitened_by_residuals
from eivor.models.regression import Regression
from eivor.models.separable import SeparableProblem, Values
from eivor.shapes import Float


@dataclass(frozen=True)
class PoolMember:
    """One flight at one combination of the discrete nuisances.

    Parameters
    ----------
    problem : SeparableProblem
        The flight's.
    weights : WeightedRows
        Its rows, whitened by its own residual.
    fixed : mapping of str to float
        Every nuisance; of those that are continuous the value at which it was whitened.
    centre : ndarray, shape (n,)
        Linear parameters at which the response is taken.
    equations : ndarray, shape (T, q, n + 1)
        Q' of residual and regressors, at each node.
    power : ndarray, shape (T, n + 1, n + 1)
        Their products with each other.
    rows : int
        Number of rows.
    """

    problem: SeparableProblem
    weights: WeightedRows
    fixed: Values
    centre: Float[np.ndarray, " n"]
    equations: Float[np.ndarray, "T q n_plus_1"]
    power: Float[np.ndarray, "T n_plus_1 n_plus_1"]
    rows: int

    def at(self, nuisances: Mapping[str, float]) -> dict[str, float]:
        """Values of all nuisances, those of the continuous ones as given."""
        return {**self.fixed, **nuisances}

    def rows_at(self, nuisances: Mapping[str, float]) -> Regression:
        """Whitened rows."""
        return self.weights.rows(self.at(nuisances))

    def recentred(self, centre: Float[np.ndarray, " n"]) -> PoolMember:
        """The same products with the response taken elsewhere."""
        moved = np.append(1.0, self.centre - centre)
        equations, power = self.equations.copy(), self.power.copy()
        equations[:, :, 0] = self.equations @ moved
        power[:, 0, 1:] = power[:, 1:, 0] = self.power[:, 1:] @ moved
        power[:, 0, 0] = moved @ self.power @ moved
        return replace(self, centre=centre, equations=equations, power=power)

    @property
    def instruments(self) -> int:
        """Number of independent instruments."""
        return self.equations.shape[1]


def pool_member(
    problem: SeparableProblem,
    nodes: Nodes,
    at: Values,
    theta: Float[np.ndarray, " n"],
    centre: Float[np.ndarray, " n"],
) -> PoolMember:
    """Products of a flight, whitened by its residual at some values.

    Parameters
    ----------
    problem : SeparableProblem
        The flight's.
    nodes : Nodes
        Of the continuous nuisances.
    at : mapping of str to float
        Value of every nuisance.
    theta : ndarray, shape (n,)
        Linear parameters there.
    centre : ndarray, shape (n,)
        Linear parameters near which solutions are looked for; what is shared is alike in all flights.
    """
    weights = whitened_by_residuals(problem, theta, at)
    equations, power, count = [], [], 0
    for point in nodes.points:
        rows = weights.rows({**at, **point})
        seen, own = products_at(rows, centre)
        equations.append(seen)
        power.append(own)
        count = rows.response.size
    return PoolMember(problem, weights, at, centre, np.stack(equations), np.stack(power), count)


def products_at(
    rows: Regression, centre: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "q n_plus_1"], Float[np.ndarray, "n_plus_1 n_plus_1"]]:
    """Q' of residual and regressors, and their products with each other."""
    columns = np.column_stack([rows.response - rows.regressors @ centre, rows.regressors])
    return rows.instruments.T @ columns, columns.T @ columns
