"""Frequency responses of logs: axes and references, and documents, JSON and figures of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np

from eivor import checks
from eivor.errors import EstimationError, InstrumentError, MissingChannelError, TooFewSamplesError, UsageError
from eivor.flights.grid import on_grid
from eivor.flights.motion import Motion
from eivor.flights.options import FlightOptions
from eivor.flights.prepare import prepare
from eivor.flights.prepared import PreparedFlight
from eivor.flights.references import ReferenceSource, exogenous
from eivor.flights.result import FlightEstimate
from eivor.models import transfer_functions as tf
from eivor.models.frequency_response import FIRST_CYCLES, FREQUENCIES, FrequencyResponse, frequency_response
from eivor.motions.equation import DeclaredMotion
from eivor.motions.rates.motion import AXES, BAND_SHARE, Rates
from eivor.motions.table import motion_by_name
from eivor.report import figure_panels as plots
from eivor.report.document import Bullets, Document, Facts, Section, TableColumn, section, table
from eivor.report.json_document import Json, document
from eivor.signals.recording import Recording
from eivor.tools import Complex, Float, printable

#: Numbers over frequency.
Values: TypeAlias = Float[np.ndarray, " f"]
#: What a response can be of.
VERTICAL = "vertical"
_VERTICAL = motion_by_name(VERTICAL)
#: Parameters that hold the cut-off of the gyroscope's low pass of second order [Hz].
FILTERS = ("IMU_GYRO_CUTOFF", "INS_GYRO_FILTER")
#: An input that stands at its largest or least value for this share of the time is saturated.
SATURATED = 0.02
#: A model is no explanation of the response below this p-value.
UNLIKELY = 1e-3
#: Rows of the table of frequencies.
ROWS = 14


@dataclass(frozen=True)
class LogResponse:
    """Response of one axis of one log, or of several flights together."""

    name: str  # Of the log
    axis: str
    input: str
    output: str
    reference: str  # Empty for none
    response: FrequencyResponse
    models: tf.TransferFunctions | None = None
    controllers: tuple[tf.Controller, ...] = ()
    loop: FrequencyResponse | None = field(default=None, repr=False)  # Broken at the error of the rate
    findings: tuple[str, ...] = ()


@dataclass(frozen=True)
class ResponsePath:
    """Input, output and possible references of the response of an axis."""

    motion: Motion[Any]  # That selects the channels
    output: str
    references: tuple[ReferenceSource, ...]
    input: str = ""  # Empty for the family that the motion chooses
    turns: bool = False  # The output is a gyroscope's, and the input sets a torque


TURNING = {
    item.name: ResponsePath(Rates((item,)), item.rate, item.references, item.torque, turns=True)
    for item in AXES
}


def response_paths(axis: str, machine: DeclaredMotion[Any] | None = None) -> dict[str, ResponsePath]:
    """Response path by axis: of one axis, of all rotational axes, or of a declared machine's."""
    offered = {
        **TURNING,
        VERTICAL: ResponsePath(_VERTICAL, "specific_force_z", _VERTICAL.channels.references),
    }
    if machine is not None:
        offered = {
            item.name: ResponsePath(machine, item.state[0], item.references, item.inputs[0])
            for item in machine.axes
            if item.state is not None and item.inputs
        }
        remedy = 'Declare a response such as ddt(speed), and a channel with role = "input".'
        if not offered:
            raise UsageError("an equation of a state that an input drives", f"none of {machine.name}", remedy)
    if axis:
        checks.index_of("an axis", axis, tuple(offered))
        return {axis: offered[axis]}
    return TURNING if machine is None else offered


def log_responses(
    recordings: Sequence[Recording],
    options: FlightOptions,
    windows: Sequence[tuple[float, float] | None],
    paths: Mapping[str, ResponsePath],
    reference: str = "",
) -> list[LogResponse]:
    """Responses of the axes that the logs have, flights together; refused when there is none."""
    results, errors = [], []
    for axis, path in paths.items():
        try:
            flights = [
                prepare(log, path.motion, options if window is None else replace(options, window=window))
                for log, window in zip(recordings, windows, strict=True)
            ]
            results.append(response_of_axis(axis, path, flights, reference))
        except (MissingChannelError, TooFewSamplesError) as error:
            errors.append(error)
    if not results:
        raise errors[0]
    return results


def response_of_axis(
    axis: str, path: ResponsePath, flights: Sequence[PreparedFlight], chosen: str = "", *, loops: bool = True
) -> LogResponse:
    """Response of one axis of flights, by the reference that is named or by rule; maybe with its loops."""
    first, output = flights[0], path.output
    source = path.input or first.input.name
    for flight in flights:
        name = flight.recording.name
        if not flight.runs:
            expected, remedy = (
                f"flight in {name} that can be used",
                "Use a log of a flight, or another window.",
            )
            raise TooFewSamplesError(expected, f"none by {flight.active.rule}", remedy)
        if output not in flight.signals.channels:
            raise MissingChannelError(f"{output} in {name}", "a log without it", "Log it.")
    reference, findings = _reference(flights, path, chosen)
    step_s = max(flight.signals.step_s for flight in flights)
    if any(abs(flight.signals.step_s - step_s) > 1e-9 for flight in flights):
        raise UsageError("flights that are logged at one rate", "several rates", "Look at them one by one.")

    def runs(channel: str) -> list[Float[np.ndarray, " n"]]:
        return [values for flight in flights for values in _runs(flight, channel)]

    channels = [output, path.input] if path.input else [output, *first.driving]
    slowest = min(flight.recording.channel(name).rate_hz for flight in flights for name in channels)
    grid = _grid(flights, slowest)
    u, y = runs(source), runs(output)
    settings: dict[str, Any] = {"rate_hz": 1.0 / step_s, "frequency_hz": grid}
    r = runs(reference) if reference else None
    response = frequency_response(u, y, reference=r, **settings)
    findings += [*response.findings, *_saturation(u, source)]
    models: tf.TransferFunctions | None = None
    controllers: tuple[tf.Controller, ...] = ()
    loop: FrequencyResponse | None = None
    try:
        declared = not path.turns and bool(path.input)
        low = min(tf.BAND_HZ[0], float(grid[0])) if declared else tf.BAND_HZ[0]
        band_hz = low, min(tf.BAND_HZ[1], float(grid[-1]))
        models = tf.transfer_functions(response, band_hz=band_hz, sensor_filter=_gyro_filter(first, path))
    except EstimationError as error:
        findings.append(f"No model: {error.received}. {error.remedy}")
    if models is not None and models.chosen.p_value < UNLIKELY:
        why = f"{' of the direct estimate' * response.is_direct} (p = {models.chosen.p_value:.1g})"
        findings.append(f"No order up to 4 explains the response{why}: its intervals are too narrow.")
    elif models is not None and loops and path.turns and models.chosen.p_value >= UNLIKELY:
        controllers, refused = _proposals(response, models)
        findings += refused
    asked_for = (f"feedback_reference_{output}", f"reference_{output}")
    setpoint = next((name for name in asked_for if name in first.recording.channels), "")
    is_attitude = bool(reference) and reference != setpoint and not reference.startswith("injected")
    everywhere = setpoint and all(setpoint in flight.recording.channels for flight in flights)
    if loops and is_attitude and everywhere:
        errors = [commanded - got for commanded, got in zip(runs(setpoint), y, strict=True)]
        measured = frequency_response(errors, y, reference=r, **settings)
        loop = None if response.is_provisional or measured.is_provisional else measured
    names = ", ".join(flight.recording.name for flight in flights)
    return LogResponse(
        names, axis, source, output, reference, response, models, controllers, loop, tuple(findings)
    )


def _proposals(
    response: FrequencyResponse, models: tf.TransferFunctions
) -> tuple[tuple[tf.Controller, ...], tuple[str, ...]]:
    """Controllers whose crossover is inside the band of the response, or the reason for none."""
    if not response.is_shown.any() or response.is_provisional or models.chosen.parameters["gain"] <= 0.0:
        return (), ()
    bottom, top = response.frequency_hz[response.is_shown][[0, -1]].tolist()
    proposals = [(item, *item.intervals["crossover_hz"]) for item in tf.proposed_controllers(models)]
    accepted = tuple(
        item
        for item, low, high in proposals
        if bottom <= low and high <= top and math.isfinite(item.margins.gain_margin_db)
    )
    if accepted or not proposals:
        return accepted, ()
    _, low, high = proposals[0]
    return (), (
        f"No gains are proposed: their loop crosses over at {low:.2g} to {high:.2g} Hz, and the response is "
        f"shown from {bottom:.2g} to {top:.2g} Hz. Fly a sweep over the band.",
    )


def _runs(flight: PreparedFlight, name: str) -> Iterator[Float[np.ndarray, " n"]]:
    """A channel, or the mean of a family, over each run; NaN at samples that are not usable."""
    if name in flight.signals.channels:
        values = flight.signals.channel(name)
    elif name == flight.input.name:
        values = flight.signals.family(name).mean(axis=1)
    else:
        values = on_grid(flight.recording.channel(name), flight.grid)[0]
    for run in flight.runs:
        yield np.where(flight.usable[run], values[run], np.nan)


def _reference(flights: Sequence[PreparedFlight], path: ResponsePath, chosen: str) -> tuple[str, list[str]]:
    """Reference channel, empty for none, and remarks on it."""
    logged = {item.name for item in flights[0].references}
    offered = dict.fromkeys(item.channel for item in path.references if item.channel in logged)
    if chosen:
        checks.index_of("a channel", chosen, tuple(sorted(flights[0].recording.channels)))
        if not exogenous(chosen):
            expected = "a reference that does not answer the vehicle"
            remedy = "Name an attitude setpoint or an injected sweep."
            raise InstrumentError(expected, f"{chosen}, which a loop makes of what is measured", remedy)
        return chosen, []
    usable = [name for name in offered if all(name in flight.usable_references for flight in flights)]
    clean = [name for name in usable if exogenous(name)]
    if clean:
        slow = "A pilot answers the vehicle at low frequencies: provisional there."
        return clean[0], [slow] if clean[0].startswith("pilot_") else []
    if usable:
        return "", [f"{usable[0]} is made by a loop of what is measured: refused as reference."]
    remarks = [f"{item.name}: {item.remark}." for item in flights[0].references if item.name in offered]
    return "", remarks


def _grid(flights: Sequence[PreparedFlight], slowest_hz: float) -> Float[np.ndarray, " f"]:
    """Frequencies from fifteen cycles of the longest run to a share of the slowest sampling rate."""
    longest = max((run.stop - run.start) * flight.signals.step_s for flight in flights for run in flight.runs)
    low = FIRST_CYCLES / longest
    top = min(BAND_SHARE * slowest_hz, 0.25 / flights[0].signals.step_s)
    if top < 2.0 * low:
        expected = f"samples at {10.0 * low:.0f} Hz or more, or a run longer than {longest:.0f} s"
        raise TooFewSamplesError(expected, f"{slowest_hz:.3g} Hz", "Log faster, or fly longer.")
    return np.geomspace(low, top, FREQUENCIES)


def _saturation(u: list[Float[np.ndarray, " n"]], name: str) -> list[str]:
    values = np.concatenate(u)
    values = values[np.isfinite(values)]
    share = float(np.isin(values, (values.min(), values.max())).mean())
    text = f"{name} stands at its limits for {share:.0%} of the time: the response is of what is left."
    return [text] if share >= SATURATED else []


def _gyro_filter(flight: PreparedFlight, path: ResponsePath) -> Any:
    """Response of the gyroscope's low-pass filter in the log's parameters; unity without one."""
    logged = flight.recording.parameters
    cutoff = next((float(logged[name]) for name in FILTERS if logged.get(name)), 0.0) if path.turns else 0.0

    def low_pass(s: Complex[np.ndarray, " f"]) -> Complex[np.ndarray, " f"]:
        if cutoff <= 0.0:
            return np.ones_like(s)
        x = s / (2.0 * np.pi * cutoff)
        return np.asarray(1.0 / (x * x + math.sqrt(2.0) * x + 1.0))

    return low_pass


def response_document(item: LogResponse) -> Document:
    """Document of the response of one axis."""
    response = item.response
    ranges = ", ".join(f"{low:.2g} to {high:.2g} Hz" for low, high in response.shown_ranges)
    kind = "direct estimate" if response.is_direct else "response"
    about = f"{item.axis}: {kind} shown from {ranges}" if ranges else f"{item.axis}: nothing is shown"
    bands = f"{response.level:.0%} at each frequency by itself"
    reference = item.reference or "none"
    facts = (("from", item.input), ("to", item.output), ("reference", reference), ("bands", bands))
    rows = (_frequencies(response),) if response.is_shown.any() else ()
    sections = [Section("", (Facts(facts), *rows))]
    if item.models is not None:
        sections.append(Section("Models by order", (_orders(item.models),)))
        sections.append(Section("What the orders within 4 AICc allow", (_shared_parameters(item.models),)))
    if item.controllers:
        sections.append(Section("Controllers, to be test-flown; none is applied", _controllers(item)))
    if item.loop is not None and item.loop.is_shown.any():
        sections.append(Section("The loop of the rate, as flown", (_loop(item.loop),)))
    return Document(item.name, about, (*sections, *section("Findings", Bullets, item.findings)))


def _frequencies(response: FrequencyResponse) -> Any:
    index = np.flatnonzero(response.is_shown)
    picked = index[np.unique(np.linspace(0, index.size - 1, min(ROWS, index.size)).round().astype(int))]
    decibels = _decibels(np.column_stack([np.abs(response.response), response.bands[0]]))
    phase, (early, late) = np.rad2deg(np.angle(response.response)), np.rad2deg(response.bands[1].T)
    columns = {
        "f [Hz]": [f"{value:.3g}" for value in response.frequency_hz],
        "|G| [dB]": [f"{value:.1f}" for value in decibels[:, 0]],
        "low": [f"{value:.1f}" for value in decibels[:, 1]],
        "high": [f"{value:.1f}" for value in decibels[:, 2]],
        "phase [°]": [f"{value:.0f}" for value in phase],
        "±": [_number_text(value, ".1f") for value in 0.5 * (late - early)],
        "u, y": [f"{value:.2f}" for value in response.direct_coherence],
    }
    if not response.is_direct:
        columns["r, u"] = [f"{value:.2f}" for value in response.points.coherence]
        columns["partial"] = [f"{value:.2f}" for value in response.points.partial]
        off = _decibels(response.direct / response.response)
        columns["direct [dB]"] = [f"{value:+.1f}" for value in off]
    titles = [TableColumn(title, right=True, whole=True) for title in columns]
    return table(titles, ([cells[k] for cells in columns.values()] for k in picked.tolist()))


def _number_text(value: float, form: str) -> str:
    return "" if math.isnan(value) else f"{value:{form}}"


def _ends(interval: tuple[float, float], scale: float = 1.0) -> str:
    return f"{scale * interval[0]:.3g} .. {scale * interval[1]:.3g}"


def _orders(models: tf.TransferFunctions) -> Any:
    rows = []
    for order, model in models.by_order.items():
        value = model.parameters
        rows.append(
            (
                f"{order}{' *' if model is models.chosen else ''}",
                f"{model.aicc - models.chosen.aicc:.1f}",
                f"{model.p_value:.2g}",
                f"{value['gain']:.4g}",
                f"{1e3 * model.lag_s:.1f}",
                f"{1e3 * value['delay']:.1f}",
                f"{value['damping']:.2f}",
                _number_text(model.natural_frequency_hz, ".2g"),
                _number_text(model.damping_ratio, ".2g"),
            )
        )
    titles = ("order", "ΔAICc", "p", "gain", "lag [ms]", "delay [ms]", "damping [1/s]", "f₀ [Hz]", "ζ")
    return table([TableColumn(title, right=True) for title in titles], rows)


def _shared_parameters(models: tf.TransferFunctions) -> Any:
    scales = {"lag": ("lag [ms]", 1e3), "delay": ("delay [ms]", 1e3), "damping": ("damping [1/s]", 1.0)}
    rows = []
    for name in tf.SHARED:
        words, scale = scales.get(name, (name, 1.0))
        rows.append((words, *(_ends(model.intervals[name], scale) for model in (models, models.chosen))))
    titles = (f"{models.level:.0%}, all orders", "chosen order")
    return table(("", *(TableColumn(title, whole=True) for title in titles)), rows)


def _controllers(item: LogResponse) -> tuple[Any, ...]:
    rows, bullets = [], []
    margins = {name: LOOP[name] for name in ("crossover_hz", "phase_margin_deg", "gain_margin_db")}
    for controller in item.controllers:
        cells = (
            f"{getattr(controller.margins, name):.{decimals}f} ({_ends(controller.intervals[name])})"
            for name, (_, decimals) in margins.items()
        )
        gains = f"{controller.proportional:.3g}", f"{controller.integral_s:.2f}"
        rows.append((controller.name, *gains, *cells))
        for values in controller.autopilot_parameters(item.axis).values():
            settings = ", ".join(f"{key} {x:.4g}" for key, x in values.items())
            bullets.append(f"{controller.name}: {settings}")
    return table(("", "P", "Ti [s]", *(words for words, _ in margins.values())), rows), Bullets(
        tuple(bullets)
    )


#: Margins by their words and decimals.
LOOP = {
    "crossover_hz": ("crossover [Hz]", 2),
    "phase_margin_deg": ("phase margin [°]", 0),
    "phase_crossover_hz": ("-180° at [Hz]", 2),
    "gain_margin_db": ("gain margin [dB]", 1),
    "bandwidth_hz": ("bandwidth [Hz]", 2),
    "disturbance_bandwidth_hz": ("disturbance rejection [Hz]", 2),
}


def _loop(loop: FrequencyResponse) -> Any:
    rows = []
    for name, (value, low, high) in tf.measured_margins(loop).items():
        if name in LOOP:
            words, decimals = LOOP[name]
            ends = "" if math.isnan(low) else _ends((low, high))
            rows.append((words, _number_text(value, f".{decimals}f"), ends))
    return table(("", TableColumn("value", right=True), f"{loop.level:.0%}"), rows)


def responses_json(results: Sequence[LogResponse]) -> dict[str, Json]:
    """Document of schema ``eivor.frequency-response/1``: numbers in SI units, null where unbounded."""
    return document("eivor.frequency-response/1", axes=[_axis_json(item) for item in results])


def _axis_json(item: LogResponse) -> dict[str, object]:
    models = item.models
    orders = {} if models is None else models.by_order
    return {
        "log": item.name,
        **{name: getattr(item, name) for name in ("axis", "input", "output")},
        "reference": item.reference or None,
        "direct_only": item.response.is_direct,
        "provisional": item.response.is_provisional,
        "level": item.response.level,
        "shown_hz": item.response.shown_ranges,
        "response": item.response.columns(),
        "models": {
            str(order): {
                "parameters": model.parameters,
                "intervals": model.intervals,
                "poles": [(pole.real, pole.imag) for pole in model.poles.tolist()],
                **{name: getattr(model, name) for name in ("aicc", "chi_square", "dof", "p_value")},
            }
            for order, model in orders.items()
        },
        "order": None if models is None else models.chosen.order,
        "intervals": None if models is None else models.intervals,
        "controllers": [
            asdict(controller) | {"parameters": controller.autopilot_parameters(item.axis)}
            for controller in item.controllers
        ],
        "loop": None
        if item.loop is None
        else item.loop.columns() | {"margins": tf.measured_margins(item.loop)},
        "findings": item.findings,
    }


def response_figure(results: Sequence[LogResponse]) -> plots.Figure:
    """Bode plot with bands and models, coherences, and loops on a Nichols chart; a column for each axis."""
    figure = plots.page(
        max(5.2 * len(results), 7.0), 11.0, f"{printable(results[0].name)}: frequency responses"
    )
    kinds = ("magnitude", "phase", "coherence", "loop")
    rows = [[f"{kind} {item.axis}" for item in results] for kind in kinds]
    panels = plots.mosaic(figure, rows, height_ratios=(1.3, 1.0, 0.7, 1.3))
    for item in results:
        for curves in _curves(item):
            _draw_curves(panels[f"{curves.kind} {item.axis}"], item.response, curves)
        _draw_nichols(panels[f"loop {item.axis}"], item)
        names = f"{item.axis}: {item.input} to {item.output}"
        panels[f"magnitude {item.axis}"].set_title(names, fontsize=9, parse_math=False)
    return figure


def _unwrapped(values: Complex[np.ndarray, " f"], mask: Any) -> Float[np.ndarray, " f"]:
    phase = np.full(values.size, np.nan)
    if mask.any():
        phase[mask] = np.unwrap(np.angle(values[mask]))
        phase -= 2.0 * np.pi * np.ceil((phase[mask][0] - 0.75 * np.pi) / (2.0 * np.pi))
    return np.asarray(np.rad2deg(phase))


#: Looks of a response, of the direct estimate and of a model.
LOOKS: Mapping[str, Mapping[str, Any]] = {
    "measured": {"color": plots.BLUE, "lw": 1.4},
    "residual": {"ls": ":", "color": plots.RED, "lw": 1.1},
    "predicted": {"ls": "--", "color": plots.DARK, "lw": 1.0},
}


@dataclass(frozen=True, slots=True)
class Curves:
    """Curves over frequency, for files and pages; NaN outside the band that is known."""

    kind: str
    unit: str
    lines: list[tuple[str, str, Values]]  # Words and look of each
    bands: tuple[Float[np.ndarray, "f 2"], ...] = ()  # Simultaneous, then pointwise


def _curves(item: LogResponse) -> Iterator[Curves]:
    response, mask = item.response, item.response.is_shown
    name = "direct, biased in closed loop" if response.is_direct else "on the reference"
    series = [(name, "measured", response.response, mask)]
    coherences = [("input, output", "residual", response.direct_coherence)]
    if not response.is_direct:
        series.append(("direct, biased", "residual", response.direct, np.isfinite(response.direct)))
        coherences.append(("reference, input", "measured", response.points.coherence))
        coherences.append(("input, output without the reference", "predicted", response.points.partial))
    if item.models is not None:
        model = item.models.chosen
        values = model.response(response.frequency_hz)
        series.append((f"model of order {model.order}", "predicted", values, np.ones_like(mask)))
    bands_of = response.simultaneous_bands, response.bands
    # multiples of 360 degrees from the phases of the bands to the unwrapped phases
    turn = _unwrapped(response.response, mask) - np.rad2deg(np.angle(response.response))
    sizes = [(name, look, np.where(where, _decibels(curve), np.nan)) for name, look, curve, where in series]
    bands = tuple(np.where(mask[:, None], _decibels(band), np.nan) for band, _ in bands_of)
    yield Curves("magnitude", "dB", sizes, bands)
    phases = [(name, look, _unwrapped(curve, where)) for name, look, curve, where in series]
    yield Curves("phase", "°", phases, tuple(np.rad2deg(band) + turn[:, None] for _, band in bands_of))
    yield Curves("coherence", "", coherences)


def _draw_curves(axes: plots.Axes, response: FrequencyResponse, curves: Curves) -> None:
    f, shares = response.frequency_hz, ((0.12, "all together"), (0.3, "each"))
    for band, (alpha, words) in zip(curves.bands, shares, strict=False):
        label = f"{response.level:.0%} {words}"
        axes.fill_between(f, *band.T, color=plots.BLUE, alpha=alpha, lw=0, label=label)
    for label, look, values in curves.lines:
        axes.plot(f, values, label=label, **LOOKS[look])
    axes.set(xscale="log")
    if curves.kind == "magnitude" and response.is_shown.any():
        size = curves.lines[0][-1]
        axes.set_ylim(np.nanmin(size) - 14.0, np.nanmax(size) + 14.0)
    plots.labelled(axes, x="frequency [Hz]", y=f"{curves.kind} [{curves.unit or '-'}]", size=9.0)
    axes.grid(alpha=0.25, which="both")
    if curves.kind != "phase":  # whose lines are those above it
        plots.legend(axes, size=7, location="lower left")


def response_pictures(result: FlightEstimate) -> Iterator[plots.Pictures]:
    """Magnitude, phase and coherences of the axes of turning whose responses the flights show."""
    flying = [flight for flight in result.prepared if flight.runs]
    for axis, path in TURNING.items() if isinstance(result.motion, Rates) and result.fit else ():
        try:
            item = response_of_axis(axis, path, flying, loops=False)
        except (EstimationError, MissingChannelError, TooFewSamplesError, UsageError):
            continue  # not logged, too short, or at several rates
        if not item.response.is_direct and item.response.is_shown.any():
            yield f"Response of {axis}", tuple(_response_charts(item))


def _response_charts(item: LogResponse) -> Iterator[plots.Picture]:
    response = item.response
    words = f"{item.input} to {item.output}, on {item.reference}; {response.level:.0%} bands."
    x = np.log10(response.frequency_hz)
    full, view = ((float(part[0]), float(part[-1])) for part in (x, x[response.is_shown]))
    for curves in _curves(item):
        ends = [pair for band in curves.bands[-1:] for pair in zip(("low", "high"), band.T, strict=True)]
        edges = (plots.Line(f"{end} end of the band", "edge", values) for end, values in ends)
        lines = (*edges, *(plots.Line(*line) for line in curves.lines))
        chart = plots.Chart(
            f"response-{item.axis}", curves.unit, x, lines, full, view, (), over_frequency=True
        )
        unit = f" [{curves.unit}]" if curves.unit else ""
        yield plots.Picture(f"Response of {item.axis}: {curves.kind}{unit}", words, chart)


def _decibels(response: Any) -> Any:
    return 20.0 * np.log10(np.maximum(np.abs(response), 1e-12))


def _draw_nichols(axes: plots.Axes, item: LogResponse) -> None:
    """Broken loops by phase and magnitude: as flown where the log has it, and with the proposals."""
    f = np.geomspace(0.1, 20.0, 300)
    if item.loop is not None and item.loop.is_shown.any():
        mask, size = item.loop.is_shown, _decibels(item.loop.response)
        axes.plot(
            _unwrapped(item.loop.response, mask), size, "o-", color=plots.BLUE, ms=3, lw=1.0, label="as flown"
        )
    for controller, colour in zip(item.controllers, (plots.RED, plots.DARK), strict=False):
        loop = item.models.chosen.response(f) * controller.response(2j * np.pi * f) if item.models else f + 0j
        angle = _unwrapped(loop, np.ones(f.size, dtype=np.bool_))
        axes.plot(angle, _decibels(loop), color=colour, lw=1.1, label=controller.name)
        margins = controller.margins
        ends = [margins.phase_margin_deg - 180.0, -180.0], [0.0, -margins.gain_margin_db]
        axes.plot(*ends, "s", color=colour, ms=4)
    axes.plot([-180.0], [0.0], "+", color=plots.DARK, ms=10)
    axes.set(xlim=(-300.0, -30.0), ylim=(-30.0, 30.0))
    axes.grid(alpha=0.25)
    plots.labelled(axes, x="phase of the broken loop [°]", y="magnitude [dB]", size=9.0)
    if len(axes.lines) > 1:
        plots.legend(axes, size=7, location="upper left")
    else:
        axes.text(-165.0, 10.0, "no loop is known", fontsize=8, ha="center", color=plots.GREY)
