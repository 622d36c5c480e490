"""Output error of the rigid body over several steps, with free initial states of every window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares

from eivor.errors import TooFewSamplesError
from eivor.estimation.estimate import Estimate
from eivor.flights.motion import Flights, Starts, starts_of
from eivor.inference.covariance import CovariancePart, JointCovariance
from eivor.models.lagged_runs import ACTUATOR_LAG, ASYMMETRIES, ASYMMETRY, DELAY, LaggedRuns
from eivor.models.separable import Values
from eivor.motions.rigid_body import regression
from eivor.motions.rigid_body.dynamics import turned, vector_part
from eivor.motions.rigid_body.predict import LoggedState, StatePropagator
from eivor.motions.rigid_body.regression import DAMPING, DRAG, GAIN, OFFSET, QUADRATIC_DRAG, THRUST
from eivor.motions.rigid_body.verdict import with_gyroscopic_moments
from eivor.signals.recording import Finding
from eivor.tools import Float, Int

Numbers = Float[np.ndarray, " k"]
Vector = Float[np.ndarray, " n"]
States = Float[np.ndarray, "... 13 starts"]
Jacobian = Float[np.ndarray, "all n"]
Square = Float[np.ndarray, "k k"]

#: Windows begin so far apart, and are looked at so long after their begin [s].
WINDOW_SPACING_S = 0.2
LOOKED_AT_S = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
#: Fewer windows determine nothing.
FEWEST_WINDOWS = 30
#: Windows that begin within so long of each other have residuals that go together [s].
CLUSTER_S = 2.0
#: Standard deviations of measured states that a search begins with, by their units.
FIRST_NOISE = {"m": 0.002, "m/s": 0.02, "rad": 0.005, "rad/s": 0.05}
#: Lags and delays that are possible [s], and how far the clocks of two flights may stand apart.
LAGS_S, DELAYS_S, EARLY_S, OFFSETS_S = (0.001, 0.5), (0.0, 0.2), (-0.1, 0.2), 0.05
#: Times that weights are renewed, and calls of one search.
PASSES, CALLS = 3, 20
#: Tolerance of a search, and of the last one, by which every start ends alike.
TOLERANCE, LAST_TOLERANCE = 1e-4, 1e-8
#: Scale of the difference of two clocks [s].
CLOCK_S = 0.002
#: Parts of a state's difference, [position, velocity, rotation, rates], by unit.
_UNITS = ("m",) * 3 + ("m/s",) * 3 + ("rad",) * 3 + ("rad/s",) * 3
#: Terms that a model always has; the others are selected.
CORE = (*GAIN, *OFFSET, THRUST, *DRAG)
ALWAYS = frozenset(item.name for item in (*CORE, ACTUATOR_LAG, DELAY))
#: Terms that only dissipate energy.
NOT_NEGATIVE = frozenset(item.name for item in (*DAMPING, *DRAG, *QUADRATIC_DRAG))


def difference(states: States, measured: States) -> Float[np.ndarray, "... 12 starts"]:
    """States less measured ones: position, velocity, the small turn between them on body axes, rates."""
    predicted, logged = (np.moveaxis(item[..., 6:10, :], -2, 0) for item in (states, measured))
    size = np.sqrt((predicted**2).sum(axis=0))
    turn = 2.0 * np.sign((logged * predicted).sum(axis=0)) / size * vector_part(logged, predicted)
    turn = np.moveaxis(turn, 0, -2)
    result = states - measured
    return np.concatenate([result[..., :6, :], turn, result[..., 10:, :]], axis=-2)


@dataclass(frozen=True)
class Windows:
    """Windows of one flight, side by side."""

    logged: LoggedState
    rotors: regression.RotorStates
    starts: Starts

    @cached_property
    def outputs(self) -> list[int]:
        """Parts of the difference that were measured."""
        moving = [*self.logged.placed, 3, 4, 5] if self.logged.moves else []
        return [*moving, *((6, 7, 8) if self.logged.turns else ()), 9, 10, 11]

    @cached_property
    def initial(self) -> Float[np.ndarray, "13 1 starts"]:
        """Measured states at the starts, for all models."""
        return self.logged.body[:, None, self.starts.samples]

    def errors(self, models: Sequence[Values]) -> Float[np.ndarray, "models rows starts"]:
        """Errors of models in every output after each time, from the measured states."""
        return self._errors(models, self.initial)

    def by_initial_state(self, model: Values) -> Float[np.ndarray, "rows outputs starts"]:
        """Derivatives of a model's errors by the initial states."""
        step, count = 1e-5, len(self.outputs)
        perturbed = np.repeat(self.initial, count + 1, axis=1)
        for number, part in enumerate(self.outputs):
            if 6 <= part < 9:
                turn = (step * float(part == 6 + axis) for axis in range(3))
                perturbed[6:10, number] = turned(perturbed[6:10, number], *turn)
            else:
                perturbed[part if part < 6 else part + 1, number] += step
        errors = self._errors([model] * (count + 1), perturbed)
        return (errors[:count] - errors[count]).transpose(1, 0, 2) / step

    def _errors(
        self, models: Sequence[Values], initial: Float[np.ndarray, "13 #models starts"]
    ) -> Float[np.ndarray, "models rows starts"]:
        states = StatePropagator(self.logged, self.rotors, models, self.starts).propagate(initial)
        measured = self.logged.body[:, self.starts.ends].transpose(1, 0, 2)
        errors = difference(states, np.broadcast_to(measured, states.shape))[:, :, self.outputs]
        return errors.reshape(len(errors), -1, errors.shape[-1])


#: Inverse roots of the covariances of windows, whose initial states are free within their noise.
Weights = Float[np.ndarray, "starts rows rows"]


def weights_of(
    residual: Float[np.ndarray, "rows starts"],
    by_state: Float[np.ndarray, "rows outputs starts"],
    noise: Float[np.ndarray, " outputs"],
) -> tuple[Weights, Float[np.ndarray, " outputs"]]:
    """Weights from residuals, and the noise of measured states that these imply: one step of EM."""
    by_start = by_state.transpose(2, 0, 1) * noise
    floor = 1e-12 * float((by_start**2).sum(axis=2).max()) + 1e-18  # of a variance, where a log has no noise
    std = np.sqrt((1.4826 * np.median(np.abs(residual), axis=1)) ** 2 + floor)
    for _ in range(3):
        covariance = by_start @ by_start.transpose(0, 2, 1) + np.diag(std**2)
        gain = np.linalg.solve(covariance, by_start).transpose(0, 2, 1)
        state = np.clip((gain @ residual.T[:, :, None])[..., 0], -3.0, 3.0)
        residuals = residual.T - (by_start @ state[..., None])[..., 0]
        posterior = np.eye(noise.size) - gain @ by_start
        state_variance = np.einsum("sri,sij,srj->sr", by_start, posterior, by_start)
        std = np.sqrt(np.median(residuals**2, axis=0) / 0.455 + np.mean(state_variance, axis=0) + floor)
    scale = np.sqrt(np.mean(state**2 + np.diagonal(posterior, axis1=1, axis2=2), axis=0))
    roots = np.linalg.inv(np.linalg.cholesky(covariance))
    return roots, noise * np.clip(scale, 0.3, 3.0)


@dataclass(frozen=True)
class Minimum:
    """A minimum of output errors."""

    structure: Structure
    weights: tuple[Weights, ...]

    def whitened(self, points: Sequence[Vector]) -> Float[np.ndarray, "points all"]:
        """Residuals of variance 1 at points."""
        pairs = zip(self.weights, self.structure.errors(points), strict=True)
        whitened = [np.einsum("sij,...js->...si", roots, errors) for roots, errors in pairs]
        return np.concatenate([item.reshape(len(points), -1) for item in whitened], axis=1)

    @cached_property
    def clusters(self) -> Int[np.ndarray, " all"]:
        """Numbers of the clusters of residuals, of windows of a flight with similar starts."""
        results, count = [], 0
        for windows in self.structure.windows:
            times = windows.starts.samples * windows.starts.step_s
            _, numbers = np.unique((times / CLUSTER_S).astype(np.int64), return_inverse=True)
            results.append(np.repeat(count + numbers, len(windows.outputs) * len(windows.starts.steps)))
            count += int(numbers.max()) + 1
        return np.concatenate(results)

    def linearised(self) -> Linearised:
        """Scores and slopes of every cluster, for all terms."""
        structure = replace(self.structure, free=self.structure.terms)
        points = structure.perturbed(structure.point)
        whitened = replace(self, structure=structure).whitened(points)
        residual, jacobian = whitened[0], structure.derivatives(points, whitened)
        bend = (1.0 + residual**2) ** -0.5  # weight of the loss; its cube is the loss' curvature
        scale = 1.0 / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
        ends = np.flatnonzero(np.diff(self.clusters, append=-1)) + 1
        scores, slopes = [], []
        for cluster in np.split(np.arange(residual.size), ends[:-1]):
            rows = jacobian[cluster] * scale
            scores.append(-rows.T @ (bend[cluster] * residual[cluster]))
            slopes.append((rows * bend[cluster, None] ** 3).T @ rows)
        added = np.zeros_like(slopes[0])
        if structure.clocks.size:  # their mean is the delay
            clocks = np.where(np.arange(scale.size) < len(structure.free), 0.0, scale)
            added = 1e4 * np.outer(clocks, clocks) / float(clocks @ clocks) / len(slopes)
        return Linearised(np.stack(scores), np.stack(slopes) + added, scale)


@dataclass(frozen=True)
class Linearised:
    """Scores and slopes of clusters of windows at a minimum, of scaled parameters."""

    scores: Float[np.ndarray, "clusters n"]
    slopes: Float[np.ndarray, "clusters n n"]
    scale: Vector  # A parameter is its scaled value times this

    def of(self, indices: Int[np.ndarray, " k"]) -> tuple[Numbers, Square]:
        """Newton step of selected parameters, and its covariance by the jackknife over clusters."""
        slopes = self.slopes[:, indices[:, None], indices]
        total, scale = slopes.sum(axis=0), self.scale[indices]
        change = np.linalg.pinv(total, rcond=1e-12, hermitian=True) @ self.scores[:, indices].sum(axis=0)
        residual = self.scores[:, indices] - slopes @ change
        # one Newton step for each omitted cluster, as there are few
        reduced = total - slopes + 1e-10 * np.diag(np.diag(total))
        steps = np.linalg.solve(reduced, residual[..., None])[..., 0]
        return change * scale, (1.0 - 1.0 / len(residual)) * steps.T @ steps * np.outer(scale, scale)


def minimise(start: Structure, *, tolerance: float = TOLERANCE) -> Minimum:
    """The nearest minimum of the whitened errors, with weights from the errors themselves."""
    low, high = start.bounds
    margin = 1e-3 * start.scale
    point = np.clip(start.point, low + margin, high - margin)
    noises = [np.array([FIRST_NOISE[_UNITS[part]] for part in item.outputs]) for item in start.windows]
    for _ in range(PASSES):
        weights = []
        for number, (windows, errors) in enumerate(zip(start.windows, start.errors([point]), strict=True)):
            by_state = windows.by_initial_state(start.models([point], number)[0])
            roots, noises[number] = weights_of(errors[0], by_state, noises[number])
            weights.append(roots)
        best = Minimum(start, tuple(weights))

        def clock_sum(point: Vector) -> Float[np.ndarray, " clocks"]:
            offsets = point[len(start.free) :]
            return np.array([1e4 * offsets.sum()]) if offsets.size else np.empty(0)

        def residual(point: Vector, best: Minimum = best) -> Float[np.ndarray, " all"]:
            return np.append(best.whitened([point])[0], clock_sum(point))

        def jacobian(point: Vector, best: Minimum = best) -> Jacobian:
            points = start.perturbed(point)
            clocks = np.stack([clock_sum(item) for item in points])
            return start.derivatives(points, np.concatenate([best.whitened(points), clocks], axis=1))

        settings = {"bounds": (low, high), "x_scale": start.scale, "loss": "soft_l1", "max_nfev": CALLS}
        point = least_squares(residual, point, jacobian, ftol=tolerance, xtol=0.1 * tolerance, **settings).x
    values = {**start.values, **dict(zip(start.free, point.tolist(), strict=False))}
    return replace(best, structure=replace(start, values=values, clocks=point[len(start.free) :]))


def flight_windows(problem: LaggedRuns, flights: Flights) -> tuple[Windows, ...]:
    """Windows of every flight."""
    rotors = regression.body_equation(problem.columns[0]).rotors
    rotor_states = [replace(rotors, flight=item, signals=item.signals, _last=None) for item in flights]
    windows = tuple(
        Windows(LoggedState(item.flight), item, starts_of(item.flight, LOOKED_AT_S, WINDOW_SPACING_S))
        for item in rotor_states
    )
    count = sum(item.starts.samples.size for item in windows)
    if count < FEWEST_WINDOWS or not all(item.starts.samples.size for item in windows):
        expected = f"{FEWEST_WINDOWS} windows of {LOOKED_AT_S[-1]:g} s or more, and some in every flight"
        raise TooFewSamplesError(expected, f"{count}", "Fly longer without a break, or use another method.")
    return windows


# -- Structure --

#: Squared ratio of a term to its standard error from which Akaike's criterion wants it.
AKAIKE = 2.0
#: Most updates of the free terms.
ROUNDS = 8


@dataclass(frozen=True)
class Structure:
    """Terms that windows can identify, those of them that are free, and the values of all."""

    windows: tuple[Windows, ...]
    terms: tuple[str, ...]
    scales: Mapping[str, float]
    values: Values  # Of everything
    free: tuple[str, ...]
    clocks: Float[np.ndarray, " offsets"]  # Of each flight [s]; a single flight has its delay instead

    @cached_property
    def scale(self) -> Vector:
        """Scales of the free parameters and of the clocks."""
        return np.array([*(self.scales[name] for name in self.free), *[CLOCK_S] * self.clocks.size])

    @cached_property
    def point(self) -> Vector:
        """Values of the free parameters and of the clocks."""
        return np.array([*(self.values[name] for name in self.free), *self.clocks])

    @property
    def measured(self) -> bool:
        """Whether states of the rotors were measured: such states may be early."""
        return all(item.logged.flight.input.measured for item in self.windows)

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        known = {ACTUATOR_LAG.name: LAGS_S, DELAY.name: EARLY_S if self.measured else DELAYS_S}
        known |= dict.fromkeys(NOT_NEGATIVE, (0.0, np.inf))
        known[ASYMMETRY.name] = (float(ASYMMETRIES[0]), float(ASYMMETRIES[1]))
        pairs = [known.get(name, (-np.inf, np.inf)) for name in self.free]
        low, high = np.array([*pairs, *[(-OFFSETS_S, OFFSETS_S)] * self.clocks.size]).T
        return low, high

    def models(self, points: Sequence[Vector], flight: int) -> list[Values]:
        """Every number of the equations at points, in one flight."""
        models = []
        for point in points:
            values = {**self.values, **dict(zip(self.free, point.tolist(), strict=False))}
            if self.clocks.size:
                delay_s = values[DELAY.name] + float(point[len(self.free) + flight])
                values[DELAY.name] = max(delay_s, -np.inf if self.measured else 0.0)
            models.append(values)
        return with_gyroscopic_moments(models)

    def errors(self, points: Sequence[Vector]) -> list[Float[np.ndarray, "points rows starts"]]:
        """Residuals of every window, by flight."""
        return [windows.errors(self.models(points, number)) for number, windows in enumerate(self.windows)]

    def perturbed(self, point: Vector) -> list[Vector]:
        """The point, and it with each entry perturbed by a small share of its scale, within the bounds."""
        steps = np.where(point + 2e-4 * self.scale > self.bounds[1], -1e-4, 1e-4) * self.scale
        return [point, *(point + np.diag(steps))]

    def derivatives(self, points: Sequence[Vector], values: Float[np.ndarray, "points all"]) -> Jacobian:
        """Derivatives of values by finite differences over `perturbed` points."""
        steps = np.array([(point - points[0]).sum() for point in points[1:]])
        return ((values[1:] - values[0]) / steps[:, None]).T

    def step_of(self, model: Linearised, name: str = "") -> tuple[Numbers, Square]:
        """Newton step of the free parameters, of a further one and of clocks, with its covariance."""
        free = [*self.free, *([name] if name else [])]
        clocks = range(len(self.terms), model.scale.size)
        return model.of(np.array([*(self.terms.index(item) for item in free), *clocks]))

    def updated(self, at: Linearised) -> Structure:
        """Structure with terms added by Akaike's criterion, or else without its weakest one."""
        extended = self._extended(at)
        ratios = dict(zip(self.free, self.point**2 / np.diag(self.step_of(at)[1]).clip(1e-300), strict=False))
        weakest = min(ratios, key=lambda name: np.inf if name in ALWAYS else ratios[name])
        if extended.free != self.free or weakest in ALWAYS or ratios[weakest] > AKAIKE:
            return extended
        names = tuple(name for name in self.free if name != weakest)
        return replace(self, free=names, values={**self.values, weakest: 0.0})

    def _extended(self, model: Linearised) -> Structure:
        """Structure with terms added by the criterion, one after the other."""
        index, ratios = len(self.free), {"": 0.0}
        for name in self.terms:
            if name not in self.free:
                change, covariance = self.step_of(model, name)
                negative = name in NOT_NEGATIVE and change[index] < 0.0
                ratios[name] = 0.0 if negative else change[index] ** 2 / max(covariance[index, index], 1e-300)
        best = max(ratios, key=lambda name: ratios[name])
        return self if ratios[best] <= AKAIKE else replace(self, free=(*self.free, best))._extended(model)


def first_structure(estimate: Estimate, windows: tuple[Windows, ...]) -> Structure:
    """Structure with the terms that are always free, at the estimate."""
    names, known = estimate.names, {**estimate.nuisances, **estimate.parameters}
    values = {name: 0.0 if name in names and name not in ALWAYS else value for name, value in known.items()}
    scales = {name: max(estimate.std_error(name), 1e-9) for name in names}
    clocks = np.zeros(len(windows) if len(windows) > 1 else 0)
    full = Structure(windows, names, scales, values, names, clocks)
    errors = full.errors(full.perturbed(full.point))
    effects = sum(np.abs(item[1:] - item[0]).sum(axis=(1, 2)) for item in errors)
    terms = tuple(name for name, size in zip(names, effects, strict=False) if size > 0.0)
    values |= {name: known[name] for name in names if name not in terms}
    return replace(full, terms=terms, values=values, free=tuple(name for name in terms if name in ALWAYS))


def refined_by_output_error(
    problem: LaggedRuns, estimate: Estimate, flights: Flights
) -> tuple[Estimate, tuple[Finding, ...]]:
    """The output-error estimate of multi-step predictions, with findings: see docs/rigid-body.md."""
    minimum = minimise(first_structure(estimate, flight_windows(problem, flights)))
    for _ in range(ROUNDS):
        candidate = minimum.structure.updated(minimum.linearised())
        if candidate.free == minimum.structure.free:
            break
        minimum = minimise(candidate)
    minimum = minimise(minimum.structure, tolerance=LAST_TOLERANCE)
    structure, model, names = minimum.structure, minimum.linearised(), estimate.names
    matrix = np.diag([estimate.std_error(name) ** 2 for name in names])
    rows = np.array([names.index(name) for name in structure.terms])
    # fixed terms may exist: free ones are no better known than with all terms free
    covariance = model.of(np.arange(model.scale.size))[1]
    matrix[rows[:, None], rows] = covariance[: rows.size, : rows.size]
    inverse = np.linalg.pinv(model.slopes.sum(axis=0), rcond=1e-12, hermitian=True)
    shares = np.einsum("ij,cjk,ki->ci", inverse, model.slopes, inverse)
    # clusters of equal shares that would say as much (Carter, Schnepel and Steigerwald 2017)
    clusters = float(np.median(shares.sum(axis=0) ** 2 / (shares**2).sum(axis=0)))
    part = CovariancePart("clustered by windows", matrix, degrees=clusters - 1.0)
    values = structure.values
    theta = np.array([values[name] for name in names[: estimate.theta.size]])
    findings: tuple[Finding, ...] = ()
    if np.abs(structure.clocks).max(initial=0.0) > CLOCK_S:
        spread_words = f"{1e3 * structure.clocks.min():.1f} to {1e3 * structure.clocks.max():.1f} ms"
        text = f"Commands and sensors of the flights stand apart by {spread_words}, which are taken out."
        findings = (Finding("clocks_of_flights", text),)
    result = replace(
        estimate,
        solution=replace(estimate.solution, theta=theta),
        nuisances={name: values[name] for name in estimate.nuisances},
        streamed_covariance=JointCovariance((part,)),
    )
    return result, findings
