"""What a motion takes from a log: which channels in which role, and which samples count."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from eivor.errors import MissingChannelError, UsageError
from eivor.flights.between import Between, curve_between, line_between
from eivor.signals.recording import Channel, Finding, Recording


@dataclass(frozen=True, slots=True)
class InputFamily:
    """Channels that may drive a vehicle, one for each actuator or one for all.

    Parameters
    ----------
    name : str
        The channel, or what stands before the actuators' numbers ("rotor_command").
    measured : bool
        True for the actuators' measured state, which does not lag, and may be late or early.
    input_map : str
        Name of the map from its values to what enters the equation.
    numbered : bool
        One channel for each actuator, told by numbers from 1 on.
    least_rate_hz : float
        Slower channels are passed over where there is another family [Hz].
    """

    name: str
    measured: bool = False
    input_map: str = "linear"
    numbered: bool = False
    least_rate_hz: float = 0.0

    def holds(self, channel: str) -> bool:
        """Return whether a channel is this one, or one of this family."""
        stem, _, number = channel.rpartition("_")
        return channel == self.name or (stem == self.name and number.isdecimal())


@dataclass(frozen=True, slots=True)
class Limit:
    """Samples count only where a channel is within bounds.

    Parameters
    ----------
    channel : str
        Name.
    low, high : float
        Bounds, both included, in the channel's unit.
    """

    channel: str
    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True)
class Selection:
    """Channels of one log by their role.

    Parameters
    ----------
    input : InputFamily
        What drives the vehicle. After a gap in it the actuator's state is not known for a while.
    commands : tuple of Channel
        Its channels.
    states : mapping of str to Channel
        By role, what the equation needs beside the input ("velocity").
    responses : mapping of str to Channel or None
        By role, what the equation explains; None for what the log lacks and the motion can do without.
        The grid is fine when these and the commands are fast.
    conditions : tuple of Channel
        Others that enter.
    constants : mapping of str to float
        Values in place of conditions that the log lacks.
    limits : tuple of Limit
        Which samples count.
    band_hz : tuple of float
        Band of spectral rows [Hz].
    findings : tuple of Finding
        What a reader of the result should know of the choice.
    issued_within_s : float
        The longest that the next command can be waited for [s], where the command's stamps do not tell.
    step_s : float, optional
        Step of the grid [s]. Default: by the rates of commands and responses.
    spread_alike : bool
        What was measured is a line between its stamps, and is spread over time as the line between the stamps
        of a thinned command spreads what was issued, so that both sides of the equation are; the band is then
        kept whole. Else it is a curve.
    """

    input: InputFamily
    commands: tuple[Channel, ...]
    states: Mapping[str, Channel]
    responses: Mapping[str, Channel | None]
    conditions: tuple[Channel, ...] = ()
    constants: Mapping[str, float] = field(default_factory=dict)
    limits: tuple[Limit, ...] = ()
    band_hz: tuple[float, float] = (0.04, 5.0)
    findings: tuple[Finding, ...] = ()
    issued_within_s: float = math.inf
    step_s: float | None = None
    spread_alike: bool = False

    def between(self, channel: Channel) -> Between:
        """What a channel was between its stamps."""
        measured = any(channel is one for one in (*self.states.values(), *self.responses.values()))
        return curve_between if measured and not self.spread_alike else line_between

    @property
    def logged_responses(self) -> tuple[Channel, ...]:
        """Responses that are in the log."""
        return tuple(channel for channel in self.responses.values() if channel is not None)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Every channel that is put on the grid."""
        return (*self.states.values(), *self.commands, *self.logged_responses, *self.conditions)

    @property
    def command_names(self) -> frozenset[str]:
        """Names of the channels that drive the vehicle."""
        return frozenset(command.name for command in self.commands)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Roles of what was measured whose channel comes from an estimator."""
        measured = {**self.states, **self.responses}
        return tuple(role for role, channel in measured.items() if channel is not None and channel.estimated)

    @property
    def rates_hz(self) -> dict[str, float]:
        """Mean logging rate of the slowest command, and by role of what was measured; 0 when absent [Hz]."""
        measured = {**self.states, **self.responses}
        slowest = min(channel.rate_hz for channel in self.commands)
        return {"command": slowest} | {
            role: 0.0 if channel is None else channel.rate_hz for role, channel in measured.items()
        }


def chosen_input(
    log: Recording, families: tuple[InputFamily, ...], wanted: str, *, remedy: str
) -> tuple[InputFamily, tuple[Channel, ...]]:
    """Family and channels of the input: the one that is wanted, or the first that the log has.

    Parameters
    ----------
    log : Recording
        Where to look.
    families : tuple of InputFamily
        In order of preference.
    wanted : str
        Channel or family that a user named; empty for none.
    remedy : str
        What to log, as a beginning of a sentence: ", or name a channel with --input." follows.

    Raises
    ------
    UsageError
        When the log does not have the one that is wanted.
    MissingChannelError
        When it has none.
    """
    if wanted:
        name = wanted.rstrip("*").rstrip("_")
        channels = log.family(name)
        if not channels:
            raise UsageError(
                f"an input out of the channels {', '.join(sorted(log.channels))}",
                f"'{wanted}'",
                f"Name a channel, or a family such as {families[0].name}.",
            )
        own = next((family for family in families if family.holds(name)), InputFamily(name))
        return replace(own, name=name), tuple(channels)
    logged = [(family, tuple(channels)) for family in families if (channels := log.family(family.name))]
    for family, members in logged:
        if min(channel.rate_hz for channel in members) >= family.least_rate_hz:
            return family, members
    if logged:
        return logged[0]
    looked = sorted({source for family in families for source in log.looked_for.get(family.name, ())})
    raise MissingChannelError(
        f"an input in {log.name}: {_in_words(families)}",
        f"a log without one (looked for: {', '.join(looked) or 'those names'})",
        f"{remedy}, or name a channel with --input.",
    )


def _in_words(families: tuple[InputFamily, ...]) -> str:
    names = [f"{family.name}_1.." if family.numbered else family.name for family in families]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])}, or {names[-1]}"
