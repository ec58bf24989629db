#!/usr/bin/env bash
# Expected: a mesh that is handed over with a model, MjSpec.from_string(xml, assets={"leg.obj": content}) or
#   MjModel.from_xml_string(xml, {...}), is the one of that call: its volume, and the mass that follows from it.
# Instead: a process keeps compiled meshes by their name. The second model gets the mesh of the first one, whatever its
#   content is: a tetrahedron twice as wide weighs the same, without a word. A file on the disk is read again only if
#   its time differs by whole seconds, so that one rewritten within a second is not.
# Versions: mujoco 3.17.0.
# Matters for: loading two robots whose meshes have one name (base.stl, pelvis.STL) from memory; randomising meshes;
#   tests. Masses, inertias and contacts are those of the other robot.
# Source: none found. Remedy: names made of the content's hash.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check mujoco==3.17.0
cat > meshes.py <<'PY'
import sys

import mujoco

MODEL = """<mujoco><asset><mesh name="leg" file="{0}"/></asset>
<worldbody><body><freejoint/><geom type="mesh" mesh="leg"/></body></worldbody></mujoco>"""


def content(width):
    return f"v 0 0 0\nv {width} 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n".encode()


def mass(width, name):
    assets = {name: content(width)}
    ways = (
        mujoco.MjSpec.from_string(MODEL.format(name), assets=assets).compile(),
        mujoco.MjModel.from_xml_string(MODEL.format(name), assets),
    )
    first, second = (float(model.body_mass[1]) for model in ways)
    assert first == second
    return round(first)


print(*(mass(width, "leg.obj" if sys.argv[1] == "one" else f"leg_{width}.obj") for width in (1, 2, 3)))
PY
echo "mujoco $(venv/bin/python -c 'import mujoco; print(mujoco.__version__)')"
one=$(venv/bin/python meshes.py one) several=$(venv/bin/python meshes.py several)
echo "masses (kg) of tetrahedra 1, 2 and 3 m wide, each with a name of its own: $several"
echo "the same, all of one name: $one"
[ "$several" = "167 333 500" ]
[ "$one" = "167 167 167" ]
