"""Export a policy to run elsewhere: ``python -m gctd3.export run=DIR out=policy.onnx``."""

from __future__ import annotations

import hashlib
import io
import logging
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from gctd3.deploy.contract import Contract
from gctd3.deploy.cpp_policy import to_cpp
from gctd3.deploy.network import metadata, open_session
from gctd3.deploy.robot_contract import Rehearsed, describe, warnings_of
from gctd3.deploy.settings import ExportSettings
from gctd3.envs.factory import build_env
from gctd3.envs.settings import EnvSettings
from gctd3.errors import NumericalError
from gctd3.evaluation.rollout import evaluate
from gctd3.files import check_writable, write_bytes, write_text
from gctd3.nn.actor import ACTION, NODES
from gctd3.runs.load import load_run
from gctd3.tasks.simulated_task import SimulatedTask
from gctd3.training.checkpoint import POLICY, Checkpoints, checked, versions

# The operator set in which PyTorch's exporter is written; it converts every later one from it.
OPSET = 18
NEEDED = ("onnx", "onnxscript", "onnxruntime")
Act = Callable[[np.ndarray], np.ndarray]  # states to actions
STATES, TOLERANCE = 10_000, 1e-5  # states of the comparison with PyTorch, and the largest difference of an action
MARGIN = 1.2  # factor of the largest observed change of a desired angle
INSIDE = "policy.json"  # name of the contract inside a .pt2 file


class Deterministic(nn.Module):
    """Compute the deterministic action of any kind of policy, as a function of tensors.

    Shapes:
        input ``[B, N, F]``, output ``[B, A]`` in [-1, 1].
    """

    def __init__(self, policy: TensorDictModuleBase) -> None:
        super().__init__()
        self.policy = policy
        self._which = list(policy.out_keys).index(ACTION)

    def forward(self, nodes: Tensor) -> Tensor:
        """Compute the action for the node features ``nodes``."""
        with set_exploration_type(ExplorationType.DETERMINISTIC):
            out = self.policy(nodes=nodes)
        return out[self._which] if isinstance(out, tuple) else out


@dataclass(frozen=True)
class Exported:
    """Describe the result of an export.

    Attributes:
        files: Files that were written.
        difference: Largest difference of an action from PyTorch's over ``states`` states, half of them visited in the
            simulation, half of them random.
        states: Number of states.
        warnings: A line for each thing that the robot's software has to do.
    """

    files: tuple[Path, ...]
    difference: float
    states: int
    warnings: tuple[str, ...] = ()


def export_run(settings: ExportSettings) -> Exported:
    """Export the best policy of a run.

    Raises:
        RunError: If the directory is not a run, or the run is of another library's task.
        NumericalError: If the exported network differs from PyTorch's.
    """
    run, out = load_run(settings.run), Path(settings.out)
    check_writable(out)
    task = run.task("export")
    manifest, policy = checked(Checkpoints(run.directory).best()), run.policy()
    visited, change = rehearse(policy, task, run.settings.env, settings)
    if settings.max_rate is not None:
        change = np.full_like(change, settings.max_rate * task.control_dt)
    contract = describe(
        task,
        Rehearsed(visited[..., -task.features :], change),
        weights=manifest["files"][POLICY],
        frames_trained=int(manifest["frames"]),
        trained_with=manifest["versions"],
        exported_with=versions(NEEDED if out.suffix != ".pt2" else ()),
        hold=settings.hold,
        home_rate=settings.home_rate,
    )
    warned = tuple(warnings_of(contract, task.robot))
    network, states = Deterministic(policy).eval(), _states(visited)
    with torch.no_grad():
        program = traced(network, states.shape[1:])
        if out.suffix == ".pt2":
            content, act = to_pt2(program, contract.to_json())
        else:
            content, act = to_onnx(program, contract)
            seal = hashlib.sha256(content).hexdigest()
            contract = replace(contract, network=replace(contract.network, sha256=seal, opset=OPSET))
        difference = float(np.abs(act(states) - network(torch.from_numpy(states)).numpy()).max())
    if not difference <= TOLERANCE:
        raise NumericalError(
            f"The exported network's actions differ from PyTorch's by up to {difference:g}, allowed is {TOLERANCE:g}; "
            "nothing was written."
        )
    if out.suffix == ".hpp":
        # Its contract is inside, and names no other file.
        inside = replace(contract, network=replace(contract.network, sha256=None))
        content = to_cpp(content, inside).encode()
    write_bytes(out, content)
    if out.suffix != ".onnx":
        return Exported((out,), difference, len(states), warned)
    beside = out.with_suffix(".json")
    write_text(beside, contract.to_json())
    return Exported((out, beside), difference, len(states), warned)


def rehearse(
    policy: TensorDictModuleBase, task: SimulatedTask, env: EnvSettings, settings: ExportSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Run a policy in simulation, and measure how fast it changes the desired joint angles.

    Returns:
        The visited states, shape ``[T, N, F]``, and ``1.2`` times the largest change of each desired angle in a step,
        the first one from the joint's start included, shape ``[A]`` (rad).
    """
    seen: list[tuple[Tensor, Tensor]] = []
    hook = policy.register_forward_hook(lambda _, __, out: seen.append((out[NODES].clone(), out[ACTION].clone())))
    robot = task.robot
    robots = build_env(task, env.for_evaluation(settings.episodes, settings.threads), settings.seed)
    result = evaluate(policy, robots, task, settings.seed)
    hook.remove()
    nodes, actions = (torch.stack(column, dim=1).numpy() for column in zip(*seen, strict=True))
    desired = robots.base_env.simulation.desired(actions.astype(np.float64))
    start = robot.start_qpos[[robot.joint(name).qpos for name in robot.actuated]]
    lengths = [len(episode.position) for episode in result.episodes]
    paths = [np.concatenate([start[None], path[:steps]]) for path, steps in zip(desired, lengths, strict=True)]
    change = np.max([np.abs(np.diff(path, axis=0)).max(axis=0) for path in paths], axis=0)
    return np.concatenate([path[:steps] for path, steps in zip(nodes, lengths, strict=True)]), MARGIN * change


def _states(visited: np.ndarray) -> np.ndarray:
    """Draw the ``STATES`` states of the comparison, half of them visited, half of them normally distributed."""
    rng = np.random.default_rng(0)
    drawn = visited[rng.integers(len(visited), size=STATES // 2)]
    return np.concatenate([drawn, rng.standard_normal((STATES - len(drawn), *visited.shape[1:]), dtype=np.float32)])


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress the messages of PyTorch's exporter on its own code, its passes and packages that are not needed."""
    loggers = [logging.getLogger(name) for name in ("onnx_ir", "onnxscript", "torch.onnx")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=r"`isinstance\(treespec, LeafSpec\)`", category=FutureWarning)
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


@_quiet()
def traced(network: Deterministic, shape: tuple[int, ...]) -> torch.export.ExportedProgram:
    """Export the network's graph for any batch size, without the paths of its source files on this machine."""
    example = torch.zeros(2, *shape)
    # With a named dimension the exporter wants a proof, which fails on the reshapes of the nodes' layer normalisation.
    batch = torch.export.Dim.DYNAMIC
    program = torch.export.export(network, (example,), dynamic_shapes={NODES: {0: batch}}, strict=False)
    for node in program.graph.nodes:
        node.meta.pop("stack_trace", None)
    return program


@_quiet()
def to_onnx(program: torch.export.ExportedProgram, contract: Contract) -> tuple[bytes, Act]:
    """Return the content of an ONNX file, and its network as a function."""
    passes: Any = import_module("onnx_ir.passes.common")
    made = torch.onnx.export(
        program,
        dynamo=True,
        verbose=False,
        opset_version=OPSET,
        input_names=[NODES],
        output_names=[ACTION],
        dynamic_shapes={NODES: {0: "batch"}},
    )
    if made is None:
        raise RuntimeError("torch.onnx.export made no program.")
    passes.ClearMetadataAndDocStringPass()(made.model)  # paths of source files on this machine
    made.model.metadata_props.update(metadata(contract))
    content = made.model_proto.SerializeToString()
    session = open_session(content)
    return content, lambda states: session.run([ACTION], {NODES: states})[0]


@_quiet()
def to_pt2(program: torch.export.ExportedProgram, contract: str) -> tuple[bytes, Act]:
    """Return the content of a file of ``torch.export``, and its network as a function."""
    file = io.BytesIO()
    torch.export.save(program, file, extra_files={INSIDE: contract})
    network = torch.export.load(io.BytesIO(file.getvalue())).module()
    return file.getvalue(), lambda states: network(torch.from_numpy(states)).numpy()
