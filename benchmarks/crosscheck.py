"""Check policies in other engines: finishes, speed, contacts and torques beside MuJoCo's, with a negative control.

    python benchmarks/crosscheck.py out=benchmarks/results/crosscheck.json
    python benchmarks/crosscheck.py engines=gazebo out=benchmarks/results/crosscheck.json
    python benchmarks/crosscheck.py run=DIR trained="python -m gctd3.train robot=go2" episodes=20 out=...

Each row is what ``python -m gctd3.crosscheck out=FILE`` writes, with its command and commit. Rows of a file that is
there are kept, unless they are of the same robot, engine and armature. The negative control, without armature, has few
starts: it explodes at once.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from common import commit, options, report

from gctd3.engines.crosscheck import cross_check, table
from gctd3.engines.settings import CrossCheckSettings

KEY = ("robot", "engine", "armature")
CONTROLS = 5  # starts of the negative control


def main() -> None:
    """Check, print, write."""
    given = options(run="", trained="", engines="dart,bullet,gazebo", episodes="50", seed="10000", out="")
    rows: list[dict[str, Any]] = []
    if given["out"] and Path(given["out"]).is_file():
        rows = json.loads(Path(given["out"]).read_text())["rows"]
    # All before the first: an engine may be missing.
    asked = [
        CrossCheckSettings(
            run=given["run"] or None,
            engine=engine,
            episodes=int(given["episodes"]) if armature else CONTROLS,
            seed=int(given["seed"]),
            armature=armature,
        )
        for engine in given["engines"].split(",")
        for armature in (True, False)
    ]
    for settings in asked:
        check = cross_check(settings)
        print(f"\n{check.task.robot.path.stem} in {settings.engine}{'' if settings.armature else ' without armature'}")
        print(table(check), flush=True)
        arguments = [f"engine={settings.engine}", f"episodes={settings.episodes}", f"seed={settings.seed}"]
        arguments += [] if settings.armature else ["armature=false"]
        command = " ".join(["python -m gctd3.crosscheck", *(["run=DIR"] if given["run"] else []), *arguments])
        made = {"command": command, "commit": commit(), "trained": given["trained"] or "the policy in the package"}
        row = {**made, **check.report()}
        rows = [other for other in rows if any(other[key] != row[key] for key in KEY)] + [row]
        report("crosscheck", {"rows": rows}, given["out"])


if __name__ == "__main__":
    main()
