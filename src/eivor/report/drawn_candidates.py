"""Candidates of a saved result, and joint draws at one of them or at all."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eivor.inference.covariances.covariance import JointCovariance
from eivor.inference.joint_draws import joint_draws
from eivor.inference.ordered_choices import shares_by_likelihood, shares_in_order
from eivor.shapes import Float


@dataclass(frozen=True)
class SavedCandidate:
    """Joint vector and covariance at one combination of the discrete nuisances.

    Parameters
    ----------
    at : mapping of str to float
        Value of every nuisance.
    best : bool
        Whether it is the one that fits best.
    values : ndarray, shape (n,)
        Joint vector.
    covariance : JointCovariance
        Of the joint vector.
    excess : float
        What its criterion is above the least one that it competes with.
    """

    at: Mapping[str, float]
    best: bool
    values: Float[np.ndarray, " n"]
    covariance: JointCovariance
    excess: float = 0.0


def drawn_at(
    candidate: SavedCandidate,
    names: Sequence[str],
    lowest: Float[np.ndarray, " names"],
    n: int,
    rng: np.random.Generator,
) -> dict[str, Float[np.ndarray, " n"]]:
    """Joint draws at a candidate, one array for each name; what is below its lowest value is put there."""
    draws = np.maximum(joint_draws(candidate.values, candidate.covariance, n, rng), lowest)
    return dict(zip(names, draws.T, strict=True))


def drawn_at_all(
    candidates: Sequence[SavedCandidate],
    names: Sequence[str],
    lowest: Float[np.ndarray, " names"],
    n: int,
    rng: np.random.Generator,
) -> dict[str, Float[np.ndarray, " n"]]:
    """Joint draws at all candidates, and one array more for each discrete nuisance.

    One that they differ in alone has its confidence distribution; combinations of several are drawn by their
    likelihood.
    """
    apart = [
        name
        for name in candidates[0].at
        if name not in names and len({one.at[name] for one in candidates}) > 1
    ]
    ordered = sorted(candidates, key=lambda one: [one.at[name] for name in apart])
    excesses = np.array([one.excess for one in ordered])
    shares = shares_in_order(excesses) if len(apart) == 1 else shares_by_likelihood(excesses)
    parts = [
        drawn_at(one, names, lowest, int(count), rng)
        | {name: np.full(count, value) for name, value in one.at.items() if name not in names}
        for one, count in zip(ordered, rng.multinomial(n, shares), strict=True)
        if count
    ]
    order = rng.permutation(n)
    return {name: np.concatenate([part[name] for part in parts])[order] for name in parts[0]}
