"""Estimates: named parameters with everything that inference needs.

The vector of estimates is *joint*: the linear parameters and the continuous nuisances that were searched for
(an actuator's lag, say), so that every interval includes their uncertainty. Discrete nuisances (its delay)
take a few values; each combination has its candidate, and an interval is the union over the candidates that
the data cannot tell apart.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from eivor import checks
from eivor.errors import EstimationError, UsageError
from eivor.estimation.candidate import Candidate
from eivor.estimation.competing import least_of_competitors
from eivor.estimation.fitted_noise import FittedNoise
from eivor.inference.covariances.estimators import CovarianceEstimator, check_covariance_estimator
from eivor.inference.quantiles import check_level, chi_square_quantile
from eivor.inference.sets.ellipse import Ellipse, joint_ellipse
from eivor.inference.verdict import Reason, Status, verdict
from eivor.models.equation import Parameter
from eivor.notebook import html_table
from eivor.shapes import Float

if TYPE_CHECKING:
    import polars as pl

#: A scalar function of a candidate's joint vector: its value and its gradient.
Quantity = Callable[[Candidate], tuple[float, Float[np.ndarray, " n"]]]


@dataclass(frozen=True)
class Estimate:
    """Named parameters with units, intervals and what they rest on.

    Parameters
    ----------
    method : str
        Name of the method.
    joint_parameters : tuple of Parameter
        In the order of the joint vector.
    candidates : tuple of Candidate
        One for each combination of discrete nuisances, in the order of their grids.
    reasons : tuple of Reason
        Grounds against the estimate that were met while it was made.
    bounded : tuple of tuple of str
        Discrete nuisances whose sum is known between bounds: every value of it counts, and candidates are
        compared with those of the same value only.
    noises : tuple of FittedNoise
        Noises that were fitted together with the parameters, by a spectral method.
    """

    method: str
    joint_parameters: tuple[Parameter, ...]
    candidates: tuple[Candidate, ...]
    reasons: tuple[Reason, ...] = ()
    bounded: tuple[tuple[str, ...], ...] = ()
    noises: tuple[FittedNoise, ...] = ()

    @property
    def status(self) -> Status:
        """Weak when the instruments are; see `reasons`."""
        return verdict(list(self.reasons)).status

    @cached_property
    def best(self) -> Candidate:
        """Candidate with the least criterion."""
        if len(self.candidates) == 1:
            return self.candidates[0]
        return min(self.candidates, key=lambda candidate: candidate.criterion)

    def tenable(self, level: float = 0.95) -> tuple[Candidate, ...]:
        """Candidates whose criterion is within a chi-square quantile of the least one they compete with.

        With a degree of freedom for each discrete nuisance that has a choice, but those that are bounded.
        """
        if len(self.candidates) == 1:
            return self.candidates
        allowance = chi_square_quantile(level, self.choices)
        compared = zip(self.candidates, self.excesses, strict=True)
        return tuple(one for one, excess in compared if excess <= allowance)

    @property
    def choices(self) -> int:
        """Discrete nuisances that have a choice, but those that are bounded; one at least."""
        refined = {profile.nuisance.name for profile in self.best.profiles}
        chosen = [name for name in self.best.at if name not in refined and len(self._values_of(name)) > 1]
        return max(len(chosen) - len(self.bounded), 1)

    @property
    def excesses(self) -> tuple[float, ...]:
        """What each candidate's criterion is above the least one that it competes with."""
        if len(self.candidates) == 1:
            return (0.0,)
        criteria = [one.criterion for one in self.candidates]
        least = self.least_of_competitors(criteria)
        return tuple(one - lowest for one, lowest in zip(criteria, least, strict=True))

    def least_of_competitors(self, criteria: Sequence[float]) -> list[float]:
        """For each candidate the least criterion of those it competes with, see `competing`."""
        return least_of_competitors(self.bounded, [one.at for one in self.candidates], criteria)

    def _values_of(self, nuisance: str) -> set[float]:
        return {candidate.at[nuisance] for candidate in self.candidates}

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each joint parameter."""
        return tuple(p.name for p in self.joint_parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each joint parameter."""
        return tuple(p.unit for p in self.joint_parameters)

    @property
    def parameters(self) -> dict[str, float]:
        """Value of each joint parameter of the best candidate."""
        return {name: float(value) for name, value in zip(self.names, self.best.values, strict=True)}

    @property
    def covariance(self) -> Float[np.ndarray, "n n"]:
        """Covariance of the best candidate, in the order of `names`: see `JointCovariance.matrix`."""
        return self.best.covariance.matrix

    @property
    def residuals(self) -> Float[np.ndarray, " rows"]:
        """Residuals of the weighted rows of the best candidate."""
        return self.best.residuals

    @property
    def condition(self) -> float:
        """Condition number of the equations, columns scaled to unit length."""
        return self.best.solution.condition

    def direction(self, name: str) -> Float[np.ndarray, " n"]:
        """Unit vector of a parameter.

        Raises
        ------
        UsageError
            When there is no parameter of that name.
        """
        checks.text("name", name)
        if name not in self.names:
            raise UsageError(f"a parameter out of {', '.join(self.names)}", f"'{name}'", "Name one of them.")
        return np.eye(len(self.names))[self.names.index(name)]

    def with_covariance(self, estimator: CovarianceEstimator) -> Estimate:
        """Same estimates, with intervals from another covariance.

        Parameters
        ----------
        estimator : CovarianceEstimator
            One of `eivor.covariances`.

        Raises
        ------
        EstimationError
            For an estimate whose rows are not at hand.
        """
        check_covariance_estimator(estimator)
        if not all(one.has_rows for one in self.candidates):
            raise EstimationError(
                "an estimate with its rows at hand, for another covariance",
                "one from chunks or moments, which keeps no rows",
                "Name the covariance when you identify: identify_chunks(..., covariance=...).",
            )
        candidates = tuple(replace(one, covariance_estimator=estimator) for one in self.candidates)
        return replace(self, candidates=candidates)

    def ellipse(self, name: str, other: str, level: float = 0.95) -> Ellipse:
        """Joint confidence region of two parameters of the best candidate.

        Of several covariances, the one whose region is largest.

        Raises
        ------
        UsageError
            When a name is unknown, the two are one, or the level is not between 0 and 1.
        """
        check_level(level)
        checks.text("name", name)
        checks.text("other", other)
        if name == other:
            raise UsageError("two parameters", f"'{name}' twice", "Name another one.")
        pair = np.stack([self.direction(name), self.direction(other)])
        ellipses = [
            joint_ellipse(self.best.values, part.matrix / part.share, pair, level=level, degrees=part.degrees)
            for part in self.best.covariance.parts
        ]
        return max(ellipses, key=lambda ellipse: ellipse.area)

    def std_error(self, name: str) -> float:
        """Largest of the standard errors of the best candidate."""
        return self.best.covariance.std_error(self.direction(name))

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a parameter, a union over the candidates that fit.

        Raises
        ------
        UsageError
            When there is no parameter of that name, or the level is not between 0 and 1.
        """
        direction = self.direction(name)
        return self.interval_of(lambda candidate: (float(direction @ candidate.values), direction), level)

    def interval_of(
        self,
        quantity: Quantity,
        level: float = 0.95,
        extra_variance: Callable[[Candidate], float] = lambda _: 0.0,
    ) -> tuple[float, float]:
        """Confidence interval of a function of the joint vector, by the delta method at each candidate.

        Raises
        ------
        UsageError
            When the level is not between 0 and 1.
        """
        check_level(level)
        ends: list[float] = []
        for candidate in self.tenable(level):
            value, gradient = quantity(candidate)
            half = candidate.covariance.half_width(gradient, level, extra_variance(candidate))
            ends.extend((value - half, value + half))
        return min(ends), max(ends)

    def to_frame(self) -> pl.DataFrame:
        """Table of the parameters.

        Returns
        -------
        polars.DataFrame
            Columns `parameter`, `value`, `unit`; with the rows at hand also `std_error`, `low`, `high`
            (95 %).
        """
        import polars as pl

        columns: dict[str, list[str] | list[float]] = {
            "parameter": list(self.names),
            "value": [self.parameters[name] for name in self.names],
            "unit": list(self.units),
        }
        if self.best.has_covariance:
            intervals = [self.interval(name) for name in self.names]
            columns["std_error"] = [self.std_error(name) for name in self.names]
            columns["low"] = [low for low, _ in intervals]
            columns["high"] = [high for _, high in intervals]
        return pl.DataFrame(columns)

    def __repr__(self) -> str:
        values = ", ".join(f"{name} {value:.5g}" for name, value in self.parameters.items())
        return f"<Estimate by {self.method}: {values}; {self.status.value}>"

    def _repr_html_(self) -> str:
        frame = self.to_frame()
        rows = [
            [f"{cell:.5g}" if isinstance(cell, float) else str(cell) for cell in row] for row in frame.rows()
        ]
        note = " ".join(f"{reason.sentence} {reason.remedy}" for reason in self.reasons)
        return html_table(f"{self.method}: {self.status.value}", frame.columns, rows, note)

    def to_json(self) -> str:
        """Text of a JSON document: the table of `to_frame`, row by row, and the covariance."""
        rows = [
            {
                key: None if isinstance(value, float) and not math.isfinite(value) else value
                for key, value in row.items()
            }
            for row in self.to_frame().to_dicts()
        ]
        covariance = self.covariance.tolist() if self.best.has_covariance else None
        document = {"method": self.method, "parameters": rows, "covariance": covariance}
        return json.dumps(document, indent=2, allow_nan=False) + "\n"

    def summary(self) -> str:
        """Table of parameters as text, with standard errors and 95 % intervals when the rows are at hand."""
        if not self.best.has_covariance:
            lines = [f"{self.method} (from moments: no standard errors)"]
            return "\n".join([*lines, *(f"{n:<20}{v:>12.5g}" for n, v in self.parameters.items())])
        lines = [
            f"{self.method}",
            f"{'parameter':<20}{'value':>12}{'std. error':>12}{'95 % interval':>30}  unit",
        ]
        for parameter in self.joint_parameters:
            low, high = self.interval(parameter.name)
            lines.append(
                f"{parameter.name:<20}{self.parameters[parameter.name]:>12.5g}"
                f"{self.std_error(parameter.name):>12.3g}{f'[{low:.5g}, {high:.5g}]':>30}  {parameter.unit}"
            )
        lines.extend(f"noise of {noise.sentence}" for noise in self.noises)
        lines.extend(f"- {reason.sentence} {reason.remedy}" for reason in self.reasons)
        return "\n".join(lines)
