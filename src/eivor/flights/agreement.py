"""Whether two measurements of one response agree: sensors that are late, scaled or turned.

An accelerometer and a differentiated velocity tell the same acceleration. Their difference holds no vehicle,
no input and no lag, so that a regression of it on what each kind of disagreement would leave, with the
references as instruments, tells how far they disagree, and in which way. A motion says which columns these
are; here they are estimated and judged.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from eivor.errors import EstimationError, InstrumentError, TooFewSamplesError
from eivor.estimation.fit import identify
from eivor.estimation.methods import reference_iv
from eivor.inference.covariances.estimators import Classical, EqualWeightedCosines
from eivor.inference.diagnostics.diagnostic import BEYOND_DOUBT, SIGNIFICANT
from eivor.inference.quantiles import chi_square_tail, t_quantile, t_tail
from eivor.models.lagged_runs import LaggedRuns

#: Cosine averages of the standard error, and the degrees of freedom of its t.
AVERAGES = 16
#: A difference is told below this p-value: four kinds together have false alarms in less than 1 % of flights.
TOLD = 0.004


@dataclass(frozen=True, slots=True)
class Difference:
    """How far two measurements differ in one way.

    Parameters
    ----------
    value, std_error : float
        In the unit of its parameter; the error is the larger one of white residuals and cosine averages.
    least : float
        A smaller difference matters to nothing.
    """

    value: float
    std_error: float
    least: float = 0.0

    @property
    def p_value(self) -> float:
        """Of the test that there is none."""
        return t_tail(self.value / self.std_error, AVERAGES) if self.std_error > 0.0 else 1.0

    @property
    def told(self) -> bool:
        """Whether it is there, and matters."""
        return self.p_value < TOLD and abs(self.value) >= self.least

    @property
    def half_width(self) -> float:
        """Half the width of its 95 % interval."""
        return t_quantile(0.95, AVERAGES) * self.std_error


@dataclass(frozen=True, slots=True)
class SensorAgreement:
    """In which ways two measurements of one response differ.

    Parameters
    ----------
    differences : mapping of str to Difference
        By the motion's names.
    p_value : float
        Of the test that they differ in no other way (over-identification).
    either : mapping of str to Difference
        Where the flight does not tell kinds apart: each that explains all of the difference, as large as it
        is without the others.
    """

    differences: Mapping[str, Difference]
    p_value: float
    either: Mapping[str, Difference] = field(default_factory=dict)

    @property
    def told(self) -> dict[str, Difference]:
        """Differences that are there, and matter."""
        return {name: one for name, one in self.differences.items() if one.told}

    @property
    def otherwise(self) -> bool:
        """Whether they differ in another way beyond doubt."""
        return self.p_value < BEYOND_DOUBT

    @property
    def numbers(self) -> dict[str, float]:
        """The same by name, for diagnostics."""
        found = {"sensors_p_value": self.p_value}
        for name, one in self.differences.items():
            found |= {f"sensors_{name}": one.value, f"sensors_{name}_p_value": one.p_value}
        return found


def sensor_agreement(problem: LaggedRuns | None, least: Mapping[str, float]) -> SensorAgreement | None:
    """Estimate in which ways two measurements differ.

    Parameters
    ----------
    problem : LaggedRuns or None
        Their difference, one column for each kind of disagreement, and instruments; None where the log has
        but one measurement.
    least : mapping of str to float
        The smallest difference of each kind that matters.

    Returns
    -------
    SensorAgreement or None
        None where the instruments tell nothing of it.
    """
    if problem is None:
        return None
    try:
        together = estimated(problem, least)
        found = SensorAgreement(together.differences, together.p_value)
        if found.told or together.none_p_value > BEYOND_DOUBT:
            return found
        return replace(found, either=_alone(problem, least))
    except (EstimationError, InstrumentError, TooFewSamplesError):
        return None


@dataclass(frozen=True, slots=True)
class Estimated:
    """Coefficients of columns with their standard errors.

    Parameters
    ----------
    differences : dict of str to Difference
        By parameter.
    none_p_value, p_value : float
        Of the tests that all of them are zero, and that no other column is missing (over-identification).
    """

    differences: dict[str, Difference]
    none_p_value: float
    p_value: float


def estimated(problem: LaggedRuns, least: Mapping[str, float]) -> Estimated:
    """Coefficients of a problem without nuisances, estimated and judged as disagreements are.

    Raises
    ------
    EstimationError
        When nothing is left of the difference to judge them by.
    """
    estimate = identify(problem, reference_iv())
    _, p_value = estimate.best.inference.over_identification
    parts = [
        part.matrix
        for estimator in (Classical(), EqualWeightedCosines(AVERAGES))
        for part in estimate.with_covariance(estimator).best.covariance.parts
    ]
    errors = np.sqrt(np.max([np.diag(part) for part in parts], axis=0))
    if not bool((errors > 0.0).all()):
        raise EstimationError(
            "sensors whose difference has an error",
            "sensors that differ by nothing, or by exactly what is sought",
            "Give what was measured.",
        )
    values = estimate.best.values
    scaled, correlation = values / errors, parts[0] / np.outer(errors, errors)
    wald = float(scaled @ np.linalg.lstsq(correlation, scaled, rcond=None)[0])
    named = zip(estimate.names, values.tolist(), errors.tolist(), strict=True)
    return Estimated(
        {name: Difference(value, error, least.get(name, 0.0)) for name, value, error in named},
        chi_square_tail(wald, values.size),
        1.0 if math.isnan(p_value) else p_value,
    )


def _alone(problem: LaggedRuns, least: Mapping[str, float]) -> dict[str, Difference]:
    """Kinds that explain the difference by themselves: there beyond doubt, and nothing is left."""
    found: dict[str, Difference] = {}
    for place, parameter in enumerate(problem.parameters):
        columns = tuple(replace(one, fixed=one.fixed[:, [place]]) for one in problem.columns)
        alone = estimated(replace(problem, columns=columns, parameters=(parameter,)), least)
        one = alone.differences[parameter.name]
        if one.told and one.p_value < BEYOND_DOUBT and alone.p_value >= SIGNIFICANT:
            found[parameter.name] = one
    return found
