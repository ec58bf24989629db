"""gctd3.compat: every private name exists and works as expected, and a missing one raises an error that names it."""

import asyncio
import queue
import subprocess
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from gymnasium.wrappers import RescaleAction
from losses import CRITICS, data, make, td3_actor
from omegaconf import OmegaConf
from tensordict import TensorDict
from torch import nn
from torchrl.data import ReplayBuffer
from torchrl.envs import DMControlEnv, GymEnv, SerialEnv
from torchrl.envs.transforms import MultiStepTransform
from torchrl.objectives import SoftUpdate
from websockets.asyncio import server as websockets_server

from gctd3 import compat, objectives
from gctd3.nn.plain_module import PlainModule

pytestmark = [
    pytest.mark.filterwarnings("ignore::gctd3.errors.PerformanceWarning"),
    pytest.mark.filterwarnings("ignore:No target network updater:UserWarning"),
]
KNOWN, KEYS = "_gui_input_handle_from_uuid", "_command_handle_from_uuid"


@pytest.fixture
def env():
    with_limits = GymEnv("Hopper-v5")
    yield with_limits
    with_limits.close()


def test_a_name_that_is_gone_is_named_with_the_version_that_had_it():
    with pytest.raises(compat.CompatError, match=r"torch.nn.modules.linear.Linear has no _gone, .*torch 2\.13"):
        compat.read(nn.Linear(1, 1), "_gone", compat.TORCH)


@pytest.mark.parametrize(
    "call",
    [
        lambda thing: compat.has_hooks(thing),
        lambda thing: compat.priority_weight(thing, None),
        lambda thing: compat.reduce_loss(thing, None, None, None),
        lambda thing: compat.vmapped_critics(thing, None, None),
        lambda thing: compat.replace_sac_critics(thing, print),
        lambda thing: compat.update_pairs(thing),
        lambda thing: compat.waiting_steps(thing),
        lambda thing: compat.set_waiting_steps(thing, None),
        lambda thing: compat.replace_wrapped_env(thing, None),
        lambda thing: compat.step_outcome(thing, None),
        lambda thing: compat.reset_outcome(thing, None),
        lambda thing: compat.serial_envs(thing),
        lambda thing: compat.stored_mapping(thing, "key"),
        lambda thing: compat.control_of(SimpleNamespace(gui=thing), "id"),
    ],
)
def test_every_function_says_so(call):
    class Changed:
        pass

    with pytest.raises(compat.CompatError, match="Changed has no _"):
        call(Changed())


@pytest.mark.parametrize("mixin", [compat.LossHooks, compat.AnswerHook, compat.PlainOutputs])
def test_a_hook_that_would_never_be_called_is_refused(mixin):
    class Changed:
        pass

    with pytest.raises(compat.CompatError, match="Changed has no _"):
        type("Ours", (mixin, Changed), {})


# PyTorch


@pytest.mark.parametrize(
    "register", ["register_forward_hook", "register_forward_pre_hook", "register_full_backward_hook"]
)
def test_has_hooks(register):
    layer = nn.Linear(1, 1)
    assert not compat.has_hooks(layer)
    handle = getattr(layer, register)(lambda *_: None)
    assert compat.has_hooks(layer)
    handle.remove()
    assert not compat.has_hooks(layer)


def test_hide():
    outer, inner = nn.Module(), nn.Linear(1, 1)
    compat.hide(outer, inner=inner, number=3)
    assert outer.inner is inner and outer.number == 3
    assert not list(outer.parameters()) and not outer.state_dict()


POSTPONED = """
import sys
from gctd3 import compat
compat.postpone_compiler()
import torch, tensordict
from gctd3.algorithms.adam import Adam
from gctd3.training import trainer
weight = torch.nn.Parameter(torch.zeros(3))
adam = Adam([weight], lr=0.1)
for _ in range(2):
    adam.zero_grad()
    (weight - 1).pow(2).sum().backward()
    adam.step()
missing = [name for name in ("torch._dynamo.eval_frame", "sympy") if name in sys.modules]
assert not missing, missing
marked = lambda: getattr(tensordict.utils._lock_warn, "_dynamo_marked_constant", False)
assert not marked()
# Anything else of it imports it, with the marks of TensorDict.
assert torch.compile(lambda x: 2 * x, backend="eager")(torch.ones(2)).tolist() == [2, 2]
assert "torch._dynamo.eval_frame" in sys.modules and marked()
assert torch._dynamo is sys.modules["torch._dynamo"] and hasattr(torch._dynamo, "explain")
"""


def in_a_new_process(code):
    result = subprocess.run([sys.executable, "-W", "error::UserWarning", "-c", code], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr


@pytest.mark.nightly
def test_the_compiler_is_imported_once_something_is_compiled():
    in_a_new_process(POSTPONED)


@pytest.mark.nightly
def test_import_compiler():
    in_a_new_process(
        "import sys; from gctd3 import compat; compat.postpone_compiler(); import torch; compat.import_compiler(); "
        "assert 'torch._dynamo.eval_frame' in sys.modules; compat.import_compiler(); compat.postpone_compiler(); "
        "assert hasattr(sys.modules['torch._dynamo'], 'explain')"
    )


# MuJoCo and TensorDict


def test_mujoco_is_imported_without_a_screen():
    in_a_new_process(
        "import os, sys; from gctd3 import compat\n"
        "for before in (None, 'egl'):\n"
        "    if before: os.environ['MUJOCO_GL'] = before\n"
        "    else: os.environ.pop('MUJOCO_GL', None)\n"
        "    with compat.without_screen(): import mujoco\n"
        "    assert os.environ.get('MUJOCO_GL') == before\n"
        "assert 'glfw' not in sys.modules and mujoco.MjModel.from_xml_string('<mujoco/>').nq == 0"
    )


def test_outputs_are_written_as_they_are():
    module = PlainModule(nn.Linear(2, 3), in_keys=["x"], out_keys=["y"])
    batch = TensorDict({"x": torch.ones(4, 2)}, [4])
    assert module(batch) is batch and torch.equal(batch["y"], module.module(batch["x"]))
    # As TensorDict's own in all other cases.
    assert torch.equal(module(x=torch.ones(4, 2)), batch["y"])
    aside = TensorDict({}, [4])
    assert module(batch, tensordict_out=aside) is aside and torch.equal(aside["y"], batch["y"])


# TorchRL


def test_losses_are_weighed_and_reduced():
    loss, batch = make(objectives, "TD3Loss", td3_actor(), CRITICS["list"]()), data((4,))
    assert compat.priority_weight(loss, batch) is None
    batch["priority_weight"] = torch.tensor([1.0, 2.0, 3.0, 4.0])
    weights = compat.priority_weight(loss, batch)
    assert weights.tolist() == [1, 2, 3, 4]
    # (1 * 10 + 2 * 10 + 3 * 10 + 4 * 20) / (1 + 2 + 3 + 4) = 14
    values = torch.tensor([10.0, 10.0, 10.0, 20.0])
    assert float(compat.reduce_loss(loss, values, batch, weights)) == pytest.approx(14.0)
    assert float(compat.reduce_loss(loss, values, batch, None)) == pytest.approx(12.5)


def test_critics_by_vmap_are_the_critics():
    loss, batch = make(objectives, "TD3Loss", td3_actor(), CRITICS["list"]()), data((4,))
    out = compat.vmapped_critics(loss, batch.expand(2, 4), loss.qvalue_network_params)["state_action_value"]
    for k in range(2):
        with loss.qvalue_network_params[k].to_module(loss.qvalue_network):
            alone = loss.qvalue_network(batch.clone())["state_action_value"]
        torch.testing.assert_close(out[k], alone)


def test_update_pairs():
    loss = make(objectives, "TD3Loss", td3_actor(), CRITICS["list"]())
    targets, sources = compat.update_pairs(SoftUpdate(loss, tau=0.5))
    names = [
        {name.replace("target_", "") for name in pairs.flatten_keys(".").keys(True)} for pairs in (targets, sources)
    ]
    assert names[0] == names[1] and len(names[0]) == 4  # weight and bias of the actor and of the critics


def test_waiting_steps():
    transform = MultiStepTransform(3, 0.9)
    buffer = ReplayBuffer(transform=transform, batch_size=2)
    assert compat.waiting_steps(transform) is None
    steps = data((1, 5))
    buffer.extend(steps)
    assert compat.waiting_steps(transform).shape == (1, 3)  # as many as a window is long
    compat.set_waiting_steps(transform, None)
    assert compat.waiting_steps(transform) is None


def test_await_answer():
    heard = []

    class Scheme:
        def __init__(self):
            self._ack_queues = {0: queue.Queue()}

        def _wait_for_ack(self):
            raise AssertionError("TorchRL's own wait")

    class Ours(compat.AnswerHook, Scheme):
        def await_answer(self, answers):
            heard.append(answers)

    ours = Ours()
    ours._wait_for_ack()
    assert heard == list(ours._ack_queues.values())


# Environments


def test_the_environment_inside(env):
    inner = compat.wrapped_env(env)
    assert inner.unwrapped.spec.id == "Hopper-v5"
    assert compat.wrapped_env(nn.Identity()) is None
    compat.replace_wrapped_env(env, RescaleAction(inner, np.float32(-0.5), np.float32(0.5)))
    assert env.action_spec.space.high.max() == 0.5
    assert compat.wrapped_env(env) is not inner


@pytest.mark.parametrize("make_env", [lambda: GymEnv("Hopper-v5"), lambda: DMControlEnv("hopper", "stand")])
def test_outcomes(make_env):
    env = make_env()
    inner = compat.wrapped_env(env)
    observation, *_ = compat.reset_outcome(env, inner.reset())
    action = np.zeros(env.action_spec.shape)
    following, reward, terminated, truncated, *_ = compat.step_outcome(env, inner.step(action))
    assert isinstance(float(reward), float)
    assert not bool(terminated) and not bool(truncated)
    for one in (observation, following):
        parts = env.read_obs(one)
        assert set(parts) == {str(key) for key in env.observation_spec.keys(True)}
    env.close()


def test_serial_envs():
    several = SerialEnv(2, lambda: GymEnv("Hopper-v5"))
    several.reset()
    assert len(compat.serial_envs(several)) == 2
    assert all(isinstance(one, GymEnv) for one in compat.serial_envs(several))
    several.close()


# Hydra and OmegaConf


def test_stored_mapping():
    config = OmegaConf.create({"a": {"b": 1}, "c": 3, "d": None, "e": [1], "f": "${a}", "g": "???"})
    assert compat.stored_mapping(config, "a") == {"b": 1}
    assert all(compat.stored_mapping(config, key) is None for key in "cdefg")
    typed = OmegaConf.create({"x": OmegaConf.create({"y": 1})})
    typed["x"] = None
    assert compat.stored_mapping(typed, "x") is None


def test_own_launcher():
    from hydra._internal.core_plugins.basic_launcher import BasicLauncher

    name = f"{BasicLauncher.__module__}.{BasicLauncher.__qualname__}"
    assert compat.own_launcher({"_target_": name})
    assert not compat.own_launcher({"_target_": "hydra_plugins.hydra_joblib_launcher.joblib_launcher.JoblibLauncher"})
    assert not compat.own_launcher({})


# viser


YAML = "defaults:\n- _self_\n- group: one\nkey: {}\n"


def test_packaged_yamls_are_parsed_once_and_again_when_they_were_changed(tmp_path, monkeypatch):
    from hydra import compose, initialize_config_module

    package = tmp_path / "some_yamls"
    (package / "group").mkdir(parents=True)
    for file in (package / "__init__.py", package / "group" / "__init__.py"):
        file.touch()
    (package / "config.yaml").write_text(YAML.format(1))
    (package / "group" / "one.yaml").write_text("list: [1, {a: 1e-3}]\n")
    monkeypatch.syspath_prepend(tmp_path)
    read = []
    load = OmegaConf.load
    monkeypatch.setattr(OmegaConf, "load", lambda file: read.append(file.name) or load(file))
    compat.read_packaged_yamls_once()
    compat.read_packaged_yamls_once()
    with initialize_config_module("some_yamls", version_base="1.3"):
        first, second = compose("config"), compose("config", ["key=3"])
        assert first == {"key": 1, "group": {"list": [1, {"a": 0.001}]}} and second == {**first, "key": 3}
        files = [name for name in read if "some_yamls" in name]
        assert sorted(files) == [str(package / "config.yaml"), str(package / "group" / "one.yaml")]
        (package / "config.yaml").write_text(YAML.format(20))
        assert compose("config").key == 20


def test_clients_of_viser_are_woken_in_the_loop():
    """A message of another thread neither wakes anybody there nor is lost."""
    pytest.importorskip("viser")
    compat.wake_by_the_loop()
    compat.wake_by_the_loop()
    from viser.infra import Message
    from viser.infra._async_message_buffer import AsyncMessageBuffer

    class Said(Message):
        def redundancy_key(self):
            return "said"

    async def run():
        buffer = AsyncMessageBuffer(asyncio.get_running_loop(), persistent_messages=True)

        async def first():
            return await anext(aiter(buffer.window_generator(0)))

        client = asyncio.create_task(first())
        await asyncio.sleep(0.1)  # it waits for a message now
        # The loop stands still while another thread sends one.
        sender = threading.Thread(target=buffer.push, args=(Said(),))
        sender.start()
        sender.join()
        early = buffer.message_event.is_set()
        return early, await asyncio.wait_for(client, 10)

    early, (message,) = asyncio.run(run())
    assert not early and isinstance(message, Said)


def test_a_viser_server_is_served_with_other_arguments():
    viser = pytest.importorskip("viser")
    server, given = None, []
    with compat.served_with(lambda named: given.append(named) or named):
        server = viser.ViserServer(host="localhost", port=0, verbose=False)
    try:
        assert given and given[0]["process_request"] is not None
        slider = server.gui.add_slider("a", min=0.0, max=1.0, step=0.1, initial_value=0.3)
        key = server.gui.add_command("b", hotkey="B")
        assert [compat.control_of(server, uuid) for uuid in compat.read(server.gui, KEYS, compat.VISER)] == [key]
        controls = [compat.control_of(server, uuid) for uuid in compat.read(server.gui, KNOWN, compat.VISER)]
        assert controls == [slider] and compat.control_of(server, "nobody") is None
    finally:
        server.stop()


def test_a_server_that_would_be_without_the_change_is_refused():
    serve = websockets_server.serve
    with pytest.raises(compat.CompatError, match="viser does not serve by websockets"), compat.served_with(dict):
        pass
    assert websockets_server.serve is serve
