"""TD3 of other libraries on the biped, each as its own documentation trains it, evaluated like gctd3's policies.

    python benchmarks/peers.py peer=torchrl run=DIR [seed=0] [every=20000] [episodes=5] [minutes=20] [threads=1]

``peer=sb3``: Stable-Baselines3 with its defaults and the action noise of its documentation's TD3 example. ``peer=sbx``:
the same with SBX (JAX). ``peer=torchrl``: TorchRL's own parts put together as in its TD3 example
(``sota-implementations/td3``). All step one ``gctd3/Biped-v0``, flattened, with the reward that gctd3 trains for, on
the CPU, and bootstrap where the task truncates an episode. The run's directory gets ``progress.csv``, a row for each
evaluation under gctd3's own names, and ``recipe.json``, the hyperparameters that were used.
"""

from __future__ import annotations

import csv
import importlib
import json
import logging
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import gymnasium
import numpy as np
import torch
from common import options
from hydra import compose, initialize_config_module
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModule, TensorDictSequential
from torch import Tensor, nn

import gctd3  # noqa: F401 - registers the Gymnasium task
from gctd3.config.build import build
from gctd3.config.command_line import CONF
from gctd3.envs.factory import build_env
from gctd3.evaluation.rollout import evaluate
from gctd3.files import write_text
from gctd3.training.run_log import PROGRESS
from gctd3.training.settings import TrainSettings
from gctd3.training.stop_when import COLUMNS

RECIPE = "recipe.json"
ACTION_NOISE = 0.1  # of the TD3 example in Stable-Baselines3's documentation; the class itself adds none
ENDLESS = 10**8  # steps, more than anybody waits for
PACKAGES = {"torchrl": "torchrl", "sb3": "stable_baselines3", "sbx": "sbx"}

Act = Callable[[Tensor], Tensor]  # observations ``[B, N * F]`` to actions ``[B, A]``


def shared_settings(every: int, episodes: int) -> TrainSettings:
    """The default training's settings: its reward is every peer's too, and so is its evaluation."""
    with initialize_config_module(CONF, version_base="1.3"):
        return build(compose("config", [f"evaluation.every={every}", f"evaluation.episodes={episodes}"]))


class Evaluator:
    """Writes a row of ``progress.csv`` whenever a peer's policy is due, evaluated as :class:`.Trainer` does.

    Args:
        settings: Of :func:`shared_settings`, or of another training whose task and evaluation they share.
        run: The run's directory.
        minutes: After which the training is to end.
        threads: That simulate.
    """

    def __init__(self, settings: TrainSettings, run: Path, minutes: float, threads: int) -> None:
        self.settings, self.run = settings, run
        self.task = settings.setup().task.with_reward(settings.evaluation.reward)
        evaluated = settings.env.for_evaluation(settings.evaluation.episodes, threads)
        self.env = build_env(self.task, evaluated, settings.evaluation.seed)
        self.began = time.monotonic()
        self.ends = self.began + 60 * minutes
        self.next = settings.evaluation.every
        run.mkdir(parents=True, exist_ok=True)

    @property
    def over(self) -> bool:
        """Whether the time is up."""
        return time.monotonic() > self.ends

    def __call__(self, act: Act, frames: int, updates: int) -> None:
        """Evaluate the deterministic policy ``act`` if ``frames`` say that it is time."""
        if frames < self.next:
            return
        self.next += self.settings.evaluation.every
        policy = TensorDictModule(lambda nodes: act(nodes.flatten(-2)), in_keys=["nodes"], out_keys=["action"])
        wall = time.monotonic() - self.began
        result = evaluate(policy, self.env, self.task, self.settings.evaluation.seed)
        row = {"frames": frames, "updates": updates, "wall_s": round(wall, 2), **result.summary(), **result.gait()}
        file = self.run / PROGRESS
        new = not file.exists()
        with file.open("a", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, COLUMNS, extrasaction="ignore", restval="")
            if new:
                writer.writeheader()
            writer.writerow(row)

    def note(self, recipe: dict[str, object]) -> None:
        """Write down what the peer trains with."""
        write_text(self.run / RECIPE, json.dumps(recipe, indent=1) + "\n")


def make_env(settings: TrainSettings) -> gymnasium.Env:
    """One biped with flat observations."""
    return gymnasium.wrappers.FlattenObservation(gymnasium.make("gctd3/Biped-v0", reward=settings.reward))


def stable_baselines(package: str, evaluator: Evaluator, seed: int) -> None:
    """Train Stable-Baselines3's (``stable_baselines3``) or SBX's (``sbx``) TD3."""
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.noise import NormalActionNoise

    class EvaluationCallback(BaseCallback):
        def _on_step(self) -> bool:
            evaluator(act, self.num_timesteps, self.model._n_updates)
            return not evaluator.over

    def act(observation: Tensor) -> Tensor:
        return torch.as_tensor(model.predict(observation.numpy(), deterministic=True)[0])

    env = make_env(evaluator.settings)
    actions = env.action_space.shape[0]
    noise = NormalActionNoise(mean=np.zeros(actions), sigma=ACTION_NOISE * np.ones(actions))
    model = importlib.import_module(package).TD3("MlpPolicy", env, action_noise=noise, seed=seed, device="cpu")
    names = ("learning_rate", "buffer_size", "learning_starts", "batch_size", "tau", "gamma", "gradient_steps")
    others = ("policy_delay", "target_policy_noise", "target_noise_clip", "n_steps")
    layers = getattr(model.policy, "net_arch", None) or model.policy.net_arch_pi
    used = {name: getattr(model, name) for name in (*names, *others)}
    evaluator.note({**used, "hidden_sizes": layers, "action_noise": ACTION_NOISE, "robots": 1})
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


def versions(peer: str) -> dict[str, str]:
    """Return the versions of the peer's package and its dependencies."""
    from importlib.metadata import version

    names = {"torchrl": ("torchrl", "torch"), "sb3": ("stable-baselines3", "torch"), "sbx": ("sbx-rl", "jax")}
    return {name: version(name) for name in names[peer]}


def main() -> None:
    """Train one peer."""
    given = options(peer="torchrl", run="", seed="0", every="20000", episodes="5", minutes="20", threads="1")
    if given["peer"] not in PACKAGES:
        raise SystemExit(f"peer must be one of {', '.join(PACKAGES)}, got {given['peer']}")
    if not given["run"] or (Path(given["run"]) / PROGRESS).exists():
        raise SystemExit("run=DIR must name a directory that holds no run yet")
    threads, seed = int(given["threads"]), int(given["seed"])
    torch.set_num_threads(threads)
    settings = shared_settings(int(given["every"]), int(given["episodes"]))
    evaluator = Evaluator(settings, Path(given["run"]), float(given["minutes"]), threads)
    if given["peer"] == "torchrl":
        stock_torchrl(evaluator, seed)
    else:
        stable_baselines(PACKAGES[given["peer"]], evaluator, seed)


if __name__ == "__main__":
    main()
