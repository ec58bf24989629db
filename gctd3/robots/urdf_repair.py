"""Changes to a URDF before MuJoCo reads it: impossible inertias, massless links, parts for other programs."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from gctd3.errors import RobotError, one_line
from gctd3.robots.urdf_tree import first_names, joint_link


def mend_inertias(root: ElementTree.Element, file: Path, notes: list[str]) -> None:
    """Make inertias that no body can have possible: raise moments of 0 or less to a millionth of the largest."""
    mended = []
    for link in root.iterfind("link"):
        inertia = link.find("inertial/inertia")
        if inertia is None:
            continue
        keys = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
        try:
            values, axes = np.linalg.eigh([[float(inertia.get(key, "0")) for key in row] for row in keys])
        except ValueError as error:
            raise RobotError(
                f"{file}: the inertia of link {link.get('name')!r} is no number: {one_line(error)}."
            ) from error
        if values[-1] > 0.0 and values[0] <= 0.0:
            possible = axes @ np.diag(np.maximum(values, 1e-6 * values[-1])) @ axes.T
            for row, numbers in zip(keys, possible, strict=True):
                for key, number in zip(row, numbers, strict=True):
                    inertia.set(key, repr(float(number)))
            mended.append(link.get("name", ""))
    if mended:
        notes.append(f"The inertia of {first_names(mended)} is impossible (not positive) and was raised a little.")


def fix_massless(root: ElementTree.Element, file: Path, notes: list[str]) -> None:
    """Make joints that move no mass immovable, and give a little mass to moving links between others."""
    masses = {link.get("name", ""): link.find("inertial/mass") for link in root.iterfind("link")}
    try:
        heavy = {name for name, mass in masses.items() if mass is not None and float(mass.get("value", "0")) > 0.0}
    except ValueError as error:
        raise RobotError(f"{file}: the mass of a link is no number: {one_line(error)}.") from error
    if not heavy:
        raise RobotError(f"{file}: no link has a mass (<inertial> with <mass>).")
    below: dict[str, list[ElementTree.Element]] = {}
    for joint in root.iterfind("joint"):
        below.setdefault(joint_link(joint, "parent"), []).append(joint)

    def child(joint: ElementTree.Element) -> str:
        return joint_link(joint, "child")

    def has_mass(link: str, rigid: bool, seen: frozenset[str] = frozenset()) -> bool:
        """Tell whether a link has a mass, or one below it; with ``rigid`` only those fixed to it count."""
        inner = (joint for joint in below.get(link, []) if not rigid or joint.get("type") == "fixed")
        return link in heavy or any(
            has_mass(child(joint), rigid, seen | {link}) for joint in inner if child(joint) not in seen
        )

    fixed, lifted = list[str](), list[str]()
    for joint in root.iterfind("joint"):
        if joint.get("type") == "fixed" or not child(joint):
            continue
        if not has_mass(child(joint), rigid=False):
            joint.set("type", "fixed")
            for tag in ("mimic", "limit", "dynamics"):
                for element in joint.findall(tag):
                    joint.remove(element)
            fixed.append(joint.get("name", ""))
        elif not has_mass(child(joint), rigid=True):
            link = next(link for link in root.iterfind("link") if link.get("name") == child(joint))
            for element in link.findall("inertial"):
                link.remove(element)
            inertial = ElementTree.SubElement(link, "inertial")
            ElementTree.SubElement(inertial, "mass", value="0.001")
            small = dict.fromkeys(("ixx", "iyy", "izz"), "1e-6") | dict.fromkeys(("ixy", "ixz", "iyz"), "0")
            ElementTree.SubElement(inertial, "inertia", small)
            lifted.append(child(joint))
    if fixed:
        notes.append(f"{first_names(fixed)} move nothing that has a mass and were fixed.")
    if lifted:
        notes.append(f"{first_names(lifted)} move and have no mass: they were given 1 g.")


def take_the_rest(root: ElementTree.Element, notes: list[str]) -> None:
    """Take out parts for pictures and for other programs, and tell MuJoCo how to read the rest."""
    for link in root.iterfind("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        # Placeholders, which touch nothing; MuJoCo refuses them.
        for collision in link.findall("collision"):
            if any(_is_empty(shape) for shape in collision.iterfind("geometry/*")):
                link.remove(collision)
    for tag in ("material", "transmission", "gazebo", "mujoco"):
        for element in root.findall(tag):
            root.remove(element)
    # Fixed links stay bodies, so that feet keep their names; the inertia of some files is impossible by a rounding.
    options = {"fusestatic": "false", "balanceinertia": "true", "discardvisual": "true"}
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler", options)
    followers = [joint.get("name", "") for joint in root.iterfind("joint") if joint.find("mimic") is not None]
    if followers:
        notes.append(f"{first_names(followers)} follow other joints (mimic), held to them by equality constraints.")


def _is_empty(shape: ElementTree.Element) -> bool:
    """Tell whether a sphere, cylinder, capsule or box has a size of 0."""
    sizes = [text for key in ("radius", "length", "size") for text in shape.get(key, "").split()]
    try:
        return any(float(text) == 0.0 for text in sizes)
    except ValueError:
        return False  # for MuJoCo to say


def skip_floating_root(root: ElementTree.Element) -> None:
    """Take out a root link without mass that only carries a floating joint: its child is the root then."""
    joints = root.findall("joint")
    floating = [joint for joint in joints if joint.get("type") == "floating"]
    for joint in floating:
        name = joint_link(joint, "parent")
        # Not by a path of XML, in which a name could hold what ends it.
        above = [other for other in joints if joint_link(other, "child") == name]
        beside = [other for other in joints if joint_link(other, "parent") == name]
        link = next((link for link in root.iterfind("link") if link.get("name") == name), None)
        if not above and len(beside) == 1 and link is not None and link.find("inertial") is None:
            root.remove(link)
            root.remove(joint)
