"""Contract and network are compared when a policy is loaded: a contract edited with its checksum fails there."""

import dataclasses
import json

import numpy as np
import pytest
from small_policies import RATE, reseal, small_contract, small_model, write_policy

from gctd3.deploy import Policy
from gctd3.deploy.network import read_opset
from gctd3.errors import ContractError

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")


def test_the_network_is_run_as_it_is_written(tmp_path):
    """The command is tanh(weights of the flattened features) about 0, with every frame the first one."""
    policy = Policy(write_policy(tmp_path))
    readings = dict(zip(policy.contract.readings, np.linspace(-0.3, 0.3, 8), strict=True)) | {"down": 1}
    frame = np.zeros((5, 2))
    frame.flat[[0, 1, 2, 4, 5, 6, 7, 8]] = [readings[name] for name in policy.contract.readings]
    weight = np.random.default_rng(0).standard_normal((20, 2)).astype(np.float32)
    action = np.tanh(np.concatenate([frame, frame], axis=1).reshape(1, 20) @ weight)[0]
    assert list(policy.step(readings, 0.0).values()) == pytest.approx(
        np.clip(action, [0.2 - 0.3, -0.2 - 0.3], [0.2 + 0.3, -0.2 + 0.3]), abs=1e-6
    )


CHANGED = {
    "name of the input": ({"input": "states"}, r"the contract's only input is 'states', the file's are 'nodes'"),
    "name of the output": ({"output": "torque"}, r"only output is 'torque', the file's are 'action'"),
    "operator set": ({"opset": 17}, "the operator set is 17 in the contract, 18 in the file"),
    "no operator set": ({"opset": None}, "the operator set is None in the contract, 18 in the file"),
}


@pytest.mark.parametrize("case", CHANGED)
def test_a_contract_of_another_network_is_refused(tmp_path, case):
    change, said = CHANGED[case]
    contract = small_contract()
    model = small_model(contract)
    other = dataclasses.replace(contract, network=dataclasses.replace(contract.network, **change))
    with pytest.raises(ContractError, match=said):
        Policy(write_policy(tmp_path, other, model))


MODELS = {
    "type": ({"kind": 11}, r"input 'nodes' is float32 in the contract, tensor\(double\) in the file"),
    "shape": ({"shape": (5, 6)}, r"of shape \['batch', 5, 4\] in the contract, \['batch', 5, 6\] in the file"),
    "batch": ({"batch": 1}, r"of shape \['batch', 5, 4\] in the contract, \[1, 5, 4\] in the file"),
    "not finite": ({"bias": np.nan}, r"of two states of zeros .* that are not finite"),
}


@pytest.mark.parametrize("case", MODELS)
def test_a_network_of_another_contract_is_refused(tmp_path, case):
    change, said = MODELS[case]
    contract = small_contract()
    with pytest.raises(ContractError, match=said):
        Policy(write_policy(tmp_path, contract, small_model(contract, **change)))


def test_an_edited_order_of_readings_or_servos_is_refused(tmp_path):
    file = write_policy(tmp_path)
    beside = file.with_suffix(".json")
    whole = beside.read_text(encoding="utf-8")

    def swap_nodes(content):
        content["nodes"][2:4] = content["nodes"][3:1:-1]

    def swap_servos(content):
        content["servos"].reverse()

    def one_servo(content):
        del content["servos"][1]

    def same(content):
        pass

    for change, said in (
        (swap_nodes, r"readings: number 3 is \['knee', .* in the contract, \['hip', .* in the file"),
        (swap_servos, r"actuators: number 1 is 'servo_knee' in the contract, 'servo_hip' in the file"),
        (one_servo, r"output 'action' is of shape \['batch', 1\] in the contract, \['batch', 2\] in the file"),
    ):
        beside.write_text(reseal(whole, change), encoding="utf-8")
        with pytest.raises(ContractError, match=said):
            Policy(file)
    beside.write_text(reseal(whole, same), encoding="utf-8")
    assert Policy(file).command


def test_the_operator_set_is_read_as_onnx_reads_it(exported):
    for model in (exported.read_bytes(), *(small_model(small_contract(), opset=opset) for opset in (13, 20))):
        assert read_opset(model) == onnx.load_from_string(model).opset_import[0].version
    for damaged in (b"", b"\x08", b"\xff" * 30, b"nothing", exported.read_bytes()[:50]):
        assert read_opset(damaged) is None


def test_numbers_that_no_float_holds_are_refused(tmp_path):
    file = write_policy(tmp_path)
    beside = file.with_suffix(".json")
    for number in ("1e999", "NaN", "1" + "0" * 400, "true", '"100"', "null", "-1", "1e300"):
        text = beside.read_text(encoding="utf-8")
        content = json.loads(text.replace(f'"control_rate_hz": {RATE}', f'"control_rate_hz": {number}'))
        assert content["control_rate_hz"] != RATE
        beside.write_text(reseal(json.dumps(content), lambda same: same), encoding="utf-8")
        with pytest.raises(ContractError, match="control_rate_hz"):
            Policy(file)
        beside.write_text(text, encoding="utf-8")
