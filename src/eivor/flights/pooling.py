"""Results and verdict of pooled flights, and the bootstrap over flights."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import msgspec
import numpy as np

from eivor import checks
from eivor.errors import EivorError, EstimationError, UsageError
from eivor.estimation.bootstrap import Bootstrap, PoolFlights, Replicate, check_draws, pool_flights
from eivor.estimation.linear import LinearMethod
from eivor.estimation.methods import by_name
from eivor.estimation.moments import Instrumental
from eivor.estimation.pool import Pooled, pooled
from eivor.estimation.weighting import SpectralWhitening
from eivor.flights import result as outcome
from eivor.flights.estimate import (
    FlightState,
    instruments,
    known_lag,
    posed,
    verdict_inputs,
    with_fit,
    without_fit,
)
from eivor.flights.lag_prior import LAG_SUMS, with_lag_prior
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight
from eivor.flights.result import FlightEstimate
from eivor.flights.verdict import Instruments, VerdictInputs
from eivor.inference.diagnostics.instruments import OverIdentification
from eivor.models.lagged_runs import ACTUATOR_LAG
from eivor.models.separable import SeparableProblem
from eivor.signals.recording import Finding
from eivor.tools import Float

T = TypeVar("T")

RUNS = 999


def bootstrap_flights(
    fit: FlightEstimate, *, runs: int = RUNS, seed: int | np.random.Generator = 0
) -> Bootstrap:
    """Bootstrap the estimate of a pool of flights by drawing whole flights.

    Parameters
    ----------
    fit : FlightEstimate
        Of several flights, from `identify_flight` with its default method. Of any motion.
    runs : int
        Replicates to make.
    seed : int or numpy.random.Generator
        The same seed gives the same replicates.

    Returns
    -------
    Bootstrap
        Replicates of the linear parameters, of the nuisances that were searched for, and of what the motion
        derives from them. Take the expanded intervals, the default: with ten flights the percentiles
        themselves are too narrow by a sixth.

    Raises
    ------
    UsageError
        Without an estimate by whitened instruments of two flights or more.

    Notes
    -----
    Some seconds for a pool of ten flights of a minute; a replicate takes a few milliseconds, whatever the
    flights' length.
    """
    remedy = "Make one by ev.identify_flight(recordings)."
    checks.kind("fit", fit, FlightEstimate, "a pool's estimate", remedy)
    check_draws(runs, seed)
    fitted = fit.fit
    if fitted is None:
        remedy = "See its verdict for what the flights lack."
        raise UsageError("a pool with an estimate", "one without", remedy)
    pool = pool_flights(fitted.problem, fitted.estimate)
    quantities = _quantities_of_draws(fit.motion, fitted.problem, pool)
    full, random, rows = quantities(pool.full, np.ones(len(pool.flights))), np.random.default_rng(seed), []
    for _ in range(runs):
        try:
            rows.append(list(quantities(*pool.replicate(random)).values()))
        except (EivorError, np.linalg.LinAlgError):
            continue
    draws = np.array(rows).reshape(-1, len(full))
    nuisances = [nuisance.parameter for nuisance in fitted.problem.nuisances]
    units = {name: wording.unit for name, wording in fit.motion.quantities.items()}
    units |= {item.name: item.unit for item in (*nuisances, *fitted.estimate.joint_parameters)}
    return Bootstrap(
        tuple(full),
        tuple(units[name] for name in full),
        np.array(list(full.values())),
        draws,
        runs - draws.shape[0],
        len(pool.flights),
        float("nan"),
        None if isinstance(seed, np.random.Generator) else seed,
    )


def _quantities_of_draws(
    motion: Motion[Any], problem: SeparableProblem, pool: PoolFlights
) -> Callable[[Replicate, Float[np.ndarray, " F"]], Mapping[str, float]]:
    """Function from a replicate, and the draws of each flight, to quantities of the motion."""
    names, flights = [parameter.name for parameter in pool.parameters], list(pool.flights)
    resampling = motion.abilities.resampling
    nodes = [{} if resampling is None else resampling.sums(problem, point) for point in pool.nodes.points]
    at_nodes = {name: np.stack([node[name][flights] for node in nodes], axis=1) for name in nodes[0]}

    def quantities(replicate: Replicate, times: Float[np.ndarray, " F"]) -> Mapping[str, float]:
        parameters = dict(zip(names, replicate.theta.tolist(), strict=True))
        if resampling is None:
            searched = [nuisance.name for nuisance in problem.nuisances if nuisance.searched]
            return {**parameters, **{name: replicate.nuisances[name] for name in searched}}
        sums = {name: float(times @ point @ replicate.weights) for name, point in at_nodes.items()}
        return resampling.quantities(problem, parameters, replicate.nuisances, sums)

    return quantities


def agreement(fits: Sequence[outcome.FitDiagnostics]) -> OverIdentification | None:
    """Over-identification test of a pool, combined from those of its single flights."""
    agreements = [item.agreement for item in fits if item.agreement is not None]
    known = sorted(item.p_value for item in agreements if np.isfinite(item.p_value))
    if not known:
        return None
    middle, J = (len(known) + 1) // 2, sum(item.J for item in agreements)
    p_value = min(len(known) / middle * known[middle - 1], 1.0)
    return OverIdentification(J, sum(item.degrees for item in agreements), p_value)


def linear_names(pool: Pooled) -> tuple[str, ...]:
    """Linear parameters of a flight, in their order."""
    return tuple(parameter.name for parameter in pool.estimates[0].rows.parameters)


def pool_findings(motion: Motion[Any], pool: Pooled, inputs: VerdictInputs) -> Iterator[Finding]:
    """Findings about the agreement of a pool's flights."""
    text = " and ".join(motion.quantities[name].words for name in pool.tested)
    means = [name for name in pool.flight_specific if pool.has_mean(name)]
    if means:
        p_values = [] if pool.separate else [pool.agreement_p_value]
        p_values += [pool.shared_p_value] if pool.differing else []
        p_words = f" (p {min(p_values):.2g})" if p_values else ""
        differing = " and ".join(motion.quantities[name].words for name in means)
        yield Finding(
            "flights_differ",
            f"The flights differ in {differing}{p_words}: its value here is their mean, whose interval "
            "counts the differences. Each flight's own is listed by flight.",
        )
    if pool.inflation > 1.0:
        shared = [name for name in linear_names(pool) if name not in pool.flight_specific]
        names = [motion.quantities[name].words for name in shared]
        names += [item.name.replace("_", " ") for item in pool.criterion.nodes.nuisances]
        yield Finding(
            "shared_differs",
            f"The flights differ in what a vehicle keeps ({', '.join(names)}) by more than chance says "
            f"(p {pool.shared_p_value:.2g}): its intervals are {pool.inflation**0.5:.2g} times as wide.",
        )
    searched = any(nuisance.name == ACTUATOR_LAG.name and nuisance.searched for nuisance in pool.nuisances)
    if inputs.single_frequency_hz and searched and inputs.lag_prior is None:
        frequency = f"one frequency ({inputs.single_frequency_hz:.2g} Hz)"
        yield Finding(
            "lag_by_differences",
            f"The references of all flights have {frequency}, at which lag and {text} act alike: the lag "
            f"rests on the differences of the {text} between flights.",
        )


class Member(msgspec.Struct, frozen=True):
    """A flight of a pool."""

    logged: PreparedFlight
    flight: PreparedFlight
    fit: outcome.Fit
    exogenous: bool


def pooled_result(state: FlightState, results: Sequence[FlightEstimate]) -> FlightEstimate | None:
    """Result of a pool some of whose parameters belong to the flight."""
    motion, prepared, options = state.motion, state.prepared, state.options
    if not motion.quantities.of_flight or options.pool_friction == "common":
        return None
    members = _members(prepared, options, results)
    if len(members) < 2 or any(member.flight.input_map != member.logged.input_map for member in members):
        return None  # a map that was found out is another one in each flight
    chosen = instruments(tuple(member.flight for member in members), options, by_name(options.method))
    if chosen.direct:
        return None
    try:
        result = _result(state, members, chosen)
    except (EstimationError, np.linalg.LinAlgError) as error:
        text = " and ".join(motion.quantities[name].words for name in motion.quantities.of_flight)
        remedy = "Leave flights out, or identify the pool with --pool-friction common if all have the same."
        return without_fit(state, f"The pool has no solution with {text} of each flight: {error}", remedy)
    serving = {id(member.logged): member.flight for member in members}
    in_order = tuple(serving.get(id(item), item) for item in prepared if not item.runs or id(item) in serving)
    omitted = left_out(item for item in prepared if item.runs and id(item) not in serving)
    findings = (*outcome.flight_findings(in_order, motion.words), *omitted, *result.findings)
    return replace(result, prepared=in_order, findings=findings)


def left_out(flights: Iterable[PreparedFlight]) -> Iterator[Finding]:
    """Findings on flights that a pool leaves out."""
    why = "is not in the pool: it gives no estimate by a reference like the others'."
    return (Finding("left_out_of_pool", f"{flight.recording.name} {why}") for flight in flights)


def with_references(
    flights: tuple[PreparedFlight, ...], options: FlightOptions
) -> tuple[PreparedFlight, ...]:
    """Flights with the reference that most have, where instruments are needed and not all share one."""
    flying = tuple(flight for flight in flights if flight.runs)
    counts = Counter(name for flight in flying for name in flight.usable_references)
    if not counts or not instruments(flying, options, by_name(options.method)).missing:
        return flights
    most = max(counts, key=counts.__getitem__)
    return tuple(flight for flight in flights if not flight.runs or most in flight.usable_references)


def _members(
    prepared: Sequence[PreparedFlight], options: FlightOptions, alone: Sequence[FlightEstimate]
) -> tuple[Member, ...]:
    """Flights with an estimate by whitened instruments; those that answer no vehicle, if there are any."""
    requested_method, results = by_name(options.method), []
    for flight, item in zip(prepared, alone, strict=True):
        method = None if item.fit is None else by_name(item.fit.estimate.method)
        if item.fit is None or not isinstance(method, LinearMethod):
            continue
        if isinstance(method.assembler, Instrumental) and isinstance(method.row_weighting, SpectralWhitening):
            exogenous = instruments((flight,), options, requested_method).exogenous
            results.append(Member(flight, item.prepared[0], item.fit, exogenous))
    return tuple(result for result in results if result.exogenous) or tuple(results)


def _result(state: FlightState, members: tuple[Member, ...], chosen: Instruments) -> FlightEstimate:
    motion, flights = state.motion, tuple(member.flight for member in members)
    logged = replace(state, prepared=tuple(member.logged for member in members), instruments=chosen)
    state, problem = replace(logged, prepared=flights), posed(logged)
    sensors = motion.abilities.sensors.agreement(problem, logged.flights)
    if any(flight.corrected for flight in flights):
        problem = posed(state)
    fits = [member.fit for member in members]
    problems, estimates = zip(*(f.without_prior or (f.problem, f.estimate) for f in fits), strict=True)
    separate = state.options.pool_friction == "separate"
    make = partial(pooled, problems, estimates, motion.quantities.of_flight, separate=separate)
    pool, without_prior = make(nuisances=problem.nuisances), None
    estimate = pool.pooled_estimate()
    prior, findings = known_lag(replace(state, problem=problem, estimate=estimate))
    if prior is not None:
        without_prior = problem, estimate
        problem = with_lag_prior(problem, prior.for_the_log)
        pool = make(nuisances=problem.nuisances)
        estimate = pool.pooled_estimate()
    sets = _known({name: pool.common_sets(name) for name in linear_names(pool)})
    searched = [nuisance.name for nuisance in pool.criterion.nodes.nuisances]
    sums = LAG_SUMS if searched[:1] == [ACTUATOR_LAG.name] else {}
    of_lags = {name: pool.lag_set(parts) for name, parts in sums.items()}
    # strength and agreement of the instruments as the flights have them
    stages = [_first_stage(pool, number) for number in range(len(members))]
    checks = replace(
        outcome.fit_diagnostics(outcome.pooled_traces(motion, pool), estimate),
        first_stage={name: float(np.median([item[name] for item in stages])) for name in stages[0]},
        rank=pool.criterion.instruments,
        agreement=agreement([item.checks for item in fits]),
    )
    fit = outcome.Fit(
        problem,
        estimate,
        chosen.rule.label,
        checks,
        prior,
        sets,
        sensors,
        without_prior,
        pool,
        {**{name: item.profile for name, item in sets.items()}, **_known(of_lags)},
        motion.checks(problem, estimate, state.flights),
    )
    inputs = verdict_inputs(state, fit)
    result = with_fit(state, fit, inputs)
    p_value, shared = pool.agreement_p_value, pool.shared_p_value
    tests = {"pool_own_p_value": p_value, "pool_shared_p_value": shared, "pool_inflation": pool.inflation}
    of_motion = motion.abilities.findings(flights, result.quantities)
    return replace(
        result,
        by_flight=tuple(_by_flight(state, members, fit, pool, inputs)),
        diagnostics={**result.diagnostics, **tests},
        findings=(*of_motion, *pool_findings(motion, pool, inputs), *findings),
    )


def _by_flight(
    state: FlightState, members: tuple[Member, ...], fit: outcome.Fit, pool: Pooled, inputs: VerdictInputs
) -> Iterator[outcome.FlightRow]:
    motion = state.motion
    of_own = {name: pool.member_sets(name) for name in pool.flight_specific}
    shared = {name: profile for name, profile in fit.profiles.items() if name not in pool.flight_specific}
    for number, member in enumerate(members):
        flight = (member.flight,)
        problem = pool.problems[number]
        estimate = pool.member(number)
        checks = motion.checks(problem, estimate, (member.flight.shortened,))
        here = replace(
            inputs,
            flights=flight,
            command_rate_hz=member.flight.rates_hz["command"],
            excitation=motion.abilities.excitation(flight),
            checks=checks,
        )
        of_flight = _known({name: each[number] for name, each in of_own.items()})
        flight_fit = outcome.Fit(
            problem,
            estimate,
            member.fit.instruments,
            replace(member.fit.checks, first_stage=_first_stage(pool, number)),
            fit.lag_prior,
            {**fit.sets, **of_flight},
            profiles={**shared, **{name: item.profile for name, item in of_flight.items()}},
            motion_checks=checks,
        )
        result, name = with_fit(replace(state, prepared=flight), flight_fit, here), flight[0].recording.name
        yield outcome.FlightRow(name, result.verdict.status, result.quantities, result.verdict.sentences)


def _first_stage(pool: Pooled, number: int) -> dict[str, float]:
    joint = pool.joint
    names = [*linear_names(pool), *(nuisance.name for nuisance in joint.criterion.nodes.nuisances)]
    return dict(zip(names, joint.first_stage[joint.indices[number]].tolist(), strict=True))


def _known(items: Mapping[str, T | None]) -> dict[str, T]:
    return {name: item for name, item in items.items() if item is not None}
