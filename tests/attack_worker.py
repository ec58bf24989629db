"""Answer generated cases in a process that a case may hang or crash: one JSON object a line in, one out.

A case is answered with ``ok`` (it passes its oracle), ``refused`` (by an error that the library raises on purpose),
or ``defect`` and what went wrong. A case may use ten seconds of this process's own time.
"""

import contextlib
import importlib
import json
import os
import resource
import signal
import sys
import traceback
import warnings

SECONDS = 10  # of CPU time, so that other processes do not matter
MEMORY = 24 << 30  # bytes of addresses, for sizes that nobody meant


class Hang(BaseException):
    """Report that a case takes too long; no handler of the library may catch it."""


def _late(number, frame):
    raise Hang


def main():
    """Answer until the input ends."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    warnings.simplefilter("ignore")
    # What the library prints is not an answer.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    check = importlib.import_module(sys.argv[1]).check
    signal.signal(signal.SIGPROF, _late)
    answers.write("ready\n")
    answers.flush()
    for line in sys.stdin:
        signal.setitimer(signal.ITIMER_PROF, SECONDS)
        try:
            answer = check(**json.loads(line))
        except Hang:
            answer = f"defect: no answer after {SECONDS} s of work"
        except BaseException as error:
            place = traceback.extract_tb(error.__traceback__)[-1]
            answer = f"defect: {type(error).__name__} at {os.path.basename(place.filename)}:{place.lineno}: {error}"
        finally:
            # It may strike while it is being reset.
            with contextlib.suppress(Hang):
                signal.setitimer(signal.ITIMER_PROF, 0)
        answers.write(answer.replace("\n", " ") + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
