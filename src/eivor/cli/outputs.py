"""Options, output files, exit codes and terminal of the commands."""

from __future__ import annotations

import inspect
import os
import stat
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from enum import IntEnum
from fnmatch import fnmatchcase
from functools import wraps
from glob import escape
from itertools import combinations
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Annotated, Any, ParamSpec, TypeVar, get_type_hints
from unicodedata import normalize

import msgspec
import typer
from typer.core import TyperCommand, TyperOption

from eivor import tools
from eivor.atomic_file import check_writable, write_atomically
from eivor.errors import EivorError, InputError, UsageError
from eivor.strict_toml import package_tables

if TYPE_CHECKING:
    from rich.console import Console, RenderableType


P = ParamSpec("P")
R = TypeVar("R")

# -- Arguments --

#: Heading of the options that few people need, and how many a command has before some go there.
MORE, FIRST_OPTIONS = "More options", 10
#: The word for standard output.
STANDARD_OUTPUT = "-"
#: Files that are written into the folders of a study and of a fleet, and with the figures of the paper. A
#: part of a fleet's table holds what was in it before, and a run may find it as a log.
STUDY_FILES = ("study.json", "trials.parquet", "shards/*", "nrmse.*", "coverage.*")
FLEET_FILES = ("fleet.json", "schema.json", ".lock", ".run", "reports/*.html")
FLEET_PARTS = ("flights/*.parquet", "pending/*.parquet")
RESIDUAL_FILES = ("residuals.csv", "plotjuggler.xml", "residuals.mcap", "foxglove.json")
PAPER_FILES = ("figure-*.svg", "figure-*.png")


def log_paths(text: str) -> Iterable[Path]:
    """Files of a log as typed: of a folder, or of LOG@START:END."""
    # By name, since help loads no reader of logs.
    path: Path = resolve_name("eivor.cli.parsing:log_argument")(text)[0]
    if not resolve_name("eivor.logs.read:is_local")(path):
        return []
    return resolve_name("eivor.logs.common:folder_files")(path) if path.is_dir() else [path]


def fleet_paths(text: str) -> Iterable[Path]:
    """Files of a fleet's folder."""
    return _files_in(Path(text), (*FLEET_FILES, *FLEET_PARTS))


class Reads(msgspec.Struct, frozen=True):
    """Declares that a parameter names what the command reads: the guard of outputs protects it."""

    paths: Callable[[str], Iterable[Path]] = lambda text: [Path(text)]


class Writes(msgspec.Struct, frozen=True):
    """Declares that a parameter names a file that the command writes, or a folder of such files."""

    patterns: tuple[str, ...] = ()  # Patterns of the files that are written into the folder
    default: Callable[[Mapping[str, Any]], str] = lambda _values: ""


#: Words of the options; see the file.
OPTIONS = package_tables("eivor.cli", "options.toml")


def option(name: str, known: Sequence[str] = ()) -> Any:
    """What is typed for a parameter of a command; a shell completes its values, also after a comma."""
    command, _, parameter = name.rpartition(" ")
    row = OPTIONS[command][parameter]
    values, values_of = known or row.get("values", ()), row.get("values_of", "")
    settings: dict[str, Any] = {
        "metavar": row.get("metavar", ""),
        "help": row["about"].replace("{values}", ", ".join(values)),
        "rich_help_panel": MORE if row.get("rare") else None,
    }

    def complete(incomplete: str) -> list[str]:
        loaded = resolve_name(values_of) if values_of else ()
        words = [*values, *(loaded() if callable(loaded) else loaded)]
        prefix, comma, last = incomplete.rpartition(",")
        return [f"{prefix}{comma}{value}" for value in words if value.startswith(last)]

    if "flag" in row:
        return typer.Option(row["flag"], **settings)
    # `ReadableCommand` shows the defaults that say something
    settings |= {"show_default": row.get("show_default", False)}
    settings |= {"autocompletion": complete if values or values_of else None}
    if "argument" in row:
        return typer.Argument(**settings)
    return typer.Option(*row.get("names", ()), **settings)


def group(name: str, about: str) -> typer.Typer:
    """A group of commands."""
    return typer.Typer(name=name, help=about, no_args_is_help=True, add_completion=False)


WorkersOption = Annotated[int | None, option("all workers")]
ModelOption = Annotated[str, option("all model")]
VehicleOption = Annotated[str, option("all vehicle"), Reads()]
MachineOption = Annotated[str, option("all machine"), Reads()]
FitArgument = Annotated[Path, option("all fit"), Reads()]
FitModelOption = Annotated[str, option("all fit_model")]
JsonOption = Annotated[str, option("all json"), Writes()]


def with_options(
    *sources: type[msgspec.Struct], only: tuple[str, ...] = ()
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Give a command, which takes them by ``**given``, the fields of structures as options: some, or all."""
    options = {}
    for source in sources:
        hints = get_type_hints(source, include_extras=True)
        for item in msgspec.structs.fields(source):
            default = [] if item.default is msgspec.NODEFAULT else item.default
            options[item.name] = inspect.Parameter(
                item.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hints[item.name]
            )
    added = {name: options[name] for name in only or options}

    def decorate(command: Callable[P, R]) -> Callable[P, R]:
        parameters = inspect.signature(command, eval_str=True).parameters.values()
        rest = [item for item in parameters if item.kind is not item.VAR_KEYWORD and item.name not in added]
        ordered = sorted([*added.values(), *rest], key=lambda parameter: parameter.kind)
        vars(command)["__signature__"] = inspect.Signature(ordered)
        return command

    return decorate


# -- Terminal --


def console(*, error: bool = False) -> Console:
    """Console on standard output or error, made when it is needed: width and colours follow the stream."""
    from rich.console import Console

    return Console(stderr=error, highlight=False, markup=False, emoji=False, soft_wrap=False)


def show(report: RenderableType) -> None:
    """Print a report on standard output; in a pipe without the blanks that pad lines to the width."""
    screen = console()
    with printing(), screen.capture() as captured:  # even a captured print touches the stream
        screen.print(report, crop=False)  # a table of more numbers than fit is wider: none is cut
    lines = captured.get().splitlines()
    write(captured.get() if screen.is_terminal else "".join(f"{line.rstrip()}\n" for line in lines))


def show_table(titles: Iterable[str], rows: Iterable[tuple[str, ...]]) -> None:
    """Print a table; the first column is a name."""
    from rich.table import Column, Table
    from rich.text import Text

    columns = (Column(title, overflow="fold") for title in titles)
    table = Table(*columns, box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for name, *cells in rows:
        table.add_row(Text(name, style="bold"), *map(Text, cells))
    show(table)


def write(text: str) -> None:
    """Write text on standard output."""
    with printing():
        sys.stdout.write(text)
        sys.stdout.flush()


@contextmanager
def printing() -> Iterator[None]:
    """Turn the system's error for standard output into one of Eivor's, and print nothing there any more."""
    expected = "a standard output that can be written to"
    if sys.stdout is None:
        raise InputError(expected, "one that is closed", "Print to a file, a pipe or a terminal.")
    try:
        yield
    except BrokenPipeError:
        _drop_standard_output()
        raise
    except OSError as error:
        _drop_standard_output()
        received = f"one for which the system says: {error.strerror or error}"
        raise InputError(expected, received, "Make room there, or print elsewhere.") from error


def _drop_standard_output() -> None:
    """Point standard output to nowhere, so that the interpreter does not fail again on its way out."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def complain(message: str, *details: str) -> None:
    """Print a message on standard error, with further lines below it; strings are made printable."""
    lines = [f"eivor: {tools.printable(message)}", *(f"  {tools.printable(line)}" for line in details)]
    with suppress(OSError, ValueError):
        sys.stderr.write("\n".join(lines) + "\n")
        sys.stderr.flush()


@contextmanager
def step(label: str) -> Iterator[tools.Progress]:
    """Show `what` with a spinner on standard error while it lasts, and its stages, on terminals only."""
    if not sys.stderr.isatty():
        yield tools.no_stage_callback
        return
    from rich.text import Text

    stages = len(tools.Stage)
    with console(error=True).status(Text(f"{tools.printable(label)} ...")) as status:
        yield lambda stage: status.update(
            Text(
                f"{tools.printable(label)}: {stage.value} ({[*tools.Stage].index(stage) + 1} of {stages}) ..."
            )
        )


@contextmanager
def progress_bar(label: str) -> Iterator[tools.ItemsDone]:
    """Bar on standard error while it lasts, on terminals only."""
    screen = console(error=True)
    if not screen.is_terminal:
        yield tools.no_items_callback
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=screen, transient=True) as bar:
        task = bar.add_task(tools.printable(label), total=None)

        def update(completed: int, total: int) -> None:
            if bar.tasks[0].total is None:  # what was there before says nothing about the rate
                bar.reset(task, total=total, completed=completed)
            bar.update(task, completed=completed)

        yield update


# -- Exit codes --

#: What help says of each command; see the file.
COMMANDS = package_tables("eivor.cli", "commands.toml")
#: Set to 1 to see the traceback of an unexpected error.
DEBUG_VARIABLE = "EIVOR_DEBUG"


class ExitCode(IntEnum):
    """Exit code of a command."""

    IDENTIFIED = 0
    FAILED = 1
    USAGE = 2
    NOT_IDENTIFIED = 3
    INTERRUPTED = 130


def guarded(command: Callable[P, ExitCode | None]) -> Callable[P, None]:
    """Make a command that returns an exit code, or none, into one that leaves, whatever happens inside."""

    @wraps(command)
    def run_and_exit(*args: P.args, **kwargs: P.kwargs) -> None:
        code = ExitCode.FAILED
        try:
            code = command(*args, **kwargs) or ExitCode.IDENTIFIED
        except EivorError as error:
            code = reported(error)
        except KeyboardInterrupt:
            complain("interrupted")
            code = ExitCode.INTERRUPTED
        except BrokenPipeError:
            pass
        except MemoryError:
            remedy = "Cut it to the manoeuvre of interest, or use --window."
            complain("Not enough memory for this log.", remedy)
        except Exception as error:  # the last line of defence: a user never sees a traceback
            if os.environ.get(DEBUG_VARIABLE) == "1":
                raise
            complain(
                f"unexpected {type(error).__name__}: {error}",
                "This is a mistake in Eivor. Please report it with the command and, if you can, the log;",
                f"{DEBUG_VARIABLE}=1 shows where it happened.",
            )
        raise typer.Exit(code=int(code))

    paragraphs = (inspect.getdoc(command) or "").split("\n\n")  # as wide as the terminal in help
    run_and_exit.__doc__ = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
    return run_and_exit


def reported(error: EivorError) -> ExitCode:
    """Print the message of an error, and return its exit code."""
    complain(str(error), *getattr(error, "__notes__", ()))
    return ExitCode.USAGE if isinstance(error, UsageError) else ExitCode.FAILED


def refuse_empty_options(context: Any) -> None:
    """Refuse an option that is nothing by default and was given as nothing."""
    for option in context.command.params:
        nothing = option.param_type_name == "option" and context.params.get(option.name) == ""
        source = context.get_parameter_source(option.name)
        if nothing and source is not None and source.name != "DEFAULT" and not option.default:
            name = option.opts[0]
            remedy = f"Give {name} {option.metavar or 'TEXT'}, or leave it out."
            raise UsageError(f"a value for {name}", "an empty text", remedy)


# -- Outputs --

FIGURE_FORMATS = (".png", ".svg", ".pdf")
#: Folder of the package, whose examples, maps and scenarios are no place to write to.
PACKAGE = Path(__file__).resolve().parents[1]


def output_file(text: str, *, option: str) -> Path:
    """Path of a file that can be written."""
    path = Path(text)
    if os.path.isdir(path) or not path.name:  # noqa: PTH112 - that of Path fails for a name that is too long
        raise UsageError(f"a file for {option}", f"the folder '{text}'", "Add a file name.")
    if PACKAGE in Path(os.path.realpath(path)).parents:
        expected = f"a file for {option} of your own"
        raise UsageError(expected, f"'{text}', which belongs to Eivor", "Choose another.")
    try:
        if path.parent.is_dir():
            check_writable(path)
            return path
        problem = f"whose folder '{path.parent}' does not exist"
    except PermissionError:
        problem = "which may not be written"
    except OSError as error:
        problem = f"for which the system says: {error.strerror or error}"
    raise InputError(f"a file for {option} that can be written", f"'{text}', {problem}", "Choose another.")


def figure_file(text: str) -> Path | None:
    """Path of a figure; None of none."""
    path = Path(text)
    if text and path.suffix.lower() not in FIGURE_FORMATS:
        expected = f"a figure that ends in {', '.join(FIGURE_FORMATS)}"
        raise UsageError(expected, f"'{text}'", "The ending chooses the format.")
    return path if text else None


#: Existing files that the command may replace, with the option that names each.
_replaced_files: ContextVar[Mapping[tuple[int, int], tuple[str, Path]]] = ContextVar("replaced")


def guard_outputs(context: Any) -> None:
    """Refuse a command whose outputs would replace a file that it reads, or each other."""
    files = list(declared(context))
    outputs = [(name, Path(text), item.patterns) for name, item, text in files if isinstance(item, Writes)]
    replaced: dict[tuple[int, int] | None, tuple[str, Path]] = {}
    for name, path, patterns in outputs:
        if str(path) != STANDARD_OUTPUT:
            replaced |= {_file_id(item): (name, item) for item in (path, *_files_in(path, patterns))}
    _replaced_files.set({key: item for key, item in replaced.items() if key is not None})
    for name, item, text in files:
        if isinstance(item, Reads):
            keep_inputs(name, item.paths(text))
    for (first, path, patterns), (second, other, others) in combinations(outputs, 2):
        if _overwrites(path, patterns, other) or _overwrites(other, others, path):
            expected = f"different files for {first} and {second}"
            raise UsageError(expected, f"'{other}', which both would write", f"Give {second} another name.")
    for name, path, patterns in outputs:
        if not patterns and str(path) != STANDARD_OUTPUT:
            output_file(str(path), option=name)


def _overwrites(path: Path, patterns: tuple[str, ...], other: Path) -> bool:
    """Whether the output `path`, or a file of the patterns in it, is also the output `other`."""
    spelling, of_other = _spelling(path), _spelling(other)
    if any(fnmatchcase(of_other, f"{escape(spelling)}/{item}") for item in patterns):
        return True
    keys = _file_id(path), _file_id(other)
    is_device = other.exists() and not other.is_file() and not other.is_dir()
    return keys[0] == keys[1] if None not in keys else spelling == of_other and not is_device


def keep_inputs(name: str, paths: Iterable[Path]) -> None:
    """Refuse the outputs of the command that would replace one of these files."""
    replaced = _replaced_files.get({})
    for source in paths if replaced else ():
        key = _file_id(source)
        if key is not None and key in replaced:
            option, path = replaced[key]
            expected = f"a name for {option} that replaces no file that the command reads"
            remedy = f"Give {option} another name."
            raise UsageError(expected, f"'{path}', which would replace '{source}' of {name}", remedy)


def _files_in(folder: Path, patterns: Iterable[str]) -> Iterator[Path]:
    return (path for pattern in patterns for path in folder.glob(pattern))


def declared(context: Any) -> Iterator[tuple[str, Reads | Writes, str]]:
    """Name, declaration and text of every parameter of a command that names files."""
    positions = declarations(context.command)
    for parameter in context.command.params:
        position = positions.get(parameter.name)
        if position is not None:
            value = context.params.get(parameter.name)
            if not value and isinstance(position, Writes):
                value = position.default(context.params)
            is_argument = parameter.param_type_name == "argument"
            name = str(parameter.metavar).strip("[]") if is_argument else max(parameter.opts, key=len)
            texts = value if isinstance(value, list | tuple) else (value,)
            yield from ((name, position, str(text)) for text in texts if text)


def declarations(command: Any) -> dict[str, Reads | Writes]:
    """What the parameters of a command declare, by their names in the function."""
    parameters = inspect.signature(command.callback, eval_str=True).parameters if command.callback else {}
    return {
        name: item
        for name, parameter in parameters.items()
        for item in getattr(parameter.annotation, "__metadata__", ())
        if isinstance(item, Reads | Writes)
    }


def _file_id(path: Path) -> tuple[int, int] | None:
    """Device and number of an existing regular file; None of anything else."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return (status.st_dev, status.st_ino) if stat.S_ISREG(status.st_mode) else None


def _spelling(path: Path) -> str:
    """One spelling of a path: links followed, and names that some file systems take for one are one."""
    return normalize("NFC", os.path.realpath(path)).replace(os.sep, "/").casefold()


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn the system's error for an output file into one of Eivor's."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(
            "a file that can be written", f"'{path}', for which the system says: {reason}", "Choose another."
        ) from error


def write_out(text: str | bytes, position: str) -> None:
    """Write text to a file, whole, or to standard output where the place is "-"."""
    if position == STANDARD_OUTPUT and isinstance(text, str):
        write(text)
        return
    with writing(Path(position)):
        write_atomically(Path(position), text)


def deliver(*parts: Callable[[], None]) -> None:
    """Do every part, whatever happens to those before it."""
    errors: list[EivorError | OSError] = []
    for part in parts:
        try:
            part()
        except (EivorError, OSError) as error:
            errors.append(error)
    for later in errors[1:]:
        complain(str(later))
    if errors:
        raise errors[0]


def deliver_result(
    report: Callable[[], RenderableType], document: Callable[[], str], json: str, *files: Callable[[], None]
) -> None:
    """Print a report, write a document to the file or stream of --json, then write files; see `deliver`."""
    screen = (lambda: show(report()),) if json != STANDARD_OUTPUT else ()
    to_file = (lambda: write_out(document(), json),) if json else ()
    deliver(*screen, *to_file, *files)


class ReadableCommand(TyperCommand):
    """A command that checks its options, and the files that it writes, before it runs."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        options = [item for item in self.params if isinstance(item, TyperOption) and not item.hidden]
        for item in options:
            is_value = not item.is_flag and not item.multiple
            item.show_default = item.show_default or (is_value and item.default not in (None, ""))
            if len(options) <= FIRST_OPTIONS:
                item.rich_help_panel = None

    def invoke(self, ctx: Any) -> Any:
        try:
            refuse_empty_options(ctx)
            guard_outputs(ctx)
        except EivorError as error:
            raise typer.Exit(int(reported(error))) from None
        return super().invoke(ctx)


def exit_codes(command: str) -> str:
    """Epilog of the help of a command: its exit codes."""
    return f"[bold]Exit codes[/bold]: {COMMANDS[command]['exit_codes']}"


def command(
    app: typer.Typer, name: str | None = None, about: str | None = None
) -> Callable[[Callable[P, ExitCode | None]], Callable[P, None]]:
    """Make a function a command of a group, with its exit codes below its help."""

    def added(function: Callable[P, ExitCode | None]) -> Callable[P, None]:
        epilog = exit_codes(f"{app.info.name} {name or function.__name__}")
        return app.command(name, cls=ReadableCommand, epilog=epilog, help=about)(guarded(function))

    return added
