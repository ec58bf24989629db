#!/usr/bin/env bash
# Expected: Half Cheetah weighs 14 kg in everything that reads Gymnasium's or dm_control's file of it.
# Instead: its geoms add up to 21.2 kg. The 14 are an attribute at the top of the files, <compiler settotalmass="14">,
#   that MuJoCo obeys and Pinocchio and Newton pass over without a word: the robot is half as heavy again, and needs
#   half as much torque again for the same motion. MuJoCo 3.17 warns that the attribute is to be removed.
# Versions: gymnasium 1.3.0, dm_control 1.0.50, mujoco 3.17.0, pin 4.1.0, newton 1.8.0, warp-lang 1.19.0.
# Matters for: comparisons of one policy, or of results, on "HalfCheetah" in two simulators, and model-based control.
#   Other robots with that attribute may be off by any factor.
# Source: MuJoCo's XML reference, compiler/settotalmass; of the two readers none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check \
  mujoco==3.17.0 pin==4.1.0 newton==1.8.0 warp-lang==1.19.0 numpy==2.2.6
venv/bin/pip install -q --disable-pip-version-check --no-deps gymnasium==1.3.0 dm_control==1.0.50
export WARP_CACHE_PATH="$PWD/warp"
venv/bin/python - <<'PY'
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import mujoco
import newton
import numpy as np
import pinocchio
import warp

warp.config.quiet = True


def folder(package):
    return Path(find_spec(package).origin).parent


def weigh(path):
    """Return the robot's mass in MuJoCo, Pinocchio and Newton, in kg."""
    builder = newton.ModelBuilder()
    builder.add_mjcf(str(path))
    return (
        mujoco.MjModel.from_xml_path(str(path)).body_mass.sum(),
        sum(inertia.mass for inertia in pinocchio.buildModelFromMJCF(str(path)).inertias),
        sum(builder.body_mass),
    )


packages = "gymnasium", "dm_control", "mujoco", "pin", "newton", "warp-lang"
print(*(f"{name} {version(name)}" for name in packages))
for name, path in (
    ("Gymnasium's", folder("gymnasium") / "envs" / "mujoco" / "assets" / "half_cheetah.xml"),
    ("dm_control's", folder("dm_control") / "suite" / "cheetah.xml"),
):
    assert 'settotalmass="14"' in path.read_text()
    bare = path.with_name("bare.xml")
    bare.write_text(path.read_text().replace('settotalmass="14"', ""))
    for title, file in ((name, path), (f"{name}, without the attribute", bare)):
        masses = weigh(file)
        print(f"{title}: {masses[0]:.2f} kg in MuJoCo, {masses[1]:.2f} in Pinocchio, {masses[2]:.2f} in Newton")
        assert np.allclose(masses, (14 if file == path else 21.184, 21.184, 21.184), atol=0.01)
PY
