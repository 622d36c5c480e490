"""Whether axes agree about the lag, where no instrument says whether something else moved the vehicle.

What disturbs a flight comes back through the controller, and a direct method takes the answer for a cause.
That answer is at once, so that the lag comes out too short, and differently so about each axis, as rotors and
disturbances share its motion differently. All axes have one lag: what each would change it by is one step of
its own rows' least squares from the common estimate, of all its parameters together,

    delta = d'e / d'd,   with d the rows' derivative by the lag beside what the axis' other columns explain.

Whitened rows scatter independently of one another, so that delta has the variance s^2 / d'd, and

    Q = sum (delta - mean)^2 / var

over the axes that rotors drive is compared with chi-square.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from eivor.estimation.estimate import Estimate
from eivor.inference.diagnostics.diagnostic import BEYOND_DOUBT
from eivor.inference.quantiles import chi_square_tail
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.motions.rigid_body.parameters import FORCE_Z, PITCH, ROLL, YAW
from eivor.shapes import Float

#: Axes that rotors drive, and what they are called.
DRIVEN = {ROLL: "roll", PITCH: "pitch", YAW: "yaw", FORCE_Z: "thrust"}
#: A step is no longer small, and its size says little, beyond this share of the lag.
FAR = 0.5

_P_VALUE, _COMMON, _CHANGE = "lag_agreement_p", "lag_of_all_s", "_lag_change_s"


@dataclass(frozen=True, slots=True)
class LagsApart:
    """Axes that do not agree about the lag.

    Parameters
    ----------
    lag_s : float
        Of all axes together [s].
    changes_s : mapping of str to float
        By the axis, what it would change it by [s].
    p_value : float
        Of as large a disagreement by chance.
    """

    lag_s: float
    changes_s: Mapping[str, float]
    p_value: float

    @classmethod
    def of_numbers(cls, numbers: Mapping[str, float]) -> LagsApart | None:
        """Those of the numbers of a result; None where there are none in them."""
        if _P_VALUE not in numbers:
            return None
        names = (name for name in DRIVEN.values() if name + _CHANGE in numbers)
        return cls(numbers[_COMMON], {name: numbers[name + _CHANGE] for name in names}, numbers[_P_VALUE])

    @property
    def numbers(self) -> dict[str, float]:
        """The same as numbers of a result."""
        changes = {name + _CHANGE: change for name, change in self.changes_s.items()}
        return {_P_VALUE: self.p_value, _COMMON: self.lag_s, **changes}

    @property
    def sentence(self) -> str:
        """What each axis says."""
        each = ", ".join(f"{name} {self._asked(change)}" for name, change in self.changes_s.items())
        return (
            f"The axes disagree about the lag (p-value {self.p_value:.1g}). For all of them it is "
            f"{1e3 * self.lag_s:.0f} ms; by itself {each}."
        )

    @property
    def remedy(self) -> str:
        """What to do about it."""
        return (
            "What moves the vehicle beside its rotors comes back through the controller: log setpoints, by "
            "which the two are told apart, and fly in calm air. A delay that was given wrong shows alike."
        )

    def _asked(self, change: float) -> str:
        if abs(change) <= FAR * self.lag_s:
            return f"asks for {1e3 * (self.lag_s + change):.0f} ms"
        return f"for a much {'longer' if change > 0.0 else 'shorter'} one"


def lags_apart(estimate: Estimate) -> LagsApart | None:
    """Axes that disagree about the lag beyond doubt; None where they agree, or instruments say more.

    Parameters
    ----------
    estimate : Estimate
        Of whitened rows.
    """
    if estimate.best.solved.assembler.needs_instruments:
        return None
    found = {name: (change, variance) for name, change, variance in _changes(estimate)}
    if len(found) < 2:
        return None
    changes, variances = np.array(list(found.values())).T
    mean = float(np.average(changes, weights=1.0 / variances))
    p_value = chi_square_tail(float(np.sum((changes - mean) ** 2 / variances)), len(found) - 1)
    if not p_value < BEYOND_DOUBT:
        return None
    lag_s = sum(estimate.best.at.get(one, 0.0) for one in (ACTUATOR_LAG.name, DELAY.name))
    return LagsApart(lag_s, dict(zip(found, changes.tolist(), strict=True)), p_value)


def _changes(estimate: Estimate) -> Iterator[tuple[str, float, float]]:
    """Of each axis that rotors drive, what it would change the lag by, and the variance of that."""
    best = estimate.best
    sought = [profile.nuisance.name for profile in best.profiles]
    if ACTUATOR_LAG.name not in sought:
        return
    rows, moves = best.rows, best.solved.nuisance_columns[:, sought.index(ACTUATOR_LAG.name)]
    residual, axes = rows.response - rows.regressors @ best.theta, rows.layout.axis_of_row
    for axis, name in DRIVEN.items():
        own = axes == axis
        beside = _beside(moves[own], rows.regressors[own])
        squares = float(beside @ beside)
        if squares > 0.0:
            change = float(beside @ residual[own]) / squares
            yield name, change, float(np.mean(residual[own] ** 2)) / squares


def _beside(
    column: Float[np.ndarray, " rows"], others: Float[np.ndarray, "rows k"]
) -> Float[np.ndarray, " rows"]:
    """What of a column other columns do not explain."""
    sizes = np.linalg.norm(others, axis=0)
    basis, _ = np.linalg.qr(others[:, sizes > 0.0] / sizes[sizes > 0.0])
    left: Float[np.ndarray, " rows"] = column - basis @ (basis.T @ column)
    return left
