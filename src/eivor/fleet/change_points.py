"""Drift, steps and outliers in a series of estimates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from eivor.inference.random_effects import Groups, PerGroup, Rows
from eivor.tools import Bool, Float, Int


@dataclass(frozen=True)
class Ordered:
    """Estimates in the order of their groups."""

    groups: Groups
    y: Rows
    errors: Rows
    weights: Rows  # w = 1 / (v + variance between)
    own_weights: Rows
    times: Rows  # When, in a unit that the slopes are of
    covariates: Float[np.ndarray, "p rows"]
    slopes_covariance: Float[np.ndarray, "groups p p"]

    @property
    def least_scale(self) -> PerGroup:
        """What the weighted squares of rows are on average, at least: the share of their own variances."""
        return self.groups.sums(self.weights * self.errors) / self.groups.sizes

    def scale(self, squares: PerGroup, parameters: int) -> PerGroup:
        """Mean of weighted squares about a model, never less than the rows' own variances say."""
        degrees = np.maximum(self.groups.sizes - parameters, 1)
        return np.maximum(squares / degrees, self.least_scale)

    def correction_variance(self, differences: Float[np.ndarray, "p rows"], of_rows: bool) -> Rows:
        """Variance that unknown slopes add to an effect that covariates differ by, d' C d."""
        covariance = self.slopes_covariance
        if of_rows:
            covariance = np.repeat(covariance, self.groups.sizes, axis=0)
        return np.einsum("ig,gij,jg->g", differences, covariance, differences)


def centred(groups: Groups, weights: Rows, values: Rows) -> Rows:
    """Values less the weighted mean of their group."""
    return values - groups.spread(groups.sums(weights * values) / groups.sums(weights))


def slope(groups: Groups, weights: Rows, nuisance_values: Rows, values: Rows) -> PerGroup:
    """Slope of values on something centred, in each group; zero where that does not vary."""
    spread = groups.sums(weights * nuisance_values**2)
    return groups.sums(weights * nuisance_values * values) / np.where(spread > 0.0, spread, np.inf)


#: Rows within so many standard errors of their course do not deviate.
NEAR = 2.0


def deviation_p_values(ordered: Ordered, line: Rows, leverage: Rows, parameters: PerGroup) -> Rows:
    """P-value of each row by its residual over what the other rows scatter. Performs no checks."""
    groups, w = ordered.groups, ordered.weights
    remaining = np.maximum(1.0 - leverage, 1e-9)
    squares = (ordered.y - line) ** 2
    weighted = w * squares
    degrees = groups.spread(groups.sizes - parameters - 1.0)
    others = groups.spread(groups.sums(weighted)) - weighted / remaining
    scale = np.maximum(others / np.maximum(degrees, 1.0), groups.spread(ordered.least_scale))
    score = np.sqrt(ordered.own_weights * squares / remaining / scale)
    p_values = np.ones(w.size)
    far = (degrees >= 1.0) & (score > NEAR)
    p_values[far] = 2.0 * scipy.special.stdtr(degrees[far], -score[far])
    return p_values


@dataclass(frozen=True)
class Drifts:
    """Straight lines."""

    slope: PerGroup
    std_error: PerGroup
    degrees: Int[np.ndarray, " groups"]
    squares: PerGroup  # Weighted squares about the line
    line: Rows
    leverage: Rows

    def half_widths(self, level: float = 0.95) -> PerGroup:
        """Half-widths of the slopes' intervals; infinite where there is none."""
        quantile = scipy.special.stdtrit(np.maximum(self.degrees, 1), 0.5 + 0.5 * level)
        return np.where(self.degrees > 0, quantile * self.std_error, np.inf)

    @property
    def p_values(self) -> PerGroup:
        """P-value of no drift; 1 where no line is fitted."""
        score = np.abs(self.slope) / np.where(self.std_error > 0.0, self.std_error, np.inf)
        return np.where(self.degrees > 0, 2.0 * scipy.special.stdtr(np.maximum(self.degrees, 1), -score), 1.0)


def drifts(ordered: Ordered) -> Drifts:
    """Weighted least squares, with a scale from each group's own scatter. Performs no checks."""
    groups, w = ordered.groups, ordered.weights
    position, y = centred(groups, w, ordered.times), centred(groups, w, ordered.y)
    result = slope(groups, w, position, y)
    squares = groups.sums(w * (y - groups.spread(result) * position) ** 2)
    spread = groups.sums(w * position**2)
    variance = ordered.scale(squares, 2) / np.where(spread > 0.0, spread, np.inf)
    along = np.array([slope(groups, w, position, covariate) for covariate in ordered.covariates]).reshape(
        -1, result.size
    )
    variance = variance + ordered.correction_variance(along, of_rows=False)
    line = ordered.y - y + groups.spread(result) * position
    leverage = w / groups.spread(groups.sums(w)) + w * position**2 / np.where(
        groups.spread(spread) > 0.0, groups.spread(spread), np.inf
    )
    degrees = np.where(spread > 0.0, np.maximum(groups.sizes - 2, 0), 0)
    return Drifts(result, np.sqrt(variance), degrees, squares, line, leverage)


#: Neighbours on each side, with whose median an estimate is compared.
SIDE = 3
#: Standard deviations from which on an estimate is an outlier.
FAR = 2.5
#: Variance of the median of three normal estimates over that of one; median of a chi-square with one degree.
OF_THREE, OF_SQUARES = 0.449, 0.455


def outlier_test(groups: Groups, sets: Groups, variances: Rows) -> Callable[[Rows], Rows]:
    """Return a function of estimates: the extra variance of isolated ones, zero for all others."""
    of_row = np.repeat(np.arange(groups.sizes.size), groups.sizes)
    pairs = np.flatnonzero(of_row[1:] == of_row[:-1])  # first rows of neighbours in one group
    of_group = groups.sizes - 1
    sizes = (of_group, np.add.reduceat(of_group, sets.starts))  # pairs of each group and of each set
    # medians of what errors add to squared differences, in each group and in each set
    errors = [_medians(size, variances[pairs + 1] + variances[pairs]) for size in sizes]

    def extra_variance(y: Rows) -> Rows:
        distance = np.minimum(_distance(groups, y, -1), _distance(groups, y, 1))
        distance[np.isinf(distance)] = 0.0
        squares = (y[pairs + 1] - y[pairs]) ** 2
        in_group, in_set = (
            0.5 * np.maximum(_medians(size, squares) / OF_SQUARES - error, 0.0)
            for size, error in zip(sizes, errors, strict=True)
        )
        between = np.maximum(in_group, sets.spread(in_set))  # of its set, or its own if larger
        total = variances + groups.spread(between)
        mean = groups.sums(total) / groups.sizes
        far = distance**2 > FAR**2 * (total + OF_THREE * groups.spread(mean))
        return np.where(far, distance**2, 0.0)

    return extra_variance


def _distance(groups: Groups, y: Rows, direction: int) -> Rows:
    """Distance from the median of the next few rows one way; from the nearest where there are fewer."""
    row = np.arange(y.size)
    ends = groups.starts if direction < 0 else groups.starts + groups.sizes - 1
    available = np.abs(row - np.repeat(ends, groups.sizes))
    first, second, third = (np.roll(y, -direction * (number + 1)) - y for number in range(SIDE))
    low, high = np.minimum(first, second), np.maximum(first, second)
    middle = np.abs(np.maximum(low, np.minimum(high, third)))
    nearer = np.minimum(np.abs(first), np.abs(second))
    distance = np.where(available == 1, np.abs(first), np.where(available == 2, nearer, middle))
    return np.where(available > 0, distance, np.inf)


def _medians(
    sizes: Int[np.ndarray, " parts"], values: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " parts"]:
    """Lower median of each part of values that are not negative; zero of an empty one."""
    result = np.zeros(sizes.size)
    some = np.flatnonzero(sizes > 0)
    scale = float(values.mean()) if values.size else 0.0
    if scale > 0.0:  # one sort for all parts: their numbers, and values as fractions
        ordered = np.sort(np.repeat(np.arange(sizes.size), sizes) + values / (values + scale))
        middle = ordered[(np.cumsum(sizes) - sizes + (sizes - 1) // 2)[some]] - some
        result[some] = scale * middle / (1.0 - middle)
    return result


#: Degrees of freedom that must be left for slopes to be estimated.
FEWEST_DEGREES = 5
#: Directions in which covariates vary by less than this share of their whole variation have no slope.
SMALL = 1e-6


def shared_slopes(
    groups: Groups,
    sets: Groups,
    y: Rows,
    weights: Rows,
    trends: Float[np.ndarray, "c rows"],
    covariates: Float[np.ndarray, "p rows"],
    expected: Float[np.ndarray, " p"],
    uncertainty: Float[np.ndarray, " p"],
) -> tuple[Float[np.ndarray, "sets p"], Float[np.ndarray, "sets p p"]]:
    """Slopes of sets of groups by weighted least squares, and their covariances. Performs no checks."""
    count = covariates.shape[0]
    basis: list[Rows] = []

    def residual_of(values: Rows) -> Rows:
        rest = centred(groups, weights, values)
        for trend in basis:
            rest = rest - groups.spread(slope(groups, weights, trend, rest)) * trend
        return rest

    basis.extend(residual_of(trend) for trend in trends)  # each without those before it

    def sums(values: Rows) -> Float[np.ndarray, " sets"]:
        return sets.sums(groups.sums(values))

    rest, x = residual_of(y), [residual_of(covariate) for covariate in covariates]
    gram = np.empty((sets.sizes.size, count, count))
    moment, power = np.empty((sets.sizes.size, count)), np.empty((sets.sizes.size, count))
    for i in range(count):
        moment[:, i] = sums(weights * x[i] * rest)
        power[:, i] = sums(weights * covariates[i] ** 2)
        for j in range(count):
            gram[:, i, j] = sums(weights * x[i] * x[j])
    degrees = sets.sums(np.maximum(groups.sizes - 1 - len(basis), 0).astype(float)) - count
    enough = degrees >= FEWEST_DEGREES
    prior = np.diag(uncertainty**-2.0)
    gram = np.where(enough[:, None, None], gram, 0.0) + prior
    moment = np.where(enough[:, None], moment, 0.0) + prior @ expected
    size = np.sqrt(np.maximum(np.einsum("sii->si", gram), SMALL * power + np.finfo(float).tiny))
    inverse = np.linalg.pinv(gram / (size[:, :, None] * size[:, None, :]), rcond=SMALL, hermitian=True)
    inverse = inverse / (size[:, :, None] * size[:, None, :])
    values = np.einsum("sij,sj->si", inverse, moment)
    squares = sums(weights * rest**2) + expected @ prior @ expected - np.einsum("si,si->s", values, moment)
    scale = np.where(enough, np.maximum(squares / np.maximum(degrees, 1.0), 1.0), 1.0)
    return values, scale[:, None, None] * inverse


#: Estimates on each side of a step, at least: fewer are members that deviate.
FEWEST = 3
#: P-values above this are bounds.
NO_NEWS = 0.02
#: -2 ln(1 - sqrt(.95)): 95 % quantile of the likelihood ratio of the true position of a step.
POSITIONS = 7.352


@dataclass(frozen=True)
class BestSteps:
    """The most likely step of each group."""

    index: Int[np.ndarray, " groups"]
    first: Int[np.ndarray, " groups"]
    last: Int[np.ndarray, " groups"]
    size: PerGroup
    half_width: PerGroup
    p_values: PerGroup
    squares: PerGroup  # Weighted squares about both means
    line: Rows
    leverage: Rows
    after: Bool[np.ndarray, " rows"]  # Which rows come after the step


def steps(ordered: Ordered) -> BestSteps:
    """Best step of each group, at the row with the clearest difference of means. Performs no checks."""
    groups, w = ordered.groups, ordered.weights
    y, number = centred(groups, w, ordered.y), groups.running(np.ones(w.size))
    possible = (number >= FEWEST) & (groups.spread(groups.sizes.astype(float)) - number >= FEWEST)
    before, total = groups.running(w), groups.spread(groups.sums(w))
    after = np.where(possible, total - before, 1.0)
    inverse = 1.0 / before + 1.0 / after
    size = _jump(groups, w, y, before, after)
    gain = np.where(possible, size**2 / inverse, -1.0)
    is_largest = gain >= groups.spread(np.maximum.reduceat(gain, groups.starts))
    best = np.minimum.reduceat(np.where(is_largest, np.arange(w.size), w.size), groups.starts)
    squares = groups.spread(groups.sums(w * y**2)) - gain
    degrees = np.maximum(groups.sizes - 2, 1)
    scale = np.maximum(squares / groups.spread(degrees.astype(float)), groups.spread(ordered.least_scale))
    jumps = [_jump(groups, w, covariate, before, after) for covariate in ordered.covariates]
    differences = np.array(jumps).reshape(-1, w.size)
    variance = scale * inverse + ordered.correction_variance(differences, of_rows=True)
    score = np.where(possible, np.abs(size) / np.sqrt(variance), 0.0)
    largest = np.maximum.reduceat(score, groups.starts)
    has_step, late = possible[best], number > groups.spread(number[best])
    line, leverage = _two_means(groups, w, ordered.y, ~late)
    in_set = possible & (groups.spread(gain[best]) - gain <= POSITIONS * groups.spread(scale[best]))
    half_width = scipy.special.stdtrit(degrees, 0.975) * np.sqrt(variance[best])
    return BestSteps(
        np.where(has_step, number[best], 0).astype(int),
        np.where(has_step, _smallest(groups, number, in_set), 0).astype(int),
        np.where(has_step, -_smallest(groups, -number, in_set), 0).astype(int),
        np.where(has_step, size[best], 0.0),
        np.where(has_step, half_width, np.inf),
        np.where(has_step, _tail(groups, largest, degrees, possible, before, total), 1.0),
        np.where(has_step, squares[best], np.inf),
        line,
        leverage,
        np.repeat(has_step, groups.sizes) & late,
    )


def _jump(groups: Groups, w: Rows, values: Rows, before: Rows, after: Rows) -> Rows:
    weighted = w * values
    upto = groups.running(weighted)
    return (groups.spread(groups.sums(weighted)) - upto) / after - upto / before


def _smallest(groups: Groups, values: Rows, rows: np.ndarray) -> PerGroup:
    """Smallest value of each group among some rows; undefined for a group without any."""
    return np.minimum.reduceat(np.where(rows, values, values.max() + 1.0), groups.starts)


def _two_means(groups: Groups, w: Rows, y: Rows, early: np.ndarray) -> tuple[Rows, Rows]:
    """Mean of the side of the step of each row, and the row's leverage on it."""
    line, leverage = np.empty(y.size), np.empty(y.size)
    for side in (early, ~early):
        weights = np.where(side, w, 0.0)
        total = groups.sums(weights)
        total = groups.spread(np.where(total > 0.0, total, 1.0))
        mean = groups.spread(groups.sums(weights * y)) / total
        line, leverage = np.where(side, mean, line), np.where(side, w / total, leverage)
    return line, leverage


def _tail(
    groups: Groups,
    largest: PerGroup,
    degrees: Int[np.ndarray, " groups"],
    possible: np.ndarray,
    before: Rows,
    total: Rows,
) -> PerGroup:
    """P-value of the largest |t| over all positions, see this module; only a bound where it is large."""
    one_sided = np.maximum(scipy.special.stdtr(degrees, -largest), 1e-300)
    bound = 2.0 * one_sided * groups.sums(possible.astype(float))
    pairs = np.append(possible[:-1] & possible[1:], False) & (groups.spread(2.0 * one_sided) < NO_NEWS)
    k = np.flatnonzero(pairs)
    ratio = before[k] * (total - before)[k + 1] / (before[k + 1] * (total - before)[k])
    rho = np.sqrt(np.clip(ratio, 0.0, 1.0))
    tail = groups.spread(one_sided)[k]
    c = -scipy.special.ndtri(tail)
    joint = np.zeros(before.size)
    for sign in (1.0, -1.0):
        separated = scipy.special.owens_t(c, np.sqrt((1.0 - sign * rho) / (1.0 + sign * rho)))
        joint[k] += 2.0 * np.maximum(tail - 2.0 * separated, 0.0)
    return np.clip(bound - groups.sums(joint), 2.0 * one_sided, 1.0)
