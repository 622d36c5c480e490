"""What may be spent on one log."""

from __future__ import annotations

from dataclasses import dataclass

from eivor.errors import UsageError


@dataclass(frozen=True, slots=True)
class Limits:
    """What may be spent on one log.

    Parameters
    ----------
    time_s : float
        By the clock [s].
    memory_gb : float
        Beyond what the process has when it begins [GB].

    Raises
    ------
    UsageError
        When one is not above zero.
    """

    time_s: float = 600.0
    memory_gb: float = 4.0

    def __post_init__(self) -> None:
        for name, unit in (("time_s", "s"), ("memory_gb", "GB")):
            value = getattr(self, name)
            if not value > 0.0:
                raise UsageError(
                    f"a limit {name} above zero", f"{value:g} {unit}", "Give more, or leave it out."
                )
