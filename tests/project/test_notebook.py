"""The notebook runs, cell by cell, from an MJCF to a picture of the walk."""

import json
from pathlib import Path

import pytest
from PIL import Image
from running import TINY, command

NOTEBOOK = Path(__file__).parents[2] / "examples" / "quickstart.ipynb"
CELLS = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]


def run(folder, monkeypatch, settings=(), **instead):
    """Execute the code cells as a notebook does, in ``folder``; the cell of parameters gets more settings.

    Names of ``instead`` replace those that the first cell defines.
    """
    monkeypatch.chdir(folder)
    names = {"__name__": "__main__"}
    for cell in (cell for cell in CELLS if cell["cell_type"] == "code"):
        exec(compile("".join(cell["source"]), f"{NOTEBOOK.name}, {cell['id']}", "exec"), names)
        if "parameters" in cell["metadata"].get("tags", []):
            names["settings"] += settings
        names |= instead
    return names


def test_it_says_what_to_do_without_a_display_and_holds_no_outputs():
    first = "".join(CELLS[0]["source"])
    assert "EGL" in first and "OSMesa" in first
    assert all(cell["outputs"] == [] for cell in CELLS if cell["cell_type"] == "code")
    assert sum("parameters" in cell["metadata"].get("tags", []) for cell in CELLS) == 1


@pytest.mark.nightly
def test_its_cells_run(tmp_path, monkeypatch, capsys):
    def here(name, *arguments):
        # Without the seconds that a process of its own needs to begin.
        assert command(name, *arguments) == 0

    names = run(tmp_path, monkeypatch, [f"{key}={value}" for key, value in TINY.items()], command=here)
    said = capsys.readouterr().out
    assert "8 nodes: body, hip_right" in said and "240 frames" in said
    with Image.open(tmp_path / "graph.png") as graph, Image.open(tmp_path / "walk.png") as walk:
        assert min(graph.size) > 100 and min(walk.size) > 100
    assert names["rollout"].batch_size == (4, 100)


@pytest.mark.nightly
def test_its_robot_walks(tmp_path, monkeypatch):
    assert run(tmp_path, monkeypatch)["evaluation"]["success_rate"] == 1.0
