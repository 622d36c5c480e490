"""Confidence sets that hold under weak identification."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from eivor import checks
from eivor.errors import InstrumentError, TooFewSamplesError, UsageError
from eivor.estimation.linear import LinearMethod, check_method
from eivor.estimation.moments import CrossMoments, Instrumental
from eivor.inference import anderson_rubin
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.covariance import cosine_averages
from eivor.inference.diagnostics.record import whitening
from eivor.inference.regions import ConfidenceRegion
from eivor.models.regression import LinearProblem, Parameter, RowLayout, SampleRows
from eivor.models.signal_regression import SignalRegression
from eivor.tools import Float


@dataclass(frozen=True)
class MomentRows:
    """Test functions, columns and noises of ``mean psi_t (y_t - phi_t' theta) + C theta - c``."""

    parameters: tuple[Parameter, ...]
    test_functions: Float[np.ndarray, "rows p"]
    columns: Float[np.ndarray, "rows n_plus_1"]  # [y Phi]
    noise: Float[np.ndarray, "p n_plus_1"]  # [c C]
    layout: RowLayout

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(parameter.name for parameter in self.parameters)

    def own_instruments(self) -> dict[int, int]:
        """Regressors that are instruments as well and share no noise: number of the column to that of psi."""
        results: dict[int, int] = {}
        for j, column in enumerate(self.columns.T[1:]):
            for i, psi in enumerate(self.test_functions.T):
                exact = not (self.noise[i].any() or self.noise[:, j + 1].any())
                if exact and column.any() and np.array_equal(column, psi):
                    results.setdefault(j, i)
        return results

    def without(self, regressors: Sequence[int]) -> MomentRows:
        """The same equations with some of `own_instruments` partialled out."""
        if not regressors:
            return self
        own_instruments = self.own_instruments()
        W = self.columns[:, [j + 1 for j in regressors]]
        Q = np.linalg.qr(W / np.linalg.norm(W, axis=0))[0]
        others = np.delete(np.arange(self.test_functions.shape[1]), [own_instruments[j] for j in regressors])
        remaining = [j for j in range(len(self.parameters)) if j not in regressors]
        positions = [0, *(j + 1 for j in remaining)]
        psi, columns = self.test_functions[:, others], self.columns[:, positions]
        for _ in range(2):  # once more, for what rounding leaves of a large mean
            psi, columns = psi - Q @ (Q.T @ psi), columns - Q @ (Q.T @ columns)
        parameters = tuple(self.parameters[j] for j in remaining)
        return MomentRows(parameters, psi, columns, self.noise[others][:, positions], self.layout)

    def independent(self) -> MomentRows:
        """Equations recombined into orthonormal ones, without directions that are others' combinations."""
        psi, unknowns = self.test_functions, len(self.parameters)
        change = whitening(psi.T @ psi)
        if change.shape[1] < unknowns:
            expected = f"at least {unknowns} independent instruments for {unknowns} parameters"
            raise InstrumentError(expected, f"{change.shape[1]}", "Add lags or exogenous columns.")
        return replace(self, test_functions=psi @ change, noise=change.T @ self.noise)

    def scores(self, averages: int | None) -> anderson_rubin.LinearScores:
        """Sums and cosine averages of the scores, in one pass; by rule when their number is not given."""
        equations = self.test_functions.shape[1]
        if averages is not None and not equations <= averages < self.columns.shape[0]:
            expected = f"as many cosine averages as equations, {equations}, and fewer than samples"
            raise TooFewSamplesError(expected, f"{averages}", "Leave averages out, or drop instruments.")
        total = self.test_functions.T @ self.columns - self.columns.shape[0] * self.noise
        cosines = []
        for column in self.columns.T:
            scores = self.layout.scores(self.test_functions, column)
            count = averages or anderson_rubin.averages_for(scores.shape[0], equations)
            cosines.append(cosine_averages(scores, count))
        return anderson_rubin.LinearScores(total, np.stack(cosines, axis=2))


def moment_rows(problem: LinearProblem, method: LinearMethod) -> MomentRows:
    """Rows of the moment equations that a method makes of a problem."""
    check_method(method)
    remedy = "Make one by ev.regression(...) or VerticalMotion().regression(signals)."
    checks.kind("problem", problem, LinearProblem, "a regression", remedy)
    if not method.assembler.moment_equations:
        remedy = "Use extended_iv, generalized_iv or bias_compensated_least_squares."
        raise UsageError("a method with instruments", method.name, remedy)
    moments = method.assembler.moments(problem)  # refuses what it cannot use
    rows = problem.rows()
    columns = np.column_stack([rows.response, rows.regressors])
    psi = method.assembler.test_functions(rows)
    noise = np.zeros((psi.shape[1], columns.shape[1]))
    if isinstance(moments, CrossMoments) and moments.noise is not None:
        noise = np.column_stack([moments.noise[:, -1], moments.noise[:, :-1]])
    return MomentRows(rows.parameters, psi, columns, noise, rows.layout)


class _ConfidenceSets(ABC):
    """Sets of all parameters from a joint region."""

    kind: ClassVar[str]
    assumptions: ClassVar[str]  # What the sets suppose
    parameters: tuple[Parameter, ...]
    level: float

    @abstractmethod
    def interval(self, name: str) -> ConfidenceSet:
        """Confidence set of one parameter."""

    @cached_property
    def intervals(self) -> dict[str, ConfidenceSet]:
        """Confidence set of each parameter."""
        return {parameter.name: self.interval(parameter.name) for parameter in self.parameters}

    @property
    def is_empty(self) -> bool:
        """Whether no value of the parameters passes the test: the data reject the model, or it is chance."""
        return any(interval.is_empty for interval in self.intervals.values())

    def summary(self) -> str:
        """Sets of all parameters as text, with what they suppose."""
        lines = [f"{self.kind}, {100.0 * self.level:g} %"]
        lines.extend(f"{p.name:<20} {self.intervals[p.name]}  {p.unit}".rstrip() for p in self.parameters)
        if self.is_empty:
            lines.append(
                "No value passes: the data reject the model, its instruments or the declared noises."
            )
        return "\n".join([*lines, self.assumptions])


@dataclass(frozen=True)
class AndersonRubinSet(_ConfidenceSets):
    """Confidence sets by inversion of the Anderson-Rubin test."""

    parameters: tuple[Parameter, ...]  # All parameters of the problem
    level: float  # Confidence level
    averages: int | None  # Cosine averages; None for the number by rule
    rows: MomentRows = field(repr=False)  # The equations
    kind: ClassVar[str] = "Anderson-Rubin"
    assumptions: ClassVar[str] = (
        "The instruments are uncorrelated with the error of their row once the declared noises are "
        "accounted for; errors may be autocorrelated and heteroskedastic, over times much shorter than "
        "the record. Holds in large samples, whatever the strength of the instruments."
    )

    @cached_property
    def region(self) -> ConfidenceRegion:
        """Joint region of the parameters that are not partialled out, in their order."""
        return self._region_with()

    def interval(self, name: str) -> ConfidenceSet:
        """Confidence set of one parameter, the others being whatever they may.

        Exogenous regressors are partialled out, all but the parameter's own. The rest is the shadow of the
        joint region.
        """
        position = checks.index_of("a parameter", name, [parameter.name for parameter in self.parameters])
        exogenous = set(self.rows.own_instruments())
        if len(exogenous) < len(self.parameters) and position not in exogenous:
            return self.region.interval(name)
        return self._region_with(name).interval(name)

    def _region_with(self, name: str = "") -> ConfidenceRegion:
        """Region with every exogenous regressor partialled out but `kept`; all, if there is no other."""
        names = [parameter.name for parameter in self.parameters]
        excluded = [j for j in self.rows.own_instruments() if names[j] != name]
        if len(excluded) == len(names):
            excluded = []
        rows = self.rows.without(excluded).independent()
        return anderson_rubin.robust_region(rows.names, rows.scores(self.averages), self.level)


@dataclass(frozen=True)
class SignPerturbedSet(_ConfidenceSets):
    """Confidence sets by sign perturbation."""

    parameters: tuple[Parameter, ...]  # All parameters of the problem
    level: float  # Exact coverage of `region`
    sums: int  # Number of sums that are ranked
    region: ConfidenceRegion = field(repr=False)  # Joint region of all parameters; its membership is exact
    kind: ClassVar[str] = "sign-perturbed sums"
    assumptions: ClassVar[str] = (
        "Errors are symmetric about zero and independent in time, and the instruments are independent of "
        "all of them, past and future. Variances may change from row to row, moments need not exist. "
        "Coverage of the joint region is exact in every sample, and at least as high of each interval."
    )

    def interval(self, name: str) -> ConfidenceSet:
        """Shadow of the region on a parameter's axis: at least the level.

        Exact for one parameter. With two, pieces and gaps narrower than a degree may be missed, as seen from
        the region's middle in standard errors. With more it is a search.
        """
        return self.region.interval(name)


def anderson_rubin_set(
    problem: LinearProblem, method: LinearMethod, *, averages: int | None = None, level: float = 0.95
) -> AndersonRubinSet:
    """Confidence sets that hold however weak the instruments are.

    Parameters
    ----------
    problem : Regression or SignalRegression
        As for `identify`.
    method : LinearMethod
        Whose moment equations are tested: `extended_iv`, `generalized_iv`, with or without total least
        squares, or `bias_compensated_least_squares`. Its weighting and its solver play no part.
    averages : int, optional
        Number B of cosine averages. Default: 0.4 rows^(2/3), and two for each equation at least. Fewer allow
        for slower errors and make wider sets.
    level : float
        Confidence level.

    Returns
    -------
    AndersonRubinSet
        `region.contains(theta)`, `interval(name)`, `summary()`.

    Raises
    ------
    UsageError
        When the method has no moment equations, or the level is not between 0 and 1.
    InstrumentError, MissingNoiseError, TooFewSamplesError
        When the method refuses the problem, or instruments or samples are too few.
    """
    checks.level(level)
    if averages is not None:
        checks.counted("averages", averages, 1, "one cosine average or more", "Leave averages out.")
    rows = moment_rows(problem, method)
    result = AndersonRubinSet(problem.parameters, level, averages, rows)
    result.region  # noqa: B018 - what cannot be used is refused here, not at the first question
    return result


def sign_perturbed_set(
    problem: LinearProblem,
    method: LinearMethod,
    rng: np.random.Generator,
    *,
    level: float = 0.95,
    sums: int = 100,
) -> SignPerturbedSet:
    """Confidence region with exact coverage in every finite sample.

    Parameters
    ----------
    problem : Regression or SignalRegression
        As for `identify`, rows being time samples.
    method : LinearMethod
        `extended_iv`, whose instruments are independent of the errors. A regressor that is exogenous may be
        its own instrument.
    rng : numpy.random.Generator
        Draws the signs.
    level : float
        Coverage; (1 - level) times `sums` must be a whole number.
    sums : int
        Number of sums that are ranked. More make the region depend less on the signs that were drawn.

    Returns
    -------
    SignPerturbedSet
        See `anderson_rubin_set`.

    Raises
    ------
    InstrumentError
        When the method compensates, or an instrument shares noise with an error of any time.
    UsageError
        When rows are no time samples.
    ParameterError
        When level and number of sums do not fit.
    """
    check_method(method)
    checks.level(level)
    checks.kind("rng", rng, np.random.Generator, "a generator", "Give numpy.random.default_rng(0).")
    checks.whole("sums", sums)
    if not isinstance(method.assembler, Instrumental):
        raise InstrumentError(
            "instruments that are independent of the errors, without compensation",
            f"the equations of {method.name}",
            "Use extended_iv with instruments of exact or of other channels, or anderson_rubin_set, "
            "which takes compensated equations.",
        )
    _check_independent(problem)
    rows = moment_rows(problem, method)
    if not isinstance(rows.layout, SampleRows):
        expected = "rows that are time samples"
        remedy = "Use anderson_rubin_set."
        raise UsageError(expected, "bins of spectra, whose errors are not independent", remedy)
    usable = rows.independent()
    region = anderson_rubin.sign_perturbed_region(
        usable.names, usable.test_functions, usable.columns, rng, level=level, sums=sums
    )
    return SignPerturbedSet(problem.parameters, level, sums, region)


def _check_independent(problem: LinearProblem) -> None:
    """Refuse instruments of a channel whose noise is in the errors of other rows."""
    if not isinstance(problem, SignalRegression):
        return
    others = (*problem.regressor_columns, problem.equation.response)
    noisy = {column.channel for column in others if column.channel}
    for channel, noise in problem.signals.noise.items():
        if getattr(noise, "std", None) == 0.0:
            noisy.discard(channel)
    shared = sorted(noisy & {column.channel for column in problem.instrument_columns})
    if shared:
        raise InstrumentError(
            "instruments of channels that are exact, or that are no regressor and no response",
            f"instruments of '{shared[0]}', whose measurement noise is in the errors of other rows",
            "Declare its noise with std 0 if the channel is exact, use a reference as instrument, or "
            "anderson_rubin_set.",
        )
