"""Documents on a terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import msgspec
from rich.console import Console, ConsoleOptions, Group, RenderableType
from rich.padding import Padding
from rich.table import Column, Table
from rich.text import Text

from eivor.inference.verdict import Status
from eivor.report import document as doc
from eivor.tools import printable

#: By the values of `Status` and of `Look`.
COLOURS = {
    Status.IDENTIFIED.value: "bold green",
    Status.WEAK.value: "bold yellow",
    Status.PROVISIONAL.value: "bright_black",
    Status.REFUSED.value: "bright_black",
    doc.Look.CONTRADICTED.value: "bold red",
}
TONES = {doc.Tone.PLAIN: "", doc.Tone.FAINT: "dim", doc.Tone.WARNING: "yellow"}
#: Labels and words up to this length stay whole.
LONGEST_WHOLE = LONGEST_LABEL = 20
#: Below this width intervals stay in one line, too.
NARROW = 72
#: Blanks between columns.
GAP = 2


def on_terminal(*documents: doc.Document) -> Group:
    """Documents, one below the other."""
    parts = [part for document in documents for part in (Text(), *_document(document))]
    return Group(*parts[1:])


def _document(document: doc.Document) -> Iterator[RenderableType]:
    if document.title:
        head = Text(printable(document.title), style="bold", overflow="fold")
        about = document.about if document.card is None else document.card.title
        style = "not bold" if document.card is None else COLOURS[document.card.look.value]
        yield head.append("\n").append(printable(about), style=style) if about else head
    if document.card is not None:
        yield CardText(document.card)
    for section in document.sections:
        yield from _section(section)


class CardText(msgspec.Struct, frozen=True):
    """A card whose numbers stand below their words where an interval would break beside them."""

    card: doc.Card

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        lines = [line for group in self.card.groups for line in group.lines if line.quantity]
        width, symbols, numbers = (
            max((_width(getattr(line, name)) for line in lines), default=0)
            for name in ("words", "symbol", "number")
        )
        room = options.max_width - width - symbols - 3 * GAP
        below = numbers > room
        yield Text()
        for group in self.card.groups:
            yield Text(printable(group.heading), style=COLOURS[group.look.value])
            heads = Column(width=width, no_wrap=True), Column(width=symbols, no_wrap=True, style="dim")
            grid = Table.grid(*heads, Column(overflow="fold"), padding=(0, GAP, 0, 0))
            for line in group.lines:
                words = Text(printable(line.words))
                if not line.quantity:
                    yield Padding(words.append(f": {printable(line.text)}"), (0, 0, 0, GAP))
                    if line.remark:
                        yield Padding(Text(printable(line.remark), style="dim"), (0, 0, 0, 2 * GAP))
                elif below:
                    yield Padding(words.append(f"  {printable(line.symbol)}"), (0, 0, 0, GAP))
                    yield Padding(_number(line, options.max_width - 2 * GAP), (0, 0, 0, 2 * GAP))
                else:
                    grid.add_row(words, Text(printable(line.symbol)), _number(line, room))
            if grid.row_count:
                yield Padding(grid, (0, 0, 0, GAP))


def _number(line: doc.CardLine, room: int) -> Text:
    """Number, setting and remark; a setting that would break has a line of its own."""
    text, setting = Text(printable(line.number), style="bold"), printable(line.setting)
    if setting:
        gap = " " * GAP if _width(line.number) + GAP + _width(setting) <= room else "\n"
        text.append(gap).append(setting, style="bold" if line.command else "not bold")
    return text.append(f"\n{printable(line.remark)}", style="not bold") if line.remark else text


def _section(section: doc.Section) -> Iterator[RenderableType]:
    """Heading with an empty line above it, and the parts with one between; there are no figures here."""
    parts = [part for part in section.parts if not isinstance(part, doc.Figure)]
    if not parts:
        return
    yield heading(section.heading) if section.heading else Text()
    for number, part in enumerate(parts):
        if number and not isinstance(parts[number - 1], doc.Statement):
            yield Text()
        yield _part(part)


def heading(title: str) -> RenderableType:
    """Title of a section, with an empty line above it."""
    return Padding(Text(printable(title), style="bold"), (1, 0, 0, 0))


def _part(part: doc.Part) -> RenderableType:
    match part:
        case doc.Facts():
            return _facts(part)
        case doc.TableOf():
            return FoldingTable(part)
        case doc.Bullets():
            return _bullets(part)
        case doc.Statement():
            sentence = (printable(part.text), COLOURS[part.look.value])
            return Text.assemble(sentence, printable(part.more))
        case doc.Figure():
            return Text()


def _bullets(part: doc.Bullets) -> Table:
    grid = Table.grid(Column(width=1), Column(overflow="fold"), padding=(0, 1))
    for sentence in part.sentences:
        grid.add_row(Text("-"), Text(printable(sentence)))
    return grid


def _facts(part: doc.Facts) -> Table:
    whole = all(len(label) <= LONGEST_LABEL for label, _ in part.facts)
    labels = Column(style="dim", no_wrap=whole, overflow="fold")
    grid = Table.grid(labels, Column(overflow="fold"), padding=(0, GAP))
    for label, item in part.facts:
        text = _bullets(item) if isinstance(item, doc.Bullets) else Text(printable(item))
        grid.add_row(Text(printable(label)), text)
    return grid


class FoldingTable(msgspec.Struct, frozen=True):
    """A table whose columns become lines below the first one where numbers would break side by side."""

    table: doc.TableOf

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[RenderableType]:
        """Choose by what would become of the words in the width that there is."""
        cells = [line for row in self.table.rows for cell in row for line in (cell.text, cell.below)]
        titles = [column.title for column in self.table.columns]
        words = Counter(printable(" ".join((*titles, *cells))).split())
        whole = options.max_width < NARROW
        short = Counter({word: count for word, count in words.items() if len(word) <= LONGEST_WHOLE})
        table, wider = (_side_by_side(self.table, whole=whole, names=names) for names in (False, True))
        drawn = _displayed(table, console, options)
        if not words <= drawn and words <= _displayed(wider, console, options):
            yield wider
        else:
            yield table if short <= drawn else _folded(self.table, options.max_width)


def _displayed(table: Table, console: Console, options: ConsoleOptions) -> Counter[str]:
    """Words of a table as it comes out; of a word that breaks, its parts."""
    lines = console.render_lines(table, options, pad=False)
    return Counter("\n".join("".join(part.text for part in line) for line in lines).split())


def _width(text: str) -> int:
    return Text(printable(text)).cell_len


def _side_by_side(table: doc.TableOf, *, whole: bool, names: bool) -> Table:
    """A column for each; `whole` keeps intervals in one line, else they break between their numbers."""
    grid = Table(box=None, pad_edge=False, padding=(0, GAP, 0, 0), header_style="dim")
    for number, column in enumerate(table.columns):
        short = not number and all(_width(row[0].text) <= LONGEST_WHOLE for row in table.rows)
        grid.add_column(
            Text(printable(column.title)),  # a string would be markup: "[ms]" is a tag
            justify="right" if column.right else "left",
            no_wrap=(column.whole and whole) or short or (names and not number),
            overflow="fold",
        )
    for row in table.rows:
        cells = (_cell(cell, column, "\n") for cell, column in zip(row, table.columns, strict=True))
        grid.add_row(*cells)
    return grid


def _cell(cell: doc.Cell, column: doc.TableColumn, between: str) -> Text:
    strong, status = "bold" if column.strong else "", cell.status and COLOURS[cell.status.value]
    if not cell.below:
        return Text.assemble((printable(cell.text), status or strong))
    below = printable(cell.below), status or TONES[column.below]
    return Text.assemble((printable(cell.text), strong), between, below)


def _folded(table: doc.TableOf, width: int) -> Group:
    """Row after row: the first cell with those that have no title, and below it a line for each other one."""
    titled = [number for number, column in enumerate(table.columns) if column.title and number]
    room = width - GAP - max((_width(table.columns[number].title) for number in titled), default=0) - GAP
    parts: list[RenderableType] = []
    for row in table.rows:
        titles = Column(style="dim", no_wrap=True)
        grid = Table.grid(titles, Column(overflow="fold"), padding=(0, GAP, 0, 0))
        for number in titled:
            cell, column = row[number], table.columns[number]
            if cell.text:
                neighbours = _width(cell.text) + 1 + _width(cell.below) <= room
                grid.add_row(Text(printable(column.title)), _cell(cell, column, " " if neighbours else "\n"))
        parts += [_row_head(table, row, width), Padding(grid, (0, 0, 0, GAP))]
    return Group(*parts)


def _row_head(table: doc.TableOf, row: tuple[doc.Cell, ...], width: int) -> Text:
    neighbours = _width(row[0].text) + GAP + _width(row[0].below) <= width
    head = _cell(row[0], table.columns[0], " " * GAP if neighbours else "\n")
    for cell, column in zip(row[1:], table.columns[1:], strict=True):
        if not column.title:
            head.append(" " * GAP).append(_cell(cell, column, " "))
    head.overflow = "fold"
    return head
