"""Moment equations: direct, compensated for noise, and instrumental."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from eivor.errors import CovarianceError, InstrumentError, UsageError
from eivor.estimation.products import products_of, root_of_rows
from eivor.inference.covariance import unit_scale
from eivor.inference.products import Products
from eivor.linalg.system import LinearSystem, merged_roots
from eivor.models.regression import LinearProblem, Parameter, Regression, RowBlock
from eivor.tools import Float


@dataclass(frozen=True, slots=True)
class TriangularMoments:
    """Triangular root of the rows [Phi y]."""

    rows: float  # Number of them
    root: Float[np.ndarray, "k n_plus_1"]  # R with R'R = [Phi y]'[Phi y]
    noise: Float[np.ndarray, "n_plus_1 n_plus_1"] | None = None  # [Phi y]

    def merge(self, other: Moments) -> TriangularMoments:
        if not isinstance(other, TriangularMoments) or self.root.shape[1] != other.root.shape[1]:
            raise _unlike(self, other)
        noise = _mean_noise(self, other)
        return TriangularMoments(self.rows + other.rows, merged_roots(self.root, other.root), noise)


@dataclass(frozen=True, slots=True)
class CrossMoments:
    """Mean cross-products of the instruments with [Phi y], a view of a table of products."""

    products: Products  # [psi phi y]
    noise: Float[np.ndarray, "p n_plus_1"] | None = None  # C and c, [phi' y]

    @property
    def rows(self) -> float:
        return self.products.count

    @property
    def equations(self) -> Float[np.ndarray, "p n_plus_1"]:
        """mean(psi [phi' y])."""
        return np.asarray(self.products.equations.sum(axis=0)) / self.rows

    @property
    def instruments(self) -> Float[np.ndarray, "p p"]:
        """mean(psi psi')."""
        return np.asarray(self.products.instruments.sum(axis=0)) / self.rows

    @property
    def columns(self) -> Float[np.ndarray, "n_plus_1 n_plus_1"]:
        """mean([phi y] [phi y]')."""
        return np.asarray(self.products.columns.sum(axis=0)) / self.rows

    def shared_noise(self, theta: Float[np.ndarray, " n"]) -> Float[np.ndarray, " p"]:
        """What the noises add to each row's products with the residual on average, C theta - c."""
        if self.noise is None:
            return np.zeros(self.products.tested)
        return self.noise[:, :-1] @ theta - self.noise[:, -1]

    def merge(self, other: Moments) -> CrossMoments:
        """Sums of both; count-weighted means of the noises' covariances."""
        if not isinstance(other, CrossMoments) or self.equations.shape != other.equations.shape:
            raise _unlike(self, other)
        both = self.products.total + other.products.total
        return CrossMoments(both.total, _mean_noise(self, other))


#: Summary of some rows.
Moments = TriangularMoments | CrossMoments


@dataclass(frozen=True)
class ProblemMoments:
    """Moments of a problem, with the names of its parameters."""

    parameters: tuple[Parameter, ...]
    moments: Moments

    def merge(self, other: ProblemMoments) -> ProblemMoments:
        """Moments of both sets of rows: other chunks, other flights, other machines."""
        mine, others = ([parameter.name for parameter in item.parameters] for item in (self, other))
        if mine != others:
            expected = f"moments of the parameters {', '.join(mine)}"
            raise UsageError(expected, f"moments of {', '.join(others)}", "Merge moments of one model.")
        return replace(self, moments=self.moments.merge(other.moments))


def _mean_noise(moments: Moments, other: Moments) -> Float[np.ndarray, "m n"] | None:
    """Noises' covariance of both, weighted by their rows; None where one has none."""
    if moments.noise is None or other.noise is None:
        return None
    total = moments.rows + other.rows
    return moments.noise * (moments.rows / total) + other.noise * (other.rows / total)


def _unlike(moments: Moments, other: Moments) -> UsageError:
    return UsageError(
        f"moments of the same kind and columns as these {type(moments).__name__}",
        f"{type(other).__name__} of other columns" if type(moments) is type(other) else type(other).__name__,
        "Merge moments that one method made of one problem.",
    )


class Assembler(ABC):
    """From a problem to moments, and from moments to a linear system."""

    needs_instruments: bool  # Whether the problem must have instruments
    compensates = False  # Whether declared noises are taken out of the equations

    @property
    def moment_equations(self) -> bool:
        """True when the equations are mean cross-products, False when they are rows or their root."""
        return self.needs_instruments or self.compensates

    @property
    def plain_products(self) -> bool:
        """True when the equations are mean(psi [phi' y]) and nothing else."""
        return self.needs_instruments and not self.compensates

    @property
    def takes_out_own_noise(self) -> bool:
        """True when regressors are their own instruments, so that their noise must be known."""
        return self.compensates and not self.needs_instruments

    @abstractmethod
    def moments(self, problem: LinearProblem) -> Moments:
        """Summary of the rows."""

    def check_noise(self, problem: LinearProblem) -> None:
        """Refuse instruments whose noise the rows share where the equations take none out."""
        if self.plain_products and problem.instruments_share_noise():
            raise InstrumentError(
                "instruments whose measurement noise no regressor and no response shares",
                "an instrument of the same channel and lag as a noisy regressor",
                "Use lags from 1 on, another channel, or a compensated method: generalized_iv.",
            )

    def noise(self, problem: LinearProblem) -> Float[np.ndarray, "p n_plus_1"] | None:
        """Mean covariance of the noises of what equations are products of; None where none is taken out."""
        self.check_noise(problem)
        if not self.compensates:
            return None
        if self.needs_instruments:
            return problem.instrument_noise_covariance()
        return problem.regressor_noise_covariance()[:-1]

    def system(self, moments: Moments) -> LinearSystem:
        """Equations for the parameters; by default mean cross-products, less the noises' where it does so."""
        if not isinstance(moments, CrossMoments):
            raise _other_kind("cross moments", moments)
        equations = moments.equations
        available, columns = equations.shape
        if available < columns - 1:
            expected = f"at least {columns - 1} instruments for {columns - 1} parameters"
            remedy = "Add lags or exogenous columns, or use a direct method."
            raise InstrumentError(expected, f"{available}", remedy)
        if self.compensates:
            if moments.noise is None:
                raise _other_kind("cross moments with the noises' covariance", moments)
            equations = equations - moments.noise
        if self.takes_out_own_noise:
            _check_compensated(moments.equations[:, :-1], equations[:, :-1])
        return LinearSystem(equations[:, :-1], equations[:, -1])

    def test_functions(self, rows: Regression | RowBlock) -> Float[np.ndarray, "rows p"]:
        """Functions psi whose products with the residual the equations are made of."""
        return rows.instruments if self.needs_instruments else rows.regressors


@dataclass(frozen=True, slots=True)
class Direct(Assembler):
    """The rows themselves are the equations: Phi theta = y, the paper's (9), (13). Never squared."""

    needs_instruments = False

    def moments(self, problem: LinearProblem) -> TriangularMoments:
        count, root = root_of_rows(problem)
        return TriangularMoments(float(count), root, problem.declared_noise())

    def system(self, moments: Moments) -> LinearSystem:
        if not isinstance(moments, TriangularMoments):
            raise _other_kind("triangular moments", moments)
        return LinearSystem(moments.root[:, :-1], moments.root[:, -1], moments.noise, moments.rows)


@dataclass(frozen=True, slots=True)
class Instrumental(Assembler):
    """Mean cross-products with the instruments: Psi'Phi theta = Psi'y, the paper's (23)."""

    needs_instruments = True

    def moments(self, problem: LinearProblem) -> CrossMoments:
        return CrossMoments(products_of(problem), self.noise(problem))


@dataclass(frozen=True, slots=True)
class Compensated(Assembler):
    """Cross-products without what the measurement noises add: (R_psi_phi - C) theta = r_psi_y - c."""

    # Equations (29), (15) of the paper.

    needs_instruments: bool = True  # Use the problem's instruments, or the regressors
    compensates = True

    def moments(self, problem: LinearProblem) -> CrossMoments:
        noise = self.noise(problem)
        return CrossMoments(products_of(problem, instruments=self.needs_instruments), noise)


def _check_compensated(moments: Float[np.ndarray, "n n"], compensated: Float[np.ndarray, "n n"]) -> None:
    """Refuse regressors that are less than their declared noise; without noise there is nothing to refuse."""
    if np.array_equal(moments, compensated):
        return
    powers, variances = np.diag(moments), np.diag(moments - compensated)
    scale = unit_scale(powers)
    smallest = float(np.linalg.eigvalsh(np.outer(scale, scale) * compensated)[0])
    if smallest <= 0.0:
        raise CovarianceError(
            "regressors whose mean squares exceed their declared noise in every direction",
            f"mean squares {powers} and noise variances {variances}",
            f"In columns of unit length their difference has the eigenvalue {smallest:.3g}. Declare a "
            "smaller noise, or use instruments that share none of it: extended_iv, or generalized_iv.",
        )


def _other_kind(expected: str, moments: Moments) -> UsageError:
    return UsageError(
        expected, type(moments).__name__, "Make the moments with the method that is to use them."
    )


@dataclass(frozen=True, slots=True)
class FittedNoise:
    """A noise whose spectrum is strength^2 |difference|^(2 order)."""

    of: str
    strength: float
    strength_error: float
    order: float
    order_error: float
    measure: str

    @property
    def sentence(self) -> str:
        """What is reported about it."""
        strength = f"{self.strength:.3g}"
        if self.strength_error:
            strength += f" ± {self.strength_error:.1g}"
        order = f"{self.order:z.2f}" + (f" ± {self.order_error:.1g}" if self.order_error else "")
        return f"{self.of} {strength} {self.measure}, order {order}"
