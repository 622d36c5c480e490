"""A Recording from arrays or a data frame, without a file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from eivor import checks
from eivor.errors import EmptyLogError, ShapeError, UsageError, did_you_mean
from eivor.logs.columns import Columns
from eivor.logs.mapping import canonical_map, mapped_recording
from eivor.signals.canonical import canonical_channel, canonical_channels
from eivor.signals.recording import Frame, Recording


@runtime_checkable
class DataFrameLike(Protocol):
    """A data frame of polars or pandas: columns by name."""

    @property
    def columns(self) -> Iterable[str]:
        """Names of the columns."""

    def __getitem__(self, name: str, /) -> Any: ...


def recording_from_columns(
    columns: Mapping[str, Any] | DataFrameLike,
    *,
    name: str = "arrays",
    frame: Frame = Frame.Z_UP,
    input_map: str = "",
    parameters: Mapping[str, float] | None = None,
    estimated: tuple[str, ...] = (),
) -> Recording:
    """Return a recording of columns with canonical names.

    Parameters
    ----------
    columns : mapping of str to array_like, or data frame
        `time` [s] and canonical channels in SI units, all of one length. NaN means "no value", and so does
        what a mask hides.
    name : str
        What to call the recording in reports.
    frame : Frame
        Which way z points.
    input_map : str
        Name of the vehicle's input map, if it is known.
    parameters : mapping of str to float, optional
        Vehicle parameters, by names of your own.
    estimated : tuple of str
        Channels that an estimator makes of other measurements, such as the velocity of a Kalman filter.

    Raises
    ------
    UsageError
        When `time` is missing, a name is not canonical, `estimated` names a channel that is not among the
        columns, or an argument is of another type.
    ShapeError
        When a column is not one-dimensional, or has another length than `time`.
    DataError
        When a column does not hold real numbers.
    EmptyLogError
        When there are no values.
    """
    checks.kind(
        "columns",
        columns,
        (Mapping, DataFrameLike),
        "a mapping or a data frame",
        "Give a dictionary of arrays.",
    )
    checks.text("name", name)
    checks.text("input_map", input_map)
    checks.kind("frame", frame, Frame, "a Frame", "Give Frame.Z_UP or Frame.NED.")
    if parameters is not None:
        checks.mapping("parameters", parameters, checks.NUMBERS, "numbers")
    names = list(columns) if isinstance(columns, Mapping) else list(columns.columns)
    unknown = [key for key in names if key != "time" and canonical_channel(str(key)) is None]
    if unknown:
        every = f"The names are {', '.join(canonical_channels())}."
        hint = did_you_mean(str(unknown[0]), canonical_channels(), every, most=3)
        raise UsageError("canonical names of channels", f"{unknown[0]!r}", hint)
    chosen = canonical_map(names, name)
    if chosen is None:
        raise UsageError(
            "a column 'time' and at least one channel",
            f"{', '.join(names) or 'no columns'}",
            "Add what is missing.",
        )
    arrays = {key: np.array(checks.real_array(f"column '{key}'", columns[key]), ndmin=1) for key in names}
    rows = arrays["time"].size
    if rows == 0:
        raise EmptyLogError("columns with values", "columns of length 0", "Give at least one row.")
    for key, array in arrays.items():
        if array.shape != (rows,):
            raise ShapeError(
                f"columns of the length of 'time', {rows}",
                f"'{key}' of shape {array.shape}",
                "Give one value a row.",
            )
    _check_among(estimated, names)
    rules = tuple(replace(rule, estimated=rule.name in estimated) for rule in chosen.rules)
    recording = mapped_recording(chosen, rules, Columns(arrays), name=name, log_format="frame")
    return replace(recording, frame=frame, input_map=input_map, parameters=dict(parameters or {}))


def _check_among(estimated: tuple[str, ...], names: list[str]) -> None:
    """Refuse what does not name columns."""
    remedy = 'Give ("velocity_z",), for example.'
    checks.items("estimated", estimated, str, "names of channels", remedy)
    unknown = [one for one in estimated if one not in names]
    if unknown:
        raise UsageError(f"channels out of {', '.join(names)}", f"{unknown[0]!r}", "Correct the name.")
