"""Filters: actuator lag, low pass, derivatives and time stamps."""

from __future__ import annotations

from math import prod

import numpy as np
import scipy

from eivor.signals.noise import padded_length
from eivor.tools import Float, Int

Series = Float[np.ndarray, " n"]
Rotors = Float[np.ndarray, "n rotors"]
Columns = Float[np.ndarray, "n columns"]


#: Samples of a record that are filtered at a time: so few stay in a cache.
PART = 8_192
#: Passes of a search for the side from which states approach commands: it ends at the exact one before.
MOST_PASSES = 20


def actuator_state(
    command: Rotors,
    *,
    step_s: float,
    lag_s: float,
    delay_s: float,
    second_stage: float = 0.0,
    asymmetry: float = 0.0,
) -> Rotors:
    """State at the samples, behind lag and delay [s] of held commands: q lag^2 w'' + lag w' + w = command.

    With an asymmetry a the lag is lag / (1 + a) upward and lag / (1 - a) downward, without a second stage.
    """
    if lag_s <= 0.0:  # a step of the command is seen in the middle of a difference of states around it
        later = delay_s + 0.5 * step_s
        return command if delay_s <= 0.0 else shifted_by(command, step_s=step_s, delay_s=later)
    if second_stage > 0.0:
        parts = 0.5 + 0.5 * np.sqrt(1.0 - 4.0 * second_stage) * np.array([1.0, -1.0])
        states = [
            actuator_state(command, step_s=step_s, lag_s=part * lag_s, delay_s=delay_s)
            for part in parts.tolist()
        ]
        return (parts[0] * states[0] - parts[1] * states[1]) / (parts[0] - parts[1])
    steps = int(np.floor(delay_s / step_s + 1e-9))
    fraction = max(delay_s / step_s - steps, 0.0)
    decay = np.exp(-step_s / lag_s)
    tail = np.exp(-(1.0 - fraction) * step_s / lag_s)
    start = command[0]
    state: Rotors = np.zeros(command.shape, order="F")
    driven = state[steps + 1 :]
    np.subtract(command[: -steps - 1], start, out=driven)
    further = (tail - decay) * driven[:-1] if tail != decay else None
    driven *= 1.0 - tail
    if further is not None:
        driven[1:] += further
    # w[k] = decay w[k-1] + driven[k] from rest, a bidiagonal triangular system, in short parts
    solve, band = scipy.linalg.lapack.dtbtrs, np.full((2, min(PART, state.shape[0])), -decay, order="F")
    for first in range(0, state.shape[0], PART):
        part = state[first : first + PART]
        part[0] += decay * state[first - 1] if first else 0.0
        part[:] = solve(band[:, : part.shape[0]], part, uplo="L", diag="U", overwrite_b=True)[0]
    state += start
    if asymmetry:
        lengths = np.array([fraction, 1.0 - fraction]) * step_s
        return _uneven_state(command, state, lengths / lag_s, steps, asymmetry)
    return state


def _uneven_state(
    command: Rotors, state: Rotors, lengths: Float[np.ndarray, "2"], steps: int, asymmetry: float
) -> Rotors:
    """The same with two lags, from the state with their mean; lengths are the parts of a step in lags."""
    # a held command is approached from one side: with the sides known, states follow from a linear system
    index = np.maximum(np.arange(-1, command.shape[0] - 1) - steps, 0)
    decays = np.exp(-np.outer(lengths, [1.0 + asymmetry, 1.0 - asymmetry])).tolist()
    band = np.ones((2, command.shape[0]), order="F")
    for rotor, logged in enumerate(command.T):  # what a pass makes of a rotor stays in the processor's cache
        late, rotor_state, last = logged[index], state[:, rotor], np.empty(0)
        early = np.concatenate([late[:1], late[:-1]])
        for _ in range(MOST_PASSES):
            above = np.concatenate([rotor_state[:1], rotor_state[:-1]]) - early
            first = np.where(above < 0.0, *decays[0])
            second = np.where(late > early + above * first, *decays[1])
            decay = first * second
            if np.array_equal(decay, last):
                break
            last, driven = decay, (1.0 - first) * second * early + (1.0 - second) * late
            driven[0], band[1, :-1] = logged[0], -decay[1:]
            columns = driven[:, None]
            rotor_state = scipy.linalg.lapack.dtbtrs(band, columns, uplo="L", diag="U", overwrite_b=True)[0][
                :, 0
            ]
        state[:, rotor] = rotor_state
    return state


#: Lagrange's weights of samples -2, -1, 0, 1 around a fraction of a step, by its powers.
BETWEEN_SAMPLES = np.array([[0, 0, 6, 0], [-1, 6, -3, -2], [0, 3, -6, 3], [1, -3, 3, -1]]) / 6.0


def weights_between_samples(delays: Series) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 4"]]:
    """Whole steps of delays in steps, and Lagrange's weights of samples -2, -1, 0, 1 from there."""
    steps = np.floor(delays)
    return steps.astype(np.int64), np.vander(delays - steps, 4, increasing=True) @ BETWEEN_SAMPLES


def shifted_by(values: Columns, *, step_s: float, delay_s: float) -> Columns:
    """Sampled values so much later; earlier for a negative delay."""
    (steps,), (weights,) = weights_between_samples(np.array([delay_s / step_s]))
    count = values.shape[0]
    around = values.T[:, np.clip(np.arange(-2, count + 1) - steps, 0, count - 1)]
    is_between = weights[2] != 1.0
    return np.array(
        [np.correlate(column, weights, "valid") for column in around] if is_between else around[:, 2:-1]
    ).T


def first_order_lag(values: Series, *, step_s: float, lag_s: float) -> Series:
    """Held `values` behind a first-order lag that starts at rest at the first one."""
    return actuator_state(values[:, None], step_s=step_s, lag_s=lag_s, delay_s=0.0)[:, 0]


def lagged_between_stamps(values: Series, time_s: Series, lag_s: float) -> Series:
    """Values that hold between stamps, behind a first-order lag that starts at rest at the first one."""
    if values.size < 2:
        return values
    decay = np.exp(-np.maximum(np.diff(time_s), 0.0) / lag_s)
    band = np.ones((2, values.size), order="F")
    band[1, :-1] = -decay
    driven = np.concatenate([[0.0], (1.0 - decay) * (values[:-1] - values[0])])
    state = scipy.linalg.lapack.dtbtrs(band, driven[:, None], uplo="L", diag="U")[0][:, 0]
    return np.asarray(state + values[0])


#: Weights that are found one by one before the number of them is doubled.
FIRST_WEIGHTS = 32


def filtered(weights: Float[np.ndarray, " m"], values: Series) -> Series:
    """sum_j w_j x(k - j) for each k, as long as the values; weights left out are zero. Performs no checks."""
    count = values.size
    if weights.size == 1:
        return weights[0] * values
    length = padded_length(max(count, weights.size))
    spectrum = np.fft.rfft(weights[:count], length) * np.fft.rfft(values, length)
    return np.asarray(np.fft.irfft(spectrum, length)[:count])


def cascaded(first: Float[np.ndarray, " m"], second: Float[np.ndarray, " k"]) -> Series:
    """Weights of two filters in a row, as many as the longer one has. Performs no checks."""
    longer, shorter = (first, second) if first.size >= second.size else (second, first)
    return filtered(shorter, longer)


def reciprocal(weights: Series) -> Series:
    """Weights of the inverse filter: those that make 1, 0, 0, ... of the filter's own."""
    first = weights[:FIRST_WEIGHTS]
    first_weights = np.zeros(first.size)
    first_weights[0] = 1.0 / first[0]
    for k in range(1, first.size):  # weight by weight: quadratic, for a few of them
        first_weights[k] = -(first[1 : k + 1] @ first_weights[k - 1 :: -1]) / first[0]
    while first_weights.size < weights.size:
        count = min(2 * first_weights.size, weights.size)
        padded = np.zeros(count)
        padded[: first_weights.size] = first_weights
        residual = -filtered(weights[:count], padded)
        residual[: first_weights.size] = 0.0  # right but for rounding: 1, 0, 0, ...
        first_weights = padded + filtered(padded, residual)
    return first_weights


#: Central differences over one, two and three samples to each side: exact for polynomials of degree six.
WEIGHTS = (45.0 / 60.0, -9.0 / 60.0, 1.0 / 60.0)


def time_derivative(values: Series, step_s: float) -> Series:
    """Derivative of a series by central differences of seven samples; of fewer near its ends, zero of one."""
    half = len(WEIGHTS)
    if values.size <= 2 * half:
        return np.gradient(values, step_s) if values.size > 1 else np.zeros(values.size)
    weights = np.array([-weight for weight in reversed(WEIGHTS)] + [0.0, *WEIGHTS])
    middle = np.correlate(values, weights, "valid") / step_s
    first, last = np.gradient(np.stack([values[: half + 1], values[-half - 1 :]]), step_s, axis=1)
    return np.concatenate([first[:-1], middle, last[1:]])


#: Prime factors of quick lengths: of fewer kinds more samples would be lost.
FACTORS = (2, 3, 5, 7, 11, 13, 17, 19, 23)


def fast_length(count: int) -> int:
    """Return the largest length up to a count, from 1 on, that has small prime factors only."""
    # a length divides a high power of the product of the factors when it has no others
    power = prod(FACTORS) ** max(count.bit_length(), 1)
    return next(length for length in range(count, 0, -1) if power % length == 0)


def low_passed(values: Columns, *, step_s: float, cutoff_hz: float) -> Columns:
    """Columns behind the filter, which has seen their first values for ever."""
    s = np.sqrt(2.0) * np.pi * cutoff_hz
    t = step_s * np.arange(1, 4)
    ramp = t - (1.0 - np.exp(-s * t) * np.cos(s * t)) / s
    first, second = -2.0 * np.exp(-s * step_s) * np.cos(s * step_s), np.exp(-2.0 * s * step_s)
    bends = np.diff([0.0, 0.0, *ramp], 2) / step_s
    start = values[0]
    deviation = values - start
    driven = np.zeros(deviation.shape, order="F")
    for late, weight in enumerate(np.convolve([1.0, first, second], bends)[:3]):
        driven[late:] += weight * deviation[: deviation.shape[0] - late]
    band = np.empty((3, values.shape[0]), order="F")
    band[0], band[1], band[2] = 1.0, first, second
    filtered: Columns = scipy.linalg.lapack.dtbtrs(band, driven, uplo="L", diag="U", overwrite_b=True)[0]
    filtered += start
    return filtered


#: Samples to each side of a line's fit: a second of a slow log, and too short for a clock to drift.
REACH = 25
#: Fewer backward stamps than this share are slips.
BACKWARD_SHARE = 0.005
#: Backward step of stamps, in usual distances, beyond which the clock was set.
FURTHEST = 5.0
#: Distance, in usual ones, that is a pause: lines end there.
PAUSE = 10.0


#: Stamps that are closer, but not equal, were written together: no sensor is sampled so often [s].
BURST_S = 1e-4
#: Shares of such distances in bursts of up to 20 samples; more are a clock in another unit.
BURST_SHARES = 0.4, 0.95


def in_bursts(distances: Series) -> bool:
    """Whether samples were written in bursts, which have stamps of their writing."""
    close = np.count_nonzero((distances > 0.0) & (distances < BURST_S))
    low, high = (share * distances.size for share in BURST_SHARES)
    return bool(close > 0 and low <= close <= high)


def evened(time_s: Series) -> Series:
    """Stamps with their errors averaged out, where they err; else the same array."""
    if time_s.size <= 2 * REACH:
        return time_s
    distances = np.diff(time_s)
    if in_bursts(distances):
        return on_lines(time_s, PAUSE * float(np.median(distances[distances >= BURST_S])))
    back = distances[distances < 0.0]
    if back.size < BACKWARD_SHARE * time_s.size:
        return time_s
    usual = float(np.mean(distances[np.abs(distances) <= PAUSE * np.median(np.abs(distances))]))
    if usual <= 0.0 or float(back.min()) < -FURTHEST * usual:
        return time_s
    return on_lines(time_s, PAUSE * usual)


def on_lines(time_s: Series, longest_s: float) -> Series:
    """Each stamp on the line through those around it, whether they err or not."""
    ends = np.flatnonzero(np.diff(time_s) > longest_s) + 1
    return np.concatenate([_on_lines(part) for part in np.split(time_s, ends)])


def _on_lines(time_s: Series) -> Series:
    """Value at each sample of the least squares line through the stamps around it, against their numbers."""
    count = time_s.size
    if count < 3:
        return time_s
    number = np.arange(count, dtype=np.float64)
    low = np.maximum(np.arange(count) - REACH, 0)
    high = np.minimum(np.arange(count) + REACH + 1, count)
    # against numbers from the sample itself on, and times from those of an even clock: small sums
    even = time_s[0] + number * (time_s[-1] - time_s[0]) / (count - 1)
    deviation = time_s - even
    width = high - low

    def window(values: Series) -> Series:
        total = np.concatenate([[0.0], np.cumsum(values)])
        return np.asarray(total[high] - total[low])

    middle = window(number) / width
    spread = window(number**2) - width * middle**2
    mean = window(deviation) / width
    slope = (window(number * deviation) - width * middle * mean) / spread
    return np.asarray(even + mean + slope * (number - middle))


#: After this time a value whose rate is limited has caught up [s].
CAUGHT_UP_S = 2.0
#: Mean step over the usual one at most: closer stamps are not those of commands.
MOST_QUICKER = 10.0


def rate_limited(
    values: Float[np.ndarray, " n"], time_s: Float[np.ndarray, " n"], limits: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "k n"]:
    """Values that follow those given by no more than each limit [1/s]; blocks are computed side by side."""
    values = values[np.maximum.accumulate(np.where(np.isfinite(values), np.arange(values.size), 0))]
    step = np.diff(time_s, prepend=time_s[0])
    usual_s = max(float(np.median(step)), float(np.mean(step)) / MOST_QUICKER, 1e-6)
    block = max(int(CAUGHT_UP_S / usual_s), 1)
    # each block begins a block earlier
    rows = (np.arange(-block, block)[:, None] + np.arange(0, values.size, block)).clip(0, values.size - 1)
    inputs, steps = values[rows], step[rows][:, None] * limits[:, None]
    state, results = np.broadcast_to(inputs[0], steps.shape[1:]), np.empty(steps.shape)
    for k in range(2 * block):
        np.maximum(inputs[k], state - steps[k], out=results[k])
        state = np.minimum(results[k], state + steps[k], out=results[k])
    return results[block:].transpose(1, 2, 0).reshape(limits.size, rows.shape[1] * block)[:, : values.size]


#: Half of a variation at this frequency is taken out of an integral [Hz].
SLOW_HZ = 0.05


def integrated(rate: Float[np.ndarray, " length"], step_s: float) -> Float[np.ndarray, " length"]:
    """Integral behind a zero-phase Butterworth high-pass of the second order."""
    integral = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))]) * step_s
    detrended = integral - np.linspace(integral[0], integral[-1], integral.size)
    frequency = np.fft.rfftfreq(detrended.size, step_s)
    gain = np.zeros(frequency.size)
    gain[1:] = 1.0 / (1.0 + (SLOW_HZ / frequency[1:]) ** 4)
    return np.asarray(np.fft.irfft(gain * np.fft.rfft(detrended), detrended.size))
