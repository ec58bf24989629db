"""Both nodes: the simulator in this process, the policy in one of its own, over a master of their own in ROS 1."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields, replace

import gctd3
from gctd3.bridge.names import layout_of
from gctd3.bridge.network import choose_for
from gctd3.bridge.policy_node import check_commands
from gctd3.bridge.settings import RosSettings
from gctd3.bridge.simulator_node import run_simulator
from gctd3.bridge.walk import Walk
from gctd3.deploy.policy import Policy
from gctd3.errors import MiddlewareError

LEAVES = 15.0  # within which the policy's node has ended by itself (s)


def run_both(settings: RosSettings) -> Walk:
    """Run both nodes until the walk ends.

    Raises:
        ContractError: If the policy is missing, or for another robot.
        MiddlewareError: If ROS is missing, or a node has fallen silent.
    """
    # Before processes are started.
    policy = Policy(settings.policy)
    check_commands(policy)
    middleware = choose_for(settings.middleware, layout_of(policy.contract, settings.names))
    master = None
    if middleware == "ros1":
        from gctd3.bridge.ros1 import start_master

        master = start_master(settings.listen)
    follower = subprocess.Popen(policy_command(replace(settings, middleware=middleware)))
    try:
        walk = run_simulator(replace(settings, node="simulator", middleware=middleware))
        code = follower.wait(LEAVES)
    except subprocess.TimeoutExpired as error:
        raise MiddlewareError(f"The policy's node has not ended {LEAVES:g} s after the walk.") from error
    except MiddlewareError as error:
        left = follower.poll()
        if left is None:
            raise
        raise MiddlewareError(f"{error} The policy's node has ended with exit code {left}.") from error
    finally:
        if follower.poll() is None:
            follower.kill()
            follower.wait()
        if master is not None:
            master.stop()
    if code:
        raise MiddlewareError(f"{walk.summary()}\nThe policy's node ended with exit code {code}.")
    return walk


def policy_command(settings: RosSettings) -> list[str]:
    """Return the command line of the policy's node."""
    given = {
        field.name: getattr(settings, field.name)
        for field in fields(settings)
        if getattr(settings, field.name) != field.default and field.name not in ("node", "run", "seed", "seconds")
    }
    words = [f"{key}={str(value).lower() if isinstance(value, bool) else value}" for key, value in given.items()]
    return [sys.executable, "-m", f"{gctd3.__name__}.ros", "node=policy", *words]
