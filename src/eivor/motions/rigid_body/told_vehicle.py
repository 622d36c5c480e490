"""The vehicle that a result was made for, out of the result's JSON."""

from __future__ import annotations

from collections.abc import Mapping

from eivor.errors import EivorError, InputError
from eivor.motions.rigid_body.known_number import KnownNumber
from eivor.motions.rigid_body.known_vehicle import RANGES, KnownVehicle


def vehicle_told(told: object) -> KnownVehicle:
    """Vehicle of what `dataclasses.asdict` made of it, and JSON of that.

    Raises
    ------
    InputError
        When it is no vehicle.
    """
    try:
        if not isinstance(told, Mapping):
            raise TypeError("there is none")
        fields = dict(told)
        for name in RANGES:
            if fields[name] is not None:
                fields[name] = KnownNumber(**fields[name])
        fields["positions"] = tuple(tuple(float(one) for one in place) for place in fields["positions"])
        fields["spins"] = tuple(int(spin) for spin in fields["spins"])
        return KnownVehicle(**fields)
    except (KeyError, TypeError, ValueError, EivorError) as error:
        raise InputError(
            "a result that says what flies, under prediction.vehicle",
            f"one that does not ({error})",
            "Identify the flight again, with --vehicle.",
        ) from error
