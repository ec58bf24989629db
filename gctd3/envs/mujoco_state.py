"""The whole state of one MuJoCo simulator, and of the task of another library that is built on it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from gctd3.compat import wrapped_env

INTEGRATION = mujoco.mjtState.mjSTATE_INTEGRATION.value
# Prefixes of a model's arrays; some tasks move or resize these at a reset (targets, lights).
MOVABLE = ("actuator_", "body_", "cam_", "dof_", "eq_", "geom_", "jnt_", "light_", "site_", "tendon_")
Generator = np.random.Generator | np.random.RandomState


def integration_state(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """Return everything that the next physics step depends on, as one vector."""
    state = np.empty(mujoco.mj_stateSize(model, INTEGRATION))
    mujoco.mj_getState(model, data, state, INTEGRATION)
    return state


def load_integration_state(model: mujoco.MjModel, data: mujoco.MjData, state: np.ndarray) -> None:
    """Restore the state returned by :func:`integration_state`."""
    mujoco.mj_setState(model, data, np.array(state), INTEGRATION)


def task_state(task: Any, model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, Any]:  # noqa: ANN401
    """Return the state of a task of dm_control's suite or Gymnasium's MuJoCo robots, which have no method for it.

    Besides the simulator's state these are numbers, arrays and random generators in the attributes of the task and of
    its wrappers: counters of steps, goals, whether a reset is due. The memory that a task keeps in other types (lists,
    objects of its own) is not saved.

    Args:
        task: A ``dm_control.rl.control.Environment`` or a ``gymnasium.Env``.
        model: Model of its simulator.
        data: Data of its simulator.
    """
    return {
        "integration": integration_state(model, data),
        # Rewards may read values derived before the last integration, so these are kept and not recomputed.
        "derived": _joined(_derived(model, data)),
        "model": _joined(_movable(model)),
        "layers": [_attributes(layer) for layer in _layers(task)],
    }


def load_task_state(task: Any, model: mujoco.MjModel, data: mujoco.MjData, state: dict[str, Any]) -> None:  # noqa: ANN401
    """Restore the state returned by :func:`task_state`.

    Raises:
        ValueError: If it is of another task.
    """
    _spread(state["model"], _movable(model))
    load_integration_state(model, data, state["integration"])
    # Contacts and constraints, whose number varies; then the rest as it was.
    mujoco.mj_step1(model, data)
    _spread(state["derived"], _derived(model, data))
    for layer, attributes in zip(_layers(task), state["layers"], strict=True):
        unknown = [name for part in attributes.values() for name in part if name not in vars(layer)]
        if unknown:
            raise ValueError(f"A {type(layer).__name__} has no {', '.join(unknown)}.")
        for name, value in attributes["values"].items():
            setattr(layer, name, np.array(value) if isinstance(value, np.ndarray) else value)
        for name, value in attributes["generators"].items():
            _set_generator(getattr(layer, name), value)


def _layers(task: Any) -> Iterator[Any]:  # noqa: ANN401
    """Yield the objects that hold the task's memory, from the outside in."""
    if hasattr(task, "physics"):
        # The suite's wrappers pass attribute access on to the task, and hold no state.
        while (inner := wrapped_env(task)) is not None:
            task = inner
        yield from (task, task.task)
        return
    while task is not task.unwrapped:
        yield task
        task = task.env
    yield task


def _attributes(layer: Any) -> dict[str, dict[str, Any]]:  # noqa: ANN401
    attributes = vars(layer).items()
    numbers = (bool, int, float, np.generic, np.ndarray)
    return {
        "values": {
            name: np.array(value) if isinstance(value, np.ndarray) else value
            for name, value in attributes
            if isinstance(value, numbers) and np.asarray(value).dtype.kind in "biuf"
        },
        "generators": {name: _get_generator(value) for name, value in attributes if isinstance(value, Generator)},
    }


def _get_generator(generator: Generator) -> dict[str, Any]:
    if isinstance(generator, np.random.Generator):
        return dict(generator.bit_generator.state)
    return dict(generator.get_state(legacy=False))


def _set_generator(generator: Generator, state: dict[str, Any]) -> None:
    if isinstance(generator, np.random.Generator):
        generator.bit_generator.state = state
    else:
        generator.set_state(state)


def _derived(model: mujoco.MjModel, data: mujoco.MjData) -> list[np.ndarray]:
    """Return the arrays of a simulator's data whose size does not depend on its contacts and constraints."""
    fresh = mujoco.MjData(model)
    fixed = [name for name in _float_arrays(fresh) if getattr(fresh, name).size]
    return [getattr(data, name) for name in fixed]


def _movable(model: mujoco.MjModel) -> list[np.ndarray]:
    return [getattr(model, name) for name in _float_arrays(model) if name.startswith(MOVABLE)]


def _float_arrays(owner: Any) -> list[str]:  # noqa: ANN401
    names = (name for name in sorted(dir(owner)) if not name.startswith("_"))
    arrays = ((name, getattr(owner, name, None)) for name in names)
    return [name for name, value in arrays if isinstance(value, np.ndarray) and value.dtype.kind == "f"]


def _joined(arrays: list[np.ndarray]) -> np.ndarray:
    return np.concatenate([array.reshape(-1).astype(np.float64) for array in arrays])


def _spread(values: np.ndarray, arrays: list[np.ndarray]) -> None:
    sizes = [array.size for array in arrays]
    if len(values) != sum(sizes):
        raise ValueError(f"A simulator's state has {sum(sizes)} numbers, got {len(values)}.")
    for array, part in zip(arrays, np.split(values, np.cumsum(sizes)[:-1]), strict=True):
        array[...] = part.reshape(array.shape)
