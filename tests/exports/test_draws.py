"""Joint draws: their laws and correlations, and files of simulators that are made of them."""

from __future__ import annotations

import json
import runpy

import numpy as np
import pytest
from scipy import stats

import eivor as ev
from eivor.errors import EstimationError, MissingReaderError, NotIdentifiedError, ParameterError, UsageError
from exports import documents
from exports.test_simulators import WORSE
from refusal_rows import calls, rows, table, without

LAW_DRAWS = 100_000


@pytest.mark.parametrize("degrees", [5.0, 8.0, None])
def test_marginal_laws_and_correlations(degrees, tmp_path):
    reported = documents.document(degrees)
    for name in documents.JOINT:  # nothing beyond the covariance
        reported["parameters"][name]["interval"] = [documents.NUMBERS[name][0]] * 2
    draws = ev.load_fit(documents.written(reported, tmp_path)).sample(LAW_DRAWS, seed=3)
    assert list(draws) == list(documents.JOINT)
    edge = stats.norm.ppf(0.975) if degrees is None else stats.t.ppf(0.975, degrees)
    scaled = [
        (draws[name] - documents.NUMBERS[name][0]) / documents.NUMBERS[name][1] for name in documents.JOINT
    ]
    for item in scaled:
        assert np.median(item) == pytest.approx(0.0, abs=0.002)
        assert np.quantile(item, [0.025, 0.975]) == pytest.approx([-edge, edge], abs=0.005)
    np.testing.assert_allclose(np.corrcoef(scaled), documents.CORRELATIONS, atol=0.01)


def test_what_a_printed_interval_has_beyond_the_covariance_is_drawn(tmp_path):
    reported = documents.document(degrees=None)
    value, std_error = documents.NUMBERS["viscous_friction"]
    printed = [value - 5.0 * std_error, value + 3.0 * std_error]
    reported["parameters"]["viscous_friction"]["interval"] = printed
    draws = ev.load_fit(documents.written(reported, tmp_path)).sample(LAW_DRAWS, seed=3)
    ends = (np.quantile(draws["viscous_friction"], [0.025, 0.975]) - value) / std_error
    np.testing.assert_allclose(ends, [-5.0, 3.0], atol=0.08)


def test_a_document_of_several_delays_is_read_where_it_fits_best(tmp_path):
    """Documents of schema /1 of before the delay was continuous had a candidate for each delay."""
    reported = documents.document()
    (best,) = reported["covariance"]["candidates"]
    other = {**best, "best": False, "excess": 2.0, "values": [0.3, 23.9, 0.04]}
    reported["covariance"]["candidates"] = [other, best]
    fit = ev.load_fit(documents.written(reported, tmp_path))
    np.testing.assert_array_equal(fit.joint.values, best["values"])
    assert list(fit.sample(10)) == list(documents.JOINT)


def test_a_delay_is_drawn_within_what_lag_and_delay_are_together(tmp_path):
    reported = documents.document()
    covariance = reported["covariance"]
    (best,) = covariance.pop("candidates")
    spread = np.diag([0.01, 0.1, 0.02, 0.02]) ** 2
    spread[2, 3] = spread[3, 2] = -0.99 * 0.02**2
    parts = [{**best["parts"][0], "matrix": spread.tolist()}]
    covariance |= {"names": [*documents.JOINT, "delay"], "values": [0.3, 23.9, 0.05, 0.0], "parts": parts}
    draws = ev.load_fit(documents.written(reported, tmp_path)).sample(20_000, seed=1)
    assert (draws["delay"] >= 0.0).all()
    assert np.mean(draws["delay"] == 0.0) == pytest.approx(0.5, abs=0.02)
    assert np.std(draws["delay"] + draws["actuator_lag"]) == pytest.approx(0.0028, rel=0.2)


COUNT = 2000

#: Relative standard deviations of what is drawn.
GAIN_SPREAD, MASS_SPREAD = 8e-9 / documents.GAIN * (8.0 / 6.0) ** 0.5, 0.01


def drawn(to, folder, record=None):
    fit = ev.load_fit(documents.written(record or documents.of_speeds(), folder))
    return fit.export(
        to, vehicle=documents.vehicle_file(folder), priors=documents.PRIORS, draws=COUNT, seed=3
    )


def python_file(to, folder, **others):
    path = folder / "draws.py"
    path.write_text(drawn(to, folder, **others), encoding="utf-8")
    return runpy.run_path(str(path))


def spread(column):
    return float(np.std(column) / np.mean(column))


@pytest.mark.thorough  # of the extra `simulators`
def test_fields_of_mujoco_fit_its_model(tmp_path):
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    fields = {name: np.array(load) for name, load in json.loads(drawn("mujoco", tmp_path))["fields"].items()}
    model = mujoco.MjModel.from_xml_path(documents.saved("mujoco", tmp_path))
    assert spread(fields["actuator_gainprm"] / fields["body_mass"]) == pytest.approx(GAIN_SPREAD, rel=0.1)
    row = int(np.argmax(fields["body_mass"]))
    model.body_mass[1], model.body_inertia[1] = fields["body_mass"][row], fields["body_inertia"][row]
    model.body_ipos[1] = fields["body_ipos"][row]
    model.actuator_gainprm[:4, 0] = fields["actuator_gainprm"][row]
    model.actuator_dynprm[:4, 0] = fields["actuator_dynprm"][row]
    model.actuator_gear[:4, 5] = [-fields["actuator_gear"][row], fields["actuator_gear"][row]] * 2
    model.actuator_biasprm[4:, 2] = fields["actuator_biasprm"][row]
    model.site_pos[:] = fields["site_pos"][row]
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data)
    lift = 4 * fields["actuator_gainprm"][row] / fields["body_mass"][row]
    assert data.qvel[2] / model.opt.timestep == pytest.approx(lift - documents.GRAVITY, abs=1e-3)


def test_ranges_of_isaac_lab_hold_95_percent_of_the_draws(tmp_path):
    file = python_file("isaaclab", tmp_path)
    draws, thruster = file["draws"], file["thruster"]
    hover = np.sqrt(np.array(draws["mass"]) * 9.81 / (4 * np.array(draws["thrust_const"])))
    assert np.median(hover) * 2.0 * np.pi == pytest.approx(documents.HOVER, rel=1e-4)
    assert spread(hover) < 0.002
    ends = file["events"]["randomize_rigid_body_mass"]["mass_distribution_params"]
    for (low, high), name in (
        (ends, "mass"),
        (thruster["tau_inc_range"], "time_constant"),
        (thruster["thrust_const_range"], "thrust_const"),
    ):
        inside = np.mean((np.array(draws[name]) >= low) & (np.array(draws[name]) <= high))
        assert inside == pytest.approx(0.95, abs=0.002)
    assert np.median(draws["linear_damping"]) == pytest.approx(0.3, rel=0.01)
    assert thruster["use_discrete_approximation"] is False


def test_draws_of_a_rigid_body_keep_what_its_flight_tells(tmp_path):
    """Inertia over mass and arm is a ratio of gains, told to a tenth of a percent."""
    rigid_body = documents.of_rigid_body(documents.KNOWN_VEHICLE)
    fit = ev.load_fit(documents.written(rigid_body, tmp_path))
    fields = {
        name: np.array(load) for name, load in json.loads(fit.export("mujoco", draws=COUNT))["fields"].items()
    }
    ratio = fields["body_inertia"][:, 0] / (fields["body_mass"] * fields["site_pos"][:, 1, 0])
    assert spread(ratio) < 0.004
    assert spread(fields["body_inertia"][:, 0]) > 0.012
    assert np.all(fields["body_inertia"][:, 2] <= fields["body_inertia"][:, :2].sum(axis=1))
    assert np.median(fields["actuator_gear"]) == pytest.approx(0.034, rel=0.01)


@pytest.mark.parametrize("to", ["rotorpy", "isaaclab", "mujoco"])
def test_no_name_breaks_out_of_draws(to, tmp_path):
    reported = documents.refused(documents.of_speeds(), "viscous_friction", WORSE)
    reported["provenance"]["logs"][0]["name"] = WORSE
    text = drawn(to, tmp_path, reported)
    assert text.isascii()
    assert "drag_z is not written: viscous_friction is refused. a" in text
    if to == "mujoco":
        assert not np.any(json.loads(text)["fields"]["actuator_biasprm"])
    else:
        assert "linear_damping" not in python_file(to, tmp_path, record=reported).get("draws", {})


def written(record, to, options, tmp_path):
    """A text of a vehicle is put into a file."""
    (tmp_path / "mine.toml").write_text(options.get("vehicle", ""), encoding="utf-8")
    options = options | ({"vehicle": tmp_path / "mine.toml"} if "vehicle" in options else {})
    ev.load_fit(documents.written(record, tmp_path)).export(to, **options)


def sampled(record, n, seed, tmp_path):
    ev.load_fit(documents.written(record, tmp_path)).sample(n, seed)


def to_control(tmp_path):
    ev.load_fit(documents.written(SETPOINT, tmp_path)).to_statespace().to_control()


def with_model(record, **model):
    return {**record, "model": {**record["model"], **model}}


SETPOINT, SPEEDS = documents.document(), documents.of_speeds()
KEPT = with_model(SETPOINT, autopilot_curve={"in_force": {"THR_MDL_FAC": 0.65}})
KEPT["logs"] = [{"name": "flight.parquet", "format": "parquet"}]
KNOWN = {"vehicle": documents.VEHICLE.format(numbering="crazyflie")}
SHORT = {"vehicle": '[rotors]\nlayout = "quad-x"\nnumbering = "px4"\n'}
PLUS = {"vehicle": documents.PLUS, "priors": documents.PRIORS}
TURNING = (with_model(item, name="angular_rates") for item in (SETPOINT, SPEEDS))
OF_PRIORS = " ".join(f"--prior {name}=VALUE:STD" for name in documents.PRIORS)
EXPORTS = rows("export", None, written,
    (documents.document(hover_input=(1788.0, 2.0)), "px4", {}, UsageError,
        r"a share of the largest.*--input actuator_output"),
    (next(TURNING), "px4", {}, UsageError, "the vertical motion for PX4"),
    (SETPOINT, "ardupilot", {}, UsageError, "each autopilot counts shares"),
    (KEPT, "ardupilot", {}, UsageError, "a vehicle with THR_MDL_FAC"),
    (SETPOINT, "px5", {}, UsageError, "Did you mean 'px4'"),
    (SETPOINT, "px4", {"mass": (1.5, 0.1)}, UsageError, "no mass for px4"),
    (SETPOINT, "px4", {"priors": {"hover_input": (0.4, 0.1)}}, UsageError, "priors that px4 uses"),
    (SETPOINT, "statespace", {"priors": {"drag": (0.2, 0.01)}}, UsageError, "priors that a state space uses"),
    (SETPOINT, "statespace", {"priors": {"delay": (0.2, -0.01)}}, UsageError, "not below zero"),
    (SETPOINT, "statespace", {"mass": (0.0, 0.01)}, UsageError, "a mass above zero"),
    (SPEEDS, "gazebo", {"draws": 9}, UsageError, "draws out of rotorpy, mujoco, isaaclab"),
    (next(TURNING), "mujoco", {}, UsageError, "the vertical motion or the rigid body"),
    (SPEEDS, "rotorpy", {}, NotIdentifiedError, r"--mass 1.53:0.02.* and .*--vehicle FILE.toml"),
    (SPEEDS, "rotorpy", KNOWN, NotIdentifiedError, OF_PRIORS),
    (SPEEDS, "rotorpy", SHORT | {"mass": (0.03, 0.0)}, NotIdentifiedError, "the arm's length"),
    (SPEEDS, "px4", SHORT, UsageError, "no vehicle for px4"),
    (SPEEDS, "mujoco", KNOWN | {"priors": {"thrust": (1.0, 0.0)}}, UsageError, "priors that MuJoCo uses"),
    (SPEEDS, "mujoco", {"accept": "wek"}, UsageError, "weak"),
    (SPEEDS, "urdf", PLUS, UsageError, "one in each quarter"),
)  # fmt: skip
PRIORS = rows("prior", None,
    lambda name, prior, tmp_path: documents.exported("mujoco", tmp_path, **{name: prior}),
    *((name, (-1.0, 0.0), UsageError, f"a {name} above zero")
        for name in ("inertia_xx", "largest_command", "speed_scale")),
    ("inertia_zz", (3.5e-5, 0.0), ParameterError, "none of which is larger"),
    ("largest_command", (1700.0, 0.0), UsageError, "above that at hover, 1787.86; received 1700"),
)  # fmt: skip
SAMPLES = rows("draws", None, sampled,
    (documents.document(degrees=2.0), 10, 0, EstimationError, "degrees of freedom"),
    *((SETPOINT, *given, UsageError, "10,000,000 draws") for given in ((0, 1), (10**8, 1), (5, -1))),
    ({**SETPOINT, "covariance": None}, 10, 0, EstimationError, "with an estimate"),
)  # fmt: skip
PACKAGE = calls("package", MissingReaderError, (without("control", to_control), "pip install control"))
test_refused = table(EXPORTS, PRIORS, SAMPLES, PACKAGE)
