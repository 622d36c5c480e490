"""Where the paper's equations, as extracted, cannot be meant as printed, each with a numerical check.

The checks run on records of the paper's motion whose noises are strong enough to tell: ratios of variances
of 0.1 instead of 2e-3, otherwise the reading ratios-of-variances.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from eivor.estimation import methods
from eivor.estimation.method import Method
from eivor.estimation.moments import CrossMoments, Moments, TriangularMoments
from eivor.estimation.solve import solve_moments
from eivor.linalg.system import LinearSystem
from eivor.models.column import lags
from eivor.models.scenario import SimulatedRecord
from eivor.models.vertical import GRAVITY, VerticalMotion
from eivor.signals.fractional import fractional_weights
from eivor.signals.signals import Signals
from eivor.studies.paper import trial_generator
from eivor.studies.paper_readings import EXAMPLES, PRINTED_METHODS, Example, Ratio, named_readings
from eivor.studies.paper_trials import nrmse, record

RUNS = 20
STRONG = Example(0, 0.1, {})
#: Mean over standard deviation of the absolute value of a normal variable without bias.
HALF_NORMAL = float(np.sqrt(2.0 / np.pi) / np.sqrt(1.0 - 2.0 / np.pi))


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
    return (
        Erratum(
            "(1) last row, (4)",
            "f(t) - g; ... - m g",
            "f(t) - m g; ... - g",
            "Units: forces, and accelerations.",
        ),
        Erratum("(6)-(9), (12)-(16), (23)-(34)", "z'' - g", "z'' + g, which (5) has", _gravity(records)),
        Erratum(
            "(9)", "Z'' stacked with - g, and g subtracted again", "the response z'' + g once", "As above."
        ),
        Erratum(
            "(13)",
            "sigma of a signal about its mean",
            "variances of the noises, which (14), (15) need",
            _signal_variances(records),
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
        Erratum("(27), (33)", "first unknown eps", "eps / sigma, as in (16)", _first_unknown(records[0])),
        Erratum(
            "(29)",
            "sigma^2 H, with the 1 of H in row 2",
            "N sigma^2 H, with the 1 in the row of lag 0, the first of (28)",
            _compensations(records),
        ),
        Erratum(
            "a_j, b_j",
            "binom(alpha, j) = (-1)^j and a quotient of Gamma functions",
            "the right side; the left one lacks (-1)^j",
            _weights(),
        ),
        Erratum(
            "Delta^alpha",
            "upper limit i",
            "k, the noise zero before the record",
            "The sum of (20) runs over the record so far.",
        ),
        Erratum(
            "(34)",
            "no name before (t_k, q^-1)",
            "C, as in (19)",
            "The quotient has a polynomial on both sides.",
        ),
        Erratum("table 2, GIV", "5.74 ± 2.70", "taken as printed; 3.74 would fit its neighbours", _table_2()),
    )


def _mean_error(
    records: Sequence[SimulatedRecord],
    method: Method,
    change: Callable[[Moments], Moments],
    first_lag: int = -1,
) -> str:
    """Mean NRMSE of both parameters by a method from changed moments, in words."""
    found = []
    for one in records:
        columns = lags("input", first_lag, 10) if first_lag >= 0 else ()
        problem = VerticalMotion(intercept=False).regression(one.signals, columns)
        found.append(solve_moments(method, change(method.assembler.moments(problem)), None).solution.theta)
    return f"{nrmse(np.array(found))[:, -1].mean():.3g} %"


def _unchanged(moments: Moments) -> Moments:
    return moments


def _gravity(records: Sequence[SimulatedRecord]) -> str:
    def shifted(one: SimulatedRecord) -> SimulatedRecord:
        channels = dict(one.signals.channels)
        channels["specific_force_z"] = channels["specific_force_z"] - 2.0 * GRAVITY
        return replace(one, signals=Signals(one.signals.rate_hz, channels, noise=one.signals.noise))

    right = _mean_error(records, methods.least_squares(), _unchanged)
    wrong = _mean_error([shifted(one) for one in records], methods.least_squares(), _unchanged)
    return f"LS errs by {right} with z'' + g, by {wrong} with z'' - g."


def _signal_variances(records: Sequence[SimulatedRecord]) -> str:
    def with_signals(moments: Moments) -> Moments:
        assert isinstance(moments, TriangularMoments)  # noqa: S101 - those of a direct method
        power = np.einsum("ij,ij->j", moments.root, moments.root) / moments.count
        return replace(moments, noise=np.diag(power))

    method = methods.total_least_squares()
    right, wrong = (_mean_error(records, method, change) for change in (_unchanged, with_signals))
    return f"TLS errs by {right} with the noises' variances, by {wrong} with the signals'."


def _first_unknown(one: SimulatedRecord) -> str:
    """Solve (27) in full, with p + 2 unknowns."""
    problem = VerticalMotion(intercept=False).regression(one.signals, lags("input", 1, 10))
    method = methods.extended_iv_tls()
    system: LinearSystem = method.assembler.system(method.assembler.moments(problem))
    A, b = system.matrix, system.right
    rows, unknowns = A.shape
    sigma = float(np.linalg.svd(np.column_stack([A, b]), compute_uv=False)[-1])
    full = np.block([[sigma * np.eye(rows), A], [A.T, sigma * np.eye(unknowns)]])
    solution = np.linalg.solve(full, np.concatenate([b, np.zeros(unknowns)]))
    residual = b - A @ solution[rows:]
    return (
        f"Solved in full, the first block times sigma is the residual to "
        f"{_off(sigma * solution[:rows], residual):.0e}; the block itself is off by a factor of "
        f"{np.linalg.norm(solution[:rows]) / np.linalg.norm(residual):.2g}."
    )


def _off(one: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"]) -> float:
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


def _compensations(records: Sequence[SimulatedRecord]) -> str:
    def changed(change: Callable[[Float[np.ndarray, "p n"], int], Float[np.ndarray, "p n"]]) -> str:
        def moments(before: Moments) -> Moments:
            assert isinstance(before, CrossMoments)  # noqa: S101 - those of an instrumental method
            assert before.noise is not None  # noqa: S101 - of a compensated one
            return replace(before, noise=change(before.noise, before.count))

        return _mean_error(records, methods.generalized_iv(), moments, 0)

    return (
        f"GIV errs by {changed(lambda noise, _: noise)}; with the 1 in row 2 by "
        f"{changed(lambda noise, _: np.roll(noise, 1, axis=0))}, without N by "
        f"{changed(lambda noise, count: noise / count)}, without any compensation by "
        f"{changed(lambda noise, _: 0.0 * noise)}."
    )


def _weights() -> str:
    signed = fractional_weights(-0.5, 4000)
    printed = signed * (-1.0) ** np.arange(4000)

    def correlation(weights: Float[np.ndarray, " n"]) -> float:
        return float(weights[:-1] @ weights[1:] / (weights @ weights))

    return (
        f"At order -0.5 neighbours correlate by {correlation(signed):+.2f} with the sign, the long memory "
        f"that accelerometers have, and by {correlation(printed):+.2f} without it: an alternating noise."
    )


def _table_2() -> str:
    friction, gain, _ = EXAMPLES[1].printed[PRINTED_METHODS["GIV"]]
    return (
        f"Mean over SD is {friction.mean / friction.std:.2f}; it is {gain.mean / gain.std:.2f} in the next "
        f"row, and {HALF_NORMAL:.2f} for errors without bias. 3.74 would give {3.74 / friction.std:.2f}."
    )
