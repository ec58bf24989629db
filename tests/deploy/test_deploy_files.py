"""An exported policy's files are refused if they do not belong together, and run with NumPy and onnxruntime alone."""

import json
import subprocess
import sys

import pytest

from gctd3.deploy.contract import read_contract
from gctd3.deploy.policy import Policy
from gctd3.errors import ContractError
from gctd3.files import seal

pytest.importorskip("onnxruntime")


def copied(exported, folder):
    for file in exported.parent.iterdir():
        (folder / file.name).write_bytes(file.read_bytes())
    return folder / exported.name


def edited(contract, **changes):
    content = json.loads(contract.read_text(encoding="utf-8"))
    del content["sha256"]
    content.update(changes)
    contract.write_text(json.dumps({**content, "sha256": seal(content)}), encoding="utf-8")


def other_robot(contract):
    robot = read_contract(contract).robot
    edited(contract, robot={"name": "my_robot", "sha256": "0" * 64, "standing_height_m": robot.standing_height_m})


DAMAGE = {
    "no policy": (lambda f: f.unlink(), r"No policy at .*policy\.onnx"),
    "no contract": (lambda f: f.with_suffix(".json").unlink(), r"No contract at .*policy\.json"),
    "not JSON": (lambda f: f.with_suffix(".json").write_text("{"), "no contract of a policy, or damaged"),
    "not text": (lambda f: f.with_suffix(".json").write_bytes(b"\xff\xfe\xff"), "cannot be read"),
    "a list": (lambda f: f.with_suffix(".json").write_text("[]"), "no contract of a policy, or damaged"),
    "edited": (
        lambda f: f.with_suffix(".json").write_text(f.with_suffix(".json").read_text().replace("50.0", "500.0")),
        "damaged or was edited",
    ),
    "a later format": (lambda f: edited(f.with_suffix(".json"), format=5), "has format 5; gctd3 .* reads format 4"),
    "an earlier format": (
        lambda f: edited(f.with_suffix(".json"), format=2),
        "has format 2, of an older gctd3; .* reads format 4: export the policy again",
    ),
    "no format": (lambda f: edited(f.with_suffix(".json"), format=True), "has format True; gctd3 .* reads format 4"),
    "an unknown key": (lambda f: edited(f.with_suffix(".json"), colour="red"), "unknown keys: colour"),
    "a wrong type": (
        lambda f: edited(f.with_suffix(".json"), history_frames="5"),
        r"the contract\.history_frames must be int, got '5'",
    ),
    "another normalisation": (
        lambda f: edited(f.with_suffix(".json"), normalisation="z-score"),
        r"the contract\.normalisation must be .*'none'.*, got 'z-score'",
    ),
    "another history": (lambda f: edited(f.with_suffix(".json"), history_frames=4), r"contradicts itself.*\(8, 8\)"),
    "another robot": (lambda f: other_robot(f.with_suffix(".json")), "of another robot.*'biped'.*'my_robot'"),
    "another network": (lambda f: f.write_bytes(f.read_bytes() + b"\x5a\x00"), "do not belong together"),
    "no network": (lambda f: f.write_bytes(b"nothing"), "no ONNX file that onnxruntime can run"),
}


@pytest.mark.parametrize("case", DAMAGE)
def test_files_that_do_not_belong_together_are_refused(exported, tmp_path, case):
    damage, said = DAMAGE[case]
    file = copied(exported, tmp_path)
    assert Policy(file).command
    damage(file)
    with pytest.raises(ContractError, match=said):
        Policy(file)


def test_it_runs_only_on_the_robot_that_it_was_trained_for(exported, robot, tmp_path):
    assert Policy(exported, robot=robot.path).command
    mine = tmp_path / "mine.xml"
    mine.write_text(robot.path.read_text().replace('mass="4.02"', 'mass="5"'))
    with pytest.raises(ContractError, match=r"trained for 'biped', whose MJCF is not .*mine\.xml"):
        Policy(exported, robot=mine)


# Without the packages of training.

ALONE = """
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top not in {allowed} and top not in sys.stdlib_module_names:
            raise ModuleNotFoundError(f"{{name}} is not here")

sys.meta_path.insert(0, Refuse())
from gctd3.deploy.policy import Policy
policy = Policy({file!r})
print(policy.step(dict.fromkeys(policy.contract.readings, 0.0), 0.0))
for name in ("torch", "mujoco", "gymnasium", "hydra", "safetensors"):
    assert name not in sys.modules, name
"""


def test_it_needs_numpy_and_onnxruntime_only(exported):
    code = ALONE.format(allowed=("gctd3", "numpy", "onnxruntime"), file=str(exported))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    policy = Policy(exported)
    expected = policy.step(dict.fromkeys(policy.contract.readings, 0.0), 0.0)
    assert done.stdout.strip() == str(expected) and len(expected) == 6


def test_without_onnxruntime_it_says_what_to_install(exported):
    code = ALONE.format(allowed=("gctd3", "numpy"), file=str(exported))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stderr.strip().endswith("needs onnxruntime: pip install 'gctd3[deploy]'.")
