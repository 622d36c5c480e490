"""The words of the rover: its quantities, the meaning of its verdicts, what to drive and to log."""

from __future__ import annotations

from eivor.flights.quantity import CardSection, Kind, QuantitySpec, QuantityTable, Words
from eivor.inference.verdict import Status
from eivor_rover.rule import DRIVE

EQUATION = (
    "v' = a u - c v - d sign(v) + b",
    "tau w' + w = command(t - t_d), u = mean(w)",
)
MS = {"shown_unit": "ms", "scale": 1e3, "lowest": 0.0}
QUANTITIES = QuantityTable(
    drive_gain=QuantitySpec("drive gain", "a", "m/s^2", shown_unit="m/s²", headline=True, in_rows=True),
    rolling_drag=QuantitySpec("rolling drag", "c", "1/s", shown_unit="1/s", in_rows=True),
    dry_friction=QuantitySpec("dry friction", "d", "m/s^2", shown_unit="m/s²", headline=True, in_rows=True),
    actuator_lag=QuantitySpec("lag of the drive", "τ", "s", **MS),
    delay=QuantitySpec("delay", "t_d", "s", **MS),
    effective_lag=QuantitySpec("effective lag", "τ + t_d", "s", Kind.DERIVED, in_rows=True, **MS),
    breakaway_command=QuantitySpec("breakaway command", "d/a", "", Kind.DERIVED),
    time_constant=QuantitySpec("time constant", "1/c", "s", Kind.DERIVED, shown_unit="s", lowest=0.0),
)
CARD = (
    CardSection("Drive", (DRIVE, "Turn as little as possible, and keep the wheels from slipping.")),
    CardSection(
        "Log",
        (
            "forward_speed, drive_command and reference_forward_speed at 50 Hz or more, with a column time.",
            "forward_acceleration too, where there is an accelerometer.",
        ),
    ),
)
WORDS = Words(
    title="Rover",
    model="rover",
    meanings={
        Status.IDENTIFIED: "the drive tells gain and dry friction within their intervals.",
        Status.WEAK: "the numbers are indications; something keeps the intervals from being trusted.",
        Status.PROVISIONAL: "no instrument: slopes may bias the numbers more than the intervals say.",
        Status.REFUSED: "the drive cannot tell gain and dry friction.",
    },
    fly=DRIVE,
    no_reference="None is logged: no speed that was asked for.",
    no_lag="The motors' state was measured:\nthere is no lag to find.",
    where="under way",
    begins="sets off",
    another_log="Give a log of a drive.",
    advice=lambda _format: CARD,
)
