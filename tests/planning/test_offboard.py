"""The program that flies a plan: its limits, and flights with the real MAVSDK and an autopilot over UDP.

A flight is a process of its own. Messages that were in a socket when the mode message came may still arrive.
"""

from __future__ import annotations

import ast
import asyncio
import math
import os
import runpy
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from planning.fake_autopilot import Autopilot, Received
from planning.test_plan import planned, program_text

#: After a mode message: setpoints that are still in a socket [s].
IN_FLIGHT_S = 0.2
#: Setpoints of a short plan at 20 Hz, and its duration [s].
SHORT = 25
SHORT_S = 0.05 * SHORT
#: Waits of the program that are made shorter.
QUICK = {"LISTEN_S = 5.0": "LISTEN_S = 0.5", "SETTLE_S = 1.0": "SETTLE_S = 0.3"}
QUICK |= {
    "WAIT_S = 10.0": "WAIT_S = 5.0",
    '"battery": 6.0': '"battery": 1.0',
    '"in_air": 3.0': '"in_air": 1.2',
}
Event = Callable[[Autopilot, Received | None], None]

SIGNALS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGTSTP")
linux = pytest.mark.skipif(sys.platform != "linux", reason="signals and /proc of Linux")


# Limits, without a vehicle.


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """What the program defines."""
    path = tmp_path_factory.mktemp("program") / "written.py"
    path.write_text(program_text("multisine"), encoding="utf-8")
    return SimpleNamespace(**runpy.run_path(str(path)))


def telemetry(program, **changes):
    """Fresh telemetry of a hover at 5.5 m, with changes; `old` names streams that are old."""
    value = {
        "mode": program.FlightMode.HOLD,
        "height": 5.5,
        "climb": 0.0,
        "roll": 0.0,
        "yaw": 30.0,
        "east": 0.0,
    }
    value |= {"down": -25.5, "batteries": {0: 90.0}, "in_air": True, "position_ok": True, "global_ok": True}
    value |= {"old": ()} | changes
    seen, named = program.Seen(), SimpleNamespace
    place = named(north_m=1.0, east_m=value["east"], down_m=value["down"])
    velocity = named(north_m_s=0.0, east_m_s=0.0, down_m_s=-value["climb"])
    health = {"is_local_position_ok": value["position_ok"], "is_global_position_ok": value["global_ok"]}
    for name, content in {
        "mode": value["mode"],
        "position": named(relative_altitude_m=value["height"]),
        "odometry": named(position=place, velocity=velocity),
        "attitude": named(roll_deg=value["roll"], pitch_deg=0.0, yaw_deg=value["yaw"]),
        "in_air": value["in_air"],
        "health": named(**health),
    }.items():
        seen.take(name, content)
    for number, percent in value["batteries"].items():
        seen.take("battery", SimpleNamespace(id=number, remaining_percent=percent))
    for name in value["old"]:
        if name.startswith("battery "):
            key = int(name.split()[1])
            seen.batteries[key] = (seen.batteries[key][0], time.monotonic() - 7.0)
        else:
            seen.since[name] = time.monotonic() - 7.0
    return seen


NAN = math.nan


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"batteries": {0: 40.0}}, "battery at 40 %"),
        ({"batteries": {1: 40.0, 0: 90.0}}, "battery at 40 %"),
        ({"batteries": {0: NAN, 1: 90.0}}, "battery at nan %"),
        ({"height": 3.2}, "height 3.2 m: hover at 5.5 m"),
        ({"height": NAN}, "height nan m"),
        ({"in_air": False}, "take off first"),
        ({"position_ok": False}, "no local position"),
        ({"down": NAN}, "no local position"),
        ({"yaw": NAN}, "no local position"),
        ({"climb": 0.9}, "hover still"),
        ({"climb": NAN}, "hover still"),
        ({"roll": 30.0}, "tilted"),
        ({"roll": NAN}, "tilted"),
        ({"old": ["attitude"]}, "no telemetry of attitude"),
        ({"old": ["battery 0"], "batteries": {0: 90.0, 1: 90.0}}, "no telemetry of battery 0"),
    ],
)
def test_checks_before_the_flight(program, changes, words):
    assert program.objections(telemetry(program)) == []
    assert words in "; ".join(program.objections(telemetry(program, **changes)))


@pytest.mark.parametrize(
    ("changes", "code", "words"),
    [
        ({"height": 8.3}, 10, "height 8.30 m outside 3.0 to 8.0 m"),
        ({"height": 2.8}, 10, "height 2.80 m outside 3.0 to 8.0 m"),
        ({"height": NAN}, 10, "height nan m outside"),
        ({"climb": -2.4}, 11, "sink rate 2.40 m/s"),
        ({"climb": NAN}, 11, "sink rate nan m/s"),
        ({"roll": 25.0}, 12, "tilt beyond 20.0 degrees"),
        ({"roll": -170.0}, 12, "tilt beyond 20.0 degrees"),
        ({"roll": NAN}, 12, "tilt beyond 20.0 degrees"),
        ({"east": 4.0}, 13, "sideways"),
        ({"batteries": {0: 25.0}}, 14, "battery at 25 %"),
        ({"batteries": {1: 25.0, 0: 90.0}}, 14, "battery at 25 %"),
        ({"batteries": {0: NAN, 1: 90.0}}, 14, "battery at nan %"),
        ({"in_air": False}, 15, "no longer in the air"),
        ({"position_ok": False}, 16, "local position is lost"),
        ({"global_ok": False}, 16, "local position is lost"),
        ({"east": NAN}, 16, "local position is lost"),
        ({"down": NAN}, 16, "local position is lost"),
        ({"old": ["health"]}, 17, "no telemetry of health"),
        ({"old": ["in_air"]}, 17, "no telemetry of in_air"),
        ({"old": ["battery 1"], "batteries": {1: 90.0, 0: 90.0}}, 17, "no telemetry of battery 1"),
    ],
)
def test_limits_on_the_way(program, changes, code, words):
    start = SimpleNamespace(north_m=1.0, east_m=0.0, down_m=-25.5)
    assert program.breach(telemetry(program), start, True) is None
    result, sentence = program.breach(telemetry(program, **changes), start, True)
    assert (result, words in sentence) == (code, True), sentence


def test_an_error_of_mavsdk_ends_the_flight_in_a_sentence(program):
    async def fails():
        raise RuntimeError("the channel is closed")

    flight = program.Flight("")
    flight.seen, flight.enter, flight.server = telemetry(program), fails, SimpleNamespace(end=list)
    code, sentence = asyncio.run(flight.fly())
    assert (code, sentence.partition(";")[0]) == (22, "A call to mavsdk failed: the channel is closed")


def test_only_numbers_enter_the_program():
    blank = files("eivor.planning").joinpath("fly_plan.txt").read_text(encoding="utf-8")
    before, after = blank.partition("LOWEST_M")[0], blank.partition("{% endfor %}\n)\n")[2]
    for kind in ("multisine", "steps"):
        text = program_text(kind)
        assert text.startswith(before)
        assert text.endswith(after)
        for statement in ast.parse(text[len(before) : len(text) - len(after)]).body:
            assert isinstance(statement, ast.Assign)
            value = np.array(ast.literal_eval(statement.value), dtype=float)
            assert np.isfinite(value).all()


def test_another_mavsdk_is_refused_with_the_installation_line(tmp_path):
    package = tmp_path / "mavsdk"
    package.mkdir()
    (package / "__init__.py").write_text("class LegacyModuleError(Exception): ...\nraise LegacyModuleError\n")
    (tmp_path / "fly.py").write_text(program_text("multisine"), encoding="utf-8")
    run = subprocess.run([sys.executable, tmp_path / "fly.py"], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (3, "")
    assert "pip install 'mavsdk>=3,<4'" in run.stdout


# Flights.


def short_program():
    """The program with the first setpoints of a plan, and shorter waits."""
    lines = program_text("multisine").splitlines(keepends=True)
    first = lines.index("SETPOINTS = (\n") + 1
    text = "".join(lines[: first + SHORT] + lines[lines.index(")\n", first) :])
    for old, new in QUICK.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    return text


@dataclass
class Case:
    """A flight, and what is expected of it."""

    name: str  # What happens
    code: int  # Exit code
    commands: tuple[str, ...]  # Modes that are commanded
    happens: Event = lambda _autopilot, _received: None  # To the autopilot
    words: str = ""  # Part of what is printed
    taken: bool = False  # The last mode is not the program's: after its message nothing arrives
    vehicle: dict[str, Any] = field(default_factory=dict)  # Attributes of the autopilot
    replace: tuple[str, str] = ("", "")  # A text of the program and its replacement
    options: tuple[str, ...] = ("--start",)
    check: Callable[[Autopilot], object] = lambda _autopilot: None
    closed: bool = False  # The terminal is closed: nothing can be printed


taken = partial(Case, code=20, taken=True)


class FlyingAutopilot(Autopilot):
    """An autopilot that knows the process of the program."""

    process: subprocess.Popen[str]
    children: dict[str, int] = {}  # noqa: RUF012, processes that must be gone at the end


def once(condition, action):
    """Do something at the first tick or message of a condition."""
    done: list[bool] = []

    def happens(autopilot, received):
        if not done and condition(autopilot, received):
            done.append(True)
            action(autopilot)

    return happens


def at(seconds, action):
    """Do something that long after offboard mode was entered."""
    return once(lambda autopilot, _: autopilot.flying_s() >= seconds, action)


def becomes(**changes):
    """Other attributes."""
    return lambda autopilot: vars(autopilot).update(changes)


def mode(name, *, quiet=False, **changes):
    """Another mode, and other attributes."""

    def action(autopilot):
        vars(autopilot).update(changes)
        autopilot.change(name, quiet=quiet)

    return action


def children(process):
    """Process ids of children, by the ends of their names."""
    results = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rsplit(")", 1)
        except OSError:
            continue
        if int(fields[1].split()[1]) == process:
            results[fields[0].split("(", 1)[1]] = int(folder.name)
    return results


def lives(process):
    """Whether a process runs; one that only waits for its parent does not."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def flown(case, folder):
    """Fly a case in a process; returns what is not as expected."""
    path = folder / f"{case.name.replace(' ', '_')}.py"
    text = short_program()
    assert not case.replace[0] or text.count(case.replace[0]) == 1
    path.write_text(text.replace(*case.replace) if case.replace[0] else text, encoding="utf-8")
    with FlyingAutopilot(case.happens, **case.vehicle) as autopilot:
        address = f"udpin://127.0.0.1:{autopilot.port}"
        command = [sys.executable, str(path), "--connect", address, *case.options]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        if case.closed:
            command = ["sh", "-c", 'exec "$@" >&-', "sh", *command]
        autopilot.process = subprocess.Popen(command, **pipes, text=True, start_new_session=True)
        try:
            out, error = autopilot.process.communicate(timeout=60.0)
        finally:
            autopilot.process.kill()
        ended = time.monotonic()
        time.sleep(0.8)
        return [f"{case.name}: {wrong} [{out!r}]" for wrong in unexpected(case, autopilot, out, error, ended)]


def unexpected(case, autopilot, out, error, ended):
    """What is not as expected."""
    results = []
    if autopilot.process.returncode != case.code:
        results.append(f"exit code {autopilot.process.returncode}, not {case.code}")
    if error:
        results.append(error)
    if case.words.lower() not in out.lower():
        results.append(f"not printed: {case.words}")
    commands = tuple(name for _, name in autopilot.commanded)
    if commands != case.commands:
        results.append(f"commands {commands}")
    if case.taken:
        late = [item for item in autopilot.setpoints() if item.time > autopilot.told[-1][0] + IN_FLIGHT_S]
        results += [f"{len(late)} setpoints after the mode message"] if late else []
        late_commands = [name for when, name in autopilot.commanded if when > autopilot.changed[-1][0]]
        results += [f"{late_commands} commanded after the takeover"] if late_commands else []
    stray = {item.message.get_type() for item in autopilot.received if item.time > ended + IN_FLIGHT_S}
    if stray:
        results.append(f"{stray} after the end: the server lives")
    results += [f"{name} lives" for name, number in autopilot.children.items() if lives(number)]
    if wrong := case.check(autopilot):
        results.append(str(wrong))
    return results


def all_flown(cases, folder):
    """Fly some cases, several at a time."""
    with ThreadPoolExecutor(8) as pool:
        wrong = [text for texts in pool.map(lambda case: flown(case, folder), cases) for text in texts]
    assert not wrong, "\n".join(wrong)


def follows_the_plan(autopilot):
    """The setpoints of the plan arrived, and a neutral one at last."""
    heights = [-20.0 - item.message.z for item in autopilot.setpoints()]
    plan = planned("multisine").height[::5][:SHORT]
    missing = [height for height in plan if min(abs(np.array(heights) - height)) > 2e-3]
    last = autopilot.setpoints()[-1].message
    neutral = (last.vx, last.vy, last.vz, last.afx, last.afy, last.afz) == (0.0,) * 6
    wrong = f"heights {missing} are missing, or the last is not neutral: {last}"
    return "" if not missing and neutral else wrong


def neutral(autopilot):
    """The last setpoint before hold is at rest."""
    last = autopilot.setpoints()[-1].message
    return "" if (last.vz, last.afz) == (0.0, 0.0) else f"not neutral: {last}"


def send(name):
    """A signal to the program and its group, as from a terminal."""

    def action(autopilot):
        autopilot.children = children(autopilot.process.pid)
        os.killpg(autopilot.process.pid, getattr(signal, name))

    return action


def end_child(name):
    """End a child of the program."""

    def action(autopilot):
        autopilot.children = children(autopilot.process.pid)
        process = next(value for key, value in autopilot.children.items() if key.startswith(name))
        os.kill(process, signal.SIGKILL)

    return action


def silenced(after):
    """No setpoints later than that after 0.5 s of flight, and the autopilot's failsafe has acted."""

    def check(autopilot):
        if not autopilot.changed:
            return "offboard mode was not entered"
        late = [item for item in autopilot.setpoints() if item.time > autopilot.changed[0][0] + 0.5 + after]
        current = [name for _, name in autopilot.changed] == ["OFFBOARD", "HOLD"]
        return "" if current and not late else f"{len(late)} late setpoints, modes {autopilot.changed}"

    return check


def setpoint(_, received):
    """A setpoint has come."""
    return received is not None and received.is_setpoint()


def hold_refused(autopilot, received):
    """Hold has been commanded and answered."""
    return received is None and autopilot.commanded[-1:] != [] and autopilot.commanded[-1][1] == "HOLD"


FLOWN, STARTED = ("OFFBOARD", "HOLD"), ("OFFBOARD",)
#: A quick flight: the mode comes four times a second.
SOON = {"heartbeats_hz": 4.0}


@pytest.mark.thorough
@linux
def test_a_flight_a_takeover_and_a_killed_program(tmp_path):
    all_flown(
        [
            Case("flown", 0, FLOWN, words="Flown to the end; hold", vehicle=SOON, check=follows_the_plan),
            Case(
                "taken", 20, STARTED, at(0.5, mode("ALTCTL")), "mode is ALTCTL now", taken=True, vehicle=SOON
            ),
            Case("killed", -9, STARTED, at(0.5, send("SIGKILL")), vehicle=SOON, check=silenced(0.2)),
        ],
        tmp_path,
    )


@pytest.mark.thorough
def test_a_takeover_is_never_overridden(tmp_path):
    def starting(autopilot, received):
        return received is not None and received.wanted_mode() == "OFFBOARD"

    words, holds = "Taken over: the mode is ", {"refuses": {"HOLD"}}
    cases = [
        taken(f"{name} {when}", commands=commands, happens=happens, words=words + printed, vehicle=vehicle)
        for name, printed, harm in (
            ("MANUAL", "MANUAL", {"climb": 4.0}),
            ("ALTCTL", "ALTCTL", {"roll": 0.5}),
            ("RTL", "RETURN_TO_LAUNCH", {"batteries": {0: 25}, "gust": 3.5}),
            ("LAND", "LAND", {"in_air": False, "gust": -3.0}),
        )
        for when, commands, happens, vehicle in (
            ("before", (), once(setpoint, mode(name)), {}),
            ("during", STARTED, at(0.5, mode(name)), {}),
            ("and a limit", STARTED, at(0.4, mode(name, quiet=True, **harm)), {}),
            ("at the end", STARTED, at(SHORT_S + 0.15, mode(name, quiet=True)), {}),
            ("between retries", FLOWN, once(hold_refused, mode(name)), holds),
        )
    ]
    offboard = once(starting, mode("MANUAL", refuses={"OFFBOARD"}))
    unanswered = {"happens": once(hold_refused, mode("MANUAL")), "vehicle": {"ignores": {"HOLD"}}}
    cases += [
        taken("MANUAL at the start", commands=STARTED, happens=offboard),
        taken("hold", commands=STARTED, happens=at(0.5, mode("HOLD")), words=words + "HOLD"),
        taken("POSCTL before", commands=(), happens=once(setpoint, mode("POSCTL")), words=words + "POSCTL"),
        taken("MANUAL while hold is not answered", commands=FLOWN, words=words, **unanswered),
    ]
    all_flown(cases, tmp_path)


@linux
@pytest.mark.thorough
def test_signals_and_ends_of_processes(tmp_path):
    def both(autopilot):
        autopilot.change("MANUAL", quiet=True)
        autopilot.process.send_signal(signal.SIGTERM)

    def twice(autopilot):
        autopilot.process.send_signal(signal.SIGINT)
        autopilot.process.send_signal(signal.SIGTERM)

    def checking(autopilot, _):
        return len(autopilot.received) > 3

    stopped, awake = at(0.5, send("SIGSTOP")), at(3.0, send("SIGCONT"))

    def stands_still(autopilot, received):
        stopped(autopilot, received)
        awake(autopilot, received)

    no_kernel = ('if sys.platform != "linux":\n        return None', "return None")
    stops = {name: (128 + getattr(signal, name), f"Stopped by {name}; hold was accepted") for name in SIGNALS}
    cases = [
        Case(name, code, FLOWN, at(0.5, send(name)), words, check=neutral)
        for name, (code, words) in stops.items()
    ]
    cases += [
        Case("signal in the checks", 143, (), once(checking, send("SIGTERM")), "Stopped by SIGTERM"),
        taken("signal and takeover", commands=STARTED, happens=at(0.4, both), words="Taken over"),
        Case("two signals", 130, FLOWN, at(0.4, twice), "Stopped by SIGINT; hold"),
        Case("killed", -9, STARTED, at(0.5, send("SIGKILL")), check=silenced(0.2)),
        Case("killed alone", -9, STARTED, at(0.5, send("SIGKILL")), replace=no_kernel, check=silenced(0.4)),
        Case("server killed", 22, STARTED, at(0.5, end_child("mavsdk_server")), check=silenced(0.2)),
        Case("watchdog killed", 22, STARTED, at(0.5, end_child("python")), check=silenced(0.2)),
        Case("stands still", 22, STARTED, stands_still, "ended", check=silenced(1.4)),
        Case("terminal closed", 129, FLOWN, at(0.5, send("SIGHUP")), closed=True, check=neutral),
    ]
    all_flown(cases, tmp_path)


@pytest.mark.thorough
def test_links_and_telemetry(tmp_path):
    two, lost = {"batteries": {0: 90, 1: 85}}, becomes(silent={"battery 1"})
    cases = [
        Case("link lost", 21, STARTED, at(0.3, becomes(silent={"all"})), "Link lost", check=silenced(2.5)),
        Case("no attitude", 17, FLOWN, at(0.1, becomes(silent={"attitude"})), "of attitude"),
        Case("no place", 17, FLOWN, at(0.1, becomes(silent={"local_position"})), "of odometry"),
        Case("tilt unknown", 12, FLOWN, at(0.3, becomes(roll=NAN)), "tilt", check=neutral),
        Case("place unknown", 16, FLOWN, at(0.3, becomes(east=NAN)), "position is lost", check=neutral),
        Case("place lost", 16, FLOWN, at(0.1, becomes(position_ok=False)), "position is lost"),
        Case("too high", 10, FLOWN, at(0.3, becomes(gust=3.0)), "outside 3.0 to 8.0 m; hold", check=neutral),
        Case("low battery", 14, FLOWN, at(0.1, becomes(batteries={0: 90, 1: 25})), "25 %", vehicle=two),
        Case("no number", 14, FLOWN, at(0.1, becomes(batteries={0: 90, 1: -1})), "battery at", vehicle=two),
        Case("lost battery", 17, FLOWN, once(setpoint, lost), "y 1 lately", vehicle=two | SOON),
        Case("low from the start", 1, (), words="battery at 40 %", vehicle={"batteries": {1: 40, 0: 90}}),
        Case("manual from the start", 1, (), words="change to hold", vehicle={"mode": "MANUAL"}),
        Case("no battery", 1, (), words="no telemetry of battery", vehicle={"silent": {"battery", "status"}}),
        Case("only checks", 0, (), words="add --start", options=()),
        Case("no vehicle", 4, (), words="No vehicle answers", vehicle={"silent": {"all"}}),
        Case("no address", 4, (), words="nonsense", options=("--connect", "nonsense")),
    ]
    for case in cases:
        if case.name in ("no attitude", "no place", "place lost"):
            case.vehicle = case.vehicle | SOON
    all_flown(cases, tmp_path)


@pytest.mark.thorough
def test_commands_that_fail(tmp_path):
    three, refused = ("OFFBOARD", "HOLD", "HOLD", "HOLD"), {"refuses": {"HOLD"}} | SOON
    accepted = once(hold_refused, becomes(refuses=set()))
    cases = [
        Case("offboard refused", 5, STARTED, words="was refused", vehicle={"refuses": {"OFFBOARD"}}),
        Case("hold refused", 23, three, words="TAKE OVER", vehicle=refused),
        Case("hold refused once", 0, (*FLOWN, "HOLD"), accepted, "hold was accepted", vehicle=refused),
    ]
    all_flown(cases, tmp_path)
