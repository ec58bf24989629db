"""The hash of a robot's physics: equal for one robot spelled in two ways, another for another robot."""

import os
from pathlib import Path

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gctd3.robots.physics import part_hashes, physics_hash
from gctd3.robots.rounding import rounded
from gctd3.robots.sources import find_place

ATTACHED = Path(__file__).parent / "cases" / "hash"

SPELLED = """
<mujoco model="one">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.004" gravity="0 0 -9.81"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="torso" pos="0 0 1">
      <joint name="x" type="slide" axis="1 0 0"/> <joint name="z" type="slide" axis="0 0 1"/>
      <inertial pos="0 0 0.1" mass="3" diaginertia="0.02 0.05 0.04" quat="1 0 0 0"/>
      <geom type="box" size="0.1 0.1 0.1" friction="0.8 0.005 0.0001"/>
      <body name="leg" pos="0 0.1 0" quat="0.96592582628906831 0.25881904510252074 0 0">
        <joint name="hip" axis="0 1 0" range="-0.78539816339744828 1.0471975511965976" damping="0.5"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02" mass="1" friction="0.8 0.005 0.0001"/>
      </body>
    </body>
  </worldbody>
  <actuator><position name="hip" joint="hip" kp="40" kv="2" ctrlrange="-1 1"/></actuator>
</mujoco>
"""
# The same in degrees, by classes, with Euler angles, another form of the capsule and of the inertia; things to look at.
OTHERWISE = """
<mujoco model="two">
  <compiler angle="degree" autolimits="false"/>
  <option timestep="4e-3"/>
  <default>
    <geom friction=".8"/>
    <default class="leg"><joint axis="0 3 0" limited="true" range="-45 60" damping=".5"/></default>
  </default>
  <asset><material name="red" rgba="1 0 0 1"/></asset>
  <worldbody>
    <light pos="0 0 3"/> <camera name="side" pos="0 -3 1"/>
    <geom type="plane" size="0 0 2" friction="1 .005 .0001" rgba="0 1 0 1"/>
    <body name="trunk" pos="0 0 1">
      <joint name="x" type="slide" axis="1 0 0"/> <joint name="z" type="slide" axis="0 0 1"/>
      <inertial pos="0 0 0.1" mass="3" fullinertia="0.02 0.05 0.04 0 0 0"/>
      <geom name="trunk" type="box" size=".1 .1 .1" material="red"/>
      <geom type="sphere" size="0.3" contype="0" conaffinity="0" mass="0"/>
      <body pos="0 .1 0" euler="30 0 0" childclass="leg">
        <joint name="hip"/>
        <geom type="capsule" pos="0 0 -0.25" euler="180 0 77" size="0.02 0.25" mass="1"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <general name="hip" joint="hip" gainprm="40" biastype="affine" biasprm="0 -40 -2" ctrllimited="true"
      ctrlrange="-1 1"/>
  </actuator>
  <sensor><jointpos joint="hip"/></sensor>
  <keyframe><key name="k" qpos="0 0 0.3"/></keyframe>
</mujoco>
"""


def model(text):
    return mujoco.MjModel.from_xml_string(text)


def differing(one, two):
    first, second = part_hashes(one), part_hashes(two)
    return [name for name in first if first[name] != second[name]]


def test_one_robot_spelled_in_two_ways():
    one, two = model(SPELLED), model(OTHERWISE)
    # The capsule is turned about its own axis, and the principal axes of the trunk have another order.
    assert not np.allclose(one.geom_quat[2], two.geom_quat[3]) and not np.allclose(one.body_iquat, two.body_iquat)
    assert differing(one, two) == [] and physics_hash(one) == physics_hash(two)


CHANGED = {
    'kp="40"': ('kp="41"', ["actuator gains"]),
    'kv="2"': ('kv="2.0000001"', ["actuator gains"]),
    'ctrlrange="-1 1"': ('ctrlrange="-1 1.1"', ["actuator ranges"]),
    'mass="3"': ('mass="3.1"', ["masses"]),
    'damping="0.5"': ('damping="0.6"', ["joint damping and friction"]),
    "1.0471975511965976": ("1.1", ["joint ranges"]),
    'axis="0 1 0"': ('axis="0 -1 0"', ["joints"]),
    'pos="0 0.1 0" quat': ('pos="0 0.11 0" quat', ["bodies"]),
    "0 0 -0.5": ("0 0 -0.6", ["masses", "collision geometry"]),
    'size="0.1 0.1 0.1" friction="0.8': ('size="0.1 0.1 0.1" friction="0.9', ["contact parameters"]),
    'timestep="0.004"': ('timestep="0.005"', ["options of the simulation"]),
    '<position name="hip"': ('<position name="hop"', ["actuators"]),
}


@pytest.mark.parametrize("what", CHANGED)
def test_what_differs_is_named(what):
    instead, parts = CHANGED[what]
    assert what in SPELLED
    assert differing(model(SPELLED), model(SPELLED.replace(what, instead, 1))) == parts


def test_shipped_robots_differ():
    hashes = {physics_hash(find_place_model(name)) for name in ("biped", "biped_planar", "quadruped", "hexapod")}
    assert len(hashes) == 4


def find_place_model(name):
    return mujoco.MjModel.from_xml_path(str(find_place(name).file))


def test_an_attached_model_is_a_part_of_the_robot(tmp_path):
    """Another gain or mass in a file that is attached is another robot, and the source has changed."""
    (tmp_path / "parts").mkdir()
    whole, part = tmp_path / "attach.xml", tmp_path / "parts" / "bot.xml"
    whole.write_text((ATTACHED / "attach.xml").read_text())
    text = (ATTACHED / "parts" / "bot.xml").read_text()
    seen = {}
    for change in ((), ('kp="60"', 'kp="61"'), ('mass="6"', 'mass="6.5"')):
        part.write_text(text.replace(*change) if change else text)
        loaded = mujoco.MjModel.from_xml_path(str(whole))
        seen[physics_hash(loaded)] = find_place(str(whole)).sha256
    assert len(seen) == len(set(seen.values())) == 3


def test_a_mesh_of_an_attached_model_belongs_to_the_source(tmp_path):
    """MuJoCo reads it from the folders of the model that is attached."""
    (tmp_path / "sub" / "forms").mkdir(parents=True)
    form = tmp_path / "sub" / "forms" / "t.obj"
    corners = "v 0 0 0\nv {} 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "sub" / "b.xml").write_text(
        '<mujoco><compiler meshdir="forms"/><asset><mesh name="t" file="t.obj"/></asset><worldbody><body name="x">'
        '<freejoint/><geom type="mesh" mesh="t"/></body></worldbody></mujoco>'
    )
    whole = tmp_path / "a.xml"
    whole.write_text(
        '<mujoco><compiler meshdir="none"/><asset><model name="b" file="sub/b.xml"/></asset><worldbody>'
        '<attach model="b" body="x" prefix="p"/></worldbody></mujoco>'
    )
    seen = {}
    for width in (1, 2):
        form.write_text(corners.format(width))
        os.utime(form, (width, width))  # MuJoCo remembers a file that is as old as before
        seen[physics_hash(mujoco.MjModel.from_xml_path(str(whole)))] = find_place(str(whole)).sha256
    assert len(seen) == len(set(seen.values())) == 2


@given(st.lists(st.decimals(-100, 100, places=5), min_size=1, max_size=6), st.sampled_from((1 - 2**-52, 1 + 2**-52)))
def test_written_numbers_outlast_errors_of_rounding(written, error):
    row = np.array([[float(number) for number in written]])
    for same in (row * error, row + 1e-16 * np.abs(row).max()):
        assert all(np.array_equal(a, b) for a, b in zip(rounded(row), rounded(same), strict=True))


def test_nine_digits_of_the_largest_count():
    exponents, whole = rounded(np.array([[100.0, 1e-7], [0.5, 0.25]]))
    # 100 is 100000000 millionths; 1e-7 is a tenth of one. 0.5 is 500000000e-9.
    assert exponents.ravel().tolist() == [-6, -9]
    assert whole.tolist() == [[100_000_000, 0], [500_000_000, 250_000_000]]
