"""What an export takes and returns, and the interface of a target."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from eivor import checks
from eivor.errors import NotIdentifiedError, UsageError
from eivor.flights.quantity import Quantity
from eivor.inference.covariance import JointEstimate
from eivor.inference.verdict import Status
from eivor.motions.machine import Machine
from eivor.motions.rigid_body.vehicle import KnownNumber, KnownVehicle
from eivor.signals.channels import CurveSide
from eivor.signals.thrust_map import InputMap, input_map
from eivor.strict_toml import package_tables

if TYPE_CHECKING:
    from jinja2 import Environment

#: Longer strings are cut: some readers of parameters have lines of bounded length.
LONGEST = 400


def one_line(text: str) -> str:
    """`text` in printable ASCII: control characters, line breaks and other letters as backslash escapes."""
    printable = "".join(
        c if " " <= c <= "~" else c.encode("unicode_escape", "surrogatepass").decode("ascii")
        for c in text.replace("±", "+-")
    )
    return printable if len(printable) <= LONGEST else f"{printable[: LONGEST - 3]}..."


def hash_comments(lines: Iterable[str]) -> str:
    """Lines that begin with ``#``."""
    return "\n".join(f"# {one_line(line)}".rstrip() for line in lines)


def xml_comments(lines: Iterable[str]) -> str:
    """Comments of XML, which hold no two hyphens in a row."""
    return "\n".join(f"<!-- {re.sub('-(?=-)', '- ', one_line(line)).rstrip('-')} -->" for line in lines)


def single(value: float) -> str:
    """Fewest digits that give back the 32-bit float, without an exponent."""
    return np.format_float_positional(np.float32(value), trim="0")


@cache
def _templates() -> Environment:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(  # noqa: S701 - comments are escaped as each format has them, all else are numbers
        loader=PackageLoader("eivor.exports"),
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        undefined=StrictUndefined,
    )
    environment.filters |= {"hash": hash_comments, "xml": xml_comments, "single": single}
    return environment


def rendered(file: str, comments: Iterable[str], **values: object) -> str:
    """Text of a template."""
    return _templates().get_template(file).render(comments=comments, **values)


def listed(names: Sequence[str]) -> str:
    """Names with their verb."""
    return f"{', '.join(names)} {'is' if len(names) == 1 else 'are'}"


#: Verdicts that an export may accept, the worst first; and words up to which it does.
ACCEPTABLE = (Status.PROVISIONAL, Status.WEAK)
ACCEPTABLE_WORDS = ("identified", "weak", "provisional")


def accepted_verdicts(word: str) -> frozenset[Status]:
    """Verdicts that are written: up to the one of this word."""
    known = "A refused number is never written."
    accepted = checks.index_of("a verdict to accept", word, ACCEPTABLE_WORDS, known)
    return frozenset(ACCEPTABLE[len(ACCEPTABLE) - accepted :])


#: Name in documents of the motion that exports are made of.
VERTICAL = "vertical_motion"


def known_number(value: float, std: float = 0.0) -> KnownNumber:
    """Number that a user gives to an export."""
    if not (math.isfinite(value) and 0.0 <= std < math.inf):
        remedy = "Give 1.53:0.02, for example."
        raise UsageError("a number and a standard deviation that is not below zero", f"{value}:{std}", remedy)
    return KnownNumber(value, std)


@dataclass(frozen=True, slots=True)
class Supplied:
    """Prior knowledge of the user."""

    mass: KnownNumber | None = None  # [kg]
    priors: Mapping[str, KnownNumber] = field(default_factory=dict)
    vehicle: KnownVehicle | None = None

    def __post_init__(self) -> None:
        if self.mass is not None and not self.mass.value > 0.0:
            raise UsageError("a mass above zero [kg]", f"{self.mass.value}", "Give 1.53:0.02, for example.")

    def number(self, name: str) -> Number | None:
        """A prior as it is written; None where none is given."""
        prior = self.priors.get(name)
        return None if prior is None else Number(prior.value, prior.interval, "given")

    def check_only(self, names: tuple[str, ...], target: str, *, body: bool) -> None:
        """Refuse inputs that a target ignores: a user would expect an effect."""
        inputs = {
            "mass": self.mass and f"{self.mass.value} kg",
            "vehicle": self.vehicle and f"'{self.vehicle.name}'",
        }
        for name, received in inputs.items():
            if received and not body:
                expected = f"no {name} for {target}, which is made of ratios"
                raise UsageError(expected, received, "Leave it out.")
        for name in self.priors:
            if name not in names:
                useful = ", ".join(names) or "none"
                raise UsageError(f"priors that {target} uses ({useful})", f"'{name}'", "Leave it out.")


@dataclass(frozen=True, slots=True)
class Number:
    """A number that is written, with what stands beside it."""

    value: float
    interval: tuple[float, float]
    source: str = "identified"

    @property
    def excludes_zero(self) -> bool:
        low, high = self.interval
        return not low <= 0.0 <= high

    @property
    def words(self) -> str:
        low, high = self.interval
        return f"{self.value:.6g}, 95 % interval [{low:.6g}, {high:.6g}], {self.source}"


@dataclass(frozen=True)
class Fitted:
    """A result as exports see it."""

    model: str  # Name of the motion in documents
    quantities: Mapping[str, Quantity]  # With their verdicts
    input: str  # Channel, or family of channels, that drove the vehicle
    map_name: str  # Input map, see `eivor.signals.thrust_map`
    curve_side: CurveSide
    curve_in_force: Mapping[str, float]
    input_measured: bool
    formats: tuple[str, ...]
    logs: tuple[tuple[str, str], ...]  # Name and SHA-256 of each log
    version: str
    vehicle: KnownVehicle | None = None
    names: tuple[str, ...] = ()
    joint: JointEstimate | None = None
    accepted: frozenset[Status] = frozenset()  # Verdicts beside identified that are written
    logged: Mapping[str, float] = field(default_factory=dict)  # The autopilot's parameters in the logs
    machine: Machine | None = None  # Whose equations these are

    @property
    def input_map(self) -> InputMap:
        return input_map(self.map_name)

    def origin(self, numbers: Mapping[str, Number] | None = None) -> Iterator[str]:
        """Sentences that say where the numbers come from, and what stands beside those that are given."""
        yield f"Written by Eivor {self.version}."
        for name, sha256 in self.logs:
            yield f"Log: {name}, SHA-256 {sha256 or 'unknown'}"
        side = f", {self.curve_side.value} the autopilot's thrust curve" if self.curve_side.value else ""
        yield f"Command: {self.input}{side}, input map {self.map_name}."
        for name, number in (numbers or {}).items():
            yield f"{name}: {number.words}"

    def check_vertical(self, target: str) -> None:
        if self.model != VERTICAL:
            remedy = "Identify the log with --model vertical."
            raise UsageError(f"a result of the vertical motion for {target}", f"one of {self.model}", remedy)

    def is_identified(self, name: str) -> bool:
        """Whether there is such a quantity, and it is identified, or its verdict is accepted."""
        verdicts = {Status.IDENTIFIED, *self.accepted}
        return name in self.quantities and self.quantities[name].verdict in verdicts

    def lacking(self, names: Iterable[str]) -> tuple[str, ...]:
        """Names of quantities that are not identified."""
        return tuple(name for name in names if not self.is_identified(name))

    def source(self, *names: str) -> str:
        """Worst verdict of quantities, as it stands beside a number that is made of them."""
        verdicts = {self.quantities[name].verdict for name in names if name in self.quantities}
        worst = next((item for item in ACCEPTABLE if item in verdicts), Status.IDENTIFIED)
        return worst.value if worst is Status.IDENTIFIED else f"{worst.value.upper()}, not identified"

    def identified_number(self, name: str) -> Number | None:
        """A quantity that is identified; None for any other."""
        if not self.is_identified(name) or not math.isfinite(self.quantities[name].value):
            return None
        return Number(self.quantities[name].value, self.quantities[name].interval, self.source(name))

    def left_over(self, target: str, names: Collection[str]) -> Iterator[str]:
        """Sentences about what is identified and a target has no place for."""
        for name in self.quantities:
            number = self.identified_number(name) if name in names else None
            if number is not None and number.excludes_zero:
                words = name.replace("_", " ")
                at_start = re.sub("^a ", "A ", target)
                yield f"{at_start} has no {words}, and {name} {number.value:.4g} not in this file."

    def why_not(self, *names: str) -> str:
        """Why quantities are not written; a sentence that several share stands once."""
        verdicts: dict[str, list[str]] = {}
        for name in names:
            item = self.quantities.get(name)
            verdicts.setdefault("not estimated" if item is None else item.verdict.value, []).append(name)
        reasons = (item.reasons for name, item in self.quantities.items() if name in names)
        sentences = dict.fromkeys(reason.sentence for of_name in reasons for reason in of_name)
        return " ".join((*(f"{listed(items)} {why}." for why, items in verdicts.items()), *sentences))

    def needed(self, names: Iterable[str], supplied: Supplied, target: str) -> dict[str, Number]:
        """Quantities that a target cannot do without: identified, or else given."""
        candidates = {name: self.identified_number(name) or supplied.number(name) for name in names}
        numbers = {name: number for name, number in candidates.items() if number is not None}
        missing = [name for name in candidates if name not in numbers]
        if missing:
            priors = " ".join(f"--prior {name}=VALUE:STD" for name in missing)
            raise NotIdentifiedError(
                f"{', '.join(missing)} identified, which {target} cannot do without",
                self.why_not(*missing).rstrip("."),
                f"Fly again as the report says, or give what is known: {priors}.{self.acceptance(*missing)}",
            )
        return numbers

    def acceptance(self, *names: str) -> str:
        """Sentence that says which option would write quantities that are not identified."""
        verdicts = {self.quantities[name].verdict for name in names if name in self.quantities}
        worst = next((item for item in ACCEPTABLE if item in verdicts), None)
        return f" Or write them with their verdict: --accept {worst.value}." if worst else ""


@dataclass(frozen=True, slots=True)
class Exported:
    """A file's content."""

    text: str | bytes
    omitted: tuple[str, ...] = ()  # Quantities that are not identified
    lost: tuple[str, ...] = ()  # Effects that are identified and the target cannot represent


class Target(msgspec.Struct, frozen=True):
    """A file format of those who use the numbers."""

    name: str  # Its word on the command line
    words: str  # What the file is
    ending: str  # How names of such files end
    export: Callable[[Fitted, Supplied], Exported]


def targets(exports: Mapping[str, Callable[[Fitted, Supplied], Exported]]) -> tuple[Target, ...]:
    """Targets of the file `targets.toml`, by their words on the command line."""
    table = package_tables("eivor.exports", "targets.toml")
    return tuple(Target(name, export=export, **table[name]) for name, export in exports.items())
