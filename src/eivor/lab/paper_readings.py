"""Readings of the paper's experiments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

from eivor.errors import UsageError
from eivor.lab.records import DisturbanceRoute, Intersample
from eivor.lab.study_run import Spread

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
#: Methods in the order of the results; of each pair the second is solved by total least squares.
METHODS = (
    "least_squares",
    "total_least_squares",
    "extended_iv",
    "extended_iv_tls",
    "generalized_iv",
    "generalized_iv_tls",
)
#: What the paper's columns LS, IV and GIV are called here.
PRINTED_METHODS: Mapping[str, str] = {"LS": "least_squares", "IV": "extended_iv", "GIV": "generalized_iv"}


@dataclass(frozen=True, slots=True)
class Example:
    """An example of the paper with the table it prints.

    Parameters
    ----------
    number : int
        1 or 2.
    ratio : float
        Noise-to-signal ratio of all sources but one.
    printed : mapping of str to (Spread, Spread, Spread)
        For each method of the table, mean and SD of NRMSE in percent, in the order of `SCORES`.
    """

    number: int
    ratio: float
    printed: Mapping[str, tuple[Spread, Spread, Spread]]


EXAMPLES = (
    Example(
        1,
        2e-3,
        {
            "least_squares": (Spread(6.43, 0.074), Spread(6.32, 0.075), Spread(6.42, 0.074)),
            "extended_iv": (Spread(187.2, 119.4), Spread(129.3, 80.4), Spread(186.9, 119.2)),
            "generalized_iv": (Spread(2.30, 1.67), Spread(2.26, 1.65), Spread(2.30, 1.67)),
        },
    ),
    Example(
        2,
        5e-3,
        {
            "least_squares": (Spread(6.55, 0.10), Spread(6.442, 0.10), Spread(6.55, 0.10)),
            "extended_iv": (Spread(211.6, 247.3), Spread(145.0, 159.7), Spread(211.6, 246.9)),
            "generalized_iv": (Spread(5.74, 2.70), Spread(3.69, 2.65), Spread(5.739, 2.70)),
        },
    ),
)


class Ratio(Enum):
    """What the noise-to-signal ratios are ratios of."""

    STD = "standard deviations"
    VARIANCE = "variances"


class RatioOf(Enum):
    """Which noise a ratio is taken of."""

    WHITE = "the white sequence before Delta^alpha"
    FRACTIONAL = "the noise after Delta^alpha, its mean variance over the record"


class Weights(Enum):
    """Weights of Delta^alpha."""

    SIGNED = "(-1)^j binom(alpha, j)"
    PRINTED = "binom(alpha, j)"


class MotionSource(Enum):
    """Where z' and z'' at the samples come from; z is the height, integrated exactly."""

    SOLUTION = "the solution of the equation of motion"
    VELOCITY_CENTRAL = "z'' by central differences of z'"
    VELOCITY_BACKWARD = "z'' by backward differences of z'"
    VELOCITY_FORWARD = "z'' by forward differences of z'"
    HEIGHT_CENTRAL = "z' by central, z'' by central second differences of z"
    HEIGHT_TWICE_CENTRAL = "z' by central differences of z, z'' by central differences of that"
    HEIGHT_BACKWARD = "z' by backward differences of z, z'' by backward differences of that"
    NOISY_VELOCITY = "z'' by central differences of z' as measured, with its noise"
    EULER_STEPS = "Euler's steps, each z'' beside the z' that it leads to"


class Input(Enum):
    """Which input drives the vehicle."""

    PAPER = "(35) with t in seconds"
    SAMPLES = "(35) with t counted in samples"
    WHITE = "white, with the variance of (35)"


class Compensation(Enum):
    """What is subtracted from the products of instruments and regressors in (29)."""

    SHARED = "N sigma_u^2 in the row of lag 0"
    PRINTED_ROW = "N sigma_u^2 in row 2, as H is printed"
    WITHOUT_COUNT = "sigma_u^2 without N, as (29) is printed"


@dataclass(frozen=True, slots=True)
class PaperReading:
    """One way to read the paper's simulation.

    Parameters
    ----------
    name : str
        What the command line calls it.
    sentence : str
        What it says.
    allowed : bool
        Whether the text allows it; False for what is measured to understand the others.
    input_variance : float
        Variance of the white sequence in (35).
    input : Input
        Which input.
    ratio, ratio_of : Ratio, RatioOf
        What the ratios mean.
    larger_on : str
        Source that has the ratio 1e-2, one of `SOURCES`.
    weights : Weights
        Of Delta^alpha.
    motion : MotionSource
        Where z' and z'' come from.
    intersample : Intersample
        What the input does between samples.
    route : Route
        Where the disturbance enters.
    disturbance_scaled : bool
        Scale the disturbance to its ratio; False leaves e ~ N(0, 1) and sinusoids of amplitude 1.
    lags : int
        n: extended IV has the input at lags 1 to n, generalized IV at 0 to n.
    compensation : Compensation
        Of generalized IV.
    as_many : bool
        Generalized IV has the lags 0 to n - 1, as many instruments as extended IV.
    """

    name: str
    sentence: str
    allowed: bool = True
    input_variance: float = 0.02
    input: Input = Input.PAPER
    ratio: Ratio = Ratio.STD
    ratio_of: RatioOf = RatioOf.WHITE
    larger_on: str = "velocity_z"
    weights: Weights = Weights.SIGNED
    motion: MotionSource = MotionSource.SOLUTION
    intersample: Intersample = Intersample.HOLD
    route: DisturbanceRoute = DisturbanceRoute.EQUATION
    disturbance_scaled: bool = True
    lags: int = 10
    compensation: Compensation = Compensation.SHARED
    as_many: bool = False

    @property
    def records(self) -> PaperReading:
        """What shapes the records alone: readings that share it have the same ones."""
        same = PaperReading("", "")
        return replace(
            self,
            name="",
            sentence="",
            allowed=True,
            lags=same.lags,
            compensation=same.compensation,
            as_many=same.as_many,
        )


_STD = PaperReading(
    "ratios-of-std",
    "Ratios of standard deviations, 1e-2 on z', 0.02 the standard deviation of the input's noise, exact "
    "motion, ten lags.",
    input_variance=0.02**2,
)
_VARIANCE = replace(
    _STD,
    name="ratios-of-variances",
    sentence="As ratios-of-std, with the ratios those of variances.",
    ratio=Ratio.VARIANCE,
)
_CENTRAL = PaperReading(
    "central-10-lags",
    "Ratios of standard deviations, 0.02 a variance, z'' by central differences of z' at T = 0.2 s, ten "
    "lags.",
    motion=MotionSource.VELOCITY_CENTRAL,
)
#: Every named reading.
READINGS: tuple[PaperReading, ...] = (
    _STD,
    _VARIANCE,
    replace(
        _STD,
        name="input-variance-std",
        sentence="As ratios-of-std, with 0.02 the variance of the input's noise.",
        input_variance=0.02,
    ),
    replace(
        _VARIANCE,
        name="input-variance",
        sentence="As ratios-of-variances, with 0.02 the variance of the input's noise.",
        input_variance=0.02,
    ),
    replace(
        _VARIANCE,
        name="larger-on-acceleration",
        sentence="As ratios-of-variances, with 1e-2 on z''.",
        larger_on="acceleration_z",
    ),
    replace(
        _VARIANCE,
        name="larger-on-input",
        sentence="As ratios-of-variances, with 1e-2 on u.",
        larger_on="input",
    ),
    replace(
        _VARIANCE,
        name="larger-on-disturbance",
        sentence="As ratios-of-variances, with 1e-2 on the disturbance.",
        larger_on=DISTURBANCE,
    ),
    replace(
        _VARIANCE,
        name="ratio-after-delta",
        sentence="As ratios-of-variances, the ratios of the noises after Delta^alpha.",
        ratio_of=RatioOf.FRACTIONAL,
    ),
    replace(
        _VARIANCE,
        name="weights-as-printed",
        sentence="As ratios-of-variances, with binom(alpha, j) as weights: signs alternate.",
        weights=Weights.PRINTED,
    ),
    replace(
        _VARIANCE,
        name="disturbance-in-dynamics",
        sentence="As ratios-of-variances, with the disturbance moving the vehicle.",
        route=DisturbanceRoute.DYNAMICS,
    ),
    replace(
        _VARIANCE,
        name="disturbance-unscaled",
        sentence="As ratios-of-variances, with e ~ N(0, 1) and sinusoids of amplitude 1 m/s^2 as printed.",
        disturbance_scaled=False,
    ),
    replace(
        _VARIANCE,
        name="two-lags",
        sentence="As ratios-of-variances, with n = 2 in (21) and (28): as many delayed inputs as parameters.",
        lags=2,
    ),
    replace(
        _VARIANCE,
        name="row-of-h-as-printed",
        sentence="As larger-on-input, with the 1 of H in row 2 as printed.",
        larger_on="input",
        compensation=Compensation.PRINTED_ROW,
    ),
    replace(
        _VARIANCE,
        name="count-left-out",
        sentence="As larger-on-input, with sigma_u^2 not multiplied by N, as (29) is printed.",
        larger_on="input",
        compensation=Compensation.WITHOUT_COUNT,
    ),
    replace(
        _VARIANCE,
        name="time-in-samples",
        sentence="As ratios-of-variances, with t in (35) counted in samples.",
        input=Input.SAMPLES,
    ),
    _CENTRAL,
    replace(_CENTRAL, name="central-5-lags", sentence="As central-10-lags, with five lags.", lags=5),
    replace(_CENTRAL, name="central-2-lags", sentence="As central-10-lags, with n = 2 as in (21).", lags=2),
    replace(
        _CENTRAL,
        name="central-linear-input",
        sentence="As central-5-lags, with an input that is linear between samples.",
        lags=5,
        intersample=Intersample.LINEAR,
    ),
    replace(
        _CENTRAL,
        name="height-central",
        sentence="As central-5-lags, with z' by central and z'' by central second differences of z.",
        lags=5,
        motion=MotionSource.HEIGHT_CENTRAL,
    ),
    replace(
        _CENTRAL,
        name="height-backward",
        sentence="As central-5-lags, with z' and z'' by backward differences of z, one after the other.",
        lags=5,
        motion=MotionSource.HEIGHT_BACKWARD,
    ),
    replace(
        _CENTRAL,
        name="height-backward-2-lags",
        sentence="As height-backward, with n = 2 as in (21).",
        lags=2,
        motion=MotionSource.HEIGHT_BACKWARD,
    ),
    replace(
        _CENTRAL,
        name="noise-before-differences",
        sentence="As central-5-lags, with z'' by central differences of the noisy z'.",
        lags=5,
        motion=MotionSource.NOISY_VELOCITY,
    ),
    replace(
        _CENTRAL,
        name="euler-steps",
        sentence="As central-10-lags, with the motion by Euler's steps: z'' of the z' before, and in the "
        "equation beside the z' that it leads to.",
        motion=MotionSource.EULER_STEPS,
    ),
    replace(
        _VARIANCE,
        name="forward-printed-weights",
        sentence="As larger-on-input, with z'' by forward differences of z', binom(alpha, j) as weights, "
        "n = 2, and as many instruments in generalized as in extended IV.",
        larger_on="input",
        motion=MotionSource.VELOCITY_FORWARD,
        weights=Weights.PRINTED,
        lags=2,
        as_many=True,
    ),
    replace(
        _VARIANCE,
        name="forward-linear-2-lags",
        sentence="As ratios-of-variances, with 0.02 a variance, an input that is linear between samples, "
        "z'' by forward differences of z', n = 2, and as many instruments in generalized as in extended IV.",
        input_variance=0.02,
        intersample=Intersample.LINEAR,
        motion=MotionSource.VELOCITY_FORWARD,
        lags=2,
        as_many=True,
    ),
    replace(
        _VARIANCE,
        name="white-input",
        sentence="Not the paper's: as ratios-of-variances, with a white input of the variance of (35).",
        allowed=False,
        input=Input.WHITE,
        input_variance=0.02,
    ),
    replace(
        _VARIANCE,
        name="white-input-2-lags",
        sentence="Not the paper's: as white-input, with n = 2.",
        allowed=False,
        input=Input.WHITE,
        input_variance=0.02,
        lags=2,
    ),
)


def named_readings(names: tuple[str, ...]) -> tuple[PaperReading, ...]:
    """Readings of those names, in the order of the names; all for none."""
    known = {reading.name: reading for reading in READINGS}
    for name in names:
        if name not in known:
            raise UsageError(
                f"readings out of {', '.join(known)}", f"'{name}'", "Name some of them, with commas between."
            )
    return tuple(known[name] for name in names) or READINGS
