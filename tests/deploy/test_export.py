"""An exported policy gives PyTorch's actions, and its contract agrees with the robot's file."""

import dataclasses
import json
import re
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
from compositions import walking
from hydra import compose, initialize_config_module
from running import command
from tensordict import TensorDict
from thinned import parametrize
from torchrl.envs.utils import ExplorationType, set_exploration_type

import gctd3
from gctd3 import KinematicGraph, Robot
from gctd3.config.build import build
from gctd3.deploy import Policy
from gctd3.deploy.contract import parse_contract, read_contract, robot_hash
from gctd3.deploy.export import Deterministic, to_onnx, traced
from gctd3.deploy.robot_contract import Rehearsed, _feature, describe, sensed, warnings_of
from gctd3.errors import ConfigError, ContractError, ReadingError, RobotError
from gctd3.files import checksum
from gctd3.nn import Network
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.features import Reading
from gctd3.tasks.reflection import Reflection
from gctd3.tasks.walk import WalkSettings
from gctd3.training.saved_configuration import save_config

pytest.importorskip("onnxscript")
onnx = pytest.importorskip("onnx")
onnxruntime = pytest.importorskip("onnxruntime")


@pytest.fixture(scope="module")
def states():
    """Make 10,000 states: half of them visited by the policy from its start on, half of them random."""
    env = gctd3.make_env("biped", num_envs=50, seed=3)
    walked = env.rollout(100, gctd3.load_policy(), break_when_any_done=False)["nodes"].reshape(-1, 8, 10)
    return torch.cat([walked, 3 * torch.randn(5000, 8, 10)])


def difference(file, policy, states):
    session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
    with torch.no_grad():
        action = policy(TensorDict({"nodes": states}, [len(states)]))["action"].numpy()
    return np.abs(session.run(["action"], {"nodes": states.numpy()})[0] - action).max()


def test_actions_are_pytorchs(exported, states):
    assert len(states) == 10_000
    assert difference(exported, gctd3.load_policy(), states) <= 1e-5
    # The comparison can fail: another policy's actions differ.
    assert difference(exported, gctd3.make_actor(KinematicGraph.from_mjcf("biped")), states) > 0.1


def test_the_onnx_file_says_what_it_is(exported):
    model = onnx.load(exported)
    onnx.checker.check_model(model, full_check=True)
    contract = read_contract(exported.with_suffix(".json"))
    assert [(i.domain, i.version) for i in model.opset_import] == [("", contract.network.opset)]
    (nodes,), (action,) = model.graph.input, model.graph.output
    shape = [d.dim_param or d.dim_value for d in nodes.type.tensor_type.shape.dim]
    assert (nodes.name, shape) == ("nodes", ["batch", 8, 10])
    assert (action.name, action.type.tensor_type.shape.dim[1].dim_value) == ("action", 6)
    assert {p.key: p.value for p in model.metadata_props}["gctd3.robot"] == "biped"
    # The file holds no paths of this machine.
    content = exported.read_bytes()
    assert str(Path(gctd3.__file__).parent).encode() not in content and b"site-packages" not in content
    assert [path.name for path in exported.parent.iterdir() if path.stem == "policy"] in (
        ["policy.onnx", "policy.json"],
        ["policy.json", "policy.onnx"],
    )


def test_the_contract_says_what_the_robots_file_says(exported, robot):
    said = json.loads(exported.with_suffix(".json").read_text(encoding="utf-8"))
    assert (said["format"], said["control_rate_hz"], said["history_frames"]) == (4, 50.0, 5)
    assert (said["history_order"], said["history_warm_up"]) == ("oldest first", "repeat the first frame")
    # Section 2.3 of the paper.
    order = ["body", "hip_right", "hip_left", "knee_right", "knee_left", "ankle_right", "ankle_left", "ground"]
    assert [node["name"] for node in said["nodes"]] == order
    readings = [[feature["reading"] for feature in node["features"]] for node in said["nodes"]]
    assert readings[0] == ["height_m", "velocity_m_s"]
    assert readings[3] == ["angle_knee_right_rad", "velocity_knee_right_rad_s"]
    assert readings[7] == ["down_foot_right", "down_foot_left"]
    # Table 2 and the servos of models/biped/README.md; the action is right hip to left ankle.
    servos = {servo["actuator"]: servo for servo in said["servos"]}
    assert list(servos) == ["hip_right", "knee_right", "ankle_right", "hip_left", "knee_left", "ankle_left"]
    knee = servos["knee_left"]
    assert (knee["low_rad"], knee["high_rad"], knee["start_rad"]) == (-1.3962, 0.0012, 0.0)
    gains = ("kp_nm_per_rad", "kd_nm_s_per_rad", "effort_nm", "time_constant_s")
    assert [[servos[f"{joint}_right"][key] for key in gains] for joint in ("hip", "knee", "ankle")] == [
        [50.0, 10.0, 30.0, 0.0],
        [50.0, 3.0, 30.0, 0.0],
        [63.0, 1.0, 30.0, 0.0],
    ]
    # The boom joint is 0.653 m up when the robot is dropped, 0.0235 m lower when it stands.
    assert said["robot"]["standing_height_m"] == pytest.approx(0.653 - 0.0235)
    assert said["robot"]["sha256"] == robot_hash(robot.path)
    assert said["exported_with"]["onnx"] and said["trained_with"]["torch"]
    assert said["frames_trained"] > 0


def test_a_desired_angle_may_change_as_it_does_in_the_walk(exported):
    """The largest change in a walk from another start is between half of the limit and the limit."""
    env = gctd3.make_env("biped", num_envs=1, seed=5)
    action = env.rollout(600, gctd3.load_policy())["action"][0]
    servos = read_contract(exported.with_suffix(".json")).servos
    low, high, most = np.array([(s.low_rad, s.high_rad, s.most_change_rad) for s in servos]).T
    change = np.abs(np.diff(action.numpy(), axis=0)).max(axis=0) * (high - low) / 2
    assert (change <= most).all() and (change > most / 2).all()
    assert (most < high - low).any()


@pytest.mark.nightly
def test_torch_export_holds_policy_and_contract(tmp_path, states):
    file, extra = tmp_path / "policy.pt2", {"policy.json": ""}
    assert command("export", f"out={file}", "max_rate=7", "episodes=1", "threads=1") == 0
    assert [path.name for path in tmp_path.iterdir()] == ["policy.pt2"]
    network = torch.export.load(file, extra_files=extra).module()
    expected = gctd3.load_policy()(TensorDict({"nodes": states}, [len(states)]))["action"]
    assert (network(states) - expected).abs().max() <= 1e-5
    assert (network(states[:1]) - expected[:1]).abs().max() <= 1e-5
    contract = parse_contract(extra["policy.json"])
    # 7 rad/s for 20 ms.
    assert [servo.most_change_rad for servo in contract.servos] == pytest.approx([0.14] * 6)


def plain(graph, reflection):
    network = Network((8, 8), (16,), norm="layer", graph_norm="layer", residual=True, chebyshev=2, equivariant=True)
    return gctd3.make_actor(graph, 10, 6, network, reflection)


def shared(graph, reflection):
    return gctd3.make_actor(graph, 10, 6, Network((8, 8), (16,), residual=True, mixing="alternating", readout="joint"))


def stochastic(graph, reflection):
    return gctd3.make_stochastic_actor(graph, 10, 6, Network((), (16,)))


@parametrize(3, "make", [plain, shared, stochastic])
def test_any_network_can_be_exported(robot, graph, tmp_path, make):
    policy = make(graph, Reflection.from_robot(robot)).requires_grad_(False).eval()
    file = tmp_path / "policy.onnx"
    file.write_bytes(to_onnx(traced(Deterministic(policy).eval(), (8, 10)), contract_of(robot))[0])
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert difference(file, policy, torch.randn(500, 8, 10)) <= 1e-5
        assert difference(file, policy, torch.randn(1, 8, 10)) <= 1e-5


def contract_of(robot):
    task = walking(robot)
    rehearsed = Rehearsed(np.zeros((1, task.graph.num_nodes, task.features)), np.full(int(robot.model.nu), 0.1))
    return describe(task, rehearsed, "0" * 64, 1, {}, {})


@pytest.mark.parametrize("name", ["biped", "biped_planar", "quadruped", "hexapod"])
def test_readings_by_name_are_the_tasks_node_features(name):
    """Readings taken from MuJoCo by name equal the node features, a free base's angles included."""
    robot = Robot.from_mjcf(name)
    task, model, data = walking(robot), robot.model, mujoco.MjData(robot.model)
    rng = np.random.default_rng(0)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(model, data)
    root = model.body(robot.root).id
    standing = data.xpos[root].copy()
    for _ in range(20):
        mujoco.mj_integratePos(model, data.qpos, 0.3 * rng.standard_normal(model.nv), 1.0)
        data.qvel[:] = rng.standard_normal(model.nv)
        mujoco.mj_forward(model, data)
        turn, speed = data.xmat[root].reshape(3, 3), np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, root, speed, 0)
        spin = turn.T @ speed[:3] if robot.base.free else speed[:3]
        truth = {
            "height_m": data.xpos[root, 2] - standing[2],
            "velocity_m_s": speed[3],
            "side_m": data.xpos[root, 1] - standing[1],
            "side_rate_m_s": speed[4],
            "roll_rad": np.arctan2(turn[2, 1], turn[2, 2]),
            "pitch_rad": np.arcsin(-turn[2, 0]),
            "yaw_rad": np.arctan2(turn[1, 0], turn[0, 0]),
            **{f"{axis}_rate_rad_s": rate for axis, rate in zip(("roll", "pitch", "yaw"), spin, strict=True)},
        }
        for joint in robot.joints:
            truth[f"angle_{joint.name}_rad"] = data.joint(joint.name).qpos[0]
            truth[f"velocity_{joint.name}_rad_s"] = data.joint(joint.name).qvel[0]
        for foot in robot.feet:
            truth[f"down_{foot}"] = float(data.sensor(foot).data[0] > 0)
        nodes = task.node_features(task.measure(data.qpos, data.qvel, data.sensordata))
        mine = [[truth[f.reading] if f.reading else 0.0 for f in node.features] for node in sensed(task, nodes[None])]
        np.testing.assert_allclose(mine, nodes, atol=1e-5)
        data.qpos[:] = robot.standing_qpos


def named(name):
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        settings = build(compose("config", [f"robot={name}"]).robot)
    try:
        return settings.load()
    except RobotError as error:
        pytest.skip(str(error))


@pytest.mark.nightly
@pytest.mark.parametrize("name", ["quadruped", "go2"])
def test_a_free_robot_by_name_stands_up_and_stops_when_it_tips(name, tmp_path):
    """An untrained policy: what it reads, its safe command and its stop, in the robot's own simulation."""
    robot = named(name)
    task, model, data = walking(robot), robot.model, mujoco.MjData(robot.model)
    actor = gctd3.make_actor(task.graph, task.features * task.history, model.nu, Network((8,), (16,)))
    frames = task.node_features(task.measure(robot.standing_qpos, np.zeros(model.nv), data.sensordata))[None]
    contract = describe(task, Rehearsed(frames, np.full(model.nu, 0.05)), "0" * 64, 1, {}, {})
    file = tmp_path / "policy.onnx"
    program = traced(Deterministic(actor.requires_grad_(False).eval()).eval(), contract.network.input_shape)
    file.write_bytes(to_onnx(program, contract)[0])
    network = dataclasses.replace(contract.network, sha256=checksum(file), opset=18)
    contract = dataclasses.replace(contract, network=network)
    file.with_suffix(".json").write_text(contract.to_json(), encoding="utf-8")
    policy, features = Policy(file), contract.features

    def sense():
        nodes = task.node_features(task.measure(data.qpos, data.qvel, data.sensordata))
        read = {f: nodes[i, k] + f.zero for i, n in enumerate(contract.nodes) for k, f in enumerate(n.features)}
        return {f.reading: float(read[f]) for f in features}

    # Held 0.15 rad from home at each joint that can be: home is reached at 0.5 rad/s in 0.3 s, 15 periods.
    data.qpos[:] = robot.start_qpos
    home = np.array([servo.home_rad for servo in contract.servos])
    for joint, servo in zip(map(robot.joint, robot.actuated), contract.servos, strict=True):
        data.qpos[joint.qpos] = min(servo.home_rad + 0.15, servo.high_rad)
    mujoco.mj_forward(model, data)
    before = np.array([data.qpos[robot.joint(servo.joint).qpos] for servo in contract.servos])
    for period in range(1, 17):
        command = np.array(list(policy.start(sense()).values()))
        np.testing.assert_allclose(command, before + np.clip(home - before, -0.01 * period, 0.01 * period), atol=1e-6)
    assert policy.at_home
    assert policy.step(sense(), 0.0).keys() == {servo.actuator for servo in contract.servos}
    # On its side.
    turn = np.zeros(4)
    mujoco.mju_axisAngle2Quat(turn, np.array([1.0, 0.0, 0.0]), 1.0)
    data.qpos[robot.base.free.qpos + 3 : robot.base.free.qpos + 7] = turn
    mujoco.mj_forward(model, data)
    with pytest.raises(
        ReadingError, match=r"Stopped: the body was tilted by 1\.000 rad, allowed are 0\.800 rad"
    ) as error:
        policy.step(sense(), task.control_dt)
    assert error.value.command == policy.command


@pytest.mark.parametrize("servo", ['<position gear="2"', '<general biastype="affine" gainprm="9" biasprm="0 -8 0"'])
def test_a_servo_that_is_told_no_joint_angle_is_refused(robot, tmp_path, servo):
    text = robot.path.read_text()
    assert '<position name="hip_left"' in text
    file = tmp_path / "my.xml"
    file.write_text(text.replace('<position name="hip_left"', f'{servo} ctrlrange="-1 1" name="hip_left"'))
    with pytest.raises(RobotError, match=r"must be a <position> servo"):
        contract_of(Robot.from_mjcf(file))


def test_the_robots_hash_covers_what_it_includes(robot, tmp_path):
    text = robot.path.read_text(encoding="utf-8")
    start, end = text.index("<actuator>"), text.index("</actuator>") + len("</actuator>")
    part, scene = tmp_path / "part.xml", tmp_path / "scene.xml"
    part.write_text(f"<mujoco>{text[start:end]}</mujoco>")
    scene.write_text(f'{text[:start]}<include file="part.xml"/>{text[end:]}')
    # Told in another way it is the same robot; with another gain it is not.
    assert robot_hash(scene) == robot_hash(robot.path) == robot_hash("biped")
    scene.write_text(scene.read_text().replace('kp="63"', 'kp="64"').replace('kp="50"', 'kp="51"'))
    part.write_text(part.read_text().replace("</actuator>", '<general name="more" joint="hip_left"/></actuator>'))
    assert robot_hash(scene) != robot_hash(robot.path)
    part.unlink()
    with pytest.raises(ContractError, match=r"part\.xml"):
        robot_hash(scene)


@pytest.mark.nightly
def test_an_export_that_differs_is_not_written(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("gctd3.deploy.export.to_pt2", lambda program, contract: (b"", lambda states: np.float32(0.0)))
    assert command("export", f"out={tmp_path / 'policy.pt2'}", "episodes=1", "threads=1") == 2
    assert re.search(r"error: .* differ from PyTorch's by up to .* nothing was written", capsys.readouterr().err)
    assert not list(tmp_path.iterdir())


def test_what_is_missing_is_named_before_anything_is_done(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("gctd3.deploy.settings.find_spec", lambda name: None if name == "onnxscript" else object())
    assert command("export", f"out={tmp_path / 'policy.onnx'}") == 2
    assert "needs onnxscript: pip install 'gctd3[export]'" in capsys.readouterr().err


@pytest.mark.dm_control
def test_a_librarys_task_is_refused(tmp_path, capsys):
    run = tmp_path / "run"
    with initialize_config_module("gctd3.conf", version_base="1.3"):
        save_config(run, compose("config", ["task=walker_walk"]), [])
    assert command("export", f"run={run}", f"out={tmp_path / 'policy.pt2'}") == 2
    assert "was trained on walker-walk: export is for tasks that gctd3 simulates" in capsys.readouterr().err


def test_contracts_with_a_contradiction_are_refused(robot):
    contract = contract_of(robot)
    assert parse_contract(contract.to_json()) == contract
    network = dataclasses.replace(contract.network, input_shape=(8, 12))
    with pytest.raises(ContractError, match=r"make \(8, 10\), not network.input_shape"):
        dataclasses.replace(contract, network=network)
    # Slow control and a single frame are no contradiction.
    assert dataclasses.replace(contract, control_rate_hz=0.5).control_rate_hz == 0.5
    one = dataclasses.replace(contract.network, input_shape=(8, 2))
    assert dataclasses.replace(contract, network=one, history_frames=1).history_frames == 1
    for wrong in (
        {"control_rate_hz": 0.0},
        {"history_frames": 0, "network": dataclasses.replace(one, input_shape=(8, 0))},
    ):
        with pytest.raises(ContractError, match="control_rate_hz and history_frames are above 0"):
            dataclasses.replace(contract, **wrong)
    servo = contract.servos[0]
    for wrong, said in (
        ({"centre_rad": 1.0}, "start_rad, centre_rad and home_rad lie between .* centre_rad of 'hip_right' is 1"),
        ({"home_rad": -1.0}, "home_rad of 'hip_right' is -1, the limits -0.7854 and 0.7854"),
        ({"low_rad": 1.0}, "low_rad of 'hip_right' is below its high_rad"),
        # Degrees in place of radians.
        ({"low_rad": -45.0, "high_rad": 45.0}, "both within 4 pi rad"),
        ({"scale_rad": 45.0}, "scale_rad .* at most twice the way .* got 45 rad on a way of 1.5708 rad"),
        ({"scale_rad": 0.0}, "scale_rad of 'hip_right' is above 0"),
        ({"home_rate_rad_s": 0.0}, "home_rate_rad_s above 0"),
        ({"kd_nm_s_per_rad": -1.0}, "kd_nm_s_per_rad of 'hip_right' is at least 0"),
        ({"angle_reading": "angle_knee"}, "'angle_knee' is none of the readings"),
        ({"actuator": "hip_left"}, "two servos have one actuator, 'hip_left'"),
        ({"joint": "hip_left"}, "two servos have one joint, 'hip_left'"),
    ):
        with pytest.raises(ContractError, match=said):
            dataclasses.replace(contract, servos=(dataclasses.replace(servo, **wrong), *contract.servos[1:]))


def test_the_contract_says_whence_readings_come(exported):
    """The paper's biped stands on a boom, whose encoders measure height and speed."""
    features = read_contract(exported.with_suffix(".json")).features
    assert [(f.reading, f.unit, f.source) for f in features[:4]] == [
        ("height_m", "m", "boom encoder"),
        ("velocity_m_s", "m/s", "boom encoder"),
        ("angle_hip_right_rad", "rad", "joint encoder"),
        ("velocity_hip_right_rad_s", "rad/s", "joint encoder"),
    ]
    assert [(f.unit, f.source, f.low, f.high, f.binary) for f in features[-2:]] == [
        ("1", "foot contact switch", 0.0, 1.0, True)
    ] * 2
    # A quarter of the hip's 1.5708 rad on each side; it never gets to its ends.
    assert (features[2].low, features[2].high) == pytest.approx((-0.7854 - 0.3927, 0.7854 + 0.3927))
    assert features[2].margin == pytest.approx(0.3927)
    # As much again as the speeds of the walk, from standing to 1.2 m/s and more.
    speed = features[1]
    assert speed.high - speed.low == pytest.approx(3 * speed.margin) and speed.low < -1.0 and speed.high > 2.4


def test_readings_that_only_a_simulator_has_are_named():
    free = Robot.from_mjcf("quadruped")
    contract = contract_of(free)
    sources = {f.reading: f.source for f in contract.features}
    exact = {"height_m", "velocity_m_s", "yaw_rad", "side_m", "side_rate_m_s"}
    assert {name for name, source in sources.items() if source == "simulator"} == exact
    assert sources["roll_rad"] == sources["pitch_rad"] == "IMU orientation"
    assert sources["yaw_rate_rad_s"] == "IMU gyroscope"
    (line,) = warnings_of(contract, free)
    assert line.startswith(
        "No robot that walks freely measures these readings, only what is in brackets: height_m (sim"
    )
    assert all(f"{name} (simulator)" in line for name in exact) and "roll_rad" not in line
    # The walking task's fall: 0.8 rad.
    assert (contract.safety.tilt_readings, contract.safety.most_tilt_rad) == (("roll_rad", "pitch_rad"), 0.8)


def test_a_count_of_contacts_is_not_binary():
    counted = Reading("feet_down", "number of feet on the ground", "contact")
    feature = _feature(
        WalkSettings().build(RobotSettings("biped")), "ground", counted, np.array([0.0, 1.0, 2.0]), 0.0, 2.0
    )
    assert (feature.binary, feature.low, feature.high, feature.source) == (False, -2.0, 4.0, "not stated")


def test_an_unknown_source_is_refused(robot):
    wrong = Reading("height_m", "height", "length", source="IMU gyroscop")
    with pytest.raises(
        ConfigError, match=r"unknown source 'IMU gyroscop'. Did you mean 'IMU gyroscope'\? Sources: joint"
    ):
        _feature(robot, "body", wrong, np.zeros(1), 0.0, 0.0)
