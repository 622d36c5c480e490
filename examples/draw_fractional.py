"""Draw what fractional difference equations say: a cell's impedance, and a step response with its error.

    PYTHONPATH=. python examples/draw_fractional.py [FOLDER]

The cell is the record of seed 0 of the study of `validation/fractional`, current and voltage both noisy.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

import eivor as ev
from eivor.report.figure_panels import BLUE, DARK, GREY, RED, labelled, legend, page
from validation.fractional.study import ARC, ARC_ORDER, OHMIC, TIME_CONSTANT, Cell, formulas, step_response

PICTURES = Path(__file__).resolve().parents[1] / "docs" / "images"
#: Steps of the step response [s], and the time that it is drawn for.
STEPS_S, SPAN_S, STEP_ORDER = (0.2, 0.1, 0.05), 8.0, 0.6


def main(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    figure = page(10.0, 3.8)
    impedance, error = figure.subplots(1, 2)
    draw_impedance(impedance)
    draw_error(error)
    path = folder / "fractional.png"
    figure.savefig(path, dpi=110)
    print(path)


def draw_impedance(axes: Axes) -> None:
    """Impedance of the identified equations over that of the cell, real part and negative imaginary part."""
    cell = Cell()
    signals = cell.record(0)
    frequency_hz = np.geomspace(0.005, 5.0, 60)
    true = OHMIC + ARC / (1.0 + (2j * np.pi * frequency_hz * TIME_CONSTANT) ** ARC_ORDER)
    axes.plot(1e3 * true.real, -1e3 * true.imag, color=DARK, linewidth=3, alpha=0.4, label="the cell")
    displayed = {"least_squares": RED, "total_least_squares": BLUE}
    for name, color in displayed.items():
        problem = cell.model.problem(signals, divided_by_output_at=cell.guess)
        result = ev.identify(problem, formulas()[name].method)
        low, high = result.interval("order")
        response = cell.model.frequency_response(result.parameters, frequency_hz, rate_hz=cell.rate_hz)
        label = f"{name.replace('_', ' ')}: order {low:.3f} to {high:.3f}"
        axes.plot(1e3 * response.real, -1e3 * response.imag, color=color, linewidth=1.2, label=label)
    labelled(axes, x="real part [milliohm]", y="- imaginary part [milliohm]", size=9)
    axes.set_title(f"Impedance, order {ARC_ORDER}: one record at 40 dB", fontsize=10)
    axes.set_ylim(0.0, 12.0)
    legend(axes, place="upper left")


def draw_error(axes: Axes) -> None:
    """Error of the simulated step response against Mittag-Leffler's function, by the step."""
    marks = {"difference": (ev.FractionalDifference(), RED), "derivative": (ev.FractionalDerivative(), BLUE)}
    for name, (operator, color) in marks.items():
        model = ev.FractionalDifferenceModel((0.0, STEP_ORDER), (0.0,), operator)
        for number, step_s in enumerate(STEPS_S):
            time = np.arange(1, round(SPAN_S / step_s) + 1) * step_s
            driven = np.ones(time.size + 1)
            driven[0] = 0.5  # a jump enters with the mean of its two sides
            gain = step_s**-STEP_ORDER if name == "difference" else 1.0
            parameters = {"output_coefficient_2": gain, "input_coefficient_1": 1.0}
            result = model.simulate(parameters, driven, rate_hz=1.0 / step_s)[1:]
            error = np.abs(result - step_response(time, STEP_ORDER))
            label = f"{name}, steps {', '.join(f'{item:g}' for item in STEPS_S)} s" if number == 0 else None
            axes.plot(time, error, color=color, linewidth=1.6 - 0.5 * number, label=label)
    axes.set_yscale("log")
    axes.axhline(0.0, color=GREY)
    labelled(axes, x="time [s]", y="error of the step response", size=9)
    axes.set_title("Order 0.6 against Mittag-Leffler's function", fontsize=10)
    legend(axes, place="upper right")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURES)
