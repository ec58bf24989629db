#!/usr/bin/env bash
# Expected: a viser page may be changed from the program's own thread, as every example does, however many browsers
#   watch it.
# Instead: each change sets an asyncio.Event in the thread that makes it, besides in the server's loop. That class is
#   not for several threads. asyncio's debug mode says so at the first change; without it the same line raises
#   "deque mutated during iteration" in the caller, once in some thousand changes while browsers come and go: a viewer
#   with five clients ended after 6 to 20 minutes.
# Versions: viser 1.1.1.
# Matters for: anything that draws a robot for hours.
# Source: asyncio's documentation: "asyncio primitives are not thread-safe".
set -euo pipefail
dir=$(mktemp -d); trap 'rm -rf "$dir"' EXIT; cd "$dir"
"${PYTHON:-python3}" -m venv venv
venv/bin/pip install -q --disable-pip-version-check viser==1.1.1
PYTHONASYNCIODEBUG=1 venv/bin/python -W ignore - <<'PY'
import logging
import threading
import time

import viser
from websockets.sync.client import connect

logging.disable(logging.CRITICAL)
server = viser.ViserServer(port=0, verbose=False)
frame = server.scene.add_frame("/robot")


def watch(page):
    for _ in page:
        pass


with connect(f"ws://localhost:{server.get_port()}", subprotocols=[f"viser-v{viser.__version__}"]) as page:
    threading.Thread(target=watch, args=(page,), daemon=True).start()
    time.sleep(2)
    raised = ""
    for step in range(100):
        time.sleep(0.05)  # the page has what there is, and waits
        try:
            frame.position = (step, 0.0, 0.0)
        except RuntimeError as error:
            raised = str(error)
            break
print(f"viser {viser.__version__}, asyncio's debug mode, one page, at change {step + 1}: {raised or 'nothing raised'}")
assert raised.startswith("Non-thread-safe operation"), "changed: pages are woken by the loop alone"
PY
