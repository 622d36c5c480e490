"""Fields of a bag's topics as columns of a channel map: ``/mavros/imu/data.linear_acceleration.z``.

The part before the first dot is the topic, the rest the field. The clock is ``stamp``, each topic's own: in
seconds, whatever the map says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from eivor.errors import ChannelMapError, EmptyLogError, did_you_mean
from eivor.logs.bags.derived import with_derived
from eivor.logs.bags.topics import BagTopic, RawTopic, as_columns, of_one_clock, start_ns
from eivor.logs.channel_map import ChannelMap, ChannelRule
from eivor.logs.columns import Columns
from eivor.logs.mapping import delay_findings, fitted_rules, listed, mapped_channels
from eivor.signals.recording import Channel, Finding

#: Names of the clock.
CLOCKS = ("stamp", "header.stamp", "timestamp")


def topic_of(column: str) -> str:
    """Return the topic that a column is of."""
    return column.partition(".")[0]


def mapped_topics(chosen: ChannelMap) -> set[str]:
    """Return the topics that a map names."""
    return {topic_of(column) for rule in chosen.rules for column in rule.expression.columns}


def map_channels(
    chosen: ChannelMap,
    raws: Mapping[str, RawTopic],
    available: Mapping[str, str],
    name: str,
    findings: list[Finding],
) -> dict[str, Channel]:
    """Return the channels that a map makes of a bag.

    Parameters
    ----------
    chosen : ChannelMap
        The map.
    raws : mapping of str to RawTopic
        The topics that it names, as far as they are there.
    available : mapping of str to str
        Types of all topics.
    name : str
        What to call the bag.
    findings : list of Finding
        Gets what is found.

    Raises
    ------
    ChannelMapError
        When the map does not fit.
    EmptyLogError
        When no channel has a value.
    """
    _check(chosen, available, name)
    columns = [as_columns(raw, raw.defined(), findings) for raw in raws.values()]
    topics = of_one_clock([one for one in columns if one is not None], findings)
    tables = {one.name: with_derived(one.kind, one.fields) for one in topics}
    names = [
        f"{topic}.{field}"
        for topic, fields in tables.items()
        for field, values in fields.items()
        if values.dtype.kind != "S"
    ]
    rules = fitted_rules(chosen, [*CLOCKS, *names], name)
    start = start_ns(topics) if topics else 0
    channels: dict[str, Channel] = {}
    for one in topics:
        served = [rule for rule in rules if topic_of(rule.expression.columns[0]) == one.name]
        made, found = _made(chosen, served, one, tables[one.name], start, name) if served else ({}, [])
        channels |= made
        findings += found
    if not channels:
        raise EmptyLogError(
            "a bag with values", f"'{name}', in which every mapped field is empty", "Check the map."
        )
    findings += delay_findings(channels, chosen.origin)
    return channels


def _made(
    chosen: ChannelMap,
    served: Sequence[ChannelRule],
    topic: BagTopic,
    fields: Mapping[str, object],
    start: int,
    name: str,
) -> tuple[dict[str, Channel], list[Finding]]:
    import numpy as np

    needed = dict.fromkeys(column for rule in served for column in rule.expression.columns)
    values = {
        column: np.asarray(fields[column.partition(".")[2]]).astype(np.float64, copy=False)
        for column in needed
    }
    values[chosen.time_column] = topic.seconds(start)
    return mapped_channels(chosen, served, Columns(values, seconds=frozenset({chosen.time_column})), name)


def _check(chosen: ChannelMap, available: Mapping[str, str], name: str) -> None:
    """Raise for a map that names no clock of a bag, topics that are not there, or several for one channel."""
    if chosen.time_column not in CLOCKS:
        raise ChannelMapError(
            f"the clock of a bag, '{CLOCKS[0]}' ({chosen.origin}, key time.column)",
            f"'{chosen.time_column}'",
            "Each topic has a clock of its own: the stamps of its messages.",
        )
    for rule in chosen.rules:
        topics = {topic_of(column) for column in rule.expression.columns}
        if len(topics) > 1:
            raise ChannelMapError(
                f"columns of one topic for channels.{rule.name} ({chosen.origin})",
                f"{listed(sorted(topics))}, whose clocks differ",
                "Take fields of one topic.",
            )
        missing = [topic for topic in topics if topic not in available]
        if missing and not rule.optional:
            raise ChannelMapError(
                f"a topic '{missing[0]}' ({chosen.origin}, key channels.{rule.name})",
                f"'{name}' with the topics {listed(sorted(available))}",
                did_you_mean(missing[0], sorted(available), "Correct the map: TOPIC.FIELD.", most=3),
            )
