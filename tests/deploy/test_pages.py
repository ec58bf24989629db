"""The code of docs/safety.md and docs/cpp.md runs."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from small_policies import HOME, small_contract, small_model, write_policy

from gctd3.deploy.cpp_policy import to_cpp

pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
DOCS = Path(__file__).parents[2] / "docs"


def block(page, language):
    (text,) = re.findall(rf"^```{language}\n(.*?)^```", (DOCS / page).read_text(encoding="utf-8"), flags=re.M | re.S)
    return text


def test_the_loop_of_the_page_on_safety_runs(tmp_path, monkeypatch):
    write_policy(tmp_path)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(block("safety.md", "python"), names)
    policy, period, sent = names["policy"], 0, []

    def read_sensors():
        nonlocal period
        period += 1
        readings = {**dict.fromkeys(policy.contract.readings, 0.0), "angle_hip_rad": 0.3}
        return (None, None) if period % 7 == 0 else (readings, period * 0.01)

    names["control"](read_sensors, sent.append, lambda: period < 100)
    home = {"servo_hip": HOME[0], "servo_knee": HOME[1]}
    # From the knee's 0 rad to -0.2 rad at 0.005 rad a period; every seventh period gives nothing.
    first = sent.index(home) + 1
    assert first == 40 + 40 // 6
    assert len(sent) == 100 and any(command != home for command in sent[first:])
    assert np.isfinite([list(command.values()) for command in sent]).all()


@pytest.mark.skipif(shutil.which("g++") is None, reason="There is no g++.")
def test_the_loop_of_the_page_on_cpp_compiles(tmp_path):
    contract = small_contract()
    (tmp_path / "policy.hpp").write_text(to_cpp(small_model(contract), contract), encoding="utf-8")
    source = tmp_path / "loop.cpp"
    source.write_text(block("cpp.md", "cpp"), encoding="utf-8")
    flags = ["-std=c++17", "-Wall", "-Wextra", "-Werror", "-pedantic"]
    subprocess.run(["g++", *flags, "-c", str(source), "-o", str(tmp_path / "loop.o")], check=True)
    refused = subprocess.run(
        ["g++", *flags, "-ffast-math", "-fsyntax-only", str(source)], capture_output=True, text=True
    )
    assert refused.returncode != 0 and "Compile without -ffast-math" in refused.stderr
