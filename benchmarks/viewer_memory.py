"""Resident memory of the viewer while pages watch it, steer it, come and go: does it grow?

    python benchmarks/viewer_memory.py [minutes=60] [clients=5] [out=FILE.json] [run=DIR]

Runs ``python -m gctd3.view`` with so many websocket clients (those of the tests: they read all that a page reads).
Every 15 s one of them changes a slider, resets the walk, or leaves without a word while another comes; the process's
memory is read then (from ``/proc``, so on Linux). Growth is that of the medians: the last tenth of the time against the
second tenth, since the first holds what is loaded when the first page comes.
"""

from __future__ import annotations

import itertools
import statistics
import sys
import time
from pathlib import Path

from common import options, report
from websockets.exceptions import ConnectionClosed

# The tests' client speaks the page's protocol; a second one would only be a copy.
sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))
from viewer_client import Client, Viewer

OWN = {"minutes": "60", "clients": "5", "out": "", "run": ""}
EVERY = 15.0  # s

Sample = tuple[float, float, float]  # minutes, simulated time of the walk (s), resident memory (MB)


def disturb(clients: list[Client], port: int, turn: int) -> None:
    """Do what people do: move a slider, start anew, leave and come back."""
    client = clients[turn % len(clients)]
    match turn % 4:
        case 0:
            client.set("Speed", 0.5 if turn % 8 else 1.0)
        case 1:
            client.set("Friction", 0.9 if turn % 8 == 1 else 1.0)
        case 2:
            client.set("Reset", True)
        case _:
            client.vanish()
            clients[turn % len(clients)] = Client(port).ready()


def watch(viewer: Viewer, count: int, minutes: float) -> list[Sample]:
    """Attend a viewer with so many clients for so long, and note its memory."""
    clients = [Client(viewer.port).ready() for _ in range(count)]
    samples: list[Sample] = []
    began = time.monotonic()
    for turn in itertools.count():
        now = (time.monotonic() - began) / 60
        if now >= minutes:
            return samples
        disturb(clients, viewer.port, turn)
        clients[(turn + 1) % count].goes_on()
        samples.append((round(now, 2), clients[(turn + 1) % count].time, viewer.memory() / 1e6))
        print(f"[{now:5.1f} min] {samples[-1][2]:8.0f} MB", flush=True)
        time.sleep(min(EVERY, 60 * minutes / 40))


def main() -> None:
    """Attend, watch, report."""
    own = options(**OWN)
    viewer = Viewer(*([f"run={own['run']}"] if own["run"] else []))
    try:
        with viewer:
            samples = watch(viewer, int(own["clients"]), float(own["minutes"]))
    except (AssertionError, ConnectionClosed) as error:
        raise SystemExit(
            f"the viewer fell silent, and ended with {viewer.process.returncode}:\n{viewer.output}"
        ) from error
    tenth = len(samples) // 10
    if not tenth:
        raise SystemExit(f"only {len(samples)} samples, of at least 10: watch longer")
    memory = [sample[2] for sample in samples]
    first, last = statistics.median(memory[tenth : 2 * tenth]), statistics.median(memory[-tenth:])
    print(f"\nin the second tenth {first:.0f} MB, in the last {last:.0f} MB ({last / first - 1:+.1%})")
    figures = {"clients": int(own["clients"]), "samples": samples, "first_mb": first, "last_mb": last}
    report("viewer_memory", figures | {"growth": last / first - 1}, own["out"])


if __name__ == "__main__":
    main()
