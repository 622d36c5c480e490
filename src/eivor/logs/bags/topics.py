"""The topics of a bag that are needed, as bytes and then as columns with stamps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from eivor.errors import CorruptLogError
from eivor.logs.bags.common_types import common_types
from eivor.logs.bags.containers import Connection, opened
from eivor.logs.bags.decompression import Budget
from eivor.logs.bags.definitions import Types, parsed_definition
from eivor.logs.bags.idl import idl_types
from eivor.logs.bags.layouts import Layout, message_layout
from eivor.logs.bags.messages import decoded
from eivor.logs.stamps import MAX_SPAN_S
from eivor.shapes import Float, Int
from eivor.signals.recording import Finding

#: Messages are recorded as they arrive, which may be late by so much; more is a jump of the clock [ns].
OVERTAKEN_NS = 500_000_000
#: Topics whose stamps are this much further from the time of the record than others' have another clock [s].
SAME_CLOCK_S = 5.0
#: Stamps beyond these are none: half of what 64 bits hold [ns].
LAST_NS = 1 << 62
#: Fields that are texts, by the type of their message; texts in the place of other fields are none.
TEXTS = frozenset({("mavros_msgs/State", "mode")})


@dataclass(slots=True)
class RawTopic:
    """Messages of a topic as a bag has them.

    Parameters
    ----------
    name, kind : str
        The topic, and the type of its messages.
    text : str
        Definition of that type; empty where the bag has none.
    is_idl, ros1 : bool
        How the definition and the messages are written.
    payloads : list of bytes
        The messages.
    record_ns : list of int
        When they were recorded [ns].
    """

    name: str
    kind: str
    text: str
    is_idl: bool
    ros1: bool
    payloads: list[bytes] = field(default_factory=list)
    record_ns: list[int] = field(default_factory=list)

    def types(self) -> Types:
        """Fields of its type and of those in it: of the bag's own definition where it has one."""
        known = dict(common_types())
        if self.text:
            known |= idl_types(self.text) if self.is_idl else parsed_definition(self.text, self.kind)
        return known

    def defined(self) -> Callable[[bytes], Layout]:
        """What gives the layout of a message, by the definition; `message_layout` says what it raises."""
        types = self.types()
        return lambda message: message_layout(message, self.kind, types, ros1=self.ros1)


@dataclass(frozen=True, slots=True)
class BagTopic:
    """A topic as columns.

    Parameters
    ----------
    name, kind : str
        The topic, and the type of its messages.
    fields : mapping of str to ndarray, shape (n,)
        Numbers and texts by the full name of the field.
    stamp_ns : ndarray, shape (n,)
        What each message says of when it is from [ns].
    record_ns : ndarray, shape (n,)
        When it was recorded [ns].
    """

    name: str
    kind: str
    fields: Mapping[str, np.ndarray]
    stamp_ns: Int[np.ndarray, " n"]
    record_ns: Int[np.ndarray, " n"]

    def numbers(self) -> list[str]:
        """Names of the fields that hold numbers."""
        return [name for name, values in self.fields.items() if values.dtype.kind in "iuf"]

    def seconds(self, start_ns: int) -> Float[np.ndarray, " n"]:
        """Stamps since some time [s]."""
        return (self.stamp_ns - start_ns).astype(np.float64) * 1e-9


@dataclass(slots=True)
class Contents:
    """What was read of a bag.

    Parameters
    ----------
    topics : dict of str to RawTopic
        Those that were wanted, with their messages.
    listed : dict of str to str
        Type of each topic that has messages.
    """

    topics: dict[str, RawTopic] = field(default_factory=dict)
    listed: dict[str, str] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """Number of messages."""
        return sum(len(one.payloads) for one in self.topics.values())


def read_contents(
    files: Sequence[Path], wanted: Callable[[Connection], bool], findings: list[Finding]
) -> Contents:
    """Read the messages of some topics out of the files of a bag.

    Parameters
    ----------
    files : sequence of Path
        In the order of the record.
    wanted : callable
        Says which topics are needed.
    findings : list of Finding
        Gets what was left out.

    Raises
    ------
    CorruptLogError
        When nothing can be read.
    """
    budget = Budget.of(sum(file.stat().st_size for file in files))
    contents = Contents()
    for file in files:
        before = contents.size
        try:
            _add_file(file, wanted, budget, contents)
        except CorruptLogError as error:
            got = contents.size - before
            if not got and len(files) == 1:
                raise
            told = f"{got} messages of '{file.name}' were read" if got else "A part was left out"
            findings.append(Finding("corrupt_parts", f"{told}: {error.received}."))
    return contents


def _add_file(file: Path, wanted: Callable[[Connection], bool], budget: Budget, contents: Contents) -> None:
    with opened(file, budget) as container:
        contents.listed |= {one.topic: one.kind for one in container.connections if one.count}
        chosen = [one for one in container.connections if wanted(one)]
        for one, record_ns, payload in container.messages(chosen):
            raw = contents.topics.get(one.topic)
            if raw is None:
                raw = RawTopic(one.topic, one.kind, one.text, one.is_idl, container.ros1)
                contents.topics[one.topic] = raw
            if raw.kind == one.kind:
                raw.payloads.append(budget.spent(payload))
                raw.record_ns.append(record_ns)


def as_columns(
    raw: RawTopic, layout_of: Callable[[bytes], Layout], findings: list[Finding]
) -> BagTopic | None:
    """Return a topic as columns; None when it has no sound message, or none that says when it is from.

    Parameters
    ----------
    raw : RawTopic
        Its messages.
    layout_of : callable
        Gives the layout of one.
    findings : list of Finding
        Gets what was left out.
    """
    made = decoded(raw.payloads, layout_of)
    lost = len(raw.payloads) - made.places.size
    if lost:
        sentence = f"Messages of {raw.name} ({raw.kind}) that were left out: {lost}, as {made.reason}."
        findings.append(Finding("message_formats", sentence))
    stamp_ns = _stamps(made.fields) if made.places.size else None
    if stamp_ns is None:
        if made.places.size:
            sentence = f"Messages of {raw.name} ({raw.kind}) do not say when they are from, and are not used."
            findings.append(Finding("time_stamps", sentence))
        return None
    said = (stamp_ns > 0) & (stamp_ns < LAST_NS)
    if said.any():
        middle = int(np.median(stamp_ns[said]))
        said &= np.abs(stamp_ns - middle) <= round(MAX_SPAN_S * 1e9)
    if not said.all():
        sentence = (
            f"Messages of {raw.name} without a stamp that can be, which were left out: {int((~said).sum())}."
        )
        findings.append(Finding("time_stamps", sentence))
    if not said.any():
        return None
    kept = _in_order(stamp_ns, np.flatnonzero(said))
    fields = {
        name: values[kept]
        for name, values in made.fields.items()
        if values.dtype.kind != "S" or (raw.kind, name) in TEXTS
    }
    record_ns = np.array(raw.record_ns, dtype=np.int64)[made.places][kept]
    return BagTopic(raw.name, raw.kind, fields, stamp_ns[kept], record_ns)


def _in_order(stamp_ns: Int[np.ndarray, " n"], kept: Int[np.ndarray, " m"]) -> Int[np.ndarray, " m"]:
    """Which messages, in the order of their stamps where they overtook each other on their way only."""
    stamps = stamp_ns[kept]
    behind = np.maximum.accumulate(stamps) - stamps
    return kept[np.argsort(stamps, kind="stable")] if behind.max() <= OVERTAKEN_NS else kept


def _stamps(fields: Mapping[str, np.ndarray]) -> Int[np.ndarray, " n"] | None:
    """What messages say of when they are from [ns]: PX4's stamp in microseconds, or the header's."""
    microseconds = fields.get("timestamp")
    if microseconds is not None and microseconds.dtype.kind == "u" and microseconds.dtype.itemsize == 8:
        return np.where(microseconds < LAST_NS // 1000, microseconds, 0).astype(np.int64) * 1000
    seconds, rest = fields.get("header.stamp.sec"), fields.get("header.stamp.nanosec")
    if seconds is None or rest is None or {seconds.dtype.kind, rest.dtype.kind} - {"i", "u"}:
        return None
    return seconds.astype(np.int64) * 1_000_000_000 + rest.astype(np.int64)


def of_one_clock(topics: Sequence[BagTopic], findings: list[Finding]) -> list[BagTopic]:
    """Return the topics whose stamps are of one clock: that of most messages.

    Clocks are told apart by how far their stamps are from the time of the record, which serves nothing else.
    """
    if not topics:
        return []
    ahead = [float(np.median(one.stamp_ns - one.record_ns)) * 1e-9 for one in topics]

    def company(place: int) -> int:
        near = (abs(other - ahead[place]) <= SAME_CLOCK_S for other in ahead)
        return sum(one.stamp_ns.size for one, is_near in zip(topics, near, strict=True) if is_near)

    best = ahead[max(range(len(topics)), key=company)]
    kept = [one for one, offset in zip(topics, ahead, strict=True) if abs(offset - best) <= SAME_CLOCK_S]
    others = [one.name for one in topics if not any(one is other for other in kept)]
    if others:
        sentence = f"Stamps of another clock than the others', which are not used: {', '.join(others)}."
        findings.append(Finding("clocks", sentence))
    return kept


def start_ns(topics: Sequence[BagTopic]) -> int:
    """Earliest stamp [ns]."""
    return min(int(one.stamp_ns.min()) for one in topics)
