"""URDF files as texts: links, joints, and a robot of two legs."""

INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>'


def link(name, *geometry, inertial=INERTIAL, origin=""):
    shapes = "".join(f"<collision>{origin}<geometry>{shape}</geometry></collision>" for shape in geometry)
    return f'<link name="{name}">{inertial}{shapes}</link>'


def joint(
    name, parent, child, xyz="0 0 0", kind="revolute", more='<limit lower="-1" upper="1" effort="7" velocity="9"/>'
):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/><axis xyz="0 1 0"/>{more}</joint>'
    )


def robot(*parts):
    return f'<?xml version="1.0"?><!-- <mujoco> --><robot name="two">{"".join(parts)}</robot>'


LEG = '<cylinder radius="0.02" length="0.4"/>'
LEGS = robot(
    link("torso", '<box size="0.2 0.2 0.2"/>'),
    *(
        link(f"leg_{side}", LEG, origin='<origin xyz="0 0 -0.2"/>')
        + joint(f"hip_{side}", "torso", f"leg_{side}", place)
        for side, place in (("l", "0 0.1 -0.1"), ("r", "0 -0.1 -0.1"))
    ),
)
