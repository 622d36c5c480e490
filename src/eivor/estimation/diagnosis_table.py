"""Diagnostics as a table and as text."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from eivor.estimation.diagnose import Diagnostics

#: Diagnostic, what it is of, value, and what to hold it against.
Row = tuple[str, str, float, float | None]


def table_of(found: Diagnostics) -> list[Row]:
    """Every number that is at hand."""
    return [*_instrument_rows(found), *_residual_rows(found), *_excitation_rows(found), *_record_rows(found)]


def _instrument_rows(found: Diagnostics) -> list[Row]:
    rows: list[Row] = []
    strength = found.first_stage
    if strength is not None:
        for j, name in enumerate(found.names):
            rows.append(("effective_F", name, float(strength.effective[j]), float(strength.critical[j])))
            rows.append(("shea_r_squared", name, float(strength.shea_r_squared[j]), None))
        rows.append(("smallest_eigenvalue", "", strength.smallest_eigenvalue, strength.smallest_critical))
        rows.append(("cragg_donald", "", strength.cragg_donald, None))
    if found.over_identification is not None:
        rows.append(
            ("over_identification_J", "", found.over_identification.J, found.over_identification.p_value)
        )
    if found.endogeneity is not None:
        rows.append(("endogeneity", "", found.endogeneity.statistic, found.endogeneity.p_value))
        differences = zip(found.names, found.endogeneity.difference, strict=True)
        rows.extend(("less_least_squares", name, float(value), None) for name, value in differences)
    return rows


def _residual_rows(found: Diagnostics) -> list[Row]:
    white = found.whiteness
    rows: list[Row] = [
        ("ljung_box", f"{white.autocorrelation.size} lags", white.ljung_box, white.p_value),
        ("durbin_watson", "", white.durbin_watson, 2.0),
    ]
    lags = enumerate(white.autocorrelation, start=1)
    rows.extend(("autocorrelation", f"lag {lag}", float(r), white.band) for lag, r in lags)
    if found.memory is not None:
        rows.append(("memory", "", found.memory.memory, found.memory.order_error))
    return rows


def _excitation_rows(found: Diagnostics) -> list[Row]:
    rows: list[Row] = [("information_condition", "", found.information.condition, None)]
    bands = found.bands
    linear = found.names[: bands.share_above.size]
    rows.extend(
        ("power_above", name, float(share), None)
        for name, share in zip(linear, bands.share_above, strict=True)
        if not math.isnan(share)
    )
    for b, (low, high) in enumerate(zip(bands.low_hz, bands.high_hz, strict=True)):
        for j, name in enumerate(linear):
            power, residual = float(bands.input_power[b, j]), float(bands.residual_power[b])
            rows.append(("band_power", f"{name}, {low:.3g} to {high:.3g} Hz", power, residual))
    return rows


def _record_rows(found: Diagnostics) -> list[Row]:
    rows: list[Row] = []
    constant, leverage = found.constancy, found.leverage
    if constant is not None:
        rows.append(("constancy", "", constant.statistic, constant.p_value))
        for name, p, change in zip(found.names, constant.p_values, constant.change, strict=True):
            rows.append(("change", name, float(change), float(p)))
        rows.append(("break_at", "share of the record", constant.break_at, None))
    if leverage is not None:
        for j, name in enumerate(found.names):
            first, end = found.segments[leverage.most[j]]
            where = f"{name}, {found.at_row(first)} to {found.at_row(end)}"
            rows.append(("leverage", where, float(leverage.largest[j]), 1.0))
    return rows


def summary_of(found: Diagnostics) -> str:
    """Text of a few lines, and the reasons."""
    lines = [f"diagnostics of {found.estimate.method}"]
    strength, J, against = found.first_stage, found.over_identification, found.endogeneity
    if strength is not None:
        for j, name in enumerate(found.names):
            needed = f"{name} (needed: {strength.critical[j]:.3g})"
            lines.append(f"effective F          {strength.effective[j]:>10.4g}  {needed}")
        needed = f"needed: {strength.smallest_critical:.3g}"
        lines.append(f"smallest eigenvalue  {strength.smallest_eigenvalue:>10.4g}  {needed}")
    if J is not None:
        lines.append(f"over-identification  {J.J:>10.4g}  J on {J.degrees} degrees, p-value {J.p_value:.3g}")
    if against is not None:
        lines.append(f"endogeneity          {against.statistic:>10.4g}  p-value {against.p_value:.3g}")
    white, memory = found.whiteness, found.memory
    lines.append(f"whiteness            {white.ljung_box:>10.4g}  Ljung-Box, p-value {white.p_value:.3g}")
    lines.append(f"Durbin-Watson        {white.durbin_watson:>10.4g}")
    if memory is not None:
        lines.append(f"memory               {memory.memory:>10.3f}  standard error {memory.order_error:.3f}")
    lines.append(
        f"information          {found.information.condition:>10.4g}  condition; worst: "
        f"{found.information.worst(found.names)}"
    )
    lines.extend(
        f"power above residual {share:>10.0%}  {name}"
        for name, share in zip(found.names, found.bands.share_above, strict=False)
        if not math.isnan(share)
    )
    constant, leverage = found.constancy, found.leverage
    if constant is not None:
        likely = f"p-value {constant.p_value:.3g}, a change most likely at {found.when(constant.break_at)}"
        lines.append(f"constancy            {constant.statistic:>10.4g}  {likely}")
    if leverage is not None:
        for j, name in enumerate(found.names):
            first, end = found.segments[leverage.most[j]]
            of = f"standard errors of {name}, {found.at_row(first)} to {found.at_row(end)}"
            lines.append(f"largest leverage     {leverage.largest[j]:>+10.2f}  {of}")
    lines.extend(f"- {reason.sentence} {reason.remedy}" for reason in found.reasons)
    return "\n".join(lines)
