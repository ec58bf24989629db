"""Standing poses of files as people own them: the key of the file that is taken, or the pose that is found."""

import mujoco
import numpy as np
import pytest
from compositions import walking
from incomplete_files import CASES, LEG, LEGS, case, dog

from gctd3.errors import RobotError
from gctd3.robots.robot import Robot
from gctd3.robots.settings import RobotSettings


def test_a_key_in_which_it_stands_is_taken_whatever_its_name(tmp_path):
    pose = "0 0 {z} 1 0 0 0" + " .5 -1" * 4
    height = 0.2 * np.cos(0.5) * 2 + 0.03
    flat = '<key name="lying" qpos="0 0 .2 .7071 .7071 0 0 0 0 0 0 0 0 0 0"/>'
    path = dog(tmp_path, rest=f'<keyframe>{flat}<key name="standing" qpos="{pose.format(z=height)}"/></keyframe>')
    robot = RobotSettings(name=str(path)).load()
    np.testing.assert_allclose(robot.standing_qpos[7:], [0.5, -1.0] * 4)
    assert "The robot stands in key 'standing'." in robot.notes
    for asked, message in (("standin", "Did you mean 'standing'"), ("lying", "does not stand in key 'lying'")):
        with pytest.raises(RobotError, match=message):
            RobotSettings(name=str(path), pose=asked).load()


def test_a_key_off_the_ground_is_put_on_it(tmp_path):
    pose = "0 0 .6 1 0 0 0" + " .5 -1" * 4
    path = dog(tmp_path, rest=f'<keyframe><key name="home" qpos="{pose}"/></keyframe>')
    robot = RobotSettings(name=str(path)).load()
    # Two links of 0.2 m at 0.5 rad to the vertical, and the ball's radius.
    assert robot.standing_qpos[2] == pytest.approx(0.4 * np.cos(0.5) + 0.03, abs=1e-4)
    assert any("lowered by 0.219 m" in note for note in robot.notes)


@pytest.mark.parametrize(
    "wrong",
    ['qpos="0 0 .5 1 0 0 0"', f'qpos="{" 1" * 20}"', f'qpos="nan{" 1" * 14}"', 'ctrl="1"', 'act="1 2 3"', 'mpos="1"'],
)
@pytest.mark.parametrize("name", ["stand", ""])
def test_a_key_that_cannot_be_used_is_passed_over_by_name(tmp_path, wrong, name):
    path = dog(
        tmp_path, rest=f"<keyframe><key/><key {f'name={chr(34)}{name}{chr(34)}' if name else ''} {wrong}/></keyframe>"
    )
    # Parts without names are named for the sensors that are added.
    path.write_text(path.read_text().replace('<body name="shank_fl"', "<body"))
    robot = RobotSettings(name=str(path)).load()
    assert len(robot.feet) == 4
    if name:
        assert any(note.startswith("Key 'stand' is ") for note in robot.notes)
        with pytest.raises(
            RobotError,
            match=r"stand in key 'stand': (its size does not fit|it has n)",
        ):
            RobotSettings(name=str(path), pose="stand").load()


@pytest.mark.parametrize("foot, lower", [("trunk", "shank_fl is 0.38 m"), ("stub", "shank_fl is 0.3")])
def test_feet_that_do_not_reach_the_ground_are_refused(tmp_path, foot, lower):
    inside = '<body name="stub" pos=".3 0 0"><joint name="nod" axis="0 1 0" range="-9 9"/><geom size=".1"/></body>'
    path = dog(tmp_path, inside=inside)
    with pytest.raises(RobotError, match=f"the feet {foot} do not reach the ground: in the standing pose {lower}"):
        RobotSettings(name=str(path), feet=[foot]).load()


def test_what_mujoco_says_takes_one_line(tmp_path):
    path = dog(tmp_path, actuator='<motor joint="{n}x"/>')
    with pytest.raises(RobotError, match=r"unknown transmission target 'hip_flx'") as caught:
        RobotSettings(name=str(path)).load()
    assert "\n" not in str(caught.value)


def test_a_key_in_which_feet_hang_in_the_air_is_passed_over(tmp_path):
    pose = "0 0 .4 1 0 0 0 1.2 -2.4 1.2 -2.4 .2 -.4 .2 -.4"
    path = dog(tmp_path, rest=f'<keyframe><key name="home" qpos="{pose}"/></keyframe>')
    robot = RobotSettings(name=str(path)).load()
    assert len(robot.feet) == 4
    assert any(note.startswith("Key 'home' is passed over") for note in robot.notes)


def test_a_found_pose_has_bent_legs_and_feet_below_the_hips(tmp_path):
    robot = RobotSettings(name=str(dog(tmp_path))).load()
    model, data = robot.model, mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(model, data)
    for n, *_ in LEGS:
        foot, hip = data.xpos[model.body(f"ball_{n}").id], data.xanchor[model.joint(f"hip_{n}").id]
        assert abs(foot[0] - hip[0]) < 0.01
        # Of a leg of 0.4 m.
        assert 0.84 < (hip[2] - foot[2]) / 0.4 < 0.91
        assert foot[2] == pytest.approx(0.03, abs=1e-6)
    np.testing.assert_array_equal(robot.standing_qpos[7:9], robot.standing_qpos[9:11])
    assert not any("falling" in note for note in robot.notes)


def test_a_waist_stays_straight_in_a_found_pose(tmp_path):
    """Several legs hang on it: each would bend it its own way."""
    legs = "".join(LEG.format(n=n, x=x, y=y) for n, x, y in LEGS)
    belly = '<joint name="waist" axis="0 1 0" range="-1 1"/><geom size=".02" mass=".1" contype="0" conaffinity="0"/>'
    robot = RobotSettings(name=str(dog(tmp_path, inside=f'<body name="belly">{belly}{legs}</body>', legs=[]))).load()
    assert any("one with bent legs is found" in note for note in robot.notes)
    assert robot.standing_qpos[robot.joint("waist").qpos] == 0.0
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.standing_qpos
    mujoco.mj_kinematics(robot.model, data)
    assert np.ptp([data.xpos[robot.model.body(f"ball_{n}").id][2] for n, *_ in LEGS]) < 1e-3


def test_a_pose_outside_of_a_range_is_put_into_it_and_named():
    robot = case("start/key_outside_range.xml").load()
    assert [note for note in robot.notes if "knee_right" in note and "0.1 rad instead of 0.6" in note]
    assert robot.start_qpos[robot.joint("knee_right").qpos] == pytest.approx(0.1)
    # It is not kicked.
    data = mujoco.MjData(robot.model)
    data.qpos[:] = robot.start_qpos
    data.ctrl[:] = robot.start_qpos[[robot.joint(name).qpos for name in robot.actuated]]
    mujoco.mj_step(robot.model, data, 4)
    assert np.abs(data.qvel).max() < 1.0


@pytest.mark.parametrize("read", [Robot.from_mjcf, lambda path: RobotSettings(name=path).load()])
def test_start_noise_keeps_loops_closed(read):
    robot = read(str(CASES / "start/loop.xml"))
    task, rng = walking(robot), np.random.default_rng(0)
    data, ends = mujoco.MjData(robot.model), np.array([0.0, 0.0, -0.25])
    opened = 0.0
    for _ in range(5):
        data.qpos[:], data.qvel[:] = task.start(rng)
        mujoco.mj_forward(robot.model, data)
        for side in ("right", "left"):
            rod, foot = data.body(f"rod_{side}"), data.body(f"foot_{side}")
            # The anchor is at the foot's sole when nothing moved: compared in the frame of the foot.
            place = foot.xmat.reshape(3, 3).T @ (rod.xpos + rod.xmat.reshape(3, 3) @ ends - foot.xpos)
            opened = max(opened, float(np.abs(place - [0.05, 0.0, 0.0]).max()))
        assert np.abs(data.qpos[2:]).max() > 0.01
    assert opened < 1e-6
