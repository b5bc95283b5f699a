"""The page of a fit that runs: who gets it, what it tells, and when it ends."""

from __future__ import annotations

import contextlib
import http.client
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest

from metapp.extensions.viewer import live as module
from metapp.extensions.viewer.live import CONNECTIONS, HOST, Live
from metapp.extensions.viewer.page import Group, Shown, document
from metapp.extensions.viewer.view import View


def page(title: str) -> dict[str, Any]:
    return document("metapp", [Group(title, "BRDF", [Shown("meta", "", View("pictures"))])])


@pytest.fixture
def live() -> Iterator[Live]:
    server = Live()
    yield server
    server.close()


def get(server: Live, path: str, host: str = "") -> tuple[int, str]:
    """Status and body of a path below the page's address, or of another path or address."""
    address = urlsplit(server.address)
    connection = http.client.HTTPConnection(address.netloc, timeout=20)
    whole = path if path.startswith(("/", "http:")) else address.path + path
    connection.request("GET", whole, headers={"Host": host or address.netloc})
    answer = connection.getresponse()
    return answer.status, answer.read().decode()


def test_the_page_and_its_news_are_served_to_this_machine(live: Live) -> None:
    live.tell(page("gold"), "step 1 of 9", [(1, 0.5)])
    assert urlsplit(live.address).hostname == HOST == "127.0.0.1"
    status, text = get(live, "")
    assert status == 200
    assert '"live": "news"' in text
    news = json.loads(get(live, "news?after=0")[1])
    assert (news["serial"], news["text"], news["curve"], news["done"]) == (1, "step 1 of 9", [[1, 0.5]], False)
    assert news["group"]["title"] == "gold"


def test_nothing_else_is_reachable(live: Live) -> None:
    live.tell(page("gold"), "", [])
    token = urlsplit(live.address).path
    others = ("/", "//", "http://[", "/news", "/%c3%a4", f"{token[:-1]}x/", f"{token}../", f"{token}x")
    for path in (*others, f"{token}%2e%2e/news"):
        status, body = get(live, path)
        assert (status, body) == (404, ""), path


def test_pages_of_other_sites_cannot_ask(live: Live) -> None:
    """A name that somebody has resolve to this machine is not the address that was given."""
    live.tell(page("gold"), "", [])
    port = urlsplit(live.address).port
    for host in ("evil.example", f"evil.example:{port}", f"localhost:{port}", "127.0.0.1:1"):
        assert get(live, "", host)[0] == 404
    connection = http.client.HTTPConnection(urlsplit(live.address).netloc, timeout=20)
    connection.request("GET", urlsplit(live.address).path, headers={"Origin": "https://evil.example"})
    assert connection.getresponse().getheader("Access-Control-Allow-Origin") is None


def test_a_question_waits_for_news(live: Live) -> None:
    live.tell(page("gold"), "first", [])
    threading.Timer(0.3, lambda: live.tell(page("gold"), "second", [])).start()
    begin = time.monotonic()
    assert json.loads(get(live, "news?after=1")[1])["text"] == "second"
    assert time.monotonic() - begin > 0.2


@pytest.mark.parametrize("after", ["", "?after=", "?after=x", "?after=-5", "?after=%d9%a5"])
def test_questions_that_make_no_sense_are_answered(live: Live, after: str) -> None:
    live.tell(page("gold"), "first", [])
    assert json.loads(get(live, f"news{after}")[1])["text"] == "first"


def test_without_news_things_are_as_they_were(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WAIT_SECONDS", 0.05)
    live.tell(page("gold"), "first", [])
    news = json.loads(get(live, "news?after=1")[1])
    assert (news["serial"], news["text"], "group" in news) == (1, "first", False)


def test_a_serial_of_any_length_is_answered(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WAIT_SECONDS", 0.05)
    live.tell(page("gold"), "first", [])
    assert json.loads(get(live, "news?after=" + "9" * 5000)[1])["text"] == "first"


def test_a_page_that_is_early_asks_again(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "WAIT_SECONDS", 0.05)
    status, text = get(live, "")
    assert status == 200
    assert "location.reload()" in text
    live.tell(page("gold"), "first", [])
    assert '"live": "news"' in get(live, "")[1]


def connected(server: Live) -> socket.socket:
    address = urlsplit(server.address)
    return socket.create_connection((address.hostname, address.port), timeout=20)


def closed(connection: socket.socket) -> bool:
    try:
        return connection.recv(1) == b""
    except ConnectionError:
        return True


def test_idle_connections_are_few_and_end(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REQUEST_SECONDS", 0.5)
    live.tell(page("gold"), "", [])
    threads = threading.active_count()
    idle = [connected(live) for _ in range(5 * CONNECTIONS)]
    assert all(closed(one) for one in idle[CONNECTIONS:])
    assert threading.active_count() <= threads + CONNECTIONS
    assert all(closed(one) for one in idle)
    assert get(live, "")[0] == 200


def test_a_request_has_few_bytes_and_little_time(live: Live, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REQUEST_SECONDS", 0.5)
    large, slow = connected(live), connected(live)
    with contextlib.suppress(ConnectionError):
        large.sendall(b"GET / HTTP/1.0\r\nX: " + b"x" * 2**22)
    assert closed(large)
    begun = time.monotonic()
    with contextlib.suppress(ConnectionError):
        while time.monotonic() < begun + 10:  # a byte now and then does not hold it open
            slow.sendall(b"G")
            time.sleep(0.05)
    assert time.monotonic() < begun + 5


def test_errors_of_the_server_are_not_printed(live: Live, capfd: pytest.CaptureFixture[str]) -> None:
    def fail(path: str) -> None:
        raise RuntimeError(path)

    live.answer = fail  # type: ignore[assignment]
    with pytest.raises(http.client.HTTPException):
        get(live, "")
    assert capfd.readouterr() == ("", "")


def test_the_end_reaches_pages_that_are_open_and_waits_for_none_else() -> None:
    server = Live()
    server.tell(page("gold"), "step 1", [])
    get(server, "")
    heard: list[str] = []
    thread = threading.Thread(target=lambda: heard.append(get(server, "news?after=1")[1]))
    thread.start()
    time.sleep(0.1)
    server.tell(page("gold"), "over", [], done=True)
    server.close()
    thread.join()
    assert json.loads(heard[0])["done"]
    with pytest.raises(ConnectionError):
        get(server, "")
    alone, begin = Live(), time.monotonic()
    alone.tell(page("gold"), "over", [], done=True)
    alone.close()
    assert time.monotonic() - begin < 1


@pytest.mark.long
@pytest.mark.usefixtures("small_spheres")
def test_a_watched_fit_tells_its_address_and_serves_its_steps(
    metapp: Callable, ten_materials: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    told: list[tuple[str, bool, int]] = []
    monkeypatch.setattr("metapp.extensions.viewer.watching.EVERY", 0.0)
    tell = Live.tell

    def noted(self: Live, page: Any, text: str, curve: Any, *, done: bool = False) -> None:
        told.append((text, done, len(curve)))
        tell(self, page, text, curve, done=done)

    monkeypatch.setattr(Live, "tell", noted)
    result = metapp("overfit", "brdf", "--steps", "3", "--data", ten_materials, "--watch", "--out", "runs")
    assert result.code == 0
    assert "watch: http://127.0.0.1:" in result.err
    assert told[0] == ("step 0 of 3", False, 0)
    assert told[-2:] == [("after 3 steps", False, 3), ("after 3 steps; the fit is over", True, 3)]
    assert [done for _, done, _ in told].count(True) == 1
    quiet = metapp("overfit", "brdf", "--steps", "3", "--data", ten_materials, "--watch", "--out", "q", "--quiet")
    assert (quiet.out, quiet.err.count("http")) == ("", 1)  # the address alone


def test_the_server_ends_where_a_fit_fails(
    metapp: Callable, ten_materials: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    closed: list[str] = []
    monkeypatch.setattr(Live, "close", lambda self: closed.append(self.address))

    def fail(*_: object) -> None:
        raise FloatingPointError("the fit's parameters are not finite")

    monkeypatch.setattr("metapp.runs.fits.fitter.require_finite", fail)
    result = metapp("overfit", "brdf", "--steps", "2", "--data", ten_materials, "--watch")
    assert result.code == 1
    assert len(closed) == 1
    assert closed[0] in result.err
