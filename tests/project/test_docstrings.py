"""Public docstrings begin with a verb in the imperative, as in "Return the Cartesian position of a body"."""

import ast
from pathlib import Path

import pytest

import gctd3

ROOT = Path(gctd3.__file__).parent
# One verb a word; a new one is added here.
VERBS = set(
    """
    Accept Act Add Advance Align Announce Answer Append Apply Ask Assign Attach Average Begin Bind Block Bound Build
    Cache Call Cancel Carry Change Check Choose Clip Close Collect Compare Compile Complete Compose Compute
    Configure Construct Continue Convert Copy Correct Count Create Cut Decide Declare Decode Define Delay Delete
    Deliver Describe Detect Disable Divide Draw Drive Drop Enable Encode End Ensure Enter Estimate Evaluate
    Exchange Exclude Export Extract Fill Filter Find Finish Follow Forget Format Freeze Gather Generate Get
    Give Go Group Guard Handle Have Hide Hold Identify Ignore Implement Import Index Initialise Insert Install
    Interpolate Iterate Join Keep Label Leave Let Limit List Listen Load Locate Lock Log Look Make Map
    Mark Match Measure Merge Minimise Mirror Move Name Note Number Observe Offer Open Order Pair Parse Pass Pause
    Pay Penalise Permute Place Plot Predict Prepare Print Process Project Provide Publish Push Put Raise
    Randomise Rank React Read Reconstruct Record Reduce Reflect Refuse Register Release Remember Remove Rename
    Render Repeat Replace Replay Report Represent Request Reset Resolve Restart Restore Resume Return Reward
    Run Sample Save Say Scale Search Seed Select Send Sense Separate Set Share Show Shut Simulate Skip Smooth
    Sort Split Stack Start Step Stop Store Subscribe Sum Summarise Switch Take Tell Terminate Test Time Track Train
    Transform Translate Undo Update Use Validate Wait Walk Warn Watch Weight Wrap Write Yield
    """.split()  # noqa: SIM905 - one line a verb would be long
)


def wrong(tree, inside=""):
    """Yield line, name and first words of each public docstring that does not begin with a verb."""
    for node in ast.iter_child_nodes(tree):
        if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            if isinstance(node, (ast.If, ast.Try, ast.With)):
                yield from wrong(node, inside)
            continue
        if node.name.startswith("_"):
            continue
        text = ast.get_docstring(node)
        if text and text.split()[0].rstrip(",.:;") not in VERBS:
            yield node.lineno, inside + node.name, " ".join(text.split()[:6])
        if isinstance(node, ast.ClassDef):
            yield from wrong(node, f"{node.name}.")


@pytest.mark.parametrize("room", sorted({file.relative_to(ROOT).parts[0] for file in ROOT.rglob("*.py")}))
def test_public_docstrings_begin_with_a_verb(room):
    found = {}
    for file in sorted((ROOT / room).rglob("*.py")) if (ROOT / room).is_dir() else [ROOT / room]:
        if rows := list(wrong(ast.parse(file.read_text(encoding="utf-8")))):
            found[file.relative_to(ROOT).as_posix()] = rows
    assert not found, "\n".join(
        f"{file}:{line} {name}: {text}" for file, rows in found.items() for line, name, text in rows
    )


@pytest.mark.parametrize("text", ["The mass of a robot.", "Of Adam, for every network.", "What is read."])
def test_a_noun_is_found(text):
    planted = ast.parse(f'class Robot:\n    """Hold a robot."""\n    def mass(self):\n        """{text}"""')
    assert [row[1] for row in wrong(planted)] == ["Robot.mass"]
