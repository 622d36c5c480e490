"""Climb rates of a run under drag that grows with the square of the speed, from its input alone.

v' = f - K v - K_2 v |v| + c: over a step the rate K + K_2 |v| is that at its beginning. Trim c and start v(0)
suit what was measured best, by Gauss and Newton's steps with the sensitivities, whose rate is K + 2 K_2 |v|.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from eivor.errors import EstimationError
from eivor.shapes import Bool, Float
from eivor.signals.recording import LARGEST_VALUE

#: Most steps towards the best trim and start, and when they have arrived.
STEPS, ARRIVED = 8, 1e-9
#: Speed beyond which drag grows no more [m/s].
FASTEST = 100.0
#: Its exponential is a number yet.
LARGEST_EXPONENT = 700.0


def dragged_run(
    driven: Float[np.ndarray, " n"],
    measured: Float[np.ndarray, " n"],
    counted: Bool[np.ndarray, " n"] | slice,
    friction: float,
    drag: float,
    step_s: float,
) -> Float[np.ndarray, " counted"]:
    """Answer to the input of one run, at the samples that count.

    Parameters
    ----------
    driven, measured : ndarray, shape (n,)
        Force of the input [m/s^2], and the climb rate [m/s].
    counted : ndarray of bool or slice
        Samples that count.
    friction, drag : float
        K [1/s] and K_2 [1/m].
    step_s : float
        Time between samples [s].

    Raises
    ------
    EstimationError
        When the climb rate grows beyond all numbers.
    """
    force, wanted = driven - driven.mean(), measured[counted]
    trim, start = 0.0, float(wanted[0])
    for _ in range(STEPS):
        answer, by_trim, by_start = (
            one[counted] for one in _answers(force + trim, start, friction, drag, step_s)
        )
        step = np.linalg.lstsq(np.column_stack([by_trim, by_start]), wanted - answer, rcond=None)[0]
        trim, start = trim + float(step[0]), start + float(step[1])
        if np.abs(step).max() < ARRIVED:
            break
    return np.asarray(_answers(force + trim, start, friction, drag, step_s)[0][counted])


def _answers(
    force: Float[np.ndarray, " n"], start: float, friction: float, drag: float, step_s: float
) -> Float[np.ndarray, "3 n"]:
    """Climb rate, and its derivatives by the trim and by the start."""
    v, by_trim, by_start = start, 0.0, 1.0
    found = [(v, by_trim, by_start)]
    halves = (0.5 * step_s * force).tolist()
    for before, after in pairwise(halves):
        pushed = drag * min(abs(v), FASTEST)
        decay = math.exp(min(-step_s * (friction + pushed), LARGEST_EXPONENT))
        slower = decay * math.exp(min(-step_s * pushed, LARGEST_EXPONENT))
        v = decay * (v + before) + after
        by_trim = slower * (by_trim + 0.5 * step_s) + 0.5 * step_s
        by_start *= slower
        found.append((v, by_trim, by_start))
    answers = np.array(found).T
    if not (np.abs(answers) <= LARGEST_VALUE).all():
        raise EstimationError(
            "numbers with which the predicted climb rate stays finite",
            f"a friction of {friction:.3g} 1/s and a drag of {drag:.3g} 1/m, with which it grows",
            "Identify the flight without the term quadratic-drag, or fly faster.",
        )
    return answers
