"""Server of a live page: the page itself, and what happens as server-sent events.

The feed goes one way, from the flight to browsers. Server-sent events do that with Python's own
HTTP server and browsers' own `EventSource`, which also connects again after an interruption.
"""

import logging
import queue
import socket
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from ipaddress import ip_address
from typing import Any

from bulletuav.envs.viewer import join_address

MOST_VIEWERS = 64
MOST_WAITING = 64
"""Events that a viewer leaves unread until it is let go; its page connects anew"""
SILENCE = 5.0
"""s without an event after which a viewer is written to, to find out whether it is still there"""
PATIENCE = 10.0
"""s that a viewer may take for one event"""
FAREWELL = 1.0
"""s that viewers have to read the last event"""
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
LOG = logging.getLogger("bulletuav.live")


def event(name: str, data: str = "") -> str:
    """Write an event; `data` is one line."""
    return f"event: {name}\ndata: {data}\n\n"


class _Viewer:
    """Somebody who watches.

    Attributes:
        events: Texts to send; None ends the stream.
        has_begun: Whether it was told what there is.
        is_let_go: Whether it has left too much unread.
        gone: Set when its thread has ended.
    """

    def __init__(self) -> None:
        self.events: queue.Queue[str | None] = queue.Queue(MOST_WAITING)
        self.has_begun = False
        self.is_let_go = False
        self.gone = threading.Event()


class Feed:
    """Serves a page and a stream of events, in threads of its own.

    Attributes:
        address: host:port that browsers open.
    """

    def __init__(
        self,
        host: str,
        port: int,
        make_page: Callable[[], str],
    ) -> None:
        """Open the port.

        Args:
            host: Address to listen at.
            port: Port; 0 for a free one.
            make_page: Function that gives the page's HTML.

        Raises:
            OSError: The port is in use, or there is no such address.
        """
        self._lock = threading.Lock()
        self._viewers: list[_Viewer] = []
        self._came = threading.Event()
        self.make_page = make_page
        try:
            self._server = _Server((host, port), self)
        except OSError as error:
            raise OSError(
                f"cannot serve the live page at {host}, port {port}: {error.strerror or error}; "
                f"if another live page is there, choose another port"
            ) from error
        self.address = join_address(host, self._server.server_address[1])
        # Names by which a browser may ask for a page of this machine
        self._names = (*LOOPBACK_NAMES, host) if _is_loopback(host) else ()
        # A daemon, so that a program that ends is not held up
        threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True).start()
        LOG.info("live page at http://%s/", self.address)

    @property
    def is_watched(self) -> bool:
        """Whether somebody watches."""
        return bool(self._viewers)

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until somebody watches, and tell whether somebody did in time."""
        return self._came.wait(seconds)

    def send(self, news: str, make_start: Callable[[], str]) -> None:
        """Send an event to all viewers, without waiting for any.

        Args:
            news: The event.
            make_start: Function that gives the event with which new viewers begin instead.
        """
        with self._lock:
            viewers = list(self._viewers)
        start = "" if all(viewer.has_begun for viewer in viewers) else make_start()
        for viewer in viewers:
            text = news if viewer.has_begun else start
            viewer.has_begun = True
            try:
                viewer.events.put_nowait(text)
            except queue.Full:
                viewer.is_let_go = True
                self.leave(viewer)

    def begin_anew(self) -> None:
        """Let all viewers begin with the start again."""
        with self._lock:
            for viewer in self._viewers:
                viewer.has_begun = False

    def join(self) -> _Viewer | None:
        """Take in a viewer; None where there are too many."""
        viewer = _Viewer()
        with self._lock:
            if len(self._viewers) >= MOST_VIEWERS:
                return None
            self._viewers.append(viewer)
        self._came.set()
        return viewer

    def leave(self, viewer: _Viewer) -> None:
        """Let a viewer go."""
        with self._lock:
            if viewer in self._viewers:
                self._viewers.remove(viewer)

    def knows(self, name: str) -> bool:
        """Tell whether a page may ask for this host.

        Names that others make point here are refused on loopback: pages elsewhere could read along.
        """
        return not self._names or name in self._names

    def close(self) -> None:
        """Tell viewers that it is over, and close the port; a second call does nothing."""
        with self._lock:
            viewers, self._viewers = self._viewers, []
        for viewer in viewers:
            try:
                viewer.events.put_nowait(event("over"))
                viewer.events.put_nowait(None)
            except queue.Full:
                continue
        for viewer in viewers:
            viewer.gone.wait(FAREWELL)
        self._server.shutdown()
        self._server.server_close()


def _is_loopback(host: str) -> bool:
    """Tell whether only this machine reaches an address."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class _Server(ThreadingHTTPServer):
    """The HTTP server of a feed."""

    daemon_threads = True

    def __init__(self, address: tuple[str, int], feed: Feed) -> None:
        self.feed = feed
        if ":" in address[0]:
            self.address_family = socket.AF_INET6
        super().__init__(address, _Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Note what went wrong with a viewer, such as one that left."""
        LOG.debug("a viewer has left", exc_info=True)


class _Handler(BaseHTTPRequestHandler):
    """Answers one request of a browser."""

    server: _Server
    timeout = PATIENCE

    def do_GET(self) -> None:
        """Send the page, or the stream."""
        host = self.headers.get("Host", "").rsplit(":", 1)[0].strip("[]")
        if not self.server.feed.knows(host):
            self.send_error(403, "unknown host")
        elif self.path == "/":
            self._send_page()
        elif self.path == "/feed":
            self._send_events()
        else:
            self.send_error(404)

    def _begin(self, kind: str) -> None:
        """Write the head of an answer."""
        self.send_response(200)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()

    def _send_page(self) -> None:
        """Send the page."""
        page = self.server.feed.make_page().encode()
        self._begin("text/html")
        self.wfile.write(page)

    def _send_events(self) -> None:
        """Send events until the viewer leaves, or is let go."""
        feed = self.server.feed
        viewer = feed.join()
        if viewer is None:
            self.send_error(503, "too many viewers")
            return
        try:
            self._begin("text/event-stream")
            while not viewer.is_let_go and (text := self._next(viewer)) is not None:
                self.wfile.write(text.encode())
        finally:
            feed.leave(viewer)
            viewer.gone.set()

    @staticmethod
    def _next(viewer: _Viewer) -> str | None:
        """Take the next text for a viewer; None at the end."""
        try:
            return viewer.events.get(timeout=SILENCE)
        except queue.Empty:
            return ": nothing new\n\n"

    def log_message(self, format: str, *args: Any) -> None:
        """Note a request."""
        LOG.debug(format, *args)
