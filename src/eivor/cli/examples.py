"""`eivor example`: the bundled flight, and public real logs that are downloaded once and kept."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from eivor.cli.exit_codes import ExitCode, guarded
from eivor.cli.readable_help import ReadableCommand, ReadableGroup
from eivor.cli.terminal import show, step, write
from eivor.errors import CorruptLogError, InputError, UsageError

EXAMPLE_FLIGHT = "example_flight.parquet"
REGISTRY = "public_logs.toml"
#: Folder of the downloads, in place of the user's cache folder.
CACHE_VARIABLE = "EIVOR_CACHE"
TIMEOUT_S = 30.0


@dataclass(frozen=True, slots=True)
class PublicLog:
    """A real log that others published.

    Parameters
    ----------
    name : str
        What to call it on the command line.
    url : str
        Where it is, at a fixed version.
    sha256 : str
        Hash of its bytes.
    about : str
        What it is, in one sentence.
    licence : str
        Of the repository it comes from.
    """

    name: str
    url: str
    sha256: str
    about: str
    licence: str

    @property
    def file_name(self) -> str:
        """Name of the file at its origin."""
        return self.url.rpartition("/")[2]


def public_logs() -> Mapping[str, PublicLog]:
    """Every public log by name, in the order of the registry."""
    text = resources.files("eivor.data").joinpath(REGISTRY).read_text(encoding="utf-8")
    registry = tomllib.loads(text)
    return {
        entry["name"]: PublicLog(
            entry["name"],
            f"{source['base']}/{entry['file']}",
            entry["sha256"],
            entry["about"],
            source["licence"],
        )
        for source in registry["source"]
        for entry in source["log"]
    }


def cache_folder() -> Path:
    """Folder of the downloads: EIVOR_CACHE, or the user's cache folder."""
    chosen = os.environ.get(CACHE_VARIABLE)
    if chosen:
        return Path(chosen).expanduser()
    import pooch

    return Path(pooch.os_cache("eivor"))


def fetched(log: PublicLog, *, folder: Path) -> Path:
    """Local file of a public log; downloaded when it is not there yet, its hash checked in any case.

    Raises
    ------
    InputError
        When it cannot be downloaded or stored.
    CorruptLogError
        When what came is not the file that the registry knows.
    """
    import pooch

    pooch.get_logger().setLevel("ERROR")
    downloader = pooch.HTTPDownloader(timeout=TIMEOUT_S) if log.url.startswith("http") else _copied
    kept = folder / log.file_name
    try:
        found = pooch.retrieve(
            log.url, f"sha256:{log.sha256}", fname=log.file_name, path=folder, downloader=downloader
        )
    except ValueError as error:
        raise CorruptLogError(
            f"'{log.file_name}' with the SHA-256 {log.sha256[:12]}...",
            f"another content from {log.url}",
            "Try again later; nothing was kept. If it persists, the file has changed at its origin.",
        ) from error
    except OSError as error:  # every error of requests is one
        wrong = f"; and '{kept}' is there with another content" if kept.is_file() else ""
        raise InputError(
            f"a download of {log.url} to {folder}",
            f"{_cause(error)}{wrong}",
            f"Check the network, or put the file there yourself; {CACHE_VARIABLE} names another folder.",
        ) from error
    return Path(found)


def _copied(url: str, output_file: str, _pooch: object) -> None:
    """Download of a file: URL."""
    import shutil
    from urllib.parse import unquote, urlparse

    shutil.copyfile(unquote(urlparse(url).path), output_file)


def _cause(error: OSError) -> str:
    """What went wrong, in a few words: libraries' messages about networks go on for lines."""
    import requests

    if isinstance(error, requests.Timeout):
        return f"no answer within {TIMEOUT_S:.0f} s"
    if isinstance(error, requests.HTTPError) and error.response is not None:
        return f"the answer {error.response.status_code} {error.response.reason}"
    if isinstance(error, requests.RequestException):
        return "no connection"
    return error.strerror or str(error)


app = typer.Typer(
    name="example",
    help="The example flight that comes with Eivor, and public real logs to try it on.",
    no_args_is_help=True,
    add_completion=False,
    cls=ReadableGroup,
)


@app.command("list", cls=ReadableCommand, epilog="[bold]Exit codes[/bold]: 0 done; 2 wrong usage.")
@guarded
def list_logs() -> ExitCode:
    """List the public real logs that can be fetched."""
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="dim")
    for title in ("name", "what it is", "licence"):
        table.add_column(title, overflow="fold")
    for log in public_logs().values():
        table.add_row(Text(log.name, style="bold"), Text(log.about), Text(log.licence))
    show(table)
    return ExitCode.IDENTIFIED


@app.command(
    cls=ReadableCommand,
    epilog="[bold]Exit codes[/bold]: 0 the file is there; 1 no network, wrong content, or a folder that "
    "cannot be written; 2 wrong usage.",
)
@guarded
def fetch(
    name: Annotated[str, typer.Argument(metavar="NAME", help="A name out of eivor example list.")],
) -> ExitCode:
    """Download a public real log, check it, and print its path. A second time it works without a network.

    The folder is the user's cache; EIVOR_CACHE names another one.
    """
    logs = public_logs()
    by_file = {log.file_name: log for log in logs.values()}
    log = logs.get(name) or by_file.get(name)
    if log is None:
        raise UsageError(f"a log out of {', '.join(logs)}", f"'{name}'", "See: eivor example list")
    with step(f"Downloading {log.file_name}"):
        path = fetched(log, folder=cache_folder())
    write(f"{path}\n")
    return ExitCode.IDENTIFIED


@app.command(cls=ReadableCommand, epilog="[bold]Exit codes[/bold]: 0 done; 2 wrong usage.")
@guarded
def path() -> ExitCode:
    """Print where the bundled example flight is."""
    with resources.as_file(resources.files("eivor.data").joinpath(EXAMPLE_FLIGHT)) as file:
        write(f"{file}\n")
    return ExitCode.IDENTIFIED
