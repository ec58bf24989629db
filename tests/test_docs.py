"""What the documentation shows runs, and what it links to is there."""

import doctest
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()


def test_readme_python_runs(exported, monkeypatch):
    monkeypatch.chdir(exported.parent)
    blocks = re.findall(r"^```python\n(.*?)^```", README, flags=re.M | re.S)
    assert len(blocks) == 3
    names: dict[str, object] = {}
    for block in blocks:
        exec(block, names)
    assert names["rollout"].batch_size == (64, 100)
    assert names["envs"].num_envs == 64
    assert list(names["command"]) == list(names["policy"].command) and len(names["command"]) == 6


def test_readme_links_lead_somewhere():
    links = re.findall(r"\]\((?!https?:)([^)]+)\)", README)
    assert len(links) >= 5
    for link in links:
        assert (ROOT / link).exists(), link


@pytest.mark.parametrize("module", ["gctd3.graph", "gctd3.nn.actor", "gctd3.envs.factory"])
def test_docstring_examples(module):
    result = doctest.testmod(importlib.import_module(module))
    assert result.attempted > 0
    assert result.failed == 0
