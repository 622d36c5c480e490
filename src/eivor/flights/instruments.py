"""Which instruments flights have for a method, and what a verdict needs to know of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from eivor.estimation.method import Method, NaturalInstruments
from eivor.flights.options import FlightOptions
from eivor.flights.prepared import PreparedFlight
from eivor.models.instruments import InstrumentRule, LaggedInputs, LaggedReferences, NoInstruments

#: A reference has one frequency when this share of its power lies within so many bins of its peak.
LINE_SHARE = 0.995
LINE_BINS = 3


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
    names : tuple of str
        The references among them.
    past_inputs : bool
        They are past inputs, which a controller computes.
    """

    rule: InstrumentRule
    exogenous: bool = True
    missing: str = ""
    constant: bool = False
    names: tuple[str, ...] = ()
    past_inputs: bool = False

    @property
    def absent(self) -> bool:
        """There are none."""
        return isinstance(self.rule, NoInstruments)


def instruments(flying: tuple[PreparedFlight, ...], options: FlightOptions, method: Method) -> Instruments:
    """Instruments of a method: those that were asked for, else its natural ones."""
    if not method.of_flights.needs_instruments:
        return Instruments(NoInstruments())
    wanted = options.instruments or (method.natural_instruments.value,)
    if wanted == (NaturalInstruments.LAGS.value,):
        first = method.first_past_input
        return Instruments(LaggedInputs(first), exogenous=False, past_inputs=True)
    shared = [name for name in flying[0].usable_references if _serves_all(name, flying)]
    if shared:
        usable = [reference for flight in flying for reference in flight.references if reference.usable]
        clean = all(reference.exogenous for reference in usable)
        return Instruments(LaggedReferences(tuple(shared)), exogenous=clean, names=tuple(shared))
    return _none(flying)


def _serves_all(name: str, flying: tuple[PreparedFlight, ...]) -> bool:
    return all(name in flight.usable_references for flight in flying)


def _none(flying: tuple[PreparedFlight, ...]) -> Instruments:
    """Remarks on every reference, and whether one is logged and constant."""
    remarks = {f"{r.name}: {r.remark}" for flight in flying for r in flight.references if not r.usable}
    constant = any(r.constant for flight in flying for r in flight.references)
    missing = "; ".join(sorted(remarks)) or "the log has none"
    return Instruments(NoInstruments(), missing=missing, constant=constant)


def single_frequency_hz(flying: tuple[PreparedFlight, ...], names: tuple[str, ...]) -> float:
    """The frequency of references that have only one, all the same; zero for others [Hz].

    A sine, its derivatives and its lags span two dimensions, however many instruments are made of them.
    """
    peaks: list[float] = []
    for flight in flying:
        longest = max(flight.runs, key=lambda run: run.stop - run.start)
        width = 1.0 / ((longest.stop - longest.start) * flight.signals.step_s)
        for name in names:
            values = flight.signals.channel(name)[longest]
            power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(values.size))) ** 2
            peak = int(np.argmax(power))
            near = power[max(peak - LINE_BINS, 0) : peak + LINE_BINS + 1].sum()
            if (
                not near >= LINE_SHARE * power.sum()
                or abs(peak * width - (peaks or [peak * width])[0]) > width
            ):
                return 0.0
            peaks.append(peak * width)
    return float(np.mean(peaks)) if peaks else 0.0
