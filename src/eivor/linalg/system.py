"""A theta = b: what an assembler makes and a solver solves."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from eivor import checks
from eivor.errors import NonFiniteError, ShapeError, TooFewSamplesError
from eivor.shapes import Float


@dataclass(frozen=True, slots=True)
class LinearSystem:
    """Equations A theta = b, usually more of them than unknowns.

    Parameters
    ----------
    matrix : ndarray, shape (m, n)
        A.
    right : ndarray, shape (m,)
        b.
    error_covariance : ndarray, shape (n + 1, n + 1), optional
        Covariance of the errors in one row of [A b], up to a common factor; zero rows and columns for
        columns without error. Only total least squares uses it; None stands for the identity.
    count : float, optional
        Number of equations that these are a triangular root of; None for as many as there are.
    error_degrees : float, optional
        Degrees of freedom that the error covariance was estimated on; None when it is a declared one.

    Raises
    ------
    ShapeError, NonFiniteError, TooFewSamplesError
        When shapes do not fit, a number is not finite, or there are fewer equations than unknowns.
    """

    matrix: Float[np.ndarray, "m n"]
    right: Float[np.ndarray, " m"]
    error_covariance: Float[np.ndarray, "n_plus_1 n_plus_1"] | None = None
    count: float | None = None
    error_degrees: float | None = None

    def __post_init__(self) -> None:
        for name in ("matrix", "right", "error_covariance"):
            given = getattr(self, name)
            if given is not None or name != "error_covariance":
                object.__setattr__(self, name, checks.real_array(name, given))
        if self.matrix.ndim != 2:
            raise ShapeError(
                "a matrix with two dimensions",
                f"shape {self.matrix.shape}",
                "Stack columns with column_stack.",
            )
        rows, unknowns = self.matrix.shape
        covariance = self.error_covariance
        if self.right.shape != (rows,) or (
            covariance is not None and covariance.shape != (unknowns + 1, unknowns + 1)
        ):
            raise ShapeError(
                f"{rows} right-hand sides and an error covariance of {unknowns + 1} columns for a "
                f"{rows} x {unknowns} matrix",
                f"{self.right.shape} and {None if covariance is None else covariance.shape}",
                "Check the shapes.",
            )
        if rows < unknowns:
            raise TooFewSamplesError(
                f"at least {unknowns} equations for {unknowns} unknowns",
                f"{rows}",
                "Give more samples or more instruments.",
            )
        if not (np.isfinite(self.matrix).all() and np.isfinite(self.right).all()):
            raise NonFiniteError(
                "finite equations", "NaN or infinity", "Repair or mask the samples they come from."
            )

    @property
    def equations(self) -> float:
        """Number of equations, of all that a root stands for."""
        return float(self.matrix.shape[0]) if self.count is None else self.count


@dataclass(frozen=True, slots=True)
class Shrinkage:
    """What regularisation did to a solution.

    Parameters
    ----------
    scheme, choice : str
        Names of the regularisation and of what chose its parameter.
    parameter : float
        The parameter.
    kept : float
        Number of parameters that are left, of n: the sum of the shares of each direction that are kept.
    shift : ndarray, shape (n,)
        Theta less the solution that is not regularised.
    """

    scheme: str
    choice: str
    parameter: float
    kept: float
    shift: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class Solution:
    """What a solver found.

    Parameters
    ----------
    theta : ndarray, shape (n,)
        Unknowns.
    residual : ndarray, shape (m,)
        b - A theta.
    objective : float
        What the solver minimised.
    condition : float
        Condition number of the matrix after columns were scaled to unit length.
    shrinkage : Shrinkage, optional
        What regularisation did; None without any.
    """

    theta: Float[np.ndarray, " n"]
    residual: Float[np.ndarray, " m"]
    objective: float
    condition: float
    shrinkage: Shrinkage | None = None


@dataclass(frozen=True, slots=True)
class ScoreCorrection:
    """What to add to the test functions of a direct method, and to the sensitivity of its score.

    Parameters
    ----------
    rows : ndarray, shape (rows, n)
        Added to the regressors: the part of each residual that the solver attributes to them.
    sensitivity : ndarray, shape (n, n)
        Added to G'G.
    """

    rows: Float[np.ndarray, "rows n"]
    sensitivity: Float[np.ndarray, "n n"]


class Solver(ABC):
    """One way to solve a `LinearSystem`."""

    @abstractmethod
    def solve(self, system: LinearSystem) -> Solution:
        """Solution of `system`.

        Raises
        ------
        CollinearError
            When columns are combinations of one another.
        """

    def objectives(self, systems: Float[np.ndarray, "systems m n_plus_1"]) -> Float[np.ndarray, " systems"]:
        """What `solve` would leave of many systems [A b] of one size. Performs no checks."""
        return np.array([self.solve(LinearSystem(one[:, :-1], one[:, -1])).objective for one in systems])

    @abstractmethod
    def score_correction(
        self,
        residual: Float[np.ndarray, " rows"],
        theta: Float[np.ndarray, " n"],
        error_covariance: Float[np.ndarray, "n_plus_1 n_plus_1"] | None,
        /,
    ) -> ScoreCorrection:
        """Difference between the solver's score and that of least squares, for direct equations."""
