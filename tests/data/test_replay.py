"""Replay: n-step arithmetic by hand, and reflections against a simulation of the mirrored robot."""

import mujoco
import numpy as np
import pytest
import torch
from compositions import env_of, walking
from hypothesis import given
from hypothesis import strategies as st
from robots import opposite_axes
from tensordict import TensorDict
from thinned import parametrize
from torchrl.collectors import Collector

from gctd3.data.exploration import Explorer
from gctd3.data.mirror_augmentation import MirrorAugmentation
from gctd3.data.replay import ENDS, KEPT, Replay
from gctd3.data.settings import ExplorationSettings, ReplaySettings
from gctd3.envs.simulation import Simulation
from gctd3.errors import ConfigError
from gctd3.nn import make_actor

STORAGES = ("frames", "stacked")
GAMMA = 0.5


def flags(robots, time, *places):
    """Return bool ``[robots, time]``, true at each (robot, t)."""
    mask = torch.zeros(robots, time, dtype=torch.bool)
    for place in places:
        mask[place] = True
    return mask


def episodes(terminated, truncated):
    """Make a collector's batch: nodes hold the time, an episode's last ones half a step more; counters the robot."""
    robots, time = terminated.shape
    ends = {"terminated": terminated[..., None], "truncated": truncated[..., None]}
    ends["done"] = ends["terminated"] | ends["truncated"]
    t = torch.arange(float(time)).expand(robots, time)[..., None]
    number = torch.arange(float(robots))[:, None, None].expand(robots, time, 1)

    def nodes(time):
        return time[..., None].expand(robots, -1, 1, 2)

    root = {"nodes": nodes(t), "counters": number, "action": -t, "is_init": t == 0, "step_count": t, "position": t}
    after = torch.where(ends["done"], t + 0.5, t + 1.0)
    following = {"nodes": nodes(after), "counters": number, "reward": 2.0**t, "position": after, **ends}
    return TensorDict({**root, "next": following}, [robots, time])


def filled(storage, collected, sizes, n_step, capacity=1000, history=1, gamma=GAMMA):
    """Fill a replay with the collected steps in chunks of the given sizes."""
    settings = ReplaySettings(buffer_size=capacity, batch_size=1, n_step=n_step, mirror=False, storage=storage)
    replay = Replay(settings, gamma, history)
    for chunk in collected.split(list(sizes), dim=1):
        replay.extend(chunk.clone())
    return replay


def held(replay):
    """Return all transitions that can be drawn, ordered by robot, then by time."""
    if replay.settings.storage == "stacked":
        content = replay.buffer.torchrl[:].exclude("index")
    else:
        rows, robots = torch.arange(replay.buffer.ready), replay.buffer.robots
        content = replay.buffer.gather(rows.repeat(robots), torch.arange(robots).repeat_interleave(len(rows)))
    key = torch.cat([content["counters"], content["nodes"].flatten(1)], dim=1).tolist()
    return content[sorted(range(len(content)), key=key.__getitem__)]


CHUNKS = [(8,), (1,) * 8, (3, 5), (2, 2, 2, 2), (1, 7), (7, 1), (4, 1, 3)]


@pytest.mark.parametrize("sizes", CHUNKS, ids=str)
@pytest.mark.parametrize("storage", STORAGES)
def test_three_step_windows_by_hand(storage, sizes):
    # Every reward is 2^t and gamma is 0.5: a window that begins at t sums to 2^t times its length.
    # Robot 0 goes on, robot 1 terminates at t = 2, robot 2 is truncated at t = 3; of 8 steps the first 5 are complete.
    #  t  reward           next nodes  steps  terminated  truncated
    expected = [
        [(0, 3 * 1.0, 3.0, 3, False, False),  # 1 + 2/2 + 4/4
         (1, 3 * 2.0, 4.0, 3, False, False),
         (2, 3 * 4.0, 5.0, 3, False, False),
         (3, 3 * 8.0, 6.0, 3, False, False),
         (4, 3 * 16., 7.0, 3, False, False)],
        [(0, 3 * 1.0, 2.5, 3, True, False),   # its last step is the terminal one
         (1, 2 * 2.0, 2.5, 2, True, False),   # 2 + 4/2, cut short
         (2, 1 * 4.0, 2.5, 1, True, False),
         (3, 3 * 8.0, 6.0, 3, False, False),  # the next episode
         (4, 3 * 16., 7.0, 3, False, False)],
        [(0, 3 * 1.0, 3.0, 3, False, False),  # ends one step before the cut
         (1, 3 * 2.0, 3.5, 3, False, True),
         (2, 2 * 4.0, 3.5, 2, False, True),
         (3, 1 * 8.0, 3.5, 1, False, True),
         (4, 3 * 16., 7.0, 3, False, False)],
    ]  # fmt: skip
    content = held(filled(storage, episodes(flags(3, 8, (1, 2)), flags(3, 8, (2, 3))), sizes, 3))
    keys = ("counters", "nodes", ("next", "reward"), ("next", "nodes"), "steps_to_next_obs")
    columns = [content[key] for key in (*keys, *ENDS)]
    found = [tuple(float(column[i].flatten()[0]) for column in columns) for i in range(len(content))]
    assert found == [
        (robot, *row[:4], row[4] or row[5], *row[4:]) for robot, rows in enumerate(expected) for row in rows
    ]
    assert torch.equal(content["action"], -content["nodes"][:, 0, :1])


def test_every_place_for_the_ends_of_episodes_counts():
    """All of the 64 places for last frames that are made at once can be used."""
    collected = episodes(flags(64, 8, *((robot, 2) for robot in range(64))), flags(64, 8))
    frames, stacked = (held(filled(storage, collected, (8,), 3)) for storage in STORAGES)
    assert len(frames) == 64 * 5 == len(stacked)
    for key in ("nodes", ("next", "reward"), ("next", "nodes"), ("next", "terminated"), "steps_to_next_obs"):
        assert torch.equal(frames[key].double(), stacked[key].double()), key


@parametrize(2, "storage", STORAGES)
@given(
    n=st.integers(1, 5),
    sizes=st.lists(st.integers(1, 9), min_size=1, max_size=12),
    share=st.floats(0.0, 0.3),
    seed=st.integers(0, 2**31),
)
def test_windows_of_any_length_in_chunks_of_any_size(storage, n, sizes, share, seed):
    torch.manual_seed(seed)
    shape = (2, sum(sizes))
    collected = episodes(torch.rand(shape) < share, torch.rand(shape) < share)
    collected["next", "reward"] = torch.randn(*shape, 1)
    replay = filled(storage, collected, sizes, n)
    # The stacked buffer waits for the step after a window too, but for single steps.
    ready = max(0, sum(sizes) - (0 if storage == "stacked" and n == 1 else n))
    assert replay.buffer.ready * (2 if storage == "frames" else 1) == 2 * ready
    for step in held(replay) if ready else []:
        robot, begin = int(step["counters"]), int(step["nodes"][0, 0])
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


@pytest.mark.parametrize("storage", STORAGES)
def test_a_collector_may_deliver_one_step_at_a_time(robot, graph, storage):
    """A batch from TorchRL's collector is not overwritten by its next one."""

    def collect(steps):
        torch.manual_seed(0)
        env = env_of(walking(robot, time_limit=9))
        explorer = Explorer(make_actor(graph), robot, 4, ExplorationSettings(learning_starts=40))
        settings = ReplaySettings(buffer_size=1000, batch_size=4, n_step=3, mirror=False, storage=storage)
        replay = Replay(settings, 0.9, history=5)
        collector = Collector(env, explorer, frames_per_batch=4 * steps, total_frames=4 * 24)
        for collected in collector:
            replay.extend(collected)
        collector.shutdown()
        return held(replay)

    one, many = collect(1), collect(8)
    assert len(one) == 4 * (24 - 3) and one["next", "truncated"].any()
    assert set(one.keys(True, True)) == set(many.keys(True, True))
    for key in one.keys(True, True):
        assert torch.equal(one[key], many[key]), key


# Stored transitions.


@pytest.mark.parametrize("n_step", [1, 3])
@pytest.mark.parametrize("storage", STORAGES)
def test_keeps_what_updates_read_and_nothing_else(storage, n_step):
    content = held(filled(storage, episodes(flags(2, 6), flags(2, 6)), [6], n_step))
    extra = {"steps_to_next_obs"} if n_step > 1 else set()
    assert set(content.keys(True, True)) == {*KEPT, *ENDS, *extra}


@pytest.mark.parametrize("storage, newest", [("stacked", [3, 4, 5, 6, 7]), ("frames", [3, 4, 5, 6])])
def test_the_oldest_leave_first(storage, newest):
    steps = episodes(flags(1, 8), flags(1, 8))
    for t in range(8):
        replay = filled(storage, steps[:, : t + 1], [1] * (t + 1), 1, capacity=5)
        assert len(replay) == min(t + 1, 5)
    # In the frame buffer the newest step has no next frame yet.
    assert {float(replay.sample()["nodes"][0, 0, 0]) for _ in range(100)} == set(newest)


@pytest.mark.parametrize("storage", STORAGES)
def test_batches_have_their_size_as_soon_as_there_is_enough(storage):
    replay = Replay(ReplaySettings(buffer_size=50, batch_size=6, n_step=1, mirror=False, storage=storage), GAMMA, 1)
    steps = episodes(flags(2, 5), flags(2, 5))
    ready = []
    for t in range(5):
        replay.extend(steps[:, t : t + 1])
        ready.append(replay.ready)
    assert ready == [False, False, storage == "stacked", True, True]
    assert replay.sample().batch_size == (6,)


@pytest.mark.parametrize(
    "key, value", [("buffer_size", 0), ("batch_size", 0), ("n_step", 0), ("batch_size", 2_000_000)]
)
def test_settings_out_of_range(key, value):
    with pytest.raises(ConfigError, match=rf"^{key} must .*{value}"):
        ReplaySettings(**{key: value})


# The mirror.

HISTORY = 3


@pytest.fixture(scope="module", params=["biped", "opposite axes"])
def biped(request, robot, tmp_path_factory):
    if request.param == "biped":
        return robot
    return opposite_axes(robot, tmp_path_factory.mktemp("robot"))


def mirror_of(robot):
    return MirrorAugmentation(walking(robot).reflection(), HISTORY)


def mirrored_pair(robot):
    """Simulate two robots, the second in the mirrored state of the first."""
    task = walking(robot)
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
    simulation.memory = task.begin(simulation.now)
    return simulation


def test_reflection_is_what_the_mirrored_robot_sees(biped):
    simulation, mirror = mirrored_pair(biped), mirror_of(biped)
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
        nodes, counters = np.concatenate(frames, axis=-1), task.counters(simulation.memory)
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
    mirror, values = mirror_of(biped), torch.randn(5, *shape)
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
    mirror, seen = mirror_of(biped), transitions(size)
    batch, half = mirror(seen.clone()), size // 2
    for key in seen.keys(True, True):
        name = key if isinstance(key, str) else key[-1]
        kept = name in ("reward", "done", "terminated", "truncated")
        assert torch.equal(batch[key][:half], seen[key][:half])
        expected = seen[key][half:] if kept else mirror.reflect(name, seen[key][half:])
        assert torch.equal(batch[key][half:], expected), key


def test_sampling_mirrors_copies_and_not_what_is_remembered(biped):
    mirror, seen = mirror_of(biped), transitions(1)
    settings = ReplaySettings(buffer_size=10, batch_size=4, n_step=1, mirror=True, storage="stacked")
    replay = Replay(settings, GAMMA, HISTORY, mirror)
    replay.extend(seen[:, None])
    for _ in range(3):
        nodes = replay.sample()["nodes"]
        reflected = mirror.reflect("nodes", seen["nodes"])
        assert torch.equal(nodes, torch.cat([seen["nodes"]] * 2 + [reflected] * 2))
