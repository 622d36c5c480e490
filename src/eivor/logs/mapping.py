"""Channels made by a map, from columns or arrays."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from eivor import checks
from eivor.errors import ChannelMapError, EmptyLogError, ShapeError, UsageError, did_you_mean
from eivor.logs import channel_map as maps
from eivor.logs import common
from eivor.signals.channels import canonical_channel, canonical_channels, held_by_default, unit_of
from eivor.signals.filters import Series
from eivor.signals.recording import Channel, Finding, Frame, LogOrigin, Recording, clean_channel, utc_time
from eivor.tools import Bool, Float

#: First stamps beyond this are a calendar's, not a log's [s].
EPOCH_S = 1e7
_MOST_LISTED = 12
#: Columns that are recognised before a map of them is of use: time, a state and a command.
LEAST_SUGGESTED = 3

#: Units by column, of a table without a line of them.
NO_UNITS: Mapping[str, str] = {}
#: A column's name, and its unit in brackets behind it.
_WITH_UNIT = re.compile(r"(.*?)\s*[\[(]([^\[\]()]*)[\])]\s*")
#: Units as people write them.
_WRITTEN: Mapping[str, str] = common.LOG_TABLES["written"]


def known_unit(text: str) -> str | None:
    """Unit that a text is, as maps have it; None for a text that is none."""
    unit = _WRITTEN.get(text, text)
    return unit if unit in common.UNITS or unit in common.TIME_UNITS else None


def _split_unit(column: str, units: Mapping[str, str]) -> tuple[str, str | None]:
    """Name and unit of a column that has one below it or in brackets; None for none."""
    match = _WITH_UNIT.fullmatch(column)
    if match is None or column in units:
        return column, units.get(column)
    unit = match[2].strip()
    return match[1], _WRITTEN.get(unit, unit)


def canonical_map(
    names: Sequence[str], origin: str, units: Mapping[str, str] = NO_UNITS
) -> maps.ChannelMap | None:
    """Map of a table with canonical column names, units in brackets; None without `time` or a channel."""
    rules, times = [], []
    for column in names:
        name, unit = _split_unit(column, units)
        channel = canonical_channel(name)
        si_unit, factor = common.UNITS.get(unit or "", (unit or "", 1.0))
        if name == "time" and (unit or "s") in common.TIME_UNITS:
            times.append((column, unit or "s"))
        elif channel is not None and (unit is None or common.unit_fits(channel, si_unit)):
            expression = maps.Expression.of_column(column)
            rules.append(maps.ChannelRule(name, expression, factor, held=held_by_default(name)))
    if len(times) != 1 or not rules:
        return None
    return maps.ChannelMap("canonical", *times[0], tuple(rules), Frame.Z_UP, "", {}, origin)


def _called() -> dict[str, str]:
    """Channels by what people call them, in small letters."""
    result = {word: channel for channel, words in common.LOG_TABLES["called"].items() for word in words}
    for channel, (words, parts) in common.LOG_TABLES["called_by_part"].items():
        result |= {f"{word}{part}": f"{channel}_{part}" for word, part in itertools.product(words, parts)}
    for word, channel in [*result.items()]:
        if canonical_channel(f"reference_{channel}") is not None:
            for mark in common.LOG_TABLES["reference_called"]["marks"]:
                result |= dict.fromkeys((f"{mark}{word}", f"{word}{mark}"), f"reference_{channel}")
    return result


def suggested_map(names: Sequence[str], units: Mapping[str, str] = NO_UNITS) -> list[str]:
    """Lines of a channel map for columns that are called as people call them; none for too few."""
    columns_by_channel: dict[str, tuple[str, str | None]] = {}
    known = _called()
    called = {**known, **{name.replace("_", ""): name for name in canonical_channels()}}
    for column in names:
        name, unit = _split_unit(column, units)
        word, _, suffix = name.rpartition("_")
        if unit is None and suffix in common.TIME_UNITS and known.get(word.lower()) == "time":
            name, unit = word, suffix
        channel = called.get(re.sub(r"[\W_]", "", name).lower(), name)
        if channel in known.values() or canonical_channel(channel) is not None:
            columns_by_channel.setdefault(channel, (column, unit))
    if "time" not in columns_by_channel or len(columns_by_channel) < LEAST_SUGGESTED:
        return []
    column, unit = columns_by_channel.pop("time")
    lines = [
        'name = "own"',
        'frame = "z_up"',
        "[time]",
        f"column = {_toml(column)}",
        f'unit = "{unit or "s"}"',
    ]
    angles = [columns_by_channel.pop(name) for name in ("roll", "pitch") if name in columns_by_channel]
    for channel, (column, unit) in columns_by_channel.items():
        of_channel = unit_of(channel) if unit is None else unit
        lines += [f"[channels.{channel}]", f"column = {_toml(column)}", f'unit = "{of_channel}"']
    if len(angles) == len(("roll", "pitch")):
        columns = ", ".join(_toml(column) for column, _ in angles)
        lines += ["[channels.cos_tilt]", f"roll_pitch = [{columns}]", f'unit = "{angles[0][1] or "rad"}"']
    return lines


def _toml(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def fitting_map(
    names: Sequence[str], table: str, findings: list[Finding], units: Mapping[str, str] = NO_UNITS
) -> maps.ChannelMap:
    """Return the map for a table that came without one; a finding says when a shipped map was chosen."""
    canonical = canonical_map(names, table, units)
    if canonical is not None:
        return canonical
    for name in maps.shipped_maps():
        shipped = maps.load_channel_map(name)
        if set(shipped.needed_by(rule for rule in shipped.rules if not rule.optional)) <= set(names):
            findings += common.noted("channel_map", name)
            return shipped
    lines = suggested_map(names, units)
    write = (
        "Save the lines below as own.toml, correct what is wrong in them, and give --map own.toml."
        if lines
        else "Write a channel map (TOML) that says which column is which channel, and give it with "
        "`channel_map` (--map). Columns that a motion adds are known once it is named (--model, --machine, "
        "ev.motion_by_name, ev.machine)."
    )
    error = ChannelMapError(
        "canonical column names ('time', 'velocity_z', 'rotor_command_1', ...), or the columns of a "
        f"shipped map ({', '.join(maps.shipped_maps())})",
        f"'{table}' with the columns {listed(names)}",
        write,
    )
    for line in lines:
        error.add_note(line)
    raise error


def fitted_rules(chosen: maps.ChannelMap, names: Sequence[str], table: str) -> tuple[maps.ChannelRule, ...]:
    """Rules of a map that the table can serve, after all its columns have been found."""
    available = set(names)
    rules = []
    for rule in chosen.rules:
        missing = [column for column in rule.expression.columns if column not in available]
        if not missing:
            rules.append(rule)
        elif not rule.optional:
            raise _no_column(missing[0], f"channels.{rule.name}", chosen, names, table)
    used = maps.columns_of(chosen.rules).keys()
    if chosen.time_column not in available:
        raise _no_column(chosen.time_column, "time.column", chosen, names, table)
    if chosen.time_column in used:
        expected = f"a time column that no channel is made of ({chosen.origin})"
        received = f"'{chosen.time_column}' as both"
        raise ChannelMapError(expected, received, "Correct the column of the time, or that of the channel.")
    for column in chosen.ranges:
        if column not in available and column not in used:
            raise _no_column(column, f"columns.{column}", chosen, names, table)
    doubled = {name for name in names if names.count(name) > 1} & (used | {chosen.time_column})
    if doubled:
        expected = f"columns with names of their own in '{table}'"
        received = f"two columns called {listed(sorted(doubled))}"
        raise ChannelMapError(expected, received, "Rename one of them.")
    if not rules:
        expected = f"at least one channel of {chosen.origin} in '{table}'"
        raise ChannelMapError(expected, "none", "Check that the map fits the table.")
    return tuple(rules)


def _no_column(
    column: str, key: str, chosen: maps.ChannelMap, names: Sequence[str], table: str
) -> ChannelMapError:
    remedy = did_you_mean(column, names, "Correct the map.", most=3)
    expected = f"a column '{column}' ({chosen.origin}, key {key})"
    return ChannelMapError(expected, f"'{table}' with the columns {listed(names)}", remedy)


def listed(names: Sequence[str]) -> str:
    """Return the first of some names, quoted and cut, and how many more there are."""
    text = ", ".join(repr(name[:60]) for name in names[:_MOST_LISTED])
    return f"{text} and {len(names) - _MOST_LISTED} more" if len(names) > _MOST_LISTED else text


#: A column, NaN outside its valid range; how many of its values are outside it, and how many saturated.
_Ranged = tuple[Series, int, int]


def mapped_recording(
    chosen: maps.ChannelMap,
    rules: Sequence[maps.ChannelRule],
    columns: common.Columns,
    *,
    name: str,
    log_format: str,
    findings: Sequence[Finding] = (),
) -> Recording:
    """Return the recording of a table."""
    result = list(findings)
    channels = mapped_channels(chosen, rules, columns, name, result)
    if not channels:
        lists = _report_lists(columns)
        received = f"'{name}', in which every mapped column is empty{lists and f'. {lists}'}"
        raise EmptyLogError("a table with values", received, "Check the export.")
    absent = {
        rule.name: (f"{rule.expression.text}, which is there and holds no number",)
        for rule in rules
        if rule.name not in channels
    }
    stamps = columns.values[chosen.time_column]
    first = float(stamps[np.isfinite(stamps)][0]) * _unit(chosen, columns)
    return Recording(
        name=name,
        format=log_format,
        channels=channels,
        frame=chosen.frame,
        input_map=chosen.input_map,
        looked_for=looked_for(chosen) | absent,
        findings=(*result, *delay_findings(channels, chosen.origin), *common.channel_findings(channels)),
        origin=LogOrigin(airframe=chosen.airframe, start=utc_time(first) if first > EPOCH_S else None),
    )


def looked_for(chosen: maps.ChannelMap) -> dict[str, tuple[str, ...]]:
    """Which column each channel was looked for in, by a map: one of its own name where it has no rule."""
    columns: dict[str, tuple[str, ...]] = {key: (f"column {key}",) for key in canonical_channels()}
    return columns | {rule.name: (rule.expression.text,) for rule in chosen.rules}


def mapped_channels(
    chosen: maps.ChannelMap,
    rules: Sequence[maps.ChannelRule],
    columns: common.Columns,
    name: str,
    findings: list[Finding],
) -> dict[str, Channel]:
    """Return the channels with a value that rules make of columns of one clock."""
    cells = [f"{key[:60]!r} {count}" for key, count in columns.unreadable.items() if key not in columns.lists]
    findings += common.noted("lists", _report_lists(columns))
    findings += common.noted("unreadable_text", cells)
    time_s, stamped = _clock(chosen, columns, name, findings)
    measured = {
        key: raw if stamped.all() else raw[stamped]
        for key, raw in columns.values.items()
        if key != chosen.time_column
    }
    clean = common.without_extrapolation(time_s, measured, findings)
    ranged = {
        key: _ranged(values, np.isnan(clean[key]), chosen.ranges.get(key)) for key, values in measured.items()
    }
    findings += _angle_findings(rules, ranged)
    channels: dict[str, Channel] = {}
    for rule in rules:
        channel = _channel(rule, time_s, ranged)
        if np.isfinite(channel.values).any():
            channels[rule.name] = channel
        else:
            findings += common.noted("never_valid_rule", f"{rule.name} ({rule.expression.text})")
    selected = {name: common.on_channel_clock(channel) for name, channel in channels.items()}
    rates = [f"{name} {item.rate_hz:.3g} Hz" for name, item in selected.items() if item is not channels[name]]
    findings += common.noted("own_clock", rates)
    return selected


def channels_by_clock(
    chosen: maps.ChannelMap,
    served: Iterable[tuple[Sequence[maps.ChannelRule], common.Columns]],
    name: str,
    findings: list[Finding],
) -> dict[str, Channel]:
    """Return the channels that rules make of columns of several clocks, those of each clock together."""
    channels: dict[str, Channel] = {}
    for rules, columns in served:
        channels |= mapped_channels(chosen, rules, columns, name, findings)
    return channels


def delay_findings(channels: Mapping[str, Channel], origin: str) -> list[Finding]:
    """Say which delays have been taken off, and who says so."""
    late = [f"{name} {1e3 * channel.delay_s:g} ms" for name, channel in channels.items() if channel.delay_s]
    text = f"{origin} says: {', '.join(late)}" if late else ""
    return common.noted("stated_delays", text)


def _report_lists(columns: common.Columns) -> str:
    """Say which columns hold lists, if any, and how a map names an element."""
    if not columns.lists:
        return ""
    text = ", ".join(f"{name[:60]!r} ({cell[:60]})" for name, cell in columns.lists.items())
    return f"Columns whose cells are lists, which are no numbers: {text}; a map names one by its `index`"


def _clock(
    chosen: maps.ChannelMap, columns: common.Columns, name: str, findings: list[Finding]
) -> tuple[Float[np.ndarray, " m"], np.ndarray]:
    """Stamps [s] of the rows that have one, and which rows these are."""
    raw = columns.values[chosen.time_column]
    stamped = np.isfinite(raw)
    if not stamped.any():
        expected = f"a table whose column '{chosen.time_column}' holds time stamps"
        remedy = "Check the time column, or name another one in a channel map."
        raise EmptyLogError(expected, f"'{name}', in which it holds no number", remedy)
    unit = _unit(chosen, columns)
    findings += common.noted("stampless_rows", int((~stamped).sum()))
    stamps = raw[stamped]
    if abs(stamps[0]) * unit > EPOCH_S:
        findings += common.noted("cut_clock", stamps[0] * unit)
        stamps = stamps - stamps[0]
    return stamps * unit, stamped


def _unit(chosen: maps.ChannelMap, columns: common.Columns) -> float:
    return 1.0 if chosen.time_column in columns.seconds else common.TIME_UNITS[chosen.time_unit]


def _angle_findings(rules: Sequence[maps.ChannelRule], ranged: Mapping[str, _Ranged]) -> list[Finding]:
    """Doubt angles that go round in radians, or never reach one degree."""
    findings: list[Finding] = []
    for rule in rules:
        largest = [float(np.nanmax(np.abs(ranged[c][0]), initial=0.0)) for c in rule.angles]
        if not largest:
            continue
        columns, peak = " and ".join(map(repr, rule.angles)), max(largest)
        if rule.angle_unit == "rad" and peak > 2.0 * np.pi:
            doubt = f"{columns} reach {peak:.3g} rad; are they in degrees?"
        elif rule.angle_unit == "deg" and 0.0 < peak < 1.0:
            doubt = f"{columns} never exceed {peak:.3g} deg; are they in radians?"
        else:
            continue
        findings.append(Finding("mixed_units", doubt))
    return findings


def _ranged(values: Series, missing: Bool[np.ndarray, " n"], bounds: maps.ValidRange | None) -> _Ranged:
    if bounds is None:
        return np.where(missing, np.nan, values) if missing.any() else values, 0, 0
    low, high, saturates = bounds
    is_outside = (values < low) | (values > high)
    is_low = (values == low) & (saturates in ("lower", "both"))
    saturated = is_low | ((values == high) & (saturates in ("upper", "both")))
    return np.where(is_outside | missing, np.nan, values), int(is_outside.sum()), int(saturated.sum())


def _channel(rule: maps.ChannelRule, time_s: Series, ranged: Mapping[str, _Ranged]) -> Channel:
    used = {column: ranged[column] for column in rule.expression.columns}
    values = rule.expression.evaluate({column: item for column, (item, *_) in used.items()}, time_s)
    return clean_channel(
        rule.name,
        time_s - rule.delay_s if rule.delay_s else time_s,
        values * rule.factor,
        unit_of(rule.name),
        source=rule.expression.text,
        held=rule.held,
        overflowed=sum(overflowed for _, overflowed, _ in used.values()),
        saturated=sum(saturated for *_, saturated in used.values()),
        estimated=rule.estimated,
        delay_s=rule.delay_s,
        noise=rule.noise,
        curve_side=rule.curve_side,
    )


def recording_from_columns(
    columns: Any,
    *,
    name: str = "arrays",
    frame: Frame = Frame.Z_UP,
    input_map: str = "",
    parameters: Mapping[str, float] | None = None,
    estimated: tuple[str, ...] = (),
) -> Recording:
    """Return a recording of columns with canonical names.

    Parameters
    ----------
    columns : mapping of str to array_like, or data frame
        `time` [s] and canonical channels in SI units, all of one length. NaN means "no value", and so does
        what a mask hides.
    name : str
        What to call the recording in reports.
    frame : Frame
        Which way z points.
    input_map : str
        Name of the vehicle's input map, if it is known.
    parameters : mapping of str to float, optional
        Vehicle parameters, by names of your own.
    estimated : tuple of str
        Channels that an estimator makes of other measurements, such as the velocity of a Kalman filter.

    Raises
    ------
    UsageError
        When `time` is missing, a name is not canonical, `estimated` names a channel that is not among the
        columns, or an argument is of another type.
    ShapeError
        When a column is not one-dimensional, or has another length than `time`.
    DataError
        When a column does not hold real numbers.
    EmptyLogError
        When there are no values.
    """
    is_mapping = isinstance(columns, Mapping)
    if not (is_mapping or (hasattr(columns, "columns") and hasattr(columns, "__getitem__"))):
        expected = "a mapping or a data frame for columns"
        raise UsageError(expected, checks.described(columns), "Give a dictionary of arrays.")
    checks.text("name", name)
    checks.text("input_map", input_map)
    checks.kind("frame", frame, Frame, "a Frame", "Give Frame.Z_UP or Frame.NED.")
    if parameters is not None:
        checks.mapping("parameters", parameters, checks.NUMBERS, "numbers")
    names = list(columns if is_mapping else columns.columns)
    unknown = [key for key in names if key != "time" and canonical_channel(str(key)) is None]
    if unknown:
        every = f"The names are {', '.join(canonical_channels())}."
        hint = did_you_mean(str(unknown[0]), canonical_channels(), every, most=3)
        raise UsageError("canonical names of channels", f"{unknown[0]!r}", hint)
    chosen = canonical_map(names, name)
    if chosen is None:
        expected = "a column 'time' and at least one channel"
        raise UsageError(expected, f"{', '.join(names) or 'no columns'}", "Add what is missing.")
    arrays = {key: np.array(checks.real_array(f"column '{key}'", columns[key]), ndmin=1) for key in names}
    rows = arrays["time"].size
    if rows == 0:
        raise EmptyLogError("columns with values", "columns of length 0", "Give at least one row.")
    for key, array in arrays.items():
        if array.shape != (rows,):
            expected = f"columns of the length of 'time', {rows}"
            raise ShapeError(expected, f"'{key}' of shape {array.shape}", "Give one value a row.")
    checks.items("estimated", estimated, str, "names of channels", 'Give ("velocity_z",), for example.')
    unknown = [item for item in estimated if item not in names]
    if unknown:
        raise UsageError(f"channels out of {', '.join(names)}", f"{unknown[0]!r}", "Correct the name.")
    rules = tuple(replace(rule, estimated=True if rule.name in estimated else None) for rule in chosen.rules)
    recording = mapped_recording(chosen, rules, common.Columns(arrays), name=name, log_format="frame")
    return replace(recording, frame=frame, input_map=input_map, parameters=dict(parameters or {}))
