"""JSON documents of inspections, ``eivor.inspect/1`` and ``eivor.inspect_pool/1``, see docs/json.md."""

from __future__ import annotations

from importlib.metadata import version

from eivor.report.inspection import ChannelSummary, Flown, Inspection, PooledInspection
from eivor.report.json_document import Json, findings_list, number

SCHEMA = "eivor.inspect/1"
POOLED_SCHEMA = "eivor.inspect_pool/1"


def inspection_json(found: Inspection) -> dict[str, Json]:
    """Document of an inspection, ready for `json_text`."""
    log = found.recording
    return {
        "schema": SCHEMA,
        "log": {
            "name": log.name,
            "format": log.format,
            "frame": log.frame.name.lower(),
            "sha256": log.sha256 or None,
            "span": [number(end) for end in log.span_s],
        },
        "channels": [_channel(summary) for summary in found.channels],
        "missing": list(found.missing),
        "looked_for": {name: list(sources) for name, sources in log.looked_for.items()},
        "advice": list(found.advice),
        "airborne": None if found.flown is None else _airborne(found.flown),
        "tried": None if found.tried is None else [number(end) for end in found.tried],
        "references": [] if found.flown is None else _references(found.flown),
        "parameters": {name: number(value) for name, value in found.parameters.items()},
        "findings": findings_list(found.findings),
        "verdict": found.verdict,
        "reasons": list(found.reasons),
        "provenance": {"version": version("eivor")},
    }


def pooled_json(found: PooledInspection) -> dict[str, Json]:
    """Document of several logs, ready for `json_text`."""
    return {
        "schema": POOLED_SCHEMA,
        "logs": [inspection_json(log) for log in found.logs],
        "findings": [] if found.result is None else findings_list(found.result.findings),
        "verdict": found.verdict,
        "reasons": list(found.reasons),
        "provenance": {"version": version("eivor")},
    }


def _channel(summary: ChannelSummary) -> Json:
    quality = summary.quality
    return {
        "name": summary.name,
        "source": summary.source,
        "unit": summary.unit,
        "samples": summary.samples,
        "rate_hz": number(summary.rate_hz),
        "held": summary.held,
        "estimated": summary.estimated,
        "delay_s": number(summary.delay_s),
        "range": [number(summary.lowest), number(summary.highest)],
        "gaps": [[number(start), number(end)] for start, end in summary.gaps],
        "duplicated_stamps": quality.duplicated_stamps,
        "backward_stamps": quality.backward_stamps,
        "evened_stamps": quality.evened_stamps,
        "missing_values": quality.missing_values,
        "overflowed": quality.overflowed,
        "saturated": quality.saturated,
    }


def _airborne(flown: Flown) -> Json:
    return {
        "rule": flown.rule,
        "segments": [[number(start), number(end)] for start, end in flown.active],
        "used": [[number(start), number(end)] for start, end in flown.used],
    }


def _references(flown: Flown) -> list[Json]:
    return [
        {"name": reference.name, "usable": reference.usable, "remark": reference.remark}
        for reference in flown.references
    ]
