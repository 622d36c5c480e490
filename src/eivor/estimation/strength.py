"""Whether the instruments of a plain problem are strong enough to be believed."""

from __future__ import annotations

import sys
import warnings

import numpy as np

from eivor.errors import WeakInstrumentsWarning
from eivor.estimation.moments import CrossMoments, Moments
from eivor.inference.diagnostics.instrument_tests import first_stage_of_products
from eivor.inference.diagnostics.strength import STRONG_FIRST_STAGE
from eivor.inference.verdict import Reason, Status
from eivor.linalg.system import LinearSystem
from eivor.models.equation import Parameter
from eivor.shapes import Float

#: Columns whose squared correlation is nearer to one than this are the same.
SAME_COLUMN = 1e-9


def first_stage_strengths(moments: Moments) -> Float[np.ndarray, " n"] | None:
    """Conditional first-stage F of each regressor; None when the moments do not tell.

    Of compensated equations without the noise that instruments and regressors share, which is no strength.
    """
    if not isinstance(moments, CrossMoments) or moments.instruments is None or moments.regressors is None:
        return None
    cross = moments.equations[:, :-1]
    shared = None if moments.noise is None else moments.noise[:, :-1]
    return first_stage_of_products(moments.instruments, cross, moments.regressors, moments.rows, shared)


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
        "An input that hardly moves tells nothing, and a white one is no instrument for itself once delayed: "
        "use generalized_iv with lag 0, other instruments, or an input with memory. The sets of "
        "eivor.anderson_rubin_set hold all the same.",
    )
    warnings.warn(f"{reason.sentence} {reason.remedy}", WeakInstrumentsWarning, stacklevel=user_level())
    return (reason,)


def overstated_noise(moments: Moments, parameters: tuple[Parameter, ...]) -> tuple[Reason, ...]:
    """Grounds for the status weak where more noise is taken out of a column than there is of it.

    Only of columns that are instruments themselves: their mean squares hold the whole of their noise.
    """
    if not isinstance(moments, CrossMoments) or moments.noise is None:
        return ()
    if moments.instruments is None or moments.regressors is None:
        return ()
    cross, noise = moments.equations[:, :-1], moments.noise[:, :-1]
    powers = np.outer(np.diag(moments.instruments), np.diag(moments.regressors))
    itself = (powers > 0.0) & (cross**2 >= (1.0 - SAME_COLUMN) * powers)
    return tuple(
        Reason(
            Status.WEAK,
            f"The noise that is declared of the regressor of {parameters[column].name} is all there is of"
            f" it, or more: {np.sqrt(noise[row, column] / cross[row, column]):.3g}"
            " times its root mean square.",
            "Declare a smaller noise, or use instruments that share none of it.",
        )
        for row, column in np.argwhere(itself & (noise * np.sign(cross) >= np.abs(cross))).tolist()
    )


def user_level() -> int:
    """Level, as `warnings.warn` of the calling function counts, of the line that called Eivor.

    Chunks, moments and rows come here by ways of different depth.
    """
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "eivor":
        frame, level = frame.f_back, level + 1
    return level
