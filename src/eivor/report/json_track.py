"""The JSON document of a track, schema ``eivor.track/1``; every key is described in docs/track.md."""

from __future__ import annotations

from eivor.flights.track import Track
from eivor.report.json_document import Json, findings_list, number
from eivor.report.track_document import untold


def track_json(track: Track) -> dict[str, Json]:
    """Document of a track; numbers are in SI units, and null where nothing is told."""
    (flight,) = track.result.prepared
    return {
        "schema": "eivor.track/1",
        "log": flight.recording.name,
        "parameter": track.name,
        "unit": track.unit,
        "memory_s": track.memory_s,
        "at": dict(track.at),
        "known": list(track.known),
        "moments": [
            {
                "time_s": one.time_s,
                "value": number(one.value),
                "low": number(one.value - one.half_width),
                "high": number(one.value + one.half_width),
                "told": one.told,
            }
            for one in track.moments
        ],
        "changes": [{"time_s": one.time_s, "upwards": one.change > 0} for one in track.changes],
        "not_told": list(untold(track)),
        "verdict_of_the_flight": track.result.verdict.status.value,
        "findings": findings_list(track.result.findings),
    }
