"""Options with nothing in them: `--lag ""` is a variable of the shell that was never set, and no answer."""

from __future__ import annotations

from typing import Any

import typer

from eivor.cli.exit_codes import ExitCode
from eivor.cli.terminal import complain
from eivor.errors import UsageError


def refuse_empty_options(context: Any) -> None:
    """Leave with a message where an option that is nothing by default was given as nothing.

    Parameters
    ----------
    context : typer.Context
        Of the command, its options read.

    Raises
    ------
    typer.Exit
        After the message, with the code of wrong usage.
    """
    for option in context.command.params:
        nothing = option.param_type_name == "option" and context.params.get(option.name) == ""
        source = getattr(context.get_parameter_source(option.name), "name", "DEFAULT")
        if nothing and source != "DEFAULT" and not option.default:
            name = option.opts[0]
            remedy = f"Give {name} {option.metavar or 'TEXT'}, or leave it out."
            complain(str(UsageError(f"a value for {name}", "an empty text", remedy)))
            raise typer.Exit(int(ExitCode.USAGE))
