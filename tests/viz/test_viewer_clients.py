"""The viewer and real websocket clients: foreign pages are refused, and nothing that a client sends ends it."""

import http.client
import shutil
import socket

import pytest
from viewer_client import GARBAGE, Client, Viewer, clients, lies, until
from websockets.exceptions import InvalidStatus

from gctd3.training.saved_configuration import find_run

pytest.importorskip("mjviser", reason="no mjviser")


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    folder = tmp_path_factory.mktemp("viewer")
    shutil.copytree(find_run(None), folder / "runs" / "other")
    with Viewer("allowed_hosts=[robots.example.org]", cwd=folder) as running:
        yield running
    # Whatever the tests below sent: it still walked, and had no more to say than at its start.
    assert running.alive and running.output in ("", "\nInterrupted.\n"), running.output
    assert [path.name for path in folder.iterdir()] == ["runs"]


def answer(port, path="/", **headers):
    """Return the status of the answer to a request with these headers alone."""
    connection = http.client.HTTPConnection("localhost", port, timeout=30)
    connection.putrequest("GET", path, skip_host=True)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    response.read()
    connection.close()
    return response.status


OWN = ["localhost:{port}", "127.0.0.1:{port}", "[::1]:{port}", "LOCALHOST:{port}", "robots.example.org"]
FOREIGN = ["evil.example:{port}", "localhost", "localhost:1", "localhost.evil.example:{port}", "127.0.0.2:{port}", ""]


@pytest.mark.parametrize("host", OWN)
def test_the_page_is_given_to_its_own_names(viewer, host):
    host = host.format(port=viewer.port)
    assert answer(viewer.port, Host=host) == 200
    assert answer(viewer.port, Host=host, Origin=f"http://{host}") == 200


@pytest.mark.parametrize("host", FOREIGN)
def test_other_names_are_refused(viewer, host):
    host, own = host.format(port=viewer.port), f"localhost:{viewer.port}"
    assert answer(viewer.port, Host=host) == 403
    assert answer(viewer.port, Host=own, Origin=f"http://{host}") == 403


@pytest.mark.parametrize("origin", ["null", "file://", "http://", "ftp://localhost:{port}", "localhost:{port}"])
def test_origins_that_are_no_page_of_the_viewer_are_refused(viewer, origin):
    assert answer(viewer.port, Host=f"localhost:{viewer.port}", Origin=origin.format(port=viewer.port)) == 403


def test_a_request_without_a_host_or_with_two_is_refused(viewer):
    assert answer(viewer.port) == 403
    with socket.create_connection(("localhost", viewer.port)) as connection:
        host = f"Host: localhost:{viewer.port}\r\n"
        connection.sendall(f"GET / HTTP/1.1\r\n{host}Host: evil.example\r\n\r\n".encode())
        assert b" 403 " in connection.recv(100)


@pytest.mark.parametrize("origin", ["http://evil.example", "http://localhost:3000", "null"])
def test_a_websocket_of_a_foreign_page_is_refused(viewer, origin):
    with pytest.raises(InvalidStatus, match="403"):
        Client(viewer.port, origin=origin)


def test_a_websocket_to_a_foreign_name_is_refused(viewer):
    with socket.create_connection(("localhost", viewer.port)) as connection:
        upgrade = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        key = "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
        connection.sendall(f"GET / HTTP/1.1\r\nHost: evil.example\r\n{upgrade}{key}\r\n".encode())
        assert b" 403 " in connection.recv(100)


@pytest.mark.parametrize("origin", [None, "http://localhost:{port}", "https://robots.example.org"])
def test_its_own_page_steers_the_walk(viewer, origin):
    with Client(viewer.port, origin=origin and origin.format(port=viewer.port)) as client:
        client.ready().goes_on()
        client.set("Pause", True)
        client.wait(lambda: "<b>paused</b>" in client.page["whole"])
        client.set("Reset", True)
        client.wait(lambda: client.time == 0.0)
        client.set("Pause", True)
        client.goes_on()


def test_a_lie_changes_nothing_for_anybody(viewer):
    with clients(viewer.port, 2) as (honest, liar):
        honest.ready().set("Speed", 0.5)
        liar.ready().wait(lambda: liar.values["Speed"] == 0.5)
        before, controls = dict(honest.values), dict(honest.controls)
        number = 0
        for number, lie in enumerate(lies(liar), 1):  # noqa: B007 - counted
            liar.send(lie)
        assert number > 200
        # What the liar sends next is handled after its lies.
        liar.set("Friction", 0.9)
        honest.wait(lambda: honest.values["Friction"] == 0.9)
        assert honest.values == before | {"Friction": 0.9} and honest.controls == controls
        honest.goes_on()
        honest.set("Friction", 1.0)
        honest.set("Speed", 1.0)
        liar.wait(lambda: liar.values["Speed"] == 1.0)


def test_a_value_counts_only_from_a_page_that_shows_itself(viewer):
    with Client(viewer.port) as honest, Client(viewer.port, introduce=False) as silent:
        silent.ready().set("Speed", 0.5)
        silent.send({"type": "NoSuchMessage"})
        honest.ready().set("Friction", 0.8)
        silent.wait(lambda: silent.values["Friction"] == 0.8)
        assert honest.values["Speed"] == 1.0
        honest.set("Friction", 1.0)
        honest.goes_on()


@pytest.mark.parametrize("frame", GARBAGE, ids=range(len(GARBAGE)))
def test_garbage_ends_its_own_connection_alone(viewer, frame):
    with clients(viewer.port, 2) as (honest, liar):
        honest.ready()
        liar.ready().send(frame)
        liar.wait(lambda: liar.close_code is not None)
        assert liar.close_code == 1008
        honest.goes_on()


def test_a_frame_that_is_too_large_ends_its_own_connection_alone(viewer):
    with clients(viewer.port, 2) as (honest, liar):
        honest.ready()
        liar.ready().send(b"\x00" * 200_000)
        liar.wait(lambda: liar.close_code is not None)
        assert liar.close_code == 1009
        honest.goes_on()


def test_connections_that_break_off_are_left_behind(viewer):
    with Client(viewer.port) as honest:
        honest.ready()
        for start in (b"", b"\x16\x03\x01", b"GET /", b"GET / HTTP/1.1\r\n\r\n", b"POST / HTTP/1.1\r\nHost: a\r\n\r\n"):
            with socket.create_connection(("localhost", viewer.port)) as connection:
                connection.sendall(start)
        for path in ("/%00", "/../../etc/passwd", "/%2e%2e/%2e%2e/pyproject.toml", "/" + "a" * 5000):
            assert answer(viewer.port, path, Host=f"localhost:{viewer.port}") in (404, 500)
        for _ in range(3):
            Client(viewer.port).ready().vanish()
        honest.goes_on()


def test_a_flood_of_pushes_ends_and_delays_nothing(viewer):
    with clients(viewer.port, 2) as (honest, pusher):
        honest.ready()
        pusher.ready().set("Push, N s", 10.0)
        for _ in range(1000):
            pusher.set("Push forward", True)
        pusher.set("Reset", True)
        honest.goes_on()
        pusher.set("Push, N s", 2.5)
        honest.wait(lambda: honest.values["Push, N s"] == 2.5)
        honest.goes_on()


def test_only_a_run_of_the_list_is_loaded(viewer):
    with Client(viewer.port) as client:
        client.ready()
        assert client.controls["Run"]["props"]["options"] == ["shipped with gctd3", "runs/other"]
        client.set("Run", "runs/../runs/other")
        client.set("Run", "runs/other")
        client.wait(lambda: client.controls["Run"]["value"] == "runs/other")
        client.ready().set("Run", "shipped with gctd3")
        client.wait(lambda: client.controls["Run"]["value"] == "shipped with gctd3")
        client.goes_on()


@pytest.mark.nightly
def test_twenty_clients_one_of_them_lying(viewer):
    with clients(viewer.port, 20) as many:
        for client in many:
            client.ready()
        liar, *honest = many
        for _ in range(5):
            for lie in lies(liar):
                liar.send(lie)
        for client in honest[10:]:
            client.vanish()
        honest[0].set("Speed", 1.5)
        for client in honest[1:10]:
            client.wait(lambda client=client: client.values["Speed"] == 1.5)
            client.goes_on()
        honest[0].set("Speed", 1.0)


@pytest.mark.nightly
def test_memory_does_not_grow_with_clients_that_come_and_go(viewer):
    def come_and_go(times):
        for number in range(times):
            client = Client(viewer.port).ready()
            if number % 2:
                client.vanish()
            else:
                client.socket.close()

    # Memory grows by 0.07 MB with each of the first 640 clients, and no further: something is kept of the latest ones.
    come_and_go(700)
    settled = viewer.memory()
    come_and_go(120)
    with Client(viewer.port) as client:
        client.ready().goes_on()
    # A page's scene and controls take 0.3 MB: one client kept in every three would show.
    until(lambda: viewer.memory() - settled < 12e6, seconds=60)
