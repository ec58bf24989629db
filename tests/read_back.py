"""Read an exported URDF or SDF with MuJoCo's own compiler, and by hand."""

from xml.etree import ElementTree

import mujoco
import numpy as np


def by_mujoco(text, folder=None, free=False):
    """Compile a URDF with MuJoCo: with links as they are written, and a free joint above a root that is free."""
    root = ElementTree.fromstring(text)
    extension = ElementTree.SubElement(root, "mujoco")
    settings = {"fusestatic": "false", "strippath": "false", "discardvisual": "true", "balanceinertia": "false"}
    ElementTree.SubElement(extension, "compiler", settings | ({"meshdir": str(folder)} if folder else {}))
    if free:
        top = next(iter(root.iterfind("link"))).get("name")
        ElementTree.SubElement(root, "link", name="world")
        joint = ElementTree.SubElement(root, "joint", name="free_base", type="floating")
        ElementTree.SubElement(joint, "parent", link="world")
        ElementTree.SubElement(joint, "child", link=top)
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))


def inertia(model, body):
    """Return a body's inertia about its centre of mass, along the body's axes."""
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[body])
    turn = turn.reshape(3, 3)
    return turn @ np.diag(model.body_inertia[body]) @ turn.T


def configured(model, qpos_of):
    """Return the places of a model's bodies with joint angles by name, and of ``free_base`` the pose."""
    data = mujoco.MjData(model)
    for name, values in qpos_of.items():
        start = int(model.joint(name).qposadr[0])
        data.qpos[start : start + np.size(values)] = values
    mujoco.mj_forward(model, data)
    return data
