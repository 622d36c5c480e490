"""Regularisation as a study names it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from eivor.errors import UsageError
from eivor.estimation import methods
from eivor.estimation.linear import LinearMethod
from eivor.estimation.method import Method
from eivor.linalg import ParameterChoice, Regularisation
from eivor.studies.among import check_among

#: Regularisations by name.
SCHEMES: Mapping[str, Callable[[], Regularisation]] = {
    "tikhonov": methods.Tikhonov,
    "implicit_iteration": methods.ImplicitIteration,
}
#: Choices of their parameter by name; "given" beside them.
CHOICES: Mapping[str, Callable[[], ParameterChoice]] = {
    "gcv": methods.GeneralizedCrossValidation,
    "discrepancy": methods.DiscrepancyPrinciple,
    "l_curve": methods.LCurve,
}
GIVEN = "given"
#: What a solution may be pulled towards.
TARGETS: Mapping[str, Method | None] = {"zero": None, "least_squares": methods.least_squares()}


@dataclass(frozen=True, slots=True)
class RegularisationChoice:
    """How the solution of a method is pulled.

    Parameters
    ----------
    scheme : str
        One of `SCHEMES`.
    choice : str
        Of its parameter: one of `CHOICES`, or "given".
    parameter : float, optional
        The one that is given.
    towards : str
        One of `TARGETS`.

    Raises
    ------
    UsageError
        When a name is unknown, or a parameter stands beside another choice than "given".
    """

    scheme: str = "tikhonov"
    choice: str = "gcv"
    parameter: float | None = None
    towards: str = "zero"

    def __post_init__(self) -> None:
        check_among("a regularisation", self.scheme, SCHEMES)
        check_among("a choice of the parameter", self.choice, (*CHOICES, GIVEN))
        check_among("a vector to be pulled towards", self.towards, TARGETS)
        if (self.parameter is None) != (self.choice != GIVEN):
            raise UsageError(
                'a parameter for choice = "given", and for no other',
                f"{self.parameter} for '{self.choice}'",
                "Leave one of them out.",
            )
        if self.parameter is not None:
            SCHEMES[self.scheme]().check(self.parameter)

    def of(self, method: LinearMethod) -> Method:
        """The method with its solution pulled."""
        given = self.parameter
        choice = CHOICES[self.choice]() if given is None else methods.GivenParameter(given)
        return methods.regularised(method, SCHEMES[self.scheme](), choice, TARGETS[self.towards])
