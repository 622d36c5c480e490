"""Assemblers: which equations a regression's rows are turned into.

An assembler also says which *test functions* P its estimate makes orthogonal to the residual, which is
all that inference needs to know of it: ``P' e = 0``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.errors import InstrumentError
from eivor.linalg.system import LinearSystem
from eivor.linalg.triangular import triangular_root
from eivor.models.regression import Regression


class Assembler(ABC):
    """From a regression to a linear system."""

    @property
    @abstractmethod
    def needs_instruments(self) -> bool:
        """True when the regression must have instruments."""

    @abstractmethod
    def system(self, regression: Regression) -> LinearSystem:
        """Equations for the linear parameters."""

    @abstractmethod
    def test_functions(
        self, regression: Regression, jacobian: Float[np.ndarray, "rows n"]
    ) -> Float[np.ndarray, "rows n"]:
        """P for a Jacobian that may hold columns of nuisance parameters beside the regressors."""


@dataclass(frozen=True, slots=True)
class Direct(Assembler):
    """The rows themselves are the equations: Phi theta = y, the paper's (9), (13). Never squared."""

    @property
    def needs_instruments(self) -> bool:
        """No."""
        return False

    def system(self, regression: Regression) -> LinearSystem:
        """Triangular root of the rows [Phi y]: the same solutions, n + 1 equations."""
        root = triangular_root(np.column_stack([regression.regressors, regression.response]))
        return LinearSystem(root[:, :-1], root[:, -1], regression.error_scale)

    def test_functions(
        self,
        regression: Regression,  # noqa: ARG002 - the interface's
        jacobian: Float[np.ndarray, "rows n"],
    ) -> Float[np.ndarray, "rows n"]:
        """The Jacobian itself."""
        return jacobian


@dataclass(frozen=True, slots=True)
class Instrumental(Assembler):
    """Mean cross-products with the instruments: Psi'Phi theta = Psi'y, the paper's (23).

    Instruments must be uncorrelated with the error. A weighting may have replaced them by an
    orthonormal basis of the same space, which makes this two-stage least squares.
    """

    @property
    def needs_instruments(self) -> bool:
        """Yes."""
        return True

    def system(self, regression: Regression) -> LinearSystem:
        """Psi'Phi / rows and Psi'y / rows.

        Raises
        ------
        InstrumentError
            With fewer instruments than regressors.
        """
        rows, available = regression.instruments.shape
        if available < regression.regressors.shape[1]:
            raise InstrumentError(
                f"at least {regression.regressors.shape[1]} instruments that vary",
                f"{available}",
                "Name more exogenous signals, or use a direct method.",
            )
        Psi = regression.instruments
        return LinearSystem(Psi.T @ regression.regressors / rows, Psi.T @ regression.response / rows)

    def test_functions(
        self, regression: Regression, jacobian: Float[np.ndarray, "rows n"]
    ) -> Float[np.ndarray, "rows n"]:
        """Psi Psi'G."""
        Psi = regression.instruments
        return Psi @ (Psi.T @ jacobian)
