"""Make robots for tests that the library does not ship."""

from pathlib import Path

from gctd3.robots.robot import Robot

TWO_LEGS = """
<mujoco>
  <compiler angle="radian"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="torso" pos="0 0 1">
      <joint name="x" type="slide" axis="1 0 0"/> <joint name="z" type="slide" axis="0 0 1"/>
      <geom name="torso" size="0.1"/>
      <body name="leg_r" pos="0 -0.1 0">
        <joint name="hip_r" axis="0 -1 0"/>
        <geom name="leg_r" type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02"/>
      </body>
      <body name="leg_l" pos="0 0.1 0">
        <joint name="hip_l" axis="0 1 0"/>
        <geom name="leg_l" type="capsule" fromto="0 0 0 0 0 -0.5" size="0.02"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="hip_r" joint="hip_r" ctrlrange="-1 1"/> <position name="hip_l" joint="hip_l" ctrlrange="-1 1"/>
  </actuator>
  <sensor>
    <contact body1="leg_r" geom2="floor" data="found"/> <contact body1="leg_l" geom2="floor" data="found"/>
  </sensor>
</mujoco>
"""

# The same on a free base.
FREE_LEGS = TWO_LEGS.replace(
    '<joint name="x" type="slide" axis="1 0 0"/> <joint name="z" type="slide" axis="0 0 1"/>', "<freejoint/>"
)


def opposite_axes(biped, folder):
    """Turn the axes of the biped's left joints round: equal motions of both legs have opposite angles."""
    text = biped.path.read_text()
    for joint, limits in (("hip", "-0.7854 0.7854"), ("knee", "-0.0012 1.3962"), ("ankle", "-0.7854 0.7854")):
        for tag, new in (("joint", f'axis="0 1 0" range="{limits}"'), ("position", f'ctrlrange="{limits}"')):
            old = f'<{tag} name="{joint}_left" class="{joint}"'
            assert text.count(old) == 1
            text = text.replace(old, f"{old} {new}")
    path = folder / "opposite.xml"
    path.write_text(text)
    return Robot.from_mjcf(path)


def write(folder: Path, text: str) -> Path:
    path = folder / "robot.xml"
    path.write_text(text)
    return path
