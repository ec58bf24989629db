"""Settings of the nodes of ROS; needs the standard library only."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from gctd3.errors import ConfigError, check_between, check_seed

Node = Literal["simulator", "policy", "both"]
Distribution = Literal["auto", "ros1", "ros2"]
Clock = Literal["lockstep", "wall"]
Names = Literal["contract", "paper", "authors"]


@dataclass(frozen=True)
class RosSettings:
    """Hold the settings of ``gctd3.ros``.

    Attributes:
        node: ``policy``: the exported policy, which needs NumPy, onnxruntime and ROS only; ``simulator``: the robot in
            MuJoCo in place of a real one; ``both``: the simulator here, and the policy in a process of its own, with a
            master of their own in ROS 1.
        middleware: ``ros1`` (rospy), ``ros2`` (rclpy), or ``auto`` for the one that can be imported, ROS 1 first.
        policy: ONNX file that gctd3.export wrote, with its contract beside it; a simulator reads the contract only.
        run: Directory of the run whose robot and task are simulated; ``None`` for the walking biped that ships with
            gctd3.
        clock: ``lockstep``: simulator and policy wait for each other in every control step, so that results do not
            depend on the machine; ``wall``: both keep to the time of day, as a real robot does.
        names: Topics: ``contract``, from the names of the policy's readings and joints, for any robot; ``paper`` and
            ``authors``, those of the paper and of its authors' program, for the biped.
        listen: Address at which nodes listen in ROS 1; ``None`` for what the variable ROS_IP or ROS_HOSTNAME says, else
            127.0.0.1, where nobody else reaches them.
        wait: Time for which a node waits until the other one is there (s).
        patience: Time without a good message from the other node after which a node gives up, with the safe command of
            the contract (s).
        command_timeout: Time after which a velocity on ``/cmd_vel`` that is not repeated counts as 0 (s).
        home_first: Whether the policy's node moves the robot to its home pose before it walks; simulators start there.
        seed: Seed of the simulated robot's start; ``None`` for the start pose itself.
        seconds: Simulated time after which the walk ends (s); ``None`` for the time limit of the task.
    """

    node: Node = "both"
    middleware: Distribution = "auto"
    policy: str = "policy.onnx"
    run: str | None = None
    clock: Clock = "lockstep"
    names: Names = "contract"
    listen: str | None = None
    wait: float = 30.0
    patience: float = 2.0
    command_timeout: float = 0.5
    home_first: bool = False
    seed: int | None = None
    seconds: float | None = None

    def __post_init__(self) -> None:
        if Path(self.policy).suffix != ".onnx":
            raise ConfigError(f"policy must be the .onnx file that gctd3.export writes, got {self.policy!r}.")
        check_between(self, 0.1, 3600.0, "wait", "patience", "command_timeout")
        if self.seed is not None:
            check_seed("seed", self.seed)
        if self.seconds is not None and not self.seconds > 0:
            raise ConfigError(f"seconds must be above 0, or null, got {self.seconds}.")
