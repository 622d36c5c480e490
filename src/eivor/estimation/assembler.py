"""Assemblers: which equations a problem is turned into, by way of which moments.

An assembler also says which *test functions* P its estimate makes orthogonal to the residual,
``sum_t (P_t e_t + constant) = 0``, which is all that inference needs to know of it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from eivor.errors import CovarianceError, InstrumentError, MissingNoiseError, UsageError
from eivor.estimation.moments import CrossMoments, Moments, TriangularMoments
from eivor.estimation.products.of_problem import products_of, root_of_rows
from eivor.inference.covariances.covariance import unit_scale
from eivor.linalg.system import LinearSystem, Solution
from eivor.models.regression import LinearProblem, Regression, RowBlock
from eivor.shapes import Float


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

    @property
    def plain_products(self) -> bool:
        """True when the equations are mean(psi [phi' y]) and nothing else; not so by default."""
        return False

    @property
    def compensates(self) -> bool:
        """True when declared noises are taken out of the equations; not so by default."""
        return False

    @abstractmethod
    def moments(self, problem: LinearProblem) -> Moments:
        """Summary of the problem's rows: what the equations need."""

    def full_moments(self, problem: LinearProblem) -> Moments:
        """With mean(psi psi') and mean(phi phi'), for weights and strength; without instruments no more."""
        return self.moments(problem)

    @property
    def takes_out_own_noise(self) -> bool:
        """True when the noise of the regressors must be known; not so by default."""
        return False

    def left(self, _moments: Moments, solution: Solution, /) -> float:
        """What a search of nuisances makes least; by default what the solver did."""
        return solution.objective

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

    def moments(self, problem: LinearProblem) -> TriangularMoments:
        """Triangular root of [Phi y], and its noise covariance where that is declared."""
        count, root = root_of_rows(problem)
        try:
            noise = problem.regressor_noise_covariance()
        except MissingNoiseError:
            noise = None
        return TriangularMoments(float(count), root, noise)

    def system(self, moments: Moments) -> LinearSystem:
        """The root's rows: the same solutions, n + 1 equations."""
        if not isinstance(moments, TriangularMoments):
            raise _other_kind("triangular moments", moments)
        return LinearSystem(moments.root[:, :-1], moments.root[:, -1], moments.noise, moments.rows)

    def test_functions(self, rows: Regression | RowBlock) -> Float[np.ndarray, "rows p"]:
        """The regressors."""
        return rows.regressors


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

    @property
    def plain_products(self) -> bool:
        """Yes."""
        return True

    def moments(self, problem: LinearProblem) -> CrossMoments:
        """mean(psi [phi' y]).

        Raises
        ------
        InstrumentError
            When an instrument shares declared noise with a regressor or the response.
        """
        return self._moments(problem, whole=False)

    def full_moments(self, problem: LinearProblem) -> CrossMoments:
        """With mean(psi psi') and mean(phi phi'), see `moments`."""
        return self._moments(problem, whole=True)

    def _moments(self, problem: LinearProblem, *, whole: bool) -> CrossMoments:
        if problem.instruments_share_noise():
            raise InstrumentError(
                "instruments whose measurement noise no regressor and no response shares",
                "an instrument of the same channel and lag as a noisy regressor",
                "Use lags from 1 on, another channel, or a compensated method: generalized_iv.",
            )
        return CrossMoments(products_of(problem, whole=whole))

    def system(self, moments: Moments) -> LinearSystem:
        """Mean cross-products as equations."""
        return _instrumental_system(moments, compensated=False)

    def test_functions(self, rows: Regression | RowBlock) -> Float[np.ndarray, "rows p"]:
        """The instruments."""
        return rows.instruments


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

    @property
    def takes_out_own_noise(self) -> bool:
        """When the regressors are their own instruments."""
        return not self.by_instruments

    @property
    def compensates(self) -> bool:
        """Yes."""
        return True

    def _noise(self, problem: LinearProblem) -> Float[np.ndarray, "p n_plus_1"]:
        if self.by_instruments:
            return problem.instrument_noise_covariance()
        return problem.regressor_noise_covariance()[:-1]

    def moments(self, problem: LinearProblem) -> CrossMoments:
        """mean(psi [phi' y]) and the mean covariance of the noises in it.

        Raises
        ------
        MissingNoiseError
            When a noise that instruments and regressors share is not declared: none is never assumed.
        """
        return self._moments(problem, whole=not self.by_instruments)

    def full_moments(self, problem: LinearProblem) -> CrossMoments:
        """With mean(psi psi') and mean(phi phi'), see `moments`."""
        return self._moments(problem, whole=True)

    def _moments(self, problem: LinearProblem, *, whole: bool) -> CrossMoments:
        noise = self._noise(problem)
        products = products_of(problem, instruments=self.by_instruments, whole=whole)
        return CrossMoments(products, noise)

    def system(self, moments: Moments) -> LinearSystem:
        """Compensated mean cross-products as equations.

        Raises
        ------
        CovarianceError
            When the declared noise leaves nothing of the regressors' own moments in some direction. With
            instruments the moments are no covariance, and there is nothing of that kind to see in them.
        """
        found = _instrumental_system(moments, compensated=True)
        if not self.by_instruments and isinstance(moments, CrossMoments):
            _check_compensated(moments.equations[:, :-1], found.matrix)
        return found

    def left(self, moments: Moments, solution: Solution, /) -> float:
        """With instruments what is left of the equations; else the sum of squares without the noise in it.

        The equations of as many regressors are met by whatever the nuisances are. What the regressors' noise
        adds to the squares of the residual, theta' C theta - 2 c' theta, depends on them as little as the
        noise of the response, which stays in.
        """
        if self.by_instruments or not isinstance(moments, CrossMoments) or not moments.products.layout.whole:
            return solution.objective
        residual = moments.products.with_residual(solution.theta).power.sum()
        added = moments.shared_noise(solution.theta) @ solution.theta
        if moments.noise is not None:
            added -= moments.noise[:, -1] @ solution.theta
        return float(residual - moments.rows * added)

    def test_functions(self, rows: Regression | RowBlock) -> Float[np.ndarray, "rows p"]:
        """The instruments, or the regressors."""
        return rows.instruments if self.by_instruments else rows.regressors


def _instrumental_system(moments: Moments, *, compensated: bool) -> LinearSystem:
    if not isinstance(moments, CrossMoments):
        raise _other_kind("cross moments", moments)
    available, columns = moments.equations.shape
    if available < columns - 1:
        raise InstrumentError(
            f"at least {columns - 1} instruments for {columns - 1} parameters",
            f"{available}",
            "Add lags or exogenous columns, or use a direct method.",
        )
    equations = moments.equations
    if compensated:
        if moments.noise is None:
            raise _other_kind("cross moments with the noises' covariance", moments)
        equations = equations - moments.noise
    return LinearSystem(equations[:, :-1], equations[:, -1])


def _check_compensated(moments: Float[np.ndarray, "n n"], compensated: Float[np.ndarray, "n n"]) -> None:
    """Refuse regressors that are less than their declared noise; without noise there is nothing to refuse."""
    powers = np.diag(moments)
    if np.array_equal(moments, compensated):
        return
    scale = unit_scale(powers)
    smallest = float(np.linalg.eigvalsh(np.outer(scale, scale) * compensated)[0])
    if smallest <= 0.0:
        variances = np.diag(moments - compensated)
        raise CovarianceError(
            "regressors whose mean squares exceed the noise that is declared of them, in every direction",
            f"mean squares {powers} and noise variances {variances}, whose difference, in columns of unit "
            f"length, has the eigenvalue {smallest:.3g}",
            "Declare a smaller noise, or use instruments that share none of it: extended_iv, or "
            "generalized_iv with them.",
        )


def _other_kind(expected: str, moments: Moments) -> UsageError:
    return UsageError(
        expected, type(moments).__name__, "Make the moments with the method that is to use them."
    )
