"""Live streaming of a flight to Foxglove as ROS 2 messages.

It needs the extra `foxglove`, but no ROS installation.

Topics and messages are those of the MCAP export. Messages of topics without subscribers are not
made.
"""

import logging
import re
import threading
import time
from typing import Any

from bulletuav.adapters.flights import FlightArrays
from bulletuav.adapters.ros import stamps_of, topics_of
from bulletuav.envs.viewer import join_address
from bulletuav.errors import missing_extra
from bulletuav.serving.refusals import LineLimit

try:
    from foxglove import Channel, Context, Schema, start_server
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    raise missing_extra("showing flights in Foxglove", "foxglove") from None

LOGGERS = ("server", "connected_client", "connected_client.poller")
"""Loggers below `foxglove.websocket` that report each invalid message of a client"""
for _name in LOGGERS:
    logging.getLogger(f"foxglove.websocket.{_name}").addFilter(LineLimit())
NAME = "bulletuav"
"""Name of the server"""
FIRST_TOPICS = (("/time", "std_msgs/msg/Float64"), ("/tf", "tf2_msgs/msg/TFMessage"))
"""Topics that every flight has, advertised before it begins"""
CLOSE_TIMEOUT = 1.0
"""Maximum time to wait on closing, s, so that viewers receive the end of the flight: Foxglove's
library drops queued messages when its server stops, and does not report the length of its queue"""
POLL_PERIOD = 0.02
"""Period of the checks whether viewers are still connected, s"""


class FoxgloveServer:
    """Server of topics by Foxglove's websocket protocol, which runs in its own threads.

    Attributes:
        address: Address that viewers connect to.
    """

    def __init__(self, host: str, port: int) -> None:
        """Open the port and advertise the first topics.

        Args:
            host: Address to listen at.
            port: Port; 0 for a free one.

        Raises:
            OSError: If the port is in use, or the address does not exist.
        """
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._context = Context()
        self._channels: dict[str, Channel] = {}
        self._subscribed = threading.Event()
        self._is_closed = False
        try:
            self._server = start_server(
                name=NAME, host=host, port=port, server_listener=self, context=self._context
            )
        except RuntimeError as error:
            reason = re.sub(r".*: (?=\w)| \(os error.*", "", str(error))
            raise OSError(
                f"cannot serve Foxglove at {host}, port {port}: {reason}; "
                f"if another live view is running, choose another port"
            ) from error
        self.address = f"ws://{join_address(host, self._server.port)}"
        for name, kind in FIRST_TOPICS:
            self._channel(name, kind)

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Record that a viewer has subscribed; a callback of Foxglove's library."""
        self._subscribed.set()

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """Do nothing: each channel knows its subscribers."""

    @property
    def is_watched(self) -> bool:
        """True if any viewer is subscribed to a topic."""
        return any(channel.has_sinks() for channel in self._channels.values())

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until a viewer subscribes to a topic; return False after a timeout."""
        return self._subscribed.wait(seconds)

    def restart_viewers(self) -> None:
        """Start a new session: viewers discard the previous flight."""
        self._server.clear_session()

    def send(self, flight: FlightArrays) -> None:
        """Send the last state of a flight, and the first one at the start of the flight.

        Args:
            flight: Arrays of two consecutive states and the decision between them.
        """
        stamps = stamps_of(flight)
        for topic in topics_of(flight, self._store.types):
            channel = self._channel(topic.name, topic.kind)
            if not channel.has_sinks():
                continue
            for k in range(1 if stamps[0] else 0, len(stamps)):
                if k in topic.rows:
                    data = self._store.serialize_cdr(topic.message(k), topic.kind)
                    channel.log(bytes(data), log_time=stamps[k])

    def _channel(self, name: str, kind: str) -> Channel:
        """Return the channel of a topic; a new channel is advertised to viewers."""
        if name not in self._channels:
            text, _ = self._store.generate_msgdef(kind, ros_version=2)
            schema = Schema(name=kind, encoding="ros2msg", data=text.encode())
            self._channels[name] = Channel(
                name, schema=schema, message_encoding="cdr", context=self._context
            )
        return self._channels[name]

    def close(self) -> None:
        """Close the port; before, wait up to `CLOSE_TIMEOUT` for viewers to receive the rest.

        Further calls do nothing.
        """
        end = time.monotonic() + CLOSE_TIMEOUT
        while not self._is_closed and self.is_watched and time.monotonic() < end:
            time.sleep(POLL_PERIOD)
        self._is_closed = True
        self._server.stop()
