"""What a curve of thrust that was found out means for an autopilot: the parameter that it would set.

PX4's THR_MDL_FAC and ArduPilot's MOT_THST_EXPO are both the share s of thrust = (1 - s) u + s u^2, u the
signal to a motor. Commands of thrust come before that curve: an autopilot with the parameter s_0 has put them
through its inverse already, so what is left of the curve is seen, and s is that of both together.
"""

from __future__ import annotations

from collections.abc import Mapping

from eivor.flights.prepared import PreparedFlight
from eivor.flights.quantity import Quantity
from eivor.inference.verdict import Status
from eivor.motions.vertical.curve_family import family_of, share_of_both
from eivor.signals.input_map import input_map
from eivor.signals.recording import Finding

#: Parameters of autopilots that are shares of a thrust curve.
CURVE_PARAMETERS = {"THR_MDL_FAC": "PX4", "MOT_THST_EXPO": "ArduPilot"}


def curve_findings(
    flights: tuple[PreparedFlight, ...], quantities: Mapping[str, Quantity]
) -> tuple[Finding, ...]:
    """The parameter that a curve would set; none where the curve or the hover input is not told."""
    curve, hover = quantities.get("thrust_curve"), quantities["hover_input"].value
    if curve is None or curve.verdict is Status.REFUSED or not 0.0 < hover < 1.0:
        return ()
    family = family_of(input_map(flights[0].input_map))
    logged = flights[0].recording.parameters
    known = {name: logged[name] for name in CURVE_PARAMETERS if name in logged}
    in_force = next(iter(known.values()), 0.0) if family.of_share else 0.0
    value, low, high = (share_of_both(family, one, hover, in_force) for one in (curve.value, *curve.interval))
    names = " or ".join(known) or " or ".join(f"{name} ({pilot})" for name, pilot in CURVE_PARAMETERS.items())
    now = "".join(f"; the log has {name} {one:.2g}" for name, one in known.items())
    sentence = (
        f"The thrust curve that was found is a share of {value:.2f} [{low:.2f}, {high:.2f}] of the square of "
        f"a motor's signal, which {names} would be set to{now}."
    )
    return (Finding("thrust_curve", sentence),)
