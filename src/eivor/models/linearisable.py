"""Problems whose nuisances' own columns are known with the noise in them, so that any method takes them.

At some values of the nuisances the equation is linear in their changes as well: y = Phi theta + D delta.
The columns of D are combinations of the channels like those of Phi, and share noise with them.
"""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from eivor.models.regression import LinearProblem, Regression
from eivor.models.separable import SeparableProblem, Values
from eivor.shapes import Float


class LinearisableProblem(SeparableProblem):
    """A separable problem that is, beside any point, a linear problem of all its unknowns."""

    @abstractmethod
    def regression(self, at: Values) -> LinearProblem:
        """Problem of the linear parameters at values of the nuisances."""

    @abstractmethod
    def linearised(self, at: Values, theta: Float[np.ndarray, " n"]) -> LinearProblem:
        """Problem of the linear parameters and of the changes of the nuisances, beside a point.

        Parameters
        ----------
        at : mapping of str to float
            Values of the nuisances.
        theta : ndarray, shape (n,)
            Linear parameters, which the nuisances' columns are in proportion to.
        """

    def rows(self, at: Values) -> Regression:
        """Rows in time."""
        return self.regression(at).rows()
