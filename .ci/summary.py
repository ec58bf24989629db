"""Say in a page what came of a test run: when, of which commit, where, how many tests, and why some were skipped.

python .ci/summary.py RESULTS.xml SECONDS [COMMAND [INSTALLED ...]]

COMMAND is the test run's, ``bash .ci/nightly`` by default. INSTALLED are words of reasons for which no test may have
been skipped, since what they ask for is installed; the exit code is 1 if one was.
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


def still_skipped(results: str, installed: list[str]) -> list[str]:
    """The reasons of skipped tests that hold one of the words."""
    cases = ElementTree.parse(results).getroot().iter("skipped")
    reasons = {case.get("message", "") for case in cases}
    return sorted(reason for reason in reasons if any(word in reason for word in installed))


def summary(results: str, seconds: int, command: str = "bash .ci/nightly") -> str:
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
        command,
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
    print(summary(sys.argv[1], int(sys.argv[2]), *sys.argv[3:4]))
    left = still_skipped(sys.argv[1], sys.argv[4:])
    for why in left:
        print(f"skipped, though it is installed: {why}", file=sys.stderr)
    raise SystemExit(1 if left else 0)
