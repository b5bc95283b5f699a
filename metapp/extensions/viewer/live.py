"""The page of a fit that runs, on this machine alone: it asks for what has changed until the fit is over."""

from __future__ import annotations

import hmac
import io
import json
import secrets
import socket
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import parse_qs

from metapp.extensions.viewer.page import html
from metapp.storage import Document
from metapp.storage.html import element, page

HOST = "127.0.0.1"
NEWS = "news"
WAIT_SECONDS = 10.0  # that a question for news waits for some
LAST_SECONDS = 2.0  # that the end waits for pages that have not heard of it
CONNECTIONS = 16  # at a time; more are closed
REQUEST_BYTES, REQUEST_SECONDS = 8192, 5.0  # of a request, all of it
LONGEST_SERIAL = 18  # digits
# a page that asks again at once, and is not answered before there is something to show or WAIT_SECONDS are over
EARLY = page(
    "metapp",
    "",
    element("p", "The fit has not begun yet; this page shows it once it has."),
    element("script", "location.reload()"),
)


class Live:
    """Serves one page at an address that nobody else knows; any other address is not found.

    Attributes:
        address: of the page, with a random token.
    """

    def __init__(self) -> None:
        self._token, self._changed = secrets.token_urlsafe(16), threading.Condition()
        self._news: Document | None = None
        self._document: Document = {}
        self._serial, self._heard, self._pages = 0, 0, 0
        live = self

        class Handler(_Handler):
            def answer(self) -> tuple[str, str] | None:
                """Content and its type, of this server."""
                return live.answer(self.path)

        self._server = _Server((HOST, 0), Handler)
        Handler.host = f"{HOST}:{self._server.server_port}"
        self.address = f"http://{Handler.host}/{self._token}/"
        threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True).start()

    def tell(self, document: Document, text: str, curve: list[tuple[int, float]], *, done: bool = False) -> None:
        """Give pages something new.

        Args:
            document: as of `metapp.extensions.viewer.page.document`, with one group.
            text: where the fit is.
            curve: steps and the visible loss before each.
            done: whether it is the last.
        """
        with self._changed:
            self._serial += 1
            self._document = document
            group = document["groups"][0]
            self._news = {"serial": self._serial, "text": text, "curve": curve, "done": done, "group": group}
            self._changed.notify_all()

    def close(self) -> None:
        """End the server, once pages that were opened have heard of the last news."""
        end = time.monotonic() + LAST_SECONDS
        with self._changed:
            while self._pages and self._heard < self._serial and time.monotonic() < end:
                self._changed.wait(0.1)
        self._server.shutdown()
        self._server.server_close()

    def answer(self, path: str) -> tuple[str, str] | None:
        """The content and its type for a path; None where there is nothing."""
        where, _, query = path.partition("?")
        token, _, rest = where.lstrip("/").partition("/")
        if not hmac.compare_digest(token.encode(), self._token.encode()) or rest not in ("", NEWS):
            return None
        if rest == NEWS:
            after = parse_qs(query).get("after", ["0"])[0][:LONGEST_SERIAL]
            news = self._after(int(after) if after.isascii() and after.isdecimal() else 0)
            return json.dumps(news), "application/json"
        self._after(0)  # a page shows something
        with self._changed:
            if self._news is None:
                return EARLY, "text/html; charset=utf-8"
            self._pages += 1
            return html(self._document, NEWS), "text/html; charset=utf-8"

    def _after(self, serial: int) -> Document:
        """The news after a serial number; after a while without any where things are."""
        with self._changed:
            self._changed.wait_for(lambda: self._serial > serial, WAIT_SECONDS)
            news = self._news or {"serial": 0, "text": "", "curve": [], "done": False}
            if news["serial"] <= serial:
                return {"serial": serial, "text": news["text"], "curve": news["curve"], "done": news["done"]}
            self._heard = max(self._heard, news["serial"])
            self._changed.notify_all()
            return news


_Request = socket.socket | tuple[bytes, socket.socket]


class _Server(ThreadingHTTPServer):
    """A server of few connections at a time, whatever of which leaves the fit alone."""

    daemon_threads = True

    def __init__(self, address: tuple[str, int], handler: type[_Handler]) -> None:
        self._free = threading.BoundedSemaphore(CONNECTIONS)
        super().__init__(address, handler)

    def process_request(self, request: _Request, client_address: object) -> None:
        """Answer in a thread of its own, or close it where there are too many."""
        if not self._free.acquire(blocking=False):
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except BaseException:
            self._free.release()
            raise

    def process_request_thread(self, request: _Request, client_address: object) -> None:
        """Answer one."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: _Request, client_address: object) -> None:
        """Print nothing: the terminal is the fit's."""


def _request_of(connection: socket.socket) -> bytes:
    """The head of a request; b"" where it takes too many bytes or too long."""
    end, head = time.monotonic() + REQUEST_SECONDS, b""
    while b"\r\n\r\n" not in head:
        connection.settimeout(max(end - time.monotonic(), 1e-3))
        more = connection.recv(REQUEST_BYTES)
        head += more
        if not more or len(head) > REQUEST_BYTES or time.monotonic() > end:
            return b""
    return head


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.0"
    host: str

    def setup(self) -> None:
        """Read the request at once, so that its bytes and seconds have an end."""
        super().setup()
        self.rfile = io.BytesIO(_request_of(self.connection))
        self.connection.settimeout(REQUEST_SECONDS)

    def answer(self) -> tuple[str, str] | None:
        """Content and its type."""
        raise NotImplementedError

    def do_GET(self) -> None:
        """Answer, if this machine's browser asks: other names of it may be of other people's pages."""
        answer = self.answer() if self.headers.get("Host") == self.host else None
        content, kind = answer or ("", "text/plain")
        body = content.encode(errors="backslashreplace")
        self.send_response(200 if answer else 404)
        headers = {"Content-Type": kind, "Content-Length": str(len(body)), "Cache-Control": "no-store"}
        headers |= {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""

    def handle(self) -> None:
        """Let a browser go away in the middle."""
        try:
            super().handle()
        except (ConnectionError, TimeoutError):
            self.close_connection = True
