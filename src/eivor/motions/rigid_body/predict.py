"""Prediction of the rigid body's state."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from eivor.flights import motion
from eivor.flights.grid import on_grid
from eivor.flights.lag_prior import EFFECTIVE_LAG
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import SimpleModel
from eivor.models.lagged_runs import actuators
from eivor.models.separable import Values
from eivor.motions.equation import UNCHANGED_WORDS, States, Term, parsed
from eivor.motions.rates.motion import AXES
from eivor.motions.rigid_body import compatibility, dynamics, regression
from eivor.motions.rigid_body.dynamics import into_body
from eivor.motions.rigid_body.regression import DRAG, GAIN, TERMS, THRUST, RotorStates, drives
from eivor.motions.rigid_body.vehicle import KnownVehicle, inertia_shares
from eivor.motions.rigid_body.verdict import with_gyroscopic_moments
from eivor.signals.filters import time_derivative
from eivor.signals.recording import GRAVITY
from eivor.tools import Float, Int


@dataclass(frozen=True)
class LoggedState:
    """Position, velocity, attitude and rates on a flight's grid."""

    flight: PreparedFlight

    @cached_property
    def turns(self) -> bool:
        """Whether the attitude is logged."""
        return compatibility.logged(self.flight.recording, dynamics.ATTITUDE)

    @cached_property
    def moves(self) -> bool:
        """Whether velocity and attitude are."""
        return self.turns and compatibility.logged(self.flight.recording, dynamics.VELOCITY)

    @property
    def placed(self) -> tuple[int, ...]:
        """Axes along which the position is logged, from 0."""
        log, names = self.flight.recording, enumerate(dynamics.POSITION)
        return tuple(axis for axis, name in names if compatibility.logged(log, (name,)))

    @cached_property
    def body(self) -> Float[np.ndarray, "13 n"]:
        """The state at every sample."""
        body = np.zeros((dynamics.BODY, self.flight.signals.sample_count))
        body[6] = 1.0
        for axis in self.placed:
            body[axis] = self._channel(dynamics.POSITION[axis])
        if self.moves:
            body[3:6] = [self._channel(name) for name in dynamics.VELOCITY]
        if self.turns:
            body[6:10] = [self._channel(name) for name in dynamics.ATTITUDE]
            length = np.sqrt((body[6:10] ** 2).sum(axis=0))
            body[6:10] /= np.where(length > 0.0, length, 1.0)
        body[10:13] = [self.flight.signals.channel(axis.rate) for axis in AXES]
        return body

    def _channel(self, name: str) -> Float[np.ndarray, " n"]:
        """Values on the grid; NaN without data for channels that the motion did not select."""
        signals = self.flight.signals
        if name in signals.channels:
            return signals.channel(name)
        values, valid = on_grid(self.flight.recording.channel(name), self.flight.grid)
        return np.where(valid, values, np.nan)


def kinematics(
    body: Float[np.ndarray, "13 starts"],
    velocity: Float[np.ndarray, "3 starts"],
    rates: Float[np.ndarray, "3 starts"],
) -> Float[np.ndarray, "13 starts"]:
    """Rate of change of states by accelerations and angular accelerations."""
    w, x, y, z, p, q, r = body[6 : dynamics.BODY]
    attitude = (-(x * p + y * q + z * r), w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p)
    return np.concatenate([body[3:6], velocity, 0.5 * np.stack(attitude), rates])


@dataclass(frozen=True)
class StatePropagator:
    """Rates of change of a body's state at the samples of a flight, by models side by side."""

    logged: LoggedState
    rotors: RotorStates
    models: Sequence[Values]  # Parameters and nuisances of each
    starts: motion.Starts
    turns: tuple[bool, ...] = (True, True, True)  # Axes that the rotors turn
    lifts: bool = True

    def __call__(
        self, body: Float[np.ndarray, "13 states"], samples: Int[np.ndarray, " starts"]
    ) -> Float[np.ndarray, "13 states"]:
        """Rate of change of the states of each model at samples, with the rotors' forces."""
        rows = dynamics.rotation(*body[6:10])
        states = self._states[:, self._timing[:, None], samples].reshape(len(regression.STATES), -1)
        force = self._forces[:, :, samples].reshape(6, -1)
        signals = {**dict(zip(regression.STATES, states, strict=True)), **self._motion_signals(body, rows)}
        for axis, term, values in self._state_terms:
            force[axis] += values * term.expression.evaluate(signals)
        if self._coupling is not None:
            force[:3] = self._coupling(signals, force[:3])
        change = np.zeros_like(body[3:6])
        if self.lifts and self.logged.moves:
            change = np.stack([a * force[3] + b * force[4] + c * force[5] for a, b, c in rows])
            change[2] -= GRAVITY
        return kinematics(body, change, force[:3] * np.array(self.turns)[:, None])

    def propagate(
        self, body: Float[np.ndarray, "13 #models starts"]
    ) -> Float[np.ndarray, "models horizons 13 starts"]:
        """States of each model at the horizons, from its own or common states at the starts."""
        initial_states = np.broadcast_to(body, (dynamics.BODY, len(self.models), body.shape[2]))
        states = self.starts.propagate(initial_states.reshape(dynamics.BODY, -1), self)
        return states.reshape(*states.shape[:2], len(self.models), -1).transpose(2, 0, 1, 3)

    def _motion_signals(self, body: Float[np.ndarray, "13 n"], rows: dynamics.Rows) -> dict[str, Any]:
        """Channels of terms other than rotor states."""
        velocity = np.stack(into_body(rows, *body[3:6])) if self.logged.moves else np.zeros_like(body[3:6])
        values = zip((*regression.MOVED, *regression.RATES), (*velocity, *body[10:13]), strict=True)
        return {**self.rotors.vehicle.numbers, **dict(values), "speed": np.linalg.norm(velocity, axis=0)}

    @cached_property
    def _terms(self) -> list[tuple[int, Term, Float[np.ndarray, " models"]]]:
        """Terms that some model has, by the number of the equation, with their values in each."""
        rows = [(*item, [values.get(item[1].name, 0.0) for values in self.models]) for item in TERMS]
        return [(number, term, np.array(values)) for number, term, values in rows if any(values)]

    @cached_property
    def _state_terms(self) -> list[tuple[int, Term, Float[np.ndarray, " states"]]]:
        """Terms that depend on the state, with their values for every start of every model."""
        count = self.starts.samples.size
        rows = [(number, term, np.repeat(values, count)) for number, term, values in self._terms]
        return [item for item in rows if not drives(item[1].of)]

    @cached_property
    def _coupling(self) -> Callable[[States, np.ndarray], np.ndarray] | None:
        """Function that couples the axes by products of inertia; None of models without."""
        products = np.array([[item.get(p.name, 0.0) for item in self.models] for p in regression.PRODUCT])
        if not products.any():
            return None
        shares = np.array([inertia_shares(item) for item in self.models])
        inverse, count = np.tile(np.eye(3), (len(self.models), 1, 1)), self.starts.samples.size
        for pair, (i, j) in enumerate(regression.PAIRS):
            inverse[:, i, j], inverse[:, j, i] = shares[:, i] * products[pair], shares[:, j] * products[pair]
        coupling, of_starts = np.linalg.inv(inverse), np.repeat(products, count, axis=1)
        scaled = np.repeat(shares.T, count, axis=1)

        def coupled(of: States, force: Float[np.ndarray, "3 states"]) -> Float[np.ndarray, "3 states"]:
            steady = {**of, **dict.fromkeys(regression.TURNED, np.zeros(1))}
            for axis, texts in enumerate(regression.BY_PRODUCT):
                pairs = zip(of_starts, texts, strict=True)
                force[axis] += scaled[axis] * sum(item * parsed(of).evaluate(steady) for item, of in pairs)
            split = force.reshape(3, len(coupling), count)
            return np.einsum("mij,jms->ims", coupling, split).reshape(force.shape)

        return coupled

    @cached_property
    def _nodes(self) -> list[tuple[tuple[str, float], ...]]:
        return list(dict.fromkeys(tuple(actuators(item).items()) for item in self.models))

    @cached_property
    def _timing(self) -> Int[np.ndarray, " models"]:
        return np.array([self._nodes.index(tuple(actuators(item).items())) for item in self.models])

    @cached_property
    def _rotors(self) -> list[tuple[States, States]]:
        """Rotor states at samples, and with thrusts as means over steps."""
        return [self.rotors.at(dict(path)) for path in self._nodes]

    @cached_property
    def _states(self) -> Float[np.ndarray, "7 pairs n"]:
        sums = [np.stack([item[name] for name in regression.STATES]) for item, _ in self._rotors]
        return np.stack([self.starts.over_step(item) for item in sums], axis=1)

    @cached_property
    def _forces(self) -> Float[np.ndarray, "6 models n"]:
        """Mean force of the rotors on each axis over each step, with the trims of the runs."""
        flight, body = self.logged.flight, self.logged.body
        rows, step_s = dynamics.rotation(*body[6:10]), flight.signals.step_s
        change = [time_derivative(entry, step_s) for entry in body[10:13]]
        if self.logged.moves:
            change.extend(dynamics.felt(rows, body[3:6], step_s))
        trims = [motion.trim(flight, axis) for axis in change]
        results = np.zeros((6, len(self.models), body.shape[1]))
        results[: len(trims)] = np.array(trims)[:, None]
        moving = self._motion_signals(body, rows)
        for node, pair in enumerate(self._rotors):
            models = np.flatnonzero(self._timing == node)
            for number, term, of_models in self._terms:
                values, by_rotors = of_models[models, None], drives(term.of)
                if values.any() and number < len(trims):
                    column = term.expression.evaluate({**moving, **pair[by_rotors]})
                    driven = self.starts.over_steps(column) if by_rotors else 0.0
                    results[number, models] += values * (driven - motion.trim(flight, column))
        return results


#: Terms without which a prediction is a little worse; one that the fit refuses counts as zero.
SMALL = {term.name for _, term in TERMS} - {item.name for item in (*GAIN, regression.REACTION, THRUST)}
#: Drag by whose verdict the quadratic one of its axis goes: the two are identified well together, or neither.
WITH_DRAG = {item.name: drag.name for item, drag in zip(regression.QUADRATIC_DRAG, DRAG, strict=True)}
#: What is predicted: its parts of the state, and its unit.
RATES = {f"{axis} rate": ([10 + number], "rad/s") for number, axis in enumerate(regression.TURNING)}
BEYOND = {"attitude": ([6, 7, 8, 9], "rad"), "velocity": ([3, 4, 5], "m/s"), "position": ([0, 1, 2], "m")}
PREDICTED = RATES | BEYOND


def why_omitted(identified: Set[str], logged: Sequence[LoggedState], placed: list[int]) -> dict[str, str]:
    """Reason for each quantity that cannot be predicted."""
    if EFFECTIVE_LAG not in identified:
        return dict.fromkeys(PREDICTED, "the fit does not identify the lag")
    gains = zip(RATES, regression.TURNING, GAIN, strict=True)
    results = {
        rate: f"the fit does not identify the {axis} gain"
        for rate, axis, gain in gains
        if gain.name not in identified
    }
    moves = all(item.moves for item in logged), "velocity or attitude is not logged"
    needs = {
        "attitude": [(all(item.turns for item in logged), "no attitude is logged")],
        "velocity": [moves],
        "position": [moves, (bool(placed), "no position is logged")],
    }
    for quantity, logs in needs.items():
        reasons = [words for known, words in logs if not known]
        # where only yaw stays, the force still points very nearly where it does
        rates = [*RATES] if quantity == "attitude" else [*RATES][:2]
        reasons += [results[rate] for rate in rates if rate in results]
        if quantity != "attitude" and THRUST.name not in identified:
            reasons.append("the fit does not identify the thrust gain")
        if reasons:
            results[quantity] = reasons[0]
    return results


def rigid_body_prediction(
    flights: tuple[PreparedFlight, ...],
    vehicle: KnownVehicle,
    models: Mapping[str, SimpleModel],
    refused: frozenset[str],
) -> motion.MultiStepPrediction:
    """The state after each horizon, by each model and by rates and velocity at the start."""
    model_values = with_gyroscopic_moments([model.values for model in models.values()])
    values, logged = model_values[0], [LoggedState(flight) for flight in flights]
    identified = {*values, EFFECTIVE_LAG} - refused
    turns = tuple(item.name in identified for item in GAIN)
    placed = [axis for axis in range(3) if all(axis in item.placed for item in logged)]
    omitted = why_omitted(identified, logged, placed)
    zeros = [name for name in regression.QUANTITIES if name in SMALL and WITH_DRAG.get(name, name) in refused]
    model_values[0] = {name: value for name, value in values.items() if name not in zeros}

    def errors(number: int, starts: motion.Starts) -> Iterator[motion.HorizonErrors]:
        if len(omitted) == len(PREDICTED) or not starts.samples.size:
            return
        flight, body, thrust = flights[number], logged[number].body, THRUST.name in identified
        hover = regression.hover_state(flight, vehicle, model_values[0].get(THRUST.name, 0.0))
        hover_usual = hover or regression.usual_state((flight,))
        rotors = RotorStates(flight, vehicle, hover_usual, flight.signals)
        initial, measured = body[:, starts.samples], body[:, starts.ends].transpose(1, 0, 2)
        propagator = StatePropagator(logged[number], rotors, model_values, starts, turns, thrust)
        states = dict(zip(models, propagator.propagate(initial[:, None]), strict=True))
        zeros_3 = np.zeros((3, starts.samples.size))
        states[motion.UNCHANGED] = starts.propagate(initial, lambda now, _: kinematics(now, zeros_3, zeros_3))

        def error(model: str, quantity: str) -> motion.HorizonErrors:
            """Errors of a quantity, of position along the axes on which it is logged."""
            parts, unit = PREDICTED[quantity]
            parts = placed if quantity == "position" else parts
            pair = measured, states[model]
            series = np.stack([item[-1, parts[0]] for item in pair], axis=1) if quantity in RATES else None
            changes = [_distance(quantity, item[-1:, parts], initial[None, parts])[0] for item in pair]
            label = "height" if quantity == "position" and placed == [2] else quantity
            sizes = _distance(quantity, states[model][:, parts], measured[:, parts]).T
            words = models[model].words if model in models else UNCHANGED_WORDS
            return motion.HorizonErrors(model, words, label, unit, sizes, np.stack(changes, axis=1), series)

        for quantity in (name for name in PREDICTED if name not in omitted):
            yield from (error(model, quantity) for model in states)

    by_reason: dict[str, list[str]] = {}
    for quantity, reason in omitted.items():
        by_reason.setdefault(reason, []).append(quantity)
    sentences = [f"Not predicted: {', '.join(names)}, since {reason}." for reason, names in by_reason.items()]
    zero = [name.replace("_", " ") for name in zeros if name in values]
    if zero and len(omitted) < len(PREDICTED):
        sentences.append(f"Counted as zero, since the fit does not identify it: {', '.join(zero)}.")
    return motion.multi_step_predictions(flights, errors, tuple(sentences))


def _distance(
    quantity: str,
    first: Float[np.ndarray, "horizons k starts"],
    second: Float[np.ndarray, "horizons k starts"],
) -> Float[np.ndarray, "horizons starts"]:
    """Size of the difference: of attitudes, the first of any length, the angle of the turn between them."""
    if quantity != "attitude":
        return np.asarray(np.sqrt(((first - second) ** 2).sum(axis=1)))
    first = first / np.sqrt((first**2).sum(axis=1, keepdims=True))
    direct, opposite = (np.sqrt((item**2).sum(axis=1)) for item in (first - second, first + second))
    distance = np.minimum(direct, opposite)  # an attitude and its negative are one
    return np.asarray(4.0 * np.arcsin(np.minimum(0.5 * distance, 1.0)))
