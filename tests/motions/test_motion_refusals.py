"""Machines, vehicles, terms and logs that a motion refuses, each with the reason and the remedy."""

from __future__ import annotations

import re
from dataclasses import asdict, replace
from functools import cache
from pathlib import Path

import numpy as np
import test_rigid_body_verdict as bodies
from test_forces import EACH, TRUE, TWO_ROTORED, TWO_ROTORS, X
from test_machines import ROLL
from typer.testing import CliRunner

import eivor as ev
from eivor.cli.main import app
from eivor.cli.options import FlightWords
from eivor.cli.parsing import flight_options
from eivor.errors import InputError, MissingChannelError, ParameterError, UsageError
from eivor.motions.rigid_body import vehicle as vehicles
from eivor.motions.rigid_body.dynamics import side_by_side
from eivor.motions.rigid_body.motion import refuse_other_turns
from eivor.motions.vertical.motion import Vertical
from eivor.simulation.controller import Sensor
from eivor.simulation.rigid_body import Sensors
from flights.flight_logs import changed, flown
from motions.turning_logs import BODY, body_flown, combinations, turned
from motions.vertical import test_sensors as sensors
from refusal_rows import calls, rows, table


def vehicle_file(top, rotors, tmp_path):
    (tmp_path / "mine.toml").write_text(f"{top}\n[rotors]\n{rotors}", encoding="utf-8")
    vehicles.load_vehicle(tmp_path / "mine.toml")


def no_text(tmp_path):
    (tmp_path / "log.toml").write_bytes(b"\xff\xfe")
    vehicles.load_vehicle(tmp_path / "log.toml")


VEHICLE_FILES = rows("file of a vehicle", InputError, vehicle_file, *(
    (top, rotors, re.escape(text)) for top, rotors, text in (
        ("mass = { value = 1, sdt = 0.1 }", X, "unknown key 'sdt'. Did you mean 'std'"),
        ("mass = { std = 0.1 }", X, "finite number at mass.value of mine.toml; received nothing"),
        ("mass = { value = 1, std = -0.1 }", X, "std of zero or more in mine.toml"),
        ("mass = { value = 1, std = 0.5 }", X, "standard deviation of the mass of at most 0.4"),
        ('mass = "1 kg"', X, "a finite number or a table at mass"),
        ("gyro_cutoff_hz = 0", X, "gyro_cutoff_hz between 1 and 10000 Hz"),
        ("", X + "arm = 225", "0.005 to 10 m at rotors.arm of mine.toml; received 225. Check its unit"),
        ("", X + 'thrust_map = "cubic"', "an input map linear, square"),
        ("", X + "radius = 15.0", "rotor_radius"),
        ("", X + EACH, "received both"),
        ("", EACH + 'spins = ["cw", "cw", "ccw"]', "4 positions and 3 spins"),
        ("", EACH + 'spins = ["cw", "cw", "left", "ccw"]', "one of cw, ccw at rotors.spins[3]"),
        ("", EACH + "spins = [1, 1, 2, -1]", "spins of +1 or -1"),
        ("", EACH + "spins = [1, 1, 1, 1]", "of both spins"),
        ("", "positions = [[0.1, 0.1, 0.0]]\nspins = [1]", "two numbers at rotors.positions[1]"),
        ("", "positions = [[100, 100]]\nspins = [1]", "at most 10 m at rotors.positions[1]"),
)))  # fmt: skip
NO_VEHICLES = calls("no vehicle", InputError,
    (lambda tmp_path: vehicles.load_vehicle(tmp_path / "missing.toml"), "unreadable"),
    (no_text, "unreadable"),
    (lambda tmp_path: vehicles.load_vehicle(tmp_path.parent), "unreadable"),
    (lambda: vehicles.load_vehicle("crazyflie-2"), "Did you mean 'crazyflie-2x'"),
    (lambda: vehicles.load_vehicle("hexacopter"), "eivor vehicle new"),
    (lambda: vehicles.load_vehicle("x" * 5000), "eivor vehicle new"),
)  # fmt: skip
VEHICLES = rows("vehicle", (ParameterError, UsageError), lambda of, change: replace(of, **change),
    (TWO_ROTORED, {"mass": 0.0}, "mass above zero"),
    (TWO_ROTORED, {"inertia": (1.0, 2.0)}, "three numbers .* or six"),
    (TWO_ROTORED, {"inertia": (1.0, 2.0, -3.0)}, "positive definite"),
    (TWO_ROTORED, {"inertia": (1.0, 1.0, 1.0, 2.0, 0.0, 0.0)}, "positive definite"),
    (TWO_ROTORED, {"inertia": (float("nan"), 1.0, 1.0)}, "positive definite"),
    (TWO_ROTORS, {"spins": (1,)}, "a spin for each"),
    (TWO_ROTORS, {"spins": (1, 2)}, r"spins of \+1 or -1"),
    (TWO_ROTORS, {"positions": ((0.1, 0.0), (0.1, 0.0, 0.0))}, "three numbers for position"),
    (TWO_ROTORS, {"inertia": -1.0}, "inertia of zero or more"),
    (TWO_ROTORS, {"thrust_quadratic": 0.0}, "rotors with thrust"),
    (TWO_ROTORS, {"lowest_speed": 1000.0}, "below the highest_speed"),
    (vehicles.KnownNumber(1.0), {"value": float("nan")}, "finite value"),
    (vehicles.KnownNumber(1.0), {"std": -0.1}, "std of zero or more"),
    (TRUE, {"mass": vehicles.KnownNumber(-1.0)}, "mass between"),
    (TRUE, {"positions": tuple((*item, 0.0) for item in TRUE.positions)}, "Leave its height out"),
    (TRUE, {"thrust_map": ""}, "input map"),
    (vehicles.BodyDrag(), {"linear": (1.0,)}, "three numbers"),
    (vehicles.BodyDrag(), {"quadratic": (0.0, 0.0, -1.0)}, "zero or more"),
)  # fmt: skip
THREE_ROTORS = replace(TWO_ROTORS, positions=(*TWO_ROTORS.positions, (0.0, 0.1, 0.0)), spins=(1, -1, 1))


def declaration(old, new, tmp_path):
    """The command line says it as briefly as the library."""
    assert old in ROLL
    (tmp_path / "m.toml").write_text(ROLL.replace(old, new, 1))
    done = CliRunner().invoke(app, ["identify", "no.csv", "--machine", str(tmp_path / "m.toml")])
    assert done.exit_code == 1
    assert done.output.count("\n") < 12
    assert "Traceback" not in done.output
    ev.load_machine(tmp_path / "m.toml")


DECLARATIONS = rows("declaration", InputError, declaration,
    ('"drag"', '"drg"', r"L_p.of of m.toml, line 10; received 'drg' with 'drg'. Did you mean 'drag'"),
    ('L_p = "drag"', 'L_p = "phi_reference"', "a reference is an instrument .* line 10"),
    ('L_p = "drag"', 'L_p = "ddt(p)"', "a term that is not the response .*line 10"),
    ('L_p = "drag"', 'L_p = "ddt(aileron)"', "a derivative of what was measured .*line 10"),
    ('L_p = "drag"', 'L_p = "drag + aileron"', "units that fit .*line 10; .*joins 1/s and a pure"),
    ('L_p = "drag"', 'L_p = "p**9"', r"an expression .*exponent that is no number from -8 to 8"),
    ('L_p = "drag"', 'L_p = "sin(1.0"', "an expression .*not understood"),
    ('unit = "rad/s^2"', 'unit = "m/s^2"', r"makes the term one of the response, 1/s\^2 .*line 11"),
    ('behind = "servo"', 'behind = "sevro"', "one of servo .*line 11; received 'sevro'. Did you mean"),
    ('"rad/s", noise', '"deg/s", noise', "the unit 'deg/s'. Give it in rad, and convert"),
    ('"rad/s", noise', '"parsec", noise', "line 4; received the unit 'parsec'"),
    ("noise = 0.003", "noise = -1.0", "a standard deviation of zero or more .*line 4"),
    ('role = "input"', 'role = "inptu"', "one of state, .*line 5; .*Did you mean 'input'"),
    ('role = "input"', 'rol = "input"', "no keys but .*line 5; received the unknown key 'rol'"),
    ('name = "roll"', 'name = "roll"\ncolour = "red"', "no keys but .*line 2; .*the unknown key 'colour'"),
    ("[2, 300]", "[300, 2]", r"\[least, largest\] in ms.*line 13"),
    ("lag_ms = [2, 300]", "lag_ms = [2, 300]\norder = 2", "an actuator of first order .*line 14"),
    ('"-1 / L_p"', '"-1 / L_q"', "over the parameters L_p, L_da .*line 15; received .*'L_q'"),
    ('"abs(p) < 3"', '"abs(p) < < 3"', "an expression at active.when of m.toml, line 17"),
    ('headline = ["L_p"]', 'headline = ["L"]', "quantities out of .*line 19; received 'L'"),
    ('headline = ["L_p"]', "half_width = 0.9", "0 < half_width <= weak_half_width .*line 19"),
    ("[let]", "[let]\np = '2 * aileron'", "a name that no channel has .*line 8"),
    ('is = "2 * p", unit = "rad/s"', 'is = "p", unit = "m"', "the unit that follows, 1/s .*line 8"),
    ('response = "ddt(p)"', "", "an expression, such as ddt.*received none"),
    ('"input" }', '"input" }\nq = { unit = "1", role = "input" }', "a channel that .* uses .*line 6"),
    ('L_p = "drag"', 'delay = "drag"', "a name that no lag .* line 10; received 'delay'. Rename it"),
    ('L_p = "drag"', 'effective_lag = "drag"', "a name that no lag .* line 10; received 'effective_lag'"),
    ("time_constant", "actuator_lag", "a name that no lag .*derived.actuator_lag of m.toml, line 15"),
    (', behind = "servo"', "", "a term stands behind .*line 12; received 'servo'.* Add behind"),
    ("[active]", "[band]\nhz = [3, 1]\n[active]", r"\[low, high\] in Hz .*line 17"),
)  # fmt: skip
LOG = ev.recording_from_columns({"time": np.arange(9.0), "velocity_z": np.arange(9.0)})
BOAT = ev.load_machine("boat-yaw")
DECLARED = {"channels": {"velocity_z": "m", "u": ev.input()}, "response": "ddt(velocity_z)"}
VALUES = {"a": 1.0, "g": 1.0, "actuator_lag": 0.1}
STILL = dict.fromkeys(("rudder", "reference_heading"), np.zeros(100))
MACHINES = calls("machine", None,
    (lambda: ev.identify_flight(LOG, model=Path("boat-yaw")), MissingChannelError,
        "the channel 'rudder' in arrays"),
    (lambda: ev.identify_flight(LOG, model=BOAT, input="velocity_z"), UsageError, r"declares \(rudder\)"),
    (lambda: ev.load_machine("boat-jaw"), InputError, r"'boat-jaw'.*Did you mean 'boat-yaw'"),
    (lambda: ev.machine("x", **DECLARED, terms={"a": "u"}), InputError,
        "canonical channel velocity_z, m/s"),
    (lambda: BOAT.simulate(VALUES, {}), UsageError, "actuator_lag, delay; received none of delay"),
    (lambda: BOAT.simulate({**VALUES, "delay": 0.0}, {}), UsageError, "signals of rudder, reference_head"),
    (lambda: BOAT.simulate({**VALUES, "dealy": 0.0}, {}), UsageError,
        "none of delay, and 'dealy'. Did you mean 'delay'"),
    (lambda: BOAT.simulate({**VALUES, "delay": 0.0, "drag": 1.0}, {}), UsageError,
        "received 'drag'. Give these values"),
    (lambda: BOAT.simulate({**VALUES, "delay": 0.0}, {**STILL, "ruder": 0.0}), UsageError, "mean 'rudder'"),
    (lambda: BOAT.simulate({**VALUES, "delay": 0.0}, STILL), UsageError,
        "6000 samples of rudder, for 60 s in steps of 0.01 s; received 100. Give a longer series"),
    (lambda: BOAT.simulate({**VALUES, "delay": 0.0}, STILL, seconds=1.0, noise={"yaw": 0.1}), UsageError,
        "noise of a channel out of .* received 'yaw'"),
    (lambda: side_by_side([TWO_ROTORED, replace(TWO_ROTORED, rotors=THREE_ROTORS)]), UsageError,
        "equally many rotors"),
    (lambda: ev.identify_flight(LOG, model=7), UsageError,
        "Expected the name of a motion, or a motion for model; received 7"),
)  # fmt: skip


body = cache(lambda: body_flown(duration=6.0, seed=8).recording)
ahead = cache(lambda: body_flown(duration=9.0, seed=3, sensors=Sensors(*[Sensor()] * 5)))
turning = cache(lambda: turned(1, seconds=5.0))
vertical = cache(lambda: flown(seconds=30.0, seed=5)[0])


def quaternion_read_as(order, signs):
    parts = bodies.attitude(body())
    wrong = {name: s * parts[item] for name, item, s in zip(bodies.PARTS, order, signs, strict=True)}
    bodies.prepared(bodies.with_values(body(), **wrong))


QUATERNIONS = rows("quaternion", InputError, quaternion_read_as,
    ((1, 2, 3, 0), (1, 1, 1, 1), "only when it is read as x, y, z, w."),
    ((0, 1, 2, 3), (1, -1, -1, -1), "only when it is read as w, x, y, z from world to body"),
    ((1, 2, 3, 0), (-1, -1, -1, 1), "only when it is read as x, y, z, w from world to body"),
)  # fmt: skip


def rates_in_degrees():
    rates = [body().channel(f"angular_rate_{axis}") for axis in "xyz"]
    parts = [body().channel(name) for name in bodies.PARTS]
    refuse_other_turns(parts, rates, "as they are")
    refuse_other_turns(parts, [replace(rate, values=np.rad2deg(rate.values)) for rate in rates], "degrees")


def rotors_that_never_differ():
    equal = dict.fromkeys(COMMANDS, commands().mean(axis=0))
    bodies.prepared(bodies.with_values(body(), **equal))


def rotors_that_never_turn_it_about_yaw():
    spins = np.array(bodies.ROTORS.spins)[:, None]
    values = commands() - spins * (spins * commands()).mean(axis=0)
    bodies.prepared(bodies.with_values(body(), **dict(zip(COMMANDS, values, strict=True))))


def commands():
    return np.stack([body().channel(name).values for name in COMMANDS])


def long_quaternions():
    parts = dict(zip(bodies.PARTS, 2.0 * bodies.attitude(body()), strict=True))
    ev.identify_flight(bodies.with_values(body(), **parts), model=BODY)


def turning_in_degrees():
    rates = turning().family("angular_rate")
    degrees = {rate.name: replace(rate, values=np.rad2deg(rate.values) * 10.0) for rate in rates}
    ev.identify_flight(changed(turning(), **degrees), model="rates")


COMMANDS = [f"rotor_command_{number}" for number in (1, 2, 3, 4)]
LINE = ev.regression(np.arange(9.0) ** 2, np.arange(9.0))
WITHOUT, LACKING = "rigid-body", ("torque_setpoint_x", "torque_setpoint_y", "angular_rate_z")
TURNING = calls("turning", None,
    (rates_in_degrees, InputError, "57 times as fast as the attitude"),
    (rotors_that_never_differ, InputError, "never turn it about roll, pitch, yaw"),
    (rotors_that_never_turn_it_about_yaw, InputError, "never turn it about yaw"),
    (long_quaternions, InputError, "length 1"),
    (lambda: ev.identify_flight(changed(body(), COMMANDS[3]), model=BODY), InputError, "4 rotors"),
    (lambda: ev.identify_flight(body(), model=WITHOUT), UsageError, "--vehicle"),
    (lambda: ev.identify_flight(body(), model="rates", vehicle="crazyflie-2x"), UsageError,
        "asks what flies"),
    (lambda tmp_path: ev.identify_flight(body(), model=WITHOUT, vehicle=tmp_path / "no.toml"), InputError,
        "unreadable"),
    (lambda: ev.identify_flight(changed(turning(), *LACKING), model="rates"), MissingChannelError,
        "torque_setpoint_x with angular_rate_x or"),
    (turning_in_degrees, InputError, "deg/s"),
    (lambda: ev.identify_flight(turning(), model="rates", method="output_error"), UsageError,
        r"output_error with a motion that predicts its states; received it with 'rates'\."),
    (lambda: ev.identify(LINE, ev.methods.output_error()), UsageError,
        "a flight of a motion whose states output_error predicts"),
    (lambda: flight_options((Vertical(),), FlightWords(terms=["lift"])), UsageError, "received 'lift'"),
    (lambda: ev.identify_flight(body(), model="vertical", vehicle="quadrotor-x", terms=("ground-effect",)),
        UsageError, "or a vehicle file with it"),
)  # fmt: skip


def validated(prediction, lacking, nothing, tmp_path):
    parameters = ahead().truth.parameters
    values = combinations(parameters) | {"actuator_lag": parameters.lag_up, "delay": parameters.delay}
    values = {name: item for name, item in values.items() if not (nothing and name.endswith("gain"))}
    ev.validate(bodies.saved(values, tmp_path, **prediction), bodies.without(ahead().recording, *lacking))


VALIDATED = rows("validated", None, validated,
    ({"vehicle": None}, (), False, InputError, "says what flies"),
    ({"input_level": 0.6}, (), False, InputError, "commands in the same unit"),
    ({}, ("rotor_command_4",), False, InputError, "4 rotors"),
    ({}, ("angular_rate_y",), False, MissingChannelError, "angular_rate_y"),
    ({}, (), True, UsageError, "does not identify the roll gain"),
)  # fmt: skip
RECORD = asdict(replace(BODY.vehicle, thrust_map="linear", mass=vehicles.KnownNumber(0.03, 0.001)))
RECORDS = rows("record of a vehicle", InputError, vehicles.vehicle_from_record,
    ({}, "says what flies"),
    ({**RECORD, "mass": {"value": -1.0, "std": 0.0}}, "says what flies"),
    ({**RECORD, "wings": 2}, "says what flies"),
)  # fmt: skip


def measured():
    log = sensors.with_channel(vertical(), "battery_voltage", 16.0 * sensors.sagging(vertical()))
    speed = replace(log.channels["rotor_command_1"], name="rotor_speed_1", held=False)
    return changed(log, "rotor_command_1", rotor_speed_1=speed)


GROUND, VOLTAGE = {"terms": ("ground-effect",)}, {"terms": ("voltage",)}
NEAR_GROUND = {**GROUND, "rotor_radius": sensors.RADIUS}
TERMS = rows("term", None, lambda log, options: ev.identify_flight(log(), **options),
    (vertical, {"terms": ("qudratic-drag",)}, UsageError, "ground-effect, voltage; received 'qudratic-drag'"),
    (vertical, {"terms": ("voltage", "voltage")}, UsageError, "each term once; received voltage twice"),
    (vertical, GROUND, UsageError, "the radius of a rotor with the term ground-effect"),
    (vertical, {"rotor_radius": -1.0}, UsageError, "between 0 and 5 m; received -1 m"),
    (vertical, VOLTAGE, MissingChannelError, "battery_voltage for the term voltage"),
    (lambda: changed(vertical(), "position_z"), NEAR_GROUND, MissingChannelError,
        "position_z for the term ground-effect"),
    (vertical, NEAR_GROUND, InputError, "begins or ends on the ground"),
    (measured, VOLTAGE, InputError, "commands for the term voltage"),
    (turning, {"model": "rates", **VOLTAGE}, UsageError, "no optional terms: 'rates' has none"),
)  # fmt: skip


test_refused = table(
    *(VEHICLE_FILES, NO_VEHICLES, VEHICLES, DECLARATIONS, MACHINES),
    *(QUATERNIONS, TURNING, VALIDATED, RECORDS, TERMS),
    fixtures=("coarse_search",),
)
