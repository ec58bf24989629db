"""Damaged MJCF and URDF files are refused by a message, or make a robot that is what MuJoCo makes of the file."""

import contextlib
import random
import subprocess
import sys
from collections import Counter
from xml.etree import ElementTree

import pytest
from attacking import Attacker, defects
from robots import FREE_LEGS, TWO_LEGS

from gctd3.robots.mjcf import find_mjcf

pytestmark = pytest.mark.nightly

INERTIAL = '<inertial><mass value="{}"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'
LIMIT = '<limit lower="-0.8" upper="0.8" effort="20" velocity="9"/>'


def urdf(legs):
    """Return a robot with a box for a trunk and legs of two links, at (name, x, y)."""
    parts = [f'<link name="trunk">{INERTIAL.format(4)}<collision><geometry><box size="0.3 0.2 0.1"/></geometry>']
    parts.append("</collision></link>")
    for name, x, y in legs:
        for link, parent, place, kind in (
            (f"thigh_{name}", "trunk", f"{x} {y} 0", "hip"),
            (f"shank_{name}", f"thigh_{name}", "0 0 -0.2", "knee"),
        ):
            parts.append(
                f'<link name="{link}">{INERTIAL.format(0.5)}<collision><origin xyz="0 0 -0.1"/><geometry>'
                '<cylinder radius="0.02" length="0.2"/></geometry></collision></link>'
                f'<joint name="{kind}_{name}" type="revolute"><parent link="{parent}"/><child link="{link}"/>'
                f'<origin xyz="{place}"/><axis xyz="0 1 0"/>{LIMIT}</joint>'
            )
    return f'<robot name="made_up">{"".join(parts)}</robot>'


FOUR = [("fl", 0.15, 0.1), ("fr", 0.15, -0.1), ("rl", -0.15, 0.1), ("rr", -0.15, -0.1)]
SOURCES = {
    "biped.xml": lambda: find_mjcf("biped").read_text(),
    "planar.xml": lambda: find_mjcf("biped_planar").read_text(),
    "quadruped.xml": lambda: find_mjcf("quadruped").read_text(),
    "boom.xml": lambda: TWO_LEGS,
    "free.xml": lambda: FREE_LEGS,
    "four.urdf": lambda: urdf(FOUR),
    "two.urdf": lambda: urdf(FOUR[:2]),
}
NUMBERS = ("nan", "inf", "-inf", "1e308", "-1e308", "1e-308", "0", "-1", "1e9", "", "x", "0x1p3", "1 2 3 4 5 6 7 8 9")
FACTORS = (-1.0, 0.0, 0.5, 0.9, 1.01, 2.0, 10.0, 1e4, 1e-4)
EACH, CHUNKS = 60, 3  # cases of a source, in so many tests


def numbers(element):
    """Return the attributes that hold numbers."""
    found = {}
    for key, text in element.attrib.items():
        with contextlib.suppress(ValueError):
            found[key] = [float(word) for word in text.split()]
    return [(key, values) for key, values in found.items() if values]


def mutate(root, rng):
    """Change one thing, and say which."""
    parents = [(parent, child) for parent in root.iter() for child in parent]
    parent, child = rng.choice(parents)
    kind = rng.choice(("remove", "double", "rename", "scale", "scale", "number", "drop", "swap", "move", "same name"))
    if kind == "remove":
        parent.remove(child)
    elif kind == "double":
        parent.insert(rng.randrange(len(parent) + 1), child)
    elif kind in ("rename", "drop", "same name") and child.attrib:
        key = rng.choice(sorted(child.attrib))
        if kind == "drop":
            del child.attrib[key]
        elif kind == "same name":
            same = [other.attrib["name"] for other in root.iter(child.tag) if "name" in other.attrib]
            child.set("name", rng.choice(same) if same else "same")
        else:
            child.set(key, rng.choice(("", "renamed", "right", "left", "world", "機械", "a b", "root_pitch", "ground")))
    elif kind == "scale" and numbers(child):
        key, values = rng.choice(numbers(child))
        factor = rng.choice(FACTORS)
        child.set(key, " ".join(f"{factor * value:.9g}" for value in values))
    elif kind == "number" and numbers(child):
        key, values = rng.choice(numbers(child))
        words = [f"{value:.9g}" for value in values]
        words[rng.randrange(len(words))] = rng.choice(NUMBERS)
        child.set(key, " ".join(words))
    elif kind == "swap" and len(parent) > 1:
        one, other = rng.sample(range(len(parent)), 2)
        parent[one], parent[other] = parent[other], parent[one]
    elif kind == "move":
        target = rng.choice(parents)[1]
        if target not in child.iter():
            parent.remove(child)
            target.append(child)


def files(source, folder):
    """Write damaged copies of a robot's file, the same ones every time; the first one is whole."""
    text = SOURCES[source]()
    (folder / f"000_{source}").write_text(text)
    yield folder / f"000_{source}"
    for number in range(1, EACH):
        rng = random.Random(f"{source} {number}")
        root = ElementTree.fromstring(text)
        for _ in range(rng.choice((1, 1, 1, 2, 4))):
            mutate(root, rng)
        file = folder / f"{number:03d}_{source}"
        file.write_bytes(ElementTree.tostring(root, encoding="utf-8"))
        yield file


def ends_mujoco_too(file):
    """Tell whether MuJoCo's compiler by itself ends a process with a file: that is not this library's fault."""
    code = f"import mujoco; mujoco.MjSpec.from_file({str(file)!r}).compile()"
    return subprocess.run([sys.executable, "-c", code], capture_output=True).returncode < 0


@pytest.mark.parametrize("chunk", range(CHUNKS))
@pytest.mark.parametrize("source", SOURCES)
def test_robot_files(tmp_path, source, chunk):
    attacker, answers = Attacker("attack_robot_files", tmp_path), {}
    for file in list(files(source, tmp_path))[chunk::CHUNKS]:
        answer = attacker.ask(file=str(file))
        answers[file.name] = "refused" if answer == "crash" and ends_mujoco_too(file) else answer
    attacker.close()
    assert not defects(answers)
    if chunk == 0:
        assert answers[f"000_{source}"] == "ok"
    assert Counter(answers.values())["ok"] > 0


def test_files_are_the_same_every_time(tmp_path):
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
    one, two = (list(files("biped.xml", tmp_path / folder)) for folder in ("one", "two"))
    assert [a.read_bytes() for a in one] == [b.read_bytes() for b in two]
    assert len({a.read_bytes() for a in one}) > 0.9 * EACH
