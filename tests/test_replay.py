"""Replay: n-step arithmetic by hand, and reflections against a simulation of the mirrored robot."""

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from tensordict import TensorDict
from torchrl.collectors import Collector

from gctd3.envs.factory import EnvSettings, build_env
from gctd3.envs.gait import Endings, Reward, WalkingTask
from gctd3.envs.simulation import Simulation
from gctd3.errors import ConfigError
from gctd3.exploration import ExplorationSettings, Explorer
from gctd3.nn import make_actor
from gctd3.replay import ENDS, KEPT, Mirror, Replay, ReplaySettings
from gctd3.robot import Robot

# n-step windows. Every reward is 2^t and gamma is 0.5, so a window that begins at t sums to 2^t times its length.
GAMMA = 0.5


def episode(robots, time, terminated=(), truncated=()):
    """What a collector delivers; nodes hold ``t``, next nodes ``t + 0.5``; endings are pairs (robot, t)."""
    t = torch.arange(float(time)).expand(robots, time)[..., None]
    number = torch.arange(float(robots))[:, None, None].expand(robots, time, 1)
    ends = {"terminated": torch.zeros(robots, time, 1, dtype=torch.bool)}
    ends["truncated"] = ends["terminated"].clone()
    for name, pairs in (("terminated", terminated), ("truncated", truncated)):
        for pair in pairs:
            ends[name][pair] = True
    following = {"nodes": t[..., None] + 0.5, "counters": number, "reward": 2.0**t, **ends}
    following |= {"done": ends["terminated"] | ends["truncated"], "position": t, "step_count": t}
    return TensorDict(
        {
            "nodes": t[..., None],
            "counters": number,
            "action": -t,
            "is_init": t == 0,
            "step_count": t,
            "next": following,
        },
        [robots, time],
    )


def content(collected, n_step, sizes):
    """What a replay holds after the steps came in chunks of ``sizes``, ordered by robot and time."""
    replay = Replay(ReplaySettings(capacity=10_000, batch_size=1, n_step=n_step, storage="stacked"), GAMMA)
    for chunk in collected.split(list(sizes), dim=1):
        replay.extend(chunk.clone())
    held = replay.buffer[:]
    order = sorted(range(len(held)), key=lambda i: (float(held["counters"][i]), float(held["nodes"][i].flatten()[0])))
    return held[order]


CHUNKS = [(8,), (1,) * 8, (3, 5), (2, 2, 2, 2), (1, 7), (7, 1), (4, 1, 3)]


@pytest.mark.parametrize("sizes", CHUNKS, ids=str)
def test_three_step_windows_by_hand(sizes):
    # Robot 0 goes on, robot 1 terminates at t = 2, robot 2 is truncated at t = 3; of 8 steps the first 5 have left.
    #  t  reward           next nodes  steps  terminated  truncated
    expected = [
        [(0, 3 * 1.0, 2.5, 3, False, False),  # 1 + 2/2 + 4/4
         (1, 3 * 2.0, 3.5, 3, False, False),
         (2, 3 * 4.0, 4.5, 3, False, False),
         (3, 3 * 8.0, 5.5, 3, False, False),
         (4, 3 * 16., 6.5, 3, False, False)],
        [(0, 3 * 1.0, 2.5, 3, True, False),   # its last step is the terminal one
         (1, 2 * 2.0, 2.5, 2, True, False),   # 2 + 4/2, cut short
         (2, 1 * 4.0, 2.5, 1, True, False),
         (3, 3 * 8.0, 5.5, 3, False, False),  # the next episode
         (4, 3 * 16., 6.5, 3, False, False)],
        [(0, 3 * 1.0, 2.5, 3, False, False),  # ends one step before the cut
         (1, 3 * 2.0, 3.5, 3, False, True),
         (2, 2 * 4.0, 3.5, 2, False, True),
         (3, 1 * 8.0, 3.5, 1, False, True),
         (4, 3 * 16., 6.5, 3, False, False)],
    ]  # fmt: skip
    held = content(episode(3, 8, terminated=[(1, 2)], truncated=[(2, 3)]), 3, sizes)
    rows = [
        tuple(float(value.flatten()[0]) for value in values)
        for values in zip(
            *(held[key] for key in ("counters", "nodes", ("next", "reward"), ("next", "nodes"), "steps_to_next_obs")),
            *(held["next", key] for key in ("terminated", "truncated", "done")),
            strict=True,
        )
    ]
    assert rows == [(robot, *row, row[4] or row[5]) for robot, rows_ in enumerate(expected) for row in rows_]
    assert torch.equal(held["action"], -held["nodes"].flatten(1))


@given(
    st.integers(1, 5),
    st.lists(st.integers(1, 9), min_size=1, max_size=12),
    st.floats(0.0, 0.5),
    st.integers(0, 2**31),
)
def test_windows_of_any_length_in_chunks_of_any_size(n, sizes, share, seed):
    torch.manual_seed(seed)
    collected = episode(2, sum(sizes))
    for name in ("terminated", "truncated"):
        collected["next", name] = torch.rand(2, sum(sizes), 1) < share / 2
    collected["next", "done"] = collected["next", "terminated"] | collected["next", "truncated"]
    collected["next", "reward"] = torch.randn(2, sum(sizes), 1)
    replay = Replay(ReplaySettings(capacity=1000, batch_size=1, n_step=n, storage="stacked"), GAMMA)
    for chunk in collected.split(sizes, dim=1):
        replay.extend(chunk.clone())
    ready = sum(sizes) - n if n > 1 else sum(sizes)
    assert len(replay) == 2 * max(ready, 0)
    if ready <= 0:
        return
    for step in replay.buffer[:]:
        robot, begin = int(step["counters"]), int(step["nodes"])
        reward, end, following = 0.0, begin, collected["next"][robot]
        for k in range(n):
            end = begin + k
            reward += GAMMA**k * float(following["reward"][end])
            if following["done"][end]:
                break
        assert float(step["next", "reward"]) == pytest.approx(reward, abs=1e-5)
        for key in ("nodes", "counters", "done", "terminated", "truncated"):
            assert torch.equal(step["next", key], following[key][end])
        assert n == 1 or int(step["steps_to_next_obs"]) == end - begin + 1


def test_a_collector_may_deliver_one_step_at_a_time(robot, graph):
    """What TorchRL's collector delivers is not overwritten by what it delivers next."""

    def collect(steps):
        torch.manual_seed(0)
        env = build_env(robot, EnvSettings(num_envs=4, threads=1, endings=Endings(time_limit=9)), Reward(), seed=0)
        explorer = Explorer(make_actor(graph), robot, 4, ExplorationSettings(warmup_frames=40))
        replay = Replay(ReplaySettings(capacity=1000, batch_size=4, n_step=3, storage="stacked"), 0.9)
        collector = Collector(env, explorer, frames_per_batch=4 * steps, total_frames=4 * 24)
        for collected in collector:
            replay.extend(collected)
        collector.shutdown()
        held = replay.buffer[:].exclude("index")
        return held[sorted(range(len(held)), key=lambda i: held["nodes"][i].flatten().tolist())]

    one, many = collect(1), collect(8)
    assert len(one) == 4 * (24 - 3)
    assert set(one.keys(True, True)) == set(many.keys(True, True))
    for key in one.keys(True, True):
        assert torch.equal(one[key], many[key]), key
    assert one["next", "truncated"].any()


# What is kept.


@pytest.mark.parametrize("n_step", [1, 3])
def test_keeps_what_updates_read_and_nothing_else(n_step):
    held = content(episode(2, 6), n_step, [6])
    extra = {"steps_to_next_obs"} if n_step > 1 else set()
    assert set(held.keys(True, True)) - {"index"} == {*KEPT, *ENDS, *extra}


def test_the_oldest_leave_first():
    replay = Replay(ReplaySettings(capacity=5, batch_size=3, storage="stacked"), GAMMA)
    steps = episode(1, 8)
    for t in range(8):
        replay.extend(steps[:, t : t + 1])
        assert len(replay) == min(t + 1, 5)
    assert sorted(replay.buffer[:]["nodes"].flatten().tolist()) == [3, 4, 5, 6, 7]
    assert {float(v) for _ in range(40) for v in replay.sample()["nodes"]} == {3, 4, 5, 6, 7}


def test_batch_size():
    replay = Replay(ReplaySettings(capacity=50, batch_size=17, storage="stacked"), GAMMA)
    replay.extend(episode(2, 3))
    assert replay.sample().batch_size == (17,)


@pytest.mark.parametrize("key, value", [("capacity", 0), ("batch_size", 0), ("n_step", 0), ("batch_size", 2_000_000)])
def test_settings_out_of_range(key, value):
    with pytest.raises(ConfigError, match=rf"replay\.{key}.*{value}"):
        ReplaySettings(**{key: value})


# The mirror.

HISTORY = 3


@pytest.fixture(scope="module", params=["biped", "opposite axes"])
def biped(request, robot, tmp_path_factory):
    """The biped, and the same robot with the left joints' axes turned round: equal motions have opposite angles."""
    if request.param == "biped":
        return robot
    text = robot.path.read_text()
    for joint, limits in (("hip", "-0.7854 0.7854"), ("knee", "-0.0012 1.3962"), ("ankle", "-0.7854 0.7854")):
        for tag, new in (("joint", f'axis="0 1 0" range="{limits}"'), ("position", f'ctrlrange="{limits}"')):
            old = f'<{tag} name="{joint}_left" class="{joint}"'
            assert old in text
            text = text.replace(old, f"{old} {new}")
    path = tmp_path_factory.mktemp("robot") / "opposite.xml"
    path.write_text(text)
    return Robot.from_mjcf(path)


def mirrored_pair(robot):
    """Two robots, the second in the mirrored state of the first."""
    task = WalkingTask(robot)
    simulation = Simulation(task, 2, seed=3, threads=1)
    simulation.reset(np.ones(2, dtype=bool))
    model, state = robot.model, simulation.state
    state[1] = state[0]
    for joint in robot.joints:
        partner, sign = robot.joint(robot.mirror_name(joint.name)), robot.mirror_sign(joint.name)
        state[1, 1 + partner.qpos] = sign * state[0, 1 + joint.qpos]  # time comes first
        state[1, 1 + model.nq + partner.qvel] = sign * state[0, 1 + model.nq + joint.qvel]
    sensors, data = np.zeros((2, model.nsensordata)), mujoco.MjData(model)
    for i in range(2):
        mujoco.mj_setState(model, data, state[i], mujoco.mjtState.mjSTATE_FULLPHYSICS.value)
        mujoco.mj_forward(model, data)
        sensors[i] = data.sensordata
    qpos, qvel = state[:, 1 : 1 + model.nq], state[:, 1 + model.nq : 1 + model.nq + model.nv]
    simulation.now = task.measure(qpos, qvel, sensors)
    simulation.progress = task.begin(simulation.now)
    return simulation


def test_reflection_is_what_the_mirrored_robot_sees(biped):
    simulation, mirror = mirrored_pair(biped), Mirror(biped, HISTORY)
    task, (order, sign), rng = simulation.task, biped.action_mirror, np.random.default_rng(0)
    frames = [task.node_features(simulation.now)] * HISTORY
    ended, seen = False, []
    for t in range(80):
        if t % 5 == 0:
            action = rng.uniform(-1.0, 1.0, len(order))
        both = np.stack([action, sign * action[order]])
        reflected = mirror.reflect("action", torch.from_numpy(both[:1]))
        np.testing.assert_array_equal(reflected, both[1:])
        outcome = simulation.step(both)
        frames = [*frames[1:], task.node_features(simulation.now)]
        nodes, counters = np.concatenate(frames, axis=-1), task.counters(simulation.progress)
        for key, values in (("nodes", nodes), ("counters", counters)):
            values = torch.from_numpy(values)
            torch.testing.assert_close(mirror.reflect(key, values[:1]), values[1:], rtol=0.0, atol=1e-5)
        assert outcome.reward[0] == pytest.approx(outcome.reward[1], abs=1e-6)
        assert outcome.terminated[0] == outcome.terminated[1]
        ended |= bool(outcome.terminated[0])
        seen.append(counters[0])
    contact = np.stack(seen)[:, :2]
    assert ended and np.abs(contact[:, 0] - contact[:, 1]).max() > 0.1  # an ending, and no symmetric walk


@pytest.mark.parametrize("key, shape", [("nodes", (8, 2 * HISTORY)), ("counters", (4,)), ("action", (6,))])
def test_reflecting_twice_changes_nothing(biped, key, shape):
    mirror, values = Mirror(biped, HISTORY), torch.randn(5, *shape)
    once = mirror.reflect(key, values)
    assert not torch.equal(once, values)
    assert torch.equal(mirror.reflect(key, once), values)


def transitions(size):
    def state():
        return {"nodes": torch.randn(size, 8, 2 * HISTORY), "counters": torch.randn(size, 4)}

    flags = {key: torch.rand(size, 1) < 0.5 for key in ("done", "terminated", "truncated")}
    following = {**state(), "reward": torch.randn(size, 1), **flags}
    return TensorDict({**state(), "action": torch.randn(size, 6), "next": following}, [size])


@pytest.mark.parametrize("size", [6, 7])
def test_only_the_second_half_of_a_batch_is_mirrored(biped, size):
    mirror, seen = Mirror(biped, HISTORY), transitions(size)
    batch, half = mirror(seen.clone()), size // 2
    for key in seen.keys(True, True):
        name = key if isinstance(key, str) else key[-1]
        kept = name in ("reward", "done", "terminated", "truncated")
        assert torch.equal(batch[key][:half], seen[key][:half])
        expected = seen[key][half:] if kept else mirror.reflect(name, seen[key][half:])
        assert torch.equal(batch[key][half:], expected), key


def test_sampling_mirrors_copies_and_not_what_is_remembered(biped):
    mirror, seen = Mirror(biped, HISTORY), transitions(1)
    replay = Replay(ReplaySettings(capacity=10, batch_size=4, mirror=True, storage="stacked"), GAMMA, mirror)
    replay.extend(seen[:, None])
    for _ in range(3):
        nodes = replay.sample()["nodes"]
        reflected = mirror.reflect("nodes", seen["nodes"])
        assert torch.equal(nodes, torch.cat([seen["nodes"]] * 2 + [reflected] * 2))
