"""The result of several flights of one vehicle: what they share, and what is each flight's own.

A motion says which of its parameters belong to the flight (`Motion.of_flight`). The others, and lags and
delays, are estimated once for all flights; those of the flight once for each, and judged for each. The
pool's own value of such a parameter is the common one where the flights agree, else their mean, see
`estimation/pools`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eivor.errors import EstimationError
from eivor.estimation.assembler import Instrumental
from eivor.estimation.linear import LinearMethod
from eivor.estimation.methods import by_name
from eivor.estimation.parameter_sets import ParameterSets
from eivor.estimation.pools.pooled import Pooled
from eivor.estimation.pools.pooling import pooled
from eivor.estimation.weighting.whitening import SpectralWhitening
from eivor.flights.agreement import SensorAgreement
from eivor.flights.circumstances import Circumstances
from eivor.flights.diagnostics import FitDiagnostics, fit_diagnostics, flight_findings
from eivor.flights.estimated import EFFECTIVE_LAG
from eivor.flights.given_lag import with_given_lag
from eivor.flights.instruments import Instruments, instruments
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.pool_verdict import agreement, linear_names, pool_findings
from eivor.flights.prepared import PreparedFlight
from eivor.flights.recipe import circumstances, known_lag, with_fit
from eivor.flights.result import Fit, FlightEstimate, FlightRow, Unaided, pooled_traces
from eivor.inference.sets.confidence_set import ConfidenceSet
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY
from eivor.models.separable import SeparableProblem
from eivor.signals.recording import Finding


@dataclass(frozen=True)
class Member:
    """A flight of a pool.

    Parameters
    ----------
    logged, flight : PreparedFlight
        The flight as logged, and as it was estimated: with its sensors aligned where that was asked for.
    fit : Fit
        Its own fit, by whitened instruments.
    exogenous : bool
        Its instruments do not answer the vehicle.
    """

    logged: PreparedFlight
    flight: PreparedFlight
    fit: Fit
    exogenous: bool


def pooled_result(
    motion: Motion[Any],
    prepared: tuple[PreparedFlight, ...],
    options: FlightOptions,
    alone: Sequence[FlightEstimate],
) -> FlightEstimate | None:
    """Result of a pool some of whose parameters belong to the flight.

    Parameters
    ----------
    motion : Motion
        What to identify.
    prepared : tuple of PreparedFlight
        The flights.
    options : FlightOptions
        Choices.
    alone : sequence of FlightEstimate
        Each flight by itself.

    Returns
    -------
    FlightEstimate or None
        None where nothing belongs to the flight, or all is to be common; for another method than one by
        whitened instruments; and where fewer than two flights have an estimate by it.
    """
    if not motion.of_flight or options.pool_friction == "common":
        return None
    members = _members(prepared, options, alone)
    if len(members) < 2 or any(one.flight.input_map != one.logged.input_map for one in members):
        return None  # a map that was found out is another one in each flight
    chosen = instruments(tuple(one.flight for one in members), options, by_name(options.method))
    if chosen.absent:
        return None
    try:
        found = _Pool(motion, members, options, chosen).result()
    except (EstimationError, np.linalg.LinAlgError):
        return None
    serving = {id(one.logged): one.flight for one in members}
    left_out = [one for one in prepared if one.runs and id(one) not in serving]
    told = tuple(serving.get(id(one), one) for one in prepared if not one.runs or id(one) in serving)
    findings = (*flight_findings(told, motion.words), *map(_left_out, left_out), *found.findings)
    return replace(found, prepared=told, findings=findings)


def _members(
    prepared: Sequence[PreparedFlight], options: FlightOptions, alone: Sequence[FlightEstimate]
) -> tuple[Member, ...]:
    """Flights with an estimate by whitened instruments; those that answer no vehicle, if there are any."""
    method = by_name(options.method)
    found = [
        Member(flight, own.prepared[0], own.fit, instruments((flight,), options, method).exogenous)
        for flight, own in zip(prepared, alone, strict=True)
        if own.fit is not None and _by_whitened_instruments(own.fit)
    ]
    clean = tuple(one for one in found if one.exogenous)
    return clean or tuple(found)


def _by_whitened_instruments(fit: Fit) -> bool:
    method = by_name(fit.estimate.method)
    return (
        isinstance(method, LinearMethod)
        and isinstance(method.assembler, Instrumental)
        and isinstance(method.row_weighting, SpectralWhitening)
    )


def _left_out(flight: PreparedFlight) -> Finding:
    return Finding(
        "left_out_of_pool",
        f"{flight.recording.name} is not in the pool: it gives no estimate by a reference like the others'.",
    )


@dataclass(frozen=True)
class _Pool:
    """How flights become the result of their pool."""

    motion: Motion[Any]
    members: tuple[Member, ...]
    options: FlightOptions
    chosen: Instruments

    def result(self) -> FlightEstimate:
        """Quantities of the pool and of each flight, with their verdicts."""
        motion, flights = self.motion, tuple(one.flight for one in self.members)
        problem, sensors, aligned = self._problem()
        pool, unaided = self._pooled(problem), None
        estimate = pool.whole()
        given, noticed = known_lag(motion, flights, self.options, problem, estimate)
        if given is not None:
            unaided = Unaided(problem, estimate)
            problem = with_given_lag(problem, given.for_the_log, estimate.best.at)
            pool = self._pooled(problem)
            estimate = pool.whole()
        sets = _found({name: pool.whole_sets(name) for name in linear_names(pool)})
        fit = Fit(
            problem,
            estimate,
            self.chosen.rule.label,
            self._checks(pool),
            given,
            {name: sets[name] for name in motion.headline if name in sets},
            sensors,
            unaided,
            pool,
            {**_profiles(sets), **_of_lags(pool)},
        )
        numbers = dict(motion.diagnostics(problem, estimate, tuple(one.shortened for one in flights)))
        at = replace(
            circumstances(motion, flights, self.chosen, numbers),
            given_lag=given,
            sensors=sensors,
            aligned=aligned,
        )
        whole = with_fit(motion, flights, self.options, fit, at)
        by_flight = tuple(self._by_flight(pool, fit, at))
        tests = {
            "pool_own_p_value": pool.own_p_value,
            "pool_shared_p_value": pool.shared_p_value,
            "pool_inflation": pool.inflation,
        }
        findings = (
            *motion.findings(flights, whole.quantities),
            *pool_findings(motion, pool, at),
            *noticed,
        )
        return replace(
            whole,
            by_flight=by_flight,
            diagnostics={**whole.diagnostics, **tests},
            findings=findings,
        )

    def _problem(self) -> tuple[SeparableProblem, SensorAgreement | None, bool]:
        """All flights as one problem, whether sensors agree as logged, and whether they were aligned."""
        logged = tuple(one.logged.shortened for one in self.members)
        problem = self.motion.problem(logged, self.chosen.rule)
        sensors = self.motion.sensors(problem, logged)
        if all(one.flight is one.logged for one in self.members):
            return problem, sensors, False
        aligned = tuple(one.flight.shortened for one in self.members)
        return self.motion.problem(aligned, self.chosen.rule), sensors, True

    def _pooled(self, whole: SeparableProblem) -> Pooled:
        return pooled(
            [one.fit.by_itself.problem for one in self.members],
            [one.fit.by_itself.estimate for one in self.members],
            self.motion.of_flight,
            nuisances=whole.nuisances,
            separate=self.options.pool_friction == "separate",
        )

    def _checks(self, pool: Pooled) -> FitDiagnostics:
        """Diagnostics of the pool; strength and agreement of the instruments as its flights have them."""
        made = fit_diagnostics(pooled_traces(self.motion, pool), pool.whole())
        by_flight = [_first_stage(pool, number) for number in range(len(self.members))]
        return replace(
            made,
            first_stage={name: float(np.median([one[name] for one in by_flight])) for name in by_flight[0]},
            rank=pool.candidates[pool.best].separate.instruments,
            agreement=agreement([one.fit.checks for one in self.members]),
        )

    def _by_flight(self, pool: Pooled, fit: Fit, at: Circumstances) -> Iterator[FlightRow]:
        """What the pool says of each flight."""
        motion = self.motion
        of_own = {name: pool.member_sets(name) for name in pool.own}
        shared = {name: one for name, one in fit.profiles.items() if name not in pool.own}
        for number, member in enumerate(self.members):
            flight = (member.flight,)
            problem = pool.problems[number].with_nuisances(pool.nuisances)
            estimate = pool.member(number)
            here = replace(
                at,
                flights=1,
                command_rate_hz=member.flight.rates_hz["command"],
                excitation=motion.excitation(flight),
                numbers=dict(motion.diagnostics(problem, estimate, (member.flight.shortened,))),
            )
            checks = replace(member.fit.checks, first_stage=_first_stage(pool, number))
            of_flight = _found({name: each[number] for name, each in of_own.items()})
            sets = {name: one for name, one in {**fit.sets, **of_flight}.items() if name in motion.headline}
            profiles = {**shared, **_profiles(of_flight)}
            own = Fit(
                problem, estimate, member.fit.instruments, checks, fit.given_lag, sets, profiles=profiles
            )
            told = with_fit(motion, flight, self.options, own, here)
            yield FlightRow(
                member.flight.recording.name, told.verdict.status, told.quantities, told.verdict.sentences
            )


def _first_stage(pool: Pooled, number: int) -> dict[str, float]:
    """Conditional first-stage F of the vector of one flight."""
    joint = pool.candidates[pool.best].joint
    names = [*linear_names(pool), *(axis.nuisance.name for axis in joint.criterion.nodes.axes)]
    return dict(zip(names, joint.first_stage[joint.places[number]].tolist(), strict=True))


def _profiles(sets: Mapping[str, ParameterSets]) -> dict[str, ConfidenceSet]:
    return {name: one.profile for name, one in sets.items()}


def _of_lags(pool: Pooled) -> dict[str, ConfidenceSet]:
    """Profile sets of the lag, and of lag and delay together."""
    if pool.nuisance_names != (ACTUATOR_LAG.name,):
        return {}
    names = {ACTUATOR_LAG.name: (ACTUATOR_LAG.name,), EFFECTIVE_LAG: (ACTUATOR_LAG.name, DELAY.name)}
    found = {name: pool.lag_set(each) for name, each in names.items()}
    return {name: one for name, one in found.items() if one is not None}


def _found(sets: dict[str, ParameterSets | None]) -> dict[str, ParameterSets]:
    return {name: one for name, one in sets.items() if one is not None}
