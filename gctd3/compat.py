"""All uses of other libraries' private names.

A private name may change with any release. Each function here has a plain name, names the private name it uses and the
version in which that was last seen, and raises a :class:`CompatError` with both once it is gone. Nothing heavy is
imported: objects of other libraries come as arguments.
"""

from __future__ import annotations

import contextlib
import copy
import functools
import importlib
import os
import sys
import types
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from gctd3.errors import GCTD3Error

TORCH, TENSORDICT, TORCHRL = "torch 2.13.0", "tensordict 0.14.3", "torchrl 0.14.1"
OMEGACONF, HYDRA = "omegaconf 2.3.1", "hydra-core 1.3.8"
VISER = "viser 1.1.1"
_DYNAMO = "torch._dynamo"


class CompatError(GCTD3Error, RuntimeError):
    """Report that another library no longer has a private name that gctd3 uses."""


def read(owner: object, name: str, seen: str) -> Any:  # noqa: ANN401
    """Read an attribute with a private name.

    Args:
        owner: The object or class that has the attribute.
        name: The private name.
        seen: Library and version that have the name.

    Raises:
        CompatError: If ``owner`` has no such attribute.
    """
    try:
        return getattr(owner, name)
    except AttributeError as error:
        kind = owner if isinstance(owner, type) else type(owner)
        raise CompatError(
            f"{kind.__module__}.{kind.__qualname__} has no {name}, which gctd3 uses and which {seen} has; "
            f"install that version, or mend gctd3/compat.py."
        ) from error


def _need_behind(cls: type, mixin: type, name: str, seen: str) -> None:
    """Raise a :class:`CompatError` if the bases behind a mixin of a class lack the name that the mixin overrides."""
    behind = cls.__mro__[cls.__mro__.index(mixin) + 1 :]
    if behind != (object,) and not any(hasattr(base, name) for base in behind):
        read(behind[0], name, seen)


# PyTorch


def has_hooks(module: Any) -> bool:  # noqa: ANN401 - a torch.nn.Module
    """Tell whether functions are hooked into a module's forward or backward pass.

    Private: ``_forward_hooks``, ``_forward_pre_hooks``, ``_backward_hooks``, ``_backward_pre_hooks`` of
    ``torch.nn.Module`` (torch 2.13.0).
    """
    names = "_forward_hooks", "_forward_pre_hooks", "_backward_hooks", "_backward_pre_hooks"
    return any(read(module, name, TORCH) for name in names)


class _Later(types.ModuleType):
    """Stand in for ``torch._dynamo`` until something needs more of it than to mark functions for it."""

    def __init__(self) -> None:
        super().__init__(_DYNAMO)
        self.marks: list[tuple[str, Any]] = []

    def allow_in_graph(self, function: Any) -> Any:  # noqa: ANN401 - PyTorch's
        self.marks.append(("allow_in_graph", function))
        return function

    def assume_constant_result(self, function: Any) -> Any:  # noqa: ANN401 - PyTorch's
        self.marks.append(("assume_constant_result", function))
        return function

    def disable(self, fn: Any = None, recursive: bool = True, **_: object) -> Any:  # noqa: ANN401 - PyTorch's
        # Nothing is compiled, or the module would be here.
        return (lambda function: function) if fn is None else fn

    def graph_break(self, *_: object, **__: object) -> None:
        """Do nothing, as the module's own outside of what it compiles."""

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401
        if name in ("__spec__", "__file__", "__warningregistry__"):
            raise AttributeError(name)
        return getattr(self.load(), name)

    def load(self) -> types.ModuleType:
        """Import the module itself, with the marks that were made, in place of this one."""
        if sys.modules.get(_DYNAMO) is self:
            del sys.modules[_DYNAMO]
            module = importlib.import_module(_DYNAMO)
            for mark, function in self.marks:
                getattr(module, mark)(function)
        return sys.modules[_DYNAMO]


def postpone_compiler() -> None:
    """Let TensorDict and TorchRL be imported without PyTorch's compiler, a second and 60 MB that trainings do not need.

    Both mark functions for it while they are imported. The marks are kept, and the compiler is imported as soon as
    anything else of it is asked for.

    Private: the package ``torch._dynamo`` (torch 2.13.0), whose ``allow_in_graph`` and ``assume_constant_result``
    return the functions that they mark.
    """
    if _DYNAMO not in sys.modules:
        sys.modules[_DYNAMO] = _Later()


def import_compiler() -> None:
    """Import PyTorch's compiler if :func:`postpone_compiler` postponed it."""
    later = sys.modules.get(_DYNAMO)
    if isinstance(later, _Later):
        later.load()


# MuJoCo


@contextlib.contextmanager
def without_screen() -> Iterator[None]:
    """Let MuJoCo be imported in the block without GLFW, whose search for its library takes up to half a second.

    Only ``mujoco.Renderer`` needs it, which gctd3 does not use. All names are public; that MuJoCo imports GLFW unless
    ``MUJOCO_GL`` says otherwise is not documented (mujoco 3.17.0).
    """
    before = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = "disable"
    try:
        yield
    finally:
        if before is None:
            del os.environ["MUJOCO_GL"]
        else:
            os.environ["MUJOCO_GL"] = before


# TensorDict


class PlainOutputs:
    """Let a TensorDictModule write tensors as they are; stands before it among the bases of a class.

    TensorDict would see whether each is a table of pandas, and import that, which takes half a second and 45 MB.

    Private: ``TensorDictModuleBase._write_to_tensordict`` (tensordict 0.14.3).

    Raises:
        CompatError: If a class is made of a module without it: outputs would be written in the old way.
    """

    def __init_subclass__(cls, **kwargs: Any) -> None:  # noqa: ANN401
        super().__init_subclass__(**kwargs)
        _need_behind(cls, PlainOutputs, "_write_to_tensordict", TENSORDICT)

    def _write_to_tensordict(
        self,
        tensordict: Any,  # noqa: ANN401
        tensors: Any,  # noqa: ANN401
        tensordict_out: Any = None,  # noqa: ANN401
        out_keys: Any = None,  # noqa: ANN401
    ) -> Any:  # noqa: ANN401
        keys = self.out_keys if out_keys is None else out_keys  # type: ignore[attr-defined]
        if tensordict_out is not None or self.inplace is not True or len(keys) != len(tensors):  # type: ignore[attr-defined]
            return super()._write_to_tensordict(tensordict, tensors, tensordict_out, out_keys)  # type: ignore[misc]
        for key, tensor in zip(keys, tensors, strict=True):
            tensordict.set(key, tensor)
        return tensordict


# TorchRL's losses


class LossHooks:
    """Give a TorchRL loss hooks with plain names; stands before the loss among the bases of a class.

    Private: ``_apply`` of ``torch.nn.Module`` (torch 2.13.0); ``_set_in_keys``, ``_in_keys`` and ``_make_vmap`` of
    ``TD3Loss`` and ``SACLoss`` (torchrl 0.14.1).

    Raises:
        CompatError: If a class is made of a loss that lacks one of them: its hooks would never be called.
    """

    def __init_subclass__(cls, **kwargs: Any) -> None:  # noqa: ANN401
        super().__init_subclass__(**kwargs)
        for name, seen in (("_apply", TORCH), ("_set_in_keys", TORCHRL), ("_make_vmap", TORCHRL)):
            _need_behind(cls, LossHooks, name, seen)

    def parameters_move(self) -> None:
        """Prepare for the loss's tensors to be replaced, as ``to`` does."""

    def more_in_keys(self) -> list[Any]:
        """Name the keys that the loss reads besides TorchRL's."""
        return []

    def vmaps_made(self) -> None:
        """React to TorchRL having made the functions that evaluate its networks."""

    def _apply(self, *args: Any, **kwargs: Any) -> Any:  # noqa: ANN401
        self.parameters_move()
        return super()._apply(*args, **kwargs)  # type: ignore[misc]

    def _set_in_keys(self) -> None:
        super()._set_in_keys()  # type: ignore[misc]
        self._in_keys = list({*self._in_keys, *self.more_in_keys()})  # type: ignore[has-type]

    def _make_vmap(self) -> None:
        super()._make_vmap()  # type: ignore[misc]
        self.vmaps_made()


def priority_weight(loss: Any, tensordict: Any) -> Any:  # noqa: ANN401
    """Read the weights of prioritised replay from a batch, or ``None``.

    Private: ``LossModule._maybe_get_priority_weight`` (torchrl 0.14.1).
    """
    return read(loss, "_maybe_get_priority_weight", TORCHRL)(tensordict)


def reduce_loss(loss: Any, value: Any, tensordict: Any, weights: Any) -> Any:  # noqa: ANN401
    """Reduce a loss ``[*]`` as the loss module's ``reduction``, masks and weights say.

    Private: ``LossModule._reduce_loss`` (torchrl 0.14.1).
    """
    return read(loss, "_reduce_loss", TORCHRL)(value, tensordict=tensordict, weights=weights)


def vmapped_critics(loss: Any, tensordict: Any, params: Any) -> Any:  # noqa: ANN401
    """Evaluate all critics of a TD3 loss on a batch expanded to ``[E, *]``, with parameters stacked to ``[E, ...]``.

    Private: ``TD3Loss._vmap_qvalue_network00`` (torchrl 0.14.1).
    """
    return read(loss, "_vmap_qvalue_network00", TORCHRL)(tensordict, params)


def replace_sac_critics(loss: Any, function: Callable[..., Any]) -> None:  # noqa: ANN401
    """Let a SAC loss evaluate its critics with ``function(tensordict [*], params [E, ...])``.

    Private: ``SACLoss._vmap_qnetworkN0`` (torchrl 0.14.1).
    """
    read(loss, "_vmap_qnetworkN0", TORCHRL)
    loss._vmap_qnetworkN0 = function


def update_pairs(updater: Any) -> tuple[Any, Any]:  # noqa: ANN401
    """Read the targets of a target updater and their sources, two TensorDicts with the same order of keys.

    Private: ``TargetNetUpdater._targets`` and ``._sources`` (torchrl 0.14.1).
    """
    return read(updater, "_targets", TORCHRL), read(updater, "_sources", TORCHRL)


# TorchRL's replay and collectors


def waiting_steps(transform: Any) -> Any:  # noqa: ANN401
    """Read the steps that wait in an n-step transform for their future, or ``None``.

    Private: ``MultiStepTransform._buffer`` (torchrl 0.14.1).
    """
    return read(transform, "_buffer", TORCHRL)


def set_waiting_steps(transform: Any, steps: Any) -> None:  # noqa: ANN401
    """Set the steps that :func:`waiting_steps` reads."""
    read(transform, "_buffer", TORCHRL)
    transform._buffer = steps


class AnswerHook:
    """Give TorchRL's weight synchronisation a hook for the wait; stands before ``SharedMemWeightSyncScheme``.

    Private: ``SharedMemWeightSyncScheme._wait_for_ack`` and ``._ack_queues`` (torchrl 0.14.1).

    Raises:
        CompatError: If a class is made of a scheme without the former: its hook would never be called.
    """

    def __init_subclass__(cls, **kwargs: Any) -> None:  # noqa: ANN401
        super().__init_subclass__(**kwargs)
        _need_behind(cls, AnswerHook, "_wait_for_ack", TORCHRL)

    def await_answer(self, answers: Any) -> None:  # noqa: ANN401
        """Wait for one worker to report in the queue ``answers`` that it has the weights."""
        raise NotImplementedError

    def _wait_for_ack(self, worker_ids: int | list[int] | None = None, timeout: float | None = None) -> None:
        (answers,) = read(self, "_ack_queues", TORCHRL).values()
        self.await_answer(answers)


# TorchRL's environments


def wrapped_env(env: Any) -> Any:  # noqa: ANN401
    """Read the other library's environment inside a TorchRL wrapper; ``None`` if ``env`` wraps no environment.

    Private: ``_env`` of ``torchrl.envs.GymEnv`` and ``DMControlEnv`` (torchrl 0.14.1), and the same attribute of
    dm_control's and Gymnasium's wrappers of environments.
    """
    return getattr(env, "_env", None)


def replace_wrapped_env(env: Any, inner: Any) -> None:  # noqa: ANN401
    """Put another environment into a TorchRL wrapper and read its specs anew.

    Private: ``_env`` and ``_make_specs`` of ``torchrl.envs.GymEnv`` and ``DMControlEnv`` (torchrl 0.14.1).
    """
    read(env, "_env", TORCHRL)
    env._env = inner
    read(env, "_make_specs", TORCHRL)(inner)


def step_outcome(env: Any, outcome: Any) -> tuple[Any, ...]:  # noqa: ANN401
    """Read what another library's ``step`` returned: observation, reward, terminated, truncated, done, and so on.

    Private: ``_output_transform`` of ``torchrl.envs.GymEnv`` and ``DMControlEnv`` (torchrl 0.14.1).
    """
    result: tuple[Any, ...] = read(env, "_output_transform", TORCHRL)(outcome)
    return result


def reset_outcome(env: Any, outcome: Any) -> tuple[Any, ...]:  # noqa: ANN401
    """Read what another library's ``reset`` returned: observation, information.

    Private: ``_reset_output_transform`` of ``torchrl.envs.GymEnv`` and ``DMControlEnv`` (torchrl 0.14.1).
    """
    result: tuple[Any, ...] = read(env, "_reset_output_transform", TORCHRL)(outcome)
    return result


def serial_envs(env: Any) -> Sequence[Any]:  # noqa: ANN401
    """List the environments in a ``SerialEnv`` that has been started.

    Private: ``torchrl.envs.SerialEnv._envs`` (torchrl 0.14.1).
    """
    envs: Sequence[Any] = read(env, "_envs", TORCHRL)
    return envs


def hide(module: Any, **values: object) -> None:  # noqa: ANN401 - a torch.nn.Module
    """Set attributes of a module that may hold modules, without making them parts of it.

    Their parameters and states then do not belong to the module. The trick is ``module.__dict__`` (torch 2.13.0), past
    ``torch.nn.Module.__setattr__``.
    """
    module.__dict__.update(values)


# Hydra and OmegaConf


def stored_mapping(config: Any, key: str) -> Any:  # noqa: ANN401 - a DictConfig
    """Read the mapping under ``key`` without resolving it; ``None`` if the value is null or not a mapping.

    Private: ``DictConfig._get_node`` and ``Node._is_none`` (omegaconf 2.3.1).
    """
    node = read(config, "_get_node", OMEGACONF)(key)
    return node if isinstance(node, type(config)) and not read(node, "_is_none", OMEGACONF)() else None


def own_launcher(settings: Mapping[str, Any]) -> bool:
    """Tell from a sweep's launcher settings whether it is Hydra's own, which runs in this process.

    Private: the package ``hydra._internal``, which holds that launcher (hydra-core 1.3.8).
    """
    return str(settings.get("_target_")).startswith("hydra._internal")


def complete_compositions(complete: Callable[[Any], None]) -> None:
    """Call ``complete`` with each config that Hydra composes from YAMLs, before it merges the command line's overrides.

    Hydra has no plug-in for that moment. A second call changes nothing.

    Private: ``ConfigLoaderImpl._compose_config_from_defaults_list`` of the package ``hydra._internal`` (hydra-core
    1.3.8).
    """
    from hydra._internal.config_loader_impl import ConfigLoaderImpl

    name = "_compose_config_from_defaults_list"
    compose = read(ConfigLoaderImpl, name, HYDRA)
    if hasattr(compose, "__wrapped__"):
        return

    @functools.wraps(compose)
    def completed(*arguments: Any, **named: Any) -> Any:  # noqa: ANN401 - Hydra's
        config = compose(*arguments, **named)
        complete(config)
        return config

    setattr(ConfigLoaderImpl, name, completed)


def read_packaged_yamls_once() -> None:
    """Have Hydra parse each YAML of an installed package once a process, and again where it was changed.

    A composition reads some thirty of them, a fifth of its time, and a process may compose often: for each run of a
    sweep, for each environment that it makes. A second call changes nothing.

    Private: ``SourcesRegistry`` and ``ImportlibResourcesConfigSource._read_config`` of the package ``hydra._internal``
    (hydra-core 1.3.8).
    """
    from hydra._internal.sources_registry import SourcesRegistry
    from hydra.core.plugins import Plugins

    # Hydra imports its plug-ins by hand, so that the class in ``sys.modules`` is not the one that it uses.
    Plugins.instance()
    cls, name = read(SourcesRegistry, "instance", HYDRA)().resolve("pkg"), "_read_config"
    parse = read(cls, name, HYDRA)
    if hasattr(parse, "__wrapped__"):
        return
    known: dict[tuple[Any, ...], Any] = {}

    @functools.wraps(parse)
    def read_once(source: Any, file: Any) -> Any:  # noqa: ANN401 - Hydra's
        if not isinstance(file, Path):  # in an archive
            return parse(source, file)
        status = file.stat()
        key = source.provider, source.path, file, status.st_mtime_ns, status.st_size
        if key not in known:
            known[key] = parse(source, file)
        # Hydra takes the list of defaults out of what it is given.
        return copy.deepcopy(known[key])

    setattr(cls, name, read_once)


# viser


def control_of(server: Any, uuid: str) -> object:  # noqa: ANN401 - a viser.ViserServer
    """Find a control or a key of a viser server's page by the id that browsers know it by; ``None`` if there is none.

    Private: ``GuiApi._gui_input_handle_from_uuid``, ``GuiApi._command_handle_from_uuid`` (viser 1.1.1).
    """
    controls: Mapping[str, object] = read(server.gui, "_gui_input_handle_from_uuid", VISER)
    keys: Mapping[str, object] = read(server.gui, "_command_handle_from_uuid", VISER)
    return controls.get(uuid) or keys.get(uuid)


def wake_by_the_loop() -> None:
    """Have the clients of viser servers woken by the thread of the server's event loop alone; again changes nothing.

    viser sets its ``asyncio.Event`` twice, first in the thread that changes the page and then in the loop. That class
    is not for several threads: while a client comes or goes the first may raise a RuntimeError, and end the program.

    Private: ``viser.infra._async_message_buffer.AsyncMessageBuffer`` and its ``message_event`` (viser 1.1.1).
    """
    import asyncio
    from importlib import import_module

    class LoopEvent(asyncio.Event):
        def set(self) -> None:
            try:
                asyncio.get_running_loop()
            except RuntimeError:  # another thread: viser asks the loop to set it next
                return
            super().set()

    buffer = read(import_module("viser.infra._async_message_buffer"), "AsyncMessageBuffer", VISER)
    make = buffer.__init__
    if hasattr(make, "__wrapped__"):
        return

    @functools.wraps(make)
    def made(self: Any, *arguments: Any, **named: Any) -> None:  # noqa: ANN401 - viser's
        make(self, *arguments, **named)
        read(self, "message_event", VISER)
        self.message_event = LoopEvent()

    buffer.__init__ = made


@contextlib.contextmanager
def served_with(change: Callable[[dict[str, Any]], dict[str, Any]]) -> Iterator[None]:
    """Let a viser server that starts within the block call ``websockets.asyncio.server.serve`` with other arguments.

    viser hands none of them on. All names are public; that viser calls this function is not (viser 1.1.1).

    Args:
        change: Function of the arguments that have names; it returns those to use.

    Raises:
        CompatError: If nothing was served within the block: a server that started would be without the change.
    """
    from websockets.asyncio import server

    serve, used = server.serve, []

    def changed(*arguments: Any, **named: Any) -> Any:  # noqa: ANN401 - websockets'
        used.append(True)
        return serve(*arguments, **change(named))

    server.serve = changed  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        server.serve = serve  # type: ignore[misc]
    if not used:
        raise CompatError(
            f"viser does not serve by websockets.asyncio.server.serve as {VISER} does; install that version, or mend "
            "gctd3/compat.py."
        )
