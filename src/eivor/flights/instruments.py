"""Which instruments flights have for a method, and what a verdict needs to know of them."""

from __future__ import annotations

from dataclasses import dataclass

from eivor.estimation.method import Method, NaturalInstruments
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight
from eivor.models.instruments import InstrumentRule, LaggedInputs, LaggedReferences, NoInstruments


@dataclass(frozen=True, slots=True)
class Instruments:
    """Instruments of a method.

    Parameters
    ----------
    rule : InstrumentRule
        Which columns; `NoInstruments` when the method needs none, or there are none.
    exogenous : bool
        They do not answer the vehicle.
    missing : str
        Why there are none although the method needs them; else empty.
    constant : bool
        There are none, and a reference that is logged is constant.
    """

    rule: InstrumentRule
    exogenous: bool = True
    missing: str = ""
    constant: bool = False

    @property
    def absent(self) -> bool:
        """There are none."""
        return isinstance(self.rule, NoInstruments)


def instruments(flying: tuple[PreparedFlight, ...], options: FlightOptions, method: Method) -> Instruments:
    """Instruments of a method: those that were asked for, else its natural ones."""
    if not method.needs_instruments:
        return Instruments(NoInstruments())
    wanted = options.instruments or (method.natural_instruments.value,)
    if wanted == (NaturalInstruments.LAGS.value,):
        return Instruments(LaggedInputs(), exogenous=False)
    shared = [name for name in flying[0].usable_references if _serves_all(name, flying)]
    if shared:
        usable = [reference for flight in flying for reference in flight.references if reference.usable]
        clean = all(reference.exogenous for reference in usable)
        return Instruments(LaggedReferences(tuple(shared)), exogenous=clean)
    return _none(flying)


def _serves_all(name: str, flying: tuple[PreparedFlight, ...]) -> bool:
    return all(name in flight.usable_references for flight in flying)


def _none(flying: tuple[PreparedFlight, ...]) -> Instruments:
    """Remarks on every reference, and whether one is logged and constant."""
    remarks = {f"{r.name}: {r.remark}" for flight in flying for r in flight.references if not r.usable}
    constant = any(r.constant for flight in flying for r in flight.references)
    missing = "; ".join(sorted(remarks)) or "the log has none"
    return Instruments(NoInstruments(), missing=missing, constant=constant)
