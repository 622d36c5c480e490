"""Moments of inertia of a body that there can be: none is larger than the other two together."""

from __future__ import annotations

import numpy as np

from eivor.errors import ParameterError
from eivor.exports.simulators.parts import INERTIAS, Columns
from eivor.motions.rigid_body.parameter_ranges import NO_BODY_ALLOWANCE

#: Simulators compare without allowance for rounding.
MARGIN = 1e-6


def bodily(values: Columns) -> tuple[Columns, tuple[str, ...]]:
    """Columns whose moments of inertia are those of bodies.

    A moment that is larger than the other two together is put at their sum: simulators take no other.

    Parameters
    ----------
    values : mapping of str to ndarray, shape (n,)
        By the names of `parts`; without inertias they stay as they are.

    Returns
    -------
    mapping of str to ndarray, and tuple of str
        The columns, and a sentence where one row was changed that is the only one.

    Raises
    ------
    ParameterError
        When the moments of the only row are no body's by more than published ones err.
    """
    if not all(name in values for name in INERTIAS):
        return values, ()
    moments = np.stack([values[name] for name in INERTIAS])
    others = moments.sum(axis=0) - moments
    excess = (moments / others).max(axis=0) - 1.0
    bounded = np.minimum(moments, others * (1.0 - MARGIN))
    kept = {**values, **dict(zip(INERTIAS, bounded, strict=True))}
    if moments.shape[1] > 1 or excess[0] <= 0.0:
        return kept, ()
    shown = ", ".join(f"{one:.4g}" for one in moments[:, 0])
    if excess[0] > NO_BODY_ALLOWANCE:
        raise ParameterError(
            "moments of inertia none of which is larger than the other two together",
            f"{shown} kg m^2",
            "Correct what is given of them; or fly as the report says, about two axes at once.",
        )
    return kept, (
        f"Moments of inertia {shown} are those of no body: the largest is put at the sum of the others.",
    )
