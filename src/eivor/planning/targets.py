"""What a flight may be planned for."""

from __future__ import annotations

from dataclasses import dataclass

from eivor.errors import UsageError, did_you_mean


@dataclass(frozen=True, slots=True)
class Target:
    """A quantity of the vertical motion.

    Parameters
    ----------
    quantity : str
        Its name in results.
    words, unit : str
        In words, and the unit that half-widths are told in.
    scale : float
        From SI to that unit.
    relative : bool
        Told as a share of the value.
    """

    quantity: str
    words: str
    unit: str
    scale: float = 1.0
    relative: bool = False


#: By their words on the command line, in the order of the ranking's joint vector.
TARGETS = {
    "friction": Target("viscous_friction", "viscous friction", "1/s"),
    "gain": Target("input_gain", "input gain", "%", 100.0, relative=True),
    "lag": Target("effective_lag", "effective lag", "ms", 1000.0),
}


def check_target(word: str) -> None:
    """Refuse a word that is none of `TARGETS`.

    Raises
    ------
    UsageError
        With those that there are.
    """
    if word not in TARGETS:
        known = ", ".join(TARGETS)
        raise UsageError(
            f"one of {known}", f"{word!r}", did_you_mean(word, TARGETS, f"Plan for one of {known}.")
        )
