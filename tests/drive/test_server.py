"""The page and its WebSocket, as a browser meets them, before a session of which nothing is simulated."""

import contextlib
import json
import time
from dataclasses import replace

import httpx
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync import client

from lerobot_gloves.commands.drive import address, listening
from lerobot_gloves.drive.board import Board
from lerobot_gloves.drive.desk import PATIENCE, Desk
from lerobot_gloves.drive.seats import PAGES
from lerobot_gloves.drive.server import Site, is_loopback, serving
from lerobot_gloves.drive.session import Snapshot
from lerobot_gloves.drive.stick import CENTRE
from tests.drive.test_protocol import Driven

ABOUT, PICTURE = {"type": "about", "episode": 1}, b"a picture"


class Served:
    """A server, and what it stands before."""

    def __init__(self, port: int, driven: Driven, desk: Desk, board: Board):
        self.port, self.driven, self.desk, self._board = port, driven, desk, board
        self.steps = 0

    def step(self) -> None:
        self.steps += 1
        self._last = Snapshot(ABOUT, {"type": "state", "step": self.steps}, ((0.0, 0.0, False),), PICTURE)
        self._board.publish(self._last)

    def draw(self) -> None:
        """Another picture of the last step."""
        self._board.publish(replace(self._last, picture=b"another picture"))

    def open(self, query: str = "", **options):
        return client.connect(f"ws://127.0.0.1:{self.port}/socket{query}", proxy=None, **options)

    def told(self, ws, kind: str):
        """The next message of a type."""
        for _ in range(200):
            self.step()
            with contextlib.suppress(TimeoutError):
                message = ws.recv(timeout=0.05)
                message = {"type": "picture"} if isinstance(message, bytes) else json.loads(message)
                if message["type"] == kind:
                    return message
        raise AssertionError(f"never told of {kind}")


def until(condition) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


@contextlib.contextmanager
def served(token: str | None = None):
    driven, board = Driven(), Board()
    desk = Desk(driven)
    with listening("127.0.0.1", 0) as listener, serving(Site(desk, board, {"rate": 20}, token), listener):
        yield Served(listener.getsockname()[1], driven, desk, board)


@pytest.fixture
def site():
    with served() as found:
        yield found


def test_the_page_is_whole_and_nothing_comes_from_elsewhere(site):
    for path, kind in (("", "text/html"), ("page.css", "text/css"), ("page.js", "text/javascript")):
        answer = httpx.get(f"http://127.0.0.1:{site.port}/{path}")
        assert answer.status_code == 200 and answer.headers["content-type"].startswith(kind)
        assert "script-src 'self'" in answer.headers["content-security-policy"]
        assert "//" not in answer.text.replace("://${location.host}", "") or path.endswith(".js")
        assert "http" not in answer.text.replace("https:", "")
    assert httpx.get(f"http://127.0.0.1:{site.port}/../server.py").status_code == 404


def test_a_page_is_told_everything_once_and_then_what_changes(site):
    with site.open() as ws:
        kinds = []
        until(lambda: site.desk.seats.driver is not None)
        for _ in range(8):
            site.step()
            with contextlib.suppress(TimeoutError):
                while True:
                    message = ws.recv(timeout=0.1)
                    kinds.append("picture" if isinstance(message, bytes) else json.loads(message)["type"])
        assert kinds[:6] == ["scene", "role", "trail", "about", "state", "picture"] and set(kinds[6:]) == {"state"}


def test_a_step_is_told_once_though_its_frame_comes_later(site):
    with site.open() as ws:
        site.told(ws, "picture")
        site.step()
        while ws.recv(timeout=10) != json.dumps({"type": "state", "step": site.steps}):
            pass
        site.draw()
        assert ws.recv(timeout=10) == b"another picture"


def test_the_first_page_drives_a_second_one_watches_and_takes_over_once_it_may(site):
    with site.open("?page=b") as driver:
        assert site.told(driver, "role") == {"type": "role", "drives": True, "free": False}
        with site.open("?page=c") as watcher:
            assert site.told(watcher, "role") == {"type": "role", "drives": False, "free": False}
            watcher.send('{"type": "command", "x": 1, "y": 0}')
            assert site.told(watcher, "error")["line"] == "only the page that drives may do that"
            assert site.driven.stick.position == CENTRE
            driver.send('{"type": "command", "x": 0.5, "y": 0}')
            until(lambda: site.driven.stick.position == (0.5, 0.0, 0.0, 0.0))
            driver.close()
            assert site.told(watcher, "role") == {"type": "role", "drives": False, "free": True}
            assert site.driven.stick.position == CENTRE
            watcher.send('{"type": "take"}')
            assert site.told(watcher, "role") == {"type": "role", "drives": True, "free": False}


def test_a_page_that_connects_anew_drives_on(site):
    with site.open("?page=b") as old, site.open("?page=b") as new:
        assert site.told(new, "role")["drives"]
        with pytest.raises(ConnectionClosed) as closed:
            site.told(old, "never")
        assert closed.value.rcvd.code == 4000


def test_nan_is_refused_in_one_line_and_stops_the_robot(site):
    with site.open() as ws:
        ws.send('{"type": "command", "x": 1, "y": 0}')
        until(lambda: site.driven.stick.position == (1.0, 0.0, 0.0, 0.0))
        ws.send('{"type": "command", "x": NaN, "y": 0}')
        assert site.told(ws, "error")["line"] == "a message must hold finite numbers, not NaN"
        assert site.driven.stick.position == CENTRE


@pytest.mark.parametrize(
    ("sent", "times", "code"), [("nonsense", PATIENCE, 1008), (b"\0", PATIENCE, 1008), ("x" * 9999, 1, 1009)]
)
def test_a_page_that_does_not_stop_or_sends_enormous_messages_is_closed(site, sent, times, code):
    with site.open() as ws:
        for _ in range(times):
            ws.send(sent)
        with pytest.raises(ConnectionClosed) as closed:
            site.told(ws, "never")
        assert closed.value.rcvd.code == code
        until(lambda: site.desk.seats.driver is None)
    with site.open() as ws:
        assert site.told(ws, "role")["drives"]


def test_of_a_hundred_connections_most_are_refused_in_one_line(site):
    with contextlib.ExitStack() as stack:
        opened = [stack.enter_context(site.open()) for _ in range(100)]
        refused = 0
        for ws in opened[PAGES:]:
            with pytest.raises(ConnectionClosed) as closed:
                ws.recv(timeout=10)
            refused += closed.value.rcvd.reason == f"{PAGES} pages are open already: close one"
        assert refused == 100 - PAGES and site.told(opened[0], "role")["drives"]


def test_pages_of_other_sites_and_names_of_other_hosts_are_refused(site):
    with pytest.raises(InvalidStatus) as refused:
        site.open(origin="http://elsewhere.example").close()
    assert refused.value.response.status_code == 403
    with site.open(origin=f"http://127.0.0.1:{site.port}") as ws:
        assert site.told(ws, "role")["drives"]
    answer = httpx.get(f"http://127.0.0.1:{site.port}/", headers={"Host": "elsewhere.example"})
    assert (answer.status_code, answer.text) == (403, "gloves drive: ask for localhost\n")


def test_where_others_reach_it_the_address_needs_the_token():
    with served("a token") as site:
        for query in ("", "?token=", "?token=another"):
            answer = httpx.get(f"http://127.0.0.1:{site.port}/{query}")
            assert answer.status_code == 403 and answer.text.count("\n") == 1
            with pytest.raises(InvalidStatus):
                site.open(query).close()
        assert httpx.get(f"http://127.0.0.1:{site.port}/?token=a%20token").status_code == 200
        with site.open("?token=a%20token") as ws:
            assert site.told(ws, "role")["drives"]


def test_what_only_this_computer_reaches():
    assert [is_loopback(host) for host in ("127.0.0.1", "127.9.9.9", "::1", "[::1]", "localhost")] == [True] * 5
    assert not any(is_loopback(host) for host in ("0.0.0.0", "::", "192.168.1.2", "localhost.example", ""))
    assert address("192.168.1.2", 80, "t") == "http://192.168.1.2:80/?token=t"
    assert address("::1", 80, None) == "http://[::1]:80/"
