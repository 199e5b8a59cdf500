"""Server of a live page: the page itself, and what happens as server-sent events.

The feed goes one way, from the flight to browsers. Server-sent events do that without a library
beyond Python's own, and browsers' `EventSource` connects again after an interruption.

One thread serves all browsers, so that many viewers cost a flight little, and none can block it.
"""

import asyncio
import contextlib
import http.client
import io
import logging
import re
import socket
import threading
import time
from collections.abc import Callable
from email.message import Message
from http import HTTPStatus
from ipaddress import ip_address

from bulletuav.envs.viewer import join_address
from bulletuav.serving.connections import Clock, ConnectionLimits, Connections, FullError
from bulletuav.serving.refusals import Refusals
from bulletuav.serving.streams import StreamConnection, StreamServer

LIMITS = ConnectionLimits(
    max_clients=64, max_pending=32, grace=10.0, max_unread=2**23, max_stall=10.0, linger=1.0
)
"""Limits of connections: clients are pages that watch. After `linger` the last event is lost."""
MAX_REQUEST = 2**14
"""Longest request, bytes"""
SEND_BUFFER = 2**16
"""Bytes for a viewer that the system keeps, so that unread ones are noticed soon"""
SILENCE = 5.0
"""s without an event after which a viewer is written to, to find out whether it is still there"""
SINGLE = ("Host", "Origin", "Sec-Fetch-Site", "Sec-Fetch-Mode", "Sec-Fetch-Dest")
"""Headers that are checked: one that is there twice could mean another thing to a proxy"""
HOST = re.compile(r"(\[[^\[\]@]*\]|[^:\[\]@]*)(:\d*)?", re.ASCII)
"""Form of the header `Host`: name and port"""
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
LOG = logging.getLogger("bulletuav.live")


def event(name: str, data: str = "") -> str:
    """Write an event; `data` is one line."""
    return f"event: {name}\ndata: {data}\n\n"


class RequestError(ValueError):
    """A request that is answered by an error.

    Attributes:
        status: HTTP status of the answer.
    """

    def __init__(self, status: HTTPStatus, text: str) -> None:
        super().__init__(text)
        self.status = status


class _Viewer:
    """A page that watches.

    Attributes:
        stream: Its connection.
        has_begun: Whether it was sent the whole flight so far.
    """

    def __init__(self, stream: StreamConnection) -> None:
        self.stream = stream
        self.has_begun = False


class Feed:
    """Serves a page and a stream of events, in a thread of its own.

    Attributes:
        address: host:port that browsers open.
    """

    def __init__(
        self,
        host: str,
        port: int,
        make_page: Callable[[], str],
        limits: ConnectionLimits = LIMITS,
        clock: Clock = time.monotonic,
    ) -> None:
        """Open the port.

        Args:
            host: Address to listen at.
            port: Port; 0 for a free one.
            make_page: Function that gives the page's HTML.
            limits: Limits of connections.
            clock: Function that returns the time by which connections are idle, s.

        Raises:
            OSError: The port is in use, or there is no such address.
        """
        self._viewers: list[_Viewer] = []
        self._came, self._is_ready = threading.Event(), threading.Event()
        self.make_page = make_page
        try:
            family = socket.AF_INET6 if ":" in host else socket.AF_INET
            self._socket = socket.create_server((host, port), family=family)
        except OSError as error:
            raise OSError(
                f"cannot serve the live page at {host}, port {port}: {error.strerror or error}; "
                f"if another live page is there, choose another port"
            ) from error
        # Accepted connections inherit it
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        self.address = join_address(host, self._socket.getsockname()[1])
        self._names, self._is_on_loopback = _names_of(host), _is_loopback(host)
        self._streams = StreamServer(self._talk, limits, Refusals(LOG, clock), clock)
        # A daemon, so that a program that ends is not held up
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._thread.start()
        self._is_ready.wait()
        LOG.info("live page at http://%s/", self.address)

    @property
    def is_watched(self) -> bool:
        """Whether a page watches."""
        return bool(self._viewers)

    @property
    def connections(self) -> Connections[StreamConnection]:
        """The connections that there are."""
        return self._streams.connections

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until a page watches, and return whether one did in time."""
        return self._came.wait(seconds)

    def send(self, news: str, make_start: Callable[[], str]) -> None:
        """Send an event to all viewers, without waiting for any.

        Args:
            news: The event.
            make_start: Function that gives the event with which new viewers begin instead.
        """
        viewers = list(self._viewers)
        start = "" if all(viewer.has_begun for viewer in viewers) else make_start()
        begun, new = news.encode(), start.encode()
        texts = [(viewer.stream, begun if viewer.has_begun else new) for viewer in viewers]
        for viewer in viewers:
            viewer.has_begun = True

        def send() -> None:
            for stream, text in texts:
                stream.send(text)

        self._do(send)

    def begin_anew(self) -> None:
        """Let all viewers begin with the start again."""
        for viewer in list(self._viewers):
            viewer.has_begun = False

    def close(self) -> None:
        """Send viewers that it is over, and close the port; a second call does nothing."""
        self._do(self._over.set)
        # Python's garbage collection may call it in the thread itself
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _do(self, does: Callable[[], object]) -> None:
        """Do something in the thread of the connections, which is never long; wait for it."""
        done = threading.Event()

        def do() -> None:
            does()
            done.set()

        # The loop is closed once the feed is
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(do)
            # In a process that was forked the thread is not there
            while self._thread.is_alive() and threading.current_thread() is not self._thread:
                if done.wait(0.1):
                    return

    async def _serve(self) -> None:
        """Serve until the feed is closed."""
        self._loop, self._over = asyncio.get_running_loop(), asyncio.Event()
        await self._streams.start(self._socket, MAX_REQUEST)
        self._is_ready.set()
        await self._over.wait()
        for viewer in self._viewers:
            viewer.stream.send(event("over").encode())
        await self._streams.stop()

    async def _talk(self, stream: StreamConnection) -> None:
        """Answer one request of a browser."""
        try:
            path = self._check(stream, await self._read_request(stream))
            if path == "/feed":
                await self._send_events(stream)
            else:
                page = self.make_page().encode()
                stream.send(_head(HTTPStatus.OK, "text/html", len(page)) + page)
        except RequestError as error:
            text = f"{error}\n".encode()
            stream.send(_head(error.status, "text/plain", len(text)) + text)

    @staticmethod
    async def _read_request(stream: StreamConnection) -> tuple[str, Message]:
        """Read the first lines of a request: return its path and its headers.

        Raises:
            RequestError: It is none, or none that is answered.
        """
        try:
            line, lines = (await stream.reader.readuntil(b"\r\n\r\n")).split(b"\r\n", 1)
            method, path, version = line.decode("ascii").split(" ")
            headers = http.client.parse_headers(io.BytesIO(lines))
        except asyncio.IncompleteReadError as error:
            raise ConnectionError("a browser has gone") from error
        except (asyncio.LimitOverrunError, ValueError, http.client.HTTPException) as error:
            raise RequestError(HTTPStatus.BAD_REQUEST, "this is no request of HTTP") from error
        if repeated := [name for name in SINGLE if len(headers.get_all(name, [])) > 1]:
            raise RequestError(HTTPStatus.BAD_REQUEST, f"the header {repeated[0]} is there twice")
        LOG.debug('%s "%s %s %s"', stream.peer, method, path, version)
        if not version.startswith("HTTP/1."):
            raise RequestError(HTTPStatus.HTTP_VERSION_NOT_SUPPORTED, "use HTTP/1.1")
        if method != "GET":
            raise RequestError(HTTPStatus.METHOD_NOT_ALLOWED, "pages can be read, and that is all")
        return path, headers

    def _check(self, stream: StreamConnection, request: tuple[str, Message]) -> str:
        """Return the path of a request that may be answered.

        Raises:
            RequestError: It is for another host, from a page of another one, or for another path.
        """
        path, headers = request
        host = headers.get("Host", "")
        if not self.knows(host):
            self._streams.log.log_connection(stream.peer, "refused: it asked for another host")
            raise RequestError(
                HTTPStatus.FORBIDDEN, f"unknown host: open http://{self.address}/ instead"
            )
        if not _is_of_this_page(host, headers):
            self._streams.log.log_connection(stream.peer, "refused: it is a page of another site")
            raise RequestError(HTTPStatus.FORBIDDEN, "pages of other sites are not served")
        if path not in ("/", "/feed"):
            raise RequestError(HTTPStatus.NOT_FOUND, "there is no such page")
        return path

    def knows(self, host: str) -> bool:
        """Return True if a page may ask for a host, as in the header "Host".

        Pages elsewhere could read along by a name that they make point here. So names have to be
        those of this machine. Addresses cannot be made to point here; on loopback they have to be
        its own all the same.
        """
        name = _name_in(host)
        return name in self._names or (not self._is_on_loopback and _is_address(name))

    async def _send_events(self, stream: StreamConnection) -> None:
        """Send events until the viewer leaves, or is dropped.

        Raises:
            RequestError: There are too many viewers.
        """
        try:
            stream.request()
        except FullError as error:
            raise RequestError(HTTPStatus.SERVICE_UNAVAILABLE, f"{error}: try later") from error
        # Events come after the head, as they are sent in this thread, too: a page that has the head
        # misses none
        viewer = _Viewer(stream)
        self._viewers.append(viewer)
        stream.send(_head(HTTPStatus.OK, "text/event-stream"))
        self._came.set()
        try:
            while True:
                try:
                    # Pages send nothing more: this ends when they leave
                    async with asyncio.timeout(SILENCE):
                        await stream.reader.read(1)
                    return
                except TimeoutError:
                    stream.send(b": nothing new\n\n")
        finally:
            self._viewers.remove(viewer)


def _head(status: HTTPStatus, kind: str, length: int | None = None) -> bytes:
    """Write the head of an answer; its connection ends with it."""
    lines = [
        f"HTTP/1.1 {status.value} {status.phrase}",
        f"Content-Type: {kind}; charset=utf-8",
        "Cache-Control: no-store",
        "X-Content-Type-Options: nosniff",
        "Cross-Origin-Resource-Policy: same-origin",
        "Content-Security-Policy: frame-ancestors 'self'",
        "Connection: close",
    ]
    lines += [] if length is None else [f"Content-Length: {length}"]
    return "\r\n".join([*lines, "\r\n"]).encode()


def _is_of_this_page(host: str, headers: Message) -> bool:
    """Return True unless a request comes from a page of another site.

    Browsers send "Origin" with `EventSource`, and "Sec-Fetch-Site" with all requests. Links on
    other sites may lead here.
    """
    origin = headers.get("Origin")
    if origin is not None and origin.lower() != f"http://{host.lower()}":
        return False
    site, mode = headers.get("Sec-Fetch-Site", "none"), headers.get("Sec-Fetch-Mode", "")
    is_link = mode == "navigate" and headers.get("Sec-Fetch-Dest", "document") == "document"
    return site in ("same-origin", "none") or is_link


def _name_in(host: str) -> str:
    """Return the name in "name:port", in lower case; an IPv6 address without brackets.

    It is empty if the text is not of that form.
    """
    found = HOST.fullmatch(host)
    return found[1].strip("[]").lower() if found else ""


def _names_of(host: str) -> tuple[str, ...]:
    """Return the names by which browsers may ask for a page that is served at an address."""
    if _is_loopback(host):
        return (*LOOPBACK_NAMES, host.lower())
    own = socket.gethostname().lower()
    return (*LOOPBACK_NAMES, host.lower(), own, f"{own}.local", socket.getfqdn().lower())


def _is_address(name: str) -> bool:
    """Return True for an IP address."""
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


def _is_loopback(host: str) -> bool:
    """Return True if only this machine reaches an address."""
    return ip_address(host).is_loopback if _is_address(host) else host == "localhost"
