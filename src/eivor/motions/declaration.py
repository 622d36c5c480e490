"""Declarations of machines, in TOML and in Python, read into motions; units of every term."""

from __future__ import annotations

import ast
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from typing import Any

import msgspec
import numpy as np

from eivor import checks
from eivor.errors import ChannelMapError, did_you_mean
from eivor.flights.lag_prior import LAG_QUANTITIES
from eivor.flights.references import ReferenceSource
from eivor.logs.channel_map import CONDITIONS, Expression, InTime
from eivor.logs.common import UNITS
from eivor.motions.equation import AxisEquation, Mirror, Term, parsed
from eivor.motions.machine import Activity, Derived, Machine, MachineChannel
from eivor.signals.channels import BUILT_IN, canonical_channel, declare_channels
from eivor.signals.recording import DataSheet
from eivor.strict_toml import Text, TomlFiles, TomlTable

# -- Structures of the file --

#: Lags and delays that are searched, of the range that is declared.
LAGS, DELAYS = 16, 5
LONGEST_MS = 20_000.0
ROLES = ("state", "response", "input", "reference")
_NAME = re.compile(r"[A-Za-z_]\w*")


class _Channel(msgspec.Struct, forbid_unknown_fields=True):
    unit: str
    role: str = "state"
    held: bool | None = None
    feedback: bool = False
    noise: float | None = None
    quantisation: float | None = None


class _Let(msgspec.Struct, forbid_unknown_fields=True, rename={"of": "is"}):
    of: Text
    unit: str | None = None
    symbol: str = ""


class _Term(msgspec.Struct, forbid_unknown_fields=True):
    of: Text
    behind: str = ""
    unit: str | None = None
    symbol: str = ""


class _Actuator(msgspec.Struct, forbid_unknown_fields=True):
    lag_ms: tuple[float, ...] = (0.0, 0.0)
    delay_ms: tuple[float, ...] = (0.0, 0.0)
    order: int = 1


class _Active(msgspec.Struct, forbid_unknown_fields=True):
    when: Text


class _Instruments(msgspec.Struct, forbid_unknown_fields=True):
    of: list[Text]


class _Quality(msgspec.Struct, forbid_unknown_fields=True):
    headline: list[str] = []
    half_width: float = 0.2
    weak_half_width: float = 0.5


class _Band(msgspec.Struct, forbid_unknown_fields=True):
    hz: list[float]


class _Axis(msgspec.Struct, forbid_unknown_fields=True):
    response: str | list[str]
    terms: dict[str, Any]
    references: list[str] | None = None


class _File(msgspec.Struct, forbid_unknown_fields=True):
    name: Text
    channels: dict[str, Any]
    title: str = ""
    move: str = "Move it to and fro for a minute, with references that change at uneven times."
    log: str = ""
    response: str | list[str] = ""
    terms: dict[str, Any] = {}
    let: dict[str, Any] = {}
    actuators: dict[str, Any] = {}
    derived: dict[str, Any] = {}
    active: _Active | None = None
    instruments: dict[str, Any] | None = None
    quality: _Quality = msgspec.field(default_factory=_Quality)
    band: _Band | None = None
    axes: dict[str, Any] = {}


# -- Public doors --


def machine(
    name: str,
    *,
    channels: Mapping[str, str | Mapping[str, Any]],
    response: str | Sequence[str] = "",
    terms: Mapping[str, str | Mapping[str, Any]] | None = None,
    actuators: Mapping[str, Mapping[str, Any]] | None = None,
    let: Mapping[str, str | Mapping[str, Any]] | None = None,
    derived: Mapping[str, str | Mapping[str, Any]] | None = None,
    axes: Mapping[str, Mapping[str, Any]] | None = None,
    active: str = "",
    instruments: Sequence[str] = (),
    band_hz: tuple[float, float] | None = None,
    headline: Sequence[str] = (),
    half_width: float = 0.2,
    weak_half_width: float = 0.5,
    **words: str,
) -> Machine:
    """Declare a machine: its channels, and equations whose parameters are to be identified.

    Parameters
    ----------
    name : str
        What it is called in results.
    channels : mapping
        Each channel's SI unit, or `input`, `reference` or a mapping with the keys of a file.
    response : str or sequence of str
        Expression for what is explained, such as "ddt(r)"; of several the last is always logged.
    terms : mapping
        Parameter = expression, or `behind` for what an actuator drives. A term of "1" is an intercept.
    actuators : mapping
        `actuator` for each name that terms stand behind.
    let, derived : mapping
        Names for expressions over channels, and quantities that are expressions over parameters; with
        ``{"is": ..., "unit": ...}`` where a unit does not follow.
    axes : mapping
        Several equations in place of one: a mapping with response and terms for each.
    active : str
        Condition under which samples count. Default: where no speed with a sign in a term stands still.
    instruments : sequence of str
        Expressions over references. Default: the references, their lags, and the curves of terms of them.
    band_hz : tuple of float
        Band of the rows in frequency [Hz].
    headline : sequence of str
        Quantities whose verdicts make the overall one. Default: every parameter but intercepts.
    half_width, weak_half_width : float
        Largest half-widths of what is identified and of what is weak, as shares.
    **words : str
        `title`, and what to do and to log where a log identifies too little: `move`, `log`.

    Returns
    -------
    Machine
        A motion for ``ev.identify_flight(log, model=...)``. Its channels are known from here on: make it
        before its logs are read.

    Raises
    ------
    InputError
        For a declaration that does not hold together, with the key and a suggestion.
    """
    tables = {"terms": terms, "actuators": actuators, "let": let, "derived": derived, "axes": axes}
    quality = {"headline": headline, "half_width": half_width, "weak_half_width": weak_half_width}
    values = {"name": name, "channels": channels, "response": response, "quality": quality, **words}
    values |= {key: table for key, table in tables.items() if table is not None}
    lone = {
        "active": ("when", active, ""),
        "instruments": ("of", instruments, ()),
        "band": ("hz", band_hz, None),
    }
    for section, (key, value, default) in lone.items():
        if not isinstance(value, type(default)) or value:
            values[section] = {key: value}
    return machine_of(TomlTable(_plain(values), "ev.machine"))


def behind(of: str, actuator: str, **keys: str) -> dict[str, Any]:
    """Term that an actuator drives: an expression over inputs, and the actuator's name."""
    checks.text("of", of)
    checks.text("actuator", actuator)
    return {"of": of, "behind": actuator, **keys}


def input(unit: str = "", **keys: Any) -> dict[str, Any]:
    """Channel that drives a machine, and holds its values between stamps unless ``held=False``."""
    checks.text("unit", unit)
    return {"unit": unit, "role": "input", **keys}


def reference(unit: str = "", **keys: Any) -> dict[str, Any]:
    """Channel that was set beforehand; with ``feedback=True`` one that a controller computes."""
    checks.text("unit", unit)
    return {"unit": unit, "role": "reference", **keys}


def actuator(
    *, lag_s: tuple[float, float] = (0.0, 0.0), delay_s: tuple[float, float] = (0.0, 0.0)
) -> dict[str, Any]:
    """Actuator of first order: the least and the largest lag and delay [s]."""
    for name, ends in {"lag_s": lag_s, "delay_s": delay_s}.items():
        checks.items(name, ends, (int, float), "two numbers", "Give the least and the largest.")
    return {"lag_ms": [1e3 * item for item in lag_s], "delay_ms": [1e3 * item for item in delay_s]}


def load_machine(source: str | os.PathLike[str]) -> Machine:
    """Machine of a file, or one that comes with Eivor.

    Parameters
    ----------
    source : str or path
        Path of a TOML file, or a name out of `shipped_machines`.

    Raises
    ------
    InputError
        When there is none, or the file has something wrong in it.
    """
    checks.path("source", source)
    return machine_of(replace(MACHINES.table(source), text=MACHINES.text(source)))


MACHINES = TomlFiles("eivor.motions", "machines", "a machine", "Check the name.")
shipped_machines, machine_text = MACHINES.names, MACHINES.text


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


# -- Reading --


@dataclass(frozen=True)
class _Names:
    top: TomlTable
    channels: Mapping[str, MachineChannel]
    units: Mapping[str, Unit]  # Of channels, then of names
    lets: Mapping[str, str]  # Expression of each name
    actuators: tuple[str, ...]

    def expanded(self, text: str) -> str:
        """The text with names of `[let]` substituted."""
        if text.strip() in self.lets:
            return self.lets[text.strip()]

        def substitute(match: re.Match[str]) -> str:
            return _parenthesised(self.lets[match[0]]) if match[0] in self.lets else match[0]

        parts = re.split(r'("[^"]*")', text)
        parts[::2] = [_NAME.sub(substitute, part) for part in parts[::2]]
        return "".join(parts)

    def unit(self, section: TomlTable, key: str, text: str) -> tuple[Unit, bool]:
        """Unit of an expression, with every name in it checked."""
        expression = _parsed_checked(section, key, text)
        for name in expression.columns:
            if name not in self.units:
                expected = f"an expression over {', '.join(self.units)}"
                remedy = did_you_mean(name, tuple(self.units), "Declare the channel: its unit and role.")
                raise section.wrong(key, expected, f"{text!r} with '{name}'", remedy)
        return _unit_checked(section, key, lambda: unit_of(expression, self.units))


def _parenthesised(text: str) -> str:
    """An expression ready to stand in another: in parentheses unless it is a name or a function."""
    return text if isinstance(_tree(text), ast.Name | ast.Call | ast.Constant) else f"({text})"


def _tree(text: str) -> ast.expr:
    return ast.parse(text.strip(), mode="eval").body


def _parsed_checked(section: TomlTable, key: str, text: str) -> Expression:
    try:
        return parsed(text)
    except ChannelMapError as error:
        raise section.wrong(key, "an expression", error.received, error.remedy) from None


def _unit_checked(section: TomlTable, key: str, compute: Any) -> Any:
    try:
        return compute()
    except UnitError as error:
        received, remedy = error.args
        raise section.wrong(key, "units that fit", received, remedy) from None


def _tables(top: TomlTable, name: str, only_key: str) -> dict[str, TomlTable]:
    """Tables of a section by name; a text stands for a table with one key."""
    entries = top.values.get(name, {})
    if not isinstance(entries, dict):
        raise top.wrong(name, f"a table [{name}]", repr(entries))
    tables = {key: {only_key: value} if isinstance(value, str) else value for key, value in entries.items()}
    parent = top.part(name, tables)
    for key in tables:
        if not _NAME.fullmatch(key):
            raise parent.wrong(key, "a name of letters, digits and _", repr(key), "Rename it.")
        if name in ("terms", "derived") and key in LAG_QUANTITIES:
            remedy = f"Rename it, such as {key}_of_term."
            raise parent.wrong(key, "a name that no lag of actuators has", repr(key), remedy)
    return {key: parent.part(key) for key in tables}


def machine_of(top: TomlTable) -> Machine:
    """Machine of a declaration; its channels are known from then on."""
    spec = top.convert(_File)
    channels = {name: _channel(name, section) for name, section in _tables(top, "channels", "unit").items()}
    delays = _actuators(top)
    names = _names(top, channels, tuple(delays))
    if bool(spec.axes) == bool(spec.terms):
        expected = "one equation by response and [terms], or several by [axes.NAME]"
        raise top.wrong("terms", expected, "both" if spec.axes else "neither", "Give one.")
    sections = _tables(top, "axes", "response") if spec.axes else {spec.title or spec.name: top}
    axes = tuple(_axis(name, part, names) for name, part in sections.items())
    terms = {term.name: term for axis in axes for term in axis.terms}
    if len(terms) < sum(len(axis.terms) for axis in axes):
        raise top.wrong("axes", "parameters with names of their own", "one name in two axes", "Rename one.")
    for name in delays if not any(term.behind for term in terms.values()) else ():
        expected, received = "an actuator that a term stands behind", f"'{name}', which no term names"
        remedy = f'Add behind = "{name}" to the term of the input, or leave the actuator out.'
        raise top.part("actuators").wrong(name, expected, received, remedy)
    derived = _derived(top, terms)
    quality = spec.quality
    headline = tuple(quality.headline) or tuple(t.name for t in terms.values() if not t.is_intercept)
    known = (*terms, *(item.name for item in derived))
    for name in headline:
        if name not in known:
            expected, remedy = f"quantities out of {', '.join(known)}", "Name some of them."
            remedy = did_you_mean(name, known, remedy)
            raise top.part("quality").wrong("headline", expected, f"'{name}'", remedy)
    if not 0.0 < quality.half_width <= quality.weak_half_width:
        received = f"{quality.half_width:g} and {quality.weak_half_width:g}"
        raise top.part("quality").wrong("half_width", "0 < half_width <= weak_half_width", received)
    texts = (text for axis in axes for text in (*axis.response, *(term.of for term in axis.terms)))
    used = {column for text in texts for column in parsed(text).columns}
    if not any(channels[name].role == "input" for name in used):
        raise top.wrong("channels", "an equation with an input", "none", 'Give a channel role = "input".')
    for name, channel in channels.items():
        if name not in used and channel.role in ("input", "response"):
            expected = "a channel that the equation uses"
            raise top.part("channels").wrong(name, expected, f"'{name}', unused", "Leave it out.")
    logged = tuple(channels.values())
    result = Machine(
        spec.name,
        spec.title or spec.name,
        _equation(axes),
        logged,
        axes,
        headline,
        spec.move,
        spec.log or f"Log {', '.join(channel.name for channel in logged)} at 50 Hz or more.",
        derived,
        (quality.half_width, quality.weak_half_width),
        _activity(top, spec.active, names, axes),
        _band(top, spec.band),
        top.values,
        next(iter(delays.values()), ((0.0,), (0.0,))),
    )
    declare_channels(*result.channels.added, replacing=True)
    return result


def _channel(name: str, section: TomlTable) -> MachineChannel:
    spec = section.convert(_Channel)
    role = section.choose("role", spec.role, ROLES)
    unit = _unit_checked(section, "unit", lambda: parsed_unit(spec.unit))
    held = role in ("input", "reference") if spec.held is None else spec.held
    noise: float | DataSheet | None = spec.noise
    if spec.quantisation is not None:
        if spec.noise is not None or not spec.quantisation > 0.0:
            expected = "noise, or a quantisation above zero"
            raise section.wrong("quantisation", expected, f"{spec.quantisation:g}", "Leave out one of them.")
        noise = DataSheet(0.0, None, spec.quantisation)
    elif spec.noise is not None and not spec.noise >= 0.0:
        raise section.wrong("noise", "a standard deviation of zero or more", f"{spec.noise:g}")
    logged_unit = "" if spec.unit == "1" else spec.unit
    known = canonical_channel(name)
    if known is not None and known in BUILT_IN and not known.free_unit and parsed_unit(known.unit) != unit:
        expected = f"the unit of the canonical channel {name}, {known.unit or 'a pure number'}"
        raise section.wrong("unit", expected, f"'{spec.unit}'", "Correct it, or rename the channel.")
    return MachineChannel(name, logged_unit, role, held, spec.feedback, noise)


def _names(top: TomlTable, channels: Mapping[str, MachineChannel], actuators: tuple[str, ...]) -> _Names:
    """Units of channels and of the names of [let], and the expression of each such name."""
    units = {name: parsed_unit(item.unit) for name, item in channels.items()}
    names = _Names(top, channels, units, {}, actuators)
    for name, section in _tables(top, "let", "is").items():
        spec = section.convert(_Let)
        if name in channels:
            raise section.wrong("", "a name that no channel has", f"'{name}'", "Rename it.")
        unit, scaled = names.unit(section, "is", spec.of)
        unit = _declared_unit(section, spec.unit, unit, scaled)
        lets = {**names.lets, name: names.expanded(spec.of)}
        _parsed_checked(section, "is", lets[name])
        names = replace(names, units={**names.units, name: unit}, lets=lets)
    return names


def _declared_unit(section: TomlTable, text: str | None, unit: Unit, scaled: bool) -> Unit:
    """Declared unit of an expression, else its own; one with a number as a factor may have any."""
    if text is None:
        return unit
    declared: Unit = _unit_checked(section, "unit", lambda: parsed_unit(text))
    if declared != unit and not scaled:
        expected = f"the unit that follows, {unit_text(unit) or '1'}"
        raise section.wrong("unit", expected, f"'{text}'", "Leave it out, or correct the expression.")
    return declared


def _actuators(top: TomlTable) -> dict[str, tuple[Any, Any]]:
    results = {}
    for name, section in _tables(top, "actuators", "lag_ms").items():
        spec = section.convert(_Actuator)
        if spec.order != 1:
            raise section.wrong("order", "an actuator of first order", f"{spec.order}", "Give order = 1.")
        for key in ("lag_ms", "delay_ms"):
            ends = getattr(spec, key)
            if len(ends) != 2 or not 0.0 <= ends[0] <= ends[1] <= LONGEST_MS:
                expected = f"[least, largest] in ms, from 0 to {LONGEST_MS:g}"
                raise section.wrong(key, expected, f"{ends}", "Such as [10, 300].")
        (lag, last), (low, high) = spec.lag_ms, spec.delay_ms
        first = max(lag, 0.005 * last)
        lags = np.geomspace(first, last, LAGS) if last > first else np.array([last])
        delays = np.linspace(low, high, DELAYS) if high > low else np.array([high])
        results[name] = tuple((1e-3 * lags).tolist()), tuple((1e-3 * delays).tolist())
    if len(results) > 1:
        received, part = ", ".join(results), top.part("actuators")
        expected = "one actuator, which all terms share"
        raise part.wrong(list(results)[-1], expected, received, "Declare the slowest.")
    return results


def _axis(name: str, section: TomlTable, names: _Names) -> AxisEquation:
    top = names.top
    spec = section.convert(_Axis) if section is not top else top.convert(_File)
    responses = [spec.response] if isinstance(spec.response, str) else spec.response
    if not any(responses):
        raise section.wrong("response", "an expression, such as ddt(p)", "none", "Add it.")
    units = [names.unit(section, "response", text)[0] for text in responses]
    _refuse_references(section, "response", names, responses)
    if any(unit != units[0] for unit in units):
        both = " and ".join(unit_text(unit) or "a pure number" for unit in units)
        raise section.wrong("response", "candidates of one unit", both, "Correct one of them.")
    expanded = tuple(names.expanded(text) for text in responses)
    terms = tuple(
        _term(key, part, names, expanded, units[0]) for key, part in _tables(section, "terms", "of").items()
    )
    if all(term.is_intercept for term in terms):
        raise section.wrong("terms", "a term with a channel", "none", "Add one: NAME = EXPRESSION.")
    texts = (*expanded, *(term.of for term in terms))
    columns = dict.fromkeys(column for text in texts for column in parsed(text).columns)
    inputs = tuple(column for column in columns if names.channels[column].role == "input")
    known = [item.name for item in names.channels.values() if item.role == "reference"]
    references = (spec.references if isinstance(spec, _Axis) else None) or known
    for item in references:
        if item not in known:
            remedy = did_you_mean(item, known, "Give its channel that role.")
            raise section.wrong("references", f"references out of {', '.join(known)}", f"'{item}'", remedy)
    unlagged = [column for term in terms if not term.behind for column in parsed(term.of).columns]
    unlagged += [column for text in expanded for column in parsed(text).columns]
    lagged = " + ".join(f"{term.symbol} {term.of}" for term in terms if term.behind)
    unit = unit_text(units[0])
    return AxisEquation(
        name,
        inputs,
        expanded,
        terms,
        (responses[-1], unit.replace("^2", "²"), "the sum of terms", lagged or "nothing behind an actuator"),
        tuple(ReferenceSource(item) for item in references),
        state=_state(expanded[-1], names, inputs),
        mirrors=tuple(_mirrors(terms, names, references)),
        instruments_of=_instruments(top, names),
        averaged=tuple(name for name in inputs if name in unlagged and names.channels[name].held),
    )


def _term(
    name: str, section: TomlTable, names: _Names, responses: tuple[str, ...], response_unit: Unit
) -> Term:
    spec = section.convert(_Term)
    unit, _ = names.unit(section, "of", spec.of)
    _refuse_references(section, "of", names, [spec.of])
    text = names.expanded(spec.of)
    expression = _parsed_checked(section, "of", text)
    if text in responses:
        raise section.wrong("of", "a term that is not the response", f"'{spec.of}'", "Leave it out.")
    inputs = [column for column in expression.columns if names.channels[column].role == "input"]
    if spec.behind:
        section.choose("behind", spec.behind, names.actuators)
        if not inputs:
            expected = "an expression over an input, which the actuator follows,"
            raise section.wrong("of", expected, f"'{spec.of}'", 'Leave out behind, or give a role = "input".')
    elif any(
        first in inputs and isinstance(step, InTime) and step.lag_s is None
        for first, step in pairwise(expression.steps)
    ):
        expected, received = "a derivative of what was measured", f"'{spec.of}' of a held input"
        raise section.wrong("of", expected, received, "Put the term behind an actuator, or leave ddt out.")
    required = over(response_unit, unit)
    if spec.unit is not None:
        stated = _unit_checked(section, "unit", lambda: parsed_unit(spec.unit or ""))
        if stated != required:
            expected = f"the unit that makes the term one of the response, {unit_text(required) or '1'}"
            raise section.wrong("unit", expected, f"'{spec.unit}'", "Correct it, or the expression.")
    unit_words = unit_text(required) if spec.unit is None else spec.unit
    return Term(name, text, spec.symbol or name, unit_words, behind=bool(spec.behind))


def _refuse_references(section: TomlTable, key: str, names: _Names, texts: Sequence[str]) -> None:
    for text in texts:
        for name in parsed(names.expanded(text)).columns:
            if names.channels[name].role == "reference":
                expected = (
                    "an equation over states and inputs: a reference is an instrument and stands in no term"
                )
                received = f"{text!r} with the reference '{name}'"
                raise section.wrong(key, expected, received, "Name what was measured.")


def _state(response: str, names: _Names, inputs: tuple[str, ...]) -> tuple[str, str, str] | None:
    """Channel, words and unit of the state whose derivative is explained."""
    match parsed(response).steps:
        case (str() as name, InTime()) if name not in inputs:
            return name, name.replace("_", " "), names.channels[name].unit
    return None


#: Functions that are linear in their arguments.
_LINEAR = {np.add, np.subtract, np.negative}


def _mirrors(terms: Sequence[Term], names: _Names, references: Sequence[str]) -> Iterator[Mirror]:
    """Each nonlinear term over every reference whose time derivatives have the units of its states."""
    for term in terms:
        curved = any(isinstance(step, np.ufunc) and step not in _LINEAR for step in term.expression.steps)
        if not curved or term.behind or term.is_intercept:
            continue
        for name in references:
            unit, orders = names.units[name], {}
            for column in term.expression.columns:
                for order in range(3):
                    if over(unit, {"s": Fraction(order)} if order else {}) == names.units[column]:
                        orders[column] = order
                        break
            if len(orders) == len(term.expression.columns):
                yield Mirror(name, term.of, orders)


def _instruments(top: TomlTable, names: _Names) -> tuple[str, ...]:
    if "instruments" not in top.values:
        return ()
    part = top.part("instruments")
    texts = part.convert(_Instruments).of
    for text in texts:
        names.unit(part, "of", text)
        for name in parsed(names.expanded(text)).columns:
            if names.channels[name].role != "reference":
                expected = "instruments that are expressions over references"
                raise part.wrong("of", expected, f"{text!r} with '{name}'", "Use references only.")
    return tuple(names.expanded(text) for text in texts)


def _derived(top: TomlTable, terms: Mapping[str, Term]) -> tuple[Derived, ...]:
    results = []
    parameters = {name: term for name, term in terms.items() if not term.is_intercept}
    units = {name: parsed_unit(term.unit) for name, term in parameters.items()}
    for name, section in _tables(top, "derived", "is").items():
        spec = section.convert(_Let)
        expression = _parsed_checked(section, "is", spec.of)
        for item in expression.columns or ("",):
            if item not in units:
                remedy = did_you_mean(item, tuple(units), "Name parameters.")
                expected = f"an expression over the parameters {', '.join(units)}"
                raise section.wrong("is", expected, f"{spec.of!r} with '{item}'", remedy)
        if name in terms:
            raise section.wrong("", "a name that no parameter has", f"'{name}'", "Rename it.")
        unit, scaled = _unit_checked(section, "is", lambda e=expression: unit_of(e, units))
        unit_of_value = _declared_unit(section, spec.unit, unit, scaled)
        text = spec.unit if spec.unit is not None else unit_text(unit_of_value)
        results.append(Derived(name, spec.of, spec.symbol or spec.of, "" if text == "1" else text))
    return tuple(results)


def _activity(top: TomlTable, spec: _Active | None, names: _Names, axes: Sequence[AxisEquation]) -> Activity:
    speeds = dict.fromkeys(speed for axis in axes for term in axis.terms for speed in _signs(term.of))
    if spec is None:
        return Activity("", tuple(speeds))
    names.unit(top.part("active"), "when", spec.when)
    when = names.expanded(spec.when)
    # a speed that the condition is over stands still where the condition says
    covered = {*parsed(when).columns}
    return Activity(when, tuple(item for item in speeds if not {*parsed(item).columns} <= covered))


def _signs(text: str) -> Iterator[str]:
    """Arguments of the signs in an expression."""
    for node in ast.walk(_tree(text)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id.lower() == "sign":
            yield ast.unparse(node.args[0]).replace("'", '"')


def _band(top: TomlTable, band: _Band | None) -> tuple[float, float] | None:
    if band is None:
        return None
    if len(band.hz) != 2 or not 0.0 <= band.hz[0] < band.hz[1]:
        expected, received = "[low, high] in Hz with low < high", f"{band.hz}"
        raise top.part("band").wrong("hz", expected, received, "Such as [0.05, 5].")
    return band.hz[0], band.hz[1]


def _signed_term(term: Term) -> str:
    text, sign = term.of.strip(), "+"
    if text.startswith("-") and not isinstance(getattr(_tree(text), "op", None), ast.Add | ast.Sub):
        text, sign = text[1:].strip(), "-"
    return f" {sign} {term.symbol} {_parenthesised(text)}".removesuffix(" 1")


def _equation(axes: Sequence[AxisEquation]) -> tuple[str, str]:
    """The equations in one line, and the inputs that the actuator lags."""
    lines = []
    for axis in axes:
        text = "".join(map(_signed_term, axis.terms)).removeprefix(" + ")
        intercept = "" if any(term.is_intercept for term in axis.terms) else " + b"
        lines.append(f"{axis.response[-1]} = {text.strip()}{intercept}")
    lagging = sorted({name for axis in axes for t in axis.terms if t.behind for name in parsed(t.of).columns})
    behind_words = f"; {', '.join(lagging)} behind tau x' + x = input(t - d)" if lagging else ""
    return "; ".join(lines), f"b an intercept for each run{behind_words}"


# -- Units --

#: Powers of base units; none of a pure number. Angles are pure numbers, as in SI.
Unit = Mapping[str, Fraction]

#: Units that are products of base units.
_DERIVED_UNITS = {"N": "kg m/s^2", "J": "kg m^2/s^2", "W": "kg m^2/s^3", "Pa": "kg/m/s^2", "Hz": "1/s"}
_DERIVED_UNITS |= {"rad": "", "1": ""}
_BASE_UNITS = ("kg", "m", "s", "A", "V", "K", "degC", "us")
#: Products that have a name of their own.
_NAMED_UNITS = {"kg m/s^2": "N", "kg m^2/s^2": "N m", "kg/s": "N s/m", "kg m^2/s": "N m s"}
_FACTOR = re.compile(r"\s*([*/·]?)\s*([A-Za-z]+|1)(?:\^(-?\d(?:\.\d+)?|\(\d{1,9}/[1-9]\d{0,8}\))|([²³]))?")


class UnitError(ValueError):
    """Units that do not fit: what was received, and the remedy."""


def parsed_unit(text: str) -> Unit:
    """Powers of base units of a text such as ``rad/s^2`` or ``N m``."""
    powers: dict[str, Fraction] = {}
    offset, stripped = 0, text.strip()
    while offset < len(stripped):
        match = _FACTOR.match(stripped, offset)
        if match is None:
            raise UnitError(f"the unit '{text}'", "Write it as m/s^2, N m or 1/s.")
        sign, name, digits, raised = match.groups()
        power = Fraction((digits or "").strip("()") or {"²": 2, "³": 3}.get(raised, 1))
        power = -power if sign == "/" else power
        if name in _DERIVED_UNITS:
            powers = dict(_product(powers, parsed_unit(_DERIVED_UNITS[name]) if name != "1" else {}, power))
        elif name in _BASE_UNITS:
            powers = dict(_product(powers, {name: Fraction(1)}, power))
        else:
            si = UNITS.get("deg" if name.startswith("degree") else name, ("", 0.0))[0]
            remedy = f"Give it in {si}, and convert in a channel map." if si else "Units are those of SI."
            names = (*_BASE_UNITS, *_DERIVED_UNITS)
            raise UnitError(f"the unit '{text}'", remedy if si else did_you_mean(name, names, remedy))
        offset = match.end()
    return powers


def _product(left: Unit, right: Unit, power: int | Fraction = 1) -> Unit:
    names = dict.fromkeys((*left, *right))
    result = {name: left.get(name, Fraction(0)) + power * right.get(name, Fraction(0)) for name in names}
    return {name: value for name, value in result.items() if value}


def over(above: Unit, below: Unit) -> Unit:
    """Quotient of two units."""
    return _product(above, below, -1)


def unit_text(unit: Unit) -> str:
    """A unit as it is written; empty for a pure number."""
    order = [name for name in _BASE_UNITS if name in unit]

    def factor(name: str, power: Fraction) -> str:
        exponent = f"{power}" if power.denominator == 1 else f"({power})"
        return name if power == 1 else f"{name}^{exponent}"

    numerator = " ".join(factor(name, unit[name]) for name in order if unit[name] > 0)
    denominator = "".join(f"/{factor(name, -unit[name])}" for name in order if unit[name] < 0)
    text = (numerator or ("1" if denominator else "")) + denominator
    return _NAMED_UNITS.get(text, text)


_EQUAL_UNITS = {np.add, np.subtract, np.maximum, np.minimum, np.hypot, np.arctan2}
_CONDITIONS = set(CONDITIONS.values())
_SAME_UNIT = {np.negative, np.absolute}
_UNITLESS = {np.sign, np.arctan2, *_CONDITIONS}
_LOGICAL = {np.logical_and, np.logical_or, np.logical_not}


def unit_of(expression: Expression, units: Mapping[str, Unit]) -> tuple[Unit, bool]:
    """Unit of an expression, and whether it is a number or has one as a factor."""
    stack: list[tuple[Unit, float | None]] = []
    scaled = not expression.columns
    for step in expression.steps:
        if isinstance(step, str):
            stack.append((units[step], None))
        elif isinstance(step, float):
            stack.append(({}, step))
        elif isinstance(step, InTime):
            unit, _ = stack.pop()
            stack.append((_product(unit, {"s": Fraction(1)}, -1) if step.lag_s is None else unit, None))
        else:
            arguments = [stack.pop() for _ in range(step.nin)][::-1]
            scaled |= step in (np.multiply, np.divide) and any(number is not None for _, number in arguments)
            number = None if any(item is None for _, item in arguments) else math.nan
            stack.append((_result_unit(step, arguments, expression.text), number))
    return stack.pop()[0], scaled


def _result_unit(step: np.ufunc, arguments: Sequence[tuple[Unit, float | None]], text: str) -> Unit:
    first, last = arguments[0][0], arguments[-1][0]
    if step in (np.multiply, np.divide):
        return _product(first, last, 1 if step is np.multiply else -1)
    exponent = 0.5 if step is np.sqrt else arguments[1][1] if step is np.power else None
    if exponent is not None and math.isfinite(exponent):
        return {name: value * Fraction(exponent).limit_denominator(8) for name, value in first.items()}
    if step in _EQUAL_UNITS or (step in _CONDITIONS and step not in _LOGICAL):
        operands = [unit for unit, number in arguments if number is None]
        if any(unit != operands[0] for unit in operands):
            both = " and ".join(unit_text(unit) or "a pure number" for unit in operands)
            raise UnitError(f"'{text}', which joins {both}", "Give both the same unit.")
        return {} if step in _UNITLESS or not operands else operands[0]
    if step in _SAME_UNIT:
        return first
    if step in _UNITLESS or step in _LOGICAL:
        return {}
    if any(unit for unit, _ in arguments):
        received = f"'{text}', with {step.__name__} of {unit_text(first or last)}"
        raise UnitError(received, "Divide by a scale of that unit first.")
    return {}
