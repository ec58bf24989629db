"""Read a damaged robot's file; if it is accepted, compare it with MuJoCo's tree, both backends, and its reflection."""

import mujoco
import numpy as np

from gctd3.envs import dmc
from gctd3.envs.simulation import Simulation
from gctd3.errors import GCTD3Error
from gctd3.robots.graph import KinematicGraph
from gctd3.robots.mirror_check import MOST_RESIDUAL, check_mirror
from gctd3.robots.settings import RobotSettings
from gctd3.tasks.walk import WalkingTask

STEPS, STATES = 4, 12
MORE = 3.0  # times the residual that is stated, of 200 other states
ROUNDED = 0.03  # of the motion of one step: the solver's tolerance where nothing differs


def check(file):
    """Read the robot of a file, as ``robot=FILE`` does."""
    try:
        settings = RobotSettings(file)
        robot = settings.load()
        graph = KinematicGraph.from_robot(robot)
        task = WalkingTask(robot, graph=graph)
        verdict = check_mirror(robot, task.control_dt)
        simulation = Simulation(task, 1, seed=3, threads=1)
    except GCTD3Error as error:
        message = str(error)
        return "refused" if message.strip() else "defect: a refusal without a word"
    found = unlike_the_tree(graph, robot) or unlike_backends(task, simulation) or unlike_reflection(task, verdict)
    return f"defect: {found}" if found else "ok"


def unlike_the_tree(graph, robot):
    """Compare the edges with those found by walking up MuJoCo's tree from each joint."""
    model, nodes = robot.model, list(graph.nodes)
    if len(set(nodes)) != len(nodes):
        return f"nodes {nodes} are not different"
    by_id = {joint.id: joint.name for joint in robot.joints}
    if not set(by_id.values()) <= set(nodes):
        return f"joints {sorted(set(by_id.values()) - set(nodes))} are no nodes"
    wanted = set()
    for number, name in by_id.items():
        body = int(model.jnt_bodyid[number])
        above = [i for i in range(int(model.body_jntadr[body]), number) if i in by_id]
        while not above and body:
            body = int(model.body_parentid[body])
            first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
            above = [i for i in range(first, first + count) if i in by_id]
        wanted.add(frozenset((name, by_id[above[-1]] if above else nodes[0])))
    inside = {nodes[0], *by_id.values()}
    found = {frozenset(edge) for edge in graph.edges if set(edge) <= inside}
    return "" if found == wanted else f"edges {found ^ wanted} are not those of MuJoCo's tree"


def unlike_backends(task, simulation):
    """Step the same start by the same actions on both backends, which have to agree to the bit."""
    simulation.reset(np.ones(1, dtype=bool))
    env = dmc.load(task, random=0)
    env.reset()
    env.physics.data.qpos[:], env.physics.data.qvel[:] = simulation.qpos[0], simulation.qvel[0]
    env.physics.data.act[:] = simulation.state[0, 1 + task.robot.model.nq + task.robot.model.nv :][
        : task.robot.model.na
    ]
    env.task.restart(env.physics)
    rng = np.random.default_rng(0)
    for step in range(STEPS):
        action = rng.uniform(-1.0, 1.0, len(task.robot.actuated))
        outcome, other = simulation.step(action[None]), env.step(action)
        ended = bool(outcome.terminated[0] or outcome.truncated[0])
        if ended != other.last() or bool(outcome.diverged[0]) != bool(other.observation["diverged"][0]):
            return f"step {step} ends on one backend: {outcome}"
        if bool(outcome.diverged[0]):
            return ""
        # A warm start is no part of a simulator's state: with it they agree as far as the solver's tolerance.
        cold = task.robot.model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_WARMSTART
        tolerance = 0.0 if cold else 1e-5
        rewards, places = (float(outcome.reward[0]), other.reward), (simulation.qpos[0], env.physics.data.qpos)
        if not np.allclose(*rewards, 0.0, 100 * tolerance) or not np.allclose(*places, 0.0, tolerance):
            return f"step {step} differs by {np.abs(simulation.qpos[0] - env.physics.data.qpos).max():g}"
        if ended:
            return ""
    return ""


def unlike_reflection(task, verdict):
    """Reflect and step, and step and reflect: the motions of a robot that is said to be symmetric are the same."""
    robot = task.robot
    if not verdict.symmetric or robot.base.kind not in ("boom", "planar", "free") or robot.model.na:
        return ""
    model, data = robot.model, mujoco.MjData(robot.model)
    order, signs = robot.action_mirror
    substeps = round(task.control_dt / model.opt.timestep)
    rng, differences, motions = np.random.default_rng(5), 0.0, 0.0

    def stepped(qpos, qvel, action):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, robot.desired_angles(action)
        mujoco.mj_step(model, data, substeps)
        return np.array(data.qpos), np.array(data.qvel)

    for _ in range(STATES):
        qpos, qvel = task.start(rng)
        action = rng.uniform(-1.0, 1.0, len(order))
        after = reflected(robot, *stepped(qpos, qvel, action))
        other = stepped(*reflected(robot, qpos, qvel), signs * action[order])
        mass = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        difference, motion = after[1] - other[1], other[1] - reflected(robot, qpos, qvel)[1]
        differences += float(difference @ mass @ difference)
        motions += float(motion @ mass @ motion)
    if not np.isfinite(differences) or motions == 0.0:
        return ""  # it diverges, or hangs still
    residual = np.sqrt(differences / motions)
    most = max(ROUNDED, MORE * (verdict.residual if verdict.reason else 0.0))
    return "" if residual <= min(most, MORE * MOST_RESIDUAL) else f"residual {residual:.3g}, stated: {verdict}"


def matrix(quaternion):
    found = np.zeros(9)
    mujoco.mju_quat2Mat(found, quaternion)
    return found.reshape(3, 3)


def reflected(robot, qpos, qvel):
    """Return the mirror image of a state, by linear algebra: the plane holds the forward and the up axis."""
    model = robot.model
    flip = np.eye(3) - 2.0 * np.outer(robot.base.frame[1], robot.base.frame[1])
    place, speed = qpos.copy(), qvel.copy()
    by_name = {joint.name: joint for joint in robot.joints}
    for joint in robot.joints:
        other, sign = by_name[robot.mirror[joint.name]], robot.mirror_sign(joint.name)
        place[joint.qpos], speed[joint.qvel] = sign * qpos[other.qpos], sign * qvel[other.qvel]
    for number in np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE):
        q, v = int(model.jnt_qposadr[number]), int(model.jnt_dofadr[number])
        stand = np.asarray(robot.standing_qpos)
        still, now = matrix(stand[q + 3 : q + 7]), matrix(qpos[q + 3 : q + 7])
        turned = flip @ now @ still.T @ flip @ still
        place[q : q + 3] = stand[q : q + 3] + flip @ (qpos[q : q + 3] - stand[q : q + 3])
        mujoco.mju_mat2Quat(place[q + 3 : q + 7], turned.ravel())
        speed[v : v + 3] = flip @ qvel[v : v + 3]
        speed[v + 3 : v + 6] = turned.T @ (-flip @ (now @ qvel[v + 3 : v + 6]))
    return place, speed
