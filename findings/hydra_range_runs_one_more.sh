#!/usr/bin/env bash
# Expected: in a sweep, range(start,stop,step) leaves stop out, as with whole numbers and in Python:
#   range(0.1,0.4,0.1) is 0.1, 0.2 and 0.3.
# Instead: numbers are added up, the sum falls short of stop by rounding, and a run more is made: 0.1, 0.2,
#   0.30000000000000004, 0.4. range(0.1,0.5,0.1) makes the same four. Run names and directories get the long number.
# Versions: hydra-core 1.3.8.
# Matters for: sweeps over learning rates, noise, target speeds: a run too many, and a value that a later filter for
#   0.3 does not find.
# Source: none found.
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check hydra-core==1.3.8
cat > app.py <<'PY'
import hydra


@hydra.main(version_base=None)
def main(cfg):
    print("RUN", cfg.noise)


main()
PY
echo "hydra-core $(venv/bin/python -c 'import hydra; print(hydra.__version__)')"
sweep() {
  venv/bin/python app.py -m hydra.sweep.dir=runs "+noise=range($1,0.1)" | sed -n 's/^RUN //p' | paste -sd ' '
}
three=$(sweep 0.1,0.4) four=$(sweep 0.1,0.5)
echo "range(0.1,0.4,0.1) runs: $three"
echo "range(0.1,0.5,0.1) runs: $four"
[ "$three" = "0.1 0.2 0.30000000000000004 0.4" ]
[ "$four" = "0.1 0.2 0.30000000000000004 0.4" ]
