"""Draw the robots that were trained, for the documentation: a strip of frames of one policy of each.

    python benchmarks/robot_pictures.py [runs=runs/robots] [result=FILE.json] [out=docs/robots]

Takes of each robot the run whose feet slip least, from the trainings that ``benchmarks/robots.py what=train`` has left
in ``runs``. Needs the robots' packages, since their meshes are drawn.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from common import options
from PIL import Image

LOOK = ["rows=1", "columns=4", "width=160", "height=160", "begin=7", "every=5"]  # 0.1 s of 50 Hz
SKY = 48  # pixels of sky on top, with numbers that are in the table beside the picture


def main() -> None:
    """Draw each robot."""
    results = Path(__file__).parent / "results"
    docs = Path(__file__).parents[1] / "docs"
    given = options(runs="runs/robots", result=str(results / "robots_train.json"), out=str(docs / "robots"))
    rows = json.loads(Path(given["result"]).read_text(encoding="utf-8"))["rows"]
    out = Path(given["out"])
    out.mkdir(parents=True, exist_ok=True)
    for robot in dict.fromkeys(row["robot"] for row in rows):
        done = [row for row in rows if row["robot"] == robot and "failed" not in row and row["slip_m_s"] is not None]
        if not done:
            print(f"{robot}: no policy whose walk was measured", flush=True)
            continue
        best = min(done, key=lambda row: row["slip_m_s"])
        run = Path(given["runs"]).absolute() / "train" / robot / f"seed{best['seed']}"
        line = [sys.executable, "-m", "gctd3.render", f"run='{run}'", f"out='{out / robot}.png'", *LOOK]
        subprocess.run(line, check=True)
        with Image.open(out / f"{robot}.png") as strip:
            cut = strip.crop((0, SKY, *strip.size))
        cut.save(out / f"{robot}.png", optimize=True)
        print(f"{robot}: seed {best['seed']}", flush=True)


if __name__ == "__main__":
    main()
