"""Choices of a regularisation's parameter: one axis, one final class each.

| class | picks | needs |
|---|---|---|
| `GeneralizedCrossValidation` | least misfit / (equations - parameters left)^2 | equations left over |
| `DiscrepancyPrinciple` | the strongest whose misfit is no more than the noise | the noise, or these |
| `LCurve` | the corner of log distance over log misfit | nothing |
| `GivenParameter` | the number | nothing |

*Equations* are rows of a direct method, of which a triangular root keeps the count, and moments of an
instrumental one: p instruments give p equations, however many rows they are means over. The first two take
errors of the equations for independent and alike. Those of rows are when they are white; those of moments
only after a weighting by their covariance (`TwoStage`, `TwoStepRobust`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from eivor import checks
from eivor.errors import EstimationError
from eivor.linalg.regularisation import Regularisation
from eivor.linalg.shrinkage_path import ShrinkagePath
from eivor.shapes import Float

#: Parts of the L-curve along which it moves less than this share of its fastest are no corner.
SLOWEST = 1e-3


class ParameterChoice(ABC):
    """A way to choose the parameter."""

    #: The word that results use.
    name: ClassVar[str]

    def parameters(self, scheme: Regularisation) -> Float[np.ndarray, " k"]:
        """Parameters to choose from: those that the regularisation offers."""
        return scheme.parameters

    @abstractmethod
    def chosen(self, path: ShrinkagePath) -> int:
        """Number of the solution that is chosen.

        Raises
        ------
        EstimationError
            When the equations cannot tell.
        """


@dataclass(frozen=True, slots=True)
class GeneralizedCrossValidation(ParameterChoice):
    """Least of misfit / (m - parameters left)^2 (Golub, Heath and Wahba 1979)."""

    name: ClassVar[str] = "gcv"

    def chosen(self, path: ShrinkagePath) -> int:
        """Of equal ones the least regularised."""
        _check_left_over(path, "generalized cross-validation")
        return int(np.argmin(path.misfits / (path.equations - path.kept) ** 2))


@dataclass(frozen=True, slots=True)
class DiscrepancyPrinciple(ParameterChoice):
    """Strongest regularisation whose misfit is no more than the noise (Morozov 1966).

    Parameters
    ----------
    noise_power : float, optional
        Expected sum of squares of the equations' errors; None for m times the variance that the solution
        leaves which is regularised least, on m - n degrees of freedom.

    Raises
    ------
    UsageError
        When it is no number of zero or more.
    """

    name: ClassVar[str] = "discrepancy"

    noise_power: float | None = None

    def __post_init__(self) -> None:
        if self.noise_power is not None:
            checks.within(self, {"noise_power": (0.0, 1e300)}, "Leave it out to have it estimated.")

    def chosen(self, path: ShrinkagePath) -> int:
        """The last before the misfit grows beyond the noise."""
        allowed = self.noise_power
        if allowed is None:
            _check_left_over(path, "the discrepancy principle without a noise power")
            allowed = path.misfits[0] * path.equations / (path.equations - path.unknowns)
        beyond = np.flatnonzero(path.misfits > allowed)
        return max(int(beyond[0]) - 1, 0) if beyond.size else path.misfits.size - 1


@dataclass(frozen=True, slots=True)
class LCurve(ParameterChoice):
    """Corner of the curve of log distance over log misfit, where it bends most (Hansen 1992)."""

    name: ClassVar[str] = "l_curve"

    def chosen(self, path: ShrinkagePath) -> int:
        """The least regularised where there is no corner."""
        usable = np.flatnonzero((path.parameters > 0.0) & (path.misfits > 0.0) & (path.distances > 0.0))
        if usable.size < 3:
            return 0
        log_parameter, across, along = (
            np.log(values[usable]) for values in (path.parameters, path.misfits, path.distances)
        )
        dx, dy = np.gradient(across, log_parameter), np.gradient(along, log_parameter)
        speed = np.hypot(dx, dy)
        bend = dx * np.gradient(dy, log_parameter) - dy * np.gradient(dx, log_parameter)
        moving = speed > SLOWEST * speed.max()
        curvature = np.divide(bend, speed**3, out=np.zeros(bend.size), where=moving)
        turned = curvature * np.sign(log_parameter[-1] - log_parameter[0])
        corner = int(np.argmax(turned))
        return int(usable[corner]) if turned[corner] > 0.0 else 0


@dataclass(frozen=True, slots=True)
class GivenParameter(ParameterChoice):
    """A parameter that is known beforehand.

    Parameters
    ----------
    value : float
        Tikhonov's a, or a number of steps.
    """

    name: ClassVar[str] = "given"

    value: float

    def __post_init__(self) -> None:
        checks.number("value", self.value)

    def parameters(self, scheme: Regularisation) -> Float[np.ndarray, " k"]:
        """The number alone.

        Raises
        ------
        UsageError
            When it is no parameter of the regularisation.
        """
        scheme.check(self.value)
        return np.array([float(self.value)])

    def chosen(self, _path: ShrinkagePath) -> int:
        """It."""
        return 0


def check_choice(choice: object) -> None:
    """Refuse what is no choice of a parameter.

    Raises
    ------
    UsageError
        With what came instead.
    """
    checks.kind("choice", choice, ParameterChoice, "a choice", "Make one: GeneralizedCrossValidation().")


def _check_left_over(path: ShrinkagePath, what: str) -> None:
    """Equations that any parameters fit leave nothing to tell the noise by."""
    if path.equations <= path.unknowns:
        raise EstimationError(
            f"more equations than the {path.unknowns} unknowns for {what}",
            f"{path.equations:g}",
            "Give more instruments (moments count, not rows), or choose the parameter by LCurve or "
            "GivenParameter.",
        )
