"""Help without the types of the programming language: an argument has its name, a switch has none."""

from __future__ import annotations

import inspect
from typing import Any

from typer import Exit
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption

from eivor.cli.empty_options import refuse_empty_options
from eivor.cli.exit_codes import reported
from eivor.cli.outputs import guard_outputs
from eivor.cli.repeated_options import tell_repeated_options
from eivor.errors import EivorError


class ReadableCommand(TyperCommand):
    """A command whose help shows what to type, in paragraphs that are as wide as the terminal."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        if self.help:
            paragraphs = inspect.cleandoc(self.help).split("\n\n")
            self.help = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)

    def get_params(self, ctx: Any) -> list[Any]:
        """Parameters as the help shows them."""
        return _readable(super().get_params(ctx))

    def invoke(self, ctx: Any) -> Any:
        """Run the command, after checks of its options and of the files that it writes."""
        tell_repeated_options(ctx)
        refuse_empty_options(ctx)
        try:
            guard_outputs(ctx)
        except EivorError as error:
            raise Exit(int(reported(error))) from None
        return super().invoke(ctx)


class ReadableGroup(TyperGroup):
    """A group of commands whose help shows what to type."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Parameters as the help shows them."""
        return _readable(super().get_params(ctx))


def _readable(parameters: list[Any]) -> list[Any]:
    for parameter in parameters:
        if isinstance(parameter, TyperArgument):
            # releases that print <list[str]> beside the name ask this; the others never call it
            parameter.display_type_rich = lambda *_, **__: None  # type: ignore[method-assign]
        elif isinstance(parameter, TyperOption) and parameter.is_flag and parameter.metavar is None:
            parameter.metavar = ""
    return parameters
