"""The command that writes a result for an autopilot, a controller or a simulator."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from eivor.cli import outputs as cli
from eivor.cli.options import NO_TEXTS, parse_pair
from eivor.errors import NotIdentifiedError, UsageError
from eivor.exports.fitted import ACCEPTABLE_WORDS, Supplied, known_number, one_line
from eivor.exports.simulators import RANDOMISATIONS, TARGETS, motions_for
from eivor.inference.verdict import Status
from eivor.motions.rigid_body.vehicle import KnownNumber, load_vehicle
from eivor.report.saved_fit import SavedFit, draws_table, fit_among, load_fits

#: Word for every target, and the page of their folder.
ALL, PAGE = "all", "README.md"
#: Words of every target, and of what takes draws alone.
EVERY = {name: target.words for name, target in TARGETS.items()}
EVERY |= {"isaaclab": "a thousand draws for Isaac Lab (Python file)"}
#: Files of the folder of every target; none has a name that a file of Python imports.
NAMES = {
    name: f"fit_{name.replace('-', '_')}{TARGETS[name].ending if name in TARGETS else '.py'}"
    for name in EVERY
}
FOLDER_FILES = (PAGE, *NAMES.values())


@cli.guarded
def export(
    fit: cli.FitArgument,
    file: Annotated[str, cli.option("export file"), cli.Writes(FOLDER_FILES)] = "",
    *,
    to: Annotated[str, cli.option("export to", (*TARGETS, *RANDOMISATIONS, ALL))] = "",
    model: cli.FitModelOption = "",
    draws: Annotated[int | None, cli.option("export draws")] = None,
    seed: Annotated[int, cli.option("export seed")] = 0,
    mass: Annotated[str, cli.option("export mass")] = "",
    prior: Annotated[list[str], cli.option("export prior")] = NO_TEXTS,
    vehicle: Annotated[str, cli.option("export vehicle"), cli.Reads()] = "",
    accept: Annotated[str, cli.option("export accept", ACCEPTABLE_WORDS)] = "identified",
    output: Annotated[str, cli.option("export output"), cli.Writes(FOLDER_FILES)] = cli.STANDARD_OUTPUT,
) -> cli.ExitCode:
    """Write a result's numbers where they are used, with intervals; only what is identified."""
    output = _destination(to, draws, file, output)
    given = supplied(mass, prior, vehicle)
    fits, omitted, notes = load_fits(fit), tuple[str, ...](), tuple[str, ...]()
    result = fit_among(fits, model, motions_for(to) if to else ())
    try:
        if to == ALL:
            notes = _every_target(fits, model, given, accept, Path(output))
        elif draws is None or to:
            made = result.exported(to, given, draws, seed, accept)
            if isinstance(made.text, bytes) and output == cli.STANDARD_OUTPUT:
                raise UsageError(
                    f"a file for --to {to}", "standard output", f"Add -o fit{TARGETS[to].ending}."
                )
            cli.write_out(made.text, output)
            if output != cli.STANDARD_OUTPUT:
                cli.write(f"{output}: {to}\n")
            omitted, notes = made.omitted, made.lost
        else:
            omitted, notes = _draw_vehicles(result, draws, seed, given, accept, Path(output))
    except NotIdentifiedError as error:
        omitted = (str(error),)
    if omitted or notes:
        cli.complain(*omitted, *notes)
    return cli.ExitCode.NOT_IDENTIFIED if omitted else cli.ExitCode.IDENTIFIED


def _destination(to: str, draws: int | None, file: str, output: str) -> str:
    if not to and draws is None:
        raise UsageError("--to TARGET, --draws N or both", "neither", "Say what is to be written.")
    if file and output != cli.STANDARD_OUTPUT:
        raise UsageError("one place to write to", f"{file} and {output}", "Leave out -o.")
    to_file = file or output
    if not to and to_file == cli.STANDARD_OUTPUT:
        raise UsageError("a file for the draws", "standard output", "Add -o draws.parquet.")
    if to == ALL and (to_file == cli.STANDARD_OUTPUT or draws is not None):
        received = "standard output" if draws is None else f"--draws {draws}"
        raise UsageError("a folder for --to all, and no draws", received, "Give --to all FOLDER.")
    return to_file


def _every_target(
    fits: Mapping[str, SavedFit], model: str, given: Supplied, accept: str, folder: Path
) -> tuple[str, ...]:
    """Write every target that the result supports, and a page that says what each holds; what they lack."""
    sections: list[tuple[str, str, tuple[str, ...]]] = []
    with cli.writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for target, file in NAMES.items():
        result, draws = fit_among(fits, model, motions_for(target)), None if target in TARGETS else 1000
        try:
            try:
                made = result.exported(target, given, draws, 0, accept)
            except UsageError:  # what is given is for other targets
                made = result.exported(target, Supplied(), draws, 0, accept)
        except (NotIdentifiedError, UsageError) as error:
            sections.append((target, "", (str(error),)))
            continue
        cli.write_out(made.text, str(folder / file))
        cli.write(f"{folder / file}: {EVERY[target]}\n")
        sections.append((target, file, (*made.omitted, *made.lost)))
    cli.write_out("\n".join(_page(result, sections)), str(folder / PAGE))
    if any(file for _, file, _ in sections):
        return tuple(dict.fromkeys(note for _, file, notes in sections if file for note in notes))
    raise NotIdentifiedError(
        "a result that one target supports", "none", f"{folder / PAGE} says what each target needs."
    )


def _page(result: SavedFit, sections: Sequence[tuple[str, str, tuple[str, ...]]]) -> Iterator[str]:
    origin = (f"    {one_line(line)}" for line in result.fitted.origin())
    yield from ("# Exports of a result", "", *origin, "")
    for target, file, notes in sections:
        yield f"## {target}: {file or 'not written'}"
        yield from ("", f"For {EVERY[target].rstrip('.')}.", "")
        yield from (f"    {one_line(note)}" for note in notes)
        yield ""


def _draw_vehicles(
    result: SavedFit, count: int, seed: int, supplied: Supplied, accept: str, path: Path
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    replace(supplied, mass=None).check_only((), "draws of a table", body=False)
    table = draws_table(result, count, seed, supplied.mass, accept)
    buffer = io.BytesIO()
    table.write_parquet(buffer)
    cli.write_out(buffer.getvalue(), str(path))
    absent = [name for name in result.names if name not in table.columns]
    columns = ((name, result.quantities[name].verdict) for name in table.columns if name in result.quantities)
    marked = tuple(
        f"{name}: {verdict.value}." for name, verdict in columns if verdict is not Status.IDENTIFIED
    )
    return ((f"Not identified, hence no column: {', '.join(absent)}.",) if absent else ()), marked


def supplied(mass: str, priors: Sequence[str], vehicle: str) -> Supplied:
    """What is known beside a flight, of ``KG[:STD]``, ``NAME=VALUE[:STD]`` and a vehicle's name or file."""
    known = {}
    for text in priors:
        name, equals, number = text.partition("=")
        if not equals:
            raise UsageError("a prior NAME=VALUE:STD", f"'{text}'", "Give delay=0.01:0.002, for example.")
        known[name.strip()] = _known(number, "--prior")
    known_mass = _known(mass, "--mass") if mass else None
    return Supplied(known_mass, known, load_vehicle(vehicle) if vehicle else None)


def _known(text: str, option: str) -> KnownNumber:
    value, std = parse_pair(text if ":" in text else f"{text}:0", omitted=(math.nan, math.nan))
    if math.isnan(std) or not math.isfinite(value):
        raise UsageError(f"VALUE or VALUE:STD for {option}", f"'{text}'", "Give 1.53:0.02, for example.")
    return known_number(value, std)
