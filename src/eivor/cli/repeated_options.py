"""Options that repeat: a file holds what commands take where the command line does not say otherwise."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eivor.cli.terminal import complain
from eivor.errors import did_you_mean

if TYPE_CHECKING:
    from eivor.toml_table import TomlTable

#: Read from the working directory where it is.
FILE = "eivor.toml"
#: Under this name the reader of arguments keeps which file it was.
_READ = "eivor.cli.repeated_options"


def read_repeated_options(context: Any, file: str, commands: Iterable[str]) -> None:
    """Give the commands of a group the defaults that a file holds, a table for each command.

    Parameters
    ----------
    context : typer.Context
        Of the group.
    file : str
        The file; empty for `FILE`, where there is one.
    commands : iterable of str
        Names of all commands, those that are not loaded among them, whose tables are left alone.

    Raises
    ------
    InputError
        When the file cannot be read, or names a command or an option that does not exist.
    """
    path = Path(file or FILE)
    if not file and not path.is_file():
        return
    from eivor.toml_table import read_toml

    context.default_map = _of_group(context.command, read_toml(path, "options by command"), commands)
    context.meta[_READ] = path.name


def tell_repeated_options(context: Any) -> None:
    """Say on standard error which options of a command come from the file."""
    used = [
        f"{_name(parameter)} {_words(context.params.get(parameter.name))}".rstrip()
        for parameter in context.command.params
        if getattr(context.get_parameter_source(parameter.name), "name", "") == "DEFAULT_MAP"
    ]
    if used:
        complain(f"options of {context.meta[_READ]}: {', '.join(used)}")


def _of_group(group: Any, table: TomlTable, known: Iterable[str] = ()) -> dict[str, Any]:
    names = sorted({*group.commands, *known})
    found = {}
    for name in table.values:
        if name not in names:
            raise table.wrong(
                "",
                f"tables named as commands, {', '.join(names)},",
                f"[{name}]",
                did_you_mean(name, names, "Remove it."),
            )
        part, command = table.section(name), group.commands.get(name)
        if command is not None:
            found[name] = (_of_group if hasattr(command, "commands") else _of_command)(command, part)
    return found


def _of_command(command: Any, table: TomlTable) -> dict[str, Any]:
    options = {_name(one): one for one in command.params if one.param_type_name == "option"}
    found = {}
    for name in table.values:
        if name not in options:
            remedy = did_you_mean(name, options, "Remove it.")
            raise table.wrong("", f"options of eivor {table.path.replace('.', ' ')}", f"'{name}'", remedy)
        option = options[name]
        found[option.name] = (
            table.flag(name, default=False) if option.is_flag else _value(option, name, table)
        )
    return found


def _value(option: Any, name: str, table: TomlTable) -> Any:
    """What an option takes: a text, or a list of them where it may be given more than once."""
    value = table.values[name]
    items = value if option.multiple and isinstance(value, list) else [value]
    if not all(isinstance(item, str | int | float) and not isinstance(item, bool) for item in items):
        raise table.wrong(name, f"a text or a number{', or a list of them' * option.multiple},", repr(value))
    texts = [str(item) for item in items]
    return texts if option.multiple else texts[0]


def _name(parameter: Any) -> str:
    """Name of an option, without the dashes."""
    return str(parameter.opts[0]).removeprefix("--")


def _words(value: Any) -> str:
    """Value of an option as it is typed; nothing for a switch."""
    if isinstance(value, bool):
        return "" if value else "off"
    if isinstance(value, list | tuple):
        return " ".join(map(_words, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
