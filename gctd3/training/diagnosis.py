"""Find out why episodes of a simulated task fail: which joint diverges, or which termination ends them, and when."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import mujoco
import numpy as np

from gctd3.envs.simulation import substeps_of
from gctd3.robots.actuators import rest_servos
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.tasks.task import Task
from gctd3.training.give_up import DIVERGED, EQUAL, Seen

if TYPE_CHECKING:
    from gctd3.training.settings import TrainSettings

ATTEMPTS, STEPS = 10, 200  # episodes, and control steps of each, in which the failure has to show
# MuJoCo's warnings by which a simulation is no longer one, and what they find in it.
_WARNINGS = {
    mujoco.mjtWarning.mjWARN_BADQPOS: "position",
    mujoco.mjtWarning.mjWARN_BADQVEL: "velocity",
    mujoco.mjtWarning.mjWARN_BADQACC: "acceleration",
}


def why_given_up(failure: str, seen: Seen, settings: TrainSettings, task: Task, frames: int) -> str:
    """Say why a training cannot succeed, what to look at, and which setting judged it.

    Args:
        failure: The way in which it fails, from :meth:`.Watch.judge`.
        seen: What its first batches showed.
        settings: Settings of the training.
        task: Its task.
        frames: Frames collected so far.
    """
    begun = f"After {frames:,} steps this training is given up"
    if failure == EQUAL:
        return (
            f"{begun}: every reward was {seen.reward_low:g}, so there is nothing to learn from. Look at reward.terms "
            f"({', '.join(settings.reward.terms)}); give_up.reward_frames=null trains on."
        )
    simulated = cast(SimulatedTask, task) if "film" in task.abilities else None
    if failure == DIVERGED:
        what = f"the simulation of {seen.diverged} of the first {seen.episodes} episodes diverged"
        why = f"Look at {task.name}" if simulated is None else why_it_diverges(simulated, settings.seed)
    else:
        limit = f"{settings.give_up.steps} control step{'s' * (settings.give_up.steps > 1)}"
        what = f"{seen.short} of the first {seen.episodes} episodes ended within {limit}"
        why = f"Look at the starts of {task.name}" if simulated is None else why_it_ends(simulated, settings.seed)
    return f"{begun}: {what}. {why}. give_up.episodes=null trains on."


def why_it_diverges(task: SimulatedTask, seed: int) -> str:
    """Simulate robots with random actions until MuJoCo warns of one, and say of which joint and when."""
    accelerations: list[np.ndarray] = []
    for model, data, step in _episodes(task, seed):
        accelerations = [*accelerations[-1:], np.abs(data.qacc)]
        for warning, quantity in _WARNINGS.items():
            if data.warning[warning].number:
                return (
                    f"MuJoCo's {warning.name.removeprefix('mjWARN_')} {_time(data)} after a start (control step "
                    f"{step + 1}), of NaN, infinite or huge {quantity}. It is {_place(model, accelerations)} that "
                    f"accelerates most. Look at the gains, masses and armature there, and at the timestep of "
                    f"{model.opt.timestep:g} s"
                )
    return f"No warning of MuJoCo's shows in {ATTEMPTS} episodes of {STEPS} random actions"


def why_it_ends(task: SimulatedTask, seed: int) -> str:
    """Simulate robots with random actions until an episode ends, and say by which termination, when and where."""
    alone = {name: _only(task, name) for name, term in task.terminations.items() if not term.truncates}
    memories: dict[str, Any] = {}
    for _, data, step in _episodes(task, seed):
        now = task.measure(np.array(data.qpos), np.array(data.qvel), np.array(data.sensordata))
        if step < 0:
            memories = {name: one.begin(now, np.random.default_rng(seed)) for name, one in alone.items()}
            continue
        for name, one in alone.items():
            memories[name], outcome = one.advance(memories[name], now, rng=np.random.default_rng(seed))
            if outcome.terminated:
                return (
                    f"task.terminations.{name} ends an episode {_time(data)} after its start: {_state(task, data, now)}"
                )
    return f"None of {', '.join(alone)} ends one of {ATTEMPTS} episodes of {STEPS} random actions"


def _episodes(task: SimulatedTask, seed: int) -> Iterator[tuple[mujoco.MjModel, mujoco.MjData, int]]:
    """Yield model and data at the start of each episode, as step -1, and after each control step."""
    robot, rng = task.robot, np.random.default_rng(seed)
    model = copy.deepcopy(task.stage.model)
    # The state in which it warns is looked at, so it must stay.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    substeps = substeps_of(task.control_dt, robot)
    data = mujoco.MjData(model)
    for _ in range(ATTEMPTS):
        mujoco.mj_resetData(model, data)
        qpos, data.qvel[:] = task.start(rng)
        data.qpos[:] = task.put(qpos, task.first())
        rest_servos(model, data)
        mujoco.mj_forward(model, data)
        yield model, data, -1
        for step in range(STEPS):
            data.ctrl[:] = robot.desired_angles(rng.uniform(-1.0, 1.0, model.nu))
            for _ in range(substeps):
                mujoco.mj_step(model, data)
                if any(data.warning[warning].number for warning in _WARNINGS):
                    break
            yield model, data, step
            if any(data.warning[warning].number for warning in _WARNINGS):
                break


def _only(task: SimulatedTask, name: str) -> SimulatedTask:
    """Return the task with one of its terminations."""
    kept = {n: term if n == name else None for n, term in task.settings.terminations.items()}
    return type(task)(task.robot, task.reward, replace(task.settings, terminations=kept), task.graph)


def _place(model: mujoco.MjModel, accelerations: Sequence[np.ndarray]) -> str:
    """Name the joint that accelerates most at the last moment when all numbers were finite; the body if it is free.

    MuJoCo's own warning names the first joint of the robot, since the others' forces have reached it by then.
    """
    finite = [values for values in accelerations if np.isfinite(values).all()]
    joint = int(model.dof_jntid[int(np.argmax(finite[-1]))]) if finite else 0
    body = model.body(int(model.jnt_bodyid[joint])).name or f"number {int(model.jnt_bodyid[joint])}"
    if int(model.jnt_type[joint]) == mujoco.mjtJoint.mjJNT_FREE:
        return f"the free body {body}"
    return f"joint {model.joint(joint).name or joint} of body {body}"


def _time(data: mujoco.MjData) -> str:
    return f"{data.time:.3g} s"


def _state(task: SimulatedTask, data: mujoco.MjData, now: Any) -> str:  # noqa: ANN401 - a Measurement
    """Describe the robot: bodies besides its feet that touch something, height and tilt."""
    robot = task.robot
    down = [body for body in robot.other_contact_bodies if data.sensordata[robot.contact_sensors((body,))[0]] > 0]
    touching = f"{', '.join(down)} on the ground, " if down else ""
    return (
        f"{touching}body {float(now.height):+.2g} m from its standing height, tilted by "
        f"{np.degrees(float(now.tilt)):.2g} degrees"
    )
