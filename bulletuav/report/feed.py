"""HTTP server of a live page: the page itself, and a stream of server-sent events.

The stream is one-way, from the flight to the browsers. Server-sent events need no library beyond
the standard library, and the browsers' `EventSource` reconnects after an interruption.

One thread serves all browsers, so that many viewers cost the simulation little, and no viewer can
block it.
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
"""Limits of connections, whose clients are viewers; the last event is lost after `linger` s"""
MAX_REQUEST = 2**14
"""Maximum length of a request, bytes"""
SEND_BUFFER = 2**16
"""Size of a viewer's send buffer, bytes: small, so that stalled viewers are detected soon"""
KEEPALIVE_INTERVAL = 5.0
"""Time without an event after which a comment is sent to detect closed connections, s"""
UNIQUE_HEADERS = ("Host", "Origin", "Sec-Fetch-Site", "Sec-Fetch-Mode", "Sec-Fetch-Dest")
"""Headers that are checked, and must not be repeated: a proxy might read another one"""
HOST = re.compile(r"(\[[^\[\]@]*\]|[^:\[\]@]*)(:\d*)?", re.ASCII)
"""Pattern of the header `Host`: name and port"""
LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
LOG = logging.getLogger("bulletuav.live")


def event(name: str, data: str = "") -> str:
    """Format an event of the stream; `data` must be a single line."""
    return f"event: {name}\ndata: {data}\n\n"


class RequestError(ValueError):
    """A request that is answered by an error.

    Attributes:
        status: HTTP status of the response.
    """

    def __init__(self, status: HTTPStatus, text: str) -> None:
        super().__init__(text)
        self.status = status


class _Viewer:
    """A browser page that watches.

    Attributes:
        stream: Its connection.
        has_begun: Whether it has received the start of the flight.
    """

    def __init__(self, stream: StreamConnection) -> None:
        self.stream = stream
        self.has_begun = False


class Feed:
    """Serves a page and a stream of events, in its own thread.

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
        """Open the port and start the thread.

        Args:
            host: Address to listen on.
            port: Port; 0 for a free one.
            make_page: Function that returns the page's HTML.
            limits: Limits of connections.
            clock: Function that returns the time for timeouts, s.

        Raises:
            OSError: If the port is in use, or the address does not exist.
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
        # Accepted connections inherit the buffer size
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        self.address = join_address(host, self._socket.getsockname()[1])
        self._names, self._is_on_loopback = _names_of(host), _is_loopback(host)
        self._streams = StreamServer(self._talk, limits, Refusals(LOG, clock), clock)
        # A daemon thread does not delay the exit of the program
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._thread.start()
        self._is_ready.wait()
        LOG.info("live page at http://%s/", self.address)

    @property
    def is_watched(self) -> bool:
        """Whether any page watches."""
        return bool(self._viewers)

    @property
    def connections(self) -> Connections[StreamConnection]:
        """The open connections."""
        return self._streams.connections

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until a page watches; return False after a timeout."""
        return self._came.wait(seconds)

    def send(self, news: str, make_start: Callable[[], str]) -> None:
        """Send an event to all viewers, without waiting for any of them.

        Args:
            news: The event.
            make_start: Function that returns the first event of new viewers, which replaces `news`.
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

    def restart_viewers(self) -> None:
        """Send the start event to all viewers next."""
        for viewer in list(self._viewers):
            viewer.has_begun = False

    def close(self) -> None:
        """Send the final event to all viewers and close the port; a second call does nothing."""
        self._do(self._over.set)
        # The garbage collector may call this method in the thread itself
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _do(self, does: Callable[[], object]) -> None:
        """Call a short function in the thread of the connections, and wait for its return."""
        done = threading.Event()

        def do() -> None:
            does()
            done.set()

        # The event loop is closed after `close`
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(do)
            # The thread does not exist in a forked process
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
        """Read the head of a request.

        Returns:
            The path and the headers.

        Raises:
            RequestError: If it is not a valid or supported request.
        """
        try:
            line, lines = (await stream.reader.readuntil(b"\r\n\r\n")).split(b"\r\n", 1)
            method, path, version = line.decode("ascii").split(" ")
            headers = http.client.parse_headers(io.BytesIO(lines))
        except asyncio.IncompleteReadError as error:
            raise ConnectionError("a browser has gone") from error
        except (asyncio.LimitOverrunError, ValueError, http.client.HTTPException) as error:
            raise RequestError(HTTPStatus.BAD_REQUEST, "not a valid HTTP request") from error
        if repeated := [name for name in UNIQUE_HEADERS if len(headers.get_all(name, [])) > 1]:
            raise RequestError(HTTPStatus.BAD_REQUEST, f"the header {repeated[0]} is repeated")
        LOG.debug('%s "%s %s %s"', stream.peer, method, path, version)
        if not version.startswith("HTTP/1."):
            raise RequestError(HTTPStatus.HTTP_VERSION_NOT_SUPPORTED, "use HTTP/1.1")
        if method != "GET":
            raise RequestError(HTTPStatus.METHOD_NOT_ALLOWED, "only GET is supported")
        return path, headers

    def _check(self, stream: StreamConnection, request: tuple[str, Message]) -> str:
        """Return the path of a request, if the request is allowed.

        Raises:
            RequestError: If the request is for another host, from a page of another site, or for an
                unknown path.
        """
        path, headers = request
        host = headers.get("Host", "")
        if not self.accepts_host(host):
            self._streams.log.log_connection(stream.peer, "refused: request for another host")
            raise RequestError(
                HTTPStatus.FORBIDDEN, f"unknown host: open http://{self.address}/ instead"
            )
        if not _is_of_this_page(host, headers):
            self._streams.log.log_connection(
                stream.peer, "refused: request from a page of another site"
            )
            raise RequestError(HTTPStatus.FORBIDDEN, "pages of other sites are not served")
        if path not in ("/", "/feed"):
            raise RequestError(HTTPStatus.NOT_FOUND, "there is no such page")
        return path

    def accepts_host(self, host: str) -> bool:
        """Return True if requests may use a host, as in the header "Host".

        This prevents DNS rebinding: a page elsewhere could read the stream by a name that resolves
        to this machine. So names must be those of this machine. IP addresses cannot be rebound, but
        on loopback they must be loopback addresses.
        """
        name = _name_in(host)
        return name in self._names or (not self._is_on_loopback and _is_address(name))

    async def _send_events(self, stream: StreamConnection) -> None:
        """Send events until the viewer leaves, or is dropped.

        Raises:
            RequestError: If there are too many viewers.
        """
        try:
            stream.request()
        except FullError as error:
            raise RequestError(HTTPStatus.SERVICE_UNAVAILABLE, f"{error}: try later") from error
        # Events are sent in this thread, too, and so after the head: no viewer misses one after it
        viewer = _Viewer(stream)
        self._viewers.append(viewer)
        stream.send(_head(HTTPStatus.OK, "text/event-stream"))
        self._came.set()
        try:
            while True:
                try:
                    # Pages send no more data, so the read returns when they leave
                    async with asyncio.timeout(KEEPALIVE_INTERVAL):
                        await stream.reader.read(1)
                    return
                except TimeoutError:
                    stream.send(b": nothing new\n\n")
        finally:
            self._viewers.remove(viewer)


def _head(status: HTTPStatus, kind: str, length: int | None = None) -> bytes:
    """Format the head of a response; the connection ends with it."""
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
    """Return False for a request that comes from a page of another site.

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
    """Return the lower-case name in "name:port", without brackets of IPv6; empty if malformed.

    It is empty if the text is not of that form.
    """
    found = HOST.fullmatch(host)
    return found[1].strip("[]").lower() if found else ""


def _names_of(host: str) -> tuple[str, ...]:
    """Return the host names under which a page served at an address may be requested."""
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
    """Return True if an address is reachable from this machine only."""
    return ip_address(host).is_loopback if _is_address(host) else host == "localhost"
