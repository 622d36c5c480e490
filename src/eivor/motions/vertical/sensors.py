"""Whether velocity and accelerometer tell the same vertical acceleration.

With D the derivative of the velocity, A the acceleration of the accelerometer and attitude, and a their mean,

    D - A = o da/dt + s a + e_f (-a_f) + e_l (-a_l) :

the accelerometer is behind the velocity by o, the velocity reads more by the share s, and the up that
attitude and accelerometer make leans forward by e_f and to the left by e_l [rad], which lets the horizontal
accelerations a_f, a_l in. These come from the horizontal velocities, where the vehicle moved sideways;
without an attitude along the world's axes x and y. Instruments are those of the flight and, for the
horizontal accelerations, the horizontal velocities and lags of them, whose errors are others than D - A's.

What can be taken out is taken out of the sensor that is wrong. One is late and none is early, so the later
one is moved. An accelerometer whose scale is wrong shows another gravity; where its mean is nearer to the
right one, the velocity is scaled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from eivor.flights.agreement import Difference, SensorAgreement
from eivor.flights.allowance import Allowance, Counts
from eivor.flights.grid import on_grid
from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Unjudged
from eivor.models.equation import Parameter
from eivor.models.lagged_runs import AxisColumns, LaggedRuns, nothing_moves
from eivor.motions.vertical.flights import VerticalFlights
from eivor.motions.vertical.model import GRAVITY
from eivor.shapes import Float
from eivor.signals.actuator import first_order_lag

OFFSET = Parameter("offset", "s")
SCALE = Parameter("scale", "")
TILTS = {name: Parameter(f"tilt_{name}", "rad") for name in ("forward", "left", "x", "y")}
#: Smaller differences matter to no result.
LEAST = {OFFSET.name: 0.001, SCALE.name: 0.005} | {
    tilt.name: float(np.deg2rad(0.3)) for tilt in TILTS.values()
}
#: One sensor that reads so many times what the other does is in another unit.
OTHER_UNIT_TIMES = 2.0
#: No sensor is mounted so far off [degrees].
LARGEST_TILT_DEG = 20.0
#: The vehicle moved sideways when its horizontal speed varied by so much [m/s].
SIDEWAYS_SPEED = 0.3
#: Lags of the horizontal velocities that serve as instruments, one behind the other [s].
SIDEWAYS_LAGS_S = (0.2, 0.2, 0.4)


def difference_problem(problem: VerticalFlights, flights: Sequence[PreparedFlight]) -> LaggedRuns | None:
    """Regression of D - A on what each kind of disagreement would leave of it.

    Parameters
    ----------
    problem : VerticalFlights
        The flights' own problem, with instruments.
    flights : sequence of PreparedFlight
        The same flights, on the same samples.

    Returns
    -------
    LaggedRuns or None
        None without instruments, or where a flight has no accelerometer.
    """
    own = problem.runs.columns
    if any(one.responses.shape[1] < 2 or not one.instruments.shape[1] for one in own):
        return None
    sideways = [_sideways(flight) for flight in flights]
    names = tuple(sideways[0]) if all(one.keys() == sideways[0].keys() for one in sideways) else ()
    columns = tuple(
        _columns(one, [found[name] for name in names]) for one, found in zip(own, sideways, strict=True)
    )
    return LaggedRuns(columns, (OFFSET, SCALE, *(TILTS[name] for name in names)), ())


def _columns(own: AxisColumns, sideways: list[Float[np.ndarray, " n"]]) -> AxisColumns:
    """Columns of one flight, with its horizontal velocities."""
    A, D = own.responses.T
    a = 0.5 * (A + D)
    return replace(
        own,
        responses=(D - A)[:, None],
        fixed=np.column_stack(
            [np.gradient(a, own.step_s), a, *(-np.gradient(v, own.step_s) for v in sideways)]
        ),
        moving=nothing_moves(A.size),
        instruments=np.column_stack([own.instruments, *(_lags(v, own.step_s) for v in sideways)]),
    )


def sideways_speed(flights: Sequence[PreparedFlight]) -> float:
    """Root mean square of the horizontal speed, of the fastest flight; NaN where none is logged [m/s]."""
    found = [float("nan")]
    for flight in flights:
        channels = [flight.recording.channels.get(f"velocity_{axis}") for axis in "xy"]
        parts = [on_grid(one, flight.grid)[0][flight.used] for one in channels if one is not None]
        if len(parts) == 2:
            found.append(float(np.sqrt(np.mean(np.square(parts).sum(axis=0)))))
    return float(np.nanmax(found)) if len(found) > 1 else found[0]


def _lags(velocity: Float[np.ndarray, " n"], step_s: float) -> Float[np.ndarray, "n p"]:
    """A horizontal velocity and lags of it."""
    found = [velocity]
    for lag_s in SIDEWAYS_LAGS_S:
        found.append(first_order_lag(found[-1], step_s=step_s, lag_s=lag_s))
    return np.column_stack(found)


def _sideways(flight: PreparedFlight) -> dict[str, Float[np.ndarray, " n"]]:
    """Horizontal velocities along the vehicle's axes, or the world's, in which it moved."""
    log, used = flight.recording, flight.used
    if not {"velocity_x", "velocity_y"} <= log.channels.keys():
        return {}
    (east, known_x), (north, known_y) = (
        on_grid(log.channels[f"velocity_{axis}"], flight.grid) for axis in "xy"
    )
    if not (known_x & known_y)[used].all():
        return {}
    found = {"x": east, "y": north}
    heading = _heading(flight)
    if heading is not None:
        cosine, sine = heading
        found = {"forward": cosine * east + sine * north, "left": cosine * north - sine * east}
    return {name: v - v[used].mean() for name, v in found.items() if v[used].std() > SIDEWAYS_SPEED}


def _heading(flight: PreparedFlight) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]] | None:
    """Cosine and sine of the yaw on the flight's grid; None without an attitude."""
    parts = [flight.recording.channels.get(f"attitude_{axis}") for axis in "wxyz"]
    known = [channel for channel in parts if channel is not None and channel.time_s.size]
    if len(known) != 4 or any(not np.array_equal(one.time_s, known[0].time_s) for one in known):
        return None
    w, x, y, z = (channel.values for channel in known)
    ahead = w**2 + x**2 - y**2 - z**2, 2.0 * (w * z + x * y)
    cosine, sine = (on_grid(replace(known[0], values=part), flight.grid)[0] for part in ahead)
    length = np.hypot(cosine, sine)
    if not length[flight.used].all():
        return None
    length = np.where(length > 0.0, length, 1.0)
    return cosine / length, sine / length


# -- in words -----------------------------------------------------------------------------------------------


def sentence(name: str, found: Difference) -> str:
    """What a difference is, with number and unit."""
    value, half = found.value, found.half_width
    if name == OFFSET.name:
        late, early = ("accelerometer", "velocity") if value > 0.0 else ("velocity", "accelerometer")
        return f"The {late} is {1e3 * abs(value):.1f} ± {1e3 * half:.1f} ms behind the {early}."
    if name == SCALE.name:
        return _scale_sentence(value, half)
    along = {
        "tilt_forward": ("forward", "backward"),
        "tilt_left": ("to the left", "to the right"),
        "tilt_x": ("along x", "against x"),
        "tilt_y": ("along y", "against y"),
    }[name][int(value < 0.0)]
    degrees, width = np.rad2deg([abs(value), half])
    if degrees > LARGEST_TILT_DEG:
        return (
            f"Attitude and accelerometer do not go together: it would take a tilt of {degrees:.0f} ± "
            f"{width:.0f} degrees {along}. Check their axes and signs."
        )
    return f"Attitude and accelerometer differ by {degrees:.1f} ± {width:.1f} degrees {along}."


def velocity_over_accelerometer(scale: float) -> float:
    """What the velocity reads over what the accelerometer does, of their difference over both's mean."""
    return (1.0 + scale / 2.0) / (1.0 - scale / 2.0) if scale != 2.0 else np.inf


def _scale_sentence(scale: float, half: float) -> str:
    times = velocity_over_accelerometer(scale)
    if times < 0.0:
        return "The velocity goes down where the accelerometer goes up."
    if not 1.0 / OTHER_UNIT_TIMES < times < OTHER_UNIT_TIMES:
        return f"The velocity reads {times:.3g} times what the accelerometer does."
    more = "more" if scale > 0.0 else "less"
    width = half / (1.0 - scale / 2.0) ** 2
    return f"The velocity reads {abs(times - 1.0):.1%} (± {width:.1%}) {more} than the accelerometer."


def either_sentence(agreement: SensorAgreement) -> str:
    """What the differences are of which the flight does not tell which is there."""
    said = " Or: ".join(sentence(name, one) for name, one in agreement.either.items())
    return f"{said} This flight does not tell which." if len(agreement.either) > 1 else said


def told(agreement: SensorAgreement) -> str:
    """What is told of both sensors, in a line."""
    said = [sentence(name, one) for name, one in agreement.told.items()]
    if agreement.either:
        said.append(either_sentence(agreement))
    if agreement.otherwise:
        said.append("Velocity and accelerometer disagree in another way than these.")
    if said:
        return " ".join(said)
    known = agreement.differences
    offset, scale = known[OFFSET.name], known[SCALE.name]
    tilts = [one for name, one in known.items() if name not in (OFFSET.name, SCALE.name)]
    leaning = "".join(
        f", tilt {np.rad2deg(one.value):+.1f} ± {np.rad2deg(one.half_width):.1f} degrees" for one in tilts
    )
    return (
        f"velocity and accelerometer agree: offset {1e3 * offset.value:+.1f} ± "
        f"{1e3 * offset.half_width:.1f} ms, scale {100 * scale.value:+.1f} ± "
        f"{100 * scale.half_width:.1f} %{leaning}"
    )


# -- in intervals -------------------------------------------------------------------------------------------


def sensor_allowances(
    agreement: SensorAgreement | None, quantities: Mapping[str, Unjudged], *, aligned: bool
) -> dict[str, list[Allowance]]:
    """What disagreeing sensors add to intervals; of aligned ones, what is not known of the alignment.

    A sensor may be late, and cannot be early: the lag was sought between the clocks of both, and may be
    shorter by all of the offset. A velocity that reads more lets K come out too small, as does an
    accelerometer that reads less.
    """
    found: dict[str, list[Allowance]] = {}
    if agreement is None:
        return found
    differences = agreement.told
    if OFFSET.name in differences:
        offset = differences[OFFSET.name]
        below, above = (offset.half_width,) * 2 if aligned else (abs(offset.value), 0.0)
        why = f"{sentence(OFFSET.name, offset)} {_moved(aligned=aligned)}"
        for name in ("actuator_lag", "effective_lag"):
            found[name] = [Allowance(Counts.ADDED, below, above, why)]
    if SCALE.name in differences:
        scale = differences[SCALE.name]
        why = f"{sentence(SCALE.name, scale)} {_moved(aligned=aligned)}"
        size = scale.half_width if aligned else abs(scale.value)
        for name in ("viscous_friction", "input_gain"):
            part = size * abs(quantities[name].value)
            below = above = part
            if name == "viscous_friction" and not aligned:
                below, above = (0.0, part) if scale.value > 0.0 else (part, 0.0)
            found[name] = [Allowance(Counts.ADDED, below, above, why)]
    return found


def _moved(*, aligned: bool) -> str:
    return "It was aligned, as well as that is known." if aligned else "Which of them is right is not known."


# -- aligned ------------------------------------------------------------------------------------------------


def aligned(flights: tuple[PreparedFlight, ...], agreement: SensorAgreement) -> tuple[PreparedFlight, ...]:
    """Flights with offset and scale taken out of the sensor that is wrong."""
    known = agreement.told
    offset_s = known[OFFSET.name].value if OFFSET.name in known else 0.0
    scale = known[SCALE.name].value if SCALE.name in known else 0.0
    return tuple(_aligned(flight, offset_s, scale) for flight in flights)


def _aligned(flight: PreparedFlight, offset_s: float, scale: float) -> PreparedFlight:
    channels = dict(flight.signals.channels)
    late = "specific_force_z" if offset_s > 0.0 else "velocity_z"
    channels[late] = _earlier(channels[late], flight, abs(offset_s))
    force, velocity = channels["specific_force_z"], channels["velocity_z"]
    if flight.runs and scale:
        resting = force - np.gradient(velocity, flight.signals.step_s)
        gravity = float(resting[flight.used].mean())
        # a mean that is off by more than half of the scale is that of a wrong accelerometer
        if abs(gravity * (1.0 + scale) - GRAVITY) < abs(gravity - GRAVITY):
            channels["specific_force_z"] = (1.0 + scale) * force
        else:
            channels["velocity_z"] = velocity / (1.0 + scale)
    return replace(flight, signals=replace(flight.signals, channels=channels))


def _earlier(
    values: Float[np.ndarray, " n"], flight: PreparedFlight, offset_s: float
) -> Float[np.ndarray, " n"]:
    """Values of a sensor that is late by `offset_s`, as they would have been logged in time."""
    time = flight.grid.time_s
    moved: Float[np.ndarray, " n"] = np.interp(time + offset_s, time, values)
    return moved
