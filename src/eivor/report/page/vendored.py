"""Files of others that a page carries with it, unchanged, and what they are."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from importlib import resources


@dataclass(frozen=True, slots=True)
class Vendored:
    """A release of another project.

    Parameters
    ----------
    name, version : str
        What it is.
    script, style : str
        Its sources.
    licence : str
        The text of its licence, which goes where the sources go.
    """

    name: str
    version: str
    script: str
    style: str
    licence: str


def uplot() -> Vendored:
    """uPlot, which draws series over time."""
    folder = resources.files("eivor.report").joinpath("vendored", "uplot")
    release = tomllib.loads(folder.joinpath("release.toml").read_text(encoding="utf-8"))
    script, style, licence = (
        folder.joinpath(name).read_text(encoding="utf-8") for name in (*release["sha256"], release["licence"])
    )
    return Vendored(release["name"], release["version"], script, style, licence)


def own(name: str) -> str:
    """Source of a file of the page itself."""
    return resources.files("eivor.report.page").joinpath(name).read_text(encoding="utf-8")
