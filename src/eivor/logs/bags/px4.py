"""Topics of `px4_msgs` in a bag, read as those of a ULog."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from eivor.errors import InputError
from eivor.logs.bags.layouts import Layout, UnsoundMessageError, message_layout
from eivor.logs.bags.px4_types import PACKAGE, px4_releases
from eivor.logs.bags.topics import BagTopic, RawTopic, as_columns, of_one_clock, start_ns
from eivor.logs.ulog.channels import read_topics
from eivor.logs.ulog.delays import unknown_filters
from eivor.logs.ulog.instances import Topic, choose_instance
from eivor.logs.ulog.topics import LOOKED_FOR, NEEDED_TOPICS
from eivor.logs.ulog.vehicle import vehicle_of
from eivor.signals.recording import Channel, Finding

#: Place of the vehicle, direction, name, number of the instance, version of the message.
_NAME = re.compile(
    r"(?P<vehicle>.*?)(?:/fmu/(?P<way>in|out))?/(?P<topic>[a-z_]\w*?)(?P<instance>\d*)(?:_v\d+)?"
)


def is_px4(name: str, kind: str) -> bool:
    """Say whether a topic is one of PX4's that channels are made of."""
    match = _NAME.fullmatch(name)
    return kind.startswith(f"{PACKAGE}/") and match is not None and match["topic"] in NEEDED_TOPICS


def px4_channels(raws: Sequence[RawTopic], findings: list[Finding]) -> tuple[dict[str, Channel], str]:
    """Return the channels of PX4's topics, z down, and the kind of vehicle.

    Parameters
    ----------
    raws : sequence of RawTopic
        For which `is_px4` holds.
    findings : list of Finding
        Gets what is found.

    Raises
    ------
    InputError
        When they are of several vehicles.
    """
    places = {match["vehicle"] for raw in raws if (match := _NAME.fullmatch(raw.name)) is not None}
    if len(places) > 1:
        raise InputError(
            "a bag of one vehicle",
            f"one with topics of {len(places)}: {', '.join(sorted(place or '/' for place in places)[:6])}",
            "Take one of them out with `ros2 bag convert`, or name its topics in a channel map (--map).",
        )
    layouts = _layouts(raws, findings)
    columns = [as_columns(raw, layouts[raw.name], findings) for raw in raws if raw.name in layouts]
    sound = of_one_clock([one for one in columns if one is not None], findings)
    if not sound:
        return {}, ""
    topics = _chosen(sound, findings)
    channels = read_topics(topics, np.uint64(start_ns(sound) // 1000), {}, findings)
    findings += unknown_filters(channels.values(), "A bag holds")
    return channels, vehicle_of(topics, {})


def looked_for() -> Mapping[str, tuple[str, ...]]:
    """What is looked for, by channel."""
    return LOOKED_FOR


def _chosen(sound: Sequence[BagTopic], findings: list[Finding]) -> dict[str, Topic]:
    """The topics by PX4's names: what the vehicle sends before what it is sent, then the useful instance."""
    by_name: dict[str, dict[str, list[Topic]]] = {}
    for one in sound:
        match = _NAME.fullmatch(one.name)
        if match is None:
            continue
        topic = Topic(match["topic"], int(match["instance"] or 0), one.fields)
        by_name.setdefault(match["topic"], {}).setdefault(match["way"] or "out", []).append(topic)
    return {name: choose_instance(ways.get("out") or ways["in"], findings) for name, ways in by_name.items()}


def _layouts(raws: Sequence[RawTopic], findings: list[Finding]) -> dict[str, Callable[[bytes], Layout]]:
    """How the messages of each topic are read: by its definition, or by the releases that fit."""
    layouts = {raw.name: raw.defined() for raw in raws if raw.text}
    unsaid = [raw for raw in raws if not raw.text]
    if not unsaid:
        return layouts
    releases = px4_releases()
    fits = {raw.name: _fitting(raw, list(releases)) for raw in unsaid}
    common = set(releases).intersection(*(found for found in fits.values() if found))
    misfits = [f"{raw.name} ({len(raw.payloads[0])} bytes)" for raw in unsaid if not fits[raw.name]]
    if misfits:
        known = ", ".join(releases)
        sentence = (
            f"Without definitions in the bag, messages fit none of the releases of px4_msgs that are "
            f"known ({known}) "
            f"and are left out: {', '.join(misfits)}."
        )
        findings.append(Finding("px4_release", sentence))
    for raw in unsaid:
        if fits[raw.name]:
            layouts[raw.name] = _agreed(raw, sorted(fits[raw.name] & common or fits[raw.name]))
    told = ", ".join(sorted(common)) or "several"
    sentence = (
        f"The bag has no definitions of messages: they are read as those of PX4 {told}, whose lengths fit."
    )
    findings.append(Finding("px4_release", sentence))
    return layouts


def _fitting(raw: RawTopic, numbers: Sequence[str]) -> set[str]:
    """The releases whose type is as long as the first message."""
    found = set()
    for number in numbers:
        try:
            _agreed(raw, [number])(raw.payloads[0])
        except UnsoundMessageError:
            continue
        found.add(number)
    return found


def _agreed(raw: RawTopic, numbers: Sequence[str]) -> Callable[[bytes], Layout]:
    """What gives the layout of a message as far as some releases agree on it."""
    releases = px4_releases()
    kinds = dict.fromkeys(releases[number].get(raw.kind) for number in numbers)

    def layout_of(message: bytes) -> Layout:
        layouts = [
            message_layout(message, raw.kind, releases[number], ros1=raw.ros1)
            for number in numbers[: 1 if len(kinds) == 1 else None]
        ]
        first = layouts[0]
        fields = {
            name: place
            for name, place in first.fields.items()
            if all(one.fields.get(name) == place for one in layouts)
        }
        return Layout(fields, first.lengths, first.size)

    return layout_of
