"""Wrong terms on the command line are answered in one line with the key, the value and the accepted values."""

import pytest
from compositions import STILL, env_of, walking
from own_terms import Failing, FailingLater
from running import command, tiny, train
from thinned import parametrize

from gctd3.envs.factory import make_env
from gctd3.errors import ConfigError, TermError
from gctd3.runs.load import load_run
from gctd3.tasks.reward import Reward
from gctd3.tasks.walk import WalkSettings

COMMAND = "+task.commands.speed._target_=gctd3.UniformCommand"
NOTHING = [f"reward.terms.{name}=null" for name in ("velocity", "progress", "height", "fall", "long_contact")]
KNOWN = "Remembered: step, position[6], height[5], feet_down[5]"
WRONG = {
    # The term itself.
    "+reward.terms.x._target_=gctd3.Fal": ["reward.terms.x", "'gctd3.Fal'", "Did you mean 'gctd3.Fall'?"],
    "+reward.terms.x._target_=nowhere.Fall": ["reward.terms.x", "'nowhere.Fall'", "No module named 'nowhere'"],
    "+reward.terms.x._target_=gctd3.Fall": ["reward.terms.x must be null or", "_target_ is a RewardTerm, got Fall"],
    "+evaluation.reward.terms.x._target_=gctd3.Fall": ["evaluation.reward.terms.x must", "a RewardTerm, got Fall"],
    "+task.terminations.x._target_=gctd3.Living": ["task.terminations.x must", "is a Termination, got Living"],
    "+task.features.x._target_=gctd3.Living": ["task.features.x must", "is a NodeFeature, got Living"],
    "+task.randomisations.x._target_=gctd3.Living": ["task.randomisations.x must", "is a Randomisation, got Living"],
    "+task.commands.x._target_=gctd3.Living": ["task.commands.x must", "is a Command, got Living"],
    "+reward.terms.x=3": ["reward.terms.x must be null or a mapping", "got 3"],
    "+reward.terms.x.weight=1": ["reward.terms.x must be null or a mapping", "got {'weight': 1}"],
    "reward.terms.fal.weight=1": ["'reward.terms.fal'", "Did you mean 'reward.terms.fall'?"],
    "task.features=null": ["task.features must be a mapping, got None"],
    f"reward=table3 {' '.join(NOTHING)}": ["reward.terms must hold at least one term, got none"],
    "task.features.height=null task.features.velocity=null task.features.angle=null "
    "task.features.angular_velocity=null task.features.contact=null": ["task.features must hold at least one feature"],
    # Its numbers.
    "reward.terms.fall.weight=heavy": ["reward.terms.fall.weight must be a number, got 'heavy'"],
    "reward.terms.fall.weight=true": ["reward.terms.fall.weight must be a number, got True"],
    "reward.terms.fall.weight=null": ["reward.terms.fall.weight must be a number, got None"],
    "reward.terms.fall.wait=1": ["'reward.terms.fall.wait'", "Did you mean 'reward.terms.fall.weight'?"],
    f"{COMMAND} +task.commands.speed.every=0": ["task.commands.speed.every must be above 0 s, got 0.0"],
    f"{COMMAND} +task.commands.speed.low=[2.0]": ["task.commands.speed.low and high must hold", "[2.0] and [1.0]"],
    # References to other terms.
    "reward.terms.fall.by=fal": ["reward.terms.fall", "'fal'", "Did you mean 'fall'?", "long_contact, stuck_hip"],
    "evaluation.reward.terms.fall.by=fal": ["evaluation.reward.terms.fall", "'fal'", "Did you mean 'fall'?"],
    "+task.features.x._target_=own_terms.AskedSpeed": ["task.features.x reads 'command.speed'", KNOWN],
    "+reward.terms.x._target_=own_terms.FollowSpeed": ["reward.terms.x reads 'command.speed'", KNOWN],
    "+task.terminations.x._target_=own_terms.MissedSpeed": ["task.terminations.x reads 'command.speed'", "step, "],
    # Returned values.
    "+task.features.x._target_=own_terms.OfWheels": ["task.features.x", "'wheel'", "kinds: root, base, joint, ground"],
    "+task.features.x._target_=own_terms.TooWide": ["task.features.x must return", "[2, 1, 1], got [2, 1, 2]"],
    "+reward.terms.x._target_=own_terms.OneForAll": ["reward.terms.x must return a finite number", "shape [2], got []"],
    "+task.terminations.x._target_=own_terms.Numbers": ["task.terminations.x must return true or false", "float64"],
    "+reward.terms.x._target_=own_terms.NotFinite": ["reward.terms.x must return a finite number", "is not finite"],
    "+task.randomisations.x._target_=own_terms.ShortPose": ["task.randomisations.x must return finite qpos [", "(1,)"],
    "+task.randomisations.x._target_=own_terms.NoPose": ["task.randomisations.x must return", "got NoneType"],
    "+task.commands.x._target_=own_terms.FlatCommand": ["task.commands.x must draw [2, 1] numbers, got [2]"],
    "+reward.terms.x._target_=own_terms.Failing": [
        "reward.terms.x failed in line",
        "of own_terms.py: IndexError: list index out of range",
    ],
    # Readings.
    "+task.features.x._target_=own_terms.Nowhere": ["task.features.x", "kind None", "kinds: root, base, joint, ground"],
    "+task.features.x._target_=own_terms.Unread": ["task.features.x must say as many readings for each of 1", "None"],
    "+task.features.x._target_=own_terms.FeetDown +task.features.y._target_=own_terms.FeetDown": [
        "task.features.y has a reading 'feet_down', and so has task.features.x"
    ],
    "+task.features.x._target_=own_terms.FeetDown +task.features.x.reading=height_m": [
        "task.features.x has a reading 'height_m', and so has task.features.height"
    ],
    "+task.features.x._target_=own_terms.FeetDown +task.features.x.quantity=velocitie": [
        "the reading 'feet_down' has the quantity 'velocitie'",
        "Did you mean 'velocity'? Quantities: angle, angular velocity, length, velocity, contact, command",
    ],
    # Remembered arrays.
    "+reward.terms.x._target_=own_terms.WrongShape": ["reward.terms.x must remember 'sums' as [2, 2]", "got [2]"],
    "+reward.terms.x._target_=own_terms.OtherType": ["reward.terms.x must remember 'halves'", "int64, got", "float64"],
    "+reward.terms.x._target_=own_terms.Rising +reward.terms.y._target_=own_terms.Doubling": [
        "reward.terms.y and reward.terms.x remember different things by the name 'shared'"
    ],
    "+task.terminations.x._target_=own_terms.UnmirroredClock": ["task.terminations.x: clock_mirror", "each of the 2"],
    "+reward.terms.x._target_=own_terms.OnLegs": ["size must be a number, feet, joints or actions, got 'legs'"],
    # The time limit.
    "task.terminations.time_limit=null": ["task.terminations must hold a gctd3.TimeLimit", "got none"],
    # Classes that cannot be made.
    "+reward.terms.x._target_=gctd3.tasks.terms.RewardTerm": ["reward.terms.x: _target_", "is abstract", "__call__"],
    "+reward.terms.x._target_=own_terms.Listed +reward.terms.x.speeds=3": [
        "reward.terms.x.speeds must be a list, got 3"
    ],
    "+reward.terms.x._target_=own_terms.Listed +reward.terms.x.by_name=[]": ["by_name must be a mapping, got ()"],
    "+reward.terms.x._target_=own_terms.Listed +reward.terms.x.speeds=[3]": [
        "reward.terms.x: own_terms.Listed cannot be made: ArithmeticError: no three"
    ],
    # Leaving terms out, and replacing them.
    "task.features={}": [
        "task.features={} removes nothing",
        "Leave out each: task.features.height=null task.fea",
    ],
    "task.terminations={}": ["task.terminations={} removes nothing", "task.terminations.time_limit=null"],
    "reward.terms={}": ["reward.terms={} removes nothing", "reward.terms.swing=null"],
    "stop_when.at_least={}": ["stop_when.at_least={} removes nothing", "'~stop_when.at_least.success_rate' "],
    "reward=null": [
        "reward=null: reward cannot be left out. Options of reward: "
        "empty, jump, paper, table3, tracking, velocity, walk."
    ],
    "task=null": ["task=null: task cannot be left out. Options of task: ant, ", "walk, "],
    "reward.terms.fall._target_=gctd3.Living": [
        "Unknown key 'reward.terms.fall.by'",
        "leave it out and add yours by a new name, reward.terms.fall=null +reward.terms.NAME._target_=gctd3.Living",
    ],
    # The key that adds it.
    "reward.terms.x._target_=gctd3.Living": ["Unknown key 'reward.terms.x'. To add it: +reward.terms.x._target_=..."],
    # The environment.
    "env.backend=library": ["env.backend must be batched or dm_control for walk, got library"],
    "task=walker_walk reward=table3": [
        "reward.terms must be empty for walker-walk",
        "its own reward, got velocity, pro",
    ],
    "task=ant +reward.terms.x._target_=gctd3.Living": ["reward.terms must be empty for Ant-v5", "got x"],
    "task=ant +evaluation.reward.terms.x._target_=gctd3.Living": ["evaluation.reward.terms must be empty for Ant-v5"],
    "task=ant env.backend=batched": ["env.backend must be library for Ant-v5, got batched"],
}


@parametrize(2, "arguments", WRONG)
def test_a_wrong_term_is_answered_in_a_line(capfd, tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    assert command("train", *tiny(tmp_path / "run", *arguments.split())) == 2
    error = capfd.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1, error
    assert all(words in error for words in WRONG[arguments]), error
    assert not list(tmp_path.iterdir())


def test_a_term_that_fails_in_a_training_is_named(capfd, tmp_path):
    assert command("train", *tiny(tmp_path / "run", "+task.terminations.x._target_=own_terms.FailingLater")) == 2
    error = capfd.readouterr().err
    assert "error: task.terminations.x failed in line" in error
    assert "of own_terms.py: OSError: [Errno 5] the sensor is gone" in error


@parametrize(2, "logger", ["csv", "tensorboard"])
def test_a_training_that_fails_before_its_first_step_leaves_nothing(capfd, tmp_path, monkeypatch, logger):
    monkeypatch.chdir(tmp_path)
    term = "+reward.terms.x._target_=own_terms.FailingAtOnce"
    assert command("train", *tiny("runs/biped/one", term, f"logger={logger}", without=["logger"])) == 2
    assert "error: reward.terms.x failed in line" in capfd.readouterr().err
    assert not list(tmp_path.iterdir())
    # What was there before stays.
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "notes.txt").touch()
    assert command("train", *tiny("run", term)) == 2
    assert (tmp_path / "run" / "notes.txt").is_file()


def test_the_cause_of_a_term_that_fails_is_kept():
    with pytest.raises(ConfigError, match=r"reward.terms.x failed") as caught:
        walking(of=Reward({"x": Failing()}))
    assert isinstance(caught.value.__cause__, IndexError)
    task = walking(ends={"x": FailingLater()}, **STILL)
    with pytest.raises(TermError, match=r"task.terminations.x failed") as failed:
        env_of(task).rollout(5)
    assert isinstance(failed.value.__cause__, OSError)


@pytest.mark.parametrize(
    "make, said",
    [
        (lambda: WalkSettings(features=None), "features must be a mapping of terms by name, got None"),
        (lambda: WalkSettings(terminations=[Failing()]), "terminations must be a mapping of terms by name, got [Fail"),
        (lambda: Reward(terms=[Failing()]), "terms must be a mapping of terms by name, got [Failing("),
        (lambda: Reward(terms=None), "terms must be a mapping of terms by name, got None"),
        (lambda: make_env(reward={"x": Failing()}), "reward must be a Reward, got {'x': Failing("),
        (lambda: make_env(reward={}), "reward must be a Reward, got {}"),
        (lambda: make_env(task=Failing()), "task must be a TaskSettings, got Failing("),
        (lambda: walking(of=Failing()), "reward must be a Reward, got Failing("),
    ],
)
def test_what_is_no_composition_is_answered_from_python_too(make, said):
    with pytest.raises(ConfigError) as caught:
        make()
    assert str(caught.value).startswith(said)


@pytest.mark.nightly
def test_a_term_is_replaced_by_another_class(tmp_path):
    gone, new = "reward.terms.fall=null", "+reward.terms.mine._target_=own_terms.Listed"
    assert command("train", *tiny(tmp_path / "run", gone, new, "+reward.terms.mine.speeds=[1,2]")) == 0
    reward = load_run(tmp_path / "run").settings.reward
    assert "fall" not in reward.terms and reward.terms["mine"].speeds == [1, 2]


def test_a_key_that_a_yaml_says_twice_is_named(capfd, tmp_path):
    (tmp_path / "reward").mkdir()
    (tmp_path / "reward" / "twice.yaml").write_text("defaults: [paper, _self_]\nterms:\n  fall: null\n  fall: null\n")
    assert command("train", f"--config-dir={tmp_path}", "reward=twice", *tiny(tmp_path / "run")) == 2
    assert capfd.readouterr().err == f"error: {tmp_path}/reward/twice.yaml, line 4: found duplicate key fall.\n"


@pytest.mark.nightly
def test_a_run_that_is_continued_keeps_its_terms(capfd, tmp_path):
    run = train(tmp_path / "run", "+reward.terms.mine._target_=own_terms.Rising")
    capfd.readouterr()
    assert command("train", f"resume={run}", "reward.terms.mine.weight=5") == 2
    error = capfd.readouterr().err
    assert error.startswith("error: Unknown key 'reward.terms.mine': a run that is continued keeps its robot, task and")
    assert "May change: logger, video, total_frames" in error and error.count("\n") == 1


@pytest.mark.parametrize("key", ["+reward.terms.x._target_=gctd3.Living", "reward.terms.fall.weight=3"])
def test_a_reward_to_evaluate_under_is_chosen_before_it_is_changed(capfd, tmp_path, key):
    assert command("evaluate", f"out={tmp_path}", key) == 2
    error = capfd.readouterr().err
    known = "empty, jump, paper, table3, tracking, velocity, walk"
    assert f"reward has no keys as it is: begin with reward=..., which is one of {known}." in error
    assert command("evaluate", f"out={tmp_path}", "reward=null", "episodes=0") == 2
    assert "episodes must be at least 1" in capfd.readouterr().err


@pytest.mark.nightly
def test_two_terms_may_remember_the_same_thing(tmp_path):
    same = [f"+reward.terms.{name}._target_=own_terms.Rising" for name in "xy"]
    assert command("train", *tiny(tmp_path / "run", *same)) == 0
