"""Matplotlib Axes that a caller gives to draw into: which panel each is for, and what is none."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from eivor.checks import described
from eivor.errors import UsageError, did_you_mean

#: Axes for some panels by their names, or for all in order; for a figure of one panel also its Axes.
GivenAxes = Axes | Mapping[str, Axes] | Iterable[Axes]
REMEDY = "Pass what plt.subplots() or Figure.add_subplot() returns."


def given_axes(axes: GivenAxes, panels: Sequence[str], title: str = "") -> dict[str, Axes]:
    """Axes of each panel that is to be drawn.

    Parameters
    ----------
    axes : Axes, mapping of str to Axes, or iterable of Axes
        A mapping draws the panels that it names. A sequence or an array, as plt.subplots() returns it, is for
        all panels, row by row. Axes alone are for the only panel.
    panels : sequence of str
        Names of the panels, in order.
    title : str
        Words above the first panel that is drawn; it keeps its own when there are none.

    Raises
    ------
    UsageError
        When there are none, too few or too many, or they are not of one figure; when a name is unknown.
    """
    chosen = _named(axes, panels) if isinstance(axes, Mapping) else _ordered(axes, panels)
    if not chosen:
        raise UsageError("Axes to draw into", "none", f"Name some of: {', '.join(panels)}.")
    for name, one in chosen.items():
        _check(f"{name!r}", one)
    figure_of(*chosen.values())
    _title(next(iter(chosen.values())), title)
    return chosen


def given_panel(ax: Axes, title: str = "") -> Axes:
    """Return the Axes of the only panel, with a title above it where there is one.

    Raises
    ------
    UsageError
        When these are no Axes of a figure.
    """
    _check("ax", ax)
    _title(ax, title)
    return ax


def figure_of(*axes: Axes) -> Figure:
    """Return the figure that Axes are of; that of a subfigure is the one around it.

    Raises
    ------
    UsageError
        When there are several.
    """
    figures = {id(one.figure.figure): one.figure.figure for one in axes}
    if len(figures) != 1:
        raise UsageError(
            "Axes of one figure", f"of {len(figures)}", "Draw into each figure by itself, naming its panels."
        )
    return next(iter(figures.values()))


def _named(axes: Mapping[Any, Any], panels: Sequence[str]) -> dict[str, Axes]:
    for name in axes:
        if name not in panels:
            known = f"Name some of: {', '.join(panels)}."
            remedy = did_you_mean(name, panels, known) if isinstance(name, str) else known
            raise UsageError("the name of a panel", described(name), remedy)
    return dict(axes)


def _ordered(axes: object, panels: Sequence[str]) -> dict[str, Axes]:
    if isinstance(axes, str) or not isinstance(axes, Axes | Iterable):
        raise UsageError(
            "Axes by the name of their panel, or as many as there are panels", described(axes), REMEDY
        )
    flat = [axes] if isinstance(axes, Axes) else list(np.asarray([*axes], dtype=object).ravel())
    if len(flat) != len(panels):
        raise UsageError(
            f"{len(panels)} Axes, for {', '.join(panels)}",
            f"{len(flat)}",
            "Give as many, or a dictionary from the names of some panels to their Axes.",
        )
    return dict(zip(panels, flat, strict=True))


def _title(axes: Axes, title: str) -> None:
    if title:
        axes.set_title(title, fontsize=11, parse_math=False)


def _check(name: str, axes: object) -> None:
    if not isinstance(axes, Axes):
        many = isinstance(axes, np.ndarray | Sequence) and not isinstance(axes, str)
        raise UsageError(
            f"Matplotlib Axes for {name}", described(axes), "Pass one of them." if many else REMEDY
        )
    if axes.figure is None:
        raise UsageError(f"Axes of a figure for {name}", "Axes that were removed from theirs", REMEDY)
