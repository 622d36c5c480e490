"""A quantity that belongs to the result of another motion than the one that tells it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Companion:
    """A quantity of another motion of the same flight that belongs to a motion's result.

    Parameters
    ----------
    motion, quantity : str
        Names of that motion, and of its quantity.
    called : str
        Name of the quantity in this motion's results, which its wording has.
    input : str
        Channel, or family of channels, that drives it there.
    input_map : str
        Of that channel, unless a user names another.
    needs : mapping of str to tuple of str
        What must be logged, in words, and the channels of which one will do.
    """

    motion: str
    quantity: str
    called: str
    input: str
    input_map: str
    needs: Mapping[str, tuple[str, ...]]
