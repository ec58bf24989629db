"""Settings: every YAML builds, and every key of every YAML has a reason and is read."""

import ast
import json
from importlib.resources import files
from pathlib import Path

import pytest
import yaml
from configs import composed, items
from thinned import parametrize

import gctd3
from gctd3.algorithms.settings import AlgorithmSettings, TD3Settings
from gctd3.config.build import build
from gctd3.config.fields import defaults_of, describe, find, is_settings, settings_of
from gctd3.config.help import COMMANDS, root_of
from gctd3.config.presets import groups, presets
from gctd3.data.settings import ExplorationSettings, InlineSettings, ReplaySettings
from gctd3.errors import ConfigError
from gctd3.evaluation.settings import Perturbations
from gctd3.nn.settings import Network
from gctd3.robots.command_line import FREE
from gctd3.robots.settings import RobotSettings
from gctd3.runs.settings import EvaluateSettings
from gctd3.tasks.reward import Reward
from gctd3.tasks.walk import WalkSettings
from gctd3.training.settings import TrainSettings
from gctd3.training.stop_when import StopWhen

CONF = Path(str(files("gctd3.conf")))
ALGORITHMS, NETWORKS = (sorted(file.stem for file in (CONF / group).glob("*.yaml")) for group in ("algo", "network"))
OF_EVALUATE = "perturbations"  # a group that training does not have
OPTIONS = sorted((file.parent.name, file.stem) for file in CONF.glob("*/*.yaml") if file.parent.name != OF_EVALUATE)


@pytest.fixture(scope="module")
def default():
    return composed()


# Everything in conf/ builds.


def test_there_is_something_to_test():
    assert {"gctd3", "td3", "ddpg", "sac"} <= set(ALGORITHMS) and {"gcn", "mlp"} <= set(NETWORKS)


@parametrize(4, "group, option", [option for option in OPTIONS if option != ("reward", "empty")])
def test_every_option_builds(group, option):
    # One for a robot of one's own lacks its file alone.
    name = ["robot.name=quadruped"] if group == "robot" and option.startswith(FREE) else []
    # A robot's recipe for one task holds settings of that task.
    task = ["task=jump"] if group == "recipe" and option.startswith("jump_") else []
    assert isinstance(build(composed(f"{group}={option}", *name, *task)), TrainSettings)


def test_an_empty_reward_is_there_to_be_filled():
    settings = build(composed("reward=empty", "+reward.terms.alive._target_=gctd3.Living"))
    assert list(settings.reward.terms) == ["alive"]
    with pytest.raises(ConfigError, match=r"reward.terms must hold at least one term, got none"):
        build(composed("reward=empty")).setup()


@pytest.mark.parametrize("option", [option for group, option in OPTIONS if group == "reward" and option != "empty"])
def test_every_reward_can_evaluate_too(option):
    settings = build(composed(f"reward@evaluation.reward={option}"))
    assert settings.evaluation.reward == build(composed(f"reward={option}")).reward


@parametrize(4, "network", NETWORKS)
@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_any_algorithm_takes_any_network(algorithm, network):
    settings = build(composed(f"algo={algorithm}", f"network={network}"))
    assert bool(settings.network.graph_layers) == (network != "mlp")
    assert isinstance(settings.algo, AlgorithmSettings)
    assert settings.algo.build(settings.setup().architecture()).optimizers.keys() >= {"actor", "critic"}


@pytest.mark.parametrize("algorithm, network", [("gctd3", "gcn"), ("td3", "mlp"), ("ddpg", "mlp"), ("sac", "mlp")])
def test_an_algorithm_brings_its_network_and_its_noise(algorithm, network):
    settings = build(composed(f"algo={algorithm}"))
    assert settings.network == build(composed(f"network={network}")).network
    assert (settings.exploration.noise is None) == (algorithm == "sac")


@parametrize(3, "algorithm", ALGORITHMS)
@pytest.mark.parametrize("experiment", sorted(file.stem for file in (CONF / "experiment").glob("*.yaml")))
def test_any_algorithm_takes_any_experiment(experiment, algorithm):
    build(composed(f"experiment={experiment}", f"algo={algorithm}"))


RECIPE = {"batch_size": 128, "learning_starts": 40_000, "gradient_steps": 6, "learning_rate": 6e-4, "every": 5_000}
BEFORE = {"batch_size": 256, "learning_starts": 10_000, "gradient_steps": 4, "learning_rate": 3e-4, "every": 20_000}


def recipe_of(*arguments):
    s = build(composed(*arguments))
    return {
        "batch_size": s.replay.batch_size,
        "learning_starts": s.exploration.learning_starts,
        "gradient_steps": s.gradient_steps,
        "learning_rate": s.algo.learning_rate,
        "every": s.evaluation.every,
    }


@pytest.mark.parametrize("arguments", [[], ["algo=td3"], ["reward=paper"], ["stop_when=never"], ["robot=biped"]])
def test_the_biped_has_a_recipe_of_its_own(arguments):
    assert recipe_of(*arguments) == RECIPE
    assert build(composed(*arguments)).imitation.updates == 0


def test_a_policy_of_the_biped_may_begin_as_a_gait():
    assert recipe_of("recipe=walk_biped_gait") == {**RECIPE, "learning_starts": 76_800, "every": 10_000}
    imitation = build(composed("recipe=walk_biped_gait")).imitation
    assert imitation.updates > 0 and imitation.retries > 0


@pytest.mark.parametrize("task", ["walk", "velocity", "jump"])
@parametrize(5, "robot", ["quadruped", "biped", "biped_planar", "go2", "op3"])
def test_a_policy_that_is_random_by_itself_gets_no_noise(robot, task):
    lines = [(f"robot={robot}", f"task={task}", f"algo={algo}") for algo in ("sac", "gctd3")]
    assert [build(composed(*line)).exploration.noise is None for line in lines] == [True, False]


@pytest.mark.parametrize("experiment", ["table5", "graphs", "history"])
def test_comparisons_keep_the_recipe_that_their_results_were_made_with(experiment):
    assert recipe_of(f"experiment={experiment}") == BEFORE
    assert build(composed(f"experiment={experiment}")).exploration.mutation_share == 0.0


def test_the_faster_walk_keeps_the_recipe_that_its_results_were_made_with():
    assert recipe_of("experiment=table5_best") == RECIPE
    settings = build(composed("experiment=table5_best"))
    assert (settings.exploration.warmup, settings.exploration.mutation_share) == ("rhythmic", 0.8)
    assert settings.imitation.updates == 0 and settings.stop_when.restart_after == 140_000


def test_a_robots_recipe_wins_over_what_its_task_changes():
    """Compose the command that a committed result was trained with, and again without what its recipe says."""
    results = Path(__file__).parents[2] / "benchmarks" / "results"
    command = json.loads((results / "jump_go2.json").read_text(encoding="utf-8"))["command"]
    given = command.removeprefix("python -m gctd3.train ").split()
    said = ("exploration.learning_starts", "evaluation.every", "total_frames")
    assert {item.partition("=")[0] for item in given}.issuperset(said)
    assert composed(*given) == composed(*[item for item in given if not item.startswith(said)])
    # A robot without one has what the task changes.
    assert recipe_of("task=jump", "robot=go1")["learning_starts"] == 500_000


def test_the_papers_hyperparameters_are_those_of_its_table():
    of_paper = {"gradient_steps": 1, "learning_starts": 1_000, "every": 50_000}
    assert recipe_of("experiment=paper") == {**BEFORE, **of_paper}


@pytest.mark.parametrize("arguments", [["task=halfcheetah"], ["task=walker2d"]])
def test_no_other_robot_has_the_bipeds_recipe(arguments):
    of_robot = recipe_of(*arguments)
    assert {**of_robot, "learning_starts": 10_000} == BEFORE


def test_a_policy_that_walks_ends_the_training_unless_it_never_ends():
    walk = build(composed()).stop_when
    assert (walk.evaluations, walk.confirm) == (1, 50)
    never = build(composed("stop_when=never")).stop_when
    assert (never.evaluations, never.confirm, never.restart_after) == (None, 0, None)


@parametrize(
    8,
    "brings",
    [
        *(f"robot={file.stem}" for file in sorted((CONF / "robot").glob("*.yaml")) if not file.stem.startswith("free")),
        *(f"robot=quadruped terrain={file.stem}" for file in sorted((CONF / "terrain").glob("*.yaml"))),
        *(f"robot=quadruped task={task}" for task in ("velocity", "jump")),
    ],
)
def test_never_is_never_whatever_the_robot_its_task_and_the_ground_bring(brings):
    def rule(*more):
        stop_when = build(composed(*brings.split(), *more)).stop_when
        return stop_when.evaluations, stop_when.confirm, stop_when.restart_after

    assert rule()[0] is not None
    assert rule("stop_when=never") == (None, 0, None)
    assert rule("stop_when=never", "stop_when.evaluations=3") == (3, 0, None)


@pytest.mark.parametrize("experiment", ["table5", "history", "graphs"])
def test_trainings_of_any_robot_are_equally_long_in_comparisons(experiment):
    settings = build(composed(f"experiment={experiment}", "robot=quadruped", "terrain=rough"))
    assert settings.stop_when.evaluations is None and settings.stop_when.restart_after is None
    assert settings.total_frames == 400_000


@pytest.mark.parametrize("task", ["walker_walk", "walker2d", "halfcheetah", "ant"])
def test_a_librarys_task_brings_what_goes_with_it(task):
    settings = build(composed(f"task={task}"))
    assert (settings.env.backend, settings.env.num_envs) == ("library", 8)
    assert settings.exploration.warmup == "uniform" and not settings.replay.mirror
    assert settings.stop_when.evaluations is None
    assert not settings.reward.terms and not settings.evaluation.reward.terms
    # The command line overrides the task's own settings.
    assert build(composed(f"task={task}", "env.num_envs=3")).env.num_envs == 3


def test_perturbations_build():
    assert build(composed("run=x", root="evaluate")).perturbations == Perturbations()
    for file in (CONF / OF_EVALUATE).glob("*.yaml"):
        assert isinstance(build(composed("run=x", f"{OF_EVALUATE}={file.stem}", root="evaluate")), EvaluateSettings)


@pytest.mark.parametrize("root", ["evaluate", "export", "render", "report", "view"])
def test_the_other_commands_build(root):
    key = "runs" if root == "report" else "run"
    assert getattr(build(composed(f"{key}=somewhere", root=root)), key) == "somewhere"


def test_yaml_and_python_agree(default):
    """The defaults of the Python functions equal those of the command line, apart from what is tuned for one robot."""
    settings = build(composed("recipe=none"))
    assert settings.network == Network() and settings.algo == TD3Settings()
    assert settings.exploration == ExplorationSettings() and settings.replay == ReplaySettings()
    assert settings.collector == InlineSettings() and settings.robot == RobotSettings()
    assert build(composed("reward=paper")).reward == Reward()
    assert build(composed("stop_when=never")).stop_when == StopWhen()
    assert build(default).task == WalkSettings()


def test_python_builds_the_network_that_training_does(default, graph):
    settings = build(default)
    sizes = {name: value.shape for name, value in gctd3.make_actor(graph).state_dict().items()}
    trained = settings.algo.build(settings.setup().architecture()).actor.state_dict()
    assert sizes == {name: value.shape for name, value in trained.items()}


# Every key is explained and read.

PRESETS = [preset for group in groups() if not group.startswith("hydra/") for preset in presets(group)]
# Groups whose YAMLs compose terms, or change any other group.
FULL = ("reward", "task", "robot")


SPARE = [preset for preset in PRESETS if preset.group not in FULL]


def test_presets_are_read_as_yaml_reads_them():
    found = {(preset.group, preset.name): {change.key: change.value for change in preset.changes} for preset in PRESETS}
    assert len(found) > 40 and sum(map(len, found.values())) > 100
    for (group, name), changes in found.items():
        plain = yaml.safe_load((CONF / group / f"{name}.yaml").read_text(encoding="utf-8"))
        ours = {key: value for key, value in plain.items() if key not in ("defaults", "hydra", "_target_")}
        assert changes == {key: value for key, value in items(ours) if not isinstance(value, dict) or not value}


def test_every_key_has_a_comment():
    """Every key of every YAML has a comment on its line, or above it and the keys that follow."""
    assert [
        f"{preset.group}/{preset.name}: {change.key}" for preset in SPARE for change in preset.changes if not change.why
    ] == []


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_says_no_defaults(command):
    plain = yaml.safe_load((CONF / f"{root_of(command)}.yaml").read_text(encoding="utf-8"))
    ours = {key: value for key, value in plain.items() if key not in ("defaults", "hydra")}
    assert [key for key, value in items(ours) if not isinstance(value, dict)] == []


def attributes(tree):
    """Return the names of attributes that are read outside the checks of settings."""
    if isinstance(tree, ast.FunctionDef) and tree.name == "__post_init__":
        return set()
    own = {tree.attr} if isinstance(tree, ast.Attribute) else set()
    return own.union(*map(attributes, ast.iter_child_nodes(tree)))


def test_every_setting_is_explained_and_read():
    """Every field has a meaning, and is read outside its own check."""
    read, checked = set(), 0
    for file in Path(gctd3.__file__).parent.rglob("*.py"):
        read |= attributes(ast.parse(file.read_text(encoding="utf-8")))
    for name in vars(gctd3)["_TARGETS"]:
        settings = getattr(gctd3, name)
        if not is_settings(settings):
            continue
        for setting in settings_of(settings):
            assert len(setting.meaning) > 8, f"{name}.{setting.name} is not explained"
            assert describe(setting.hint)
            assert setting.name in read, f"nothing reads {name}.{setting.name}"
            checked += 1
    assert checked > 150


@pytest.mark.parametrize("root", ["config", "evaluate", "export", "render", "report", "view"])
def test_every_key_is_a_field_and_every_field_a_key(root):
    def check(node, path=""):
        if "_target_" in node:
            assert set(node) - {"_target_"} == set(defaults_of(find(node["_target_"]))), path
        for key, value in node.items():
            if isinstance(value, dict):
                check(value, f"{path}.{key}")

    given = {"config": [], "report": ["runs=x"]}.get(root, ["run=x"])
    check(composed(*given, root=root))
