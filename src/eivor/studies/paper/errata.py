"""Where the paper's equations, as extracted, cannot be meant as printed, each with a numerical check.

The checks run on records of the paper's motion whose noises are strong enough to tell: ratios of variances
of 0.1 instead of 2e-3, otherwise the reading ratios-of-variances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from eivor.simulation.records.scenario import SimulatedRecord
from eivor.studies.paper import errata_checks as checked
from eivor.studies.paper.examples import trial_generator
from eivor.studies.paper.readings import Example, Ratio, named_readings
from eivor.studies.paper.trials import record

RUNS = 20
STRONG = Example(0, 0.1, {})


@dataclass(frozen=True, slots=True)
class Erratum:
    """One place.

    Parameters
    ----------
    where, printed, used : str
        Equation, what it says as printed, what is used here.
    check : str
        What was computed.
    """

    where: str
    printed: str
    used: str
    check: str


def errata(runs: int = RUNS) -> tuple[Erratum, ...]:
    """Every place with its check, computed anew.

    Parameters
    ----------
    runs : int
        Records behind each mean.
    """
    reading = replace(named_readings(("ratios-of-variances",))[0], ratio=Ratio.VARIANCE)
    records = [record(reading, STRONG, trial_generator(index)) for index in range(runs)]
    return (*_of_the_motion(records), *_of_errors(records), *_of_instruments(records), *_of_the_simulation())


def _of_the_motion(records: Sequence[SimulatedRecord]) -> tuple[Erratum, ...]:
    return (
        Erratum(
            "(1) rows 1 to 3",
            "Euler angles, and their derivatives in place of the body rates",
            "body rates p, q, r and the attitude's kinematics, in the simulator of whole vehicles",
            checked.euler_rates(),
        ),
        Erratum(
            "(1) last row, (4)",
            "f(t) - g; ... - m g",
            "f(t) - m g; ... - g",
            "Units: forces, and accelerations.",
        ),
        Erratum(
            "(6)-(10), (12), (15)-(17), (20), (23)-(27), (29)-(34)",
            "z'' - g",
            "z'' + g, which (5), (13) and (14) have",
            checked.gravity(records),
        ),
        Erratum(
            "(9)", "Z'' stacked with - g, and g subtracted again", "the response z'' + g once", "As above."
        ),
    )


def _of_errors(records: Sequence[SimulatedRecord]) -> tuple[Erratum, ...]:
    return (
        Erratum(
            "(12)",
            "eps = xi'' + (phi~ - phi) theta",
            "eps = xi'' - (phi~ - phi) theta",
            checked.error_of_the_variables(records[0]),
        ),
        Erratum(
            "after A4",
            "fractional differential equation coefficients",
            "the coefficients of (5)",
            "(5) is of first order in z'; what is fractional is the noise, from section 5 on.",
        ),
        Erratum(
            "(13)",
            "sigma of a signal about its mean",
            "variances of the noises, which (14), (15) need",
            checked.signal_variances(records),
        ),
        Erratum(
            "W of (13), (29)",
            "sigma_zeta",
            "sigma of xi_u, the noise of u in (11)",
            checked.which_noise(records),
        ),
        Erratum(
            "(14), after (16), (17), (34)",
            "y for the height",
            "z, as everywhere else",
            "No y is introduced.",
        ),
        Erratum(
            "a_j, b_j",
            "binom(alpha_m, j) = (-1)^j and a quotient of Gamma functions",
            "(-1)^j binom(alpha, j): the right side, with the alpha of Delta^alpha",
            checked.weights(),
        ),
        Erratum(
            "Delta^alpha",
            "upper limit i",
            "k, the noise zero before the record",
            "The sum of (20) runs over the record so far.",
        ),
    )


def _of_instruments(records: Sequence[SimulatedRecord]) -> tuple[Erratum, ...]:
    return (
        Erratum(
            "before (21)",
            "E(psi phi^T), with the row phi of (6)",
            "E(psi phi)",
            "The product must be p x n; two columns have none.",
        ),
        Erratum("(24)", "the LS solution of system (20)", "of system (23)", checked.which_system(records[0])),
        Erratum(
            "(25)",
            "K_EIV-LS and K_EIV",
            "one number",
            checked.first_unknown_of_least_squares(records[0]),
        ),
        Erratum(
            "(25), (27)",
            "Psi Phi^T below the diagonal",
            "(Psi^T Phi)^T",
            "The block must be n x p, not N x N.",
        ),
        Erratum(
            "(25), (27), (31), (33)",
            "E_n",
            "the identity of size p",
            "The block multiplies p residuals, not n.",
        ),
        Erratum(
            "(27), (33)", "first unknown eps", "eps / sigma, as in (16)", checked.first_unknown(records[0])
        ),
        Erratum(
            "(29)",
            "sigma^2 H, with the 1 of H in row 2",
            "N sigma^2 H, with the 1 in the row of lag 0, the first of (28)",
            checked.compensations(records),
        ),
    )


def _of_the_simulation() -> tuple[Erratum, ...]:
    return (
        Erratum(
            "(34)",
            "no name before (t_k, q^-1)",
            "C, as in (19)",
            "The quotient has a polynomial on both sides.",
        ),
        Erratum(
            "(34)",
            "zeta the series and e the white sequence in it; in (17)-(19) e is the series",
            "the ratio of e is that of the series",
            checked.roles_of_e(),
        ),
        Erratum(
            "table 2, GIV",
            "5.74 ± 2.70",
            "taken as printed; 3.74 would fit its neighbours",
            checked.table_2(),
        ),
    )
