"""Frequency responses in closed loop: bands, models, margins, and what the command says of logs."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import partial

import numpy as np
import polars as pl
import pytest
from scipy.signal import lfilter

import eivor as ev
from eivor import errors
from validation.frequency_responses import FILTER_HZ, STEP_S, exact_margins, flights, truth

RATE_HZ = 400.0
NUMBERS = ("gain", "damping", "delay", "first", "second", "third")


def low_pass(s):
    x = s / (2.0 * np.pi * FILTER_HZ)
    return 1.0 / (x * x + np.sqrt(2.0) * x + 1.0)


@pytest.fixture(scope="module")
def swept():
    """Eight flights with a sweep in wind, actuators of order two; columns are flights."""
    return flights(2, "chirp", 4.0, 8, 100)


@pytest.fixture(scope="module")
def first(swept):
    _, r, u, y = swept
    grid = np.geomspace(0.5, 18.0, 24)
    return ev.frequency_response(u[:, 0], y[:, 0], reference=r[:, 0], rate_hz=RATE_HZ, frequency_hz=grid)


def inside(band, values):
    return np.isnan(band[:, 1]) | ((band[:, 0] <= values) & (values <= band[:, 1]))


def test_bands_hold_in_closed_loop_and_the_direct_ones_do_not(swept):
    made, r, u, y = swept
    grid = np.geomspace(0.5, 18.0, 16)
    G, _ = truth(made, grid)
    held, direct = [], []
    for k in range(made.runs):
        result = ev.frequency_response(
            u[:, k], y[:, k], reference=r[:, k], rate_hz=RATE_HZ, frequency_hz=grid
        )
        held.append(inside(result.bands[0], np.abs(G[k])))
        alone = ev.frequency_response(u[:, k], y[:, k], reference=None, rate_hz=RATE_HZ, frequency_hz=grid)
        direct.append(inside(alone.bands[0], np.abs(G[k])))
        assert result.is_shown.mean() > 0.5
    # 128 bands of 90 %, which neighbours share: four standard errors below
    assert np.mean(held) > 0.79
    assert np.mean(direct) < np.mean(held) - 0.15


def test_several_runs_and_gaps_are_combined(swept, first):
    _, r, u, y = swept
    grid = first.frequency_hz
    broken = y[:, 0].copy()
    broken[9000:9100] = np.nan
    two = ev.frequency_response(u[:, 0], broken, reference=r[:, 0], rate_hz=RATE_HZ, frequency_hz=grid)
    assert len(two.runs) == 2
    distance = np.abs(two.response / first.response - 1.0)
    assert np.median(distance[two.is_shown]) < 0.2
    parts = [slice(0, 12000), slice(12000, 24000)]
    lists = [[values[part, 0] for part in parts] for values in (u, y, r)]
    joined = ev.frequency_response(*lists[:2], reference=lists[2], rate_hz=RATE_HZ, frequency_hz=grid)
    assert len(joined.runs) == 2
    assert joined.frequency_hz.tolist() == grid.tolist()


def test_a_periodic_multisine_without_noise_gives_the_exact_response():
    _, r, _, _ = flights(2, "multisine", 0.0, 1, 3)
    r = r[:, 0]
    response = lfilter([0.0, 0.02, 0.01], [1.0, -1.6, 0.68], r)
    steady = slice(9600, None)  # six periods of 6 s, after the transient
    given = {"reference": r[steady], "rate_hz": RATE_HZ, "period_s": 6.0}
    result = ev.frequency_response(r[steady], response[steady], **given)
    z = np.exp(2j * np.pi * result.frequency_hz / RATE_HZ)
    exact = (0.02 * z + 0.01) / (z * z - 1.6 * z + 0.68)
    assert result.frequency_hz.size > 20
    assert np.abs(result.response / exact - 1.0).max() < 1e-6


def test_shown_only_where_the_reference_reaches(swept, first):
    rng, (_, command, moved, measured) = np.random.default_rng(0), swept
    loud = measured[:, 0] + measured.std() * rng.standard_normal(len(measured))
    heard = ev.frequency_response(moved[:, 0], loud, reference=command[:, 0], rate_hz=RATE_HZ)
    assert set(heard.is_shown[heard.bands[0][:, 0] == 0.0].tolist()) == {False}
    u, y, r = rng.standard_normal((3, 8000))
    nothing = ev.frequency_response(u, y, reference=r, rate_hz=100.0)
    assert not nothing.is_shown.any()
    said = "at no three neighbouring frequencies: nothing is shown. Fly a sweep."
    assert nothing.findings[0].endswith(said)
    assert np.isnan(nothing.bands[0][:, 1]).mean() > 0.5
    with pytest.raises(errors.EstimationError, match="a reference that reaches 6 frequencies"):
        ev.transfer_functions(nothing)
    assert first.shown_ranges
    frame = first.to_frame()
    assert frame.height == 24
    assert np.isfinite(frame["magnitude"].to_numpy()).all()


def test_the_simultaneous_band_is_wider(first):
    each, together = first.bands[0], first.simultaneous_bands[0]
    shown = first.is_shown & np.isfinite(together[:, 1])
    assert (together[shown, 1] - together[shown, 0] > each[shown, 1] - each[shown, 0]).all()


def test_without_a_reference_it_is_the_direct_estimate_and_says_so(swept):
    _, _, u, y = swept
    result = ev.frequency_response(u[:, 0], y[:, 0], reference=None, rate_hz=RATE_HZ)
    assert result.is_direct
    assert "biased where the input answers" in " ".join(result.findings)
    assert np.allclose(result.response, result.direct, equal_nan=True)


def test_models_find_order_lag_and_delay(swept):
    made, r, u, y = swept
    held, orders = [], []
    for k in range(made.runs):
        result = ev.frequency_response(u[:, k], y[:, k], reference=r[:, k], rate_hz=RATE_HZ)
        models = ev.transfer_functions(result, sensor_filter=low_pass)
        orders.append(models.chosen.order)
        for name, value in {"gain": made.K[k], "delay": made.delay[k], "lag": made.lag[k]}.items():
            low, high = models.intervals[name]
            held.append(low <= value <= high)
            assert high > low
    assert orders.count(2) >= 6
    assert np.mean(held) > 0.75
    assert models.by_order[4].poles.size == 4
    with pytest.raises(errors.UsageError, match="orders out of 1, 2, 3 and 4"):
        ev.transfer_functions(result, orders=(5,))


def test_margins_agree_with_python_control():
    control = pytest.importorskip("control")
    s = control.tf("s")
    system = 40.0 * (1.0 + 1.0 / (0.5 * s)) / ((s + 1.0) * (0.05 * s + 1.0) * (0.02 * s + 1.0))
    gain_margin, phase_margin, at_phase, at_gain = control.margin(system)
    margins = ev.loop_margins(system)
    assert margins.phase_margin_deg == pytest.approx(phase_margin, rel=1e-6)
    assert margins.gain_margin_db == pytest.approx(20.0 * np.log10(gain_margin), rel=1e-6)
    assert 2.0 * np.pi * margins.crossover_hz == pytest.approx(at_gain, rel=1e-6)
    assert 2.0 * np.pi * margins.phase_crossover_hz == pytest.approx(at_phase, rel=1e-6)
    closed = control.feedback(system, 1)
    assert np.degrees(np.angle(closed(2j * np.pi * margins.bandwidth_hz))) == pytest.approx(-90.0)
    sensitivity = abs(1.0 - closed(2j * np.pi * margins.disturbance_bandwidth_hz))
    assert sensitivity == pytest.approx(np.sqrt(0.5), rel=1e-6)


def test_margins_of_a_loop_as_flown_hold(swept):
    """Of the loop that is broken at the torque setpoint, to which the sweep is added."""
    made, r, u, _ = swept
    held = []

    def controllers(s, k):
        rate = made.kp[k] * (1.0 + STEP_S / (1.0 - np.exp(-s * STEP_S)) / made.ti[k])
        return rate * (1.0 + made.ka[k] / s)

    for k in range(made.runs):
        loop = ev.frequency_response(u[:, k], r[:, k] - u[:, k], reference=r[:, k], rate_hz=RATE_HZ)
        exact = exact_margins(made, k, partial(controllers, k=k))
        ends = ev.margin_intervals(loop)
        held += [
            ends[name][0] <= getattr(exact, name) <= ends[name][1]
            for name in ("crossover_hz", "phase_margin_deg", "gain_margin_db", "phase_crossover_hz")
            if np.isfinite(ends[name][0])
        ]
    assert len(held) > 12
    assert np.mean(held) > 0.8
    with pytest.raises(errors.UsageError, match="a broken loop alone"):
        ev.margin_intervals(loop, lambda s: s)


def test_responses_and_models_go_to_python_control(first):
    pytest.importorskip("control")
    model = ev.transfer_functions(first, orders=(4,)).chosen
    gain, damping, delay, one, two, three = (model.parameters[name] for name in NUMBERS)
    s = 2j * np.pi * 3.0
    lagging = (1.0 + one * s + two * s * s) * (1.0 + three * s)
    exact = gain * np.exp(-delay * s) / ((s + damping) * lagging)
    real = replace(model, parameters={**model.parameters, "first": 2.1 * two**0.5})
    assert np.isnan([real.damping_ratio, real.natural_frequency_hz]).all()  # a pair of real poles has neither
    assert model.to_control()(s) == pytest.approx(exact, rel=1e-6)
    shown = first.to_control()
    assert shown.omega / (2.0 * np.pi) == pytest.approx(first.frequency_hz[first.is_shown])


def test_proposals_reach_their_phase_margin_on_the_vehicle(swept):
    made, r, u, y = swept
    result = ev.frequency_response(u[:, 1], y[:, 1], reference=r[:, 1], rate_hz=RATE_HZ)
    models = ev.transfer_functions(result, sensor_filter=low_pass)
    simc, *others = ev.proposed_controllers(models)
    grid = np.geomspace(0.2, 20.0, 400)
    G = truth(made, grid)[0][1] * simc.response(2j * np.pi * grid)
    crossing = np.flatnonzero(np.abs(G) < 1.0)[0]
    assert np.degrees(np.angle(-G[crossing])) > 45.0
    assert all(item.margins.phase_margin_deg == pytest.approx(60.0, abs=1.0) for item in others)
    low, high = simc.intervals["phase_margin_deg"]
    assert low < simc.margins.phase_margin_deg < high
    written = simc.autopilot_parameters("roll")
    assert written["px4"]["MC_ROLLRATE_P"] == simc.proportional
    assert written["ardupilot"]["ATC_RAT_RLL_I"] == simc.proportional / simc.integral_s


# -- Logs --


@pytest.fixture(scope="module")
def log(swept, tmp_path_factory):
    """A log of the first flight as a table."""
    _, r, u, y = swept
    columns = {"torque_setpoint_x": u[:, 0], "angular_rate_x": y[:, 0], "injected_torque_x": r[:, 0]}
    path = tmp_path_factory.mktemp("log") / "sweep.csv"
    pl.DataFrame({"time": np.arange(len(u)) / RATE_HZ, **columns}).write_csv(path)
    return path


@pytest.fixture
def responses(command_line):
    """Frequency responses that the command finds, by axis."""

    def found(*arguments):
        run = command_line("frequency-response", *arguments, "--json", "-")
        return json.loads(run.out)["axes"]

    return found


def test_one_axis_of_a_log_suffices(responses, log):
    (item,) = responses(log)
    assert (item["axis"], item["reference"]) == ("roll", "injected_torque_x")
    assert item["order"] in (2, 3)
    assert item["controllers"]


@pytest.mark.thorough
def test_a_figure_has_four_panels_for_an_axis(responses, log, tmp_path):
    responses(log, "--figure", tmp_path / "x.svg")
    assert len(re.findall(r'<g id="axes_\d+"', (tmp_path / "x.svg").read_text(encoding="utf-8"))) == 4


def test_references_of_the_loop_are_refused(responses, command_line, log, tmp_path):
    table, name = pl.read_csv(log), "feedback_reference_angular_rate_x"
    table.rename({"injected_torque_x": name}).write_csv(tmp_path / "loop.csv")
    for path, option, word, said in (
        (log, "--axis", "wing", "an axis out of"),
        (log, "--reference", "nothing", "a channel out of"),
        (tmp_path / "loop.csv", "--reference", name, "a loop makes"),
    ):
        run = command_line("frequency-response", path, option, word)
        assert run.code in (1, 2)
        assert said in run.err
    table.drop("injected_torque_x").write_csv(tmp_path / "bare.csv")
    (item,) = responses(tmp_path / "bare.csv")
    assert item["direct_only"]
    assert not item["controllers"]


def test_a_reference_that_answers_the_output_is_provisional():
    """A rate setpoint that an attitude loop makes; the attitude setpoint itself is from outside."""
    made, setpoint, u, y = flights(2, "setpoints", 2.0, 1, 3)
    attitude = np.cumsum(y, axis=0) / RATE_HZ
    loop = made.ka * (setpoint - attitude)
    for reference, answered in ((loop, True), (setpoint, False)):
        result = ev.frequency_response(u[:, 0], y[:, 0], reference=reference[:, 0], rate_hz=RATE_HZ)
        assert result.is_answered is answered
        assert any("provisional" in sentence for sentence in result.findings) is answered


@pytest.mark.thorough
@pytest.mark.usefixtures("unchecked_shapes", "coarse_search")
def test_page_of_turning_shows_responses(command_line, log, tmp_path):
    command_line("identify", log, "--model", "rates", "--window", "0:30", "--html", tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Response of roll: magnitude" in page
    assert "Response of pitch" not in page


@pytest.mark.thorough
def test_order_of_turning_is_chosen():
    """A motor and its controller lag in two stages: the delay is too long where one lag imitates them."""
    made, r, u, y = flights(3, "chirp", 2.0, 2, 7)
    columns = {"torque_setpoint_x": u[:, 1], "angular_rate_x": y[:, 1], "injected_torque_x": r[:, 1]}
    log = ev.recording_from_columns({"time": np.arange(len(u)) / RATE_HZ, **columns}, name="sweep")
    truth = made.delay[1] + np.sqrt(2.0) / (2.0 * np.pi * FILTER_HZ)
    fits = {order: ev.identify_flight(log, model="rates", order=order) for order in (None, 1, 2, 3)}
    off = {order: abs(fit.quantities["delay"].value - truth) for order, fit in fits.items()}
    assert off[3] < 0.004 < off[2] < off[1]
    assert off[None] == pytest.approx(off[3], abs=1e-3)
    assert [order for order, fit in fits.items() if "second_lag" in fit.quantities] == [None, 3]
    low, high = fits[None].quantities["delay"].interval
    assert low <= truth <= high
    with pytest.raises(errors.UsageError, match="an order of 1, 2 or 3"):
        ev.identify_flight(log, model="rates", order=4)


CART = """
name = "cart"
response = "ddt(speed)"
[channels]
speed = { unit = "m/s" }
u = { unit = "1", role = "input" }
wanted = { unit = "m/s", role = "reference" }
[terms]
drag = "-speed"
gain = { of = "u", behind = "drive" }
[actuators.drive]
lag_ms = [2, 300]
delay_ms = [0, 200]
"""


@pytest.mark.usefixtures("unchecked_shapes")  # thousands of steps of the same shapes
def test_declared_machine_has_a_response(responses, command_line, tmp_path):
    """From its input to its state, on its references; truth is K / (s + D) behind lag and delay."""
    file, log = tmp_path / "cart.toml", tmp_path / "log.csv"
    file.write_text(CART, encoding="utf-8")
    wanted = np.repeat(np.random.default_rng(4).standard_normal(120), 50)
    columns = ev.load_machine(file).simulate(
        {"gain": 5.0, "drag": 0.8, "actuator_lag": 0.1, "delay": 0.05},
        {"wanted": wanted, "u": lambda time, of: wanted[round(time / 0.02)] - 0.4 * of["speed"]},
        seconds=120.0,
        step_s=0.02,
        noise={"speed": 0.01},
        disturbance=(0.2, 1.0),
    )
    pl.DataFrame({name: np.ravel(values) for name, values in columns.items()}).write_csv(log)
    (item,) = responses(log, "--machine", file)
    assert (item["input"], item["output"], item["reference"]) == ("u", "speed", "wanted")
    chosen = item["models"][str(item["order"])]["parameters"]
    assert chosen["gain"] == pytest.approx(5.0, rel=0.03)
    assert chosen["damping"] == pytest.approx(0.8, rel=0.1)
    lag_s = chosen["delay"] + chosen["first"] + chosen.get("third", 0.0)
    assert lag_s == pytest.approx(0.15, abs=0.005)
    refused = command_line("frequency-response", log, "--machine", file, "--axis", "roll")
    assert "an axis out of" in refused.err


def test_a_crazyflie_has_a_lag_of_58_ms(recordings):
    log = ev.read_log(recordings / "arpl-crazyflie" / "log15")
    rotors = np.stack([log.channel(f"rotor_command_{k}").values for k in (1, 2, 3, 4)])
    roll = (rotors[2] + rotors[3] - rotors[0] - rotors[1]) / 4.0
    rate = log.channel("angular_rate_x").values
    part = slice(16000, 51000)
    result = ev.frequency_response(roll[part], rate[part], reference=None, rate_hz=1000.0)
    models = ev.transfer_functions(result, band_hz=(1.5, 20.0))  # below, the loop answers
    assert result.is_direct
    assert models.chosen.order == 2
    assert models.chosen.p_value > 0.01
    # a prototype of another hand, with local lines for quadratics: 58 and 4.2 ms, or 62 in all
    assert models.chosen.lag_s == pytest.approx(0.058, abs=0.005)
    assert models.chosen.lag_s + models.chosen.parameters["delay"] == pytest.approx(0.062, abs=0.003)
