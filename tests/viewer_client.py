"""A viewer in a process of its own, and clients that speak its page's protocol by a websocket."""

import contextlib
import math
import re
import subprocess
import sys
import threading
import time

import msgspec
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [0.0, -2.0, 0.5],
    "fov": 1.3,
    "near": 0.01,
    "far": 1000.0,
    "image_height": 600,
    "image_width": 800,
    "look_at": [0.0, 0.0, 0.5],
    "up_direction": [0.0, 0.0, 1.0],
}


class Viewer:
    """Run ``python -m gctd3.view`` until the block ends; ``output`` is what it has printed then."""

    def __init__(self, *arguments, cwd=None):
        call = [sys.executable, "-m", "gctd3.view", "port=0", "browser=false", *arguments]
        self._call, self._cwd, self.output = call, cwd, None

    def __enter__(self):
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        self.process = subprocess.Popen(self._call, cwd=self._cwd, **pipes)
        self.first = self.process.stdout.readline()
        found = re.search(r"http://[^:]+:(\d+)", self.first)
        if not found:
            self.process.kill()
            raise AssertionError(self.first + self.process.communicate()[0])
        self.port = int(found[1])
        return self

    def __exit__(self, *error):
        self.alive = self.process.poll() is None
        self.process.terminate()
        self.output = self.process.communicate(timeout=60)[0]

    def memory(self):
        """Return the resident memory of the process (bytes)."""
        with open(f"/proc/{self.process.pid}/statm", encoding="ascii") as file:
            return int(file.read().split()[1]) * 4096


class Client:
    """Read all that the viewer sends, as a page does, and send it messages.

    Attributes:
        controls: Messages that made the page's controls, by label.
        values: Their values, by label.
        page: The status table's cells, by name.
    """

    def __init__(self, port, host="localhost", introduce=True, **options):
        protocol = [f"viser-v{viser.__version__}"]
        self.socket = connect(f"ws://{host}:{port}", subprotocols=protocol, max_size=None, **options)
        self.controls, self.values, self.page, self.close_code = {}, {}, {}, None
        self._changed = threading.Condition()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        if introduce:
            self.send(CAMERA)

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self.socket.close()
        self._reader.join(10)

    def _read(self):
        unzip = zstandard.ZstdDecompressor()
        try:
            for frame in self.socket:
                size, packed = (int.from_bytes(frame[i : i + 8], "little") for i in (0, 8))
                content = msgspec.msgpack.decode(unzip.decompress(frame[16 : 16 + packed], max_output_size=size))
                with self._changed:
                    for message in content["messages"]:
                        self._take(message)
                    self._changed.notify_all()
        except ConnectionClosed:
            pass
        with self._changed:
            self.close_code = self.socket.close_code
            self._changed.notify_all()

    def _take(self, message):
        props = message.get("props") or {}
        if "label" in props and "value" in message:
            self.controls[props["label"]] = message
            self.values[props["label"]] = message["value"]
        content = props.get("content") or (message.get("updates") or {}).get("content")
        if content:
            self.page = dict(re.findall(r"<td class='(\w+)'><b>(.*?)</b>", content)) | {"whole": content}
        if message["type"] == "GuiUpdateMessage" and "value" in message["updates"]:
            (label,) = [name for name, control in self.controls.items() if control["uuid"] == message["uuid"]]
            self.values[label] = message["updates"]["value"]

    def wait(self, condition, seconds=60):
        """Wait until ``condition`` holds of what the viewer has sent."""
        with self._changed:
            assert self._changed.wait_for(condition, seconds), (self.page, self.values, self.close_code)

    def ready(self):
        """Wait for the page's controls and first numbers."""
        self.wait(lambda: "Payload, kg" in self.controls and "time" in self.page)
        return self

    @property
    def time(self):
        return float(self.page["time"].split()[0])

    def goes_on(self):
        """Wait for the walk to advance."""
        before = self.page["time"]
        self.wait(lambda: self.page["time"] != before)

    def send(self, message):
        """Send a message, or the bytes or the text of a frame."""
        self.socket.send(message if isinstance(message, (bytes, str)) else msgspec.msgpack.encode(message))

    def set(self, label, value, **others):
        """Send a value of a control, true or not."""
        uuid = self.controls[label]["uuid"]
        self.send({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value, **others}})

    def vanish(self):
        """Leave without a word, as a machine does that loses its network."""
        self.socket.socket.close()


def lies(client):
    """Yield messages that no page sends: values of wrong types or ranges, unknown ids, other kinds of messages."""
    for label in ("Speed", "Friction", "Payload, kg", "Push, N s"):
        uuid = client.controls[label]["uuid"]
        wrong = (0, -1, math.nan, math.inf, -math.inf, 1e300, "1", None, True, [1.0], {"a": 1}, b"1")
        for value in wrong if label in ("Speed", "Friction") else wrong[1:]:
            yield {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}}
        for name, value in (("max", 1e9), ("label", "x"), ("visible", False), ("removed", True), ("no_such", 1)):
            yield {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {name: value}}
            yield {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": 1.0, name: value}}
    run = client.controls["Run"]["uuid"]
    for value in ("/etc", "../..", "", 0, None, ["shipped with gctd3"], math.nan, "x" * 60_000):
        yield {"type": "GuiUpdateMessage", "uuid": run, "updates": {"value": value}}
    for label in ("Pause", "Follow"):
        for value in ("yes", 1, None, math.nan, []):
            yield {"type": "GuiUpdateMessage", "uuid": client.controls[label]["uuid"], "updates": {"value": value}}
    for uuid in ("nobody", "", 7, None, ["a"], {"a": 1}):
        yield {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": 1.0}}
    for name in CAMERA.keys() - {"type"}:
        for value in (math.nan, math.inf, "text", None, [], [math.nan] * 4, {"a": 1}):
            yield {**CAMERA, name: value}
        yield {key: value for key, value in CAMERA.items() if key != name}
    yield {**CAMERA, "more": 1}
    yield {"type": "GuiUpdateMessage"}
    yield {"type": "GuiUpdateMessage", "uuid": run, "updates": None}
    yield {"type": "GuiUpdateMessage", "uuid": run, "updates": {}}
    for kind in (
        "CommandTriggerMessage",
        "CommandUpdateMessage",
        "GuiFormDirtyMessage",
        "GuiFormSubmitMessage",
        "ShareUrlDisconnect",
        "GetRenderResponseMessage",
        "SceneNodeClickMessage",
        "SceneNodeUpdateMessage",
        "FileTransferStartUpload",
        "GuiRemoveMessage",
        "ResetGuiMessage",
        "RunJavascriptMessage",
        "NoSuchMessage",
        "",
    ):
        yield {"type": kind, "uuid": run, "name": "/fixed_bodies", "updates": {}, "source": "1"}
        yield {"type": kind}


GARBAGE = (
    "a text",
    b"",
    b"\xc1",
    b"\x00" * 100,
    b"\xff" * 1000,
    b"\x91" * 60_000,  # lists in lists
    msgspec.msgpack.encode([1, 2]),
    msgspec.msgpack.encode({"type": 5}),
    msgspec.msgpack.encode({"no": "type"}),
)


@contextlib.contextmanager
def clients(port, number):
    """Connect clients that read all."""
    with contextlib.ExitStack() as stack:
        yield [stack.enter_context(Client(port)) for _ in range(number)]


def until(condition, seconds=60):
    """Wait until a condition holds; fail if it does not."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.05)
