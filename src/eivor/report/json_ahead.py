"""Predictions some tenths of a second ahead, for the JSON documents of results and of validations."""

from __future__ import annotations

from eivor.flights.ahead import Ahead


def ahead_json(ahead: Ahead | None) -> dict[str, object] | None:
    """Object of the predictions; None for none."""
    if ahead is None:
        return None
    return {
        "horizons": list(ahead.horizons_s),
        "starts": int(ahead.start_s.size),
        "errors": [
            {
                "model": one.model,
                "words": one.words,
                "quantity": one.quantity,
                "unit": one.unit,
                "rms": list(one.rms),
            }
            for one in ahead.errors
        ],
        "left_out": list(ahead.left_out),
        "sentence": ahead.sentence if ahead.errors else "",
    }
