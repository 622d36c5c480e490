"""The whole band, over which what comes back through the controller has nothing in common with the residual.

A direct method divides rows by the power of their own residual, which is likelihood where the band reaches up
to half of the sampling rate. Over all frequencies a residual that is white has nothing in common with what
came before it: what it causes later, through the controller, biases nothing (Ljung 1999, chapter 13, of
prediction errors in closed loop). Over a part of them it has, and up to 20 Hz what disturbs the vehicle
biases lag and gains. All rows are many, and most are noise; so they are taken where the axes disagree about
the lag, by an estimate that begins near the one of the lower band, whose weights it takes: with equal weights
noise far above the motion counts as much as the motion.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from eivor.estimation.estimate import Estimate
from eivor.models.lagged_runs import ACTUATOR_LAG, AxisColumns, LaggedRuns
from eivor.models.separable import Begun, Nuisance
from eivor.motions.rates.axes import AXES
from eivor.motions.rigid_body.flights import BAND_SHARE, RotorColumns
from eivor.motions.rigid_body.lags_apart import lags_apart
from eivor.motions.rigid_body.parameters import FORCE_X

#: Its upper end [Hz]: further up is next to nothing but vibration.
WHOLE_BAND_HZ = 60.0
#: It is worth its rows where it is so many times the lower one.
WIDER = 1.5
#: Estimates in it, each with the weights of the one before: those of a biased one are not yet the noise's.
PASSES = 2
#: Lags within this factor of the one of the lower band are searched.
NEAR = 2.0


def settled_band(
    problem: LaggedRuns, estimate: Estimate, estimated: Callable[[LaggedRuns], Estimate]
) -> tuple[LaggedRuns, Estimate]:
    """The problem in the whole band, and its estimate, where axes disagree about the lag; else as they were.

    Parameters
    ----------
    problem : LaggedRuns
        Of the flights.
    estimate : Estimate
        Its estimate.
    estimated : callable
        From a problem to its estimate.
    """
    if lags_apart(estimate) is None:
        return problem, estimate
    whole = in_whole_band(problem)
    if whole is problem:
        return problem, estimate
    for _ in range(PASSES):
        best = estimate.best
        nuisances = tuple(_near(one, best.at[one.name]) for one in problem.nuisances)
        whole = replace(whole, nuisances=nuisances, begun=Begun(best.theta, best.at))
        estimate = estimated(whole)
    return whole, estimate


def in_whole_band(problem: LaggedRuns) -> LaggedRuns:
    """The same problem with rows of turning up to `WHOLE_BAND_HZ`; itself where the logs do not reach far."""
    columns = tuple(_whole(one) for one in problem.columns)
    pairs = zip(columns, problem.columns, strict=True)
    if not any(new.band_hz[1] >= WIDER * old.band_hz[1] for new, old in pairs):
        return problem
    noisier = None if problem.noisier is None else in_whole_band(problem.noisier)
    return replace(problem, columns=columns, noisier=noisier)


def _whole(one: AxisColumns) -> AxisColumns:
    if one.axis >= FORCE_X or not isinstance(one.moving, RotorColumns):
        return one
    flight, (low, high) = one.moving.states.flight, one.band_hz
    reaches = BAND_SHARE * min(flight.rates_hz[name] for name in (AXES[one.axis].name, "command"))
    return replace(one, band_hz=(low, max(high, min(WHOLE_BAND_HZ, reaches))))


def _near(one: Nuisance, value: float) -> Nuisance:
    """A lag with the values of its grid near the one that was found."""
    if one.name != ACTUATOR_LAG.name or not one.refined:
        return one
    near = one.grid[(one.grid >= value / NEAR) & (one.grid <= value * NEAR)]
    return replace(one, grid=near) if near.size > 1 and near[0] <= value <= near[-1] else one
