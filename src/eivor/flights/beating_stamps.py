"""Stamps that jitter too much to show a finer step by their distances, but beat with it.

A log of every h_l seconds keeps of a controller's commands, one every h_c, the latest: its stamp is earlier
than the log's even instant n h_l by h_c frac(phase + n h_l / h_c). Stamps that err by as much hide this saw
in each distance, and not in all of them: it is a line in the spectrum of what stamps are off even instants,
of the frequency frac(h_l / h_c) per stamp. The steps h_l / (k +- f) make that line; of those whose saw has
the size that is seen, the controller's explains most. Where h_c divides h_l there is no saw, and nothing is
told.
"""

from __future__ import annotations

import numpy as np

from eivor.shapes import Float, Int

#: A line has so many times the power that white noise has on average, which chance reaches in no log.
LINE = 25.0
#: Lines below this frequency are clocks that drift.
SLOWEST = 0.02
#: Frequencies looked at closely beside the highest of the spectrum, and phases of the saw.
CLOSELY, PHASES = 33, 32
#: The size of the saw may be off by this share.
SIZE = 0.15
#: A distance of more medians than this is a pause.
PAUSE = 2.5
#: Fewer stamps tell nothing; so many tell enough.
FEWEST, MOST_STAMPS = 500, 6000
#: Over so many instants, pauses among them, a phase is followed.
MOST_INSTANTS = 20 * MOST_STAMPS


def beating_step(time_s: Float[np.ndarray, " n"], shortest_s: float) -> float | None:
    """Time between two commands h_c [s] that jittering stamps beat with; None where they do not.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Stamps [s], increasing.
    shortest_s : float
        No controller is quicker [s].
    """
    if time_s.size < FEWEST:
        return None
    number = _even_instants(time_s[:MOST_STAMPS])
    number = number[number <= MOST_INSTANTS]
    if number.size < FEWEST:
        return None
    logged, first = np.polyfit(number, time_s[: number.size], 1).tolist()
    away = time_s[: number.size] - first - logged * number
    beat = _line(number, away)
    if beat is None:
        return None
    most = int(logged / shortest_s)
    steps = [logged / (k + sign * beat) for k in range(1, most + 1) for sign in (-1.0, 1.0)]
    found = [(step, *_saw(number, away, logged / step)) for step in steps if shortest_s <= step < logged]
    fitting = [(power, step) for step, size, power in found if abs(size / step - 1.0) <= SIZE]
    return max(fitting)[1] if fitting else None


def _even_instants(time_s: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Number of each stamp's even instant."""
    steps = np.diff(time_s)
    pause = steps > PAUSE * np.median(steps)
    usual = float(steps[~pause].mean())
    whole = np.cumsum(np.where(pause, np.rint(steps / usual), 1.0))
    return np.asarray(np.concatenate([[0], whole]).astype(np.int64))


def _line(number: Int[np.ndarray, " n"], away: Float[np.ndarray, " n"]) -> float | None:
    """Frequency of the strongest line; None where none is beyond chance."""
    row = np.zeros(int(number[-1]) + 1)
    row[number] = away
    power = np.abs(np.fft.rfft(row)) ** 2 / float(away @ away)
    frequency = np.fft.rfftfreq(row.size)
    power[frequency < SLOWEST] = 0.0
    place = int(np.argmax(power))
    if power[place] < LINE:
        return None
    near = frequency[place] + np.linspace(-1.0, 1.0, CLOSELY) / row.size
    near = np.append(near[near < 0.5], 0.5) if near[-1] > 0.5 else near
    found = np.abs(np.exp(-2j * np.pi * np.outer(near, number)) @ away)
    return float(near[int(np.argmax(found))])


def _saw(number: Int[np.ndarray, " n"], away: Float[np.ndarray, " n"], turns: float) -> tuple[float, float]:
    """Size [s] of the saw of so many turns per stamp at its best phase, and what it explains."""
    phases = (np.arange(PHASES) + 0.5)[:, None] / PHASES
    saws = -np.mod(phases + np.mod(turns, 1.0) * number, 1.0)
    saws -= saws.mean(axis=1, keepdims=True)
    along, own = saws @ away, np.sum(saws**2, axis=1)
    best = int(np.argmax(along / np.sqrt(own)))
    return float(along[best] / own[best]), float(along[best] ** 2 / own[best])
