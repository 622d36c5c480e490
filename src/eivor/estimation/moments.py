"""Moment equations: direct, compensated for noise, and instrumental; the products that they are made of."""

from __future__ import annotations

from abc import ABC
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement, pairwise
from typing import TypeGuard

import msgspec
import numpy as np
from numpy.lib.stride_tricks import as_strided

from eivor.errors import CovarianceError, InstrumentError, NonFiniteError, TooFewSamplesError, UsageError
from eivor.inference.covariance import unit_scale
from eivor.inference.diagnostics.residuals import GROUPS
from eivor.inference.estimating_equation import Products, block_edges, products_of_rows
from eivor.linalg import system as linalg
from eivor.models.regression import Column, LinearProblem, Parameter, Regression, RowBlock
from eivor.models.signal_regression import SignalRegression
from eivor.tools import Float, Int

#: Samples folded into one row.
FOLD = 8
#: Taps of a filter that `np.correlate` computes fast; longer filters are sums of such.
FAST_TAPS = 11


def successive_lags(columns: Sequence[Column]) -> tuple[int, int] | None:
    """First and last lag of columns that are successive lags of one channel with a constant gain."""
    lags = [column.lag for column in columns]
    equal = len({(c.channel, c.gain, c.gain_channel) for c in columns}) == 1
    if len(lags) < 2 or not equal or not columns[0].channel or columns[0].gain_channel:
        return None
    return (lags[0], lags[-1]) if lags == list(range(lags[0], lags[-1] + 1)) else None


def lags_without_gaps(problem: LinearProblem | None) -> TypeGuard[SignalRegression]:
    """Whether every sample of signals is a row, and the instruments are successive lags of one channel."""
    return (
        isinstance(problem, SignalRegression)
        and problem.used is None
        and problem.instrument_count > 0
        and successive_lags(problem.instrument_columns) is not None
    )


def filtered_instruments(
    problem: SignalRegression, combinations: Float[np.ndarray, "p n"], start: int, stop: int
) -> RowBlock:
    """Rows from sample `start` to `stop`, with combinations of successive lags in the instruments' place."""
    lags = problem.instrument_columns
    series = problem.signals.channel(lags[0].channel)[start - lags[-1].lag : stop - lags[0].lag]
    taps = lags[0].gain * combinations[::-1].T
    psi = np.zeros((len(taps), stop - start))
    for row, tap in enumerate(taps):
        for index in range(0, tap.size, FAST_TAPS):
            piece = tap[index : index + FAST_TAPS]
            psi[row] += np.correlate(series[index : index + stop - start - 1 + piece.size], piece, "valid")
    rows = problem.columns_between(problem.columns[len(lags) :], start, stop)
    return RowBlock(rows[:, -1], rows[:, :-1], psi.T, np.zeros(stop - start, dtype=np.int64))


#: Blocks of time: at least so many, and so many for each instrument.
BLOCKS = 128
BLOCKS_PER_INSTRUMENT = 6
#: Fewest rows of a record for threads.
THREADED_FROM_ROWS = 8_000_000
#: Shorter records have their products of lags multiplied out: folding costs more.
LAGS_FOLDED_FROM = 4_000
#: Shorter records are one block, and their diagnostics are made of rows.
FOLDED_FROM = 250_000


def block_count(rows: int, instruments: int) -> int:
    """A multiple of the groups of the constancy test when there are rows enough."""
    count = GROUPS * -(-max(BLOCKS, BLOCKS_PER_INSTRUMENT * instruments) // GROUPS)
    return min(count, GROUPS * (rows // GROUPS)) if rows >= GROUPS else rows


def products_of_signals(problem: SignalRegression, *, instruments: bool) -> Products:
    """Products of a problem's columns: in blocks of a long record, all of them together of any other."""
    psi = problem.instrument_columns if instruments else problem.regressor_columns
    columns, count, p = problem.columns[problem.instrument_count :], row_count(problem), len(psi)
    if problem.used is None and count >= LAGS_FOLDED_FROM and successive_lags(psi) is not None:
        blocks = block_count(count // FOLD, p) if instruments and count >= FOLDED_FROM else 1
        return _folded(problem, psi, columns, blocks)

    def block_products(stretch: tuple[int, int]) -> Float[np.ndarray, "left right"]:
        Z = problem.columns_between((*psi, *columns), *stretch)
        return Z.T @ Z

    stretches = linalg.row_blocks(problem.first, problem.signals.sample_count, linalg.MULTIPLIED_ROWS)
    sums = np.asarray(sum(linalg.map_ahead(block_products, stretches)))
    return Products(np.array([count], dtype=np.float64), sums[None], p)


def _folded(
    problem: SignalRegression, psi: Sequence[Column], columns: Sequence[Column], blocks: int
) -> Products:
    """Products of successive lags of one channel with each other and with columns, in blocks of time."""
    first, last = problem.first, problem.signals.sample_count
    values = [np.ascontiguousarray(problem.slice_of(column, first, last)) for column in columns]
    edges = first + FOLD * block_edges((last - first) // FOLD, blocks)
    p, m = len(psi), len(columns)
    # a column that is one of the lags has its products among theirs
    places = {(lag.channel, lag.lag, ""): number for number, lag in enumerate(psi)}
    lags = [places.get((column.channel, column.lag, column.gain_channel)) for column in columns]
    unlagged = [number for number, lag in enumerate(lags) if lag is None]
    series, others = problem.signals.channel(psi[0].channel), [values[number] for number in unlagged]
    lagged = _lag_products(series, psi, others, edges, last)
    sums = np.empty((blocks, p + m, p + m))
    sums[:, :p, :p] = lagged[:, :, :p]
    positions = [p + unlagged.index(number) if lag is None else lag for number, lag in enumerate(lags)]
    sums[:, :p, p:] = lagged[:, :, positions]
    sums[:, p:, :p] = sums[:, :p, p:].transpose(0, 2, 1)
    edges[-1] = last
    ends = list(pairwise((edges - first).tolist()))
    for i, j in combinations_with_replacement(range(m), 2):
        lag, index = (lags[i], j) if lags[i] is not None else (lags[j], i)
        if lag is None:
            squares = np.array([values[i][start:stop] @ values[j][start:stop] for start, stop in ends])
        else:
            squares = sums[:, lag, p + index]
        sums[:, p + i, p + j] = sums[:, p + j, p + i] = squares
    gains = np.array([psi[0].gain] * p + [column.gain for column in columns])
    return Products(np.diff(edges).astype(np.float64), sums * np.outer(gains, gains), p)


def _lag_products(
    series: Float[np.ndarray, " samples"],
    psi: Sequence[Column],
    others: Sequence[Float[np.ndarray, " rows"]],
    edges: Int[np.ndarray, " K_plus_1"],
    last: int,
) -> Float[np.ndarray, "K p p_plus_others"]:
    """Sums over each block of u_k-i u_k-j, and of u_k-i w_k for each other series w."""
    first, first_lag, last_lag = int(edges[0]), psi[0].lag, psi[-1].lag
    columns = [np.ascontiguousarray(series[first - first_lag : last - first_lag]), *others]

    def folded(block: tuple[int, int]) -> Float[np.ndarray, "others width fold"]:
        width = FOLD + last_lag - first_lag
        total = np.zeros((len(columns), width, FOLD))
        for start, stop in linalg.row_blocks(*block, linalg.MULTIPLIED_ROWS):
            rows = (stop - start) // FOLD
            origin = series[start - last_lag :]
            A = as_strided(origin, (rows, width), (FOLD * origin.strides[0], origin.strides[0])).copy()
            for j, column in enumerate(columns):
                total[j] += A.T @ column[start - first : stop - first].reshape(rows, FOLD)
        return total

    blocks = list(pairwise(edges.tolist()))
    # block by block: threads change no sum
    totals = map(folded, blocks) if last - first < THREADED_FROM_ROWS else linalg.map_ahead(folded, blocks)
    G, p, index = np.stack(list(totals)), last_lag - first_lag + 1, np.arange(FOLD)
    sums = np.stack([G[..., index + p - 1 - lag, index].sum(axis=-1) for lag in range(p)], axis=-2)
    for sample in range(int(edges[-1]), last):
        lagged = series[sample - np.arange(first_lag, last_lag + 1)]
        sums[-1] += np.outer(lagged, [column[sample - first] for column in columns])
    # The sum at lags (i + 1, j + 1) is that at (i, j) but for the samples at both ends of the block.
    sums_of_lags = np.empty((len(blocks), p, p))
    sums_of_lags[:, :, 0] = sums_of_lags[:, 0, :] = sums[:, :, 0]
    start, stop = edges[:-1], np.append(edges[1:-1], last)
    entering, leaving = (series[end[:, None] - 1 - first_lag - np.arange(p)] for end in (start, stop))
    for i in range(p - 1):
        computed = slice(0, i + 1)
        change = entering[:, [i]] * entering[:, computed] - leaving[:, [i]] * leaving[:, computed]
        sums_of_lags[:, i + 1, 1 : i + 2] = sums_of_lags[:, 1 : i + 2, i + 1] = (
            sums_of_lags[:, i, computed] + change
        )
    return np.concatenate([sums_of_lags, sums[:, :, 1:]], axis=2)


def row_count(problem: SignalRegression) -> int:
    """Number of rows of a problem."""
    count = problem.signals.sample_count - problem.first
    if count < 1:
        expected = f"more than {problem.first} samples, the largest lag"
        remedy = "Give a longer record or fewer lags."
        raise TooFewSamplesError(expected, f"{problem.signals.sample_count}", remedy)
    return count if problem.used is None else int(problem.used.sum())


def products_of(problem: LinearProblem, *, instruments: bool = True) -> Products:
    """Products of the columns [psi phi y] of a problem."""
    if instruments and not problem.instrument_count:
        remedy = 'Name them: regression(signals, ev.lags("input", 0, 10)), or regression(instruments=...).'
        raise InstrumentError("instruments", "a problem without any", remedy)
    if isinstance(problem, SignalRegression):
        products = products_of_signals(problem, instruments=instruments)
    else:
        rows = problem.rows()
        psi, edges = rows.instruments if instruments else rows.regressors, np.array([0, rows.response.size])
        products = products_of_rows(psi, rows.regressors, rows.response, edges=edges)
    if not np.isfinite(products.sums).all():
        remedy = "Check the channels for overflow or missing values."
        raise NonFiniteError("finite cross-products", "NaN or infinity", remedy)
    return products


def root_of_rows(problem: LinearProblem) -> tuple[int, Float[np.ndarray, "k n_plus_1"]]:
    """Number of rows and the triangular root of [phi y]."""
    if isinstance(problem, SignalRegression):
        columns = problem.columns[problem.instrument_count :]
        root = np.empty((0, len(columns)))
        for start, stop in linalg.row_blocks(
            problem.first, problem.signals.sample_count, 4 * linalg.MULTIPLIED_ROWS
        ):
            root = linalg.merged_roots(root, problem.columns_between(columns, start, stop))
        return row_count(problem), root
    rows = problem.rows()
    return rows.response.size, linalg.triangular_root(np.column_stack([rows.regressors, rows.response]))


@dataclass(frozen=True, slots=True)
class TriangularMoments:
    """Triangular root of the rows [Phi y]."""

    rows: float  # Number of them
    root: Float[np.ndarray, "k n_plus_1"]  # R with R'R = [Phi y]'[Phi y]
    noise: Float[np.ndarray, "n_plus_1 n_plus_1"] | None = None  # [Phi y]

    def merge(self, other: Moments) -> TriangularMoments:
        if not isinstance(other, TriangularMoments) or self.root.shape[1] != other.root.shape[1]:
            raise _incompatible(self, other)
        noise = _mean_noise(self, other)
        return TriangularMoments(self.rows + other.rows, linalg.merged_roots(self.root, other.root), noise)


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
        return self.products.mean[: self.products.tested, self.products.tested :]

    @property
    def instruments(self) -> Float[np.ndarray, "p p"]:
        """mean(psi psi')."""
        return self.products.mean[: self.products.tested, : self.products.tested]

    @property
    def columns(self) -> Float[np.ndarray, "n_plus_1 n_plus_1"]:
        """mean([phi y] [phi y]')."""
        return self.products.mean[self.products.tested :, self.products.tested :]

    def shared_noise(self, theta: Float[np.ndarray, " n"]) -> Float[np.ndarray, " p"]:
        """Noises' part of each row's products with the residual, on average: C theta - c."""
        if self.noise is None:
            return np.zeros(self.products.tested)
        return self.noise[:, :-1] @ theta - self.noise[:, -1]

    def merge(self, other: Moments) -> CrossMoments:
        """Sums of both; count-weighted means of the noises' covariances."""
        if not isinstance(other, CrossMoments) or self.equations.shape != other.equations.shape:
            raise _incompatible(self, other)
        return CrossMoments((self.products.total + other.products.total).total, _mean_noise(self, other))


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


def _incompatible(moments: Moments, other: Moments) -> UsageError:
    return UsageError(
        f"moments of the same kind and columns as these {type(moments).__name__}",
        f"{type(other).__name__} of other columns" if type(moments) is type(other) else type(other).__name__,
        "Merge moments that one method made of one problem.",
    )


class Assembler(ABC):
    """From a problem to moments, and from moments to a linear system."""

    needs_instruments: bool  # Whether the problem must have instruments
    compensates = False  # Whether declared noises are taken out of the equations
    moment_equations = True  # Whether the equations are mean cross-products, and not rows or their root
    plain_products = False  # Whether the equations are mean(psi [phi' y]) and nothing else
    takes_out_own_noise = False  # Whether regressors are their own instruments: their noise must be known

    def moments(self, problem: LinearProblem) -> Moments:
        """Summary of the rows; by default mean cross-products."""
        noise = self.noise(problem)
        return CrossMoments(products_of(problem, instruments=self.needs_instruments), noise)

    def check_noise(self, problem: LinearProblem) -> None:
        """Refuse instruments whose noise the rows share where the equations take none out."""
        if self.plain_products and problem.instruments_share_noise():
            expected = "instruments whose measurement noise no regressor and no response shares"
            received = "an instrument of the same channel and lag as a noisy regressor"
            remedy = "Use lags from 1 on, another channel, or a compensated method: generalized_iv."
            raise InstrumentError(expected, received, remedy)

    def noise(self, problem: LinearProblem) -> Float[np.ndarray, "p n_plus_1"] | None:
        """Mean noise covariance of the columns of the equations; None where none is taken out."""
        self.check_noise(problem)
        if not self.compensates:
            return None
        if self.needs_instruments:
            return problem.instrument_noise_covariance()
        return problem.regressor_noise_covariance()[:-1]

    def system(self, moments: Moments) -> linalg.LinearSystem:
        """Equations for the parameters; by default mean cross-products, less the noises' where it does so."""
        if not isinstance(moments, CrossMoments):
            raise _wrong_kind("cross moments", moments)
        p = moments.products.tested
        equations = moments.products.mean[:p, p:]
        available, columns = equations.shape
        if available < columns - 1:
            expected = f"at least {columns - 1} instruments for {columns - 1} parameters"
            remedy = "Add lags or exogenous columns, or use a direct method."
            raise InstrumentError(expected, f"{available}", remedy)
        if self.compensates:
            if moments.noise is None:
                raise _wrong_kind("cross moments with the noises' covariance", moments)
            equations = equations - moments.noise
        if self.takes_out_own_noise:
            _check_compensated(moments.products.mean[:p, p:-1], equations[:, :-1])
        return linalg.LinearSystem(equations[:, :-1], equations[:, -1])

    def test_functions(self, rows: Regression | RowBlock) -> Float[np.ndarray, "rows p"]:
        """Functions psi whose products with the residual the equations are made of."""
        return rows.instruments if self.needs_instruments else rows.regressors


@dataclass(frozen=True, slots=True)
class Direct(Assembler):
    """The rows themselves are the equations: Phi theta = y, the paper's (9), (13). Never squared."""

    needs_instruments = False
    moment_equations = False

    def moments(self, problem: LinearProblem) -> TriangularMoments:
        count, root = root_of_rows(problem)
        return TriangularMoments(float(count), root, problem.declared_noise())

    def system(self, moments: Moments) -> linalg.LinearSystem:
        if not isinstance(moments, TriangularMoments):
            raise _wrong_kind("triangular moments", moments)
        return linalg.LinearSystem(moments.root[:, :-1], moments.root[:, -1], moments.noise, moments.rows)


@dataclass(frozen=True, slots=True)
class Instrumental(Assembler):
    """Mean cross-products with the instruments: Psi'Phi theta = Psi'y, the paper's (23)."""

    needs_instruments = True
    plain_products = True


@dataclass(frozen=True, slots=True)
class Compensated(Assembler):
    """Cross-products less the measurement noises' covariances: (R_psi_phi - C) theta = r_psi_y - c."""

    # Equations (29), (15) of the paper.

    needs_instruments: bool = True  # Use the problem's instruments, or the regressors
    compensates = True

    @property
    def takes_out_own_noise(self) -> bool:  # type: ignore[override]
        return not self.needs_instruments


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


def _wrong_kind(expected: str, moments: Moments) -> UsageError:
    return UsageError(
        expected, type(moments).__name__, "Make the moments with the method that is to use them."
    )


class FittedNoise(msgspec.Struct, frozen=True):
    """A noise whose spectrum is strength^2 |difference|^(2 order)."""

    of: str
    strength: float
    strength_error: float
    order: float
    order_error: float
    measure: str

    @property
    def sentence(self) -> str:
        """Strength and order, in words."""
        strength = f"{self.strength:.3g}"
        if self.strength_error:
            strength += f" ± {self.strength_error:.1g}"
        order = f"{self.order:z.2f}" + (f" ± {self.order_error:.1g}" if self.order_error else "")
        return f"{self.of} {strength} {self.measure}, order {order}"
