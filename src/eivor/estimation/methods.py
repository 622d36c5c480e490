"""Estimation methods by name: each is an assembler, weightings and a solver."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import inf

from numpy.typing import ArrayLike

from eivor import checks
from eivor.errors import UsageError
from eivor.estimation.diagnose import contradiction, periodic
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import OUTPUT_ERROR, LinearMethod, Method, OutputError, Problem, check_method
from eivor.estimation.moments import Assembler, Compensated, Direct, Instrumental, ProblemMoments
from eivor.estimation.spectral_iv import SpectralGeneralizedIV, WhittleLikelihood
from eivor.estimation.unknown_noise import EquationChoice, NoiseEstimatingIV
from eivor.estimation.weighting import (
    EquationWeighting,
    LimitedInformation,
    SpectralWhitening,
    TwoStage,
    TwoStepRobust,
    Unweighted,
)
from eivor.linalg.system import Solver
from eivor.linalg.total_least_squares import (
    AugmentedLeastSquares,
    AugmentedTotalLeastSquares,
    Fuller,
    LeastSquares,
)
from eivor.models.regression import LinearProblem, regression
from eivor.models.separable import SeparableProblem


def identify(problem: Problem, method: Method) -> Estimate:
    """Estimate the parameters of `problem` by `method`.

    Parameters
    ----------
    problem : Regression, SignalRegression, SeparableProblem or ProblemMoments
        Rows, or signals that rows are cut from. Or one set of rows for each value of nuisance parameters,
        such as lag and delay of an actuator. Or moments, whose estimate has no residuals and no intervals.
    method : Method
        One of `eivor.methods`, or your own.

    Returns
    -------
    Estimate
        With the continuous nuisances that were searched for, such as the lag, among its parameters. A method
        without instruments is tested by those that a linear problem holds: weak where they contradict it.

    Raises
    ------
    UsageError
        When an argument is of another type, or the method cannot use the problem.
    InstrumentError
        When the method needs instruments that the problem does not have, or they share noise with it.
    MissingNoiseError
        When a compensated method needs a noise that is not declared.
    TooFewSamplesError
        When there are no more rows than unknowns.
    EstimationError
        When the equations have no unique solution.
    """
    if not isinstance(problem, LinearProblem | SeparableProblem | ProblemMoments):
        raise UsageError(
            "a problem: regression(...), a model's regression, or moments(...)",
            f"{type(problem).__name__}",
            "For a flight log use identify_flight.",
        )
    check_method(method, Method)
    estimate = method.estimate(problem)
    if not isinstance(problem, LinearProblem):
        return estimate
    direct = problem.instrument_count and not method.needs_instruments
    against = contradiction(problem, estimate) if direct else ()
    return replace(estimate, met=(*estimate.met, *against), doubts=periodic)


def iv(
    y: ArrayLike, X: ArrayLike, Z: ArrayLike | None = None, *, names: Sequence[str] | None = None
) -> Estimate:
    """Two-stage least squares of arrays or tables; least squares without instruments.

    Parameters
    ----------
    y : array_like, shape (rows,)
        Response, rows in time order.
    X : array_like, shape (rows, n) or (rows,)
        Regressors. Add a column of ones for an intercept.
    Z : array_like, shape (rows, p) or (rows,), optional
        Instruments: exogenous columns, those of the regressors that are exogenous among them.
    names : sequence of str, optional
        Names of the parameters; see `regression`.

    Returns
    -------
    Estimate
        Its intervals hold for autocorrelated errors; `Estimate.with_covariance` gives others.

    Raises
    ------
    DataError, ShapeError, NonFiniteError, TooFewSamplesError, InstrumentError, EstimationError
        See `regression` and `identify`.
    """
    problem = regression(y, X, Z, names=names)
    return identify(problem, least_squares() if Z is None else extended_iv(TwoStage()))


__all__ = [
    "TABLE",
    "TwoStage",
    "TwoStepRobust",
    "Unweighted",
    "bias_compensated_least_squares",
    "bias_eliminating_least_squares",
    "by_name",
    "extended_iv",
    "extended_iv_tls",
    "frisch_scheme",
    "fuller",
    "generalized_fuller",
    "generalized_iv",
    "generalized_iv_tls",
    "generalized_iv_unknown_noise",
    "generalized_liml",
    "least_squares",
    "liml",
    "output_error",
    "reference_iv",
    "spectral_giv",
    "spectral_giv_combined",
    "total_least_squares",
    "whitened_least_squares",
    "whittle_ml",
]


def reference_iv() -> LinearMethod:
    """Whitened reference-instrument IV, the default for flights."""
    return LinearMethod("reference_iv", Instrumental(), LeastSquares(), SpectralWhitening())


def least_squares() -> LinearMethod:
    """Least squares, the paper's (9), (10); with a lag to find, nonlinear least squares."""
    return LinearMethod("least_squares", Direct(), AugmentedLeastSquares())


def whitened_least_squares() -> LinearMethod:
    """Least squares of whitened rows in frequency, each axis of each run with the weight of its own noise."""
    return LinearMethod("whitened_least_squares", Direct(), LeastSquares(), SpectralWhitening())


def total_least_squares() -> LinearMethod:
    """Total least squares with the columns' declared noise covariance, the paper's (13)-(16)."""
    return LinearMethod("total_least_squares", Direct(), AugmentedTotalLeastSquares())


def bias_compensated_least_squares() -> LinearMethod:
    """Least squares without what the declared noises add to the regressors' moments."""
    return LinearMethod("bias_compensated_least_squares", Compensated(False), AugmentedLeastSquares())


def extended_iv(weighting: EquationWeighting | None = None) -> LinearMethod:
    """Extended instrumental variables, the paper's (21)-(25).

    Parameters
    ----------
    weighting : EquationWeighting, optional
        `Unweighted` (the paper's, default), `TwoStage` or `TwoStepRobust`.
    """
    parts, weights = (Instrumental(), AugmentedLeastSquares()), _weighting(weighting)
    return LinearMethod("extended_iv", *parts, equation_weighting=weights, natural_instruments="lags")


def extended_iv_tls() -> LinearMethod:
    """Extended instrumental variables solved by total least squares, the paper's (26), (27)."""
    return LinearMethod("extended_iv_tls", Instrumental(), AugmentedTotalLeastSquares())


def generalized_iv(weighting: EquationWeighting | None = None) -> LinearMethod:
    """Generalized instrumental variables, the paper's (28)-(31); weights as of `extended_iv`."""
    weights = _weighting(weighting)
    return LinearMethod("generalized_iv", Compensated(), AugmentedLeastSquares(), equation_weighting=weights)


def generalized_iv_tls() -> LinearMethod:
    """Generalized instrumental variables solved by total least squares, the paper's (32), (33)."""
    return LinearMethod("generalized_iv_tls", Compensated(), AugmentedTotalLeastSquares())


def liml() -> LinearMethod:
    """Limited information maximum likelihood: extended IV that knows the errors of its columns.

    Total least squares of two-stage equations with the covariance that the instruments leave of their
    columns: (26) with errors of the right sizes, see `eivor.estimation.weighting`.
    """
    return _limited_information("liml", Instrumental(), AugmentedTotalLeastSquares())


def fuller(strength: float = 1.0) -> LinearMethod:
    """Return Fuller's modification of `liml`, which has moments.

    Parameters
    ----------
    strength : float
        1 is nearly unbiased, 4 has a small mean square error.
    """
    return _limited_information("fuller", Instrumental(), Fuller(strength))


def generalized_liml() -> LinearMethod:
    """Return `liml` of the compensated equations of generalized IV."""
    return _limited_information("generalized_liml", Compensated(), AugmentedTotalLeastSquares())


def generalized_fuller(strength: float = 1.0) -> LinearMethod:
    """Return `fuller` of the compensated equations of generalized IV."""
    return _limited_information("generalized_fuller", Compensated(), Fuller(strength))


def generalized_iv_unknown_noise(*, orders: Sequence[str] = ()) -> Method:
    """Generalized IV that estimates the noises that nothing is declared of, with optimal weights.

    Parameters
    ----------
    orders : sequence of str
        Channels whose noise is fractional, of unknown order; that of all others is white.

    Notes
    -----
    Results have `noise_variance_velocity_z`, of the white noise, and `noise_order_velocity_z`
    beside the parameters. A disturbance must not move the vehicle: the velocity would answer it.
    """
    return NoiseEstimatingIV("generalized_iv_unknown_noise", orders=tuple(orders))


def bias_eliminating_least_squares() -> Method:
    """Least squares whose bias by white noises of unknown strength is identified by instruments."""
    return NoiseEstimatingIV("bias_eliminating_least_squares", EquationChoice.BIAS_ELIMINATING)


def frisch_scheme() -> Method:
    """The Frisch scheme with instruments: white noises of regressors and response are identified."""
    return NoiseEstimatingIV("frisch_scheme", EquationChoice.FRISCH)


def spectral_giv() -> Method:
    """Generalized IV of the least variance: both equations of a sampled motion, weighted by their spectra.

    For signals of z', z'' and u without an intercept, whose input has a declared white noise; see
    `docs/efficiency.md`. Instruments of another channel, such as lags of a reference under control, take the
    place of the input's own spectrum.
    """
    return SpectralGeneralizedIV()


def spectral_giv_combined() -> Method:
    """The combination of `spectral_giv` and `generalized_iv` that has the least variance."""
    return SpectralGeneralizedIV("spectral_giv_combined", alone_from=inf)


def whittle_ml() -> Method:
    """Maximum likelihood in frequency, with the noise of the input declared and all others fitted."""
    return WhittleLikelihood()


def output_error(first: Method | None = None) -> Method:
    """Least errors of multi-step predictions, for motions that predict their states (the rigid body).

    Parameters
    ----------
    first : Method, optional
        What the search begins with, and what tests it: by default `reference_iv`.

    Notes
    -----
    Windows of half a second begin at measured states, which are free within their noise. Terms that do not
    earn their place by Akaike's criterion are zero. Without references, disturbances in closed loop bias it.
    """
    method = reference_iv() if first is None else first
    checks.kind("first", method, Method, "a method", "Make one: ev.methods.whitened_least_squares().")
    return OutputError(method)


def _limited_information(name: str, assembler: Assembler, solver: Solver) -> LinearMethod:
    return LinearMethod(name, assembler, solver, equation_weighting=LimitedInformation())


def _weighting(weighting: EquationWeighting | None) -> EquationWeighting:
    if weighting is None:
        return Unweighted()
    checks.kind("weighting", weighting, EquationWeighting, "a weighting", "Make one: ev.methods.TwoStage().")
    return weighting


#: What the command line offers for flights.
TABLE: dict[str, Callable[[], Method]] = {
    make.__name__: make
    for make in (
        *(reference_iv, least_squares, whitened_least_squares, total_least_squares, extended_iv),
        *(generalized_iv, generalized_iv_tls, bias_compensated_least_squares, spectral_giv, whittle_ml),
    )
} | {OUTPUT_ERROR: output_error}


def by_name(name: str | Method) -> Method:
    """Return the method for flights of that name; a method is its own."""
    if isinstance(name, Method):
        return name
    checks.text("method", name)
    first, _, last = name.rpartition("+")
    if first and last == OUTPUT_ERROR:
        return output_error(by_name(first))
    checks.index_of("a method", name, TABLE)
    return TABLE[name]()
