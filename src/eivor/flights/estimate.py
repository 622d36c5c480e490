"""Stages of an identification, from prepared flights to a result."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np

from eivor import errors
from eivor.errors import MissingNoiseError
from eivor.estimation.diagnose import diagnose
from eivor.estimation.estimate import Estimate
from eivor.estimation.linear import OUTPUT_ERROR, LinearMethod, Method, OutputError
from eivor.estimation.methods import by_name, identify
from eivor.estimation.profile_sets import ProfileSets
from eivor.estimation.weighting import SpectralWhitening
from eivor.flights import lag_prior, quantity
from eivor.flights import result as outcome
from eivor.flights import verdict as verdicts
from eivor.flights.grid import upward
from eivor.flights.lag_prior import LagPrior
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import part_to_read, prepare
from eivor.flights.prepared import PreparedFlight, SensorAgreement
from eivor.flights.quantity import Quantity, QuantityEstimate, widened
from eivor.flights.references import CONSTANT, check_declared
from eivor.flights.result import FlightEstimate
from eivor.flights.verdict import Instruments, VerdictInputs, reasons_by_quantity, systematic_uncertainties
from eivor.inference.confidence_set import ConfidenceSet
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE, OverIdentification
from eivor.inference.diagnostics.record import SIGNIFICANT
from eivor.inference.verdict import Reason, Status, verdict
from eivor.models import separable
from eivor.models.lagged_runs import ACTUATOR_LAG, DELAY, with_order
from eivor.models.separable import NoInstruments
from eivor.signals.recording import Finding, Recording
from eivor.tools import Float, Progress, Stage, no_stage_callback

#: Role of the commands among the rates of a selection.
COMMAND = "command"

#: A reference has one frequency when this share of its power lies within these bins of its peak.
LINE_SHARE = 0.995
LINE_BINS = 3


def instruments(flights: tuple[PreparedFlight, ...], options: FlightOptions, method: Method) -> Instruments:
    """Instruments of a method: the requested ones, else its natural ones."""
    method = method.of_flights
    if not method.needs_instruments:
        return Instruments(NoInstruments())
    requested = options.instruments or (method.natural_instruments,)
    if requested == ("lags",):
        return Instruments(separable.LaggedInputs(method.first_past_input), exogenous=False, past_inputs=True)
    references = [reference for flight in flights for reference in flight.references]
    first, *others = (flight.usable_references for flight in flights)
    shared = tuple(name for name in first if all(name in names for names in others))
    if shared:
        exogenous = all(reference.exogenous for reference in references if reference.usable)
        return Instruments(separable.LaggedReferences(shared), exogenous=exogenous, names=shared)
    remarks = {f"{reference.name}: {reference.remark}" for reference in references if not reference.usable}
    missing = "; ".join(sorted(remarks)) or "the log has none"
    constant = any(reference.remark == CONSTANT for reference in references)
    return Instruments(NoInstruments(), missing=missing, constant=constant)


def single_frequency_hz(flights: tuple[PreparedFlight, ...], names: tuple[str, ...]) -> float:
    """Common frequency of references with one spectral line each; zero for others [Hz]."""
    peaks: list[float] = []
    for flight in flights:
        longest = max(flight.runs, key=lambda run: run.stop - run.start)
        width = 1.0 / ((longest.stop - longest.start) * flight.signals.step_s)
        for name in names:
            values = flight.signals.channel(name)[longest]
            power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(values.size))) ** 2
            peak = int(np.argmax(power))
            in_peak = power[max(peak - LINE_BINS, 0) : peak + LINE_BINS + 1].sum()
            first_hz = (peaks or [peak * width])[0]
            if not in_peak >= LINE_SHARE * power.sum() or abs(peak * width - first_hz) > width:
                return 0.0
            peaks.append(peak * width)
    return float(np.mean(peaks)) if peaks else 0.0


# -- Stages of an identification --

#: Lags by other motions, estimated when they are requested.
LagMeasurements = Callable[[], tuple[LagPrior, ...]]


@dataclass(frozen=True)
class FlightState:
    """Inputs and results of the stages of an identification."""

    motion: Motion[Any]
    prepared: tuple[PreparedFlight, ...]
    options: FlightOptions
    lag_measurements: LagMeasurements = tuple
    agreement: OverIdentification | None = None  # Of the flights of a pool; else that of the estimate counts
    skip_reason: str = ""  # Reason to skip the estimate, by a coarse search
    # Made by the stages, in this order; None until then
    instruments: Instruments | Any = None
    method: Method | Any = None
    problem: separable.SeparableProblem | Any = None
    sensors: SensorAgreement | None = None
    estimate: Estimate | Any = None
    lag_prior: LagPrior | None = None
    without_prior: tuple[separable.SeparableProblem, Estimate] | None = None
    findings: tuple[Finding, ...] = ()
    fit: outcome.Fit | Any = None

    @property
    def flights(self) -> tuple[PreparedFlight, ...]:
        """Flights with runs, cut to the samples that these need."""
        return tuple(flight.shortened for flight in self.prepared if flight.runs)


def choose_instruments(state: FlightState) -> FlightState:
    """The method that was requested, and its instruments; without any the direct method of the motion."""
    method, whitened = by_name(state.options.method), state.motion.abilities.whitened
    selected = instruments(state.flights, state.options, method)
    if method.of_flights.needs_instruments and selected.direct:
        method = by_name("whitened_least_squares" if whitened else "least_squares")
    elif whitened and method.name == "total_least_squares" and isinstance(method, LinearMethod):
        method = replace(method, row_weighting=SpectralWhitening())
    return replace(state, instruments=selected, method=method)


def pose_problem(state: FlightState) -> FlightState:
    """The problem of the flights, with sensors corrected where they disagree."""
    motion, flights = state.motion, state.flights
    # undeclared noises are refused of channels that a method takes out: those that are columns twice
    regressors = state.method.of_flights.takes_out_own_noise
    inputs = regressors or (state.instruments.past_inputs and state.method.of_flights.first_past_input == 0)
    noises = [
        (f.noise, (*(f.states if regressors else ()), *(f.driving if inputs and f.input.measured else ())))
        for f in flights
    ]
    check_declared(noises, state.method.name)
    state = replace(state, problem=posed(state))
    sensors = motion.abilities.sensors.agreement(state.problem, flights)
    if sensors is None or not sensors.significant:
        return replace(state, sensors=sensors)
    corrected = motion.abilities.sensors.corrected(state.prepared, sensors, state.options)
    state = replace(state, prepared=corrected, sensors=sensors)
    return replace(state, problem=posed(state))


def posed(state: FlightState) -> separable.SeparableProblem:
    """Problem of the order that was requested."""
    problem = state.motion.problem(state.flights, state.instruments.rule)
    return problem.with_nuisances(with_order(problem.nuisances, state.options.order))


def estimate_parameters(state: FlightState) -> FlightState:
    """The estimate, and the problem as the motion refines it by estimates."""
    solve, refined = partial(identify, method=state.method), state.motion.abilities.refined
    try:
        problem, estimate = refined(state.problem, solve, state.options, state.flights)
        return replace(state, problem=problem, estimate=estimate)
    except (errors.InstrumentError, errors.CollinearError) as error:
        if state.options.lag is not None and state.lag_prior is None:
            return state  # too few for the lag as well, which is given
        if not state.motion.abilities.whitened or not state.instruments.names:
            raise
        return without_references(state, error)


def without_references(state: FlightState, error: errors.EstimationError) -> FlightState:
    """The estimate by the direct method of the motion, where references are too few for its unknowns."""
    missing = f"{', '.join(state.instruments.names)} alone cannot move all that the equations have"
    no_instruments, method = Instruments(NoInstruments(), missing=missing), by_name("whitened_least_squares")
    state = replace(state, instruments=no_instruments, method=method)
    try:
        return estimate_parameters(replace(state, problem=posed(state)))
    except errors.CollinearError:
        raise error from None


def apply_lag_prior(state: FlightState) -> FlightState:
    """The estimate with prior knowledge of the lag, where there is any."""
    problem, estimate = state.problem, state.estimate
    prior, findings = known_lag(state)
    state = replace(state, lag_prior=prior, findings=findings)
    if prior is not None and not prior.closer_alone:
        unpriored = None if estimate is None else (problem, estimate)
        problem = lag_prior.with_lag_prior(problem, prior.for_the_log)
        state = estimate_parameters(replace(state, problem=problem, without_prior=unpriored))
    return replace(state, prepared=state.motion.abilities.refined_flights(state.prepared, state.problem))


def minimise_output_error(state: FlightState) -> FlightState:
    """The output-error estimate, where it was requested, with the rows at its values."""
    refined = state.motion.abilities.prediction.output_error
    if refined is None or not isinstance(by_name(state.options.method), OutputError):
        return state
    first, problem = state.estimate, state.problem
    result, findings = refined(problem, first, state.flights)
    known = tuple(item.known_at(result.nuisances[item.name]) for item in problem.nuisances)
    start = separable.WarmStart(result.theta, result.nuisances)
    rows = identify(replace(cast("Any", problem), nuisances=known, warm_start=start), state.method.of_flights)
    result = replace(
        result,
        moments=rows.moments,
        problem=rows.problem,
        system=rows.system,
        factor=rows.factor,
        solution=replace(rows.solution, theta=result.theta),
        method=f"{first.method}+{OUTPUT_ERROR}",
    )
    agreement = state.agreement or diagnose(first).over_identification
    if first.assembler.needs_instruments:
        result = replace(result, unrefined=beyond_errors(first, result))
    return replace(state, estimate=result, findings=(*state.findings, *findings), agreement=agreement)


def beyond_errors(first: Estimate, refined: Estimate) -> Float[np.ndarray, " n"]:
    """Shift of the values, shrunk by the share that their errors explain (Efron and Morris 1973)."""
    shift = first.values - refined.values
    variances = sum(np.diag(item.joint_covariance.matrix) for item in (first, refined))
    noise = np.divide(variances, shift**2, out=np.ones_like(shift), where=shift != 0.0)
    return np.asarray(shift * np.maximum(1.0 - noise, 0.0))


def diagnose_fit(state: FlightState) -> FlightState:
    """The fit, with diagnostics of the estimate, of its residual and of the motion."""
    checks = outcome.fit_diagnostics(state.motion.traces(state.problem, state.estimate), state.estimate)
    if state.without_prior is not None:
        # the prior is compared with the estimate without it, not by over-identification
        checks = replace(checks, agreement=diagnose(state.without_prior[1]).over_identification)
    if state.agreement is not None and checks.agreement is not None:
        checks = replace(checks, agreement=state.agreement)
    fit = outcome.Fit(
        state.problem,
        state.estimate,
        state.instruments.rule.label,
        checks,
        state.lag_prior,
        sensors=state.sensors,
        without_prior=state.without_prior,
        motion_checks=state.motion.checks(state.problem, state.estimate, state.flights),
    )
    return replace(state, fit=fit)


def build_confidence_sets(state: FlightState) -> FlightState:
    """Confidence sets of the headline and of lag and delay; of all parameters where instruments are weak."""
    if state.estimate.streamed_covariance is not None:
        return state  # not by the instruments
    linear = [parameter.name for parameter in state.estimate.rows.parameters]
    maker = ProfileSets(state.problem, state.estimate)
    headline = [name for name in state.motion.quantities.headline if name in linear]
    by_parameter = {name: maker.of_parameter(name) for name in headline}
    sums = lag_prior.LAG_SUMS.items()
    lags = {name: maker.of_nuisances(parts) for name, parts in sums if name in state.motion.quantities}
    weak = any(not F >= STRONG_FIRST_STAGE for F in state.fit.checks.first_stage.values())
    if weak or any(item is not None and not item.profile.is_bounded for item in by_parameter.values()):
        by_parameter |= {name: maker.of_parameter(name) for name in linear if name not in by_parameter} | lags
    sets = {name: item for name, item in by_parameter.items() if item is not None}
    profiled = linear if state.motion.abilities.profiled else ()
    lags |= {name: by_parameter.get(name) or maker.of_parameter(name) for name in profiled}
    profiles = {name: item.profile for name, item in lags.items() if item is not None}
    for name in profiled:
        value = state.estimate.parameters[name]
        if name in profiles and not profiles[name].hull[0] <= value <= profiles[name].hull[1]:
            # another solution of the same instruments fits as well
            pieces = (*profiles[name].intervals, state.estimate.interval(name))
            profiles[name] = ConfidenceSet.union(pieces)
    return replace(state, fit=replace(state.fit, sets=sets, profiles=profiles))


def judge(state: FlightState) -> FlightEstimate:
    """The result: quantities with systematic parts and verdicts."""
    result = with_fit(state, state.fit, verdict_inputs(state, state.fit))
    return replace(result, findings=(*result.findings, *state.findings))


STAGES = (
    choose_instruments,
    pose_problem,
    estimate_parameters,
    apply_lag_prior,
    minimise_output_error,
    diagnose_fit,
    build_confidence_sets,
)


def estimated(state: FlightState, progress: Progress = no_stage_callback) -> FlightEstimate:
    """Result of prepared flights: one set of parameters by the `STAGES`, or why there is none."""
    words, flights = state.motion.words, state.flights
    if not flights:
        return without_fit(state, *_unused(state))
    if all(flight.constant_input for flight in flights):
        sentence = "The input is constant: it carries no information about the vehicle."
        return without_fit(state, sentence, words.fly)
    if state.skip_reason:
        return without_fit(state, state.skip_reason, words.fly)
    try:
        for stage in STAGES if state.fit is None else STAGES[STAGES.index(diagnose_fit) + 1 :]:
            if stage is diagnose_fit:
                progress(Stage.DIAGNOSING)
            state = stage(state)
        return judge(state)
    except (errors.EstimationError, errors.TooFewSamplesError) as error:
        return without_fit(state, str(error), "" if isinstance(error, MissingNoiseError) else words.fly)


def known_lag(state: FlightState) -> tuple[LagPrior | None, tuple[Finding, ...]]:
    """Prior knowledge of the lag: the user's, else the most precise measurement of the log."""
    flights, options, problem, unpriored = state.flights, state.options, state.problem, state.estimate
    slack_s = max(flight.command_slack_s for flight in flights)
    if options.lag is not None:
        if not lag_prior.lag_searched(problem):
            received = "one whose actuators' state was measured, or a motion without a lag"
            remedy = "Leave out what is known of the lag, or name the command with --input."
            raise errors.UsageError("a flight whose actuators' lag is searched for", received, remedy)
        if unpriored is None:
            return LagPrior(options.lag, slack_s=slack_s), ()
        strong = bool(np.all(unpriored.first_stage >= STRONG_FIRST_STAGE))
        own_lag = lag_prior.lag_quantities(problem, unpriored)[lag_prior.EFFECTIVE_LAG]
        return LagPrior(options.lag, own_lag, slack_s, strong=strong), ()
    if unpriored is None or not lag_prior.lag_searched(problem):
        return None, ()
    by_telemetry = lag_prior.telemetry_lag(flights, state.motion.channels.telemetry)
    measurements = [item for item in (by_telemetry, *state.lag_measurements()) if item is not None]
    own_lag = lag_prior.lag_quantities(problem, unpriored)[lag_prior.EFFECTIVE_LAG]
    findings: list[Finding] = []
    for item in sorted(measurements, key=lambda entry: entry.std):
        # telemetry follows the logged commands, so that their lateness is in both lags
        result = replace(item, flight_lag=own_lag, slack_s=0.0 if item is by_telemetry else slack_s)
        if result.p_value >= SIGNIFICANT:
            return result, tuple(findings)
        sentence = f"The lag by {item.source} is not used: {result.sentence}."
        findings.append(Finding(f"{item.source}_contradicts", sentence))
    return None, tuple(findings)


def verdict_inputs(state: FlightState, fit: outcome.Fit) -> VerdictInputs:
    """Inputs of a verdict other than the quantities."""
    flights, instruments_used, covariance = state.flights, state.instruments, fit.estimate.covariance
    # share of the variance of each joint parameter that comes from priors
    prior_rows = fit.estimate.prior_rows() @ covariance
    shares = np.clip((prior_rows**2).sum(axis=0) / np.diag(covariance), 0.0, 1.0) if prior_rows.size else ()
    names, constancy = fit.estimate.names, fit.checks.constancy
    sides = () if constancy is None or not constancy.speaks else constancy.sides(fit.estimate.values)
    return VerdictInputs(
        **_of_flights(flights),
        instruments=instruments_used,
        excitation=state.motion.abilities.excitation(flights),
        single_frequency_hz=single_frequency_hz(flights, instruments_used.names),
        checks=fit.motion_checks,
        periodicity=fit.checks.periodicity,
        sides=tuple(dict(zip(names, side.tolist(), strict=True)) for side in sides),
        lag_prior=fit.lag_prior,
        sensors=fit.sensors,
        prior_share=dict(zip(fit.estimate.names, map(float, shares), strict=False)),
    )


def _of_flights(flights: tuple[PreparedFlight, ...]) -> dict[str, Any]:
    """Inputs of a verdict that need no estimate."""
    measured = [[rate for role, rate in f.rates_hz.items() if role != COMMAND] for f in flights]
    return {
        "flights": flights,
        "command_rate_hz": min(flight.rates_hz[COMMAND] for flight in flights),
        "response_rate_hz": min(map(max, measured)),
        "used_s": sum(flight.used_s for flight in flights),
    }


def with_fit(state: FlightState, fit: outcome.Fit, inputs: VerdictInputs) -> FlightEstimate:
    """Result of a fit: quantities with intervals and verdicts."""
    motion, prepared, options = state.motion, state.prepared, state.options
    wording, best = motion.quantities, fit.estimate
    estimates = dict(motion.derive(fit.problem, best))
    if fit.by_sets:
        # those that are judged by confidence sets have the hulls of these as intervals
        hulls = {
            name: replace(estimates[name], interval=fit.reaching(name, estimates[name]))
            for name in fit.by_sets
        }
        estimates |= hulls | _reciprocals(motion, estimates | hulls)
    searched = {
        profile.nuisance.name: (best.nuisances[profile.nuisance.name], float(profile.nuisance.grid[-1]))
        for profile in best.profiles
    }
    inputs = replace(
        inputs,
        order_given=options.order is not None,
        first_stage=fit.checks.first_stage,
        agreement=fit.checks.agreement,
        searched=searched,
        robust=fit.by_sets,
        quantities=estimates,
    )
    parts = systematic_uncertainties(motion.parts, inputs)
    estimates = with_systematic_uncertainties(motion, estimates, parts)
    if fit.lag_prior is not None and lag_prior.EFFECTIVE_LAG in estimates:
        lag = estimates[lag_prior.EFFECTIVE_LAG]
        interval = fit.lag_prior.limited(lag.interval, lag.value)
        estimates |= {lag_prior.EFFECTIVE_LAG: replace(lag, interval=interval)}
    # of a lag at its least, a delay makes up for the rest, whatever the split
    lags = [item.nuisance for item in best.profiles if item.nuisance.name == ACTUATOR_LAG.name]
    unsplit = any(best.nuisances[item.name] <= item.first for item in lags) and DELAY.name in searched
    estimates = lag_prior.limited_by_sum(estimates, unsplit=unsplit)
    by_rules = reasons_by_quantity(motion.rules, replace(inputs, quantities=estimates), wording)
    # reasons of the estimate are each quantity's
    reasons = {name: [*by_rule, *best.reasons] for name, by_rule in by_rules.items()}
    deciding = dict.fromkeys(reason for name in wording.headline for reason in reasons.get(name, ()))
    quantities = {
        name: estimates[name].judged(verdict(reasons[name]), spec)
        for name, spec in wording.items()
        if name in estimates
    }
    numbers = {
        **outcome.flight_diagnostics(prepared),
        **outcome.fit_numbers(fit.checks, best, wording.headline),
        **({} if fit.sensors is None else fit.sensors.numbers),
        **inputs.checks.numbers,
    }
    findings = [*outcome.flight_findings(prepared, motion.words)]
    if best.noises:
        noises = "; ".join(noise.sentence for noise in best.noises)
        findings.append(Finding("fitted_noise", f"Noises that fit what the estimate leaves: {noises}."))
    findings += motion.abilities.findings(prepared, quantities)
    overall = verdict(list(deciding))
    return FlightEstimate(motion, options, prepared, fit, overall, quantities, numbers, tuple(findings))


def _reciprocals(
    motion: Motion[Any], estimates: Mapping[str, QuantityEstimate]
) -> dict[str, QuantityEstimate]:
    return {
        name: lag_prior.reciprocal(estimates[spec.reciprocal_of], spec.unit)
        for name, spec in motion.quantities.items()
        if spec.reciprocal_of in estimates
    }


def with_systematic_uncertainties(
    motion: Motion[Any],
    estimates: Mapping[str, QuantityEstimate],
    parts: Mapping[str, tuple[quantity.SystematicUncertainty, ...]],
) -> dict[str, QuantityEstimate]:
    """Quantities with their systematic parts; reciprocals of a widened headline widen as well."""
    quantities = dict(estimates)
    for name, part in parts.items():
        interval = widened(estimates[name].interval, estimates[name].value, part)
        quantities[name] = replace(estimates[name], interval=interval, systematic_uncertainties=part)
    if any(parts.get(name) for name in motion.quantities.headline):
        quantities |= _reciprocals(motion, quantities)
    return quantities


def without_fit(state: FlightState, sentence: str, remedy: str) -> FlightEstimate:
    """Result of flights that gave no estimate."""
    motion, prepared, numbers = state.motion, state.prepared, outcome.flight_diagnostics(state.prepared)
    quantities = not_estimated(motion)
    if motion.abilities.known is not None and state.flights:
        with suppress(errors.TooFewSamplesError):
            known, checks = motion.abilities.known(state.flights)
            quantities, numbers = quantities | _judged(state, known, checks), numbers | checks.numbers
    own_findings = motion.abilities.findings(prepared, quantities)
    findings = (*outcome.flight_findings(prepared, motion.words), *own_findings)
    refused = verdict([Reason(Status.REFUSED, sentence, remedy)])
    return FlightEstimate(motion, state.options, prepared, None, refused, quantities, numbers, findings)


def not_estimated(motion: Motion[Any]) -> dict[str, Quantity]:
    """Quantities of a flight that gives no estimate."""
    return {
        name: Quantity(quantity.NAN, spec.unit, quantity.NAN, quantity.NO_INTERVAL)
        for name, spec in motion.quantities.items()
        if not spec.optional
    }


def _judged(
    state: FlightState, known: Mapping[str, QuantityEstimate], checks: verdicts.MotionChecks
) -> dict[str, Quantity]:
    """Quantities that are known without an estimate, with their systematic parts and verdicts."""
    motion = state.motion
    facts, no_instruments = _of_flights(state.flights), Instruments(NoInstruments())
    inputs = VerdictInputs(**facts, instruments=no_instruments, checks=checks, quantities=known)
    widened = with_systematic_uncertainties(motion, known, systematic_uncertainties(motion.parts, inputs))
    reasons = reasons_by_quantity(motion.rules, replace(inputs, quantities=widened), motion.quantities)
    return {
        name: item.judged(verdict(list(reasons[name])), motion.quantities[name])
        for name, item in widened.items()
    }


def _unused(state: FlightState) -> tuple[str, str]:
    words, (first, *others) = state.motion.words, state.prepared
    name, never, has_no = "No flight of the pool", "", "has"
    if not others:
        name, never, has_no = first.recording.name, " never", "has no"
    if not any(flight.active.mask.any() for flight in state.prepared):
        return f"{name}{never} {words.begins} (by {first.active.rule}).", words.another_log
    short, remedy = first.shortfall
    short = f"of {first.recording.name}, {short}" if others else short
    return f"{name} {has_no} three seconds {words.where} in runs of a second or more: {short}.", remedy


# -- Lag from rates --

#: Standard deviation of the difference between the delays of the sensors of two motions [s].
SENSORS_APART_S = 0.005
#: Slower states and commands of the other motion determine no lag that is worth an estimate [Hz].
LEAST_STATE_HZ, LEAST_COMMAND_HZ = 90.0, 45.0
#: Instruments weaker than this share of strong ones are not looked at closely: F at coarse lags was .9 of its
#: best, or more, where that was strong (26 flights of three vehicles), and else half of it.
FIRST_STAGE_SHARE = 0.5


def lags_from_rates(
    motions: tuple[Motion[Any], ...],
    log: Recording,
    window: tuple[float, float] | None,
    prepared_states: dict[str, FlightState],
) -> tuple[LagPrior, ...]:
    """Lags that other motions identify, each where its own verdict on the lag is identified."""
    results = (_lag_by(motion, log, FlightOptions(window=window), prepared_states) for motion in motions)
    return tuple(result for result in results if result is not None)


def lag_measured_by(motion: Motion[Any], lag: Quantity) -> LagPrior | None:
    """Lag by the result of a motion; None unless its verdict is identified."""
    if lag.verdict is not Status.IDENTIFIED:
        return None
    return LagPrior.by_measurement(
        motion.name,
        f"{motion.words.title.lower()} (--model {motion.name})",
        QuantityEstimate(lag.value, lag.unit, lag.std_error, lag.interval),
        SENSORS_APART_S,
        "the delays that sensors differ by",
    )


def _lag_by(
    motion: Motion[Any], log: Recording, options: FlightOptions, prepared_states: dict[str, FlightState]
) -> LagPrior | None:
    """Lag by a motion; None where it is not identified."""
    try:
        log = upward(part_to_read(log, options.window))
        rates_hz = dict(motion.select(log, options).rates_hz)
        if rates_hz.pop(COMMAND) < LEAST_COMMAND_HZ or min(rates_hz.values()) < LEAST_STATE_HZ:
            return None
        flight = prepare(log, motion, options)
    except errors.InputError:
        return None
    exogenous = any(reference.usable and reference.exogenous for reference in flight.references)
    state = prepared_states[motion.name] = FlightState(motion, (flight,), options)
    if not flight.runs or not exogenous:
        return None
    first_stage, threshold = _coarse_first_stage(state), FIRST_STAGE_SHARE * STRONG_FIRST_STAGE
    if first_stage.get(ACTUATOR_LAG.name, 0.0) < threshold:
        deciding = [F for name, F in first_stage.items() if motion.quantities[name].need]
        strongest = max(deciding, default=0.0)
        if first_stage and strongest < threshold:
            strength = f"{strongest:.2g}, and {STRONG_FIRST_STAGE:.0f} is needed"
            sentence = (
                f"The instruments are too weak for an estimate: their first-stage F is at most {strength}. "
                f"With --model {motion.name} it is made all the same."
            )
            prepared_states[motion.name] = replace(state, skip_reason=sentence)
        return None
    try:
        for stage in STAGES[: STAGES.index(diagnose_fit) + 1]:
            state = stage(state)
    except (errors.EstimationError, errors.TooFewSamplesError):
        return None
    prepared_states[motion.name] = state
    return lag_measured_by(motion, judge(state).quantities[lag_prior.EFFECTIVE_LAG])


def _coarse_first_stage(state: FlightState) -> dict[str, float]:
    """First-stage F by parameter, of a coarse search: a cheap test of strength."""
    state = choose_instruments(state)
    try:
        problem = posed(state)
        result = identify(problem.with_nuisances(tuple(map(_coarse, problem.nuisances))), state.method)
    except errors.EstimationError:
        return {}
    return dict(zip(result.names, map(float, result.first_stage), strict=True))


def _coarse(nuisance: separable.Nuisance) -> separable.Nuisance:
    """A nuisance on a quarter of its grid without refinement; a delay, which a lag replaces, at one value."""
    if not nuisance.searched:
        return nuisance
    if nuisance.part_of:
        return nuisance.known_at(float(nuisance.grid[(len(nuisance.grid) - 1) // 4]))
    grid = nuisance.grid[::4]
    return replace(nuisance, grid=grid, tolerance=float(grid[-1] - grid[0]))
