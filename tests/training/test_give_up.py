"""A training that cannot succeed stops in its first batches and says why; no other one does."""

import math

import numpy as np
import pytest
import torch
from running import TINY, command, tiny
from tensordict import TensorDict
from thinned import parametrize

from gctd3.errors import ConfigError
from gctd3.robots.robot import Robot
from gctd3.tasks.walk import WalkingTask
from gctd3.training.diagnosis import why_it_diverges, why_it_ends
from gctd3.training.give_up import GiveUp, Watch


def batch(**columns):
    """Return a batch of single steps of robots; what is not given is no end, no reward and an old episode."""
    count = len(next(iter(columns.values())))
    plain = {"reward": 0.0, "done": False, "terminated": False, "truncated": False, "diverged": False, "step_count": 99}
    values = {key: columns.get(key, [value] * count) for key, value in plain.items()}
    return TensorDict({("next", key): torch.tensor(value)[:, None, None] for key, value in values.items()}, [count, 1])


def judged(watch, batches):
    """Return the number of the batch at which a training is given up, and why; ``None`` if it is not."""
    frames = 0
    for number, one in enumerate(batches, 1):
        frames += one.numel()
        if (failure := watch.judge(one, frames)) is not None:
            return number, failure
    return None


def ended(diverged=0, short=0, fell=0, timed=0):
    """Return a step in which so many robots end in each way, with different rewards."""
    kinds = ["diverged"] * diverged + ["short"] * short + ["fell"] * fell + ["timed"] * timed
    return batch(
        reward=[float(i) for i in range(len(kinds))],
        done=[True] * len(kinds),
        terminated=[kind != "timed" for kind in kinds],
        diverged=[kind == "diverged" for kind in kinds],
        step_count=[2 if kind in ("short", "timed") else 3 for kind in kinds],
    )


@pytest.mark.parametrize(
    ("first", "verdict"),
    [
        ({"diverged": 9, "fell": 1}, (1, "diverged")),
        ({"diverged": 8, "fell": 2}, None),
        ({"short": 9, "fell": 1}, (1, "short")),
        ({"short": 8, "fell": 2}, None),
        # A time limit of two steps is what somebody asked for.
        ({"timed": 10}, None),
        ({"diverged": 5, "short": 5}, None),
    ],
)
def test_first_episodes_are_judged(first, verdict):
    watch = Watch(GiveUp(episodes=10), 10, None)
    assert judged(watch, [ended(**first)]) == verdict


def test_only_the_first_episodes_are_judged():
    watch = Watch(GiveUp(episodes=10), 10, None)
    assert judged(watch, [ended(fell=10), *[ended(diverged=10)] * 100]) is None
    assert judged(Watch(GiveUp(episodes=None), 10, None), [ended(diverged=10)] * 100) is None
    # 25 steps of 4 robots, before which there are not enough.
    assert judged(Watch(GiveUp(episodes=100), 4, None), [ended(diverged=4)] * 100) == (25, "diverged")


def test_rewards_that_never_differ():
    assert judged(Watch(GiveUp(), 4, 100), [batch(reward=[0.0] * 4)] * 50) == (25, "equal")
    once = [batch(reward=[0.0] * 4)] * 24 + [batch(reward=[0.0, 0.0, 0.1, 0.0])] * 26
    assert judged(Watch(GiveUp(), 4, 100), once) is None
    assert judged(Watch(GiveUp(reward_frames=None), 4, 100), [batch(reward=[0.0] * 4)] * 50) is None
    assert judged(Watch(GiveUp(), 4, None), [batch(reward=[0.0] * 4)] * 50) is None


def test_a_reward_for_every_step_that_a_pole_stands_teaches_how_long_it_did():
    """Rewards are all 1 there, and returns are lengths of episodes."""
    step, end = batch(reward=[1.0] * 4), batch(reward=[1.0] * 4, done=[True] * 4, terminated=[True] * 4)
    falls = [step, end, step, step, end] * 100
    assert judged(Watch(GiveUp(episodes=8), 4, 20), falls) is None
    # All episodes are as long, as with a time limit alone: nothing that an action does makes a difference.
    assert judged(Watch(GiveUp(episodes=8), 4, 20), [step, step, end] * 100) == (6, "equal")


def test_several_steps_in_a_batch_count_as_one_after_another():
    rng = np.random.default_rng(0)
    singles = []
    for _ in range(40):
        done = rng.random(3) < 0.3
        singles.append(
            batch(
                reward=rng.integers(0, 2, 3).astype(float), done=done, terminated=done, step_count=rng.integers(1, 5, 3)
            )
        )
    one, other = Watch(GiveUp(episodes=10**6), 3, 10**6), Watch(GiveUp(episodes=10**6), 3, 10**6)
    for single in singles:
        one.judge(single, 0)
    for begin in range(0, 40, 8):
        other.judge(torch.cat(singles[begin : begin + 8], dim=1), 0)
    assert one.seen == other.seen and one.seen.episodes > 10
    # Written down and read again in the middle, it judges alike.
    third = Watch(GiveUp(episodes=10**6), 3, 10**6)
    for single in singles[:20]:
        third.judge(single, 0)
    fourth = Watch(GiveUp(episodes=10**6), 3, 10**6)
    fourth.load_state_dict(third.state_dict())
    for single in singles[20:]:
        fourth.judge(single, 0)
    assert fourth.seen == one.seen


def test_a_checkpoint_of_an_older_version_is_judged_no_more():
    watch = Watch(GiveUp(episodes=10), 10, 10)
    watch.load_state_dict(None)
    assert judged(watch, [ended(diverged=10)] * 3) is None


@pytest.mark.parametrize("wrong", [{"episodes": 0}, {"share": 0.4}, {"share": 1.1}, {"steps": 0}, {"reward_frames": 0}])
def test_settings_out_of_range_are_named(wrong):
    (key,) = wrong
    with pytest.raises(ConfigError, match=key):
        GiveUp(**wrong)


@pytest.fixture(scope="module")
def unstable(tmp_path_factory):
    """Write a biped whose left knee has gains that no step of 5 ms can follow."""
    text = Robot.from_mjcf("biped").path.read_text()
    old = '<position name="knee_left" class="knee"'
    assert text.count(old) == 1
    text = text.replace(old, f'{old} kp="5e8" kv="0" forcerange="-1e9 1e9"').replace("implicitfast", "Euler")
    path = tmp_path_factory.mktemp("unstable") / "unstable.xml"
    path.write_text(text)
    return path


def test_the_joint_that_diverges_is_named_with_the_time(unstable):
    why = why_it_diverges(WalkingTask(Robot.from_mjcf(unstable)), 0)
    assert "MuJoCo's BAD" in why and " s after a start" in why and "timestep of 0.005 s" in why
    # The servo pulls the shank, and with it what is beside it in the chain: not the base, which MuJoCo names.
    assert any(f"joint {joint} of body" in why for joint in ("hip_left", "knee_left", "ankle_left")), why
    assert "No warning" in why_it_diverges(WalkingTask(Robot.from_mjcf("biped")), 0)


HOPELESS = {
    "diverged": ([], ["simulation of", "MuJoCo's BAD", "_left of body", "give_up.episodes=null"]),
    "short": (
        ["task.terminations.fall.height=0.5"],
        ["ended within 2 control steps", "task.terminations.fall ends an episode 0.02 s after its start", "body +"],
    ),
    "equal": (
        [f"reward.terms.{name}=null" for name in ("velocity", "progress", "height", "flight", "fall", "swing")]
        + [f"reward.terms.{name}=null" for name in ("long_contact", "stuck_hip", "antiphase", "overspeed")]
        + ["reward.terms.living.weight=0", "give_up.reward_frames=160"],
        ["every reward was 0", "reward.terms (living)", "give_up.reward_frames=null"],
    ),
}


@parametrize(
    6,
    ("kind", "more"),
    [
        ("diverged", []),
        ("diverged", ["env.backend=dm_control"]),
        ("short", []),
        ("equal", []),
        ("short", ["env.backend=dm_control"]),
        ("diverged", ["collector=process", "collector.workers=1"]),
    ],
)
def test_a_training_that_cannot_succeed_stops(tmp_path, capsys, unstable, kind, more):
    settings, said = HOPELESS[kind]
    robot = [f"robot.name={unstable}"] if kind == "diverged" else []
    few = ["give_up.episodes=8", "total_frames=100_000", "exploration.learning_starts=80", "evaluation.every=100_000"]
    run = tmp_path / "run"
    assert (
        command("train", *tiny(run, *robot, *settings, *few, *more, without=("total_frames", "evaluation.every"))) == 2
    )
    error = capsys.readouterr().err
    assert all(words in error for words in said), error
    frames = int(error.split("After ")[1].split(" steps")[0].replace(",", ""))
    assert frames <= 2_000 and "Traceback" not in error
    # With the setting off it goes on: the verdict is that setting's alone.
    off = "give_up.reward_frames=null" if kind == "equal" else "give_up.episodes=null"
    if not more:
        on = [*robot, *settings, off, "total_frames=240", "exploration.learning_starts=240"]
        assert command("train", *tiny(tmp_path / "off", *on, without=TINY.keys() - {"env.num_envs", "logger"})) == 0


@pytest.mark.nightly
def test_episodes_of_a_library_that_end_at_once_are_noticed(tmp_path, capsys):
    short = ["task=walker2d", "give_up.steps=100", "give_up.episodes=8", "total_frames=100_000"]
    assert command("train", *tiny(tmp_path / "run", *short, without=("env.threads", "total_frames"))) == 2
    error = capsys.readouterr().err
    assert "episodes ended within 100 control steps" in error and "Walker2d-v5" in error


@pytest.mark.parametrize(
    "robot",
    [
        "biped",
        "biped_planar",
        *[pytest.param(name, marks=pytest.mark.nightly) for name in ("quadruped", "hexapod")],
    ],
)
def test_no_shipped_robot_is_given_up_or_has_a_diagnosis(robot):
    """Random actions from random starts: the hardest that a warm-up can do to a robot."""
    task = WalkingTask(Robot.from_mjcf(robot))
    assert "No warning" in why_it_diverges(task, 0)
    why = why_it_ends(task, 0)
    after = float(why.split("episode ")[1].split(" s after")[0])
    assert after > 2 * GiveUp().steps * task.control_dt and math.isfinite(after)


@pytest.mark.nightly
@pytest.mark.parametrize("exploration", ["rhythmic", "uniform"])
@pytest.mark.parametrize(
    "subject",
    ["robot=biped", "robot=biped_planar", "robot=quadruped", "robot=hexapod"]
    + ["task=walker_walk", "task=walker2d", "task=ant", "task=halfcheetah"]
    + [
        f"task=library,task.library={library},task.name={name}"
        for library, name in (
            ("gymnasium", "InvertedPendulum-v5"),
            ("gymnasium", "InvertedDoublePendulum-v5"),
            ("gymnasium", "Hopper-v5"),
            ("gymnasium", "Humanoid-v5"),
            ("dm_control", "cartpole-swingup_sparse"),
            ("dm_control", "hopper-hop"),
            ("dm_control", "humanoid-stand"),
            ("dm_control", "acrobot-swingup_sparse"),
        )
    ],
)
def test_no_shipped_training_is_given_up(tmp_path, subject, exploration):
    """2,000 frames of warm-up: more than 50 episodes of what falls soon."""
    settings = [*subject.split(","), "env.num_envs=8", "total_frames=2000", "exploration.learning_starts=2000"]
    settings += ["evaluation.every=100_000", "evaluation.episodes=1", "logger=none", "threads=1"]
    if subject.startswith("robot"):
        settings.append(f"exploration={exploration}")
    elif exploration == "rhythmic":
        pytest.skip("a task of another library has no rhythmic gaits")
    assert command("train", *settings, f"hydra.run.dir={tmp_path / 'run'}", "give_up.reward_frames=1") == 0
