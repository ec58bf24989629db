"""Judge a policy: ``python -m gctd3.evaluate run=DIR episodes=50``."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from omegaconf import DictConfig
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type, step_mdp

from gctd3.cli import command
from gctd3.envs.factory import build_env
from gctd3.envs.gait import FEATURES
from gctd3.envs.library import LibrarySettings
from gctd3.envs.reward import Reward
from gctd3.episode import LAST_METRES, Episode
from gctd3.errors import ConfigError, check_seed
from gctd3.faults import check_finite
from gctd3.files import write_text
from gctd3.gait_summary import OF_STRIDES, summarize
from gctd3.graph import KinematicGraph
from gctd3.motion import Recorder
from gctd3.nodes import foot_slots
from gctd3.robot import Robot
from gctd3.settings import build

# Table 5 of the paper, column GCTD3. Its body position seems to count from the spawn height, 0.0235 m above standing.
PAPER = {"return_mean": 380.0, "return_std": 18.47, "velocity_mean": 1.414, "body_position_mean": -0.0202}
EVALUATION, TRACE = "evaluation.json", "trace.csv"


@dataclass(frozen=True)
class Evaluation:
    """Many episodes of one policy.

    Attributes:
        episodes: The episodes.
        control_dt: Control period (s).
    """

    episodes: list[Episode]
    control_dt: float

    @property
    def returns(self) -> np.ndarray:
        """Shape ``[episodes]``."""
        return np.array([episode.reward.sum() for episode in self.episodes])

    def summary(self) -> dict[str, float | int]:
        """The headline numbers: means over episodes, ``return_std`` their standard deviation."""
        episodes = self.episodes
        return {
            "episodes": len(episodes),
            "return_mean": float(self.returns.mean()),
            "return_std": float(self.returns.std()),
            "velocity_mean": float(np.mean([e.velocity(self.control_dt) for e in episodes])),
            "distance_mean": float(np.mean([e.position[-1] for e in episodes])),
            "success_rate": float(np.mean([e.success for e in episodes])),
            "body_position_mean": float(np.mean(np.concatenate([e.height for e in episodes]))),
        }

    @property
    def typical(self) -> Episode:
        """The episode whose return is the median one, or just below."""
        return self.episodes[int(np.argsort(self.returns, kind="stable")[(len(self.episodes) - 1) // 2])]

    def gait(self) -> dict[str, float]:
        """Gait metrics over the last 10 m, averaged over the episodes that got that far; empty if none did."""
        gaits = [gait for e in self.episodes if (gait := e.gait(self.control_dt)) is not None]
        if not gaits:
            return {}
        averages = {key: float(np.mean([gait[key] for gait in gaits])) for key in gaits[0]}
        return {"episodes": len(gaits), **averages}


def evaluate(
    policy: TensorDictModuleBase, env: EnvBase, robot: Robot, seed: int, control_dt: float, record: bool = False
) -> Evaluation:
    """Run one episode on every robot of ``env``.

    Args:
        policy: Reads ``"nodes"``, writes ``"action"``; its mode is taken if it is stochastic.
        env: Of :func:`gctd3.envs.factory.build_env`, batch size ``[episodes]``.
        robot: Its robot.
        seed: Of the starts: equal seeds, equal starts.
        control_dt: Control period (s).
        record: Whether to keep each episode's motion; only for the batched backend.

    Raises:
        NumericalError: If an action of the policy is not finite.
    """
    names = KinematicGraph.from_robot(robot).nodes
    ground, feature = foot_slots(robot).T
    hips = [names.index(leg[0].name) for leg in robot.legs]
    count = env.batch_size[0]
    alive = torch.ones(count, dtype=torch.bool)
    frames: list[tuple[torch.Tensor, ...]] = []
    # TorchRL seeds the global generator along with the environment's: a fork keeps that out of the training.
    with torch.random.fork_rng(devices=[]), torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
        env.set_seed(seed)
        state = env.reset()
        recorder = Recorder(robot, env.base_env.simulation) if record else None
        while alive.any():
            acting = policy(state)
            check_finite("action", acting["action"])
            state = env.step(acting)
            if recorder is not None:
                recorder.add(acting["action"].numpy().astype(np.float64))
            after = state["next"]
            # A policy that sees the task's own observation has what the nodes sense beside it.
            newest = after.get("sensed", after["nodes"])[..., -FEATURES:]
            frames.append((alive, after["reward"][:, 0], after["position"][:, 0], newest, after["success"][:, 0]))
            alive = alive & ~after["done"][:, 0]
            state = step_mdp(state)
    lived, reward, position, nodes, success = (torch.stack(column).numpy() for column in zip(*frames, strict=True))
    lengths = [int(steps) for steps in lived.sum(axis=0)]
    motions = recorder.motions(lengths) if recorder is not None else [None] * count
    episodes = []
    for i, steps in enumerate(lengths):
        mine = nodes[:steps, i]
        episodes.append(
            Episode(
                reward=reward[:steps, i].astype(np.float64),
                position=position[:steps, i],
                height=mine[:, 0, 0],
                hips=mine[:, hips, 0] * robot.hip_signs,
                feet_down=mine[:, ground, feature] > 0.5,
                pairs=tuple((i, other) for i, other in enumerate(robot.mirror_feet) if i < other),
                success=bool(success[:steps, i].any()),
                motion=motions[i],
            )
        )
    return Evaluation(episodes, control_dt)


@dataclass(frozen=True)
class EvaluateSettings:
    """What ``gctd3.evaluate`` is asked to do.

    Attributes:
        run: Directory of the run; the policy that ships with the library if ``None``.
        reward: Under which to judge.
        episodes: How many, each from its own start.
        seed: Of the starts.
        threads: That simulate; all cores if ``None``.
        out: Directory to write to; the run's if ``None``, nowhere if there is no run either.
    """

    run: str | None
    reward: Reward
    episodes: int = 50
    seed: int = 10_000
    threads: int | None = None
    out: str | None = None

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise ConfigError(f"episodes must be at least 1, got {self.episodes}.")
        check_seed("seed", self.seed)

    @property
    def folder(self) -> Path | None:
        """Where to write."""
        place = self.run if self.out is None else self.out
        return Path(place) if place is not None else None


def evaluate_run(settings: EvaluateSettings) -> dict[str, object]:
    """Judge the best policy of a run and write ``evaluation.json`` and ``trace.csv`` to ``settings.folder``.

    Returns:
        What was written.

    Raises:
        RunError: If the directory is not a run, or one of another version.
    """
    from gctd3.checkpoint import load_policy, versions
    from gctd3.run_config import find_run, load_settings

    run = find_run(settings.run)
    trained = load_settings(run)
    policy = load_policy(run)
    folder = settings.folder
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    robot = trained.load_robot()
    judged = trained.env.judging(settings.episodes, settings.threads)
    env = build_env(robot, judged, settings.reward, settings.seed)
    walks = not isinstance(judged, LibrarySettings)
    result = evaluate(policy, env, robot, settings.seed, judged.control_dt, record=walks)
    task = {"task": judged.task} if isinstance(judged, LibrarySettings) else {"reward": asdict(settings.reward)}
    report: dict[str, object] = {
        **task,
        **result.summary(),
        "gait": {**result.gait(), **(summarize(result.episodes, robot, judged.control_dt) if walks else {})},
        "seeds": {"training": trained.seed, "evaluation": settings.seed},
        "versions": versions(),
    }
    report = {key: _finite(value) for key, value in report.items()}
    if folder is not None:
        if walks:
            write_text(folder / TRACE, trace(result.typical, robot, judged.control_dt))
        write_text(folder / EVALUATION, json.dumps(report, indent=2) + "\n")
    return report


def trace(episode: Episode, robot: Robot, dt: float) -> str:
    """An episode whose motion was recorded as CSV, a row for each control step, units in the head.

    Raises:
        ValueError: If its motion was not recorded.
    """
    motion = episode.motion
    if motion is None:
        raise ValueError("The episode's motion was not recorded; evaluate(..., record=True) does.")
    names = [joint.name for joint in robot.joints]
    head = ["time_s", "position_m", "height_m", "velocity_m_s"]
    head += [f"angle_{name}_rad" for name in names] + [f"velocity_{name}_rad_s" for name in names]
    head += [f"down_{foot}" for foot in robot.feet]
    time = dt * np.arange(1, len(episode.position) + 1)
    columns = [time, episode.position, episode.height, motion.velocity, *motion.angles.T, *motion.velocities.T]
    rows = zip(*columns, *episode.feet_down.T.astype(int), strict=True)
    return "\n".join([",".join(head), *(",".join(f"{value:.6g}" for value in row) for row in rows)]) + "\n"


def table(report: dict[str, object]) -> str:
    """The report beside the paper's row."""
    rows = [
        ("episodes", "episodes", "{:.0f}", None),
        ("return", "return_mean", "{:.1f}", "return_std"),
        ("velocity, m/s", "velocity_mean", "{:.3f}", None),
        ("distance, m", "distance_mean", "{:.2f}", None),
        ("success rate", "success_rate", "{:.2f}", None),
        ("body position, m from standing", "body_position_mean", "{:.4f}", None),
    ]
    lines = [f"{'':34}{'this policy':>18}{'paper, GCTD3':>18}"]

    def cell(values: dict[str, object], key: str, form: str, spread: str | None) -> str:
        if key not in values:
            return "-"
        text = form.format(values[key])
        return f"{text} ± {form.format(values[spread])}" if spread else text

    # The paper has nothing to say of a library's task.
    paper: dict[str, object] = {} if "task" in report else {**PAPER, "episodes": 50}
    for label, key, form, spread in rows:
        lines.append(f"{label:34}{cell(report, key, form, spread):>18}{cell(paper, key, form, spread):>18}")
    gait = report["gait"]
    if not isinstance(gait, dict) or not gait:
        return "\n".join([*lines, f"No episode got {LAST_METRES:.0f} m far, so there is no gait to measure."])
    lines += ["", f"Gait over the last {LAST_METRES:.0f} m of {gait['episodes']:.0f} episodes"]
    for key, value in gait.items():
        if key != "episodes":
            said = f"{value:.4g}" if value is not None else "not periodic" if key in OF_STRIDES else "undefined"
            lines.append(f"{key.replace('_', ' '):34}{said:>18}")
    return "\n".join(lines)


def _finite(value: object) -> object:
    """``value`` with undefined numbers as ``null``, which JSON can hold."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _task(config: DictConfig) -> None:
    settings: EvaluateSettings = build(config)
    report = evaluate_run(settings)
    print(table(report))
    if settings.folder is not None:
        print(f"\nWritten to {settings.folder / EVALUATION}")


def main() -> None:
    """Entry point of ``python -m gctd3.evaluate``."""
    command("evaluate", _task)


if __name__ == "__main__":
    main()
