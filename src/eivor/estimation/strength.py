"""Whether the instruments of a plain problem are strong enough to be believed."""

from __future__ import annotations

import warnings

import numpy as np
from jaxtyping import Float

from eivor.errors import WeakInstrumentsWarning
from eivor.estimation.moments import CrossMoments, Moments
from eivor.inference.diagnostics.instrument_tests import first_stage_of_products
from eivor.inference.verdict import Reason, Status
from eivor.linalg.system import LinearSystem
from eivor.models.parameter import Parameter

#: First-stage F below which instruments are weak.
STRONG_FIRST_STAGE = 10.0


def first_stage_strengths(moments: Moments) -> Float[np.ndarray, " n"] | None:
    """Conditional first-stage F of each regressor; None when the moments do not tell.

    Of compensated equations without the noise that instruments and regressors share, which is no strength.
    """
    if not isinstance(moments, CrossMoments) or moments.instruments is None or moments.regressors is None:
        return None
    cross = moments.products[:, :-1]
    shared = None if moments.noise is None else moments.noise[:, :-1]
    return first_stage_of_products(moments.instruments, cross, moments.regressors, moments.count, shared)


def weak_instruments(
    moments: Moments, system: LinearSystem, parameters: tuple[Parameter, ...]
) -> tuple[Reason, ...]:
    """Grounds for the status weak, told as a warning too; none when strength is not known.

    Warns
    -----
    WeakInstrumentsWarning
        When a conditional first-stage F is below ten.
    """
    strengths = first_stage_strengths(moments)
    if strengths is None:
        return ()
    weakest = int(np.argmin(strengths))
    if strengths[weakest] >= STRONG_FIRST_STAGE:
        return ()
    lengths = np.sqrt(np.einsum("ij,ij->j", system.matrix, system.matrix))
    singular = np.linalg.svd(system.matrix / lengths, compute_uv=False)
    reason = Reason(
        Status.WEAK,
        f"The instruments hardly move the regressor of {parameters[weakest].name}: first-stage F is "
        f"{strengths[weakest]:.2g}, and {STRONG_FIRST_STAGE:.0f} is needed (singular values of the scaled "
        f"equations: {', '.join(f'{value:.3g}' for value in singular)}).",
        "A white input is no instrument for itself once delayed: use generalized_iv with lag 0, other "
        "instruments, or an input with memory. The sets of eivor.anderson_rubin_set hold all the same.",
    )
    warnings.warn(f"{reason.sentence} {reason.remedy}", WeakInstrumentsWarning, stacklevel=4)
    return (reason,)
