"""A flight as live ROS 2 messages for Foxglove; needs the extra `foxglove`, but no ROS.

Topics and messages are those of MCAP files. What nobody has subscribed to is not made.
"""

import logging
import re
import threading
import time
from typing import Any

from bulletuav.adapters.flights import Flight
from bulletuav.adapters.ros import stamps_of, topics_of
from bulletuav.envs.refusals import LineLimit
from bulletuav.envs.viewer import join_address
from bulletuav.errors import missing

try:
    from foxglove import Channel, Context, Schema, start_server
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    raise missing("showing flights in Foxglove", "foxglove") from None

LOGGERS = ("server", "connected_client", "connected_client.poller")
"""Below `foxglove.websocket`: where Foxglove's library logs each odd message of a client"""
for _name in LOGGERS:
    logging.getLogger(f"foxglove.websocket.{_name}").addFilter(LineLimit())
NAME = "bulletuav"
"""Name of the server"""
FIRST = (("/time", "std_msgs/msg/Float64"), ("/tf", "tf2_msgs/msg/TFMessage"))
"""Topics that every flight has: there before it begins"""
LINGER = 1.0
"""Time that viewers have to be sent the end of a flight, s: Foxglove's library drops what is queued
when its server stops, and does not report what is"""
LOOK_PERIOD = 0.02
"""Time between two looks whether viewers are still there, s"""


class FoxgloveServer:
    """Serves topics by Foxglove's websocket protocol, in threads of its own.

    Attributes:
        address: Address that viewers connect to.
    """

    def __init__(self, host: str, port: int) -> None:
        """Open the port.

        Args:
            host: Address to listen at.
            port: Port; 0 for a free one.

        Raises:
            OSError: The port is in use, or there is no such address.
        """
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._context = Context()
        self._channels: dict[str, Channel] = {}
        self._came = threading.Event()
        self._is_closed = False
        try:
            self._server = start_server(
                name=NAME, host=host, port=port, server_listener=self, context=self._context
            )
        except RuntimeError as error:
            reason = re.sub(r".*: (?=\w)| \(os error.*", "", str(error))
            raise OSError(
                f"cannot serve Foxglove at {host}, port {port}: {reason}; "
                f"if another live view is there, choose another port"
            ) from error
        self.address = f"ws://{join_address(host, self._server.port)}"
        for name, kind in FIRST:
            self._channel(name, kind)

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Take in that a viewer wants to see a topic; Foxglove's library calls this."""
        self._came.set()

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """Do nothing: channels tell themselves whether they are watched."""

    @property
    def is_watched(self) -> bool:
        """Whether some viewer is subscribed to a topic."""
        return any(channel.has_sinks() for channel in self._channels.values())

    def wait(self, seconds: float | None = None) -> bool:
        """Wait until some viewer subscribes to a topic, and tell whether one did in time."""
        return self._came.wait(seconds)

    def restart_viewers(self) -> None:
        """Let viewers forget the flight before."""
        self._server.clear_session()

    def send(self, flight: Flight) -> None:
        """Send the last state of a flight, and the first one if the flight begins with it.

        Args:
            flight: Arrays of two states and the decision between them.
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
        """Return the channel of a topic, which is told to viewers when it is new."""
        if name not in self._channels:
            text, _ = self._store.generate_msgdef(kind, ros_version=2)
            schema = Schema(name=kind, encoding="ros2msg", data=text.encode())
            self._channels[name] = Channel(
                name, schema=schema, message_encoding="cdr", context=self._context
            )
        return self._channels[name]

    def close(self) -> None:
        """Close the port, once viewers have left or had time to get the end of the flight.

        A second call does nothing.
        """
        end = time.monotonic() + LINGER
        while not self._is_closed and self.is_watched and time.monotonic() < end:
            time.sleep(LOOK_PERIOD)
        self._is_closed = True
        self._server.stop()
