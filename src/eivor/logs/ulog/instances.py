"""Which instance of a topic is the real one.

Several instances of one topic (`multi_id` 0, 1, ...) are several sensors, or outputs of which only one
drives the motors. The lowest is taken, unless another is clearly better: a battery that is connected,
outputs that move, or more than twice the data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from eivor.logs.ulog.topics import MAX_ACTUATORS
from eivor.signals.recording import Finding


@dataclass(frozen=True, slots=True)
class Topic:
    """One instance of a topic: raw arrays by field, one entry per message."""

    name: str
    instance: int
    fields: Mapping[str, np.ndarray]

    @property
    def size(self) -> int:
        """Number of messages."""
        return int(self.fields["timestamp"].size)


def varying_fields(topic: Topic, stem: str) -> list[str]:
    """Fields ``stem[0]``, ``stem[1]``, ... with at least two different finite values."""
    varying = []
    for index in range(MAX_ACTUATORS):
        name = f"{stem}[{index}]"
        if name in topic.fields:
            values = topic.fields[name].astype(np.float64)
            finite = values[np.isfinite(values)]
            if finite.size and finite.min() < finite.max():
                varying.append(name)
    return varying


def place_of(field: str) -> int:
    """Number in the brackets of a field such as ``output[3]``."""
    return int(field.partition("[")[2].rstrip("]"))


def choose_instance(candidates: Sequence[Topic], findings: list[Finding]) -> Topic:
    """Return the instance to use; a choice is reported in `findings`.

    Parameters
    ----------
    candidates : sequence of Topic
        Instances of one topic, at least one.
    findings : list of Finding
        Gets one more entry when there is a choice.
    """
    ordered = sorted(candidates, key=lambda topic: topic.instance)
    if len(ordered) == 1:
        return ordered[0]
    best = max(_usefulness(topic) for topic in ordered)
    useful = [topic for topic in ordered if _usefulness(topic) == best]
    longest = max(useful, key=lambda topic: topic.size)
    chosen = longest if longest.size > 2 * useful[0].size else useful[0]
    sizes = ", ".join(f"{topic.instance}: {topic.size} messages" for topic in ordered)
    findings.append(
        Finding(
            "several_instances", f"{chosen.name}: instance {chosen.instance} is used (there are {sizes})."
        )
    )
    return chosen


def _usefulness(topic: Topic) -> int:
    """How much of what the topic is for is there: connected batteries, moving outputs."""
    if topic.name == "battery_status" and "connected" in topic.fields:
        return int(np.any(topic.fields["connected"] != 0))
    if topic.name == "actuator_outputs":
        return len(varying_fields(topic, "output"))
    return 0
