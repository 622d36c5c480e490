"""Assemblers: which equations a problem is turned into, by way of which moments.

An assembler also says which *test functions* P its estimate makes orthogonal to the residual,
``sum_t (P_t e_t + constant) = 0``, which is all that inference needs to know of it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from eivor.errors import InstrumentError, MissingNoiseError, UsageError
from eivor.estimation.moments import CrossMoments, Moments, TriangularMoments
from eivor.estimation.products import MeanProducts, mean_cross_products, root_of_rows
from eivor.linalg.system import LinearSystem
from eivor.models.regression import LinearProblem, Regression, RowBlock


class Assembler(ABC):
    """From a problem to moments, and from moments to a linear system."""

    @property
    @abstractmethod
    def needs_instruments(self) -> bool:
        """True when the problem must have instruments."""

    @property
    @abstractmethod
    def moment_equations(self) -> bool:
        """True when the equations are mean cross-products, False when they are rows or their root."""

    @abstractmethod
    def moments(self, problem: LinearProblem, *, instrument_products: bool = False) -> Moments:
        """Summary of the problem's rows; with mean(psi psi') and mean(phi phi') when they are needed."""

    @abstractmethod
    def system(self, moments: Moments) -> LinearSystem:
        """Equations for the parameters.

        Raises
        ------
        UsageError
            When the moments are of another assembler's kind.
        """

    @abstractmethod
    def test_functions(self, rows: Regression | RowBlock) -> Float[np.ndarray, "rows p"]:
        """Functions psi whose products with the residual the equations are made of."""

    @abstractmethod
    def score_constants(
        self, problem: LinearProblem, theta: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " p"]:
        """What the measurement noises add to each row's products on average, C theta - c."""


@dataclass(frozen=True, slots=True)
class Direct(Assembler):
    """The rows themselves are the equations: Phi theta = y, the paper's (9), (13). Never squared."""

    @property
    def needs_instruments(self) -> bool:
        """No."""
        return False

    @property
    def moment_equations(self) -> bool:
        """No."""
        return False

    def moments(self, problem: LinearProblem, *, instrument_products: bool = False) -> TriangularMoments:
        """Triangular root of [Phi y], and its noise covariance where that is declared."""
        del instrument_products
        count, root = root_of_rows(problem)
        try:
            noise = problem.regressor_noise_covariance()
        except MissingNoiseError:
            noise = None
        return TriangularMoments(count, root, noise)

    def system(self, moments: Moments) -> LinearSystem:
        """The root's rows: the same solutions, n + 1 equations."""
        if not isinstance(moments, TriangularMoments):
            raise _other_kind("triangular moments", moments)
        return LinearSystem(moments.root[:, :-1], moments.root[:, -1], moments.noise)

    def test_functions(self, rows: Regression | RowBlock) -> Float[np.ndarray, "rows p"]:
        """The regressors."""
        return rows.regressors

    def score_constants(
        self, problem: LinearProblem, theta: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " p"]:
        """Zero."""
        del problem
        return np.zeros(theta.size)


@dataclass(frozen=True, slots=True)
class Instrumental(Assembler):
    """Mean cross-products with the instruments: Psi'Phi theta = Psi'y, the paper's (23).

    Instruments must be uncorrelated with the error; those that share declared measurement noise with a
    regressor or the response are refused.
    """

    @property
    def needs_instruments(self) -> bool:
        """Yes."""
        return True

    @property
    def moment_equations(self) -> bool:
        """Yes."""
        return True

    def moments(self, problem: LinearProblem, *, instrument_products: bool = False) -> CrossMoments:
        """mean(psi [phi' y]).

        Raises
        ------
        InstrumentError
            When an instrument shares declared noise with a regressor or the response.
        """
        if problem.instruments_share_noise():
            raise InstrumentError(
                "instruments whose measurement noise no regressor and no response shares",
                "an instrument of the same channel and lag as a noisy regressor",
                "Use lags from 1 on, another channel, or a compensated method: generalized_iv.",
            )
        found = mean_cross_products(problem, instruments=True, own=instrument_products)
        return _cross_moments(found, None)

    def system(self, moments: Moments) -> LinearSystem:
        """Mean cross-products as equations."""
        return _instrumental_system(moments, compensated=False)

    def test_functions(self, rows: Regression | RowBlock) -> Float[np.ndarray, "rows p"]:
        """The instruments."""
        return rows.instruments

    def score_constants(
        self, problem: LinearProblem, theta: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " p"]:
        """Zero."""
        del theta
        return np.zeros(problem.instrument_count)


@dataclass(frozen=True, slots=True)
class Compensated(Assembler):
    """Cross-products without what the measurement noises add: (R_psi_phi - C) theta = r_psi_y - c.

    With instruments it is generalized IV, the paper's (29); with the regressors as their own instruments
    bias-compensated least squares, the paper's (15) with known noise.

    Parameters
    ----------
    by_instruments : bool
        Use the problem's instruments; False uses its regressors.
    """

    by_instruments: bool = True

    @property
    def needs_instruments(self) -> bool:
        """As `by_instruments` says."""
        return self.by_instruments

    @property
    def moment_equations(self) -> bool:
        """Yes."""
        return True

    def _noise(self, problem: LinearProblem) -> Float[np.ndarray, "p n_plus_1"]:
        if self.by_instruments:
            return problem.instrument_noise_covariance()
        return problem.regressor_noise_covariance()[:-1]

    def moments(self, problem: LinearProblem, *, instrument_products: bool = False) -> CrossMoments:
        """mean(psi [phi' y]) and the mean covariance of the noises in it.

        Raises
        ------
        MissingNoiseError
            When a noise that instruments and regressors share is not declared: none is never assumed.
        """
        noise = self._noise(problem)
        found = mean_cross_products(problem, instruments=self.by_instruments, own=instrument_products)
        return CrossMoments(
            found.count, found.cross, noise, found.instruments, found.regressors, found.blocks
        )

    def system(self, moments: Moments) -> LinearSystem:
        """Compensated mean cross-products as equations."""
        return _instrumental_system(moments, compensated=True)

    def test_functions(self, rows: Regression | RowBlock) -> Float[np.ndarray, "rows p"]:
        """The instruments, or the regressors."""
        return rows.instruments if self.by_instruments else rows.regressors

    def score_constants(
        self, problem: LinearProblem, theta: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " p"]:
        """C theta - c."""
        noise = self._noise(problem)
        return noise[:, :-1] @ theta - noise[:, -1]


def _cross_moments(found: MeanProducts, noise: Float[np.ndarray, "p n_plus_1"] | None) -> CrossMoments:
    return CrossMoments(
        found.count, found.cross, noise, found.instruments, found.regressors, blocks=found.blocks
    )


def _instrumental_system(moments: Moments, *, compensated: bool) -> LinearSystem:
    if not isinstance(moments, CrossMoments):
        raise _other_kind("cross moments", moments)
    available, columns = moments.products.shape
    if available < columns - 1:
        raise InstrumentError(
            f"at least {columns - 1} instruments for {columns - 1} parameters",
            f"{available}",
            "Add lags or exogenous columns, or use a direct method.",
        )
    equations = moments.products
    if compensated:
        if moments.noise is None:
            raise _other_kind("cross moments with the noises' covariance", moments)
        equations = equations - moments.noise
    return LinearSystem(equations[:, :-1], equations[:, -1])


def _other_kind(expected: str, moments: Moments) -> UsageError:
    return UsageError(
        expected, type(moments).__name__, "Make the moments with the method that is to use them."
    )
