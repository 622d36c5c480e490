"""The recipe: prepared flights and a motion in, quantities with intervals and a verdict out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

from eivor.errors import EstimationError, MissingNoiseError, TooFewSamplesError
from eivor.estimation.diagnose import diagnose
from eivor.estimation.estimate import Estimate
from eivor.estimation.fit import identify
from eivor.estimation.method import Method
from eivor.estimation.methods import by_name
from eivor.estimation.parameter_sets import ParameterSets, parameter_sets
from eivor.flights.allowance import Allowance, widened
from eivor.flights.circumstances import Circumstances, Searched, Strength
from eivor.flights.declared_noise import check_declared
from eivor.flights.diagnostics import (
    fit_diagnostics,
    fit_numbers,
    fitted_noise_findings,
    flight_diagnostics,
    flight_findings,
)
from eivor.flights.estimated import EFFECTIVE_LAG, lag_quantities
from eivor.flights.given_lag import GivenLag, check_lag_searched, lag_searched, with_given_lag
from eivor.flights.grounds import unbounded_reasons
from eivor.flights.instruments import Instruments, instruments, single_frequency_hz
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import NAN, NO_INTERVAL, Quantity, Unjudged
from eivor.flights.result import Fit, FlightEstimate, Unaided
from eivor.flights.stages import Progress, Stage, silent
from eivor.flights.telemetry import telemetry_lag
from eivor.flights.told_lag import ToldLag
from eivor.inference.diagnostics.over_identification import OverIdentification
from eivor.inference.verdict import Reason, Status, Verdict, verdict
from eivor.models.separable import SeparableProblem
from eivor.signals.recording import Finding

#: What other motions say of the lag, when it is asked for.
LagsBeside = Callable[[], tuple[ToldLag, ...]]


def estimated(
    motion: Motion[Any],
    prepared: tuple[PreparedFlight, ...],
    options: FlightOptions,
    agreement: OverIdentification | None = None,
    beside: LagsBeside = tuple,
    progress: Progress = silent,
    *,
    with_sets: bool = True,
) -> FlightEstimate:
    """Estimate one set of parameters, with the method asked for or, without instruments, the fallback.

    Parameters
    ----------
    motion : Motion
        What to identify.
    prepared : tuple of PreparedFlight
        One flight, or several that have all parameters in common.
    options : FlightOptions
        Choices.
    agreement : OverIdentification, optional
        Whether the instruments agree, where that is known better than from the estimate.
    beside : callable
        What other motions of the same flight say of the lag, if there are any; called where that serves.
    progress : callable
        See `Progress`.
    with_sets : bool
        Whether the headline has its confidence sets; who asks for the lag alone needs none.
    """
    flying = tuple(flight for flight in prepared if flight.runs)
    if not flying:
        return without_fit(motion, prepared, options, _grounded(motion, prepared))
    if all(flight.constant_input for flight in flying):
        sentence = "The input is constant: it tells nothing about the vehicle."
        reason = Reason(Status.REFUSED, sentence, motion.words.fly)
        return without_fit(motion, prepared, options, reason)
    method = by_name(options.method)
    chosen = instruments(flying, options, method)
    if method.of_flights.needs_instruments and chosen.absent:
        method = by_name(motion.direct)
    method = motion.weighted(method)
    try:
        check_declared(
            [flight.noise for flight in flying], noises_needed(flying, chosen, method), options.method
        )
        problem = motion.problem(tuple(flight.shortened for flight in flying), chosen.rule)
        sensors = motion.sensors(problem, tuple(flight.shortened for flight in flying))
        align = options.align and sensors is not None and bool(sensors.told)
        if align and sensors is not None:
            prepared = motion.aligned(prepared, sensors)
            flying = tuple(flight for flight in prepared if flight.runs)
            problem = motion.problem(tuple(flight.shortened for flight in flying), chosen.rule)
        solve = partial(identify, method=method)
        problem, alone = motion.settled(problem, solve, options)
        whole = problem
        given, noticed = known_lag(motion, flying, options, problem, alone, beside)
        estimate = alone
        if given is not None:
            problem = with_given_lag(problem, given.for_the_log, alone.best.at)
            problem, estimate = motion.settled(problem, solve, options)
        prepared = motion.as_settled(prepared, problem)
        progress(Stage.DIAGNOSING)
        checks = fit_diagnostics(motion.traces(problem, estimate), estimate)
        if given is not None:
            # what was given is compared with the flight by itself, and is nothing that instruments say
            checks = replace(checks, agreement=diagnose(alone).over_identification)
        if agreement is not None and checks.agreement is not None:
            checks = replace(checks, agreement=agreement)
        sets = headline_sets(problem, estimate, motion.headline if with_sets else ())
        unaided = None if given is None else Unaided(whole, alone)
        fit = Fit(problem, estimate, chosen.rule.label, checks, given, sets, sensors, unaided)
        shortened = tuple(flight.shortened for flight in flying)
        numbers = dict(motion.diagnostics(problem, estimate, shortened))
        at = replace(
            circumstances(motion, flying, chosen, numbers), given_lag=given, sensors=sensors, aligned=align
        )
        result = with_fit(motion, prepared, options, fit, at)
        return replace(result, findings=(*result.findings, *noticed))
    except MissingNoiseError as error:
        return without_fit(motion, prepared, options, Reason(Status.REFUSED, str(error)))
    except (EstimationError, TooFewSamplesError) as error:
        reason = Reason(Status.REFUSED, str(error), motion.words.fly)
        return without_fit(motion, prepared, options, reason)


def known_lag(
    motion: Motion[Any],
    flying: tuple[PreparedFlight, ...],
    options: FlightOptions,
    problem: SeparableProblem,
    alone: Estimate,
    beside: LagsBeside = tuple,
) -> tuple[GivenLag | None, tuple[Finding, ...]]:
    """What is known of the lag beside the motion: what a user gave, else what the log tells most closely.

    Telemetry or another motion that may contradict the flight is told, and not used: sensors can be later
    than is allowed for.
    """
    slack_s = max(flight.command_slack_s for flight in flying)
    if options.lag is not None:
        check_lag_searched(problem)
        return GivenLag(options.lag, lag_quantities(problem, alone)[EFFECTIVE_LAG], slack_s), ()
    if not lag_searched(problem):
        return None, ()
    by_telemetry = telemetry_lag(flying, motion.telemetry) if motion.telemetry else None
    telling = [*([] if by_telemetry is None else [by_telemetry]), *beside()]
    noticed: list[Finding] = []
    for one in sorted(telling, key=lambda one: one.prior.std):
        # telemetry answers the commands as they were logged: what these are late by is in both lags
        own = lag_quantities(problem, alone)[EFFECTIVE_LAG]
        found = GivenLag(one.prior, own, 0.0 if one is by_telemetry else slack_s, by=one)
        if found.agrees:
            return found, tuple(noticed)
        sentence = f"The lag by {one.source} is not used: {found.sentence}."
        noticed.append(Finding(f"{one.source}_contradicts", sentence))
    return None, tuple(noticed)


def circumstances(
    motion: Motion[Any],
    flying: tuple[PreparedFlight, ...],
    chosen: Instruments,
    numbers: Mapping[str, float],
) -> Circumstances:
    """What a verdict needs to know of flights beside the numbers."""
    measured = [[rate for role, rate in f.rates_hz.items() if role != "command"] for f in flying]
    return Circumstances(
        flights=len(flying),
        command_rate_hz=min(flight.rates_hz["command"] for flight in flying),
        response_rate_hz=min(max(rates) for rates in measured),
        exogenous=chosen.exogenous,
        direct=chosen.absent,
        missing_reference=chosen.missing,
        constant_reference=chosen.constant,
        excitation=motion.excitation(flying),
        single_frequency_hz=single_frequency_hz(flying, chosen.names),
        numbers=numbers,
        used_s=sum(flight.used_s for flight in flying),
        past_inputs=chosen.past_inputs,
    )


def noises_needed(
    flying: tuple[PreparedFlight, ...], chosen: Instruments, method: Method
) -> list[tuple[str, ...]]:
    """Channels of each flight whose measurement noise a method takes out: those that are columns twice.

    Commands and references are exact; of the input only a measured state has noise.
    """
    by_input = method.takes_out_own_noise or (chosen.past_inputs and method.first_past_input == 0)
    return [
        (
            *(flight.states if method.takes_out_own_noise else ()),
            *(flight.driving if by_input and flight.input.measured else ()),
        )
        for flight in flying
    ]


def with_fit(
    motion: Motion[Any],
    prepared: tuple[PreparedFlight, ...],
    options: FlightOptions,
    fit: Fit,
    at: Circumstances,
) -> FlightEstimate:
    """Result of a fit: quantities with intervals and verdicts."""
    unjudged = with_intervals_by_sets(motion, motion.quantities(fit.problem, fit.estimate), fit)
    flying = tuple(flight for flight in prepared if flight.runs)
    unjudged = with_allowances(
        motion, unjudged, motion.allowances(fit.problem, fit.estimate, flying, unjudged, at)
    )
    overall, quantities = judged(motion, unjudged, strength(fit), at, fit.estimate.reasons)
    return FlightEstimate(
        motion,
        options,
        prepared,
        fit,
        overall,
        quantities,
        flight_diagnostics(prepared)
        | fit_numbers(fit.checks, fit.estimate, motion.headline)
        | ({} if fit.sensors is None else fit.sensors.numbers)
        | dict(at.numbers),
        (
            *flight_findings(prepared, motion.words),
            *fitted_noise_findings(fit.estimate),
            *motion.findings(prepared, quantities),
        ),
    )


def headline_sets(
    problem: SeparableProblem, estimate: Estimate, headline: tuple[str, ...]
) -> dict[str, ParameterSets]:
    """Confidence sets of the headline's linear parameters, where the method has them."""
    linear = {parameter.name for parameter in estimate.best.rows.parameters}
    found = {name: parameter_sets(problem, estimate, name) for name in headline if name in linear}
    return {name: sets for name, sets in found.items() if sets is not None}


def with_intervals_by_sets(
    motion: Motion[Any], unjudged: Mapping[str, Unjudged], fit: Fit
) -> Mapping[str, Unjudged]:
    """Quantities, those that are judged by confidence sets with the hulls of these as intervals."""
    if not fit.by_sets:
        return unjudged
    changed = {name: replace(unjudged[name], interval=one.hull) for name, one in fit.by_sets.items()}
    quantities = {**unjudged, **changed}
    return {**quantities, **motion.following(quantities)}


def with_allowances(
    motion: Motion[Any], unjudged: Mapping[str, Unjudged], allowances: Mapping[str, tuple[Allowance, ...]]
) -> Mapping[str, Unjudged]:
    """Quantities with their systematic parts; those that follow from a headline that widens follow it."""
    quantities = dict(unjudged)
    for name, parts in allowances.items():
        one = unjudged[name]
        quantities[name] = replace(one, interval=widened(one.interval, one.value, parts), allowances=parts)
    if all(quantities[name].interval == unjudged[name].interval for name in motion.headline):
        return quantities
    return {**quantities, **motion.following(quantities)}


def strength(fit: Fit) -> Strength:
    """What the instruments of a fit tell, in the numbers that reports show."""
    best, checks = fit.estimate.best, fit.checks
    searched = {
        profile.nuisance.name: Searched(best.at[profile.nuisance.name], float(profile.grid[-1]))
        for profile in best.profiles
    }
    p_value = 1.0 if checks.agreement is None else checks.agreement.p_value
    return Strength(checks.first_stage, p_value, searched, fit.robust_sets)


def judged(
    motion: Motion[Any],
    unjudged: Mapping[str, Unjudged],
    numbers: Strength,
    at: Circumstances,
    of_estimate: tuple[Reason, ...] = (),
) -> tuple[Verdict, dict[str, Quantity]]:
    """The overall verdict, and the quantities with their own; grounds of the estimate are each one's."""
    grounds = {
        name: (
            *reasons,
            *of_estimate,
            *unbounded_reasons(unjudged[name], motion.wording[name].words, reasons),
        )
        if name in unjudged
        else (*reasons, *of_estimate)
        for name, reasons in motion.grounds(unjudged, numbers, at).items()
    }
    against = dict.fromkeys(reason for name in motion.headline for reason in grounds[name])
    quantities = {
        name: unjudged[name].judged(verdict(list(grounds[name])), wording)
        for name, wording in motion.wording.items()
        if name in unjudged or not wording.optional
    }
    return verdict(list(against)), quantities


def without_fit(
    motion: Motion[Any], prepared: tuple[PreparedFlight, ...], options: FlightOptions, reason: Reason
) -> FlightEstimate:
    """Result of flights that gave no estimate."""
    quantities = not_estimated(motion, motion.known(tuple(flight for flight in prepared if flight.runs)))
    return FlightEstimate(
        motion,
        options,
        prepared,
        None,
        verdict([reason]),
        quantities,
        flight_diagnostics(prepared),
        (*flight_findings(prepared, motion.words), *motion.findings(prepared, quantities)),
    )


def not_estimated(motion: Motion[Any], known: Mapping[str, float]) -> dict[str, Quantity]:
    """Quantities of a flight that gives no estimate; some values may still be known."""
    return {
        name: Quantity(known.get(name, NAN), wording.unit, NAN, NO_INTERVAL, Status.REFUSED)
        for name, wording in motion.wording.items()
        if not wording.optional
    }


def _grounded(motion: Motion[Any], prepared: tuple[PreparedFlight, ...]) -> Reason:
    """Why no flight has a run."""
    words = motion.words
    name, alone = prepared[0].recording.name, len(prepared) == 1
    if not any(flight.active.mask.any() for flight in prepared):
        which = f"{name} never {words.begins}" if alone else f"No flight of the pool {words.begins}"
        return Reason(Status.REFUSED, f"{which} (by {prepared[0].active.rule}).", words.another_log)
    which = f"{name} has no" if alone else "No flight of the pool has"
    sentence = f"{which} three seconds {words.where} in runs of a second or more, {words.limits}."
    return Reason(Status.REFUSED, sentence, words.loosen)
