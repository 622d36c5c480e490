"""The group of all commands: an interrupt while its arguments are read is told like any other."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer

from eivor.cli.exit_codes import ExitCode
from eivor.cli.readable_help import ReadableGroup
from eivor.cli.terminal import complain


class InterruptibleGroup(ReadableGroup):
    """Commands whose interrupt is one line, also where the arguments' reader leaves without words."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """Read the arguments of the group."""
        with _interrupts_told():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: Any) -> Any:
        """Read the arguments of a command, and run it."""
        with _interrupts_told():
            return super().invoke(ctx)


@contextmanager
def _interrupts_told() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        complain("interrupted")
        raise typer.Exit(code=int(ExitCode.INTERRUPTED)) from None
