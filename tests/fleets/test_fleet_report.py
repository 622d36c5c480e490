"""Reports of fleets whose truth is known: what is pooled, left out, and told to change."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from polars.testing import assert_frame_equal
from rich.console import Console
from statsmodels.stats.meta_analysis import combine_effects

from eivor.errors import InputError
from eivor.fleet.analysis import STEADY, STEPS, across_of, fleet_report, fleet_reports, wanted_columns
from eivor.fleet.logs import given_covariates, with_covariates
from eivor.fleet.report import fleet_document, flight_links, interval_text, linked
from eivor.fleet.table import write_report
from eivor.motions.rigid_body.motion import RigidBody
from eivor.motions.table import motion_by_name
from eivor.report.terminal import on_terminal
from fleets.fleet_rows import row, write_fleet
from validation.simulated_fleets import FleetSpec, fleet_rows

VERTICAL = motion_by_name("vertical")


GAIN, FRICTION, HOVER = "input_gain", "viscous_friction", "hover_input"


def reported(spec, change=None):
    return fleet_report(fleet_rows(spec) if change is None else change, VERTICAL)


def of(report, quantity):
    return report.vehicles.filter(pl.col("quantity") == quantity)


def plain(report):
    """Text of the report, as the terminal has it, in one line."""
    screen = Console(width=100)
    with screen.capture() as captured:
        screen.print(on_terminal(fleet_document(report, "fleet")))
    return " ".join(captured.get().split())


def at(table, column, rows):
    """Table with a column changed in some rows."""
    values = table[column].to_list()
    for name, value in rows.items():
        values[name] = value
    return table.with_columns(pl.Series(column, values, dtype=table.schema[column]))


def test_vehicles_are_pooled_as_statsmodels_does():
    table = fleet_rows(FleetSpec(vehicles=2, flights=9, between_flights=0.1, seed=1))
    report = reported(FleetSpec(), table)
    for vehicle in ("v0000", "v0001"):
        rows = table.filter(pl.col("vehicle") == vehicle)
        value, error = (rows[f"{GAIN}.{part}"].to_numpy() for part in ("value", "std_error"))
        truth = combine_effects(np.log(value), (error / value) ** 2, method_re="iterated", atol=1e-12)
        (identified,) = of(report, GAIN).filter(pl.col("vehicle") == vehicle).rows(named=True)
        assert np.log(identified["mean"]) == pytest.approx(truth.mean_effect_re, abs=1e-6)
        assert identified["between"] == pytest.approx(np.sqrt(truth.tau2), abs=1e-6)
        assert identified["pooled"] == 9
        assert (
            identified["next_low"]
            < identified["low"]
            < identified["mean"]
            < identified["high"]
            < identified["next_high"]
        )
        assert identified["between_low"] <= identified["between"] <= identified["between_high"]


def test_pooling_identified_flights_only_would_bias_upward():
    """The trap: flights whose interval reaches zero are refused; without them the mean is too large."""
    errors = 0.2 * np.ones(400)
    result = 0.25 + errors * np.random.default_rng(0).standard_normal(400)
    rows = [
        row(f"{number:03d}", vehicle="one", type="quad")
        | {f"{FRICTION}.value": value, f"{FRICTION}.std_error": 0.2}
        | {f"{FRICTION}.verdict": "identified" if value > 0.4 else "refused"}
        for number, value in enumerate(result.tolist())
    ]
    report = fleet_report(pl.DataFrame(rows), VERTICAL)
    (identified,) = of(report, FRICTION).rows(named=True)
    assert identified["low"] < 0.25 < identified["high"]
    assert np.mean(result[result > 0.4]) > identified["next_high"]


def test_logs_without_a_vehicle_are_pooled_with_nothing():
    """Ten logs of nobody knows how many vehicles; three of them say their type, one path has two contents."""
    table = fleet_rows(FleetSpec(vehicles=3, flights=10, between_vehicles=0.3, weather=0.05, seed=6))
    without_vehicle = (pl.col("vehicle") == "v0001").alias("nobody")
    table = table.with_columns(
        vehicle=pl.when(without_vehicle).then(None).otherwise("vehicle"),
        type=pl.when(without_vehicle & (pl.col("name") > "v0001-0002.ulg")).then(None).otherwise("type"),
    )
    table = at(table, "name", {11: table["name"][10]})
    report = reported(FleetSpec(), table)
    alone = of(report, GAIN).filter(pl.col("vehicle").str.starts_with("log "))
    assert alone["pooled"].to_list() == [1] * 10
    assert alone["vehicle"].n_unique() == 10
    assert alone["only_low"].null_count() == alone["low"].len() - alone["low"].null_count() == 0
    assert alone["differs"].sum() == 0
    (kind,) = report.types.filter(pl.col("quantity") == GAIN).rows(named=True)
    assert (kind["type"], kind["pooled"]) == ("quad", 2)
    known = reported(FleetSpec(), table.filter(pl.col("vehicle").is_not_null()))
    assert_frame_equal(report.types, known.types)
    assert_frame_equal(report.covariates, known.covariates)
    named = ~pl.col("vehicle").str.starts_with("log ")
    assert_frame_equal(report.vehicles.filter(named), known.vehicles)
    text = plain(report)
    assert "2 vehicles of 1 type; 10 logs without a vehicle, each by itself" in text
    assert "A log without a vehicle id stands alone under its own name" in text


def test_a_slope_that_the_flights_leave_as_expected_is_not_told():
    """Voltage that hardly varies: its slope is what was expected, 1 +- 1 of the gain; density is told."""
    spec = FleetSpec(vehicles=4, flights=12, weather=0.05, battery=1e-4, seed=2)
    report = reported(spec)
    identified = report.covariates.filter(pl.col("quantity") == GAIN)["covariate"].to_list()
    assert identified == ["air_density"]
    text = plain(report)
    assert "goes with battery voltage (type" not in text
    assert (
        "The flights do not identify how input gain, hover input or effective lag goes with battery voltage"
        in text
    )
    assert "battery voltage is not known of enough flights" not in text
    table = fleet_rows(spec).with_columns(load=pl.lit(2.0))  # of which nothing was expected beforehand
    report = fleet_report(table, VERTICAL, ["load"])
    assert "load" not in report.covariates["covariate"].to_list()
    few = reported(FleetSpec(vehicles=5, flights=1, weather=0.05, battery=0.05))
    assert few.covariates.height == 0


def test_a_broken_propeller_is_dated_in_its_vehicle_and_nowhere_else():
    spec = FleetSpec(vehicles=6, flights=40, weather=0.05, battery=0.03, broken=((2, 17, 0.15),), seed=3)
    gains = of(reported(spec), GAIN)
    assert gains.filter(pl.col("course") != STEADY)["vehicle"].to_list() == ["v0002"]
    (identified,) = gains.filter(pl.col("vehicle") == "v0002").rows(named=True)
    assert identified["course"] == STEPS
    assert abs(identified["step_flight"] - 18) <= 3
    assert identified["step_flight_first"] <= 18 <= identified["step_flight_last"]
    assert identified["step_low"] < -0.15 < identified["step_high"] < 0.0
    assert identified["step_start"] == fleet_rows(spec)["start"][int(identified["step_flight"]) - 1]


def test_covariates_of_any_name_are_taken_out():
    """One of which nothing is known beforehand; what is given stands in place of what is logged."""
    spec = FleetSpec(vehicles=6, flights=30, seed=2)
    table = fleet_rows(spec)
    load = np.exp(0.2 * np.random.default_rng(3).standard_normal(table.height))
    table = table.with_columns(pl.col(f"{GAIN}.value") * load**0.5, air_density=pl.lit(1.0))
    given = table.select("name", rotor_age=pl.Series(load), air_density=pl.lit(1.2))
    joined = with_covariates(table, given)
    assert set(joined["air_density"]) == {1.2}
    report = fleet_report(joined, VERTICAL, given.columns[1:])
    (identified,) = report.covariates.filter(quantity=GAIN, covariate="rotor_age").rows(named=True)
    assert identified["slope"] == pytest.approx(0.5, abs=3.0 * identified["std_error"])
    assert identified["std_error"] < 0.05


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "a CSV of covariates"),
        ("flight,mass\na,1\n", "a column sha256 or name"),
        ("name,mass\na,heavy\n", "columns of numbers"),
        ("name,mass\na,1\na,2\n", "every flight once"),
        ("name,mass\nnone,1\n", "covariates of flights of the fleet"),
        ("name,input_gain.value\nv0000-0000.ulg,1\n", "names of covariates"),
    ],
)
def test_covariates_of_no_use_are_refused(tmp_path, text, expected):
    (tmp_path / "masses.csv").write_text(text)
    with pytest.raises(InputError, match=expected):
        with_covariates(
            fleet_rows(FleetSpec(vehicles=1, flights=2)), given_covariates(tmp_path / "masses.csv")
        )


def test_a_flight_and_a_vehicle_that_are_out_of_line_are_named():
    table = fleet_rows(FleetSpec(vehicles=9, flights=12, between_vehicles=0.02, seed=5))
    value = table[f"{GAIN}.value"].to_list()
    table = at(
        table, f"{GAIN}.value", {30: 1.4 * value[30], **{index: 0.7 * value[index] for index in range(12)}}
    )
    report = reported(FleetSpec(), table)
    assert report.deviating.select("name", "quantity").rows() == [(table["name"][30], GAIN)]
    assert report.deviating["expected"][0] == pytest.approx(value[30], rel=0.15)
    assert report.vehicles.filter(pl.col("differs"))["vehicle"].to_list() == ["v0000"]


def test_a_folder_has_a_report_for_each_motion(tmp_path):
    numbers = {f"{FRICTION}.{part}": 0.4 for part in ("value", "std_error", "low", "high")}
    fleet = write_fleet(
        tmp_path / "fleet",
        [
            row("a", **numbers, **{f"{FRICTION}.verdict": "weak"}),
            row("b", **numbers, **{f"{FRICTION}.verdict": "weak"}),
        ],
        [row("a", motion="rates")],
    )
    reports = fleet_reports(fleet)
    assert [report.motion.name for report in reports] == ["rates", "vertical"]
    assert of(reports[1], FRICTION)["pooled"].to_list() == [1, 1]
    assert set(wanted_columns(across_of(VERTICAL))) >= {"air_density", f"{GAIN}.std_error"}


HASH = "0123456789abcdef" * 4


@pytest.mark.parametrize(
    ("page", "address"),
    [
        ("report.html", f"my%20fleet/reports/{HASH}.html"),
        ("my fleet/report.html", f"reports/{HASH}.html"),
        ("pages/report.html", f"../my%20fleet/reports/{HASH}.html"),
    ],
)
def test_addresses_are_relative_to_the_page_and_say_the_hash_alone(tmp_path, page, address):
    folder = tmp_path / "my fleet"
    folder.mkdir()
    assert flight_links(folder, tmp_path / page) == {}
    write_report(folder, HASH, "a page")
    (folder / "reports" / "javascript:alert(1).html").write_text("somebody else's")
    assert flight_links(folder, tmp_path / page) == {HASH: address}
    assert linked("a.ulg", HASH, {HASH: "there"}).link == "there"
    assert linked("a.ulg", "", {HASH: "there"}).below == "no report of its own"


def test_a_table_that_tells_nothing_is_reported():
    report = fleet_report(pl.DataFrame([row("a", verdict="failed", reason="It is empty.")]), VERTICAL)
    assert not report.vehicles.height
    assert not report.quantities


def test_a_mean_that_reaches_far_keeps_its_digits():
    wording, names = RigidBody.quantities["pitch_damping"], ("mean", "low", "high")
    assert interval_text({"mean": 0.2432, "low": 1.7e-5, "high": 3412.0}, wording, names) == (
        "0.24",
        "[1.7e-05, 3400]",
    )
    assert interval_text({"mean": 24.32, "low": 11.0, "high": 350.0}, wording, names)[0] == "20"
    assert interval_text({"mean": None, "low": None, "high": None}, wording, names) == ("–", "–")


def test_flights_without_a_time_are_pooled_and_have_no_course():
    table = fleet_rows(FleetSpec(vehicles=1, flights=12)).with_columns(
        start=pl.lit(None, pl.Datetime("us", "UTC"))
    )
    (identified,) = of(reported(FleetSpec(), table), GAIN).rows(named=True)
    assert (identified["pooled"], identified["course"]) == (12, "")
    half = at(fleet_rows(FleetSpec(vehicles=1, flights=12)), "start", dict.fromkeys(range(7)))
    (identified,) = of(reported(FleetSpec(), half), GAIN).rows(named=True)
    assert (identified["pooled"], identified["course"], identified["change"]) == (12, "", None)
