"""`write_recording`: a Recording as one table that reads back the same.

Parquet keeps everything: numbers exactly, and in the file's metadata the frame, the sources, which
channels are held, the parameters and the input map. Channels of several clocks have a row for each stamp of
any of them, and no value where a channel has no stamp. CSV keeps the numbers (exactly too); it has no place
for the rest, so it is refused where the rest is needed to understand the numbers.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np

from eivor.errors import UsageError
from eivor.logs.table.parquet import METADATA_KEY
from eivor.shapes import Float
from eivor.signals.canonical import CurveSide, held_by_default
from eivor.signals.log_origin import LogOrigin
from eivor.signals.recording import Channel, Finding, Frame, Recording
from eivor.whole_file import whole_file

_VERSION = 1


def write_recording(recording: Recording, path: str | os.PathLike[str]) -> None:
    """Write a recording as one table with canonical column names.

    Parameters
    ----------
    recording : Recording
        Channels with stamps of their own, other than those of most, have a value at each.
    path : str or path
        Ends in ".parquet" or ".csv".

    Raises
    ------
    UsageError
        When there are no channels, when one that has a clock of its own has NaN, when the ending is another
        one, or when a CSV cannot keep what the recording says (z down, an input map, several clocks, unusual
        held channels).
    OSError
        When the system refuses; an earlier file is as it was.
    """
    import polars as pl

    place = Path(path)
    if place.suffix not in (".parquet", ".csv"):
        raise UsageError(
            "a path that ends in .parquet or .csv",
            f"'{place.name}'",
            "Parquet keeps everything; CSV the numbers.",
        )
    frame = pl.DataFrame(_columns(recording))
    if place.suffix == ".csv":
        _check_csv(recording)
    with whole_file(place) as file:
        if place.suffix == ".csv":
            frame.write_csv(file)
        else:
            frame.write_parquet(file, metadata={METADATA_KEY: _metadata(recording)})


def _columns(recording: Recording) -> dict[str, np.ndarray]:
    """Every stamp, and each channel's values, NaN where it has no stamp."""
    channels = list(recording.channels.values())
    if not channels:
        raise UsageError("a recording with channels", "one without", "Nothing can be written.")
    time = _all_stamps(recording)
    return {"time": time, **{channel.name: _on_stamps(channel, time) for channel in channels}}


def _all_stamps(recording: Recording) -> Float[np.ndarray, " n"]:
    """The stamps of every channel, once each."""
    clocks: list[np.ndarray] = []
    for channel in recording.channels.values():
        if not any(np.array_equal(channel.time_s, clock) for clock in clocks):
            clocks.append(channel.time_s)
    return clocks[0] if len(clocks) == 1 else np.unique(np.concatenate(clocks))


def _on_stamps(channel: Channel, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    if channel.time_s.size == time.size:
        return channel.values
    if np.isnan(channel.values).any():
        raise UsageError(
            f"values at all stamps of '{channel.name}', which has a clock of its own",
            "NaN among them, which would read back as no stamp",
            "Leave these samples out first, or write the channel by itself.",
        )
    values = np.full(time.size, np.nan)
    values[np.searchsorted(time, channel.time_s)] = channel.values
    return values


def _check_csv(recording: Recording) -> None:
    lost = []
    rows = _all_stamps(recording).size
    own = [c.name for c in recording.channels.values() if c.time_s.size != rows]
    lost += [f"the stamps of {own[0]}" + (" and others" if len(own) > 1 else "")] if own else []
    if recording.frame is not Frame.Z_UP:
        lost.append("its frame (z down)")
    if recording.input_map:
        lost.append(f"its input map '{recording.input_map}'")
    lost += [
        f"how {c.name} is held" for c in recording.channels.values() if c.held != held_by_default(c.name)
    ]
    lost += [f"the delay of {c.name}" for c in recording.channels.values() if c.delay_s]
    lost += [f"the curve_side of {c.name}" for c in recording.channels.values() if c.curve_side.value]
    lost += [f"that an estimator made {c.name}" for c in recording.channels.values() if c.estimated]
    if lost:
        raise UsageError(
            "a recording that a CSV can keep",
            f"one that would lose {', '.join(lost)}",
            "Write .parquet instead.",
        )


def _metadata(recording: Recording) -> str:
    rows = _all_stamps(recording).size
    origin = recording.origin
    return json.dumps(
        {
            "version": _VERSION,
            "frame": recording.frame.name,
            "input_map": recording.input_map,
            "parameters": dict(recording.parameters),
            "origin": {
                "board": origin.board,
                "airframe": origin.airframe,
                "firmware": origin.firmware,
                "start": None if origin.start is None else origin.start.isoformat(),
            },
            "channels": {
                c.name: {
                    "source": c.source,
                    "held": c.held,
                    "estimated": c.estimated,
                    "delay_s": c.delay_s,
                    "curve_side": c.curve_side.value,
                    "own_clock": c.time_s.size != rows,
                    "overflowed": c.quality.overflowed,
                    "saturated": c.quality.saturated,
                }
                for c in recording.channels.values()
            },
        }
    )


def restore(recording: Recording, metadata: str) -> Recording:
    """Return the recording with what `write_recording` left in the file's metadata.

    Parameters
    ----------
    recording : Recording
        As read from the table alone.
    metadata : str
        JSON, empty when there is none. What is not understood is left out, with a finding.
    """
    if not metadata:
        return recording
    try:
        content = json.loads(metadata)
        frame = Frame[content["frame"]]
        input_map = _text(content["input_map"])
        parameters = {_text(key): _finite(value) for key, value in content["parameters"].items()}
        origin = _origin(content["origin"]) if "origin" in content else recording.origin
        channels = {
            name: _restored(channel, content["channels"].get(name, {}))
            for name, channel in recording.channels.items()
        }
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        finding = Finding(
            "metadata", "The file's metadata are not understood; the table is read without them."
        )
        return replace(recording, findings=(*recording.findings, finding))
    return replace(
        recording,
        frame=frame,
        input_map=input_map,
        parameters=parameters,
        channels=channels,
        origin=origin,
    )


def _origin(content: Mapping[str, object]) -> LogOrigin:
    start = content["start"]
    board, airframe, firmware = (_text(content[name]) for name in ("board", "airframe", "firmware"))
    return LogOrigin(
        board, airframe, firmware, None if start is None else datetime.fromisoformat(_text(start))
    )


def _restored(channel: Channel, content: object) -> Channel:
    if not isinstance(content, dict):
        raise TypeError("channel")
    quality = replace(
        channel.quality,
        overflowed=_count(content.get("overflowed", 0)),
        saturated=_count(content.get("saturated", 0)),
    )
    time, values = channel.time_s, channel.values
    if _flag(content.get("own_clock", False)):
        own = ~np.isnan(values)
        time, values, quality = time[own], values[own], replace(quality, missing_values=0)
    return replace(
        channel,
        time_s=time,
        values=values,
        source=_text(content.get("source", channel.source)),
        held=_flag(content.get("held", channel.held)),
        quality=quality,
        estimated=_flag(content.get("estimated", channel.estimated)),
        delay_s=_finite(content.get("delay_s", channel.delay_s)),
        curve_side=CurveSide(content.get("curve_side", channel.curve_side.value)),
    )


def _flag(value: object) -> bool:
    if not isinstance(value, bool):
        raise TypeError("flag")
    return value


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError("text")
    return value


def _count(value: object) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        raise TypeError("count")
    return value


def _finite(value: object) -> float:
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise TypeError("number")
    return float(value)
