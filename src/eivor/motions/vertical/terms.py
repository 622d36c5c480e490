"""Optional terms of the vertical equation: what it leaves out unless a user asks for it.

Each is one more column with a parameter of its own:

* quadratic drag: - K_2 z' |z'|, K_2 in 1/m;
* ground effect: g (U / mean U) k (R / h)^2, with the height h over the ground and the rotors' radius R. k is
  the thrust that is gained one radius above the ground, as a share of the weight; theory has 1/16 for a rotor
  by itself (Cheeseman and Bennett 1955);
* voltage: g (U / mean U) n (V / V_0 - 1), with the supply's voltage V and its mean V_0 over the flights. n is
  the power of the voltage that thrust goes with: 2 where rotor speed follows the voltage.

The last two bend thrust, hence go with U and lag behind the command as it does. At hover away from the ground
and at the voltage V_0 all of them vanish: there the hover input is told, and the gain.

Instruments are the same functions of velocity, input and height as far as the references explain them. A
voltage answers the load within a second as well, so that of it what the references explain counts, and a
cubic in time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from eivor.models.equation import Parameter
from eivor.shapes import Float

#: Names of what the model leaves out, in tests that it is missed.
DRAG, GROUND, SUPPLY = "quadratic_drag", "ground_effect", "supply"
#: Heights below this count as this, in rotor radii.
LEAST_RADII = 0.5
#: Power of the polynomial of time that is an instrument for the voltage.
TREND = 3

Column = Float[np.ndarray, " n"]


@dataclass(frozen=True)
class TermIngredients:
    """What optional terms of one flight are made of, arrays of shape (n,).

    Parameters
    ----------
    velocity : ndarray
        z' [m/s].
    lift : ndarray
        The mapped input over its mean, times g [m/s^2].
    radii : ndarray, optional
        Height over the ground in rotor radii.
    voltage : ndarray, optional
        Voltage over that which the gain belongs to, less one.
    """

    velocity: Column
    lift: Column
    radii: Column | None = None
    voltage: Column | None = None


class OptionalTerm(ABC):
    """A term that a user may add to the equation."""

    word: ClassVar[str]
    """As it is asked for."""
    meaning: ClassVar[str]
    """What it is."""
    parameter: ClassVar[Parameter]
    """Its coefficient."""
    written: ClassVar[str]
    """As it stands in the equation, with its sign."""
    symbols: ClassVar[str]
    """What its symbols are; empty when the equation tells."""
    left_out: ClassVar[str]
    """Name of the test that it is missed."""

    @abstractmethod
    def column(self, of: TermIngredients) -> Column:
        """Column of the parameter; performs no checks."""


@final
@dataclass(frozen=True, slots=True)
class QuadraticDrag(OptionalTerm):
    """- K_2 z' |z'|."""

    word = "quadratic-drag"
    meaning = "drag that grows with the square of the speed"
    parameter = Parameter("quadratic_drag", "1/m")
    written = "- K_2 z'|z'|"
    symbols = ""
    left_out = DRAG

    def column(self, of: TermIngredients) -> Column:
        """-z'|z'|."""
        return -of.velocity * np.abs(of.velocity)


@final
@dataclass(frozen=True, slots=True)
class GroundEffect(OptionalTerm):
    """+ k (U / mean U) g (R / h)^2."""

    word = "ground-effect"
    meaning = "thrust that grows as one over the squared height over the ground"
    parameter = Parameter("ground_effect", "")
    written = "+ k g (U/mean U) (R/h)²"
    symbols = "h the height over the ground, R a rotor's radius"
    left_out = GROUND

    def column(self, of: TermIngredients) -> Column:
        """Lift over the squared height in radii."""
        radii = np.zeros(0) if of.radii is None else of.radii
        return of.lift * np.maximum(radii, LEAST_RADII) ** -2.0


@final
@dataclass(frozen=True, slots=True)
class VoltageTerm(OptionalTerm):
    """+ n (U / mean U) g (V / V_0 - 1)."""

    word = "voltage"
    meaning = "thrust that follows the battery's voltage"
    parameter = Parameter("voltage_exponent", "")
    written = "+ n g (U/mean U) (V/V_0 - 1)"
    symbols = "V the battery's voltage, V_0 its mean"
    left_out = SUPPLY

    def column(self, of: TermIngredients) -> Column:
        """Lift times the voltage's share beyond the mean."""
        return of.lift * (np.zeros(0) if of.voltage is None else of.voltage)


#: By the words of the command line.
TERMS: dict[str, OptionalTerm] = {
    term.word: term for term in (QuadraticDrag(), GroundEffect(), VoltageTerm())
}


def term_instruments(
    terms: Sequence[OptionalTerm],
    of: TermIngredients,
    references: Float[np.ndarray, "n p"],
    runs: Sequence[slice],
) -> Float[np.ndarray, "n terms"]:
    """An instrument for each term; performs no checks.

    Parameters
    ----------
    terms : sequence of OptionalTerm
        The terms.
    of : TermIngredients
        As measured.
    references : ndarray, shape (n, p)
        Instruments of the equation without them.
    runs : sequence of slice
        Stretches used.
    """
    parts = [of.velocity, of.lift, *([] if of.radii is None else [of.radii])]
    velocity, lift, *radii = explained(references, runs, np.column_stack(parts)).T
    voltage = None
    if of.voltage is not None:
        time = np.linspace(-1.0, 1.0, of.voltage.size)
        trend = np.column_stack([time**power for power in range(1, TREND + 1)])
        voltage = explained(np.column_stack([references, trend]), runs, of.voltage[:, None])[:, 0]
    made = TermIngredients(velocity, lift, radii[0] if radii else None, voltage)
    return np.column_stack([term.column(made) for term in terms])


def explained(
    by: Float[np.ndarray, "n p"], runs: Sequence[slice], columns: Float[np.ndarray, "n k"]
) -> Float[np.ndarray, "n k"]:
    """Columns as far as others explain them by least squares over the runs, a constant among them."""
    B = np.column_stack([by, np.ones(len(by))])
    used = np.concatenate([np.arange(run.start, run.stop) for run in runs])
    fitted: Float[np.ndarray, "n k"] = B @ np.linalg.lstsq(B[used], columns[used], rcond=None)[0]
    return fitted
