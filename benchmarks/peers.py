"""Other libraries' algorithms on a robot of gctd3's, each as its own documentation trains it, evaluated like gctd3's.

    python benchmarks/peers.py peer=torchrl run=DIR [seed=0] [every=20000] [minutes=20] [threads=1]
    python benchmarks/peers.py peer=sbx-sac run=DIR robot=go2 robots=64 seconds=20 threads=2
    python benchmarks/peers.py peer=sbx-sac run=DIR robot=go2 settings='task=velocity'

``peer=sb3`` or ``sb3-td3``: TD3 of Stable-Baselines3 with its defaults and the action noise of its documentation's TD3
example; ``sb3-sac`` and ``sb3-ppo``: its SAC and PPO with their defaults. ``sbx-...``: the same with SBX (JAX).
``peer=torchrl``: TorchRL's own parts put together as in its TD3 example (``sota-implementations/td3``). All step
``gctd3/Biped-v0`` with the task and the reward that ``python -m gctd3.train robot=... SETTINGS`` trains for, on the
CPU, and bootstrap where the task truncates an episode. They are evaluated every ``every`` frames, by default as
gctd3's, or every ``seconds`` of training. The run's directory gets ``progress.csv``, a row for each evaluation under
gctd3's own names, and ``recipe.json``, the hyperparameters that were used.

With ``robots`` above 1, one call of MuJoCo steps all of them, and two hyperparameters change, since the defaults are
meant for few robots: TD3 and SAC make ``updates`` updates after each step of all robots, by default as many as gctd3's
training (-1 for as many as robots); and PPO's ``n_steps`` is divided by the robots, so that it learns after as many
frames as by default.
"""

from __future__ import annotations

import csv
import importlib.util
import inspect
import json
import logging
import shlex
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import torch
from common import options
from gymnasium.vector import AutoresetMode
from hydra import compose, initialize_config_module
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn

import gctd3  # noqa: F401 - registers the Gymnasium task
from gctd3.config.build import build
from gctd3.config.command_line import CONF
from gctd3.files import write_text
from gctd3.training.confirmation import evaluation_env, measure
from gctd3.training.run_log import PROGRESS
from gctd3.training.settings import TrainSettings
from gctd3.training.stop_when import COLUMNS

if TYPE_CHECKING:
    from stable_baselines3.common.vec_env import VecEnv

RECIPE = "recipe.json"
ACTION_NOISE = 0.1  # of the TD3 example in Stable-Baselines3's documentation; the class itself adds none
ENDLESS = 10**8  # steps, more than anybody waits for
PACKAGES = {"torchrl": "torchrl", "sb3": "stable_baselines3", "sbx": "sbx"}
PEERS = (
    "torchrl",
    *(f"{library}{algorithm}" for library in ("sb3", "sbx") for algorithm in ("", "-td3", "-sac", "-ppo")),
)
# Seconds that a run has spent in evaluations, which are not counted where evaluations are due by time.
EVALUATING = "evaluating_s"
MARK = "evaluating"  # a file that is there while such an evaluation goes on

HYPERPARAMETERS = (
    "learning_rate",
    "buffer_size",
    "learning_starts",
    "batch_size",
    "tau",
    "gamma",
    "gradient_steps",
    "policy_delay",
    "target_policy_noise",
    "target_noise_clip",
    "n_steps",
    "n_epochs",
    "gae_lambda",
    "ent_coef",
    "vf_coef",
    "max_grad_norm",
)

Act = Callable[[Tensor], Tensor]  # observations ``[B, N * F]`` to actions ``[B, A]``


def shared_settings(*overrides: str) -> TrainSettings:
    """Return the settings of ``python -m gctd3.train``: task, reward and evaluation are every peer's too."""
    with initialize_config_module(CONF, version_base="1.3"):
        return build(compose("config", list(overrides)))


class Evaluator:
    """Writes a row of ``progress.csv`` whenever a peer's policy is due, evaluated as :class:`.Trainer` does.

    Args:
        settings: Of :func:`shared_settings`, or of another training whose task and evaluation they share.
        run: The run's directory.
        minutes: After which the training is to end, without its evaluations.
        threads: That simulate.
        seconds: Between evaluations, without them; if ``None``, they are due by frames, as the settings say.
    """

    def __init__(
        self, settings: TrainSettings, run: Path, minutes: float, threads: int, seconds: float | None = None
    ) -> None:
        self.settings, self.run, self.threads, self.seconds = settings, run, threads, seconds
        self.task = settings.setup().task
        episodes, seed = settings.evaluation.episodes, settings.evaluation.seed
        self.env = evaluation_env(settings, self.task, episodes, seed, threads)
        self.columns = COLUMNS if seconds is None else (*COLUMNS, EVALUATING)
        self.began, self.evaluating, self.minutes = time.monotonic(), 0.0, minutes
        self.next = settings.evaluation.every if seconds is None else seconds
        run.mkdir(parents=True, exist_ok=True)

    @property
    def trained(self) -> float:
        """Seconds of training, without evaluations."""
        return time.monotonic() - self.began - self.evaluating

    @property
    def over(self) -> bool:
        """Whether the time is up."""
        return self.trained > 60 * self.minutes

    def __call__(self, act: Act, frames: int, updates: int) -> None:
        """Evaluate the deterministic policy ``act`` if it is time."""
        began = time.monotonic()
        if (frames if self.seconds is None else self.trained) < self.next:
            return
        if self.seconds is None:
            self.next += self.settings.evaluation.every
        else:
            self.next = self.trained + self.seconds
        mark = self.run / MARK
        if self.seconds is not None:
            mark.touch()
        policy = TensorDictModule(lambda nodes: act(nodes.flatten(-2)), in_keys=["nodes"], out_keys=["action"])
        row = {"frames": frames, "updates": updates, "wall_s": round(began - self.began, 2)}
        row |= measure(policy, self.env, self.task, self.settings, self.settings.evaluation.seed)
        self.evaluating += time.monotonic() - began
        row[EVALUATING] = round(self.evaluating, 2)
        file = self.run / PROGRESS
        new = not file.exists()
        with file.open("a", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, self.columns, extrasaction="ignore", restval="")
            if new:
                writer.writeheader()
            writer.writerow(row)
        mark.unlink(missing_ok=True)

    def note(self, recipe: dict[str, object]) -> None:
        """Write down what the peer trains with."""
        write_text(self.run / RECIPE, json.dumps(recipe, indent=1) + "\n")


def make_env(settings: TrainSettings) -> gymnasium.Env:
    """One robot with flat observations."""
    return gymnasium.make("gctd3/Biped-v0", **asked(settings))


def asked(settings: TrainSettings) -> dict[str, Any]:
    """The arguments of Gymnasium's ``make`` for the training's robot, task and reward."""
    return {"robot": settings.robot.name, "task": settings.task, "reward": settings.reward}


def make_robots(settings: TrainSettings, robots: int, threads: int) -> gymnasium.Env | VecEnv:
    """One robot, or several that are stepped at once, as Stable-Baselines3 and SBX take them."""
    if robots == 1:
        return make_env(settings)
    from gctd3.sb3 import BatchedVecEnv

    given = {"num_envs": robots, "threads": threads, "autoreset_mode": AutoresetMode.DISABLED}
    return BatchedVecEnv(gymnasium.make_vec("gctd3/Biped-v0", **given, **asked(settings)))


def stable_baselines(
    library: str, algorithm: str, evaluator: Evaluator, seed: int, robots: int = 1, updates: int | None = None
) -> None:
    """Train an algorithm (``td3``, ``sac`` or ``ppo``) of Stable-Baselines3 (``sb3``) or SBX (``sbx``).

    Args:
        library: Whose.
        algorithm: Which.
        evaluator: Evaluates it, and ends it.
        seed: Of the training.
        robots: That are stepped at once.
        updates: Of TD3 and SAC after each step of several robots, -1 for as many as robots; gctd3's if ``None``.
    """
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.noise import NormalActionNoise

    class EvaluationCallback(BaseCallback):
        def _on_step(self) -> bool:
            evaluator(act, self.num_timesteps, self.model._n_updates)
            return not evaluator.over

    def act(observation: Tensor) -> Tensor:
        # A policy is free to act beyond the actions' bounds; `predict` clips.
        return torch.as_tensor(np.array(model.predict(observation.numpy(), deterministic=True)[0]))

    kind = getattr(importlib.import_module(PACKAGES[library]), algorithm.upper())
    env = make_robots(evaluator.settings, robots, evaluator.threads)
    changed: dict[str, Any] = {}
    if robots > 1 and algorithm == "ppo":
        changed["n_steps"] = max(1, inspect.signature(kind).parameters["n_steps"].default // robots)
    elif robots > 1:
        changed["gradient_steps"] = evaluator.settings.gradient_steps if updates is None else updates
    noise = {}
    if algorithm == "td3":
        actions = env.action_space.shape[0]
        noise["action_noise"] = NormalActionNoise(mean=np.zeros(actions), sigma=ACTION_NOISE * np.ones(actions))
    model = kind("MlpPolicy", env, seed=seed, device="cpu", **changed, **noise)
    layers = getattr(model.policy, "net_arch", None) or model.policy.net_arch_pi
    used = {
        name: value for name in HYPERPARAMETERS if isinstance(value := getattr(model, name, None), int | float | str)
    }
    sigma = {"action_noise": ACTION_NOISE} if noise else {}
    evaluator.note({**used, "hidden_sizes": layers, **sigma, "robots": robots, "changed": changed})
    model.learn(ENDLESS, callback=EvaluationCallback())


@dataclass(frozen=True)
class StockRecipe:
    """The values of TorchRL's TD3 example, under its names.

    Attributes:
        init_random_frames: Collected with random actions; learning starts after them.
        frames_per_batch: Collected at once, followed by as many updates times ``utd_ratio``.
        utd_ratio: Updates for each frame.
        size: Size of the replay buffer.
        batch_size: Transitions of an update.
        gamma: Discount factor.
        lr: Learning rate of Adam.
        adam_eps: Epsilon of Adam.
        target_update_polyak: Share of the targets that stays at each update of them.
        policy_update_delay: Critic updates for each update of the actor and the targets.
        policy_noise: Standard deviation of the noise on the target's actions.
        noise_clip: Largest size of that noise.
        hidden_sizes: Layers of actor and critics, with ReLU.
        std: Standard deviation of the exploration noise.
        prefetch: Batches that a thread prepares.
    """

    init_random_frames: int = 25_000
    frames_per_batch: int = 1_000
    utd_ratio: float = 1.0
    size: int = 1_000_000
    batch_size: int = 256
    gamma: float = 0.99
    lr: float = 3e-4
    adam_eps: float = 1e-4
    target_update_polyak: float = 0.995
    policy_update_delay: int = 2
    policy_noise: float = 0.2
    noise_clip: float = 0.5
    hidden_sizes: tuple[int, ...] = (256, 256)
    std: float = 0.1
    prefetch: int = 3


def stock_torchrl(
    evaluator: Evaluator, seed: int, recipe: StockRecipe | None = None, total_frames: int = ENDLESS
) -> None:
    """Train TorchRL's TD3 as its example does, without what that only needs for logging and for several robots."""
    from torchrl import torchrl_logger
    from torchrl.collectors import Collector
    from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
    from torchrl.envs import GymWrapper, InitTracker, TransformedEnv
    from torchrl.modules import MLP, AdditiveGaussianModule, TanhModule, ValueOperator
    from torchrl.objectives import SoftUpdate, TD3Loss

    torchrl_logger.setLevel(logging.WARNING)
    recipe = recipe if recipe is not None else StockRecipe()
    evaluator.note({**asdict(recipe), "robots": 1})
    torch.manual_seed(seed)
    np.random.seed(seed)
    env = TransformedEnv(GymWrapper(make_env(evaluator.settings)), InitTracker())
    env.set_seed(seed)
    spec = env.action_spec_unbatched

    def mlp(outputs: int) -> nn.Module:
        return MLP(num_cells=list(recipe.hidden_sizes), out_features=outputs, activation_class=nn.ReLU)

    actor = TensorDictSequential(
        TensorDictModule(mlp(spec.shape[-1]), in_keys=["observation"], out_keys=["param"]),
        TanhModule(in_keys=["param"], out_keys=["action"], spec=spec),
    )
    critic = ValueOperator(mlp(1), in_keys=["action", "observation"])
    with torch.no_grad():
        critic(actor(env.fake_tensordict()))
    noise = AdditiveGaussianModule(spec=spec, sigma_init=1.0, sigma_end=1.0, mean=0.0, std=recipe.std)
    loss = TD3Loss(
        actor_network=actor,
        qvalue_network=critic,
        num_qvalue_nets=2,
        loss_function="l2",
        action_spec=spec,
        policy_noise=recipe.policy_noise,
        noise_clip=recipe.noise_clip,
    )
    loss.make_value_estimator(gamma=recipe.gamma)
    targets = SoftUpdate(loss, eps=recipe.target_update_polyak)

    def adam(parameters: TensorDictBase) -> torch.optim.Optimizer:
        trained = [p for p in parameters.values(True, True) if isinstance(p, nn.Parameter) and p.requires_grad]
        return torch.optim.Adam(trained, lr=recipe.lr, eps=recipe.adam_eps)

    critic_optimizer, actor_optimizer = adam(loss.qvalue_network_params), adam(loss.actor_network_params)
    replay = TensorDictReplayBuffer(
        storage=LazyTensorStorage(recipe.size), batch_size=recipe.batch_size, prefetch=recipe.prefetch
    )
    collector = Collector(
        env,
        TensorDictSequential(actor, noise),
        init_random_frames=recipe.init_random_frames,
        frames_per_batch=recipe.frames_per_batch,
        total_frames=total_frames,
    )

    def act(observation: Tensor) -> Tensor:
        return actor(observation=observation)[-1]

    frames = updates = 0
    for collected in collector:
        replay.extend(collected.reshape(-1))
        frames += collected.numel()
        learning = frames >= recipe.init_random_frames
        for _ in range(int(recipe.frames_per_batch * recipe.utd_ratio) if learning else 0):
            updates += 1
            batch = replay.sample()
            minimize(critic_optimizer, loss.value_loss(batch)[0])
            if updates % recipe.policy_update_delay == 0:
                minimize(actor_optimizer, loss.actor_loss(batch)[0])
                targets.step()
        evaluator(act, frames, updates)
        if evaluator.over:
            break
    collector.shutdown()


def minimize(optimizer: torch.optim.Optimizer, loss: Tensor) -> None:
    """One step down the gradient of ``loss``."""
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()


def parts(peer: str) -> tuple[str, str]:
    """Return the library and the algorithm of a peer.

    Raises:
        SystemExit: If there is no such peer.
    """
    if peer not in PEERS:
        raise SystemExit(f"peer must be one of {', '.join(PEERS)}, got {peer}")
    library, _, algorithm = peer.partition("-")
    return library, algorithm or "td3"


def versions(peer: str) -> dict[str, str]:
    """Return the versions of the peer's package and its dependencies."""
    from importlib.metadata import version

    names = {"torchrl": ("torchrl", "torch"), "sb3": ("stable-baselines3", "torch"), "sbx": ("sbx-rl", "jax")}
    return {name: version(name) for name in names[parts(peer)[0]]}


def evaluating(run: Path) -> float:
    """Return for how long (s) the run's present evaluation has gone on, 0 where its time counts or there is none."""
    try:
        return max(0.0, time.time() - (run / MARK).stat().st_mtime)
    except FileNotFoundError:
        return 0.0


def installed(peer: str) -> bool:
    """Whether a peer's package is there."""
    return importlib.util.find_spec(PACKAGES[parts(peer)[0]]) is not None


def main() -> None:
    """Train one peer."""
    evaluation = {"every": "", "episodes": ""}
    several = {"robot": "biped", "settings": "", "robots": "1", "updates": "", "seconds": ""}
    given = options(peer="torchrl", run="", seed="0", minutes="20", threads="1", **evaluation, **several)
    library, algorithm = parts(given["peer"])
    robots, threads, seed = int(given["robots"]), int(given["threads"]), int(given["seed"])
    if robots < 1 or (library == "torchrl" and robots > 1):
        raise SystemExit(f"robots must be at least 1, and 1 for torchrl, got {robots}")
    if not given["run"] or (Path(given["run"]) / PROGRESS).exists():
        raise SystemExit("run=DIR must name a directory that holds no run yet")
    torch.set_num_threads(threads)
    settings = shared_settings(
        f"robot={given['robot']}",
        *shlex.split(given["settings"]),
        *(f"evaluation.{name}={given[name]}" for name in evaluation if given[name]),
    )
    seconds = float(given["seconds"]) if given["seconds"] else None
    evaluator = Evaluator(settings, Path(given["run"]), float(given["minutes"]), threads, seconds)
    if library == "torchrl":
        stock_torchrl(evaluator, seed)
    else:
        updates = int(given["updates"]) if given["updates"] else None
        stable_baselines(library, algorithm, evaluator, seed, robots, updates)


if __name__ == "__main__":
    main()
