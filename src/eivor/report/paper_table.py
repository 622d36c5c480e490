"""The paper's study as tables for a terminal, as JSON, and as Markdown for its page."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import Enum
from importlib.metadata import version

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from eivor.report.json_document import Json, number
from eivor.report.terminal import heading
from eivor.studies.generated_page import markdown
from eivor.studies.metrics import Spread
from eivor.studies.paper.errata import errata
from eivor.studies.paper.examples import SEED, Nearness, PaperResult, nearness
from eivor.studies.paper.readings import METHODS, PRINTED_METHODS, SCORES, Example

SCHEMA = "eivor.paper/1"
METHOD_WORDS: Mapping[str, str] = {
    "least_squares": "LS",
    "total_least_squares": "LS, TLS form",
    "extended_iv": "IV",
    "extended_iv_tls": "IV, TLS form",
    "generalized_iv": "GIV",
    "generalized_iv_tls": "GIV, TLS form",
}
SCORE_WORDS = ("δθ1 (K)", "δθ2 (K_u)", "δθ")
#: What a table says where a method gives no estimate.
NO_ESTIMATE = "none"


def spread_text(spread: Spread) -> str:
    """Mean and SD to three significant digits."""
    if not (math.isfinite(spread.mean) and math.isfinite(spread.std)):
        return NO_ESTIMATE
    return f"{_digits(spread.mean)} ± {_digits(spread.std)}"


def _digits(value: float) -> str:
    if value >= 1e5:
        return f"{value:.1e}"
    return f"{value:.{max(0, 2 - math.floor(math.log10(value)))}f}" if value > 0.0 else "0"


def by_reading(results: Iterable[PaperResult]) -> dict[str, list[PaperResult]]:
    """Results of each reading, in the order in which they came."""
    found: dict[str, list[PaperResult]] = {}
    for result in results:
        found.setdefault(result.reading.name, []).append(result)
    return found


def nearest(results: Sequence[PaperResult]) -> str:
    """Name of the allowed reading whose means are nearest to the printed ones; of any if none is allowed."""
    groups = by_reading(results)
    allowed = {name: group for name, group in groups.items() if group[0].reading.allowed} or groups
    return min(allowed, key=lambda name: nearness(allowed[name]).means)


# -- terminal ----------------------------------------------------------------------------------------


def reading_report(results: Sequence[PaperResult]) -> Iterator[RenderableType]:
    """Measured beside printed for one reading."""
    reading = results[0].reading
    yield heading(reading.name)
    yield Text(reading.sentence)
    for result in results:
        table = _plain(f"example {result.example.number}: NRMSE [%]", *SCORE_WORDS)
        for method in METHODS:
            table.add_row(METHOD_WORDS[method], *map(spread_text, result.spreads(method)))
            if method in result.example.printed:
                printed = map(printed_text, result.example.printed[method])
                table.add_row(*(Text(cell, style="dim") for cell in ("    printed", *printed)))
        yield table
        if sentence := weak_sentence(result):
            yield Text(sentence)


def weak_sentence(result: PaperResult) -> str:
    """In how many runs the instruments of which method are weak; empty when none are."""
    runs = len(result.weak)
    counts = {METHOD_WORDS[method]: result.weak_runs(method) for method in PRINTED_METHODS.values()}
    told = [f"of {words} in {count} of {runs} runs" for words, count in counts.items() if count]
    return f"Weak instruments (first-stage F below 10): {', '.join(told)}." if told else ""


def overview_report(results: Sequence[PaperResult]) -> Iterator[RenderableType]:
    """How far every reading is from the printed tables, and which is nearest."""
    yield heading("How far from the printed tables")
    table = _plain("reading", "means off by", "SDs off by", "printed means met")
    for name, group in by_reading(results).items():
        table.add_row(name, *_nearness_cells(nearness(group)))
    yield table
    yield Text(verdict_sentence(results))


def verdict_sentence(results: Sequence[PaperResult]) -> str:
    """Whether any reading gives the printed tables."""
    groups = by_reading(results)
    whole = [name for name, group in groups.items() if _reproduces(nearness(group))]
    if whole:
        return f"Every printed mean is met by: {', '.join(whole)}."
    name = nearest(results)
    found = nearness(groups[name])
    return (
        f"No reading gives the printed tables. Nearest is {name}: its means are off by a factor of "
        f"{_factor(found.means)}, and {found.agreeing} of {found.printed} are met."
    )


def _reproduces(found: Nearness) -> bool:
    return found.agreeing == found.printed


def _nearness_cells(found: Nearness) -> tuple[str, str, str]:
    return _factor(found.means), _factor(found.spreads), f"{found.agreeing} of {found.printed}"


def _factor(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else NO_ESTIMATE


def printed_text(spread: Spread) -> str:
    """Mean and SD as short as they are printed."""
    return f"{spread.mean:.4g} ± {spread.std:.4g}"


def _plain(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for column in columns:
        table.add_column(Text(column), no_wrap=True)
    return table


# -- JSON --------------------------------------------------------------------------------------------


def paper_document(results: Sequence[PaperResult], *, seconds: float) -> dict[str, Json]:
    """Document of the study, ready for `json_text`; numbers are finite or null."""
    return {
        "schema": SCHEMA,
        "version": version("eivor"),
        "runs": len(results[0].estimates),
        "seed": SEED,
        "seconds": number(seconds),
        "verdict": verdict_sentence(results),
        "readings": [_reading(group) for group in by_reading(results).values()],
    }


def _reading(group: Sequence[PaperResult]) -> Json:
    reading, found = group[0].reading, nearness(group)
    choices = {name: getattr(reading, name) for name in reading.__dataclass_fields__ if name != "name"}
    return {
        "name": reading.name,
        "choices": {key: v.value if isinstance(v, Enum) else v for key, v in choices.items()},
        "means_off_by": number(found.means),
        "sds_off_by": number(found.spreads),
        "printed_means_met": found.agreeing,
        "examples": [_example(result) for result in group],
    }


def _example(result: PaperResult) -> Json:
    return {
        "number": result.example.number,
        "methods": {
            method: {
                "failed": result.failed(method),
                "weak": result.weak_runs(method),
                "nrmse": _spreads(result.spreads(method)),
                "printed": _spreads(result.example.printed.get(method, ())),
            }
            for method in METHODS
        },
    }


def _spreads(spreads: Sequence[Spread]) -> Json:
    return {
        name: {"mean": number(spread.mean), "sd": number(spread.std)}
        for name, spread in zip(SCORES, spreads, strict=False)
    }


# -- Markdown ----------------------------------------------------------------------------------------


def page_parts(results: Sequence[PaperResult]) -> dict[str, str]:
    """Generated parts of the page, by the name of their marks."""
    first = by_reading(results)[nearest(results)]
    examples = [result.example for result in first]
    parts = {
        "run": f"Made by `eivor paper` with Eivor {version('eivor')}: {len(by_reading(results))} readings, "
        f"2 examples, {len(first[0].estimates)} runs, 6 methods; seed {SEED}. {verdict_sentence(results)}",
        "readings": _readings_table(results),
    }
    for place, example in enumerate(examples):
        parts[f"example {example.number}"] = "\n\n".join(
            [
                part
                for column, method in PRINTED_METHODS.items()
                for part in (
                    f"**{column}**, NRMSE in percent",
                    _example_table([group[place] for group in by_reading(results).values()], example, method),
                )
            ]
        )
    parts["errata"] = _errata_table()
    parts["figures"] = _figures(first[0].reading.name)
    return parts


def _errata_table() -> str:
    lines = [(item.where, item.printed, item.used, item.check) for item in errata()]
    return markdown(("where", "printed", "used here", "checked"), lines)


def _readings_table(results: Sequence[PaperResult]) -> str:
    lines = []
    for name, group in by_reading(results).items():
        with_tls = nearness(group, total_least_squares=True)
        lines.append(
            [
                f"`{name}`",
                group[0].reading.sentence,
                *_nearness_cells(nearness(group)),
                _factor(with_tls.means),
            ]
        )
    header = ("reading", "what it says", "means off by", "SDs off by", "means met", "TLS forms off by")
    return markdown(header, lines)


def _example_table(results: Sequence[PaperResult], example: Example, method: str) -> str:
    partner = METHODS[METHODS.index(method) + 1]
    header = ("reading", *SCORE_WORDS, *(f"{words}, TLS" for words in SCORE_WORDS))
    lines = [["**printed**", *map(printed_text, example.printed[method]), "", "", ""]]
    for result in results:
        both = (*result.spreads(method), *result.spreads(partner))
        lines.append([f"`{result.reading.name}`", *map(spread_text, both)])
    return markdown(header, lines) + _weak_readings(results, method)


def _weak_readings(results: Sequence[PaperResult], method: str) -> str:
    """Readings under which the instruments of a method are weak, as a line below its table."""
    counts = {result.reading.name: result.weak_runs(method) for result in results}
    told = [f"`{name}` ({count} of {len(results[0].weak)})" for name, count in counts.items() if count]
    return f"\n\nWeak instruments (first-stage F below 10), in runs: {', '.join(told)}." if told else ""


def _figures(name: str) -> str:
    shown = [f"Under the reading `{name}`; red is what the paper prints, mean and one SD on both sides."]
    captions = ["Input and height"]
    captions += [f"NRMSE of {column}, example {place}" for place in (1, 2) for column in PRINTED_METHODS]
    for place, caption in enumerate(captions, start=2):
        shown.append(f"![{caption}](images/paper/figure-{place}.svg)")
        shown.append(f"*Counterpart of figure {place}. {caption}.*")
    return "\n\n".join(shown)
