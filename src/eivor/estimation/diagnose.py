"""Diagnose: what an estimate rests on, each part made when it is first asked for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple, dataclass, field
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from eivor import checks
from eivor.errors import EivorError, EstimationError, UsageError
from eivor.estimation.assembler import Compensated, Instrumental
from eivor.estimation.estimate import Estimate
from eivor.estimation.evidence import DIAGNOSTICS, Evidence
from eivor.estimation.linear import LinearMethod
from eivor.estimation.solved import Solved
from eivor.estimation.weighting.equations import TwoStage
from eivor.inference.diagnostics.constancy import Constancy
from eivor.inference.diagnostics.diagnostic import BEYOND_DOUBT, Diagnostic
from eivor.inference.diagnostics.endogeneity import NOTABLE_BIAS, DirectScores, Endogeneity, endogeneity
from eivor.inference.diagnostics.excitation import BandPower, Information
from eivor.inference.diagnostics.leverage import SegmentLeverage
from eivor.inference.diagnostics.over_identification import OverIdentification
from eivor.inference.diagnostics.periodicity import Periodicity
from eivor.inference.diagnostics.residual_memory import ResidualMemory
from eivor.inference.diagnostics.residual_whiteness import ResidualWhiteness
from eivor.inference.diagnostics.strength import Strength
from eivor.inference.verdict import Reason, Status
from eivor.linalg.least_squares import LeastSquares
from eivor.models.regression import LinearProblem

if TYPE_CHECKING:
    import polars as pl

D = TypeVar("D", bound=Diagnostic)


def diagnose(estimate: Estimate) -> Diagnostics:
    """Diagnostics of an estimate at its best candidate.

    Parameters
    ----------
    estimate : Estimate
        With its rows at hand.

    Returns
    -------
    Diagnostics
        Whose parts are computed when they are first used, and kept.

    Raises
    ------
    EstimationError
        For an estimate from moments, which do not keep the rows.

    Notes
    -----
    One pass over the rows gives sums of products over a hundred blocks or so, from which strength, J,
    endogeneity, constancy, periodicity and leverage follow; whiteness, memory and spectra read the
    residual.
    """
    checks.kind("estimate", estimate, Estimate, "an estimate", "Make one by ev.identify(...).")
    if not estimate.best.has_rows:
        raise EstimationError(
            "an estimate with its rows at hand, for diagnostics",
            "an estimate from moments, which do not keep the rows",
            "Identify a chunk that fits in memory, or the whole problem.",
        )
    return Diagnostics(Evidence(estimate, estimate.best.solved))


@dataclass(frozen=True)
class Diagnostics:
    """What an estimate rests on.

    Parameters
    ----------
    evidence : Evidence
        The estimate and its record; everything is said of its best candidate.
    """

    evidence: Evidence = field(repr=False)
    _made: dict[str, Diagnostic | None] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def estimate(self) -> Estimate:
        """What it is said of."""
        return self.evidence.estimate

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each joint parameter, in the order of every array."""
        return self.evidence.estimate.names

    def __getitem__(self, name: str) -> Diagnostic | None:
        """Diagnostic of that name; None where it cannot be made.

        Raises
        ------
        UsageError
            When there is none of that name.
        """
        if name not in DIAGNOSTICS:
            raise UsageError(
                f"a diagnostic out of {', '.join(DIAGNOSTICS)}", f"'{name}'", "Name one of them."
            )
        if name not in self._made:
            self._made[name] = DIAGNOSTICS[name](self.evidence)
        return self._made[name]

    def __iter__(self) -> Iterator[Diagnostic]:
        """Return every diagnostic that can be made, in the order of tables."""
        return (found for found in map(self.__getitem__, DIAGNOSTICS) if found is not None)

    @property
    def first_stage(self) -> Strength | None:
        """Strength of the instruments; None without instruments."""
        return self._of_kind("first_stage", Strength)

    @property
    def over_identification(self) -> OverIdentification | None:
        """Hansen's J; None without instruments."""
        return self._of_kind("over_identification", OverIdentification)

    @property
    def endogeneity(self) -> Endogeneity | None:
        """Least squares against the estimate; None when the estimate is a kind of least squares."""
        return self._of_kind("endogeneity", Endogeneity)

    @property
    def whiteness(self) -> ResidualWhiteness:
        """Autocorrelation of the residual."""
        return self._needed("whiteness", ResidualWhiteness)

    @property
    def memory(self) -> ResidualMemory | None:
        """Long memory of the residual; None where it cannot be told."""
        return self._of_kind("memory", ResidualMemory)

    @property
    def information(self) -> Information:
        """Which combination of parameters is determined worst."""
        return self._needed("information", Information)

    @property
    def bands(self) -> BandPower:
        """Power of each column against that of the residual, in bands."""
        return self._needed("bands", BandPower)

    @property
    def constancy(self) -> Constancy | None:
        """Whether the parameters changed during the record; None for fewer than 64 samples."""
        return self._of_kind("constancy", Constancy)

    @property
    def periodicity(self) -> Periodicity | None:
        """Whether the parameters vary periodically; None for few samples, or several flights."""
        return self._of_kind("periodicity", Periodicity)

    @property
    def leverage(self) -> SegmentLeverage | None:
        """What leaving out each of ten segments does; None for too few samples."""
        return self._of_kind("leverage", SegmentLeverage)

    def _of_kind(self, name: str, kind: type[D]) -> D | None:
        found = self[name]
        return found if isinstance(found, kind) else None

    def _needed(self, name: str, kind: type[D]) -> D:
        found = self[name]
        assert isinstance(found, kind)  # noqa: S101 - its maker makes it of every estimate
        return found

    @property
    def segments(self) -> tuple[tuple[int, int], ...]:
        """First sample and end of each segment of `leverage`."""
        return self.leverage.segments if self.leverage is not None else ()

    def when(self, share: float) -> str:
        """Where a share of the rows is: in seconds and samples of a record, else in rows."""
        return self.evidence.subject.when(share)

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """What speaks against the estimate or should be known of it, each with what to do."""
        return tuple(reason for found in self for reason in found.reasons(self.evidence.subject))

    def to_frame(self) -> pl.DataFrame:
        """Table of every number.

        Returns
        -------
        polars.DataFrame
            Columns `diagnostic`, `of` (parameter, lag or band; empty for the whole), `value` and `compare`:
            the critical value, p-value, standard error or band that the value is to be held against.
        """
        import polars as pl

        rows = [astuple(row) for found in self for row in found.rows(self.evidence.subject)]
        columns = ("diagnostic", "of", "value", "compare")
        return pl.DataFrame(
            rows,
            schema=dict.fromkeys(columns[:2], pl.String) | dict.fromkeys(columns[2:], pl.Float64),
            orient="row",
        )

    def summary(self) -> str:
        """Every diagnostic in a line or two, and what to do about those that matter."""
        lines = [f"diagnostics of {self.evidence.estimate.method}"]
        lines.extend(line for found in self for line in found.lines(self.evidence.subject))
        lines.extend(f"- {reason.sentence} {reason.remedy}" for reason in self.reasons)
        return "\n".join(lines)


def contradiction(problem: LinearProblem, estimate: Estimate) -> tuple[Reason, ...]:
    """Ground against a direct estimate that the problem's own instruments contradict beyond doubt.

    Parameters
    ----------
    problem : LinearProblem
        With instruments.
    estimate : Estimate
        By a method without instruments. One of other rows, and a regularised one, are not tested.
    """
    direct = estimate.best.solved
    pulled = direct.solution.shrinkage is not None and direct.solution.shrinkage.shift.any()
    if direct.problem is not problem or direct.assembler.needs_instruments or pulled:
        return ()
    shares = problem.instruments_share_noise()
    assembler = Compensated() if shares else Instrumental()
    two_stage = LinearMethod("two_stage", assembler, LeastSquares(), equation_weighting=TwoStage())
    try:
        told = Evidence(estimate, two_stage.determined(two_stage.moments(problem), problem))
    except (EivorError, np.linalg.LinAlgError):
        return ()  # the instruments do not determine the parameters
    if not told.testable or told.fits_exactly:
        return ()
    record = told.record
    test = endogeneity(record.products, record.weights, direct=_scores(direct, told))
    if test is None or not test.p_value < BEYOND_DOUBT:
        return ()
    apart = np.abs(test.difference) / told.subject.std_errors
    j = int(np.argmax(apart))
    if not apart[j] > NOTABLE_BIAS:
        return ()
    sentence = (
        f"The instruments contradict it: they give {estimate.names[j]} {told.solved.solution.theta[j]:.4g}, "
        f"{apart[j]:.1f} standard errors away (p-value {test.p_value:.1g}). A regressor is correlated with "
        "the error, or a declared noise is wrong."
    )
    instrumental = "generalized_iv" if shares else "extended_iv"
    remedy = f"Use {instrumental}, or leave out instruments that are not exogenous."
    return (Reason(Status.WEAK, sentence, remedy),)


def _scores(direct: Solved, told: Evidence) -> DirectScores:
    """Scores of a direct estimate, from the products of an instrumental one."""
    products, theta = told.record.products, direct.solution.theta
    difference = theta - told.solved.solution.theta
    GG = np.asarray(products.regressors.sum(axis=0))
    power = float(products.power.sum() - 2.0 * difference @ products.regressor_residual.sum(axis=0))
    power += float(difference @ GG @ difference)
    if direct.assembler.moment_equations:
        sensitivity = products.count * direct.system.matrix
        return DirectScores(difference, np.zeros(theta.size), direct.constant, sensitivity)
    root = np.sqrt(power)
    correction = direct.solver.score_correction(np.array([root]), theta, direct.system.error_covariance)
    return DirectScores(
        difference, correction.rows[0] / root, np.zeros(theta.size), GG + correction.sensitivity
    )
