import numpy as np
import polars as pl
import pytest

from eivor.errors import ChannelMapError
from eivor.logs import load_channel_map, read_log, shipped_maps
from eivor.logs.channel_map import parse_channel_map
from eivor.logs.expressions import parse_expression

HEAD = 'name = "m"\n[time]\ncolumn = "t"\nunit = "ms"\n'


@pytest.fixture
def table(tmp_path):
    k = np.arange(100)
    pl.DataFrame(
        {
            "t": 10.0 * k,
            "v down": np.cos(0.1 * k) * 100.0,
            "roll": np.full(100, 60.0),
            "pitch": np.zeros(100),
            "pwm": np.where(k == 7, 70000, np.where(k == 8, 65535, 30000 + k)),
            "volt": np.full(100, 4.0),
        }
    ).write_csv(tmp_path / "t.csv")
    return tmp_path


def read(folder, text):
    (folder / "m.toml").write_text(text)
    return read_log(folder / "t.csv", channel_map=folder / "m.toml")


def test_every_key(table):
    r = read(
        table,
        'description = "d"\nframe = "ned"\ninput_map = "square"\n'
        + HEAD
        + """
[columns.pwm]
valid = [0, 65535]
saturates = "upper"
[channels.velocity_z]
column = "v down"
unit = "cm/s"
sign = -1
scale = 2
[channels.cos_tilt]
roll_pitch = ["roll", "pitch"]
unit = "deg"
[channels.rotor_command_1]
expression = "pwm * volt / 275247"
held = false
[channels.input]
expression = 'sqrt(abs("v down")) + 1e-3'
[channels.landed]
column = "absent"
optional = true
""",
    )
    k = np.arange(100)
    assert (r.frame.name, r.input_map) == ("NED", "square")
    np.testing.assert_allclose(r.channels["velocity_z"].values, -2 * np.cos(0.1 * k))
    np.testing.assert_allclose(r.channels["velocity_z"].time_s, 0.01 * k)
    np.testing.assert_allclose(r.channels["cos_tilt"].values, 0.5)
    rotor = r.channels["rotor_command_1"]
    np.testing.assert_allclose(rotor.values[9], 30009 * 4 / 275247)
    assert np.isnan(rotor.values[7])
    assert (rotor.quality.overflowed, rotor.quality.saturated, rotor.held) == (1, 1, False)
    np.testing.assert_allclose(r.channels["input"].values[0], 10.001)
    assert {"overflow", "saturation"} <= {f.name for f in r.findings}
    assert "landed" not in r.channels
    with pytest.raises(Exception, match="absent"):
        r.channel("landed")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name = ", "TOML in m.toml"),
        ("[" * 5000, "TOML in m.toml"),
        (
            '[time]\ncolumn = "t"\n[channels.input]\ncolumn = "pwm"\n',
            "a text at m.toml, key name; received nothing",
        ),
        (HEAD, "key channels; received nothing"),
        (HEAD + "[channels]\n", "at least one channel"),
        (HEAD + '[channels.speed]\ncolumn = "pwm"\n', "canonical channel name .*key channels.speed"),
        (HEAD + "[channels.input]\n", "exactly one of column.*received none"),
        (HEAD + '[channels.input]\ncolumn = "pwm"\nexpression = "pwm"\n', "column and expression"),
        (HEAD + "[channels.input]\ncolumn = 3\n", "a text at m.toml, key channels.input.column; received 3"),
        (HEAD + '[channels.input]\ncolumn = ""\n', "must not be empty"),
        (HEAD + '[channels.input]\ncolumn = "pwm"\ncolour = 1\n', "unknown key 'colour'"),
        (HEAD + '[channels.input]\ncolumn = "pwm"\nsign = 2\n', "one of \\(-1.0, 1.0\\)"),
        (HEAD + '[channels.input]\ncolumn = "pwm"\nscale = nan\n', "finite number other than 0"),
        (HEAD + '[channels.input]\ncolumn = "pwm"\nscale = true\n', "finite number"),
        (HEAD + '[channels.input]\ncolumn = "pwm"\nheld = "yes"\n', "true or false"),
        (
            HEAD + '[channels.velocity_z]\ncolumn = "v down"\nunit = "furlong"\n',
            "one of .*'m/s'.*received 'furlong'",
        ),
        (HEAD + '[channels.velocity_z]\ncolumn = "v down"\nunit = "m"\n', "a unit of the kind 'm/s'"),
        (HEAD + '[channels.landed]\ncolumn = "pwm"\nunit = "V"\n', "no unit"),
        (HEAD + '[channels.velocity_z]\nroll_pitch = ["roll", "pitch"]\n', "for cos_tilt only"),
        (HEAD + '[channels.cos_tilt]\nquaternion = ["a", "b"]\n', "a list of 4 column names"),
        (HEAD + '[channels.cos_tilt]\nroll_pitch = ["roll", "pitch"]\nunit = "m"\n', "rad or deg"),
        (HEAD + '[channels.input]\ncolumn = "pwn"\n', "a column 'pwn'.*Did you mean 'pwm'"),
        (HEAD + '[channels.input]\nexpression = "pwn * 2"\n', "key channels.input.*Did you mean 'pwm'"),
        (HEAD + '[columns.pwn]\nvalid=[0,1]\n[channels.input]\ncolumn = "pwm"\n', "key columns.pwn"),
        (HEAD + '[columns.pwm]\nvalid=[1,0]\n[channels.input]\ncolumn = "pwm"\n', "low < high"),
        (HEAD + '[columns]\npwm=3\n[channels.input]\ncolumn = "pwm"\n', "a table at m.toml, key columns.pwm"),
        (HEAD + '[channels.input]\ncolumn = "pwm"\n[channels.input]\ncolumn = "volt"\n', "TOML in m.toml"),
        (
            HEAD.replace("ms", "h") + '[channels.input]\ncolumn = "pwm"\n',
            "'s', 'ms', 'us', 'ns'.*received 'h'",
        ),
        (HEAD.replace('"t"', '"tt"') + '[channels.input]\ncolumn = "pwm"\n', "key time.column"),
        (
            HEAD + '[channels.input]\ncolumn = "t"\n',
            "time column that no channel is made of.*received 't' as both",
        ),
        ('frame = "up"\n' + HEAD + '[channels.input]\ncolumn = "pwm"\n', "'z_up', 'ned'"),
        (HEAD + '[channels.input]\ncolumn = "absent"\noptional = true\n', "at least one channel of m.toml"),
    ],
)
def test_wrong_maps(table, text, words):
    with pytest.raises(ChannelMapError, match=f"(?s){words}"):
        read(table, text)


def test_maps_that_are_not_there(table):
    with pytest.raises(ChannelMapError, match=r"nanobench, rotorpy.*is no file"):
        read_log(table / "t.csv", channel_map="nanobensch")
    with pytest.raises(ChannelMapError, match="is no file"):
        read_log(table / "t.csv", channel_map=table)
    (table / "big.toml").write_bytes(b"#" * (2 << 20))
    with pytest.raises(ChannelMapError, match="larger than"):
        read_log(table / "t.csv", channel_map=table / "big.toml")
    (table / "latin.toml").write_bytes(b"\xff")
    with pytest.raises(ChannelMapError, match="unreadable"):
        read_log(table / "t.csv", channel_map=table / "latin.toml")
    with pytest.raises(ChannelMapError, match=r"a column 't'|a column"):
        read_log(table / "t.csv", channel_map="rotorpy")


def test_shipped_maps_are_sound():
    assert shipped_maps() == ("nanobench", "rotorpy")
    for name in shipped_maps():
        assert load_channel_map(name).name == name
    assert len(parse_channel_map(HEAD + '[channels.input]\ncolumn = "a"\n', "x").required_columns) == 2


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a + b * 2", 8.0),
        ("-(a - b)", 1.0),
        ("- - a", 2.0),
        ("a - -b", 5.0),
        ("a / b", 2.0 / 3.0),
        ("1/2*a", 1.0),
        ("pow(a, 3) + sqrt(b+1)", 10.0),
        ("greatest(a, b) - least(a, b)", 1.0),
        ("ABS(a - 4.5e0)", 2.5),
        ("atan2(a, a)", np.pi / 4),
        ("exp(ln(a)) + .5", 2.5),
        ('"select" + a', 6.0),
        ("select + a", 6.0),
        ("sin + a", 7.0),
        ("cos(a*a + 2) - sin(b)", np.cos(6) - np.sin(3)),
        ("asin(a/4)+acos(a/4)+atan(0*a)+tan(0*a)", np.pi / 2),
        ("1e300 * a / 1e300", 2.0),
        ("a * 2.5e-7 / 2.5e-7", 2.0),
        ("a * 123456789012345678 / 123456789012345678", 2.0),
    ],
)
def test_expressions(text, value):
    columns = {"a": np.full(3, 2.0), "b": np.full(3, 3.0), "select": np.full(3, 4.0), "sin": np.full(3, 5.0)}
    np.testing.assert_allclose(parse_expression(text, "here").evaluate(columns), value)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "1 + 2",
        "sum(a)",
        "mean(a)",
        "count(*)",
        "a FROM b",
        "a; drop table b",
        "read_csv('x')",
        "'text'",
        "a -- b\n c",
        "/* a */ a",
        "a b",
        "a +",
        "(a",
        "a)",
        "abs a",
        "abs(a, b)",
        "pow(a)",
        "CAST(a AS int)",
        "CASE WHEN a THEN b END",
        "a > b",
        "a = b",
        "a % b",
        "*",
        "a.b",
        '"a\x00"',
        '"unclosed',
        "1e999 * a",
        "1a",
        "(" * 40 + "a" + ")" * 40,
        "a + " * 400 + "a",
        "row_number() over (order by a)",
        "a OVER b",
    ],
)
def test_refused_expressions(text):
    with pytest.raises(ChannelMapError, match=r"arithmetic over columns.*at here"):
        parse_expression(text, "here")


def test_rotorpys_own_table(tmp_path):
    """The map of RotorPy against a flight of it: the specific force turned to world up is z'' + g."""
    pytest.importorskip("rotorpy")
    from rotorpy.controllers.quadrotor_control import SE3Control
    from rotorpy.environments import Environment
    from rotorpy.trajectories.circular_traj import ThreeDCircularTraj
    from rotorpy.utils.postprocessing import unpack_sim_data
    from rotorpy.vehicles.crazyflie_params import quad_params
    from rotorpy.vehicles.multirotor import Multirotor

    np.random.seed(3)  # noqa: NPY002 - RotorPy's sensors draw from the global generator
    world = Environment(Multirotor(quad_params), SE3Control(quad_params), ThreeDCircularTraj(), sim_rate=100)
    result = world.run(t_final=2, terminate=False, plot=False, animate_bool=False, verbose=False)
    frame = unpack_sim_data(result)
    frame.to_csv(tmp_path / "flight.csv")
    r = read_log(tmp_path / "flight.csv")
    assert r.input_map == "square"
    assert any(f.name == "channel_map" and "'rotorpy'" in f.message for f in r.findings)
    w, x, y, z = (r.channels[f"attitude_{part}"].values for part in "wxyz")
    force = [r.channels[f"specific_force_body_{axis}"].values for axis in "xyz"]
    up = 2 * (x * z - w * y) * force[0] + 2 * (y * z + w * x) * force[1] + (1 - 2 * (x**2 + y**2)) * force[2]
    acceleration = np.gradient(frame["zdot"].to_numpy(), frame["time"].to_numpy())
    np.testing.assert_allclose(up[50:-1] - 9.81, acceleration[50:-1], atol=0.1)
    np.testing.assert_array_equal(r.channels["rotor_command_3"].values, frame["r3des"].to_numpy())


@pytest.mark.parametrize(
    ("unit", "scale", "words"),
    [("rad", 30.0, "are they in degrees"), ("deg", 0.4, "are they in radians"), ("deg", 30.0, "")],
)
def test_angles_in_another_unit_are_told(tmp_path, unit, scale, words):
    t = np.arange(50) * 0.01
    frame = {"t": t, "roll": scale * np.sin(9 * t), "pitch": 0 * t}
    pl.DataFrame(frame).write_csv(tmp_path / "t.csv")
    (tmp_path / "m.toml").write_text(
        HEAD.replace("ms", "s") + f'[channels.cos_tilt]\nroll_pitch = ["roll", "pitch"]\nunit = "{unit}"\n'
    )
    r = read_log(tmp_path / "t.csv", channel_map=tmp_path / "m.toml")
    doubts = [f.message for f in r.findings if f.name == "mixed_units"]
    assert (len(doubts) == 1 and words in doubts[0]) if words else doubts == []


def test_tilt_from_a_quaternion_of_any_norm(tmp_path):
    angle = np.linspace(0.0, 1.0, 20)
    frame = {
        "time": np.arange(20) * 0.1,
        "a": 2 * np.cos(angle / 2),
        "b": 2 * np.sin(angle / 2),
        "c": 0 * angle,
    }
    pl.DataFrame(frame).write_csv(tmp_path / "t.csv")
    text = 'name = "m"\n[time]\ncolumn = "time"\n[channels.cos_tilt]\nquaternion = ["a", "b", "c", "c"]\n'
    (tmp_path / "m.toml").write_text(text)
    r = read_log(tmp_path / "t.csv", channel_map=tmp_path / "m.toml")
    np.testing.assert_allclose(r.channels["cos_tilt"].values, np.cos(angle))
    assert not r.channels["cos_tilt"].held
