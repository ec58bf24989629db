"""gctd3: graph-structured off-policy policies for legged robots, on TorchRL.

Light to import: nothing heavy is loaded until it is used.
"""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from gctd3.envs.factory import make_env as make_env
    from gctd3.nn import make_actor as make_actor
    from gctd3.nn import make_critic as make_critic
    from gctd3.nn import make_stochastic_actor as make_stochastic_actor
    from gctd3.robots.graph import KinematicGraph as KinematicGraph
    from gctd3.robots.robot import Robot as Robot
    from gctd3.runs.load import load_policy as load_policy

__version__ = "0.2.0"

_HOME = {
    "KinematicGraph": "gctd3.robots.graph",
    "Robot": "gctd3.robots.robot",
    "load_policy": "gctd3.runs.load",
    "make_actor": "gctd3.nn",
    "make_critic": "gctd3.nn",
    "make_env": "gctd3.envs.factory",
    "make_stochastic_actor": "gctd3.nn",
}
# Names of gctd3 for the ``_target_`` of a YAML. Configurations of runs hold these names, so they outlive moves.
_TARGETS = {
    "ActionRate": "gctd3.tasks.motor_terms",
    "DomainRandomisation": "gctd3.tasks.domain_randomisation",
    "Effort": "gctd3.tasks.motor_terms",
    "EndStops": "gctd3.tasks.motor_terms",
    "HomePose": "gctd3.tasks.motor_terms",
    "FootSlip": "gctd3.tasks.motor_terms",
    "HeightFromStanding": "gctd3.tasks.motor_terms",
    "ShankContact": "gctd3.tasks.motor_terms",
    "Antiphase": "gctd3.tasks.reward_terms",
    "BaseCoordinate": "gctd3.tasks.features",
    "BaseRate": "gctd3.tasks.features",
    "BodyHeight": "gctd3.tasks.reward_terms",
    "Boxes": "gctd3.tasks.terrain_kinds",
    "CommandGrid": "gctd3.evaluation.settings",
    "Composition": "gctd3.tasks.simulated_task",
    "CrossCheckSettings": "gctd3.engines.settings",
    "DDPGSettings": "gctd3.algorithms.settings",
    "Ended": "gctd3.tasks.reward_terms",
    "EnvSettings": "gctd3.envs.settings",
    "EvaluateSettings": "gctd3.runs.settings",
    "EvaluationSettings": "gctd3.training.settings",
    "ExplorationSettings": "gctd3.data.settings",
    "ExportSettings": "gctd3.deploy.settings",
    "Fall": "gctd3.tasks.terminations",
    "Finish": "gctd3.tasks.terminations",
    "FlatGround": "gctd3.tasks.terrain_kinds",
    "Flight": "gctd3.tasks.reward_terms",
    "FootContact": "gctd3.tasks.features",
    "ForwardVelocity": "gctd3.tasks.reward_terms",
    "Gaps": "gctd3.tasks.terrain_kinds",
    "GiveUp": "gctd3.training.give_up",
    "GraphSettings": "gctd3.viz.settings",
    "Heading": "gctd3.tasks.reward_terms",
    "GaitClock": "gctd3.tasks.gait_clock",
    "GaitSchedule": "gctd3.tasks.gait_clock",
    "Height": "gctd3.tasks.features",
    "HeightScan": "gctd3.tasks.height_scan",
    "ImitationSettings": "gctd3.algorithms.settings",
    "InlineSettings": "gctd3.data.settings",
    "JointAngle": "gctd3.tasks.features",
    "JointNoise": "gctd3.tasks.randomisations",
    "JointVelocity": "gctd3.tasks.features",
    "LibrarySettings": "gctd3.envs.settings",
    "Living": "gctd3.tasks.reward_terms",
    "LongContact": "gctd3.tasks.terminations",
    "Network": "gctd3.nn.settings",
    "OffLine": "gctd3.tasks.reward_terms",
    "Overspeed": "gctd3.tasks.reward_terms",
    "Perturbations": "gctd3.evaluation.settings",
    "ProcessSettings": "gctd3.data.settings",
    "Progress": "gctd3.tasks.reward_terms",
    "RaySettings": "gctd3.data.settings",
    "RenderSettings": "gctd3.runs.settings",
    "ReplaySettings": "gctd3.data.settings",
    "ReportSettings": "gctd3.comparison.settings",
    "Reward": "gctd3.tasks.reward",
    "RoughGround": "gctd3.tasks.terrain_kinds",
    "RobotSettings": "gctd3.robots.settings",
    "RosSettings": "gctd3.bridge.settings",
    "ServoSettings": "gctd3.robots.servo_settings",
    "SACSettings": "gctd3.algorithms.settings",
    "SingleSupport": "gctd3.tasks.reward_terms",
    "Slopes": "gctd3.tasks.terrain_kinds",
    "Stairs": "gctd3.tasks.terrain_kinds",
    "SteppingStones": "gctd3.tasks.terrain_kinds",
    "StopTogether": "gctd3.training.sweep",
    "StopWhen": "gctd3.training.stop_when",
    "Survive": "gctd3.tasks.terminations",
    "StuckHip": "gctd3.tasks.terminations",
    "SwingTime": "gctd3.tasks.reward_terms",
    "TD3Settings": "gctd3.algorithms.settings",
    "Terrain": "gctd3.tasks.terrain",
    "TerrainEdge": "gctd3.tasks.terrain_edge",
    "Tilt": "gctd3.tasks.reward_terms",
    "TimeLimit": "gctd3.tasks.terminations",
    "TrainSettings": "gctd3.training.settings",
    "UniformCommand": "gctd3.tasks.commands",
    "Velocity": "gctd3.tasks.features",
    "CommandBase": "gctd3.tasks.velocity_features",
    "CommandForward": "gctd3.tasks.velocity_features",
    "GravityDirection": "gctd3.tasks.velocity_features",
    "GravityUp": "gctd3.tasks.velocity_features",
    "Gyroscope": "gctd3.tasks.velocity_features",
    "HeadingForward": "gctd3.tasks.velocity_features",
    "HeadingBase": "gctd3.tasks.velocity_features",
    "LastAction": "gctd3.tasks.velocity_features",
    "StandStill": "gctd3.tasks.velocity_terms",
    "TrackVelocity": "gctd3.tasks.velocity_terms",
    "TrackYawRate": "gctd3.tasks.velocity_terms",
    "VelocityCommand": "gctd3.tasks.velocity_command",
    "VelocityReward": "gctd3.tasks.velocity",
    "VelocitySettings": "gctd3.tasks.velocity",
    "ViewSettings": "gctd3.runs.settings",
    "CommandHeight": "gctd3.tasks.jump_features",
    "JumpApex": "gctd3.tasks.jump_features",
    "JumpClock": "gctd3.tasks.jump_features",
    "JumpCommand": "gctd3.tasks.jump_command",
    "JumpHeight": "gctd3.tasks.jump_terms",
    "JumpReward": "gctd3.tasks.jump",
    "JumpSettings": "gctd3.tasks.jump",
    "JumpedAndStood": "gctd3.tasks.jump_terms",
    "LeaveSpot": "gctd3.tasks.jump_terms",
    "StandAfterJump": "gctd3.tasks.jump_terms",
    "WalkSettings": "gctd3.tasks.walk",
}
__all__ = sorted(_HOME)


def _register() -> None:
    from gymnasium.envs.registration import register

    register(
        id="gctd3/Biped-v0",
        entry_point="gctd3.envs.gym:BipedEnv",
        vector_entry_point="gctd3.envs.gym:BipedVectorEnv",
    )
    register(
        id="gctd3/Velocity-v0",
        entry_point="gctd3.envs.gym:VelocityEnv",
        vector_entry_point="gctd3.envs.gym:VelocityVectorEnv",
    )


class _Gymnasium:
    """Register the environment as soon as Gymnasium is imported; to import it here would take long."""

    searching = False

    @classmethod
    def find_spec(cls, name: str, path: Any = None, target: Any = None) -> Any:  # noqa: ANN401 - as importlib has them
        """Find Gymnasium as Python does, and let its import end with the registration."""
        if name != "gymnasium" or cls.searching:
            return None
        cls.searching = True
        try:
            spec = find_spec(name)
        finally:
            cls.searching = False
        if spec is None or spec.loader is None:
            return None
        execute = spec.loader.exec_module

        def exec_module(module: Any) -> None:  # noqa: ANN401
            execute(module)
            _register()

        vars(spec.loader)["exec_module"] = exec_module
        return spec


if "gymnasium" in sys.modules:
    _register()
else:
    sys.meta_path.insert(0, _Gymnasium)


def __getattr__(name: str) -> Any:  # noqa: ANN401 - any of the names above
    home = _HOME.get(name) or _TARGETS.get(name)
    if home is None:
        raise AttributeError(f"module 'gctd3' has no attribute {name!r}; it has {', '.join(__all__)}.")
    try:
        return getattr(import_module(home), name)
    except ImportError as error:
        from gctd3.config.requirements import why_no_mujoco

        if reason := why_no_mujoco(error):
            from gctd3.errors import PackageError

            raise PackageError(reason) from error
        raise


def __dir__() -> list[str]:
    return [*globals(), *__all__]
