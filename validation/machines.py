"""Study of declared machines: coverage, bias and verdicts in records under control.

`python -m validation.machines --records 100 [WORD ...]` prints a line for each row that holds one of WORDs.
The loop of the linear axis is this file's own, at 1 kHz with stiction. The wing flies in JSBSim, which must
be installed. Boat and rover simulate their own equations.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

import eivor as ev
from eivor.errors import EivorError
from eivor.logs.channel_map import parse_expression

#: Parameters of the axis: mass, friction, and what the force is off by.
AXIS = {"M": 95.1, "Fv": 203.5, "Fc": 20.4, "offset": -3.16}
BOAT = {"a": 1.0 / 3.0, "g": 0.2, "actuator_lag": 0.35, "delay": 0.2}
ROVER = {"drive_gain": 4.0, "rolling_drag": 0.8, "dry_friction": 0.3, "actuator_lag": 0.15, "delay": 0.05}

#: Machine, parameters and columns of each record: of some seeds, and of references where they are planned.
Records = Iterator[tuple[Any, dict[str, float], dict[str, np.ndarray]]]


def held(rng: np.random.Generator, count: int, step_s: float, size: float, lasting: Any) -> np.ndarray:
    """Levels to both sides that last from one time to another [s]; the first is zero."""
    levels, begin = np.zeros(count), int(lasting[0] / step_s)
    while begin < count:
        end = begin + int(rng.uniform(*lasting) / step_s)
        levels[begin:end] = size * rng.uniform(-1.0, 1.0)
        begin = end
    return levels


def on_steps(planned: Any, name: str, made: np.ndarray, step_s: float) -> np.ndarray:
    """A planned reference on steps of a simulation; the one that was made where none is planned."""
    if planned is None or name not in planned.references:
        return made
    at = np.minimum(step_s * np.arange(len(made)), planned.time_s[-1])
    return np.asarray(CubicSpline(planned.time_s, planned.references[name])(at))


def lagged(values: np.ndarray, step_s: float, *lags_s: float) -> np.ndarray:
    """Values behind first-order lags."""
    for lag_s in lags_s:
        values = parse_expression(f"lag(x, {lag_s})", "here").evaluate({"x": values}, step_s)
    return values


def axis_records(
    every: int, encoder_m: float, torque_n: float, cogging_n: float, seeds: Sequence[int], planned: Any = None
) -> Records:
    """A linear axis of 25 s at 1 kHz, logged every few samples; cogging comes again every 24 mm."""
    step_s, count, records = 0.001, 25_000, len(seeds)
    streams = [np.random.default_rng(seed) for seed in seeds]
    if planned is None:
        levels = [held(rng, count, step_s, 0.15, (0.2, 0.9)) for rng in streams]
        asked = np.stack([lagged(row, step_s, 0.1, 0.1, 0.1) for row in levels])
    else:
        asked = on_steps(planned, "reference_position", np.zeros(count), step_s)[None]
    speeds = np.gradient(asked, step_s, axis=1)
    forward = AXIS["M"] * np.gradient(speeds, step_s, axis=1) + AXIS["Fv"] * speeds
    forward += AXIS["Fc"] * np.tanh(speeds / 0.01) + AXIS["offset"]
    pushes = np.stack([rng.standard_normal(count) for rng in streams])
    decay, slower = np.exp(-step_s / 0.02), np.exp(-0.25 * step_s * AXIS["Fv"] / AXIS["M"])
    speed, push, filtered = np.zeros((3, records))
    position = last = asked[:, 0]
    seen, forces = np.empty((2, count, records))
    stiff, damping = AXIS["M"] * 60.0**2, 1.6 * AXIS["M"] * 60.0
    for k in range(count):
        measured = np.round(position / encoder_m) * encoder_m
        filtered += 0.5 * ((measured - last) / step_s - filtered)
        last = measured
        force = forward[:, k] + stiff * (asked[:, k] - measured) + damping * (speeds[:, k] - filtered)
        seen[k], forces[k] = measured, force
        push = decay * push + np.sqrt(1.0 - decay**2) * torque_n * pushes[:, k]
        left = force - AXIS["offset"] + push + cogging_n * np.sin(2.0 * np.pi * position / 0.024)
        for _ in range(4):
            free = slower * speed + (1.0 - slower) * left / AXIS["Fv"]
            # dry friction takes what speed it can
            taken = (1.0 - slower) * AXIS["Fc"] / AXIS["Fv"]
            following = np.sign(free) * np.maximum(np.abs(free) - taken, 0.0)
            position = position + 0.125 * step_s * (speed + following)
            speed = following
    time = step_s * np.arange(count)
    machine = ev.load_machine("linear-axis")
    names = ("time", "position", "force", "reference_position")
    for columns in zip([time] * records, seen.T, forces.T, asked, strict=True):
        yield machine, AXIS, {name: item[::every] for name, item in zip(names, columns, strict=True)}


#: A link on a motor in MuJoCo: armature, friction, gravity of a mass off the axis.
JOINT = {"J": 0.35, "Fv": 0.8, "Fc": 1.2, "Gs": 4.0, "Gc": 1.0, "offset": 0.4}
JOINT_XML = """<mujoco><option timestep="0.00025" integrator="implicitfast" gravity="0 0 -9.80665"/>
<worldbody>
<body><joint name="j" axis="0 -1 0" damping="{Fv}" frictionloss="{Fc}" armature="{armature}"
solreffriction="0.001 1"/><inertial mass="1" pos="{x} 0 {z}" diaginertia="1e-3 1e-3 1e-3"/></body>
</worldbody><actuator><motor joint="j"/></actuator></mujoco>"""


def joint_records(seeds: Sequence[int], planned: Any = None) -> Records:
    """A revolute joint of 25 s at 1 kHz under position control, by MuJoCo, with an encoder of 10 urad."""
    import mujoco

    step_s, count, machine = 0.001, 25_000, ev.load_machine("revolute-joint")
    # gravity turns it by Gs sin(angle) + Gc cos(angle) away from the top
    x, z = JOINT["Gc"] / 9.80665, -JOINT["Gs"] / 9.80665
    armature = JOINT["J"] - x**2 - z**2 - 1e-3
    model = mujoco.MjModel.from_xml_string(JOINT_XML.format(**JOINT, armature=armature, x=x, z=z))
    for seed in seeds:
        rng, state = np.random.default_rng(seed), mujoco.MjData(model)
        asked = lagged(held(rng, count, step_s, 1.2, (0.3, 1.2)), step_s, 0.1, 0.1, 0.1)
        asked = on_steps(planned, "reference_angle", asked, step_s)
        rate, pushes, decay = np.gradient(asked, step_s), rng.standard_normal(count), np.exp(-step_s / 0.02)
        push = filtered = last = 0.0
        columns = np.empty((count, 2))
        for k in range(count):
            seen = round(state.qpos[0] / 1e-5) * 1e-5
            filtered += 0.5 * ((seen - last) / step_s - filtered)
            last = seen
            torque = 350.0 * (asked[k] - seen) + 14.0 * (rate[k] - filtered)
            push = decay * push + np.sqrt(1.0 - decay**2) * 0.3 * pushes[k]
            columns[k], state.ctrl[0] = (seen, torque), torque - JOINT["offset"] + push
            mujoco.mj_step(model, state, 4)
        made = {"time": step_s * np.arange(count), "angle": columns[:, 0], "torque": columns[:, 1]}
        yield machine, JOINT, made | {"reference_angle": asked}


def simulated(
    name: str, truth: Any, loop: Any, settings: Any, seeds: Sequence[int], planned: Any = None
) -> Records:
    """Records of a shipped machine in a loop of its own for each record."""
    machine, step_s = ev.load_machine(name), settings["step_s"]
    for seed in seeds:
        signals = loop(np.random.default_rng(seed), round(settings["seconds"] / step_s), step_s, planned)
        yield machine, truth, machine.simulate(truth, signals, seed=seed, **settings)


def boat_loop(rng: np.random.Generator, count: int, step_s: float, planned: Any) -> dict[str, Any]:
    """Headings that are steered to."""
    asked, heading = held(rng, count, step_s, 0.8, (10.0, 25.0)), 0.0
    asked = on_steps(planned, "reference_heading", asked, step_s)

    def rudder(time: float, measured: Any) -> Any:
        nonlocal heading
        heading = heading + step_s * measured["yaw_rate"]
        return np.clip(asked[round(time / step_s)] - heading - 2.0 * measured["yaw_rate"], -0.5, 0.5)

    return {"rudder": rudder, "reference_heading": asked}


def rover_loop(rng: np.random.Generator, count: int, step_s: float, planned: Any) -> dict[str, Any]:
    """Speeds that are driven at."""
    asked = lagged(held(rng, count, step_s, 2.0, (1.5, 5.0)), step_s, 0.2)
    asked = on_steps(planned, "reference_forward_speed", asked, step_s)

    def drive(time: float, measured: Any) -> Any:
        error = asked[round(time / step_s)] - measured["forward_speed"]
        return np.clip(0.2 * asked[round(time / step_s)] + 0.6 * error, -1.0, 1.0)

    return {"drive_command": drive, "reference_forward_speed": asked}


#: A light aeroplane at 95 kt, by JSBSim: what is logged, with the noise of each.
WING_NOISE = {f"angular_rate_{axis}": 0.003 for axis in "xyz"} | {"sideslip": 0.004, "angle_of_attack": 0.004}
WING_SERVO_S, WING_STEP_S = 0.05, 0.01
#: Terms of each axis by their channel, and the references that move it under control.
WING_TERMS = {
    "roll": {"L_p": "angular_rate_x", "L_beta": "sideslip", "L_r": "angular_rate_z"}
    | {"L_da": "aileron", "L_dr": "rudder"},
    "pitch": {"M_q": "angular_rate_y", "M_alpha": "angle_of_attack", "M_de": "elevator"},
    "yaw": {"N_r": "angular_rate_z", "N_beta": "sideslip", "N_p": "angular_rate_x"}
    | {"N_dr": "rudder", "N_da": "aileron"},
}
SURFACES = ("aileron", "elevator", "rudder")
WING_REFERENCES = {"aileron": "roll_setpoint", "elevator": "pitch_setpoint", "rudder": "rudder_setpoint"}


def reference_of(surface: str, closed: bool) -> str:
    """The reference that moves a surface; in open loop its own."""
    return WING_REFERENCES[surface] if closed else f"{surface}_setpoint"


def wing(axis: str, closed: bool) -> Any:
    """The declared equation of roll, pitch or yaw."""
    terms = WING_TERMS[axis]
    names, channels = list(terms), list(terms.values())
    moved = [of for of in channels if of in SURFACES]
    references = [reference_of(of, closed) for of in moved]
    units = {"roll_setpoint": "rad", "pitch_setpoint": "rad"}
    return ev.machine(
        f"wing-{axis}",
        response=f"ddt({channels[0]})",
        channels={of: "rad/s" if "rate" in of else "rad" for of in WING_NOISE if of in channels}
        | {of: ev.input("1") for of in moved}
        | {of: ev.reference(units.get(of, "1")) for of in references},
        terms={name: ev.behind(of, "servo") if of in SURFACES else of for name, of in terms.items()},
        actuators={"servo": ev.actuator(lag_s=(0.002, 0.3), delay_s=(0.0, 0.04))},
        headline=(names[0], names[3] if axis != "pitch" else names[2]),
    )


def wing_flight(
    axis: str, turbulence: float, closed: bool, seed: int, planned: Any
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """60 s under control of the attitude, or of surfaces alone, for one axis: pitch alone, or the others.

    Columns of a log; and states through the air, servos and derivatives of the rates by axis, without noise.
    """
    import jsbsim

    rng, count = np.random.default_rng(seed), round(60.0 / WING_STEP_S)
    craft = jsbsim.FGFDMExec(None)
    craft.set_debug_level(0)
    craft.load_model("c172p")
    craft.set_dt(0.5 * WING_STEP_S)
    settings = {"ic/h-sl-ft": 4000.0, "ic/vc-kts": 95.0, "ic/gamma-deg": 0.0, "propulsion/set-running": -1}
    for name, value in settings.items():
        craft[name] = value
    craft.run_ic()
    # Adams and Bashforth's second order: the default leaves rates half a step behind their derivatives
    for which in ("rotational", "translational"):
        craft[f"simulation/integrator/rate/{which}"] = 3
    craft.do_trim(1)
    if turbulence:
        craft["atmosphere/turb-type"], craft["atmosphere/turbulence/milspec/severity"] = 3, 3
        craft["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = turbulence
        craft["simulation/randomseed"] = seed + 1
    time = WING_STEP_S * np.arange(count)

    def asked(size: float, highest_hz: float) -> np.ndarray:
        waves = [np.sin(2 * np.pi * (f * time + rng.random())) for f in np.geomspace(0.1, highest_hz, 12)]
        return size * np.sum(waves, axis=0) / np.sqrt(6.0)

    sizes = (0.0, 0.04, 0.0) if axis == "pitch" else (0.12, 0.0, 0.12)
    names = [reference_of(of, closed) for of in SURFACES]
    made = [asked(size, high) for size, high in zip(sizes, (1.2, 1.2, 1.5), strict=True)]
    setpoints = [on_steps(planned, name, of, WING_STEP_S) for name, of in zip(names, made, strict=True)]
    trims, trimmed_pitch = [craft[f"fcs/{name}-cmd-norm"] for name in SURFACES], craft["attitude/theta-rad"]
    states = [*(f"velocities/{item}-rad_sec" for item in "pqr"), "aero/beta-rad", "aero/alpha-rad"]
    seen, exact, commands = np.empty((count, 5)), np.empty((count, 11)), np.empty((count, 3))
    errors = rng.standard_normal((count, 5)) * [*WING_NOISE.values()]
    servo, decay = np.zeros(3), np.exp(-0.5 * WING_STEP_S / WING_SERVO_S)
    for k in range(count):
        true = np.array([craft[name] for name in states])
        seen[k] = true + errors[k]
        bank, pitch = craft["attitude/phi-rad"], craft["attitude/theta-rad"] - trimmed_pitch
        aileron = 1.2 * (setpoints[0][k] - bank) - 0.15 * seen[k, 0]
        elevator = 0.4 * seen[k, 1] - 2.0 * (setpoints[1][k] - pitch)
        driven = [aileron, elevator, setpoints[2][k]] if closed else [item[k] for item in setpoints]
        commands[k] = np.clip(driven, -0.6, 0.6)
        derivatives = [craft[f"accelerations/{item}dot-rad_sec2"] for item in "pqr"]
        through_air = [craft[f"velocities/{item}-aero-rad_sec"] for item in "pqr"]
        exact[k] = [*through_air, *true[3:], *servo, *derivatives]
        for _ in range(2):
            servo = decay * servo + (1.0 - decay) * commands[k]
            for name, trim, value in zip(SURFACES, trims, servo, strict=True):
                craft[f"fcs/{name}-cmd-norm"] = trim + value
            craft.run()
    columns = dict(zip(WING_NOISE, seen.T, strict=True)) | dict(zip(SURFACES, commands.T, strict=True))
    columns |= dict(zip(names, setpoints, strict=True))
    return {"time": time} | columns, dict(zip((*WING_NOISE, *SURFACES, *WING_TERMS), exact.T, strict=True))


def wing_truth(axis: str, exact: dict[str, np.ndarray]) -> dict[str, float]:
    """Least squares of what moved through the air, without noise: the plant is not linear."""
    columns = [exact[of] for of in WING_TERMS[axis].values()]
    moved = np.column_stack([*columns, np.ones_like(exact[axis])])
    theta = np.linalg.lstsq(moved[200:], exact[axis][200:])[0]
    return dict(zip(WING_TERMS[axis], theta.tolist(), strict=False)) | {"effective_lag": WING_SERVO_S}


def wing_records(
    axis: str, turbulence: float, closed: bool, seeds: Sequence[int], planned: Any = None
) -> Records:
    """Flights of the wing."""
    machine = wing(axis, closed)
    for seed in seeds:
        columns, exact = wing_flight(axis, turbulence, closed, seed, planned)
        logged = {name: columns[name] for name in ("time", *machine.record["channels"])}
        yield machine, wing_truth(axis, exact), logged


BOATS = (simulated, "boat-yaw", BOAT, boat_loop)
ROVERS = (simulated, "rover", ROVER, rover_loop)
AT_SEA = {"seconds": 300.0, "step_s": 0.1, "noise": {"yaw_rate": 0.002}}
ON_GROUND = {"seconds": 60.0, "step_s": 0.02, "noise": {"forward_speed": 0.01, "forward_acceleration": 0.1}}
#: Maker of each row's records, and what it is given.
ROWS: dict[str, tuple[Any, ...]] = {
    "axis, 1 kHz, 10 um, 10 N": (axis_records, 1, 1e-5, 10.0, 0.0),
    "axis, 1 kHz, 10 um, 1 N": (axis_records, 1, 1e-5, 1.0, 0.0),
    "axis, 1 kHz, 1 um, 10 N": (axis_records, 1, 1e-6, 10.0, 0.0),
    "axis, 1 kHz, 1 um, 1 N": (axis_records, 1, 1e-6, 1.0, 0.0),
    "axis, 200 Hz of it, 10 um, 10 N": (axis_records, 5, 1e-5, 10.0, 0.0),
    "axis, 200 Hz of it, 10 um, 1 N": (axis_records, 5, 1e-5, 1.0, 0.0),
    "axis, 1 kHz, 100 um, 10 N": (axis_records, 1, 1e-4, 10.0, 0.0),
    "axis, 1 kHz, 10 um, 1 N, cogging of 1 N": (axis_records, 1, 1e-5, 1.0, 1.0),
    "axis, 1 kHz, 100 um, 1 N": (axis_records, 1, 1e-4, 1.0, 0.0),
    "joint, 1 kHz, 10 urad, 0.3 N m": (joint_records,),
    "boat, calm": (*BOATS, AT_SEA | {"disturbance": (0.0005, 1.0)}),
    "boat, waves": (*BOATS, AT_SEA | {"disturbance": (0.03, 1.0)}),
    "boat, heavy waves": (*BOATS, AT_SEA | {"disturbance": (0.08, 1.0)}),
    "rover, smooth floor": (*ROVERS, ON_GROUND | {"disturbance": (0.05, 0.3)}),
    "rover, rough ground": (*ROVERS, ON_GROUND | {"disturbance": (0.6, 0.3)}),
    **{
        f"wing, {axis}, {air}{'' if closed else ', open loop'}": (wing_records, axis, gusts, closed)
        for closed in (True, False)
        for axis in WING_TERMS
        for air, gusts in (("calm", 0.0), ("turbulence", 20.0))
    },
}


def records_of(name: str, seeds: Sequence[int], planned: Any = None) -> Records:
    maker, *given = ROWS[name]
    return maker(*given, seeds, planned)


def row(name: str, records: int) -> dict[str, Any]:
    """Coverage, median bias and half-width of each parameter, statuses, and identified ones far off."""
    statuses, values = Counter[str](), defaultdict[str, list[tuple[float, ...]]](list)
    far = judged = 0
    for model, truth, columns in records_of(name, range(records)):
        try:
            fit = ev.identify_flight(ev.recording_from_columns(columns, name=name), model=model)
        except EivorError as error:
            statuses[type(error).__name__] += 1
            continue
        statuses[fit.verdict.status.value] += 1
        for parameter, value in truth.items():
            quantity = fit.quantities[parameter]
            low, high = quantity.interval
            half, off = 0.5 * (high - low), abs(quantity.value - value)
            numbers = (float(low <= value <= high), quantity.value / value - 1.0, half / abs(value))
            values[parameter].append(numbers)
            if quantity.verdict.value == "identified":
                judged, far = judged + 1, far + int(off > 2.0 * half)
    shown = {
        parameter: [round(float(np.mean([item[0] for item in items])), 2)]
        + [round(float(np.median([item[place] for item in items])), 4) for place in (1, 2)]
        for parameter, items in values.items()
    }
    return {"row": name, **statuses, "far": f"{far} of {judged}", "coverage, bias, half-width": shown}


def plans(name: str, records: int) -> dict[str, Any]:
    """Half-widths that planned records reached over those that were expected: median, tenth and ninetieth."""
    shares = defaultdict[str, list[float]](list)
    for seed in range(records):
        ((model, _, columns),) = records_of(name, [seed])
        first = ev.identify_flight(ev.recording_from_columns(columns, name=name), model=model)
        seconds = round(float(columns["time"][-1]))
        planned = ev.plan(first, seconds=seconds)
        ((_, _, columns),) = records_of(name, [1000 + seed], planned)
        fit = ev.identify_flight(ev.recording_from_columns(columns, name=name), model=model)
        for parameter, item in planned.predicted.items():
            now, before = (result.quantities[parameter].half_width for result in (fit, first))
            shares[parameter].append(now / item.half_width)
            shares[f"{parameter}, first"].append(now / before)
    spread = {k: np.quantile(v, (0.5, 0.1, 0.9)).round(2).tolist() for k, v in shares.items()}
    return {"plan": name, "reached over expected": spread}


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rows", nargs="*", help="rows that hold one of these words; default: all")
    parser.add_argument("--records", type=int, default=100)
    parser.add_argument("--plan", action="store_true", help="identify, plan, and identify what was planned")
    given = parser.parse_args()
    for name in ROWS:
        if not given.rows or any(word in name for word in given.rows):
            made = plans if given.plan else row
            print(json.dumps(made(name, given.records)), flush=True)


if __name__ == "__main__":
    main()
