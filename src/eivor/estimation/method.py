"""Methods: an assembler times a weighting times a solver."""

from __future__ import annotations

from dataclasses import dataclass

from eivor.estimation.assembler import Assembler
from eivor.estimation.weighting import Weighting
from eivor.linalg.system import Solver


@dataclass(frozen=True, slots=True)
class Method:
    """One way to estimate.

    Parameters
    ----------
    name : str
        The word that the command line uses.
    assembler : Assembler
        Which equations.
    weighting : Weighting
        How rows or equations are weighted.
    solver : Solver
        How the equations are solved.
    """

    name: str
    assembler: Assembler
    weighting: Weighting
    solver: Solver
