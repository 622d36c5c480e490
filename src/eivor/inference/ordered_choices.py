"""How often joint draws take each value of a nuisance that is tried value by value, such as a delay.

The criterion's excess x over the least, chi-square with one degree of freedom where a value is the true one,
has the signed root r = -sqrt(x) below the value that fits best and +sqrt(x) above it. Then Phi(r) is the
nuisance's confidence distribution (Barndorff-Nielsen and Cox 1994; Schweder and Hjort 2016): its quantiles
are the ends of one-sided intervals. Each value has what lies between the middles to its neighbours, and the
first and the last also what lies beyond them, as what cannot be below a bound is put there.

Shares in proportion to the likelihood would be quantiles of a posterior, under which a value at the end of
what is possible, such as no delay, is beyond every one-sided bound too often.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from eivor.shapes import Float


def shares_in_order(excesses: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Share of each value. Performs no checks.

    Parameters
    ----------
    excesses : ndarray, shape (n,)
        Of the criterion over the least, in the order of the nuisance's values.

    Returns
    -------
    ndarray, shape (n,)
        They add up to one.
    """
    best = int(np.argmin(excesses))
    roots = np.sqrt(np.maximum(excesses, 0.0))
    above = np.maximum.accumulate(roots[best:])
    below = -np.maximum.accumulate(roots[best::-1])[::-1]
    signed = np.concatenate([below, above[1:]])
    middles = 0.5 * (signed[1:] + signed[:-1])
    shares: Float[np.ndarray, " n"] = np.diff(special.ndtr(middles), prepend=0.0, append=1.0)
    return shares


def shares_by_likelihood(excesses: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Share of each combination of several nuisances, which have no order. Performs no checks."""
    likelihoods = np.exp(-0.5 * excesses)
    shares: Float[np.ndarray, " n"] = likelihoods / likelihoods.sum()
    return shares
