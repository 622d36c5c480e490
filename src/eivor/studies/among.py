"""Names that studies know."""

from __future__ import annotations

from collections.abc import Mapping

from eivor.errors import UsageError, did_you_mean


def check_among(what: str, name: str, known: Mapping[str, object] | tuple[str, ...]) -> None:
    """Refuse a name that is not known, and propose the nearest that is.

    Raises
    ------
    UsageError
        With all known names.
    """
    if name not in known:
        remedy = did_you_mean(name, known, "Name one of them.")
        raise UsageError(f"{what} out of {', '.join(known)}", f"'{name}'", remedy)
