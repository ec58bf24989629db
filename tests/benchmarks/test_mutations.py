"""Planted faults: how a file is changed, how a fault is recognised in another layout, and which tests find it."""

import importlib
import sys
from pathlib import Path

import pytest

SOURCE = '''"""Limits."""
LEAST = -2


def clip(values: list[int], most: int = 3) -> list[int]:
    """Cut off what is too much."""
    if not values or most < LEAST:
        raise ValueError("1 < 2")
    return [min(value, most) for value in values[: most + 1]]
'''
TEST = """from gctd3 import limits


def test_clip():
    assert limits.clip([5, 1]) == [3, 1]
"""


@pytest.fixture
def module(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "benchmarks"))
    return importlib.import_module("mutations")


def test_faults_by_hand(module):
    found = module.sites(SOURCE)
    said = {(site.line, site.kind, site.text) for site in found}
    assert said == {
        (2, "sign left out", "(2)"),
        (2, "off by one", "(3)"),
        (7, "and, or", "(not values and most < LEAST)"),
        (7, "not left out", "values"),
        (7, "comparison", "(most <= LEAST)"),
        (7, "comparison turned round", "(most > LEAST)"),
        (9, "least, most", "max"),
        (9, "slice off by one", ":most + 1 + 1"),
        (9, "operator", "(most - 1)"),
        (9, "off by one", "(2)"),
    }
    for site in found:
        changed = module.mutated(SOURCE, site)
        compile(changed, "limits.py", "exec")
        # Nothing else has changed.
        assert sum(a != b for a, b in zip(SOURCE.splitlines(), changed.splitlines(), strict=True)) == 1


def made(root, folder):
    """Make a checkout whose module lies in a folder."""
    for name in ("gctd3", "conf", "tests", f"gctd3/{folder}"):
        (root / name).mkdir(exist_ok=True, parents=True)
        (root / name / "__init__.py").touch()
    (root / "gctd3" / folder / "limits.py").write_text(f"# In {folder}.\n{SOURCE}")
    (root / "tests" / "test_limits.py").write_text(TEST.replace("gctd3 ", f"gctd3.{folder} "))
    return root


@pytest.mark.nightly
@pytest.mark.parametrize("seed, outcome", [(1, "survived"), (3, "killed")])
def test_the_same_fault_in_two_layouts(module, tmp_path, monkeypatch, capsys, seed, outcome):
    trees = [f"{name}:{made(tmp_path / name, folder)}:{sys.executable}" for name, folder in (("a", "x"), ("b", "y"))]
    monkeypatch.setattr(module, "GROUPS", {"task": ["gctd3/x/*.py"]})
    arguments = [f"out={tmp_path / 'out.json'}", "n=1", f"seed={seed}", f"trees={','.join(trees)}", "only=task"]
    monkeypatch.setattr(sys, "argv", ["mutations.py", *arguments])
    module.main()
    said = capsys.readouterr().out
    (mutant,) = module.json.loads((tmp_path / "out.json").read_text())["mutants"]
    assert mutant["files"] == {"a": "gctd3/x/limits.py", "b": "gctd3/y/limits.py"}
    assert [mutant["results"][name]["outcome"] for name in ("a", "b")] == [outcome, outcome] and outcome in said
    found = "tests/test_limits.py::test_clip" if outcome == "killed" else ""
    assert mutant["results"]["b"]["by"] == found
    # The mutant has been evaluated, and the checkouts are unchanged.
    module.main()
    assert capsys.readouterr().out.startswith("\ngroup")
    assert (tmp_path / "a" / "gctd3" / "x" / "limits.py").read_text().endswith(SOURCE)


def test_wrong_calls_are_answered(module, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["mutations.py"])
    with pytest.raises(SystemExit, match=r"out=FILE\.json is required"):
        module.main()
    monkeypatch.setattr(sys, "argv", ["mutations.py", "out=x.json", "only=tasks"])
    with pytest.raises(SystemExit, match="no group tasks; there are task, replay"):
        module.main()
