"""Generated parts of docs/paper.md: the tables of every reading, and the errata with their checks.

    python -m validation.paper.page --page docs/paper.md [--runs N] [--workers N]

runs what `eivor paper` runs, under a minute.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib.metadata import version
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from eivor.estimation import methods
from eivor.estimation.linear import LinearMethod
from eivor.estimation.moments import CrossMoments, Moments, TriangularMoments
from eivor.lab.disturbances import RandomCoefficientMovingAverage
from eivor.lab.experiments import stream
from eivor.lab.figures import (
    SCORE_WORDS,
    by_reading,
    factor_text,
    nearest,
    nearness_cells,
    printed_text,
    spread_text,
    verdict_sentence,
)
from eivor.lab.paper import (
    DISTURBANCE,
    EXAMPLES,
    METHODS,
    PRINTED_METHODS,
    READINGS,
    SEED,
    TRUTH,
    Example,
    PaperResult,
    named_readings,
    nearness,
    nrmse,
    record,
    run_paper,
)
from eivor.lab.records import SimulatedRecord
from eivor.linalg.system import LinearSystem
from eivor.models.regression import lags
from eivor.models.signal_regression import SignalRegression
from eivor.motions.vertical.model import VerticalMotion
from eivor.signals.noise import fractional_weights
from eivor.signals.recording import GRAVITY
from eivor.signals.signals import Signals
from eivor.tools import Float
from validation.pages import markdown
from validation.studies import WORKERS, Option, StudyCommand

# -- Tables --


def page_parts(results: Sequence[PaperResult]) -> dict[str, str]:
    """Generated parts of the page, by the name of their marks."""
    first = by_reading(results)[nearest(results)]
    groups = list(by_reading(results).values())
    parts = {
        "run": f"Made by `python -m validation.paper.page` with Eivor {version('eivor')}: {len(groups)} "
        f"readings, 2 examples, {len(first[0].estimates)} runs, 6 methods; seed {SEED}. "
        f"{verdict_sentence(results)}",
        "readings": _readings_table(results),
    }
    for index, example in enumerate(EXAMPLES):
        tables = (
            f"**{column}**, NRMSE in percent\n\n"
            + _example_table([group[index] for group in groups], example, method)
            for column, method in PRINTED_METHODS.items()
        )
        parts[f"example {example.number}"] = "\n\n".join(tables)
    parts["errata"] = markdown(("where", "printed", "used here", "checked"), errata())
    parts["figures"] = _figures(first[0].reading.name)
    return parts


def _readings_table(results: Sequence[PaperResult]) -> str:
    lines = []
    for name, group in by_reading(results).items():
        tls = factor_text(nearness(group, total_least_squares=True).means)
        lines.append([f"`{name}`", group[0].reading.sentence, *nearness_cells(nearness(group)), tls])
    header = ("reading", "what it says", "means off by", "SDs off by", "means met", "TLS forms off by")
    return markdown(header, lines)


def _example_table(results: Sequence[PaperResult], example: Example, method: str) -> str:
    partner = METHODS[METHODS.index(method) + 1]
    header = ("reading", *SCORE_WORDS, *(f"{words}, TLS" for words in SCORE_WORDS))
    lines = [["**printed**", *map(printed_text, example.printed[method]), "", "", ""]]
    for result in results:
        both = (*result.spreads(method), *result.spreads(partner))
        lines.append([f"`{result.reading.name}`", *map(spread_text, both)])
    counts = {result.reading.name: result.weak_runs(method) for result in results}
    weak = [f"`{name}` ({count} of {len(results[0].weak)})" for name, count in counts.items() if count]
    words = f"\n\nWeak instruments (first-stage F below 10), in runs: {', '.join(weak)}." if weak else ""
    return markdown(header, lines) + words


def _figures(name: str) -> str:
    texts = [f"Under the reading `{name}`; red is what the paper prints, mean and one SD on both sides."]
    captions = ["Input and height"]
    captions += [f"NRMSE of {column}, example {item}" for item in (1, 2) for column in PRINTED_METHODS]
    for index, caption in enumerate(captions, start=2):
        texts.append(f"![{caption}](images/paper/figure-{index}.svg)")
        texts.append(f"*Counterpart of figure {index}. {caption}.*")
    return "\n\n".join(texts)


# -- Errata --

RUNS = 20
STRONG = Example(0, 0.1, {})


class Erratum(NamedTuple):
    """A place of the text."""

    where: str
    printed: str
    used: str
    check: str


def errata(runs: int = RUNS) -> tuple[Erratum, ...]:
    """Every place with its check, computed anew."""
    reading = replace(named_readings(("ratios-of-variances",))[0], ratio="variance")
    records = [record(reading, STRONG, stream(SEED, index)) for index in range(runs)]
    return (
        Erratum(
            "(1) rows 1 to 3",
            "Euler angles, and their derivatives in place of the body rates",
            "body rates p, q, r and the attitude's kinematics, in the simulator of whole vehicles",
            euler_rates(),
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
            gravity(records),
        ),
        Erratum(
            "(9)", "Z'' stacked with - g, and g subtracted again", "the response z'' + g once", "As above."
        ),
        Erratum(
            "(12)",
            "eps = xi'' + (phi~ - phi) theta",
            "eps = xi'' - (phi~ - phi) theta",
            error_of_the_variables(records[0]),
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
            signal_variances(records),
        ),
        Erratum(
            "W of (13), (29)", "sigma_zeta", "sigma of xi_u, the noise of u in (11)", which_noise(records)
        ),
        Erratum(
            "(14), after (16), (17), (34)", "y for the height", "z, as everywhere else", "No y is introduced."
        ),
        Erratum(
            "a_j, b_j",
            "binom(alpha_m, j) = (-1)^j and a quotient of Gamma functions",
            "(-1)^j binom(alpha, j): the right side, with the alpha of Delta^alpha",
            weights(),
        ),
        Erratum(
            "Delta^alpha",
            "upper limit i",
            "k, the noise zero before the record",
            "The sum of (20) runs over the record so far.",
        ),
        Erratum(
            "before (21)",
            "E(psi phi^T), with the row phi of (6)",
            "E(psi phi)",
            "The product must be p x n; two columns have none.",
        ),
        Erratum("(24)", "the LS solution of system (20)", "of system (23)", which_system(records[0])),
        Erratum("(25)", "K_EIV-LS and K_EIV", "one number", first_unknown_of_least_squares(records[0])),
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
        Erratum("(27), (33)", "first unknown eps", "eps / sigma, as in (16)", first_unknown(records[0])),
        Erratum(
            "(29)",
            "sigma^2 H, with the 1 of H in row 2",
            "N sigma^2 H, with the 1 in the row of lag 0, the first of (28)",
            compensations(records),
        ),
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
            roles_of_e(),
        ),
        Erratum("table 2, GIV", "5.74 ± 2.70", "taken as printed; 3.74 would fit its neighbours", table_2()),
    )


# -- Errata checks --

#: Mean over standard deviation of the absolute value of a normal variable without bias.
HALF_NORMAL = float(np.sqrt(2.0 / np.pi) / np.sqrt(1.0 - 2.0 / np.pi))
#: Moments of inertia of the check of (1), about x, y and z; any that differ will do.
INERTIA = np.array([1.4, 1.4, 2.2])
#: Step of the second difference of an angle [s].
ANGLE_STEP_S = 1e-3


def _mean_error(
    records: Sequence[SimulatedRecord],
    method: LinearMethod,
    change: Callable[[Moments], Moments],
    first_lag: int = -1,
) -> str:
    results = []
    for item in records:
        columns = lags("input", first_lag, 10) if first_lag >= 0 else ()
        problem = VerticalMotion(intercept=False).regression(item.signals, columns)
        results.append(method.solve_moments(change(method.assembler.moments(problem))).solution.theta)
    return f"{nrmse(np.array(results))[:, -1].mean():.3g} %"


def _unchanged(moments: Moments) -> Moments:
    return moments


def _right_and_wrong(
    records: Sequence[SimulatedRecord],
    method: LinearMethod,
    change: Callable[[Moments], Moments],
    first_lag: int = -1,
) -> tuple[str, str]:
    right, wrong = (_mean_error(records, method, how, first_lag) for how in (_unchanged, change))
    return right, wrong


def gravity(records: Sequence[SimulatedRecord]) -> str:
    """Take g from the response instead of adding it."""
    shifted = []
    for item in records:
        channels = dict(item.signals.channels)
        channels["acceleration_z"] = channels["acceleration_z"] - 2.0 * GRAVITY
        signals = Signals(item.signals.rate_hz, channels, noise=item.signals.noise)
        shifted.append(replace(item, signals=signals))
    right, wrong = (_mean_error(each, methods.least_squares(), _unchanged) for each in (records, shifted))
    return f"LS errs by {right} with z'' + g, by {wrong} with z'' - g."


def signal_variances(records: Sequence[SimulatedRecord]) -> str:
    """Weight total least squares by the power of the signals."""

    def with_signals(moments: Moments) -> Moments:
        assert isinstance(moments, TriangularMoments)
        power = np.einsum("ij,ij->j", moments.root, moments.root) / moments.rows
        return replace(moments, noise=np.diag(power))

    right, wrong = _right_and_wrong(records, methods.total_least_squares(), with_signals)
    return f"TLS errs by {right} with the noises' variances, by {wrong} with the signals'."


def first_unknown(simulated_record: SimulatedRecord) -> str:
    """Solve (27) in full, with p + 2 unknowns."""
    A, b = _extended_equations(simulated_record)
    sigma = float(np.linalg.svd(np.column_stack([A, b]), compute_uv=False)[-1])
    block, residual = _solved_in_full(A, b, sigma, sigma)
    return (
        f"Solved in full, the first block times sigma is the residual to "
        f"{_off(sigma * block, residual):.0e}; the block itself is off by a factor of "
        f"{np.linalg.norm(block) / np.linalg.norm(residual):.2g}."
    )


def _off(first: Float[np.ndarray, " n"], other: Float[np.ndarray, " n"]) -> float:
    return float(np.linalg.norm(first - other) / np.linalg.norm(other))


def _with_noise(
    change: Callable[[Float[np.ndarray, "p n"], float], Float[np.ndarray, "p n"]],
) -> Callable[[Moments], Moments]:
    """Change of compensated instrumental moments by one of their shared noise, which their rows are given."""

    def changed(before: Moments) -> Moments:
        assert isinstance(before, CrossMoments)
        assert before.noise is not None
        return replace(before, noise=change(before.noise, before.rows))

    return changed


def compensations(records: Sequence[SimulatedRecord]) -> str:
    """Compensate (29) as printed, part by part."""

    def changed(change: Callable[[Float[np.ndarray, "p n"], float], Float[np.ndarray, "p n"]]) -> str:
        return _mean_error(records, methods.generalized_iv(), _with_noise(change), 0)

    return (
        f"GIV errs by {changed(lambda noise, _: noise)}; with the 1 in row 2 by "
        f"{changed(lambda noise, _: np.roll(noise, 1, axis=0))}, without N by "
        f"{changed(lambda noise, count: noise / count)}, without any compensation by "
        f"{changed(lambda noise, _: 0.0 * noise)}."
    )


def weights() -> str:
    """Correlation of neighbours in noises of either weights."""
    signed = fractional_weights(-0.5, 4000)
    printed = signed * (-1.0) ** np.arange(4000)

    def correlation(weights: Float[np.ndarray, " n"]) -> float:
        return float(weights[:-1] @ weights[1:] / (weights @ weights))

    return (
        f"At order -0.5 neighbours correlate by {correlation(signed):+.2f} with the sign, the long memory "
        f"that accelerometers have, and by {correlation(printed):+.2f} without it: an alternating noise."
    )


def table_2() -> str:
    """Shape of the printed errors."""
    friction, gain, _ = EXAMPLES[1].printed[PRINTED_METHODS["GIV"]]
    return (
        f"Mean over SD is {friction.mean / friction.std:.2f}; it is {gain.mean / gain.std:.2f} in the next "
        f"row, and {HALF_NORMAL:.2f} for errors without bias. 3.74 would give {3.74 / friction.std:.2f}."
    )


def euler_rates() -> str:
    """Turn a free body at zero tilt, and take its Euler angles' second derivative."""

    def accelerations(rates: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " 3"]:
        """Second derivatives of roll, pitch and yaw at zero angles, of a body that turns with these rates."""
        before, here, after = (_euler_angles(rates, time) for time in (-ANGLE_STEP_S, 0.0, ANGLE_STEP_S))
        return (before - 2.0 * here + after) / ANGLE_STEP_S**2

    x, y, z = INERTIA
    printed = ((y - z) / x, (z - x) / y, (x - y) / z)
    pairs = np.array([[0.0, 1.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 0.0]])
    results = [accelerations(pair)[axis] for axis, pair in enumerate(pairs)]
    words = ("phi'' to theta' psi'", "theta'' to psi' phi'", "psi'' to theta' phi'")
    text = ", ".join(
        f"{what} {is_:+.2f} (printed {was:+.2f})"
        for what, is_, was in zip(words, results, printed, strict=True)
    )
    return f"At zero tilt, inertia {x:g}, {y:g}, {z:g}, no torque: {text}."


def _euler_angles(rates: Float[np.ndarray, " 3"], time: float) -> Float[np.ndarray, " 3"]:
    """Roll, pitch and yaw of a free body, a time after it was level with these body rates."""
    if time == 0.0:
        return np.zeros(3)

    def slope(_: float, state: Float[np.ndarray, " 12"]) -> Float[np.ndarray, " 12"]:
        spin, turned = state[:3], state[3:].reshape(3, 3)
        cross = np.array([[0.0, -spin[2], spin[1]], [spin[2], 0.0, -spin[0]], [-spin[1], spin[0], 0.0]])
        return np.concatenate([-cross @ (INERTIA * spin) / INERTIA, (turned @ cross).ravel()])

    start = np.concatenate([rates, np.eye(3).ravel()])
    end = solve_ivp(slope, (0.0, time), start, rtol=1e-12, atol=1e-14).y[3:, -1].reshape(3, 3)
    yaw, pitch, roll = Rotation.from_matrix(end).as_euler("ZYX")
    return np.array([roll, pitch, yaw])


def error_of_the_variables(simulated_record: SimulatedRecord) -> str:
    """Compare (12) with its error, which the record's noises make."""
    measured, true = simulated_record.signals.channels, simulated_record.truth.channels
    theta = np.array(list(TRUTH.values()))
    noisy, clean = (np.column_stack([-each["velocity_z"], each["input"]]) for each in (measured, true))
    error = measured["acceleration_z"] - true[DISTURBANCE] - noisy @ theta
    response_noise = measured["acceleration_z"] - true["acceleration_z"]
    minus, plus = (response_noise + sign * (noisy - clean) @ theta for sign in (-1.0, 1.0))
    return (
        f"With the minus sign it is the residual of a record to {_off(minus, error):.0e}; as printed it is "
        f"off by {100 * _off(plus, error):.0f} %."
    )


def which_system(simulated_record: SimulatedRecord) -> str:
    """Solve (20) and (23) by least squares, and compare with the formula (24)."""
    A, b = _extended_equations(simulated_record)
    formula = np.linalg.solve(A.T @ A, A.T @ b)
    of_moments = np.linalg.lstsq(A, b, rcond=None)[0]
    rows = VerticalMotion(intercept=False).regression(simulated_record.signals).rows()
    of_rows = np.linalg.lstsq(rows.regressors, rows.response, rcond=None)[0]
    return (
        f"(24) is the LS solution of (23) to {_off(of_moments, formula):.0e}; that of (20) differs by "
        f"{100 * _off(of_rows, formula):.0f} %."
    )


def first_unknown_of_least_squares(simulated_record: SimulatedRecord) -> str:
    """Solve (25) in full, with p + 2 unknowns and one number K."""
    A, b = _extended_equations(simulated_record)
    scale = float(np.linalg.svd(A, compute_uv=False)[-1]) / np.sqrt(2.0)
    block, residual = _solved_in_full(A, b, scale, 0.0)
    off = _off(scale * block, residual)
    return f"With one number for both, the first block times it is the residual to {off:.0e}."


def _solved_in_full(
    A: Float[np.ndarray, "p n"], b: Float[np.ndarray, " p"], upper: float, lower: float
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    """First block of the unknowns of an augmented system, and the residual of the others."""
    rows, unknowns = A.shape
    full = np.block([[upper * np.eye(rows), A], [A.T, lower * np.eye(unknowns)]])
    solution = np.linalg.solve(full, np.concatenate([b, np.zeros(unknowns)]))
    return solution[:rows], b - A @ solution[rows:]


def _extended_equations(
    simulated_record: SimulatedRecord,
) -> tuple[Float[np.ndarray, "p n"], Float[np.ndarray, " p"]]:
    """A and b of (23), with ten lags."""
    problem: SignalRegression = VerticalMotion(intercept=False).regression(
        simulated_record.signals, lags("input", 1, 10)
    )
    method = methods.extended_iv_tls()
    system: LinearSystem = method.assembler.system(method.assembler.moments(problem))
    return system.matrix, system.right


def which_noise(records: Sequence[SimulatedRecord]) -> str:
    """Compensate (29) with the variance of zeta, which is the error of the equation in (7) and (20)."""
    input_noise = float(np.mean([item.signals.noise["input"].std ** 2 for item in records]))
    equation = float(np.mean([item.truth.channels[DISTURBANCE].var() for item in records]))

    def scaled(noise: Float[np.ndarray, "p n"], _: float) -> Float[np.ndarray, "p n"]:
        return noise * equation / input_noise

    right, wrong = _right_and_wrong(records, methods.generalized_iv(), _with_noise(scaled), 0)
    return f"GIV errs by {right} with the variance of u's noise, by {wrong} with that of zeta."


def roles_of_e() -> str:
    """Spread of the coloured error over that of the white sequence in it."""
    series = RandomCoefficientMovingAverage((0.0, 3.0), (1.0, 1.0), 1.0).sample(
        200_000, 0.2, np.random.default_rng(0)
    )
    return (
        f"The moving average has {series.std():.2f} times the SD of the white sequence in it: a ratio "
        f"sigma_e / sigma_y means one or the other."
    )


OPTIONS: dict[str, Option] = {
    "--runs": {"type": int, "default": 100, "help": "of each example"},
    "--workers": WORKERS,
}
main = StudyCommand(
    "validation.paper.page",
    __doc__,
    "run",
    lambda chosen: (page_parts(list(run_paper(READINGS, runs=chosen.runs, workers=chosen.workers))), ()),
    OPTIONS,
).main

if __name__ == "__main__":
    sys.exit(main())
