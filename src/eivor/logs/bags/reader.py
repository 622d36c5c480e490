"""Bags to recordings.

Topics of PX4 are read as in a ULog, z down. Topics of mavros and plain messages of ROS are z up. Stamps are
those in the messages, never the time of the record. Time 0 is the earliest of them.
"""

from __future__ import annotations

from pathlib import Path

from eivor.errors import EmptyLogError
from eivor.logs.bags import px4, ros
from eivor.logs.bags.by_map import map_channels, mapped_topics
from eivor.logs.bags.containers import check_installed
from eivor.logs.bags.files import bag_files
from eivor.logs.bags.ros_sources import LOOKED_FOR
from eivor.logs.bags.topics import Contents, read_contents
from eivor.logs.channel_map import load_channel_map
from eivor.logs.findings import channel_findings
from eivor.logs.log_format import ReadOptions
from eivor.logs.mapping import looked_for
from eivor.signals.recording import Channel, Finding, Frame, Recording

_SHOWN = 12


def read_bag(path: Path, options: ReadOptions, log_format: str) -> Recording:
    """Read a bag.

    Parameters
    ----------
    path : Path
        A file, or the folder of one bag.
    options : ReadOptions
        A channel map, and the hash of the bytes.
    log_format : str
        Name of the format.

    Raises
    ------
    MissingReaderError
        When rosbags is not installed.
    CorruptLogError
        When it cannot be read.
    EmptyLogError
        When no channel is made of its topics.
    ChannelMapError
        When the map is wrong, or does not fit the bag.
    InputError
        When it holds several vehicles, or the folder several bags.
    """
    check_installed()
    files = bag_files(path)
    findings: list[Finding] = []
    if options.channel_map is not None:
        chosen = load_channel_map(options.channel_map)
        named = mapped_topics(chosen)
        contents = read_contents(files, lambda one: one.topic in named, findings)
        channels = map_channels(chosen, contents.topics, contents.listed, path.name, findings)
        return Recording(
            name=path.name,
            format=log_format,
            channels=channels,
            frame=chosen.frame,
            sha256=options.sha256,
            input_map=chosen.input_map,
            looked_for=looked_for(chosen),
            findings=(*findings, *channel_findings(channels)),
        )
    contents = read_contents(
        files, lambda one: px4.is_px4(one.topic, one.kind) or ros.is_known(one.topic, one.kind), findings
    )
    channels, frame, vehicle = _known_channels(contents, findings)
    if not channels:
        raise _nothing(path, contents, findings)
    return Recording(
        name=path.name,
        format=log_format,
        channels=channels,
        frame=frame,
        sha256=options.sha256,
        looked_for=px4.looked_for() if frame is Frame.NED else LOOKED_FOR,
        findings=(*findings, *channel_findings(channels)),
        vehicle=vehicle,
    )


def _known_channels(contents: Contents, findings: list[Finding]) -> tuple[dict[str, Channel], Frame, str]:
    """The channels of the topics that are known, which way z points, and the kind of vehicle."""
    of_px4 = [raw for raw in contents.topics.values() if px4.is_px4(raw.name, raw.kind)]
    if of_px4:
        channels, vehicle = px4.px4_channels(of_px4, findings)
        if channels:
            return channels, Frame.NED, vehicle
    others = [raw for raw in contents.topics.values() if not px4.is_px4(raw.name, raw.kind)]
    return ros.ros_channels(others, findings), Frame.Z_UP, ""


def _nothing(path: Path, contents: Contents, findings: list[Finding]) -> EmptyLogError:
    topics = [f"{name} ({kind})" for name, kind in sorted(contents.listed.items())]
    shown = ", ".join(topics[:_SHOWN]) + (f" and {len(topics) - _SHOWN} more" if len(topics) > _SHOWN else "")
    said = " ".join(one.message for one in findings)
    return EmptyLogError(
        "a bag with topics of PX4 (px4_msgs) or mavros, or with odometry, poses and inertial sensors",
        f"'{path.name}' with {shown or 'no messages'}" + (f". {said.rstrip('.')}" if said else ""),
        'Write a channel map whose columns are TOPIC.FIELD, and whose clock is "stamp" (--map).'
        if topics
        else "Nothing was recorded: check the topics that `rosbag record` or `ros2 bag record` was given.",
    )
