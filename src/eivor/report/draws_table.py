"""Joint draws of a result as a table, for simulations that are to differ as the vehicle may."""

from __future__ import annotations

from typing import Literal

import numpy as np
import polars as pl

from eivor.errors import NotIdentifiedError
from eivor.inference.verdict import Status
from eivor.motions.rigid_body.known_number import KnownNumber
from eivor.report.saved_fit import SavedFit

#: The mass is drawn from a stream of its own, so that it leaves the other draws alone.
MASS_STREAM = 1


def draws_table(
    fit: SavedFit,
    n: int,
    seed: int = 0,
    mass: KnownNumber | None = None,
    *,
    delays: Literal["best", "all"] = "best",
) -> pl.DataFrame:
    """Table of joint draws.

    Parameters
    ----------
    fit : SavedFit
        The result.
    n, seed : int
        See `SavedFit.sample`.
    mass : KnownNumber, optional
        Of the vehicle [kg]: drawn from a normal distribution beside the others, cut at zero.
    delays : {"best", "all"}
        See `SavedFit.sample`.

    Returns
    -------
    polars.DataFrame
        A row for each draw; a column for each parameter of the joint vector that is identified, one for
        each value of `prediction.at` beside it that is (such as the delay), and `mass` where it is given.

    Raises
    ------
    NotIdentifiedError
        When no parameter of the joint vector is identified.
    EstimationError, UsageError
        See `SavedFit.sample`.
    """
    draws = fit.sample(n, seed, delays=delays)
    told = [name for name, one in fit.quantities.items() if one.verdict is Status.IDENTIFIED]
    columns = {name: column for name, column in draws.items() if name in told}
    if not columns:
        raise NotIdentifiedError(
            "a parameter that is identified, to draw from",
            f"a result without: {' '.join(fit.reasons)}",
            "Fly again as the report says.",
        )
    for name, value in fit.prediction.get("at", {}).items():
        if name in told and name not in columns and value is not None:
            columns[name] = np.full(n, float(value))
    if mass is not None:
        own = np.random.default_rng([seed, MASS_STREAM])
        columns["mass"] = np.maximum(mass.value + mass.std * own.standard_normal(n), 0.0)
    return pl.DataFrame(columns)
