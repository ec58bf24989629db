"""A biped whose left leg may differ from its right one."""

import mujoco

from gctd3.robots.robot import Robot

BOOM = '<joint name="rx" type="slide" axis="1 0 0"/><joint name="rz" type="slide" axis="0 0 1"/>'


def leg(side, y, axis="0 -1 0", mass=0.6, hip="-0.8 0.8", knee="-1.4 0.1", dynamics='damping="1"'):
    return f"""
      <body name="thigh_{side}" pos="0 {y} 0">
        <joint name="hip_{side}" axis="{axis}" range="{hip}" armature="0.01" {dynamics}/>
        <geom type="capsule" fromto="0 0 -0.03 0 0 -0.22" size="0.025" mass="1" contype="1" conaffinity="0"/>
        <body name="foot_{side}" pos="0 0 -0.25">
          <joint name="knee_{side}" axis="{axis}" range="{knee}" armature="0.01" damping="1"/>
          <geom name="sole_{side}" type="capsule" fromto="0 0 -0.03 0 0 -0.25" size="0.025" mass="{mass}" contype="1"
                conaffinity="0"/>
        </body>
      </body>"""


def servos(side, kp=60, gear=1, hip="-0.8 0.8", knee="-1.4 0.1", force="-40 40"):
    return "".join(
        f'<position name="a_{name}_{side}" joint="{name}_{side}" kp="{kp}" kv="3" ctrlrange="{limits}" '
        f'forcerange="{force}" gear="{gear}"/>'
        for name, limits in (("hip", hip), ("knee", knee))
    )


def biped(base=BOOM, trunk="0 0 0.12", left=None, left_servos=None, more=""):
    """Two legs of a thigh and a foot, whose left one differs as the arguments say."""
    left = {"side": "left", "y": 0.1, **(left or {})}
    return f"""
<mujoco>
  <compiler angle="radian"/> <option timestep="0.005" integrator="implicitfast"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" contype="0" conaffinity="1"/>
    <body name="torso" pos="0 0 0.53">{base}
      <geom type="box" size="0.06 0.1 0.12" pos="{trunk}" mass="6" contype="1" conaffinity="0"/>
      {leg("right", -0.1)}{leg(**left)}
    </body>
  </worldbody>
  <actuator>{servos("right")}{servos("left", **(left_servos or {}))}</actuator>
  <sensor>
    <contact body1="foot_right" geom2="floor" data="found"/> <contact body1="foot_left" geom2="floor" data="found"/>
  </sensor>
  {more}
</mujoco>"""


def robot_of(text, **known):
    return Robot.from_mjcf(mujoco.MjModel.from_xml_string(text), **known)
