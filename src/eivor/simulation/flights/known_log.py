"""Logs of simulated motion beside what is true of them, as `eivor simulate` writes both."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version

import numpy as np

from eivor.errors import ParameterError, UsageError
from eivor.motions.vertical.model import GRAVITY
from eivor.signals.canonical import held_by_default, unit_of
from eivor.signals.recording import Channel, Recording
from eivor.simulation.flights.vertical_flight import simulate_vertical_flights
from eivor.simulation.flights.vertical_flight_spec import STEP_S, VerticalFlightSpec
from eivor.simulation.records.scenario import Scenario, SimulatedRecord
from eivor.simulation.records.simulate import simulate

SCHEMA = "eivor.simulate/1"


@dataclass(frozen=True)
class KnownLog:
    """A log and its truth.

    Parameters
    ----------
    recording : Recording
        As it would be logged.
    rate_hz : float
        Its rate [Hz].
    samples : int
        Its length.
    truth : mapping of str to object
        Parameters, their units and what was added to the channels, as a JSON document.
    """

    recording: Recording
    rate_hz: float
    samples: int
    truth: dict[str, object]


def log_about_hover(scenario: Scenario, seed: int, *, hover: bool = False) -> KnownLog:
    """Log of a scenario.

    Parameters
    ----------
    scenario : Scenario
        What is simulated; its input is a deviation from hover.
    seed : int
        Of all randomness.
    hover : bool
        Add the input that carries the weight, g / K_u, so that the log has the whole input.

    Raises
    ------
    UsageError
        When no input carries the weight.
    ParameterError
        When the scenario cannot be simulated at its rate and length.
    """
    record = simulate(scenario, np.random.default_rng(seed))
    hover_input = _hover_input(scenario) if hover else 0.0
    truth = _truth(scenario, record) | {"hover_input": hover_input, "seed": seed}
    return KnownLog(_recording(record, hover_input), scenario.rate_hz, scenario.samples, truth)


def log_of_flight(spec: VerticalFlightSpec) -> KnownLog:
    """Log of a flight.

    Parameters
    ----------
    spec : VerticalFlightSpec
        The flight.

    Raises
    ------
    ParameterError
        When the vehicle is lost.
    """
    (log,) = logs_of_flights([spec])
    return log


def logs_of_flights(specs: Sequence[VerticalFlightSpec]) -> Iterator[KnownLog]:
    """Logs of flights of one duration, in order; many are flown side by side.

    Parameters
    ----------
    specs : sequence of VerticalFlightSpec
        The flights.

    Raises
    ------
    ParameterError
        When a vehicle is lost.
    UsageError
        When the durations differ.
    """
    for spec, flight in zip(specs, simulate_vertical_flights(specs), strict=True):
        if not flight.flew:
            raise ParameterError(
                "a flight that follows its reference within 5 m",
                f"one that is lost with the seed {spec.seed}",
                "Make the gusts weaker, or the trajectory less vigorous.",
            )
        # Without its input map, which is the rotors' own default: so a CSV can keep all that there is.
        recording = replace(flight.recording, input_map="")
        yield KnownLog(recording, 1.0 / STEP_S, spec.count, _flight_truth(spec))


def _hover_input(scenario: Scenario) -> float:
    """Input whose effect is the weight's."""
    if scenario.input_gain <= 0.0:
        raise UsageError(
            "an input_gain above zero with --hover", f"{scenario.input_gain}", "Leave --hover out."
        )
    return GRAVITY / scenario.input_gain


def _recording(record: SimulatedRecord, hover_input: float) -> Recording:
    """Recording of the measured channels."""
    signals = record.signals
    time_s = np.arange(signals.sample_count) * signals.step_s
    channels = {}
    for key, values in signals.channels.items():
        logged = values + hover_input if key == "input" else values
        channels[key] = Channel(
            key, time_s, logged, unit_of(key), source="simulation", held=held_by_default(key)
        )
    return Recording(name="simulation", format="simulation", channels=channels)


def _truth(scenario: Scenario, record: SimulatedRecord) -> dict[str, object]:
    noises = {
        name: {"std": noise.std, "order": getattr(noise, "order", 0.0)}
        for name, noise in record.signals.noise.items()
    }
    return {
        "schema": SCHEMA,
        **record.parameters,
        "units": {"viscous_friction": "1/s", "input_gain": "m/s^2 per unit of input"},
        "noise": noises,
        "disturbance": {
            "route": scenario.route.value,
            "std": float(record.truth.channels["disturbance"].std()),
        },
        "rate_hz": scenario.rate_hz,
        "samples": scenario.samples,
        "provenance": {"version": version("eivor")},
    }


def _flight_truth(spec: VerticalFlightSpec) -> dict[str, object]:
    levels = ("acceleration", "velocity", "position", "attitude")
    return {
        "schema": SCHEMA,
        "viscous_friction": spec.viscous_friction,
        "input_gain": spec.input_gain,
        "actuator_lag": spec.actuator_lag,
        "delay": spec.delay,
        "hover_input": spec.hover_input,
        "units": {
            "viscous_friction": "1/s",
            "input_gain": "m/s^2 per squared share of full command",
            "actuator_lag": "s",
            "delay": "s",
            "hover_input": "share of full command",
            "gain_changes_at": "s",
            "gain_changes_over": "s",
        },
        "noise": {"kind": str(spec.noise.kind)} | {name: getattr(spec.noise, name) for name in levels},
        "gust_rms": spec.gust_rms,
        "gain_after": spec.gain_after,
        "gain_changes_at": spec.gain_changes_at,
        "gain_changes_over": spec.gain_changes_over,
        "trajectory": str(spec.trajectory),
        "rate_hz": 1.0 / STEP_S,
        "samples": spec.count,
        "seed": spec.seed,
        "provenance": {"version": version("eivor")},
    }
