"""The paper's simulation: its readings, trials and results."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Literal

import msgspec
import numpy as np
import scipy
from threadpoolctl import threadpool_limits

from eivor import checks
from eivor.errors import EivorError, UsageError
from eivor.estimation import methods
from eivor.estimation.linear import LinearMethod, first_stage_strengths
from eivor.estimation.moments import CrossMoments, Moments
from eivor.inference.diagnostics.instruments import STRONG_FIRST_STAGE
from eivor.lab.disturbances import paper_disturbance
from eivor.lab.experiments import stream
from eivor.lab.records import DisturbanceRoute, Intersample, Scenario, SimulatedRecord, simulate
from eivor.lab.study import Spread, spread_of
from eivor.models.regression import lags
from eivor.motions.vertical.model import VerticalMotion
from eivor.process_pool import in_order, local_executor
from eivor.signals.noise import FractionalNoise, MeasurementNoise, WhiteNoise
from eivor.signals.signals import Signals
from eivor.simulation.excitation import Excitation, PaperInput, WhiteExcitation
from eivor.strict_toml import package_tables
from eivor.tools import Bool, Float

#: theta = (K, K_u) of (34).
TRUTH: Mapping[str, float] = {"viscous_friction": 0.293, "input_gain": 0.021}
RATE_HZ = 5.0
SAMPLES = 4000
RUNS = 100
#: Orders of the noises of z' and z'' in (34).
ORDERS: Mapping[str, float] = {"velocity_z": -0.4, "acceleration_z": -0.5}
#: The ratio that is the same in both examples, and what it may belong to.
LARGER_RATIO = 1e-2
DISTURBANCE = "disturbance"
SOURCES = ("velocity_z", "acceleration_z", "input", DISTURBANCE)
#: Columns of the tables: NRMSE of K, of K_u, and of both together.
SCORES = ("viscous_friction", "input_gain", "together")
#: Methods in the order of the results, and what tables call them; of each pair the second is solved by total
#: least squares.
METHOD_WORDS: Mapping[str, str] = {
    "least_squares": "LS",
    "total_least_squares": "LS, TLS form",
    "extended_iv": "IV",
    "extended_iv_tls": "IV, TLS form",
    "generalized_iv": "GIV",
    "generalized_iv_tls": "GIV, TLS form",
}
METHODS = tuple(METHOD_WORDS)
#: What the paper's columns LS, IV and GIV are called here.
PRINTED_METHODS: Mapping[str, str] = {METHOD_WORDS[name]: name for name in METHODS[::2]}


@dataclass(frozen=True, slots=True)
class Example:
    """An example of the paper with the table it prints."""

    number: int  # 1 or 2
    ratio: float  # Noise-to-signal ratio of all sources but one
    # For each method of the table, mean and SD of NRMSE in percent, in the order of `SCORES`
    printed: Mapping[str, tuple[Spread, Spread, Spread]]


EXAMPLES = tuple(msgspec.convert(package_tables("eivor.lab", "examples.toml")["example"], list[Example]))


#: Where z' and z'' at the samples come from; z is the height, integrated exactly.
MotionSource = Literal[
    "solution",  # The solution of the equation of motion
    "velocity_central",  # z'' by central differences of z'
    "velocity_forward",  # z'' by forward differences of z'
    "height_central",  # z' by central, z'' by central second differences of z
    "height_backward",  # z' by backward differences of z, z'' by backward differences of that
    "noisy_velocity",  # z'' by central differences of z' as measured, with its noise
    "euler_steps",  # Euler's steps, each z'' beside the z' that it leads to
]
#: What is subtracted from the products of instruments and regressors in (29).
Compensation = Literal[
    "shared",  # N sigma_u^2 in the row of lag 0
    "printed_row",  # N sigma_u^2 in row 2, as H is printed
    "without_count",  # sigma_u^2 without N, as (29) is printed
]


@dataclass(frozen=True, slots=True)
class PaperReading:
    """One way to read the paper's simulation."""

    name: str  # What the command line calls it
    sentence: str  # What it says
    allowed: bool = True  # Whether the text allows it; False for what is measured to understand the others
    input_variance: float = 0.02  # Variance of the white sequence in (35)
    input: Literal["paper", "samples", "white"] = "paper"  # (35), with t in samples, white of its variance
    ratio: Literal["std", "variance"] = "std"  # What the noise-to-signal ratios are ratios of
    # Which noise: the white sequence before Delta^alpha, or its mean variance over the record after it
    ratio_of: Literal["white", "fractional"] = "white"
    larger_on: str = "velocity_z"  # Source that has the ratio 1e-2, one of `SOURCES`
    # Of Delta^alpha: (-1)^j binom(alpha, j), or binom(alpha, j) as printed
    weights: Literal["signed", "printed"] = "signed"
    motion: MotionSource = "solution"
    intersample: Intersample = Intersample.HOLD  # What the input does between samples
    route: DisturbanceRoute = DisturbanceRoute.EQUATION  # Where the disturbance enters
    # Scale the disturbance to its ratio; False leaves e ~ N(0, 1) and sinusoids of amplitude 1
    disturbance_scaled: bool = True
    lags: int = 10  # n: extended IV has the input at lags 1 to n, generalized IV at 0 to n
    compensation: Compensation = "shared"  # Of generalized IV
    as_many: bool = False  # Generalized IV has the lags 0 to n - 1, as many instruments as extended IV

    @property
    def records(self) -> PaperReading:
        """What shapes the records alone: readings that share it have the same ones."""
        same = PaperReading("", "")
        others = ("name", "sentence", "allowed", "lags", "compensation", "as_many")
        return replace(self, **{name: getattr(same, name) for name in others})


def _readings() -> tuple[PaperReading, ...]:
    rows: dict[str, dict[str, Any]] = {}
    for name, row in package_tables("eivor.lab", "paper_readings.toml").items():
        rows[name] = rows.get(row.pop("as", ""), {}) | row | {"name": name}
    return tuple(msgspec.convert(list(rows.values()), list[PaperReading]))


READINGS = _readings()


def named_readings(names: tuple[str, ...]) -> tuple[PaperReading, ...]:
    """Readings of those names, in the order of the names; all for none."""
    known = {reading.name: reading for reading in READINGS}
    for name in names:
        checks.index_of("readings", name, known, "Name some of them, with commas between.")
    return tuple(known[name] for name in names) or READINGS


#: Samples at each end of a record that differences cannot reach.
EDGE = 2
#: Variance of (35) without its sinusoid per variance of w, and variance of the sinusoid.
MOVING_AVERAGE, SINUSOID = 0.7**2 + 0.49**2, 0.5

Series = Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class AlternatingNoise(FractionalNoise):
    """Fractional noise with binom(order, j) as weights, which is (-1)^k Delta^order of white noise."""

    def autocovariance(self, lag: int, start: int, count: int) -> Float[np.ndarray, " count"]:
        return (-1.0) ** lag * FractionalNoise.autocovariance(self, lag, start, count)

    def moving_average(self, count: int) -> Float[np.ndarray, " count"]:
        return (-1.0) ** np.arange(count) * FractionalNoise.moving_average(self, count)

    def sample(self, count: int, rng: np.random.Generator) -> Float[np.ndarray, " count"]:
        return (-1.0) ** np.arange(count) * FractionalNoise.sample(self, count, rng)


@dataclass(frozen=True, slots=True)
class SampleClockInput(Excitation):
    """The paper's (35) with t counted in samples."""

    variance: float

    def sample(self, count: int, _step_s: float, rng: np.random.Generator, /) -> Float[np.ndarray, " count"]:
        return PaperInput(self.variance).sample(count, 1.0, rng)


def scenario(reading: PaperReading, example: Example) -> Scenario:
    """What a reading of an example simulates; longer by the edges when differences are taken."""
    exact = reading.motion == "solution"
    ratios = {name: _ratio(reading, example, name) for name in SOURCES}
    share = ratios.pop(DISTURBANCE)
    variance = reading.input_variance
    inputs: dict[str, Excitation] = {
        "paper": PaperInput(variance),
        "samples": SampleClockInput(variance),
        "white": WhiteExcitation(float(np.sqrt(MOVING_AVERAGE * variance + SINUSOID))),
    }
    shape = FractionalNoise if reading.weights == "signed" else AlternatingNoise
    noise: dict[str, MeasurementNoise] = {name: shape(1.0, order) for name, order in ORDERS.items()}
    return Scenario(
        TRUTH["viscous_friction"],
        TRUTH["input_gain"],
        rate_hz=RATE_HZ,
        samples=SAMPLES + (0 if exact else 2 * EDGE),
        excitation=inputs[reading.input],
        noise=noise | {"input": WhiteNoise(1.0)},
        noise_to_signal=ratios,
        disturbance=paper_disturbance(),
        disturbance_to_signal=share if reading.disturbance_scaled else None,
        route=reading.route,
        intersample=reading.intersample,
    )


def _ratio(reading: PaperReading, example: Example, source: str) -> float:
    ratio = LARGER_RATIO if source == reading.larger_on else example.ratio
    if reading.ratio == "variance":
        ratio = float(np.sqrt(ratio))
    if reading.ratio_of == "fractional" and source in ORDERS:
        ratio /= float(np.sqrt(mean_variance(ORDERS[source], SAMPLES)))
    return ratio


@lru_cache
def mean_variance(order: float, count: int, start: int = 0) -> float:
    """Mean variance, over samples that begin `start` after the noise did, of Delta^order of unit noise."""
    return float(FractionalNoise(1.0, order).autocovariance(0, start, count).mean())


def record(reading: PaperReading, example: Example, rng: np.random.Generator) -> SimulatedRecord:
    """One record under a reading, and its truth."""
    simulated = simulate(scenario(reading, example), rng)
    return simulated if reading.motion == "solution" else _differentiate(simulated, reading)


def _differentiate(record: SimulatedRecord, reading: PaperReading) -> SimulatedRecord:
    """Record whose z' and z'' come from differences or steps, with the same errors, without its edges."""
    truth = record.truth
    errors = {name: record.signals.channels[name] - truth.channels[name] for name in record.signals.channels}
    velocity = truth.channels["velocity_z"]
    if reading.motion == "noisy_velocity":
        velocity = velocity + errors.pop("velocity_z")
    if reading.motion == "euler_steps":
        velocity, acceleration = euler_steps(truth.channels["input"])
    else:
        height = integrated_height(velocity, truth.channels["input"], intersample=reading.intersample)
        velocity, acceleration = _DIFFERENCES[reading.motion](velocity, height)
    exact = {
        "velocity_z": velocity,
        "acceleration_z": acceleration + truth.channels[DISTURBANCE],
        "input": truth.channels["input"],
    }
    measured = {name: values + errors.get(name, 0.0) for name, values in exact.items()}
    return SimulatedRecord(
        _without_edges(measured, record.signals), _without_edges(exact, truth), record.parameters
    )


def _without_edges(channels: dict[str, Series], like: Signals) -> Signals:
    inner = {name: values[EDGE:-EDGE] for name, values in channels.items()}
    return Signals(like.rate_hz, inner, noise=like.noise, offset=EDGE)


def integrated_height(velocity: Series, drive: Series, *, intersample: Intersample) -> Series:
    """Height of an undisturbed motion from rest [m]: K z' integrated is impulse less momentum."""
    step = 1.0 / RATE_HZ
    mean_drive = drive[:-1] if intersample is Intersample.HOLD else 0.5 * (drive[:-1] + drive[1:])
    climbs = (TRUTH["input_gain"] * step * mean_drive - np.diff(velocity)) / TRUTH["viscous_friction"]
    return np.concatenate([[0.0], np.cumsum(climbs)])


def euler_steps(drive: Series) -> tuple[Series, Series]:
    """Motion from rest by Euler's steps: y[k] = -K v[k-1] + K_u u[k], v[k] = v[k-1] + T y[k]."""
    K, K_u, T = TRUTH["viscous_friction"], TRUTH["input_gain"], 1.0 / RATE_HZ
    velocity: Series = scipy.signal.lfilter([T * K_u], [1.0, K * T - 1.0], drive)
    return velocity, np.diff(velocity, prepend=0.0) / T


def _slope(ahead: int, behind: int, values: Series) -> Series:
    """Difference quotient over so many samples ahead and behind."""
    return RATE_HZ / (ahead + behind) * (np.roll(values, -ahead) - np.roll(values, behind))


_central, _backward, _forward = partial(_slope, 1, 1), partial(_slope, 0, 1), partial(_slope, 1, 0)
#: From z' and z to z' and z'' by differences; the edges are wrong.
_DIFFERENCES: Mapping[MotionSource, Callable[[Series, Series], tuple[Series, Series]]] = {
    "velocity_central": lambda v, _: (v, _central(v)),
    "noisy_velocity": lambda v, _: (v, _central(v)),
    "velocity_forward": lambda v, _: (v, _forward(v)),
    "height_central": lambda _, z: (_central(z), _forward(_backward(z))),
    "height_backward": lambda _, z: (_backward(z), _backward(_backward(z))),
}


def estimates(
    reading: PaperReading, signals: Signals
) -> tuple[Float[np.ndarray, "methods parameters"], Bool[np.ndarray, " methods"]]:
    """Theta by every method of `METHODS`, NaN where one gives none, and whether its instruments are weak."""
    model = VerticalMotion(intercept=False)
    last = reading.lags - 1 if reading.as_many else reading.lags
    problems = (
        model.regression(_white_equivalent(signals)),
        model.regression(signals, lags("input", 1, reading.lags)),
        model.regression(signals, lags("input", 0, last)),
    )
    result = np.full((len(METHODS), len(TRUTH)), np.nan)
    weak = np.zeros(len(METHODS), dtype=np.bool_)
    for pair, problem in enumerate(problems):
        solvers: list[LinearMethod] = [getattr(methods, name)() for name in METHODS[2 * pair : 2 * pair + 2]]
        moments = solvers[0].moments(problem)
        # As the status of an estimate says it.
        if isinstance(moments, CrossMoments):
            weak[2 * pair : 2 * pair + 2] = first_stage_strengths(moments).min() < STRONG_FIRST_STAGE
        as_read = _as_read(moments, reading.compensation)
        for index, method in enumerate(solvers):
            with suppress(EivorError):  # too few equations, or no unique solution: the method says nothing
                result[2 * pair + index] = method.solve_moments(as_read).theta
    return result, weak


def _white_equivalent(signals: Signals) -> Signals:
    """Signals whose noises are white, of the same mean variance: all that direct methods use of them."""
    count, start = signals.sample_count, signals.offset
    noise = {
        name: WhiteNoise(item.std * float(np.sqrt(mean_variance(item.order, count, start))))
        if isinstance(item, FractionalNoise)
        else item
        for name, item in signals.noise.items()
    }
    return replace(signals, noise=noise)


def _as_read(moments: Moments, compensation: Compensation) -> Moments:
    """Moments with the noise compensation of the reading."""
    if not isinstance(moments, CrossMoments) or moments.noise is None:
        return moments
    if compensation == "printed_row":
        return replace(moments, noise=np.roll(moments.noise, 1, axis=0))
    if compensation == "without_count":
        return replace(moments, noise=moments.noise / moments.rows)
    return moments


def nrmse(theta: Float[np.ndarray, "*trials parameters"]) -> Float[np.ndarray, "*trials scores"]:
    """NRMSE in percent of each parameter, and of both together: the paper's definition."""
    truth = np.array(list(TRUTH.values()))
    errors = theta - truth
    single = 100.0 * np.abs(errors / truth)
    joint = 100.0 * np.linalg.norm(errors, axis=-1, keepdims=True) / np.linalg.norm(truth)
    return np.concatenate([single, joint], axis=-1)


SEED = 20240513
#: Standard errors within which a measured mean agrees with a printed one.
AGREEMENT = 3.0
PRINTED_RUNS = 100


@dataclass(frozen=True, slots=True)
class PaperResult:
    """Results of one example under one reading."""

    reading: PaperReading  # The reading
    example: Example  # The example
    # In the order of `METHODS`; NaN where a method gave none
    estimates: Float[np.ndarray, "runs methods parameters"]
    weak: Bool[np.ndarray, "runs methods"]  # Whether a method's instruments were weak

    def nrmse(self, method: str) -> Float[np.ndarray, "runs scores"]:
        """NRMSE in percent of each run in which the method gave an estimate, in the order of `SCORES`."""
        index = self.estimates[:, METHODS.index(method)]
        return nrmse(index[np.isfinite(index).all(axis=1)])

    def failed(self, method: str) -> int:
        """Runs in which the method gave no estimate."""
        return len(self.estimates) - len(self.nrmse(method))

    def weak_runs(self, method: str) -> int:
        return int(self.weak[:, METHODS.index(method)].sum())

    def spreads(self, method: str) -> tuple[Spread, ...]:
        """Mean and SD of each score; NaN where there are too few runs."""
        return tuple(map(spread_of, self.nrmse(method).T))


@dataclass(frozen=True, slots=True)
class Nearness:
    """How far a reading is from the printed tables."""

    # Typical factor between measured and printed means, and SDs, of NRMSE: exp of the mean of |log(measured /
    # printed)| over examples, columns and parameters
    means: float
    spreads: float
    # Printed means that the measured ones agree with to `AGREEMENT` standard errors, and how many there are
    agreeing: int
    printed: int


def run_together(
    task: tuple[Sequence[PaperReading], Example], runs: int, seed: int = SEED
) -> list[PaperResult]:
    """Results of an example under readings that have their records in common, see `PaperReading.records`."""
    readings, example = task
    theta = np.empty((len(readings), runs, len(METHODS), len(TRUTH)))
    weak = np.empty((len(readings), runs, len(METHODS)), dtype=np.bool_)
    with threadpool_limits(limits=1):
        for index in range(runs):
            signals = record(readings[0], example, stream(seed, index)).signals
            for row, reading in enumerate(readings):
                theta[row, index], weak[row, index] = estimates(reading, signals)
    return [
        PaperResult(reading, example, *parts) for reading, *parts in zip(readings, theta, weak, strict=True)
    ]


def run_paper(
    readings: Sequence[PaperReading], *, runs: int, workers: int | None = None
) -> Iterator[PaperResult]:
    """Results of every reading in their order, example 1 before example 2, as they are done."""
    if runs < 2:
        raise UsageError("two runs or more", f"{runs}", "The paper has 100.")
    groups: dict[PaperReading, list[PaperReading]] = {}
    for reading in readings:
        groups.setdefault(reading.records, []).append(reading)
    tasks = [(tuple(group), example) for group in groups.values() for example in EXAMPLES]
    waiting = [(reading, example) for reading in readings for example in EXAMPLES]
    finished: dict[tuple[str, int], PaperResult] = {}
    computed = local_executor(workers, len(tasks)).map(partial(run_together, runs=runs), tasks)
    with closing(in_order(computed)) as ordered:
        for results in ordered:
            finished |= {(result.reading.name, result.example.number): result for result in results}
            while waiting and (waiting[0][0].name, waiting[0][1].number) in finished:
                reading, example = waiting.pop(0)
                yield finished[reading.name, example.number]


def nearness(results: Sequence[PaperResult], *, total_least_squares: bool = False) -> Nearness:
    """How far both examples of one reading are from the printed tables."""
    pairs = [
        (spread, printed, len(result.nrmse(method)))
        for result in results
        for name in PRINTED_METHODS.values()
        for method in (f"{name}_tls" if total_least_squares and name.endswith("_iv") else name,)
        for spread, printed in zip(result.spreads(method)[:2], result.example.printed[name][:2], strict=True)
    ]
    means = _factor([(spread.mean, printed.mean) for spread, printed, _ in pairs])
    stds = _factor([(spread.std, printed.std) for spread, printed, _ in pairs])
    agreeing = sum(
        abs(spread.mean - printed.mean)
        <= AGREEMENT * np.sqrt(spread.std**2 / max(runs, 1) + printed.std**2 / PRINTED_RUNS)
        for spread, printed, runs in pairs
    )
    return Nearness(means, stds, int(agreeing), len(pairs))


def _factor(pairs: list[tuple[float, float]]) -> float:
    if any(not measured > 0.0 for measured, _ in pairs):
        return float("inf")
    return float(np.exp(np.mean([abs(np.log(measured / printed)) for measured, printed in pairs])))
