"""What was checked of a flight's estimate, a line each: the diagnostics in words."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite

from eivor.flights.diagnostics import FitDiagnostics
from eivor.flights.quantity import Wording
from eivor.flights.result import FlightEstimate
from eivor.inference.diagnostics.diagnostic import told
from eivor.inference.diagnostics.leverage import LARGE_LEVERAGE
from eivor.inference.diagnostics.strength import STRONG_FIRST_STAGE

#: Outcomes of the tests of a pool.
AGREEMENT = ("agree", "may differ", "differ")
#: A check's title and its sentence.
Check = tuple[str, str]


def checks(result: FlightEstimate) -> tuple[Check, ...]:
    """Checks of an estimate, those left out that its method cannot make; none without an estimate."""
    if result.fit is None:
        return ()
    makers = (
        _given_lag,
        _pool,
        _sensors,
        _strength,
        _agreement,
        _constancy,
        _periodicity,
        _memory,
        _leverage,
        _least_squares,
    )
    shared = tuple(check for maker in makers for check in maker(result, result.fit.checks))
    return (*shared, *result.motion.checks(result.diagnostics))


def _given_lag(result: FlightEstimate, _found: FitDiagnostics, /) -> Iterator[Check]:
    given = None if result.fit is None else result.fit.given_lag
    if given is not None:
        yield "lag", f"{given.sentence} {_tail(given.p_value)}"


def _sensors(result: FlightEstimate, _found: FitDiagnostics, /) -> Iterator[Check]:
    sensors = None if result.fit is None else result.fit.sensors
    if sensors is not None:
        yield "sensors", result.motion.sensors_told(sensors)


def _pool(result: FlightEstimate, _found: FitDiagnostics, /) -> Iterator[Check]:
    pool = None if result.fit is None else result.fit.pooled
    if pool is not None:
        own = ", ".join(result.motion.wording[name].symbol for name in pool.own)
        yield (
            "pool",
            f"the flights {told(pool.own_p_value, AGREEMENT)} in {own} {_tail(pool.own_p_value)} and "
            f"{told(pool.shared_p_value, AGREEMENT)} in what they share {_tail(pool.shared_p_value)}",
        )


def _strength(result: FlightEstimate, found: FitDiagnostics) -> Iterator[Check]:
    known = [
        f"{F:.0f} for {result.motion.wording[name].symbol}"
        for name, F in found.first_stage.items()
        if isfinite(F)
    ]
    if known:
        yield "instruments", f"first-stage F {', '.join(known)} ({STRONG_FIRST_STAGE:.0f} is needed)"


def _agreement(_result: FlightEstimate, found: FitDiagnostics) -> Iterator[Check]:
    if found.agreement is not None and found.rank and isfinite(found.agreement.p_value):
        yield "agreement", f"the instruments {found.agreement.outcome} {_tail(found.agreement.p_value)}"


def _constancy(result: FlightEstimate, found: FitDiagnostics) -> Iterator[Check]:
    constant = found.constancy
    if constant is None:
        return
    sentence = f"the parameters {constant.outcome} {_tail(constant.p_value)}"
    if constant.speaks:
        changes = [
            f"{wording.symbol} by {constant.change[result.names.index(name)] * wording.scale:+.2g} "
            f"{wording.shown_unit}".rstrip()
            for name, wording in _closely(result)
        ]
        sentence += f", most likely {constant.break_at:.0%} into the time used: {', '.join(changes)}"
    yield "constancy", sentence


def _periodicity(result: FlightEstimate, found: FitDiagnostics) -> Iterator[Check]:
    swinging = found.periodicity
    if swinging is None:
        return
    tail = _tail(swinging.p_value)
    if not swinging.speaks:
        yield "periods", f"nothing varies periodically {tail}"
        return
    one = swinging.strongest
    period = f"with a period of {one.period:.2g} s {tail}"
    if one in swinging.left_over:
        sentence = (
            f"what the model leaves over of the {one.of} swings by {one.extent} {period}, "
            "as by a wind or a supply that swings"
        )
    else:
        wording = result.motion.wording[one.of]
        extent = f"±{one.amplitude * wording.scale:.2g} {wording.shown_unit}".rstrip()
        sentence = f"{wording.symbol} varies by {extent} {period}"
    yield "periods", sentence


def _memory(_result: FlightEstimate, found: FitDiagnostics) -> Iterator[Check]:
    if found.memory is not None:
        drifting = " (it drifts)" if found.memory.drifts else ""
        yield "residual", f"memory {found.memory.memory:.2f} ± {2.0 * found.memory.order_error:.2f}{drifting}"


def _leverage(result: FlightEstimate, found: FitDiagnostics) -> Iterator[Check]:
    leverage = found.leverage
    if leverage is None:
        return
    for name, wording in _closely(result)[:1]:
        place = result.names.index(name)
        by = float(leverage.largest[place])
        if isfinite(by):
            look = ": look at it" if abs(by) > LARGE_LEVERAGE else ""
            which = f"part {leverage.most[place] + 1} of {leverage.shift.shape[0]}"
            yield "leverage", f"without {which}, {wording.symbol} moves by {by:+.1f} standard errors{look}"


def _least_squares(result: FlightEstimate, found: FitDiagnostics) -> Iterator[Check]:
    against, said = found.endogeneity, []
    if against is None:
        return
    for name, wording in _closely(result):
        quantity = result.quantities[name]
        value = quantity.value - float(against.difference[result.names.index(name)])
        if not isfinite(value):
            continue
        off = (value - quantity.value) / quantity.std_error
        remark = f", {off:+.1f} standard errors off" if against.notable(off) else ""
        shown = f"{wording.symbol} {value * wording.scale:.3g} {wording.shown_unit}".rstrip()
        said.append(f"{shown}{remark}")
    if said:
        yield "least squares", f"would give {'; '.join(said)}"


def _closely(result: FlightEstimate) -> list[tuple[str, Wording]]:
    """Parameters of the headline, which are looked at more closely."""
    return [(name, result.motion.wording[name]) for name in result.motion.headline if name in result.names]


def _tail(p_value: float) -> str:
    """P-value in brackets."""
    return f"(p {'<= 0.001' if p_value <= 0.001 else f'{p_value:.2g}'})"
