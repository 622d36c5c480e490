"""Data of the literature for tests of instruments."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np
import polars as pl

import eivor as ev

GRILICHES_EXOGENOUS = ("expr", "tenure", "rns", "smsa")
GRILICHES_EXCLUDED = ("med", "kww", "age", "mrt")
GRILICHES_YEARS = (67, 68, 69, 70, 71, 73)


def housing():
    """Rents, house values (endogenous), exogenous columns, excluded instruments: Stata's own example."""
    path = resources.files("linearmodels.tests.iv.results").joinpath("housing.csv")
    table = pl.read_csv(path.read_bytes())
    regions = sorted(set(table["region"]))[1:]
    exogenous = np.column_stack([table["pcturban"], np.ones(table.height)])
    excluded = [table["faminc"], *[(table["region"] == region).cast(int) for region in regions]]
    return (
        table["rent"].to_numpy().astype(float),
        table["hsngval"].to_numpy().astype(float)[:, None],
        exogenous,
        np.column_stack(excluded),
    )


def housing_problem():
    """The same as one problem: regressors in Stata's order, exogenous ones among the instruments."""
    y, endogenous, exogenous, excluded = housing()
    return ev.regression(
        response=y,
        regressors=np.column_stack([endogenous, exogenous]),
        instruments=np.column_stack([exogenous, excluded]),
        names=["hsngval", "pcturban", "const"],
    )


def griliches():
    """Wages, schooling and IQ (endogenous), exogenous, excluded; None when statsmodels is not installed.

    linearmodels depends on statsmodels, which ships the file with ivreg2's example.
    """
    try:
        import pandas as pd
        import statsmodels
    except ImportError:
        return None
    path = Path(statsmodels.__file__).parent / "sandbox" / "regression" / "tests" / "griliches76.dta"
    if not path.is_file():
        return None
    table = pd.read_stata(path)
    years = [(table["year"] == year).to_numpy().astype(float) for year in GRILICHES_YEARS]
    exogenous = [table[name].to_numpy().astype(float) for name in GRILICHES_EXOGENOUS]
    return (
        table["lw"].to_numpy().astype(float),
        np.column_stack([table["s"], table["iq"]]).astype(float),
        np.column_stack([*exogenous, *years, np.ones(len(table))]),
        np.column_stack([table[name] for name in GRILICHES_EXCLUDED]).astype(float),
    )


def two_stage(y, endogenous, exogenous, excluded):
    """Two-stage least squares from projections: theta, columns (endogenous first), instruments, residual."""
    X, Z = np.column_stack([endogenous, exogenous]), np.column_stack([exogenous, excluded])
    fitted = Z @ np.linalg.lstsq(Z, X, rcond=None)[0]
    theta = np.linalg.lstsq(fitted, y, rcond=None)[0]
    return theta, X, Z, y - X @ theta


def autoregression(rng, shape, memory):
    """Stationary autoregressions of unit variance along the first axis."""
    from scipy.signal import lfilter

    shocks = rng.standard_normal((shape[0] + 300, *shape[1:]))
    return np.sqrt(1.0 - memory**2) * lfilter([1.0], [1.0, -memory], shocks, axis=0)[300:]
