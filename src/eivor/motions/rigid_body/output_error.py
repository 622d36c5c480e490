"""Output error of the rigid body: what several steps leave, with free initial states of every window."""

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
BETWEEN_WINDOWS_S = 0.2
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
#: Terms that a model always has; each of the others must earn its place.
CORE = (*GAIN, *OFFSET, THRUST, *DRAG)
ALWAYS = frozenset(item.name for item in (*CORE, ACTUATOR_LAG, DELAY))
#: What only takes energy out.
NOT_NEGATIVE = frozenset(item.name for item in (*DAMPING, *DRAG, *QUADRATIC_DRAG))


def difference(states: States, measured: States) -> Float[np.ndarray, "... 12 starts"]:
    """States less measured ones: position, velocity, the small turn between them on body axes, rates."""
    after, before = (np.moveaxis(item[..., 6:10, :], -2, 0) for item in (states, measured))
    size = np.sqrt((after**2).sum(axis=0))
    turn = 2.0 * np.sign((before * after).sum(axis=0)) / size * vector_part(before, after)
    turn = np.moveaxis(turn, 0, -2)
    left = states - measured
    return np.concatenate([left[..., :6, :], turn, left[..., 10:, :]], axis=-2)


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

    def left(self, models: Sequence[Values]) -> Float[np.ndarray, "models rows starts"]:
        """What models leave of every output after each time, from the measured states."""
        return self._compared(models, self.initial)

    def by_initial_state(self, model: Values) -> Float[np.ndarray, "rows outputs starts"]:
        """Derivatives of what a model leaves by the initial states."""
        step, count = 1e-5, len(self.outputs)
        moved = np.repeat(self.initial, count + 1, axis=1)
        for number, part in enumerate(self.outputs):
            if 6 <= part < 9:
                turn = (step * float(part == 6 + axis) for axis in range(3))
                moved[6:10, number] = turned(moved[6:10, number], *turn)
            else:
                moved[part if part < 6 else part + 1, number] += step
        left = self._compared([model] * (count + 1), moved)
        return (left[:count] - left[count]).transpose(1, 0, 2) / step

    def _compared(
        self, models: Sequence[Values], initial: Float[np.ndarray, "13 #models starts"]
    ) -> Float[np.ndarray, "models rows starts"]:
        states = StatePropagator(self.logged, self.rotors, models, self.starts).propagate(initial)
        measured = self.logged.body[:, self.starts.ends].transpose(1, 0, 2)
        left = difference(states, np.broadcast_to(measured, states.shape))[:, :, self.outputs]
        return left.reshape(len(left), -1, left.shape[-1])


#: Inverse roots of the covariances of windows, whose initial states are free within their noise.
Weights = Float[np.ndarray, "starts rows rows"]


def weights_of(
    residual: Float[np.ndarray, "rows starts"],
    by_state: Float[np.ndarray, "rows outputs starts"],
    noise: Float[np.ndarray, " outputs"],
) -> tuple[Weights, Float[np.ndarray, " outputs"]]:
    """Weights from what is left, and the noise of measured states that this implies: one step of EM."""
    by_start = by_state.transpose(2, 0, 1) * noise
    least = 1e-12 * float((by_start**2).sum(axis=2).max()) + 1e-18  # of a variance, where a log has no noise
    spread = np.sqrt((1.4826 * np.median(np.abs(residual), axis=1)) ** 2 + least)
    for _ in range(3):
        covariance = by_start @ by_start.transpose(0, 2, 1) + np.diag(spread**2)
        gain = np.linalg.solve(covariance, by_start).transpose(0, 2, 1)
        state = np.clip((gain @ residual.T[:, :, None])[..., 0], -3.0, 3.0)
        left = residual.T - (by_start @ state[..., None])[..., 0]
        kept = np.eye(noise.size) - gain @ by_start
        unsure = np.einsum("sri,sij,srj->sr", by_start, kept, by_start)
        spread = np.sqrt(np.median(left**2, axis=0) / 0.455 + np.mean(unsure, axis=0) + least)
    scale = np.sqrt(np.mean(state**2 + np.diagonal(kept, axis1=1, axis2=2), axis=0))
    roots = np.linalg.inv(np.linalg.cholesky(covariance))
    return roots, noise * np.clip(scale, 0.3, 3.0)


@dataclass(frozen=True)
class Minimum:
    """A minimum of output errors."""

    structure: Structure
    weights: tuple[Weights, ...]

    def whitened(self, points: Sequence[Vector]) -> Float[np.ndarray, "points all"]:
        """Residuals of variance 1 at points."""
        pairs = zip(self.weights, self.structure.left(points), strict=True)
        whitened = [np.einsum("sij,...js->...si", roots, left) for roots, left in pairs]
        return np.concatenate([item.reshape(len(points), -1) for item in whitened], axis=1)

    @cached_property
    def clusters(self) -> Int[np.ndarray, " all"]:
        """Which windows go together: those of a flight that begin at nearly one time."""
        results, count = [], 0
        for windows in self.structure.windows:
            times = windows.starts.samples * windows.starts.step_s
            _, numbers = np.unique((times / CLUSTER_S).astype(np.int64), return_inverse=True)
            results.append(np.repeat(count + numbers, len(windows.outputs) * len(windows.starts.steps)))
            count += int(numbers.max()) + 1
        return np.concatenate(results)

    def linearised(self) -> Linearised:
        """Scores and slopes of every cluster, by all that is seen."""
        structure = replace(self.structure, kept=self.structure.seen)
        points = structure.moved(structure.point)
        whitened = replace(self, structure=structure).whitened(points)
        residual, jacobian = whitened[0], structure.derivatives(points, whitened)
        bend = (1.0 + residual**2) ** -0.5  # weight that the loss leaves; its cube is the loss' curvature
        scale = 1.0 / np.maximum(np.linalg.norm(jacobian, axis=0), 1e-300)
        ends = np.flatnonzero(np.diff(self.clusters, append=-1)) + 1
        scores, slopes = [], []
        for cluster in np.split(np.arange(residual.size), ends[:-1]):
            rows = jacobian[cluster] * scale
            scores.append(-rows.T @ (bend[cluster] * residual[cluster]))
            slopes.append((rows * bend[cluster, None] ** 3).T @ rows)
        added = np.zeros_like(slopes[0])
        if structure.clocks.size:  # their mean is the delay
            clocks = np.where(np.arange(scale.size) < len(structure.kept), 0.0, scale)
            added = 1e4 * np.outer(clocks, clocks) / float(clocks @ clocks) / len(slopes)
        return Linearised(np.stack(scores), np.stack(slopes) + added, scale)


@dataclass(frozen=True)
class Linearised:
    """Scores and slopes of clusters of windows at a minimum, of scaled parameters."""

    scores: Float[np.ndarray, "clusters n"]
    slopes: Float[np.ndarray, "clusters n n"]
    scale: Vector  # A parameter is its scaled value times this

    def of(self, kept: Int[np.ndarray, " k"]) -> tuple[Numbers, Square]:
        """Changes of the parameters that are kept, and their covariance: clusters are left out in turn."""
        slopes = self.slopes[:, kept[:, None], kept]
        total, scale = slopes.sum(axis=0), self.scale[kept]
        change = np.linalg.pinv(total, rcond=1e-12, hermitian=True) @ self.scores[:, kept].sum(axis=0)
        left = self.scores[:, kept] - slopes @ change
        # one Newton step each, as there are few of them
        others = total - slopes + 1e-10 * np.diag(np.diag(total))
        steps = np.linalg.solve(others, left[..., None])[..., 0]
        return change * scale, (1.0 - 1.0 / len(left)) * steps.T @ steps * np.outer(scale, scale)


def minimised(start: Structure, *, tolerance: float = TOLERANCE) -> Minimum:
    """The nearest minimum of the whitened errors, with weights from the errors themselves."""
    low, high = start.bounds
    margin = 1e-3 * start.scale
    point = np.clip(start.point, low + margin, high - margin)
    noises = [np.array([FIRST_NOISE[_UNITS[part]] for part in item.outputs]) for item in start.windows]
    for _ in range(PASSES):
        made = []
        for number, (windows, left) in enumerate(zip(start.windows, start.left([point]), strict=True)):
            by_state = windows.by_initial_state(start.models([point], number)[0])
            roots, noises[number] = weights_of(left[0], by_state, noises[number])
            made.append(roots)
        best = Minimum(start, tuple(made))

        def together(point: Vector) -> Float[np.ndarray, " clocks"]:
            offsets = point[len(start.kept) :]
            return np.array([1e4 * offsets.sum()]) if offsets.size else np.empty(0)

        def residual(point: Vector, best: Minimum = best) -> Float[np.ndarray, " all"]:
            return np.append(best.whitened([point])[0], together(point))

        def jacobian(point: Vector, best: Minimum = best) -> Jacobian:
            points = start.moved(point)
            clocks = np.stack([together(item) for item in points])
            return start.derivatives(points, np.concatenate([best.whitened(points), clocks], axis=1))

        kept = {"bounds": (low, high), "x_scale": start.scale, "loss": "soft_l1", "max_nfev": CALLS}
        point = least_squares(residual, point, jacobian, ftol=tolerance, xtol=0.1 * tolerance, **kept).x
    values = {**start.values, **dict(zip(start.kept, point.tolist(), strict=False))}
    return replace(best, structure=replace(start, values=values, clocks=point[len(start.kept) :]))


def flight_windows(problem: LaggedRuns, flights: Flights) -> tuple[Windows, ...]:
    """Windows of every flight."""
    rotors = regression.body_equation(problem.columns[0]).rotors
    each = [replace(rotors, flight=item, signals=item.signals, _last=None) for item in flights]
    made = tuple(
        Windows(LoggedState(item.flight), item, starts_of(item.flight, LOOKED_AT_S, BETWEEN_WINDOWS_S))
        for item in each
    )
    count = sum(item.starts.samples.size for item in made)
    if count < FEWEST_WINDOWS or not all(item.starts.samples.size for item in made):
        expected = f"{FEWEST_WINDOWS} windows of {LOOKED_AT_S[-1]:g} s or more, and some in every flight"
        raise TooFewSamplesError(expected, f"{count}", "Fly longer without a break, or use another method.")
    return made


# -- Structure --

#: Squared ratio of a term to its standard error from which Akaike's criterion wants it.
AKAIKE = 2.0
#: Times that terms are chosen at most, each with what was chosen before.
ROUNDS = 8


@dataclass(frozen=True)
class Structure:
    """Terms of the equations that windows see, those of them that are kept and free, and every value."""

    windows: tuple[Windows, ...]
    seen: tuple[str, ...]
    scales: Mapping[str, float]
    values: Values  # Of everything
    kept: tuple[str, ...]
    clocks: Float[np.ndarray, " offsets"]  # Of each flight [s]; one alone has its delay for that

    @cached_property
    def scale(self) -> Vector:
        """Of parameters that are kept, and of clocks."""
        return np.array([*(self.scales[name] for name in self.kept), *[CLOCK_S] * self.clocks.size])

    @cached_property
    def point(self) -> Vector:
        """Values of the same."""
        return np.array([*(self.values[name] for name in self.kept), *self.clocks])

    @property
    def measured(self) -> bool:
        """Whether states of the rotors were measured: such states may be early."""
        return all(item.logged.flight.input.measured for item in self.windows)

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        known = {ACTUATOR_LAG.name: LAGS_S, DELAY.name: EARLY_S if self.measured else DELAYS_S}
        known |= dict.fromkeys(NOT_NEGATIVE, (0.0, np.inf))
        known[ASYMMETRY.name] = (float(ASYMMETRIES[0]), float(ASYMMETRIES[1]))
        pairs = [known.get(name, (-np.inf, np.inf)) for name in self.kept]
        low, high = np.array([*pairs, *[(-OFFSETS_S, OFFSETS_S)] * self.clocks.size]).T
        return low, high

    def models(self, points: Sequence[Vector], flight: int) -> list[Values]:
        """Every number of the equations at points, in one flight."""
        models = []
        for point in points:
            values = {**self.values, **dict(zip(self.kept, point.tolist(), strict=False))}
            if self.clocks.size:
                delay_s = values[DELAY.name] + float(point[len(self.kept) + flight])
                values[DELAY.name] = max(delay_s, -np.inf if self.measured else 0.0)
            models.append(values)
        return with_gyroscopic_moments(models)

    def left(self, points: Sequence[Vector]) -> list[Float[np.ndarray, "points rows starts"]]:
        """What each flight's windows leave."""
        return [windows.left(self.models(points, number)) for number, windows in enumerate(self.windows)]

    def moved(self, point: Vector) -> list[Vector]:
        """The point, and it with each entry moved by a small share of its scale, inside of the bounds."""
        away = np.where(point + 2e-4 * self.scale > self.bounds[1], -1e-4, 1e-4) * self.scale
        return [point, *(point + np.diag(away))]

    def derivatives(self, points: Sequence[Vector], values: Float[np.ndarray, "points all"]) -> Jacobian:
        """Slopes of values between `moved` points; parameters enter the equations linearly."""
        away = np.array([(point - points[0]).sum() for point in points[1:]])
        return ((values[1:] - values[0]) / away[:, None]).T

    def alone(self, at: Linearised, name: str = "") -> tuple[Numbers, Square]:
        """Changes of what is kept with a name last, before the clocks; and their covariance."""
        free = [*self.kept, *([name] if name else [])]
        clocks = range(len(self.seen), at.scale.size)
        return at.of(np.array([*(self.seen.index(item) for item in free), *clocks]))

    def chosen(self, at: Linearised) -> Structure:
        """With the terms that Akaike's criterion wants as well, or without the least that it does not."""
        wider = self._wider(at)
        wanted = dict(zip(self.kept, self.point**2 / np.diag(self.alone(at)[1]).clip(1e-300), strict=False))
        least = min(wanted, key=lambda name: np.inf if name in ALWAYS else wanted[name])
        if wider.kept != self.kept or least in ALWAYS or wanted[least] > AKAIKE:
            return wider
        kept = tuple(name for name in self.kept if name != least)
        return replace(self, kept=kept, values={**self.values, least: 0.0})

    def _wider(self, at: Linearised) -> Structure:
        """With the terms that it wants as well, one after the other."""
        index, ratios = len(self.kept), {"": 0.0}
        for name in self.seen:
            if name not in self.kept:
                change, covariance = self.alone(at, name)
                wrong = name in NOT_NEGATIVE and change[index] < 0.0
                ratios[name] = 0.0 if wrong else change[index] ** 2 / max(covariance[index, index], 1e-300)
        best = max(ratios, key=lambda name: ratios[name])
        return self if ratios[best] <= AKAIKE else replace(self, kept=(*self.kept, best))._wider(at)


def first_structure(estimate: Estimate, windows: tuple[Windows, ...]) -> Structure:
    """The core of the equations at the estimate."""
    names, given = estimate.names, {**estimate.nuisances, **estimate.parameters}
    values = {name: 0.0 if name in names and name not in ALWAYS else value for name, value in given.items()}
    scales = {name: max(estimate.std_error(name), 1e-9) for name in names}
    clocks = np.zeros(len(windows) if len(windows) > 1 else 0)
    of_all = Structure(windows, names, scales, values, names, clocks)
    left = of_all.left(of_all.moved(of_all.point))
    answer = sum(np.abs(item[1:] - item[0]).sum(axis=(1, 2)) for item in left)
    seen = tuple(name for name, size in zip(names, answer, strict=False) if size > 0.0)
    values |= {name: given[name] for name in names if name not in seen}
    return replace(of_all, seen=seen, values=values, kept=tuple(name for name in seen if name in ALWAYS))


def refined_by_output_error(
    problem: LaggedRuns, estimate: Estimate, flights: Flights
) -> tuple[Estimate, tuple[Finding, ...]]:
    """The estimate whose multi-step predictions leave least, and what stands out: see docs/rigid-body.md."""
    minimum = minimised(first_structure(estimate, flight_windows(problem, flights)))
    for _ in range(ROUNDS):
        other = minimum.structure.chosen(minimum.linearised())
        if other.kept == minimum.structure.kept:
            break
        minimum = minimised(other)
    minimum = minimised(minimum.structure, tolerance=LAST_TOLERANCE)
    structure, at, names = minimum.structure, minimum.linearised(), estimate.names
    matrix = np.diag([estimate.std_error(name) ** 2 for name in names])
    places = np.array([names.index(name) for name in structure.seen])
    # terms that are left out may be there: what is kept is no better known than beside all that is seen
    covariance = at.of(np.arange(at.scale.size))[1]
    matrix[places[:, None], places] = covariance[: places.size, : places.size]
    inverse = np.linalg.pinv(at.slopes.sum(axis=0), rcond=1e-12, hermitian=True)
    shares = np.einsum("ij,cjk,ki->ci", inverse, at.slopes, inverse)
    # clusters of equal shares that would say as much (Carter, Schnepel and Steigerwald 2017)
    clusters = float(np.median(shares.sum(axis=0) ** 2 / (shares**2).sum(axis=0)))
    part = CovariancePart("clustered by windows", matrix, degrees=clusters - 1.0)
    values = structure.values
    theta = np.array([values[name] for name in names[: estimate.theta.size]])
    findings: tuple[Finding, ...] = ()
    if np.abs(structure.clocks).max(initial=0.0) > CLOCK_S:
        apart = f"{1e3 * structure.clocks.min():.1f} to {1e3 * structure.clocks.max():.1f} ms"
        text = f"Commands and sensors of the flights stand apart by {apart}, which are taken out."
        findings = (Finding("clocks_of_flights", text),)
    result = replace(
        estimate,
        solution=replace(estimate.solution, theta=theta),
        nuisances={name: values[name] for name in estimate.nuisances},
        streamed_covariance=JointCovariance((part,)),
    )
    return result, findings
