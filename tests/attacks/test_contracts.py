"""Attacks on what a robot reads: contracts, ONNX files and sensor streams, each generated from a seed.

A changed contract or file ends in a ContractError, or is a policy whose commands stay within its limits; no call of a
policy ends in anything but a command or a ReadingError with one.
"""

import dataclasses
import json
import math
import random

import numpy as np
import pytest
from small_policies import reseal, small_contract, small_model, write_policy

from gctd3.deploy import Policy
from gctd3.deploy.contract import read_contract
from gctd3.errors import ContractError, ReadingError

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
pytestmark = pytest.mark.nightly
CONTRACTS, FILES, STREAMS = 400, 100, 200

VALUES = [
    None, True, False, 0, 1, -1, 3, 10**400, -(10**30), 0.0, -0.0, 1e-320, 0.5, 1e30, -1e30, 1e308, math.nan, math.inf,
    "", "nodes", "roll_rad", "servo_hip", "\ud800", "x" * 5000, [], [[]], [0.0], [5, 4], {}, {"name": 1}, [None] * 50,
]  # fmt: skip


def places(content, path=()):
    """Yield the path of every value of a JSON tree."""
    for key, value in content.items() if isinstance(content, dict) else enumerate(content):
        yield (*path, key)
        if isinstance(value, (dict, list)):
            yield from places(value, (*path, key))


def mutate(content, rng):
    """Change one to three values of a contract's JSON in place."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        found = list(places(content))
        *path, key = rng.choice(found)
        parent = content
        for step in path:
            parent = parent[step]
        how = rng.choice(("value", "value", "scale", "delete", "copy", "swap", "add"))
        if how == "delete":
            del parent[key]
        elif how == "scale" and type(parent[key]) in (int, float):
            parent[key] *= rng.choice((-1, 0, 1.5, 57.2957795, 1e9, 1e-9))
        elif how == "copy" and isinstance(parent, list):
            parent.insert(key, json.loads(json.dumps(parent[key])))
        elif how == "swap" and isinstance(parent, list):
            other = rng.randrange(len(parent))
            parent[key], parent[other] = parent[other], parent[key]
        elif how == "add" and isinstance(parent, dict):
            parent[rng.choice(("", "extra", "__class__", str(key) + " "))] = rng.choice(VALUES)
        else:
            parent[key] = rng.choice(VALUES)


class Evil:
    """Raise whatever is asked of it."""

    def __float__(self):
        raise ZeroDivisionError

    def __repr__(self):
        raise ZeroDivisionError


class EvilMapping(dict):
    def __getitem__(self, key):
        raise OSError("the bus is gone")

    def keys(self):
        raise OSError("the bus is gone")

    __iter__ = items = values = keys


BAD = [
    *VALUES,
    Evil(),
    np.zeros(3),
    np.array([[1.0]]),
    np.float32("nan"),
    np.datetime64("now"),
    1j,
    b"1",
    lambda: 1,
    np.ma.masked,
]


def attack(policy, rng, calls):
    """Call a policy with good and bad readings and times; every command is finite and within the contract's limits."""
    contract, time = policy.contract, 0.0
    low, high = np.array([(servo.low_rad, servo.high_rad) for servo in contract.servos]).T
    hold, home = contract.safety.hold_periods, np.array([servo.home_rad for servo in contract.servos])
    rate = np.array([servo.home_rate_rad_s for servo in contract.servos]) / contract.control_rate_hz
    actuators, safe, answered = [servo.actuator for servo in contract.servos], 0, 0
    for _ in range(calls):
        before = np.array(list(policy.command.values()))
        readings = {
            f.reading: rng.choice((0, 1, True)) if f.binary else rng.uniform(f.low, f.high) for f in contract.features
        }
        if rng.random() < 0.95:
            readings |= {name: rng.uniform(-0.3, 0.3) for name in contract.safety.tilt_readings}
        time += rng.choice((0.0, 0.3, 0.8, *[1.0] * 20, 1.2, 2.0, 50.0, -3.0)) / contract.control_rate_hz
        given, when, now = readings, time, rng.choice((None, None, time))
        match rng.randrange(8):
            case 0:
                given = rng.choice([*BAD, EvilMapping(readings), {**readings, rng.choice((1, "x", None)): 0.0}])
            case 1 | 2:
                given = {**readings, rng.choice(list(readings)): rng.choice(BAD)}
            case 3:
                when = rng.choice(BAD)
            case 4:
                now = rng.choice(BAD)
        if rng.random() < 0.05:
            policy.reset(at_home=rng.random() < 0.3)
            before = np.array(list(policy.command.values()))
        try:
            command = policy.start(given) if rng.random() < 0.1 else policy.step(given, when, now)
            safe, answered = 0, answered + 1
        except ReadingError as error:
            command, safe = error.command, safe + 1
            assert str(error) and len(str(error)) < 1000
            moved = np.abs(np.array(list(command.values())) - before)
            assert (moved <= (rate if safe > hold else 0) + 1e-12).all()
            assert (np.abs(np.array(list(command.values())) - home) <= np.abs(before - home) + 1e-12).all()
        angles = np.array(list(command.values()))
        assert list(command) == actuators and np.isfinite(angles).all()
        assert (angles >= low).all() and (angles <= high).all()
    return answered


@pytest.mark.parametrize("block", range(8))
def test_changed_contracts_are_refused_or_keep_their_limits(tmp_path, block):
    file = write_policy(tmp_path)
    beside = file.with_suffix(".json")
    whole, refused, ran = beside.read_text(encoding="utf-8"), 0, 0
    for seed in range(block * CONTRACTS // 8, (block + 1) * CONTRACTS // 8):
        rng = random.Random(seed)
        text = reseal(whole, lambda content, rng=rng: mutate(content, rng))
        if rng.random() < 0.1:
            at = rng.randrange(len(text))
            text = text[:at] + rng.choice(("", "[", '"', "}", "\0", "9")) + text[at + rng.randrange(30) :]
        beside.write_text(text, encoding="utf-8")
        try:
            policy = Policy(file)
        except ContractError as error:
            assert len(str(error)) < 2000, seed
            refused += 1
            continue
        attack(policy, rng, 40)
        ran += 1
    assert refused > ran > 0


@pytest.mark.parametrize("block", range(4))
def test_changed_onnx_files_are_refused_or_keep_their_limits(tmp_path, block):
    contract = small_contract()
    whole, refused = small_model(contract), 0
    for seed in range(block * FILES // 4, (block + 1) * FILES // 4):
        rng, model = random.Random(seed), onnx.load_from_string(whole)
        match seed % 5:
            case 0:
                rng.choice(model.metadata_props).value = rng.choice(("", "[]", "null", "[[1]]", "x" * 9999, "["))
            case 1:
                del model.metadata_props[rng.randrange(4)]
            case 2:
                model.opset_import[0].version += rng.choice((-3, -1, 1, 2))
            case 3:
                port = rng.choice((model.graph.input, model.graph.output))[0].type.tensor_type.shape.dim
                dimension = rng.choice(port)
                dimension.dim_value = rng.choice((0, 1, 3, 1000))
            case 4:
                part = rng.choice(model.graph.initializer)
                numbers = onnx.numpy_helper.to_array(part).copy()
                numbers.flat[rng.randrange(numbers.size)] = rng.choice((math.nan, math.inf, 1e38, -1e38))
                part.CopyFrom(onnx.numpy_helper.from_array(numbers, part.name))
        content = model.SerializeToString()
        if rng.random() < 0.2:
            content = content[: rng.randrange(len(content))]
        try:
            policy = Policy(write_policy(tmp_path, contract, content))
        except ContractError:
            refused += 1
            continue
        attack(policy, rng, 40)
    assert refused >= FILES // 4 // 2


@pytest.mark.parametrize("block", range(4))
def test_every_call_ends_in_a_command(tmp_path, block):
    policy, answered = Policy(write_policy(tmp_path)), 0
    for seed in range(block * STREAMS // 4, (block + 1) * STREAMS // 4):
        rng = random.Random(seed)
        policy.reset(at_home=True)
        answered += attack(policy, rng, 100)
    assert answered > STREAMS // 4 * 20


def test_every_call_of_the_packaged_policy_ends_in_a_command(exported):
    policy = Policy(exported)
    answered = sum(attack(policy, random.Random(seed), 200) for seed in range(10) if not policy.reset(at_home=True))
    assert answered > 200


def test_an_edit_without_a_new_checksum_is_always_refused(tmp_path):
    file = write_policy(tmp_path)
    beside = file.with_suffix(".json")
    whole, rng = beside.read_text(encoding="utf-8"), random.Random(0)
    contract = read_contract(beside)
    for _ in range(200):
        at = rng.randrange(len(whole))
        text = whole[:at] + rng.choice('0123456789aeinrt.-,:{}[]"') + whole[at + 1 :]
        beside.write_text(text, encoding="utf-8")
        try:
            # White space, and digits of a number that say the same, change nothing.
            assert Policy(file).contract == contract
        except ContractError:
            continue
    assert dataclasses.is_dataclass(contract)
