"""A real browser on a page of another site: it reaches the viewer neither by a websocket nor by a name of its own."""

import contextlib
import http.server
import threading

import pytest
import viser
from browsers import chromium
from viewer_client import Viewer

pytest.importorskip("mjviser", reason="no mjviser")
pytestmark = pytest.mark.nightly
# What a page can do: open a websocket, and say whether it opened.
CONNECT = """([url, protocol]) => new Promise(done => {
    const socket = new WebSocket(url, [protocol]);
    socket.onopen = () => done("open");
    socket.onerror = () => done("refused");
})"""


@contextlib.contextmanager
def site():
    """Serve an empty page, as another site would."""

    class Empty(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<title>another site</title>")

        def log_message(self, *arguments):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Empty) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield server.server_address[1]
        server.shutdown()
        thread.join()


def test_only_the_viewers_own_page_reaches_it(tmp_path):
    protocol = f"viser-v{viser.__version__}"
    # Another site's names lead to this machine, as with DNS rebinding.
    rebound = "--host-resolver-rules=MAP *.example 127.0.0.1"
    with Viewer(cwd=tmp_path) as viewer, site() as other, chromium(rebound) as browser:
        page = browser.new_page(viewport={"width": 400, "height": 200})
        page.set_default_timeout(120_000)
        sockets = [f"ws://{name}:{viewer.port}" for name in ("localhost", "127.0.0.1", "evil.example")]
        for address in (f"http://127.0.0.1:{other}", f"http://evil.example:{other}"):
            page.goto(address)
            assert page.title() == "another site"
            assert [page.evaluate(CONNECT, [url, protocol]) for url in sockets] == ["refused"] * 3
        response = page.goto(f"http://evil.example:{viewer.port}")
        assert response.status == 403 and "allowed_hosts" in page.inner_text("body")
        assert page.goto(f"http://localhost:{viewer.port}").status == 200
        page.wait_for_selector("#status")
        assert page.evaluate(CONNECT, [f"ws://localhost:{viewer.port}", protocol]) == "open"
    assert viewer.alive and "Traceback" not in viewer.output
