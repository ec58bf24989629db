"""Functions run in threads of their own."""

import subprocess
import sys
import threading

import pytest

from gctd3.data.background import in_thread

# A child that asks for a signal at its parent's death, as Ray's servers do; the parent prints the outcome.
ASKING = """
import ctypes, signal, subprocess, sys, time
from gctd3.data.background import in_thread
def child():
    ask = lambda: ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    return subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"], preexec_fn=ask)
started = in_thread(child, stays={stays}).result()
try:
    print(started.wait(0.5))
except subprocess.TimeoutExpired:
    print("lives")
    started.kill()
"""


def test_its_result_and_its_error_arrive():
    assert in_thread(lambda: 3).result(10) == 3
    with pytest.raises(ZeroDivisionError):
        in_thread(lambda: 1 / 0, stays=True).result(10)


def test_a_thread_that_stays_does():
    name = in_thread(lambda: threading.current_thread().name, stays=True).result(10)
    assert name in {thread.name for thread in threading.enumerate()}


@pytest.mark.skipif(sys.platform != "linux", reason="the signal is Linux's")
@pytest.mark.parametrize(("stays", "said"), [(True, "lives"), (False, "-9")])
def test_processes_that_end_with_their_thread_need_one_that_stays(stays, said):
    done = subprocess.run([sys.executable, "-c", ASKING.format(stays=stays)], capture_output=True, text=True)
    assert done.stdout.strip() == said, done.stderr
