"""Recorded flights as ROS 2 messages: topics, and what makes the messages of each.

Frames are those of REP 103 and REP 105, as in this package: `map` is ENU, and each drone's
`drone_0/base_link` is FLU. Stamps begin with 0 at the start of the flight. Classes of messages come
from whoever writes them.
"""

import functools
import re
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from bulletuav.adapters.flights import Flight, results, rows_flown
from bulletuav.geometry.rotation import to_body

MAP = "map"
"""Name of the world's frame"""
NANOSECONDS = 10**9
"""Nanoseconds in a second"""
UNTOLD = np.zeros(36)
"""Covariance of poses and twists, of which nothing is told"""

Row = Callable[[int], Any]
"""Makes the message of a row of states"""


class Topic(NamedTuple):
    """A topic of a flight.

    Attributes:
        name: Its name, which ROS takes.
        kind: Type of its messages.
        rows: Rows of states that have a message.
        message: Makes the message of a row.
    """

    name: str
    kind: str
    rows: range
    message: Row


def stamps_of(flight: Flight) -> list[int]:
    """Give the stamp of each row of states, ns."""
    return [round(time * NANOSECONDS) for time in flight["time"].tolist()]


def topics_of(flight: Flight, types: Any) -> list[Topic]:
    """List the topics of a flight, in the order in which they are written.

    Args:
        flight: Arrays of the recording, as `Recording.everything()` returns them.
        types: Classes of messages by name, those of rosbags.
    """
    topics = list(_Messages(flight, stamps_of(flight), types).topics())
    names = ros_names(tuple(topic.name for topic in topics))
    return [topic._replace(name=name) for name, topic in zip(names, topics, strict=True)]


@functools.lru_cache(maxsize=1)  # live, each decision has the same
def ros_names(names: tuple[str, ...]) -> list[str]:
    """Make names that ROS takes: letters, digits and underscores, and none of them twice."""
    made: list[str] = []
    for name in names:
        # Slashes part the words of a topic
        words = re.sub(r"[^A-Za-z0-9/]+", "_", name).split("/")
        # A word may not begin with a digit
        text = "".join(f"/_{word}" if word[0].isdigit() else f"/{word}" for word in words if word)
        # Names that became the same are told apart by more underscores
        while text in made:
            text += "_"
        made.append(text)
    return made


class _Messages:
    """Makes the messages of a flight."""

    def __init__(self, flight: Flight, stamps: list[int], types: Any) -> None:
        """Keep the flight, the stamp of each row, ns, and classes of messages by name."""
        self._flight = flight
        self._stamps = stamps
        self._types = types

    def topics(self) -> Iterator[Topic]:
        """List the topics by names that are their own."""
        flight = self._flight
        everywhere = range(len(self._stamps))
        rows = [range(count) for count in rows_flown(flight)]
        imu = flight.get("reading/imu")
        # A decision is judged at its end.
        judged = {
            name: np.concatenate([values[:1], values]) for name, values in results(flight).items()
        }
        yield Topic("time", "std_msgs/msg/Float64", everywhere, self._number(flight["time"]))
        yield Topic("tf", "tf2_msgs/msg/TFMessage", everywhere, self._transforms(rows))
        for i, own in enumerate(rows):
            name = f"drone_{i}"
            yield Topic(f"{name}/odometry", "nav_msgs/msg/Odometry", own, self._odometry(i))
            yield Topic(
                f"{name}/velocity", "geometry_msgs/msg/Vector3Stamped", own, self._velocity(i)
            )
            if flight["goal"].shape[1]:
                yield Topic(f"{name}/goal", "geometry_msgs/msg/PointStamped", own, self._goal(i))
            if imu is not None:
                yield Topic(f"{name}/imu", "sensor_msgs/msg/Imu", own, self._imu(imu[:, i], i))
            for result, values in judged.items():
                row = self._number(values[:, i])
                yield Topic(f"{name}/{result}", "std_msgs/msg/Float64", own[1:], row)

    def _make(self, kind: str, *fields: Any) -> Any:
        """Make a message of its fields, in their order."""
        return self._types[kind](*fields)

    def _header(self, k: int, frame: str) -> Any:
        time = self._make("builtin_interfaces/msg/Time", *divmod(self._stamps[k], NANOSECONDS))
        return self._make("std_msgs/msg/Header", time, frame)

    def _vector(self, values: Iterable[float]) -> Any:
        return self._make("geometry_msgs/msg/Vector3", *values)

    def _point(self, values: Iterable[float]) -> Any:
        return self._make("geometry_msgs/msg/Point", *values)

    def _turn(self, values: Iterable[float]) -> Any:
        """Make a quaternion of x, y, z, w, which is the order of both."""
        return self._make("geometry_msgs/msg/Quaternion", *values)

    def _number(self, values: np.ndarray) -> Row:
        listed = values.tolist()
        return lambda k: self._make("std_msgs/msg/Float64", listed[k])

    def _transforms(self, rows: list[range]) -> Row:
        """Tell where the drones are that fly."""
        position, quaternion = self._flight["position"], self._flight["quaternion"]

        def one(k: int, i: int) -> Any:
            move = self._make(
                "geometry_msgs/msg/Transform",
                self._vector(position[k, i].tolist()),
                self._turn(quaternion[k, i].tolist()),
            )
            header = self._header(k, MAP)
            return self._make("geometry_msgs/msg/TransformStamped", header, _body(i), move)

        def message(k: int) -> Any:
            flying = [one(k, i) for i, own in enumerate(rows) if k in own]
            return self._make("tf2_msgs/msg/TFMessage", flying)

        return message

    def _odometry(self, i: int) -> Row:
        """Tell a drone's state; ROS wants twists in axes of the body."""
        # As lists, whose numbers messages take without a conversion each
        columns = (self._flight[name] for name in ("position", "quaternion", "velocity", "rates"))
        position, quaternion, velocity, rates = (column[:, i].tolist() for column in columns)

        def message(k: int) -> Any:
            pose = self._make(
                "geometry_msgs/msg/Pose", self._point(position[k]), self._turn(quaternion[k])
            )
            # Recordings have velocities in the world and rates in the body already
            linear = to_body(tuple(quaternion[k]), tuple(velocity[k]))
            twist = self._make(
                "geometry_msgs/msg/Twist", self._vector(linear), self._vector(rates[k])
            )
            return self._make(
                "nav_msgs/msg/Odometry",
                self._header(k, MAP),
                _body(i),
                self._make("geometry_msgs/msg/PoseWithCovariance", pose, UNTOLD),
                self._make("geometry_msgs/msg/TwistWithCovariance", twist, UNTOLD),
            )

        return message

    def _velocity(self, i: int) -> Row:
        values = self._flight["velocity"][:, i].tolist()
        return lambda k: self._make(
            "geometry_msgs/msg/Vector3Stamped", self._header(k, MAP), self._vector(values[k])
        )

    def _goal(self, i: int) -> Row:
        values = self._flight["goal"][:, i].tolist()
        return lambda k: self._make(
            "geometry_msgs/msg/PointStamped", self._header(k, MAP), self._point(values[k])
        )

    def _imu(self, reading: np.ndarray, i: int) -> Row:
        """Tell specific forces and angular velocities; an attitude is not measured."""
        force, rates = reading[:, :3].tolist(), reading[:, 3:6].tolist()
        untold = np.zeros(9)
        none = np.array([-1.0, *untold[1:]])  # how ROS says that there is no attitude
        still = self._turn((0.0, 0.0, 0.0, 1.0))
        return lambda k: self._make(
            "sensor_msgs/msg/Imu",
            self._header(k, _body(i)),
            *(still, none),
            *(self._vector(rates[k]), untold),
            *(self._vector(force[k]), untold),
        )


def _body(i: int) -> str:
    """Name the frame of a drone's body."""
    return f"drone_{i}/base_link"
