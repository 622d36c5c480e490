"""Confidence sets that hold whatever the strength of the instruments, for the problems `identify` takes.

An interval "estimate plus and minus" supposes that the instruments move the regressors. The sets here do
not: where the data do not tell a parameter, they are unbounded. They differ in what they assume of the
errors, and each says it in a sentence.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from eivor import checks
from eivor.errors import InstrumentError, UsageError
from eivor.estimation.assembler import Instrumental
from eivor.estimation.error_assumptions import AutocorrelatedErrors, ErrorAssumption
from eivor.estimation.linear import LinearMethod, check_linear
from eivor.estimation.moment_rows import MomentRows, moment_rows
from eivor.inference.quantiles import check_level
from eivor.inference.sets.confidence_region import ConfidenceRegion
from eivor.inference.sets.confidence_set import ConfidenceSet
from eivor.inference.sets.sign_perturbation import sign_perturbed_region
from eivor.models.equation import Parameter
from eivor.models.regression import LinearProblem
from eivor.models.rows import SampleRows
from eivor.models.signal_regression import SignalRegression


@dataclass(frozen=True)
class AndersonRubinSet:
    """Confidence sets by inversion of the Anderson-Rubin test.

    Parameters
    ----------
    parameters : tuple of Parameter
        All parameters of the problem.
    level : float
        Confidence level.
    errors : ErrorAssumption
        What is supposed of the errors.
    rows : MomentRows
        The equations.
    """

    parameters: tuple[Parameter, ...]
    level: float
    errors: ErrorAssumption
    rows: MomentRows = field(repr=False)

    @cached_property
    def partialled_out(self) -> tuple[str, ...]:
        """Parameters of regressors that are their own instruments; they are not in `region`."""
        own = self.rows.own_instruments()
        exogenous = tuple(p.name for j, p in enumerate(self.parameters) if j in own)
        return () if len(exogenous) == len(self.parameters) else exogenous

    @cached_property
    def region(self) -> ConfidenceRegion:
        """Joint region of the parameters that are not partialled out, in their order."""
        return self._region_with()

    @cached_property
    def intervals(self) -> dict[str, ConfidenceSet]:
        """Confidence set of each parameter."""
        return {parameter.name: self.interval(parameter.name) for parameter in self.parameters}

    @property
    def is_empty(self) -> bool:
        """Whether no value of the parameters passes the test: then the data reject the model."""
        return any(found.is_empty for found in self.intervals.values())

    @property
    def assumptions(self) -> str:
        """What the sets suppose."""
        return self.errors.sentence

    def interval(self, name: str) -> ConfidenceSet:
        """Confidence set of one parameter, the others being whatever they may.

        Exogenous regressors are partialled out, all but the parameter's own. The rest is the shadow of the
        joint region; for classical errors with the degrees of freedom of one parameter.

        Raises
        ------
        UsageError
            When there is no parameter of that name.
        """
        checks.text("name", name)
        names = tuple(parameter.name for parameter in self.parameters)
        if name not in names:
            raise UsageError(f"a parameter out of {', '.join(names)}", f"'{name}'", "Name one of them.")
        exogenous = set(self.rows.own_instruments())
        if len(exogenous) < len(names) and names.index(name) not in exogenous:
            return self.region.interval(name)
        return self._region_with(name).interval(name)

    def summary(self) -> str:
        """Sets of all parameters as text, with what they suppose."""
        return _summary("Anderson-Rubin", self.level, self.parameters, self.intervals, self.assumptions)

    def _region_with(self, kept: str = "") -> ConfidenceRegion:
        """Region with every exogenous regressor partialled out but `kept`; all, if there is no other."""
        names = [parameter.name for parameter in self.parameters]
        gone = [j for j in self.rows.own_instruments() if names[j] != kept]
        if len(gone) == len(names):
            gone = []
        return self.errors.region(self.rows.without(gone).independent(), self.level)


@dataclass(frozen=True)
class SignPerturbedSet:
    """Confidence sets by sign perturbation.

    Parameters
    ----------
    parameters : tuple of Parameter
        All parameters of the problem.
    level : float
        Exact coverage of `region`.
    sums : int
        Number of sums that are ranked.
    region : ConfidenceRegion
        Joint region of all parameters; its membership is exact.
    """

    parameters: tuple[Parameter, ...]
    level: float
    sums: int
    region: ConfidenceRegion = field(repr=False)

    @cached_property
    def intervals(self) -> dict[str, ConfidenceSet]:
        """Confidence set of each parameter."""
        return {parameter.name: self.interval(parameter.name) for parameter in self.parameters}

    @property
    def is_empty(self) -> bool:
        """Whether no value of the parameters belongs to the region; it may be so by chance alone."""
        return any(found.is_empty for found in self.intervals.values())

    @property
    def assumptions(self) -> str:
        """What the sets suppose."""
        return (
            "Errors are symmetric about zero and independent in time, and the instruments are independent of "
            "all of them, past and future. Variances may change from row to row, moments need not exist. "
            "Coverage of the joint region is exact in every sample, and at least as high of each interval."
        )

    def interval(self, name: str) -> ConfidenceSet:
        """Shadow of the region on a parameter's axis: at least the level.

        Exact for one parameter; with two, pieces and gaps narrower than a degree, as seen from the region's
        middle in standard errors, may be missed; with more it is a search.

        Raises
        ------
        UsageError
            When there is no parameter of that name.
        """
        return self.region.interval(name)

    def summary(self) -> str:
        """Sets of all parameters as text, with what they suppose."""
        return _summary("sign-perturbed sums", self.level, self.parameters, self.intervals, self.assumptions)


def anderson_rubin_set(
    problem: LinearProblem,
    method: LinearMethod,
    *,
    errors: ErrorAssumption | None = None,
    level: float = 0.95,
) -> AndersonRubinSet:
    """Confidence sets that hold however weak the instruments are.

    Parameters
    ----------
    problem : Regression or SignalRegression
        As for `identify`.
    method : LinearMethod
        Whose moment equations are tested: `extended_iv`, `generalized_iv`, with or without total least
        squares, or `bias_compensated_least_squares`. Its weighting and its solver play no part.
    errors : ErrorAssumption, optional
        `AutocorrelatedErrors()` (default) or `HomoskedasticErrors()`.
    level : float
        Confidence level.

    Returns
    -------
    AndersonRubinSet
        `region.contains(theta)`, `region.outline()`, `interval(name)`, `summary()`.

    Raises
    ------
    UsageError
        When the method has no moment equations, the level is not between 0 and 1, or the classical test is
        asked of compensated equations.
    InstrumentError, MissingNoiseError, TooFewSamplesError
        When the method refuses the problem, or instruments or samples are too few.
    """
    check_level(level)
    if errors is None:
        errors = AutocorrelatedErrors()
    checks.kind("errors", errors, ErrorAssumption, "AutocorrelatedErrors() or HomoskedasticErrors()")
    rows = moment_rows(problem, method)
    found = AndersonRubinSet(problem.parameters, level, errors, rows)
    found.region  # noqa: B018 - what cannot be used is refused here, not at the first question
    return found


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
        `region.contains(theta)`, `region.outline()`, `interval(name)`, `summary()`.

    Raises
    ------
    InstrumentError
        When the method compensates, or an instrument shares noise with an error of any time.
    UsageError
        When rows are no time samples.
    ParameterError
        When level and number of sums do not fit.
    """
    check_linear(method)
    check_level(level)
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
        raise UsageError(
            "rows that are time samples",
            "bins of spectra, whose errors are not independent",
            "Use anderson_rubin_set.",
        )
    usable = rows.independent()
    region = sign_perturbed_region(
        usable.names, usable.test_functions, usable.columns, rng, level=level, sums=sums
    )
    return SignPerturbedSet(problem.parameters, level, sums, region)


def _check_independent(problem: LinearProblem) -> None:
    """Refuse instruments of a channel whose noise is in the errors of other rows.

    A past input, measured with noise, is uncorrelated with the error of its own row. But its noise is in
    an earlier row's error, and sign perturbation needs independence of all of them.
    """
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


def _summary(
    method: str,
    level: float,
    parameters: tuple[Parameter, ...],
    intervals: dict[str, ConfidenceSet],
    assumptions: str,
) -> str:
    lines = [f"{method}, {100.0 * level:g} %"]
    lines.extend(f"{p.name:<20} {intervals[p.name]}  {p.unit}".rstrip() for p in parameters)
    if any(found.is_empty for found in intervals.values()):
        lines.append("No value passes: the data reject the model, its instruments or the declared noises.")
    lines.append(assumptions)
    return "\n".join(lines)
