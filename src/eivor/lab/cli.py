"""Commands of the laboratory: simulate, study and paper."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from eivor import checks
from eivor.cli import outputs as cli
from eivor.cli.export import supplied
from eivor.dask_executor import DaskCluster
from eivor.errors import InputError, ParameterError, UsageError
from eivor.exports.fitted import ACCEPTABLE_WORDS, accepted_verdicts
from eivor.exports.vehicle import BODY, describe, simulated_vehicle
from eivor.exports.vehicle import RIGID_BODY as RIGID_BODY_MODEL
from eivor.lab import figures as drawings
from eivor.lab.paper import PaperResult, named_readings, run_paper
from eivor.lab.records import Scenario, log_about_hover
from eivor.lab.scenario_files import SIMULATED, Simulated, shipped_file, study_from_table
from eivor.lab.study import TOGETHER, MethodScore, StudyResult, failure, run_study, scores, study_executor
from eivor.logs.table.columnar import write_recording
from eivor.report.figures import save_figure
from eivor.report.json_document import document, json_text
from eivor.report.saved_fit import fit_among, load_fits
from eivor.simulation.environment import KnownLog
from eivor.simulation.rigid_body import RigidBodyFlightSpec, log_of_rigid_body_flight, vehicle_text
from eivor.simulation.vertical import logs_of_flights
from eivor.strict_toml import read_toml
from eivor.tools import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure


#: The word for every reading.
ALL = "all"


@cli.guarded
def paper(
    *,
    runs: Annotated[int, cli.option("paper runs")] = 100,
    out: Annotated[str, cli.option("paper out"), cli.Writes(cli.PAPER_FILES)] = "",
    readings: Annotated[
        str, cli.option("paper readings", tuple(item.name for item in named_readings(())))
    ] = "",
    workers: Annotated[int | None, cli.option("paper workers")] = None,
) -> cli.ExitCode:
    """Run examples 1 and 2 of the paper that Eivor started from, and print measured beside printed.

    The paper: D. Ivanov, A. Zhdanov and I. Sandler, Identification of dynamical systems with time-varying
    disturbances and fractional errors-in-variables. Application example to a drone model (2024).

    Its text can be read in several ways; each is run, and none gives the printed tables.
    """
    named = tuple(name.strip() for name in readings.split(",") if name.strip())
    chosen = named_readings(() if named == (ALL,) else named)
    if runs < 2 or (workers or 0) < 0:
        expected = "two runs or more, and workers of zero or more"
        raise UsageError(expected, f"--runs {runs} --workers {workers or 0}", "The paper has 100 runs.")
    for path in drawings.figure_files(_folder(out)) if out else ():
        cli.output_file(str(path), option="--out")
    results = []
    with cli.progress_bar("examples") as progress:
        for result in run_paper(chosen, runs=runs, workers=workers or None):
            results.append(result)
            progress(len(results), 2 * len(chosen))
    groups = drawings.by_reading(results)
    nearest_group = groups[drawings.nearest(results)]
    chosen_groups = [*groups.values()] if named else [nearest_group]
    parts = [lambda: cli.show(_paper_report(results, chosen_groups, whole=bool(named)))]
    if out:
        parts.append(partial(_draw, Path(out), lambda: drawings.paper_figures(nearest_group)))
    cli.deliver(*parts)
    return cli.ExitCode.IDENTIFIED


def _paper_report(
    results: Sequence[PaperResult], groups: Sequence[Sequence[PaperResult]], *, whole: bool
) -> RenderableType:
    parts = (part for group in groups for part in drawings.reading_report(group))
    more = [] if whole else [Text(f"Every reading's tables: eivor paper --readings {ALL}")]
    return Group(*parts, *drawings.overview_report(results), *more)


def _draw(folder: Path, figures: Callable[[], Iterable[tuple[str, Figure]]]) -> None:
    """Draw figures by their names, each as SVG and PNG, into a folder that exists."""
    with cli.step("Drawing the figures"), cli.writing(folder):
        for name, figure in figures():
            for path in drawings.figure_files(folder, name):
                save_figure(figure, path)


def _folder(text: str) -> Path:
    """Folder of the figures, made when it is not there."""
    folder = Path(text)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        received = f"'{text}', for which the system says: {error.strerror or error}"
        raise InputError("a folder for the figures", received, "Choose another.") from error
    return folder


@cli.guarded
def simulate(
    scenario_file: Annotated[str, cli.option("simulate scenario_file"), cli.Reads()],
    *,
    out: Annotated[str, cli.option("simulate out"), cli.Writes()],
    seed: Annotated[int, cli.option("simulate seed")] = 0,
    truth: Annotated[str, cli.option("simulate truth"), cli.Writes()] = "",
    vehicle: Annotated[str, cli.option("simulate vehicle"), cli.Writes()] = "",
    fit: Annotated[str, cli.option("simulate fit"), cli.Reads()] = "",
    mass: Annotated[str, cli.option("simulate mass")] = "",
    accept: Annotated[str, cli.option("simulate accept", ACCEPTABLE_WORDS)] = "identified",
) -> cli.ExitCode:
    """Simulate motion with known parameters into a log.

    The scenario 'flight', and a file with kind = "flight", give a log as an autopilot keeps it. It has
    100 Hz, commands that the rotors follow with a lag, and the altitude that was requested.

    'crazyflie' and 'quadrotor', and a file with kind = "rigid-body", fly all axes of a vehicle: its log has
    body rates, attitude and the controller's setpoints too.

    With --from FIT.json these fly the vehicle of a result instead of their own.

    Other scenarios move about hover. Their log has acceleration_z, velocity_z and input as measured, and
    under control the reference too: reference_velocity_z, or reference_position_z beside position_z.
    Their input is a deviation from hover.
    """
    checks.seed(seed)
    log_path = Path(out)
    if log_path.suffix != ".parquet":
        raise UsageError("a log that ends in .parquet", f"'{out}'", "Change the ending.")
    source = Path(scenario_file)
    scenario, files = _scenario(source)
    if fit:
        scenario = _of_fit(scenario, fit, mass, accept)
        files = {*files, Path(fit)}
    if vehicle and not isinstance(scenario, RigidBodyFlightSpec):
        expected = "--vehicle with a flight of a whole vehicle, such as crazyflie"
        raise UsageError(expected, f"'{source.stem}', whose rotors are nowhere", "Leave --vehicle out.")
    cli.keep_inputs(source.name, files)
    try:
        with cli.step("Simulating"):
            made = _simulated(scenario, seed)
    except ParameterError as error:  # what depends on rate and length shows only here
        raise InputError(error.expected, f"{error.received}, in {source.name}", error.remedy) from error
    with cli.writing(log_path):
        write_recording(replace(made.recording, name=log_path.name), log_path)
    if truth:
        cli.write_out(json_text(made.truth), truth)
    if vehicle and isinstance(scenario, RigidBodyFlightSpec):
        cli.write_out(vehicle_text(scenario, source.stem), vehicle)
    duration = made.samples / made.rate_hz
    cli.write(f"{log_path}: {made.samples} samples at {made.rate_hz:g} Hz, {duration:g} s\n")
    return cli.ExitCode.IDENTIFIED


def _scenario(source: Path) -> tuple[Simulated, set[Path]]:
    if not source.exists() and not source.suffix and source.name == str(source):
        source = shipped_file(source.name)
    table = read_toml(source, "a scenario")
    kind = table.choose("kind", table.values.get("kind", "vertical"), tuple(SIMULATED))
    return SIMULATED[kind](table), table.files


def _of_fit(scenario: Simulated, fit: str, mass: str, accept: str) -> RigidBodyFlightSpec:
    """The flight of a whole vehicle with the vehicle of a result in place of its own."""
    if not isinstance(scenario, RigidBodyFlightSpec):
        expected = "--from with a flight of a whole vehicle"
        raise UsageError(expected, "another scenario", "Name quadrotor or crazyflie.")
    result = fit_among(load_fits(fit), preferred=("rigid-body",))
    fitted = replace(result.fitted, accepted=accepted_verdicts(accept))
    if fitted.model != RIGID_BODY_MODEL:
        remedy = "Identify the log with --model rigid-body --vehicle FILE.toml."
        raise UsageError("a result of the rigid body for --from", f"one of {fitted.model}", remedy)
    made = describe(fitted, supplied(mass, (), ""), "a simulated flight", BODY)
    vehicle, step_s = simulated_vehicle(made), scenario.step_s
    delay = round(vehicle.rotors.delay / step_s) * step_s
    said = [*made.omitted, *made.lost]
    if not math.isclose(delay, vehicle.rotors.delay, abs_tol=1e-9):
        steps = f"whole steps of {1e3 * step_s:.4g} ms"
        said.append(f"The delay is {1e3 * delay:.4g} ms for {1e3 * vehicle.rotors.delay:.4g} ms, in {steps}.")
    if said:
        cli.complain(*said)
    return replace(scenario, vehicle=replace(vehicle, rotors=replace(vehicle.rotors, delay=delay)))


def _simulated(scenario: Simulated, seed: int) -> KnownLog:
    if isinstance(scenario, Scenario):
        return log_about_hover(scenario, seed)
    if isinstance(scenario, RigidBodyFlightSpec):
        return log_of_rigid_body_flight(replace(scenario, seed=seed))
    return next(logs_of_flights([replace(scenario, seed=seed)]))


@cli.guarded
def study(
    study_file: Annotated[str, cli.option("study study_file"), cli.Reads()],
    *,
    out: Annotated[
        str,
        cli.option("study out"),
        cli.Writes(cli.STUDY_FILES, default=lambda values: f"{Path(values['study_file']).stem}-study"),
    ] = "",
    runs: Annotated[int | None, cli.option("study runs")] = None,
    workers: cli.WorkersOption = None,
    dask: Annotated[str, cli.option("study dask")] = "",
    figures: Annotated[bool, cli.option("study figures")] = False,
    json: cli.JsonOption = "",
) -> cli.ExitCode:
    """Run a Monte Carlo study, or go on with one that was interrupted."""
    if workers is not None and dask:
        raise UsageError("--workers or --dask", "both", "A Dask cluster brings its own workers.")
    table = read_toml(Path(study_file), "a study")
    chosen = study_from_table(table)
    if runs is not None:
        chosen = replace(chosen, runs=runs)
    executor = DaskCluster(dask) if dask else study_executor(chosen, workers)
    folder = Path(out) if out else Path(f"{Path(study_file).stem}-study")
    cli.keep_inputs(Path(study_file).name, table.files)
    try:
        with cli.progress_bar(chosen.name) as progress:
            result = run_study(chosen, folder, executor=executor, progress=progress)
    except KeyboardInterrupt:
        cli.complain("interrupted", f"Complete trials are in {folder}. Run the same command again to go on.")
        return cli.ExitCode.INTERRUPTED
    results = scores(result)

    cli.deliver_result(
        lambda: _report(result, results),
        lambda: json_text(_document(result, results)),
        json,
        *([partial(_draw, result.folder, lambda: drawings.study_figures(result))] if figures else []),
    )
    every_one_failed = all(item.failed == item.trials for item in results)
    return cli.ExitCode.FAILED if every_one_failed else cli.ExitCode.IDENTIFIED


def _report(result: StudyResult, method_scores: tuple[MethodScore, ...]) -> RenderableType:
    study = result.study
    truth = ", ".join(f"{name} = {value:g}" for name, value in study.experiment.truth.items())
    parts: list[RenderableType] = [
        Text(f"{printable(study.name)}: {study.runs} trials, seed {study.seed}", style="bold"),
        Text(f"truth: {truth}"),
        _table(method_scores),
        *((_coverage_table(method_scores, study.level),) if study.intervals else ()),
    ]
    for score in method_scores:
        if score.first_failure is not None:
            sentence = printable(failure(study, score.first_failure, score.label))
            counts = f"{score.label} failed in {score.failed} of {score.trials} trials"
            parts.append(Text(f"{counts}; {score.first_failure}: {sentence}"))
    parts.append(Text(f"Every trial: {printable(str(result.folder / 'trials.parquet'))}", style="dim"))
    return Group(*parts)


def _table(method_scores: tuple[MethodScore, ...]) -> Table:
    table = _columns("", "mean ± SD", "NRMSE, %", "bias", "RMSE")
    for index, method_score in enumerate(method_scores):
        if index:
            table.add_row()
        counts = {"failed": method_score.failed, "weak": method_score.weak}
        notes = [f"{count} {word}" for word, count in counts.items() if count]
        table.add_row(Text(method_score.label, style="bold"), ", ".join(notes))
        for score in method_score.parameters:
            cells = [f"  {score.name}", f"{score.estimate:.4g}", f"{score.nrmse:.3g}"]
            table.add_row(*cells, f"{score.bias:.2g}", f"{score.rmse:.2g}")
        table.add_row(f"  {TOGETHER}", "", f"{method_score.together:.3g}")
    return table


def _coverage_table(method_scores: tuple[MethodScore, ...], level: float) -> Table:
    table = _columns(f"{100 * level:g} % intervals", "held the truth", "95 % range of this share")
    for method_score in method_scores:
        for score in method_score.parameters:
            if score.coverage is not None:
                low, high = score.coverage.interval
                share = f"{100 * score.coverage.value:.1f} %"
                label = f"{method_score.label}, {score.name}"
                table.add_row(label, share, f"{100 * low:.1f} to {100 * high:.1f} %")
    return table


def _columns(first: str, *numbers: str) -> Table:
    """Empty table: words that may be folded, and numbers that are never cut."""
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(first, overflow="fold")
    for title in numbers:
        table.add_column(title, justify="right", no_wrap=True)
    return table


def _document(result: StudyResult, method_scores: tuple[MethodScore, ...]) -> dict[str, Any]:
    study = result.study
    about = {name: getattr(study, name) for name in ("name", "identity", "runs", "seed")}
    return document(
        "eivor.study/1",
        study=about | {"level": study.level if study.intervals else None},
        truth=dict(study.experiment.truth),
        methods=[_method(method_score) for method_score in method_scores],
        trials=str(result.folder / "trials.parquet"),
    )


def _method(method_score: MethodScore) -> dict[str, object]:
    parameters = {}
    for score in method_score.parameters:
        share = score.coverage
        held = share and {"share": share.value, "bounds": share.interval, "count": share.count}
        parameters[score.name] = {
            **asdict(score.estimate),
            "bias": score.bias,
            "rmse": score.rmse,
            "nrmse_percent": score.nrmse,
            "coverage": held,
        }
    return {
        **{key: getattr(method_score, key) for key in ("label", "trials", "failed", "weak")},
        "parameters": parameters,
        "together": {"nrmse_percent": method_score.together},
    }
