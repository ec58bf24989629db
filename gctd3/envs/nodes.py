"""Node features for environments of other libraries, read from their simulator.

Works on TorchRL's :class:`~torchrl.envs.DMControlEnv` and on its :class:`~torchrl.envs.GymEnv` of Gymnasium's MuJoCo
robots, one robot each; several are a :class:`~torchrl.envs.SerialEnv` or :class:`~torchrl.envs.ParallelEnv` of such.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.data import Composite, Unbounded
from torchrl.envs import CatFrames, Compose, DoubleToFloat, EnvBase, Transform, TransformedEnv

from gctd3.compat import hide, wrapped_env
from gctd3.errors import ConfigError
from gctd3.robots.floating_base import Axis
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.mjcf import body_name
from gctd3.robots.robot import Robot

KINDS = ("root", "base", "hinge", "slide", "ball", "ground")
# An odd number, while a frame's is even: a network that takes these columns for frames finds the mistake.
STATIC = (*KINDS, "actuated", "limited", "lower", "upper", "mass")


class NodeSensor:
    """Read the nodes' features from a MuJoCo state.

    Half of a node's features are positions, half velocities: for the root its height from standing (m) and forward
    velocity (m/s), for a base node its coordinate and rate (m or rad, and per second), for a joint its angle and
    velocity (rad or m, and per second). A ground node has the contacts of its feet, 0 or 1. Each half is one number, or
    three if the robot has a ball joint, whose position is a rotation vector (rad); shorter ones are padded with zeros.

    Args:
        model: The robot's model.
        feet: Names of the bodies that may touch the ground, see :meth:`.Robot.from_mjcf`.
        forward: Forward axis, see :meth:`.Robot.from_mjcf`.

    Attributes:
        robot: The robot read from the model.
        graph: The robot's graph, with a node for each row of the features.
        features: ``F``, the number of features of a node in one frame.
    """

    def __init__(self, model: mujoco.MjModel, feet: Sequence[str] | None = None, forward: Axis | None = None) -> None:
        self.robot = Robot.from_mjcf(model, feet, forward)
        self.graph = KinematicGraph.from_robot(self.robot)
        self._half = 3 if "ball" in self.graph.kinds else 1
        self.features = 2 * self._half
        self._extra = [i for i, kind in enumerate(self.graph.kinds) if kind == "base"]
        self._joints = [(self.graph.nodes.index(joint.name), joint) for joint in self.robot.joints]
        self._ground = [i for i, kind in enumerate(self.graph.kinds) if kind == "ground"]
        bodies = [body_name(model, body) for body in range(model.nbody)]
        self._feet = [bodies.index(foot) for foot in self.robot.feet]
        standing = self.robot.standing_qpos
        self._standing = self.robot.base.read(standing, np.zeros(model.nv)).get("height", (np.zeros(()),))[0]

    def read(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        """Return the present features of all nodes, shape ``[N, F]``."""
        values = np.zeros((self.graph.num_nodes, 2, self._half), dtype=np.float32)
        base = self.robot.base.read(np.array(data.qpos), np.array(data.qvel))
        nothing = np.zeros(()), np.zeros(())
        values[0, :, 0] = base.get("height", nothing)[0] - self._standing, base.get("forward", nothing)[1]
        for row, name in zip(self._extra, self.robot.base.extra, strict=True):
            values[row, :, 0] = base[name]
        for row, joint in self._joints:
            if joint.kind == "ball":
                turn = np.zeros(3)
                mujoco.mju_quat2Vel(turn, data.qpos[joint.qpos : joint.qpos + 4], 1.0)
                values[row] = turn, data.qvel[joint.qvel : joint.qvel + 3]
            else:
                values[row, :, 0] = data.qpos[joint.qpos], data.qvel[joint.qvel]
        down = self.feet_down(model, data)
        for row, feet in zip(self._ground, self.robot.foot_pairs, strict=True):
            values[row, : len(feet), 0] = down[list(feet)]
        return values.reshape(self.graph.num_nodes, self.features)

    def position(self, data: mujoco.MjData) -> float:
        """Return the forward distance from the world's origin (m); 0 for a robot that cannot move that way."""
        base = self.robot.base.read(np.array(data.qpos), np.array(data.qvel))
        return float(base["forward"][0]) if "forward" in base else 0.0

    def feet_down(self, model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
        """Return whether each foot touches a body fixed to the world, shape ``[feet]``."""
        touching: set[int] = set()
        if data.ncon:
            bodies = np.array(model.geom_bodyid)[np.array(data.contact.geom)]
            bodies = bodies[np.array(data.contact.dist) <= 0.0]
            fixed = np.array(model.body_weldid)[bodies] == 0
            touching = set(bodies[fixed[:, ::-1]].tolist())
        return np.array([foot in touching for foot in self._feet])

    def static(self) -> np.ndarray:
        """Return the constant features of all nodes, columns as in ``STATIC``, shape ``[N, 11]``.

        They are the node's one-hot kind; whether an action moves it; whether it has both limits; the limits (rad or m,
        0 for a missing one); its body's share of the robot's mass.
        """
        model, robot, graph = self.robot.model, self.robot, self.graph
        bodies = [body_name(model, body) for body in range(model.nbody)]
        columns = {name: np.zeros(graph.num_nodes, dtype=np.float32) for name in STATIC}
        for row, kind in enumerate(graph.kinds):
            columns[kind][row] = 1.0
        columns["actuated"][list(graph.actuated)] = 1.0
        for row, body in [(0, robot.root), *((row, joint.body) for row, joint in self._joints)]:
            columns["mass"][row] = model.body_mass[bodies.index(body)] / model.body_mass.sum()
        for row, joint in self._joints:
            limits = [limit if np.isfinite(limit) else 0.0 for limit in joint.range]
            columns["limited"][row] = np.isfinite(joint.range).all()
            columns["lower"][row], columns["upper"][row] = limits
        return np.stack([columns[name] for name in STATIC], axis=1)


class Nodes(Transform):
    """Write ``"nodes"`` ``[N, F]``, read from the simulator of the wrapped environment.

    Args:
        env: The environment, see :func:`sensor_of`.
        feet: See :class:`NodeSensor`.
        forward: See :class:`NodeSensor`.

    Attributes:
        sensor: Sensor that reads the nodes; its ``graph`` is that of the networks.
    """

    def __init__(self, env: EnvBase, feet: Sequence[str] | None = None, forward: Axis | None = None) -> None:
        super().__init__(in_keys=[], out_keys=["nodes"])
        hide(self, sensor=sensor_of(env, feet, forward), read_simulator=lambda: simulator(env))

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        nodes = torch.from_numpy(self.sensor.read(*self.read_simulator()))
        return next_tensordict.set("nodes", nodes)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add ``"nodes"`` to the observation spec."""
        observation_spec["nodes"] = Unbounded((self.sensor.graph.num_nodes, self.sensor.features))
        return observation_spec


class StaticNodes(Transform):
    """Append :meth:`NodeSensor.static` to every node's features, after frames were stacked.

    Args:
        sensor: Sensor with the constant features.
    """

    static: torch.Tensor

    def __init__(self, sensor: NodeSensor) -> None:
        super().__init__(in_keys=["nodes"], out_keys=["nodes"])
        self.register_buffer("static", torch.from_numpy(sensor.static()))

    def _apply_transform(self, obs: torch.Tensor) -> torch.Tensor:
        return torch.cat([obs, self.static.expand(*obs.shape[:-1], -1)], dim=-1)

    def _reset(self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the constant features to the spec of ``"nodes"``."""
        n, features = observation_spec["nodes"].shape
        observation_spec["nodes"] = Unbounded((n, features + self.static.shape[-1]))
        return observation_spec


def with_nodes(
    env: EnvBase,
    history: int = 1,
    static: bool = False,
    feet: Sequence[str] | None = None,
    forward: Axis | None = None,
) -> TransformedEnv:
    """Add ``"nodes"`` ``[N, history * F]`` (oldest frame first), in float32, to an environment's observation.

    Args:
        env: A ``DMControlEnv``, or a ``GymEnv`` of a MuJoCo robot, without transforms.
        history: Number of frames stacked.
        static: Whether to append :meth:`NodeSensor.static` to them. An equivariant network then needs
            ``Reflection.from_robot(robot, static=len(STATIC))``.
        feet: Names of the bodies that may touch the ground; ``None`` for those that the robot stands on in the pose of
            its model, which may be lying.
        forward: Forward axis, ``x``, ``-x``, ``y`` or ``-y`` of the world; ``None`` to detect it.

    Returns:
        The environment; ``env.transform[0].sensor.graph`` is the graph for the networks, ``.robot`` its robot.

    Raises:
        ConfigError: If the environment is not one of these.
        RobotError: If the simulated model is not a robot, or has no such feet.
    """
    nodes = Nodes(env, feet, forward)
    transforms: list[Transform] = [nodes, DoubleToFloat()]
    if history > 1:
        transforms.append(CatFrames(N=history, dim=-1, in_keys=["nodes"], padding="same"))
    if static:
        transforms.append(StaticNodes(nodes.sensor))
    return TransformedEnv(env, Compose(*transforms))


def sensor_of(env: EnvBase, feet: Sequence[str] | None = None, forward: Axis | None = None) -> NodeSensor:
    """Create the node sensor of an environment; ``feet`` and ``forward`` as for :class:`NodeSensor`.

    Raises:
        ConfigError: If it has no MuJoCo simulator, or more than one.
        RobotError: If the simulated model is not a robot, or has no such feet.
    """
    return NodeSensor(simulator(env)[0], feet, forward)


def simulator(env: EnvBase) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Return the simulator's present model and data: some tasks build a new model at a reset.

    Raises:
        ConfigError: If there is no MuJoCo simulator, or more than one.
    """
    # A transformed environment would pass attribute access on to the environment inside it.
    inner: Any = None if isinstance(env, TransformedEnv) else wrapped_env(env)
    if physics := getattr(inner, "physics", None):
        return physics.model.ptr, physics.data.ptr
    inner = getattr(inner, "unwrapped", None)
    model, data = getattr(inner, "model", None), getattr(inner, "data", None)
    if isinstance(model, mujoco.MjModel) and isinstance(data, mujoco.MjData) and not env.batch_size:
        return model, data
    raise ConfigError(
        f"Nodes are read from a DMControlEnv or from a GymEnv of one MuJoCo robot, got {type(env).__name__} "
        f"of batch size {list(env.batch_size)}; put transforms and several robots around it, not below it."
    )
