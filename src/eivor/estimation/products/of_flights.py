"""Products of each flight's rows, at several values of the nuisances.

What costs time does not depend on which flights are drawn: the rows of each flight are multiplied once at
every node of the nuisances, and a replicate adds the products of its flights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from eivor.estimation.weighting.rows import WeightedRows
from eivor.inference.products import Products, products_of_rows
from eivor.models.regression import Regression
from eivor.models.separable import Values


def flight_products(weights: WeightedRows, points: Sequence[Values]) -> Products:
    """Products of all columns of weighted rows, flight after flight, a block for each of some values.

    Flights are in the order of their numbers; those without rows are not among them.
    """
    tables = [products_by_flight(weights.rows(at)) for at in points]
    counts, sums = (
        np.stack(parts, axis=1)
        for parts in zip(*((table.counts, table.sums) for table in tables), strict=True)
    )
    return replace(tables[0], counts=counts.ravel(), sums=sums.reshape(-1, *sums.shape[2:]))


def products_by_flight(rows: Regression) -> Products:
    """Products of all columns of rows, a block for each flight."""
    flights = rows.layout.flight_of_row
    order = np.argsort(flights, kind="stable")
    edges = np.append(np.flatnonzero(np.diff(flights[order], prepend=-1)), order.size)
    return products_of_rows(
        rows.instruments[order], rows.regressors[order], rows.response[order], edges=edges
    )
