"""Fuller's modification of limited information maximum likelihood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor import checks
from eivor.errors import UsageError
from eivor.linalg.augmented import balanced, solve_augmented
from eivor.linalg.split_problem import split_problem
from eivor.linalg.system import LinearSystem, Solution
from eivor.linalg.total_least_squares import ErrorsInColumns


@dataclass(frozen=True, slots=True)
class Fuller(ErrorsInColumns):
    """Total least squares with less of a shift: (R'R - (sigma^2 - a/nu) I) theta = R' right (Fuller 1977).

    Of two-stage equations whose columns' errors have the covariance that the instruments leave (see
    `eivor.estimation.weighting.limited_information`) total least squares is limited information maximum
    likelihood, and this is Fuller's modification of it, the k-class with k = k_LIML - a/nu. Unlike LIML it
    has moments: a = 1 is nearly unbiased, a = 4 has a small mean square error.

    Parameters
    ----------
    strength : float
        a, zero for LIML.

    Raises
    ------
    UsageError
        When it is no number of zero or more.
    """

    strength: float = 1.0

    def __post_init__(self) -> None:
        checks.within(self, {"strength": (0.0, 1e6)}, "Use 1, or 4.")

    def solve(self, system: LinearSystem) -> Solution:
        """Solution, see `Solver.solve`.

        Raises
        ------
        UsageError
            When the errors' covariance is no estimate, which has degrees of freedom.
        """
        if system.error_degrees is None:
            raise UsageError(
                "equations whose errors' covariance was estimated, on so many degrees of freedom",
                "ones without",
                "Use the method that goes with it: eivor.methods.fuller().",
            )
        split = split_problem(system)
        if not split.noisy.size:
            return split.solution(split.theta(np.empty(0)))
        shift = split.smallest**2 - self.strength / system.error_degrees
        upper = balanced(split.R, shift)
        return split.solution(split.theta(solve_augmented(split.R, split.right, upper, shift / upper)))
