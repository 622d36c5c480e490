"""The document of a validation: what was found, the errors of each prediction, and of the fit in each run."""

from __future__ import annotations

from eivor.inference.verdict import Status
from eivor.report.ahead_parts import ahead_parts
from eivor.report.document import Cell, Document, Fact, Facts, Figure, Section, TableColumn, TableOf
from eivor.report.validation import PredictionError, Validation
from eivor.report.wording import NO_NUMBER


def validation_document(found: Validation) -> Document:
    """Document of a validation."""
    table = (_models(found),) if found.ahead is None else ahead_parts(found.ahead, sentence=False)
    sections = [Section("", (_facts(found), *table))]
    if found.ahead is None and len(found.spans_s) > 1:
        sections.append(Section("Of the fit, run by run", (_by_run(found),)))
    sections.append(Section("Figure", (Figure("validation"),)))
    return Document(found.flight.recording.name, None, found.sentence, tuple(sections))


def _facts(found: Validation) -> Facts:
    logs = ", ".join(str(log["name"]) for log in found.fit.document["provenance"]["logs"])
    verdict = found.fit.verdict
    trust = "" if verdict is Status.IDENTIFIED else f" ({verdict.value})"
    runs = len(found.spans_s)
    return Facts(
        (
            Fact("fit", f"of {logs}{trust}"),
            Fact("model", found.motion.equation[0].replace(" - ", " − ")),
            Fact("used", f"{found.flight.used_s:.1f} s in {runs} run{'' if runs == 1 else 's'}"),
            *_how(found),
        )
    )


def _how(found: Validation) -> tuple[Fact, ...]:
    if found.ahead is not None:
        return (
            Fact("fitted", "the trim of each run, for every model with parameters alike"),
            Fact("starts", f"{found.ahead.start_s.size}, each from what was measured there"),
        )
    low, high = found.flight.band_hz
    return (
        Fact("fitted", "the trim and the start of each run, for every model alike"),
        Fact("band", f"{low:g} to {high:g} Hz, one step ahead; all frequencies in open loop"),
    )


def _models(found: Validation) -> TableOf:
    columns = (
        TableColumn("predicted"),
        TableColumn("by"),
        TableColumn("RMS error", right=True, strong=True),
        TableColumn("unit"),
        TableColumn("explained", right=True),
    )
    rows = []
    for models in found.by_quantity:
        for number, one in enumerate(models):
            what = Cell("") if number else Cell(f"{one.quantity}, {one.horizon.words}")
            rms, explained = _cells(one.error)
            rows.append((what, Cell(one.words), rms, Cell(one.unit), explained))
    return TableOf(columns, tuple(rows))


def _by_run(found: Validation) -> TableOf:
    own = [quantity[0] for quantity in found.by_quantity]
    columns = [TableColumn("run [s]", whole=True)]
    for one in own:
        title = f"{one.quantity}: RMS error [{one.unit}]"
        columns += [TableColumn(title, right=True, strong=True), TableColumn("explained", right=True)]
    rows = []
    for number, (start, end) in enumerate(found.spans_s):
        cells = [Cell(f"{start:.1f} to {end:.1f}")]
        for one in own:
            cells += _cells(one.by_run[number])
        rows.append(tuple(cells))
    return TableOf(tuple(columns), tuple(rows))


def _cells(error: PredictionError) -> tuple[Cell, Cell]:
    explained = f"{error.explained:.1%}" if error.explained == error.explained else NO_NUMBER
    return Cell(f"{error.rms:.3g}"), Cell(explained)
