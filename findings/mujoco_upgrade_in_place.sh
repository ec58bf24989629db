#!/usr/bin/env bash
# Expected: after `pip install mujoco==4.0.0` over mujoco 3.17.0, which ends with exit code 0, `import mujoco` works.
# Instead: it raises an ImportError. mujoco 4 is three packages (mujoco, mujoco-core, mujoco-studio) that write into one
#   folder; pip installs mujoco-core first and then removes mujoco 3.17.0, whose list of files has the same names.
#   uv, which removes first, upgrades without harm.
#   The line that the ImportError prints as a repair names no versions: once mujoco-core is a release ahead of mujoco, it
#   installs a pair that refuses to be imported together.
# Versions: mujoco 3.17.0, mujoco 4.0.0, mujoco-core 4.0.1.
# Matters for: everybody who upgrades an environment instead of making a new one.
# Source: MuJoCo's release notes of 4.0.0, which say to uninstall first.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
pip() { venv/bin/pip "$1" -q --disable-pip-version-check "${@:2}"; }
imported() { venv/bin/python -c "import mujoco; print('imported', mujoco.__version__)" 2>error.txt || tail -n 3 error.txt; }

pip install mujoco==3.17.0
imported
pip install mujoco==4.0.0
echo "-- pip install mujoco==4.0.0 ended with exit code $?"
imported | tee upgraded.txt
grep -q "missing or corrupted" upgraded.txt

echo "-- its own repair, with a mujoco-core that is newer, as pip now takes it"
pip install --force-reinstall --no-deps mujoco==4.0.0 mujoco-core==4.0.1 mujoco-studio==4.0.0
imported | tee repaired.txt
grep -q "Version mismatch" repaired.txt || echo "(this pip wrote the two in the other order)"

echo "-- removed, then installed"
pip uninstall -y mujoco mujoco-core mujoco-studio
pip install mujoco==4.0.0
imported | tee fresh.txt
grep -q "imported 4.0.0" fresh.txt
