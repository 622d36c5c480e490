"""Errors over the Cramer-Rao bound, over a suite of scenarios, and the command that finds them out.

    python -m validation.efficiency.study [SUITE.toml] [--runs N] [--out FILE.parquet] [--page FILE.md]

runs the suite beside this file, or another one, and prints its tables. `--from FILE.parquet` makes them anew
from a finished run, or from several of other scenarios or lengths. Trials are kept in `--folder` as they are
done, and a run that was interrupted goes on there.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl

from eivor.errors import ParameterError
from eivor.inference.distributions import normal_quantile
from eivor.lab.cramer_rao import cramer_rao
from eivor.lab.disturbances import GivenDisturbance
from eivor.lab.experiments import VerticalExperiment
from eivor.lab.records import ALWAYS_MEASURED, Scenario, simulate
from eivor.lab.study import StudyResult, scores
from eivor.simulation.excitation import GivenSeries
from validation.pages import markdown
from validation.studies import Requirement, Row, requirement_table, suite_command
from validation.suite_files import Suite, SuiteStudy, read_suite


def open_loop(scenario: Scenario, seed: int) -> Scenario:
    """Scenario with one realised input, disturbance and strengths of noises, and no feedback."""
    quiet = replace(scenario, noise={}, noise_to_signal={}, disturbance=None, disturbance_to_signal=None)
    record, undisturbed = (simulate(item, np.random.default_rng(seed)) for item in (scenario, quiet))
    return replace(
        scenario,
        control=None,
        excitation=GivenSeries(tuple(undisturbed.truth.channel("input").tolist())),
        noise={name: record.signals.noise[name] for name in ALWAYS_MEASURED},
        noise_to_signal={},
        disturbance=GivenDisturbance(tuple(record.truth.channel("disturbance").tolist())),
        disturbance_to_signal=None,
    )


#: Columns of the table.
COLUMNS = (
    *("scenario", "samples", "method", "parameter", "bound", "rmse", "bias", "hits", "count"),
    *("failed", "weak", "runs", "seed", "level", "versions"),
)

#: Records under control that a bound is averaged over.
CONTROLLED_RUNS = 10


def efficiency_rows(suite_study: SuiteStudy, result: StudyResult) -> Iterator[Row]:
    bounds = bounds_of(suite_study)
    for score in scores(result):
        for parameter in score.parameters:
            covered = parameter.coverage
            yield suite_study.row(
                score.label,
                parameter.name,
                bound=bounds.get(parameter.name, float("nan")),
                rmse=parameter.rmse / abs(parameter.truth),
                bias=parameter.bias / parameter.estimate.std,
                hits=0 if covered is None else covered.hits,
                count=0 if covered is None else covered.count,
                failed=score.failed,
                weak=score.weak,
            )


def bounds_of(suite_study: SuiteStudy) -> dict[str, float]:
    """Bound of each parameter over its size; under control that of the open loop with the same input."""
    experiment = suite_study.study.experiment
    if not isinstance(experiment, VerticalExperiment):
        return {}
    scenario = experiment.scenario
    try:
        if scenario.control is None:
            return cramer_rao(scenario).relative
        relatives = [
            cramer_rao(open_loop(scenario, seed), runs=1).relative for seed in range(CONTROLLED_RUNS)
        ]
    except ParameterError:
        return {}
    return {name: float(np.sqrt(np.mean([each[name] ** 2 for each in relatives]))) for name in relatives[0]}


#: Scenarios whose noises the model holds.
HELD = ("v", "p", "rich", "rich-high", "rich-dynamic", "white")
#: Largest errors over the bound, by samples.
OVER_BOUND = {4000: 1.2, 500: 1.3}
#: Largest errors of the friction over generalized IV's, at 4,000 samples.
OVER_PLAIN = {"v": 0.75, "p": 0.75, "rich": 0.75, "rich-high": 0.75, "white": 0.3}
#: Largest errors of the combination over generalized IV's, anywhere.
COMBINED_OVER_PLAIN = 1.12
#: Largest bias over the scatter, and bounds of the coverage of each interval and of their mean.
BIAS, COVERAGE, MEAN_COVERAGE = 0.25, (0.91, 0.99), (0.94, 0.98)
#: Largest error of maximum likelihood with known spectra over the bound, and of spectral_giv over it at the
#: longest records.
KNOWN, LIKELIHOOD, OVER_LIKELIHOOD = "likelihood, spectra known", 1.2, 1.06
#: Under control: largest bias over the scatter, and error over the bound of the open loop.
CONTROLLED, CONTROLLED_BIAS, CONTROLLED_BOUND = "closed-loop", 0.35, 1.3
#: Largest bias of an input that is linear between samples, over the parameter's size.
LINEAR, LINEAR_BIAS = "rich-linear", 0.003
#: Confidence with which figures of few runs are held against a bound.
CHANCE_LEVEL = 0.99


def requirements(rows: pl.DataFrame) -> tuple[Requirement, ...]:
    """Judge a run of the suite, as far as its number of runs can tell."""
    return tuple(_fit(rows))


def _fit(rows: pl.DataFrame) -> Iterator[Requirement]:
    spectral = rows.filter(pl.col("method") == "spectral_giv")
    for samples, most in OVER_BOUND.items():
        here = spectral.filter(pl.col("samples") == samples, pl.col("scenario").is_in(HELD))
        if here.height:
            yield _largest(f"spectral_giv, N = {samples}: RMSE over the bound", here, "bound", most)
            yield _bias(f"spectral_giv, N = {samples}", here, BIAS)
        known = rows.filter(
            pl.col("method") == KNOWN, pl.col("samples") == samples, pl.col("scenario").is_in(HELD)
        )
        if known.height:
            yield _largest(f"{KNOWN}, N = {samples}: RMSE over the bound", known, "bound", LIKELIHOOD)
    yield from _over_likelihood(rows)
    yield from _over_plain(rows)
    yield from _controlled(spectral)
    yield from _linear(spectral)
    yield from _coverage(spectral)


def _over_likelihood(rows: pl.DataFrame) -> Iterator[Requirement]:
    keys = ["scenario", "samples", "parameter"]
    known = rows.filter(pl.col("method") == KNOWN).select(*keys, likelihood="rmse")
    here = rows.filter(
        pl.col("method") == "spectral_giv",
        pl.col("samples") == max(OVER_BOUND),
        pl.col("scenario").is_in(HELD),
    ).join(known, on=keys, maintain_order="left")
    if here.height:
        name = f"spectral_giv, N = {max(OVER_BOUND)}: RMSE over that of {KNOWN}"
        yield _largest(name, here, "likelihood", OVER_LIKELIHOOD)


def _controlled(spectral: pl.DataFrame) -> Iterator[Requirement]:
    here = spectral.filter(pl.col("scenario") == CONTROLLED, pl.col("samples") == max(OVER_BOUND))
    if here.height:
        name = f"spectral_giv under control, N = {max(OVER_BOUND)}"
        yield _bias(name, here, CONTROLLED_BIAS)
        yield _largest(f"{name}: RMSE over the open loop's bound", here, "bound", CONTROLLED_BOUND)


def _linear(spectral: pl.DataFrame) -> Iterator[Requirement]:
    """Bias over the size of the parameter; what is tabulated is over the scatter."""
    here = spectral.filter(pl.col("scenario") == LINEAR, pl.col("samples") == max(OVER_BOUND))
    if here.height:
        scatter = pl.col("rmse") / (1.0 + pl.col("bias") ** 2).sqrt()
        biases = here.select(
            bias=(pl.col("bias") * scatter).abs(), chance=scatter / pl.col("count").sqrt()
        ).rows()
        allowed = [LINEAR_BIAS + normal_quantile(CHANCE_LEVEL) * chance for _, chance in biases]
        yield Requirement(
            f"spectral_giv, {LINEAR}, N = {max(OVER_BOUND)}: bias over the parameter",
            f"at most {LINEAR_BIAS:.1%}",
            f"at most {max(bias for bias, _ in biases):.2%}",
            all(bias <= most for (bias, _), most in zip(biases, allowed, strict=True)),
        )


def _over_plain(rows: pl.DataFrame) -> Iterator[Requirement]:
    keys = ["scenario", "samples", "parameter"]
    plain = rows.filter(pl.col("method") == "generalized_iv").select(*keys, plain="rmse")
    joined = rows.join(plain, on=keys, maintain_order="left")
    for scenario, most in OVER_PLAIN.items():
        here = joined.filter(
            pl.col("method") == "spectral_giv",
            pl.col("samples") == max(OVER_BOUND),
            pl.col("scenario") == scenario,
            pl.col("parameter") == "viscous_friction",
        )
        if here.height:
            yield _largest(f"spectral_giv, {scenario}: RMSE of K over generalized IV's", here, "plain", most)
    combined = joined.filter(pl.col("method") == "spectral_giv_combined")
    if combined.height:
        name = "spectral_giv_combined: RMSE over generalized IV's, everywhere"
        yield _largest(name, combined, "plain", COMBINED_OVER_PLAIN)


def _largest(what: str, here: pl.DataFrame, over: str, most: float) -> Requirement:
    """The largest of some ratios of errors; a ratio of `runs` errors is told to 1/sqrt(2 runs)."""
    worst, name = -math.inf, ""
    missed: list[str] = []
    for row in here.iter_rows(named=True):
        ratio = row["rmse"] / row[over]
        chance = normal_quantile(CHANCE_LEVEL) / math.sqrt(2.0 * row["runs"])
        label = f"{row['scenario']}, N = {row['samples']}, {row['parameter']} {ratio:.2f}"
        if ratio > most * (1.0 + chance):
            missed.append(label)
        if ratio > worst:
            worst, name = ratio, label
    return Requirement.by_all(what, f"at most {most:g}", f"at most {worst:.2f} ({name})", missed)


def _bias(what: str, here: pl.DataFrame, most_bias: float) -> Requirement:
    allowed = {
        f"{row['scenario']}, {row['parameter']} {row['bias']:+.2f}": most_bias
        + normal_quantile(CHANCE_LEVEL) / math.sqrt(row["count"])
        for row in here.iter_rows(named=True)
    }
    values = [abs(value) for value in here["bias"]]
    missed = [name for (name, most), value in zip(allowed.items(), values, strict=True) if value > most]
    what = f"{what}: bias over the scatter"
    return Requirement.by_all(what, f"at most {most_bias:g}", f"at most {max(values):.2f}", missed)


def _coverage(spectral: pl.DataFrame) -> Iterator[Requirement]:
    low, high = COVERAGE
    for samples in OVER_BOUND:
        here = spectral.filter(pl.col("samples") == samples)
        if not here.height:
            continue
        shares = (here["hits"] / here["count"]).to_list()
        missed = [
            f"{row['scenario']}, {row['parameter']} {share:.3f}"
            for row, share in zip(here.iter_rows(named=True), shares, strict=True)
            if not low - _chance(low, row["count"]) <= share <= high + _chance(high, row["count"])
        ]
        what, measured = f"spectral_giv, N = {samples}", f"{min(shares):.3f} to {max(shares):.3f}"
        yield Requirement.by_all(
            f"{what}: coverage of each interval", f"{low:g} to {high:g}", measured, missed
        )
        mean, total = float(sum(here["hits"]) / sum(here["count"])), int(sum(here["count"]))
        least, most = MEAN_COVERAGE
        met = least - _chance(least, total) <= mean <= most + _chance(most, total)
        yield Requirement(
            f"spectral_giv, N = {samples}: mean coverage", f"{least:g} to {most:g}", f"{mean:.3f}", met
        )


def _chance(share: float, count: int) -> float:
    return normal_quantile(CHANCE_LEVEL) * math.sqrt(share * (1.0 - share) / count)


#: Name of the generated part of the page.
PART = "efficiency"
CALLED = "python -m validation.efficiency.study"
#: Share of weak estimates from which on a coverage is marked.
MOSTLY = 0.9
Cell = Callable[[Row], str]


def efficiency_tables(rows: pl.DataFrame) -> str:
    first = rows.row(0, named=True)
    parts = [
        f"Made by `{CALLED}` with {first['versions']}: {_number(rows)} records of each scenario and length, "
        f"seed {first['seed']}. Each cell is K / K_u.",
        requirement_table(requirements(rows)),
    ]
    methods = rows["method"].unique(maintain_order=True).to_list()
    for samples in rows["samples"].unique(maintain_order=True):
        here = rows.filter(pl.col("samples") == samples)
        parts += [f"## N = {samples}", "RMSE over the Cramer-Rao bound; without one, RMSE in per cent:"]
        parts.append(_table(here, methods, {"bound, %": _bound}, _over_bound))
        parts.append("Coverage of the 95 % intervals, *weak* where nine in ten estimates or more are:")
        parts.append(_table(here, methods, {}, _covered))
    return "\n\n".join(parts)


def _table(here: pl.DataFrame, methods: list[str], columns: Mapping[str, Cell], cell: Cell) -> str:
    """A row for each scenario: columns that no method changes, and a cell for each method."""
    lines: list[list[str]] = []
    for scenario in here["scenario"].unique(maintain_order=True):
        index = here.filter(pl.col("scenario") == scenario)
        first = index.filter(pl.col("method") == methods[0])
        neighbours = [_pair(first, column) for column in columns.values()]
        cells = [_pair(index.filter(pl.col("method") == method), cell) for method in methods]
        lines.append([str(scenario), _number(index), *neighbours, *cells])
    return markdown(["scenario", "records", *columns, *methods], lines)


def _number(rows: pl.DataFrame) -> str:
    """Number of records, or from which to which it goes."""
    runs = rows["runs"].unique().sort().to_list()
    return f"{runs[0]}" if len(runs) == 1 else f"{runs[0]} to {runs[-1]}"


def _pair(rows: pl.DataFrame, cell: Cell) -> str:
    return " / ".join(cell(row) for row in rows.iter_rows(named=True)) or "-"


def _bound(row: Row) -> str:
    bound = float(row["bound"])
    return "-" if math.isnan(bound) else f"{100.0 * bound:.3g}"


def _over_bound(row: Row) -> str:
    rmse, bound = float(row["rmse"]), float(row["bound"])
    if math.isnan(rmse):
        return "-"
    return f"({100.0 * rmse:.2f} %)" if math.isnan(bound) else f"{rmse / bound:.2f}"


def _covered(row: Row) -> str:
    if not row["count"]:
        return "-"
    weak = "*weak* " if int(row["weak"]) >= MOSTLY * int(row["runs"]) else ""
    return f"{weak}{int(row['hits']) / int(row['count']):.3f}"


def efficiency_suite() -> Suite:
    return read_suite(Path(__file__).with_name("efficiency.toml"))


main = suite_command(
    "validation.efficiency.study",
    __doc__,
    PART,
    efficiency_suite,
    efficiency_rows,
    COLUMNS,
    "efficiency",
    lambda rows: (efficiency_tables(rows), requirements(rows)),
).main

if __name__ == "__main__":
    sys.exit(main())
