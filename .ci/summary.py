"""Say in a page what came of a test run: when, of which commit, where, how many tests, and why some were skipped.

python .ci/summary.py RESULTS.xml SECONDS
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections import Counter
from datetime import datetime, timezone


def commit() -> str:
    """The checkout's commit, with ``-dirty`` behind it if files differ from it."""
    describe = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    return subprocess.run(describe, capture_output=True, text=True, check=False).stdout.strip() or "unknown"


def summary(results: str, seconds: int) -> str:
    """The page, from pytest's JUnit file."""
    cases = list(ElementTree.parse(results).getroot().iter("testcase"))
    outcomes: dict[str, list[str]] = {"failed": [], "skipped": []}
    reasons: Counter[str] = Counter()
    for case in cases:
        name = f"{case.get('classname', '').replace('.', '/')}.py::{case.get('name')}"
        skipped = case.find("skipped")
        if case.find("failure") is not None or case.find("error") is not None:
            outcomes["failed"].append(name)
        elif skipped is not None:
            outcomes["skipped"].append(name)
            reasons[skipped.get("message", "")] += 1
    failed, left = len(outcomes["failed"]), len(outcomes["skipped"])
    lines = [
        "bash .ci/nightly",
        f"date:    {datetime.now(timezone.utc):%Y-%m-%d %H:%M} UTC",
        f"commit:  {commit()}",
        f"machine: {os.cpu_count()} CPU cores, {platform.machine()}, Python {platform.python_version()}",
        f"tests:   {len(cases)}, of which {len(cases) - failed - left} passed, {failed} failed, {left} were skipped; "
        f"{seconds // 60} min {seconds % 60} s",
    ]
    lines += ["", "Failed:", *outcomes["failed"]] if failed else []
    lines += (
        ["", "Skipped, by reason:", *(f"{count:4d}  {why}" for why, count in reasons.most_common())] if left else []
    )
    return "\n".join(lines)


if __name__ == "__main__":
    print(summary(sys.argv[1], int(sys.argv[2])))
