"""Pooled quantities: flights in vehicles, and vehicles in types, as random effects.

Flights of a vehicle: variance between by Paule and Mandel, mean with the modified interval of Hartung and
Knapp, and the next flight, see `eivor.inference.random_effects`. Vehicles of a type: their means with the
errors that one variance between flights, common to the type, gives them: so that a vehicle with a single
flight has one too, and one with two flights that happen to agree does not weigh more than it knows. Shares
are pooled as logits, so that means and intervals stay between zero and the bound.
"""

from __future__ import annotations

import numpy as np
import polars as pl
from scipy import special

from eivor.fleets.pooled_rows import SHARE, TOGETHER, VEHICLE, groups_of, own_interval, pooled
from eivor.flights.across import AcrossFlights
from eivor.inference.random_effects.between import paule_mandel, q_profile
from eivor.inference.random_effects.confidence_distribution import between_distribution
from eivor.inference.random_effects.groups import Groups
from eivor.inference.random_effects.mean import random_effects_means
from eivor.inference.random_effects.weighted import weighted
from eivor.shapes import Bool, Float

#: Columns of a mean: the value with its interval, the standard deviation between members with its own, and
#: the interval of the next member. Of logarithms the deviation is a share of the value.
POOLED = ("mean", "low", "high", "between", "between_low", "between_high", "next_low", "next_high")
#: The interval of a vehicle's only flight, as that flight tells it.
ONLY = ("only_low", "only_high")


def pooled_vehicles(rows: pl.DataFrame, across: AcrossFlights) -> pl.DataFrame:
    """Each vehicle's mean over its flights: `type`, `vehicle`, `pooled` (how many), `POOLED` and `ONLY`.

    Parameters
    ----------
    rows : polars.DataFrame
        Those that say something of the quantity, in order.
    across : AcrossFlights
        The quantity.
    """
    about, groups = groups_of(rows, *VEHICLE)
    y, v = (rows.select(one).to_series().to_numpy() for one in pooled(across))
    first = rows[groups.starts].select(own_interval(across))
    only = (
        pl.when(pl.Series(groups.sizes == 1)).then(first[end]).alias(name)
        for name, end in zip(ONLY, first.columns, strict=True)
    )
    shares = rows[SHARE].to_numpy()[groups.starts]
    return _told(about, groups, y, v, across, shares).with_columns(*only)


def pooled_types(rows: pl.DataFrame, across: AcrossFlights) -> pl.DataFrame:
    """Each type's mean over its vehicles: `type`, `pooled` (how many vehicles), and `POOLED`.

    Vehicles whose type is not known, and logs without a vehicle, are of no type.

    Parameters
    ----------
    rows, across
        As for `pooled_vehicles`.
    """
    rows = rows.filter(pl.col(TOGETHER) == pl.col("type"))
    about, groups = groups_of(rows, *VEHICLE)
    types, vehicles = groups_of(about, "type")
    y, v = (rows.select(one).to_series().to_numpy() for one in pooled(across))
    means = weighted(groups, y, v, paule_mandel(groups, y, v, together=vehicles))
    shares = rows[SHARE].to_numpy()[groups.starts][vehicles.starts]
    return _told(types, vehicles, means.mean, 1.0 / means.total, across, shares)


def _told(
    about: pl.DataFrame,
    groups: Groups,
    y: Float[np.ndarray, " rows"],
    v: Float[np.ndarray, " rows"],
    across: AcrossFlights,
    shares: Bool[np.ndarray, " groups"],
) -> pl.DataFrame:
    found = random_effects_means(groups, y, v, paule_mandel(groups, y, v))
    known = between_distribution(groups, y, v)
    half, ahead = known.mean_half_widths(found), known.next_half_widths(found.value)
    low, high = q_profile(groups, y, v, near=found.between)
    ends = np.stack(
        [found.value, *(found.value + sign * one for one in (half, ahead) for sign in (-1.0, 1.0))]
    )
    largest = across.largest
    if across.logarithm:
        with np.errstate(over="ignore"):
            ends[:, ~shares] = np.exp(ends[:, ~shares])
    ends[:, shares] = np.where(np.isfinite(ends[:, shares]), largest * special.expit(ends[:, shares]), np.nan)
    mean, mean_low, mean_high, next_low, next_high = ends
    between = np.sqrt([found.between, low, high])
    between[:, shares] *= 1.0 - mean[shares] / largest  # a share of the value, not of the odds
    columns = (mean, mean_low, mean_high, *between, next_low, next_high)
    known_ends = np.isfinite(half)
    numbers = dict(zip(POOLED, columns, strict=True))
    return about.with_columns(
        pl.Series("pooled", groups.sizes),
        *(
            pl.Series(
                name, np.where(np.isfinite(one) & (known_ends | (name == "mean")), one, np.nan)
            ).fill_nan(None)
            for name, one in numbers.items()
        ),
    )
