"""Other physics engines in tests: an engine's class, or why it is skipped, and robots that they simulate."""

from dataclasses import replace

import mujoco
import pytest
from robots import FREE_LEGS

from gctd3.engines.gazebo_program import check_library
from gctd3.errors import ConfigError
from gctd3.robots.robot import Robot


def engine_of(name):
    """Return the class of an engine; skip the test with the line that brings it."""
    if name == "gazebo":
        try:
            check_library()
        except ConfigError as error:
            pytest.skip(str(error))
        from gctd3.engines.gazebo import Gazebo

        return Gazebo
    package = {"dart": "dartpy", "bullet": "pybullet"}[name]
    pytest.importorskip(package, reason=f"needs {package}: pip install 'gctd3[engines]'")
    if name == "dart":
        from gctd3.engines.dart import Dart

        return Dart
    from gctd3.engines.bullet import Bullet

    return Bullet


def free_robot(text=FREE_LEGS):
    """Make a robot with two legs on a free base, whose principal axes are no frame's."""
    text = text.replace("<freejoint/>", "<freejoint/><inertial mass='3' pos='0.02 0.01 0.03' ")
    text = text.replace("0.03' ", "0.03' fullinertia='0.03 0.04 0.05 0.001 0.002 -0.003'/>")
    return Robot.from_mjcf(mujoco.MjSpec.from_string(text))


def servos_of(contract, robot):
    """Return a contract with servos for another robot's joints, without gains."""
    first = contract.servos[0]
    weak = {"kp_nm_per_rad": 0.0, "kd_nm_s_per_rad": 0.0, "angle_reading": None}
    servos = tuple(replace(first, actuator=name, joint=name, **weak) for name in robot.actuated)
    return replace(contract, servos=servos)
