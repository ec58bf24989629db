"""Ask generated cases of a worker process, which is started anew when a case hangs or ends it."""

import json
import os
import selectors
import subprocess
import sys
from pathlib import Path

TESTS = Path(__file__).parent
WALL = 300  # s, after which a process that does no work counts as hanging; work itself is limited by its CPU time


class Attacker:
    """Run cases of one kind, one after another.

    Args:
        kind: Module with a function ``check`` that answers a case, see ``attack_worker.py``.
        here: Directory to run in.
    """

    def __init__(self, kind, here):
        self.kind, self.here, self.process = kind, here, None

    def ask(self, **case):
        """Return the answer to a case: ``ok``, ``refused``, ``defect: ...``, or ``crash`` if it ended its process."""
        if self.process is None:
            self._start()
        self.process.stdin.write(json.dumps(case) + "\n")
        self.process.stdin.flush()
        return self._read() or "crash"

    def _start(self):
        paths = [str(TESTS), *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1"}
        self.process = subprocess.Popen(
            [sys.executable, str(TESTS / "attack_worker.py"), self.kind],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            cwd=self.here,
            env=environment,
        )
        assert self._read() == "ready", f"the worker of {self.kind} does not start"

    def _read(self):
        with selectors.DefaultSelector() as selector:
            selector.register(self.process.stdout, selectors.EVENT_READ)
            if not selector.select(WALL):
                self.close()
                return f"defect: no answer for {WALL} s"
        line = self.process.stdout.readline().strip()
        if not line:
            self.close()
        return line

    def close(self):
        """End the worker."""
        if self.process is not None:
            self.process.kill()
            self.process.communicate()
            self.process = None


def defects(answers):
    """Return the cases that did not end in a result or in an error raised on purpose, with their answers."""
    return {case: answer for case, answer in answers.items() if answer not in ("ok", "refused")}
