"""From a recording to a flight that can be identified: channels, grid, tilt, segments, references.

Nothing is estimated here. What is wrong with a flight becomes a finding, so that it can be reported
beside the numbers; only what makes numbers impossible raises.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from eivor.errors import MissingChannelError, UsageError
from eivor.flights.airborne import Airborne, airborne
from eivor.flights.frames import upward, vertical_row
from eivor.flights.grid import Grid, common_grid, on_grid, unbroken
from eivor.flights.noise_level import white_noise_std
from eivor.flights.options import FlightOptions
from eivor.flights.references import CLEAN, FEEDBACK, Reference, named_reference, references
from eivor.models.vertical import GRAVITY
from eivor.models.vertical_flights import VerticalFlight
from eivor.signals.noise import WhiteNoise
from eivor.signals.recording import Channel, Finding, Recording, interval_within
from eivor.signals.signals import Signals

#: Families of channels that may drive the vertical model, in order of preference.
INPUTS = ("rotor_command", "rotor_speed", "input")
MEASURED_INPUTS = ("rotor_speed",)
#: Runs shorter than this are left out [s].
SHORTEST_RUN_S = 3.0
#: Band of spectral rows [Hz]; the upper end is lower when velocity is logged near 10 Hz.
BAND_HZ = (0.04, 5.0)
SLOW_BAND_HZ = (0.04, 4.0)
SLOW_VELOCITY_HZ = 15.0
#: The logged acceleration is preferred to the accelerometer and attitude unless it is slower than this.
SLOW_ACCELERATION_HZ = 20.0
#: A height that is known for a smaller share of the log cannot say where the ground is.
HEIGHT_KNOWN_SHARE = 0.5
#: An input whose standard deviation is below this share of its mean is constant.
CONSTANT_INPUT_SHARE = 1e-6


@dataclass(frozen=True)
class PreparedFlight:
    """A flight on its grid, with everything that the recipe and the verdict need to know of it.

    Parameters
    ----------
    recording : Recording
        The log, z up.
    flight : VerticalFlight
        Signals and runs; without runs nothing can be estimated.
    input_map : str
        Name of the input map.
    references : tuple of Reference
        Candidate instruments.
    airborne : Airborne
        Where it flies.
    usable : ndarray of bool, shape (n,)
        Samples in the air, in the window, below the largest tilt, and standing on data.
    rates_hz : dict of str to float
        Mean logging rates of "command", "velocity", "acceleration" (0 when absent).
    findings : tuple of Finding
        Named diagnostics.
    """

    recording: Recording
    flight: VerticalFlight
    input_map: str
    references: tuple[Reference, ...]
    airborne: Airborne
    usable: Bool[np.ndarray, " n"]
    rates_hz: dict[str, float]
    findings: tuple[Finding, ...]

    @property
    def usable_references(self) -> tuple[str, ...]:
        """Names of the references that may serve as instruments."""
        return tuple(reference.name for reference in self.references if reference.usable)

    @property
    def constant_input(self) -> bool:
        """The input does not vary over the runs."""
        if not self.flight.runs:
            return False
        level = self.flight.signals.family(self.flight.input)[self.used]
        spread = float(level.std(axis=0).max())
        return spread <= CONSTANT_INPUT_SHARE * max(float(np.abs(level).max()), 1e-12)

    @property
    def used(self) -> Bool[np.ndarray, " n"]:
        """Samples of the runs."""
        return _mask(self.flight.runs, self.usable.size)


def prepare(recording: Recording, options: FlightOptions) -> PreparedFlight:
    """Put a recording on one grid and find the runs that can be used.

    Raises
    ------
    MissingChannelError
        When velocity, input, or the options' channels are not in the log.
    InputError
        When the channels share no time.
    UsageError
        When the window lies outside the log.
    """
    log = upward(recording)
    family, commands = _input(log, options.input)
    velocity = log.channel("velocity_z")
    acceleration, tilt, findings = _acceleration_and_tilt(log)
    needed = [velocity, *commands] + ([acceleration] if acceleration else []) + ([tilt] if tilt else [])
    for channel in needed:
        _refuse_empty(log, channel)
    grid = common_grid(needed, [*commands, *([acceleration] if acceleration else [])])
    channels: dict[str, Float[np.ndarray, " n"]] = {}
    good = np.ones(grid.count, dtype=np.bool_)
    for channel in needed:
        values, stands = on_grid(channel, grid)
        channels[channel.name] = values
        good &= unbroken(channel, grid, stands) if channel in commands else stands
    channels.setdefault("cos_tilt", np.ones(grid.count))
    flies = _airborne(log, grid, np.stack([channels[c.name] for c in commands], axis=1))
    usable = good & flies.mask & (channels["cos_tilt"] >= np.cos(np.deg2rad(options.max_tilt_deg)))
    if options.window is not None:
        start, end = interval_within(options.window, log.span_s)
        usable &= (grid.time_s >= start) & (grid.time_s <= end)
    runs = Signals(1.0 / grid.step_s, channels, valid=usable).runs(SHORTEST_RUN_S)
    used = _mask(runs, grid.count)
    candidates = _references(log, grid, used, options)
    channels.update({reference.name: reference.values for reference in candidates if reference.usable})
    signals = Signals(
        1.0 / grid.step_s,
        channels,
        noise=_noise(channels, used, acceleration is not None),
        valid=usable,
        start_s=grid.start_s,
    )
    slow = velocity.rate_hz < SLOW_VELOCITY_HZ
    measured = family in MEASURED_INPUTS or family.rsplit("_", 1)[0] in MEASURED_INPUTS
    flight = VerticalFlight(signals, family, measured, tuple(runs), SLOW_BAND_HZ if slow else BAND_HZ)
    rates = {
        "command": min(channel.rate_hz for channel in commands),
        "velocity": velocity.rate_hz,
        "acceleration": acceleration.rate_hz if acceleration else 0.0,
    }
    return PreparedFlight(
        log,
        flight,
        options.input_map or log.input_map or ("square" if family.startswith("rotor_") else "linear"),
        candidates,
        flies,
        usable,
        rates,
        (*log.findings, *findings),
    )


def _input(log: Recording, wanted: str) -> tuple[str, list[Channel]]:
    """Family and channels of the input."""
    for family in (wanted.rstrip("*").rstrip("_"),) if wanted else INPUTS:
        channels = log.family(family)
        if channels:
            return family, channels
    looked = sorted({source for name in INPUTS for source in log.looked_for.get(name, ())})
    if wanted:
        raise UsageError(
            f"an input out of the channels {', '.join(sorted(log.channels))}",
            f"'{wanted}'",
            "Name a channel, or a family such as rotor_command.",
        )
    raise MissingChannelError(
        f"an input in {log.name}: rotor_command_1.., rotor_speed_1.., or input",
        f"a log without one (looked for: {', '.join(looked) or 'those names'})",
        "Log the thrust setpoint or the rotor commands at 50 Hz or more, or name a channel with --input.",
    )


def _acceleration_and_tilt(log: Recording) -> tuple[Channel | None, Channel | None, list[Finding]]:
    """World-up specific force and cosine of tilt, each on a clock of its own."""
    attitude = [log.channels.get(f"attitude_{axis}") for axis in "wxyz"]
    present = [channel for channel in attitude if channel is not None]
    row = vertical_row(present) if len(present) == 4 else None
    findings: list[Finding] = []
    tilt = _told(log, "cos_tilt", findings)
    if tilt is None and row is not None:
        tilt = Channel("cos_tilt", row[0], row[1][:, 2], "", "attitude quaternion")
    if tilt is None:
        findings.append(
            Finding("no_attitude", "No attitude is logged: the vehicle is taken as level throughout.")
        )
    force = _told(log, "specific_force_z", findings)
    logged = _told(log, "acceleration_z", findings)
    if force is None and logged is not None:
        force = Channel(
            "specific_force_z", logged.time_s, logged.values + GRAVITY, "m/s^2", logged.source, logged.held
        )
    body = [log.channels.get(f"specific_force_body_{axis}") for axis in "xyz"]
    if force is None or force.rate_hz < SLOW_ACCELERATION_HZ:
        rotated = _rotated(body, row)
        if rotated is not None and (force is None or rotated.rate_hz > force.rate_hz):
            force = rotated
    if force is None:
        findings.append(
            Finding("no_accelerometer", "No accelerometer is logged: only the velocity's derivative is used.")
        )
    return force, tilt, findings


def _told(log: Recording, name: str, findings: list[Finding]) -> Channel | None:
    """Channel of that name if it has two numbers or more; a finding when it is there and has not."""
    channel = log.channels.get(name)
    if channel is None or np.isfinite(channel.values).sum() >= 2:
        return channel
    findings.append(Finding("empty_channel", f"The channel {name} is empty; the flight is used without it."))
    return None


def _rotated(
    body: list[Channel | None], row: tuple[Float[np.ndarray, " n"], Float[np.ndarray, "n 3"]] | None
) -> Channel | None:
    """World-up specific force from the body's and the attitude, on the accelerometer's clock."""
    axes = [channel for channel in body if channel is not None]
    if len(axes) != 3 or row is None or row[0].size == 0:
        return None
    time = axes[2].time_s
    if not all(channel.time_s.size for channel in axes):
        return None
    columns = [
        channel.values
        if np.array_equal(channel.time_s, time)
        else np.interp(time, channel.time_s, channel.values)
        for channel in axes
    ]
    up = [np.interp(time, row[0], row[1][:, axis]) for axis in range(3)]
    values = sum((u * column for u, column in zip(up, columns, strict=True)), np.zeros(time.size))
    inside = (time >= row[0][0]) & (time <= row[0][-1])
    return Channel("specific_force_z", time[inside], values[inside], "m/s^2", "accelerometer and attitude")


def _refuse_empty(log: Recording, channel: Channel) -> None:
    if channel.time_s.size < 2 or not np.isfinite(channel.values).any():
        raise MissingChannelError(
            f"values in the channel '{channel.name}' of {log.name}",
            f"{channel.time_s.size} samples, {int(np.isfinite(channel.values).sum())} of them numbers",
            "Log it, or use another channel.",
        )


def _airborne(log: Recording, grid: Grid, commands: Float[np.ndarray, "n rotors"]) -> Airborne:
    landed = height = None
    if "landed" in log.channels:
        on_ground, known = on_grid(log.channels["landed"], grid)
        if known.any():
            landed = (on_ground > 0.5) | ~known
            if "ground_contact" in log.channels:
                touching, told = on_grid(log.channels["ground_contact"], grid)
                landed |= told & (touching > 0.5)
    if "position_z" in log.channels:
        level, known = on_grid(log.channels["position_z"], grid)
        height = level if known.mean() >= HEIGHT_KNOWN_SHARE else None
    return airborne(input_level=commands.mean(axis=1), step_s=grid.step_s, landed=landed, height=height)


def _references(
    log: Recording, grid: Grid, used: Bool[np.ndarray, " n"], options: FlightOptions
) -> tuple[Reference, ...]:
    named = [name for name in options.instruments if name not in {"references", "lags"}]
    if not named:
        return references(log, grid, used)
    automatic = {reference.name: reference for reference in references(log, grid, used)}
    return tuple(
        automatic[name]
        if name in automatic and name in CLEAN and automatic[name].usable
        else named_reference(log, name, grid)
        for name in named
    )


def _noise(
    channels: dict[str, Float[np.ndarray, " n"]], used: Bool[np.ndarray, " n"], accelerometer: bool
) -> dict[str, WhiteNoise]:
    """White noise levels, read off above the band; what total least squares scales its columns by."""
    names = ["velocity_z"] + (["specific_force_z"] if accelerometer else [])
    levels = {name: white_noise_std(channels[name][used]) for name in names}
    return {name: WhiteNoise(level) for name, level in levels.items()}


def _mask(runs: Sequence[slice], count: int) -> Bool[np.ndarray, " n"]:
    mask = np.zeros(count, dtype=np.bool_)
    for run in runs:
        mask[run] = True
    return mask


def contains_feedback(flight: PreparedFlight) -> bool:
    """Return whether a reference that a position loop computes is among those that serve."""
    return FEEDBACK in flight.usable_references
