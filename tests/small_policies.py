"""Exported policies made by hand: a free robot with two joints, and a network of one layer written with onnx.helper."""

import dataclasses
import hashlib
import json

import numpy as np

from gctd3.deploy.contract import FORMAT, Contract, Feature, NetworkFile, Node, RobotIdentity, Safety, Servo

RATE = 100.0  # Hz
# Each joint may turn by 1 rad either way from 0; home is at 0.2 and -0.2 rad, 0.5 rad/s away in a second.
HOME, HOME_RATE, MOST_CHANGE, HOLD, TILT = (0.2, -0.2), 0.5, 0.3, 3, 0.8


def encoder(name, unit, low, high, source="joint encoder"):
    return Feature(name, name, unit, source, low, high, 0.0)


def servo(joint, home):
    return Servo(
        actuator=f"servo_{joint}",
        joint=joint,
        angle_reading=f"angle_{joint}_rad",
        low_rad=-1.0,
        high_rad=1.0,
        centre_rad=0.0,
        scale_rad=1.0,
        start_rad=home,
        home_rad=home,
        home_rate_rad_s=HOME_RATE,
        most_change_rad=MOST_CHANGE,
        kp_nm_per_rad=40.0,
        kd_nm_s_per_rad=1.0,
        effort_nm=30.0,
        time_constant_s=0.0,
    )


def small_contract(frames=2, **changes):
    nodes = (
        Node("body", (encoder("roll_rad", "rad", -4, 4, "IMU orientation"), encoder("roll_rate", "1", -9, 9))),
        Node("pitch", (encoder("pitch_rad", "rad", -4, 4, "IMU orientation"), Feature(None, "nothing"))),
        Node("hip", (encoder("angle_hip_rad", "rad", -1.5, 1.5), encoder("velocity_hip_rad_s", "rad/s", -20, 20))),
        Node("knee", (encoder("angle_knee_rad", "rad", -1.5, 1.5), encoder("velocity_knee_rad_s", "rad/s", -20, 20))),
        Node("ground", (Feature("down", "contact", "1", "foot contact switch", 0, 1, 0, True), Feature(None, "none"))),
    )
    said = {
        "format": FORMAT,
        "network": NetworkFile("0" * 64, 18, "nodes", (5, 2 * frames), "action", "0" * 64),
        "robot": RobotIdentity("small", "1" * 64, 0.5),
        "control_rate_hz": RATE,
        "history_frames": frames,
        "history_order": "oldest first",
        "history_warm_up": "repeat the first frame",
        "normalisation": "none",
        "nodes": nodes,
        "servos": (servo("hip", HOME[0]), servo("knee", HOME[1])),
        "safety": Safety(
            HOLD,
            "each desired angle goes to home_rad at home_rate_rad_s and stays",
            "repeat the last frame",
            ("roll_rad", "pitch_rad"),
            "arc cosine of the product of the cosines",
            TILT,
        ),
        "frames_trained": 1,
        "trained_with": {},
        "exported_with": {},
    }
    return Contract(**{**said, **changes})


def following_contract(frames=4, slew=0.0):
    """Return a contract with what a robot that follows commands reads: gravity's direction, and its own last action."""
    contract = small_contract(frames)
    body = Node(
        "body",
        (
            encoder("gravity_up", "1", -1.1, 1.1, "IMU orientation"),
            Feature("asked", "asked", "1", "command", -2.0, 2.0, slew_rate=slew),
        ),
    )
    joints = [
        Node(
            name, (encoder(f"angle_{name}_rad", "rad", -1.5, 1.5), encoder(f"action_{name}", "1", -1, 1, "last action"))
        )
        for name in ("knee", "hip")
    ]
    safety = dataclasses.replace(
        contract.safety, tilt_readings=("gravity_up",), tilt="arc cosine of the negative reading"
    )
    return small_contract(frames, nodes=(body, contract.nodes[1], *joints, contract.nodes[4]), safety=safety)


def slewing_contract(frames=4):
    """Return a contract whose command changes by at most 40 a second, 0.4 a control period."""
    return following_contract(frames, slew=0.4 * RATE)


def ticking_contract(frames=2, hz=2.5, phase=0.25):
    """Return a contract in which the ground's second feature is the clock of a gait."""
    contract = small_contract(frames)
    clock = Feature("clock_cos_foot", "clock", "1", "clock", -1.0, 1.0, clock_hz=hz, clock_phase=phase)
    ground = Node("ground", (contract.nodes[-1].features[0], clock))
    return small_contract(frames, nodes=(*contract.nodes[:-1], ground))


def small_model(contract, opset=18, batch="batch", kind=None, names=("nodes", "action"), shape=None, bias=0.0):
    """Serialise tanh(flattened nodes * weights + bias) as an ONNX file."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    from gctd3.deploy.network import metadata

    kind, shape = kind or TensorProto.FLOAT, shape or contract.network.input_shape
    width = int(np.prod(shape))
    rng = np.random.default_rng(0)
    dtype = helper.tensor_dtype_to_np_dtype(kind)
    parts = [
        numpy_helper.from_array(rng.standard_normal((width, 2)).astype(dtype), "weight"),
        numpy_helper.from_array(np.full(2, bias, dtype=dtype), "bias"),
    ]
    made = [
        helper.make_node("Flatten", [names[0]], ["flat"], axis=1),
        helper.make_node("Gemm", ["flat", "weight", "bias"], ["linear"]),
        helper.make_node("Tanh", ["linear"], [names[1]]),
    ]
    graph = helper.make_graph(
        made,
        "small",
        [helper.make_tensor_value_info(names[0], kind, [batch, *shape])],
        [helper.make_tensor_value_info(names[1], kind, [batch, 2])],
        parts,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=9)
    helper.set_model_props(model, metadata(contract))
    onnx.checker.check_model(model)
    return model.SerializeToString()


def write_policy(folder, contract=None, model=None):
    """Write a policy and its contract, which fits the file's checksum whatever else it says; return its path."""
    contract = contract or small_contract()
    content = small_model(contract) if model is None else model
    network = dataclasses.replace(contract.network, sha256=hashlib.sha256(content).hexdigest())
    file = folder / "policy.onnx"
    file.write_bytes(content)
    file.with_suffix(".json").write_text(dataclasses.replace(contract, network=network).to_json(), encoding="utf-8")
    return file


def reseal(text, change):
    """Return the contract's JSON after ``change(content)``, with a checksum that fits."""
    from gctd3.files import seal

    content = json.loads(text)
    content.pop("sha256", None)
    content = change(content) or content
    return json.dumps({**content, "sha256": seal(content)})


CPP = """#include "{header}"
#include <cstdio>
#include <cstring>

namespace p = gctd3_policy;

// Reads calls from standard input and writes an answer to each: `n` and a state: the network's action; `s`, a time and
// readings: a step; `b` and readings: a start; `r` or `h`: a reset, at home or not.
int main() {{
  char kind[8];
  p::Policy policy;
  static float scratch[{scratch}];
  while (std::scanf("%7s", kind) == 1) {{
    double time = 0, readings[p::READINGS], command[p::SERVOS];
    const char* reason = nullptr;
    if (kind[0] == 'n') {{
      float nodes[p::NODES * p::FRAMES * p::FEATURES], action[p::SERVOS];
      for (float& x : nodes)
        if (std::scanf("%f", &x) != 1) return 1;
      p::network::run(nodes, action, scratch);
      for (float x : action) std::printf("%.9g ", static_cast<double>(x));
      std::printf("\\n");
      continue;
    }}
    if (kind[0] == 'r' || kind[0] == 'h') {{
      policy.reset(kind[0] == 'h');
      continue;
    }}
    if (kind[0] == 's' && std::scanf("%lf", &time) != 1) return 1;
    for (double& x : readings)
      if (std::scanf("%lf", &x) != 1) return 1;
    reason = kind[0] == 's' ? policy.step(readings, time, command) : policy.start(readings, command);
    std::printf("%d %d ", reason ? 1 : 0, policy.at_home() ? 1 : 0);
    for (double x : command) std::printf("%.17g ", x);
    std::printf("\\n");
  }}
  return std::strlen(p::CONTRACT) > 1000 ? 0 : 2;
}}
"""


def compiled(header, folder, compiler="g++"):
    """Compile a program around a C++ header with every warning an error; return its path."""
    import re
    import subprocess

    scratch = re.search(r"scratch_\[(\d+)\]", header.read_text(encoding="utf-8"))[1]
    source, program = folder / "main.cpp", folder / "main"
    source.write_text(CPP.format(header=header, scratch=scratch), encoding="utf-8")
    flags = ["-std=c++17", "-O2", "-Wall", "-Wextra", "-Werror", "-Wno-unused-variable", "-pedantic"]
    subprocess.run([compiler, *flags, str(source), "-o", str(program)], check=True)
    return program


def answers(program, calls):
    """Return the numbers of each line that the program answers to the calls, lines of text."""
    import subprocess

    done = subprocess.run([str(program)], input="\n".join(calls), capture_output=True, text=True, check=True)
    return np.array([[float(number) for number in line.split()] for line in done.stdout.splitlines()])
