"""Conversion of recorded flights to ROS 2 topics and messages.

Frames follow REP 103 and REP 105, as in this package: `map` is ENU, and `drone_0/base_link` of each
drone is FLU. Time stamps begin with 0 at the start of the flight. The caller provides the message
classes.
"""

import functools
import re
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from bulletuav.adapters.flights import FlightArrays, count_flown_rows, decision_results
from bulletuav.geometry.rotation import to_body

MAP = "map"
"""Name of the world frame"""
NANOSECONDS = 10**9
"""Nanoseconds in a second"""
ZERO_COVARIANCE = np.zeros(36)
"""Covariance of poses and twists, all zero: unknown"""

Row = Callable[[int], Any]
"""Function that makes the message of a state row"""


class Topic(NamedTuple):
    """A topic of a flight.

    Attributes:
        name: Valid ROS name of the topic.
        kind: Message type.
        rows: State rows that have a message.
        message: Function that makes the message of a row.
    """

    name: str
    kind: str
    rows: range
    message: Row


def stamps_of(flight: FlightArrays) -> list[int]:
    """Return the time stamp of each state row, ns."""
    return [round(time * NANOSECONDS) for time in flight["time"].tolist()]


def topics_of(flight: FlightArrays, types: Any) -> list[Topic]:
    """Return the topics of a flight, in the order in which they are written.

    Args:
        flight: Arrays of the recording, as `Recording.everything()` returns them.
        types: Message classes of rosbags by name.
    """
    topics = list(_Messages(flight, stamps_of(flight), types).topics())
    names = ros_names(tuple(topic.name for topic in topics))
    return [topic._replace(name=name) for name, topic in zip(names, topics, strict=True)]


@functools.lru_cache(maxsize=1)  # in a live view, all decisions have the same topics
def ros_names(names: tuple[str, ...]) -> list[str]:
    """Convert names to unique valid ROS names of letters, digits and underscores."""
    made: list[str] = []
    for name in names:
        # Slashes separate the tokens of a topic name
        words = re.sub(r"[^A-Za-z0-9/]+", "_", name).split("/")
        # A token must not begin with a digit
        text = "".join(f"/_{word}" if word[0].isdigit() else f"/{word}" for word in words if word)
        # Duplicates get further underscores
        while text in made:
            text += "_"
        made.append(text)
    return made


class _Messages:
    """Factory of the messages of a flight."""

    def __init__(self, flight: FlightArrays, stamps: list[int], types: Any) -> None:
        """Set the flight, the time stamp of each row (ns), and message classes by name."""
        self._flight = flight
        self._stamps = stamps
        self._types = types

    def topics(self) -> Iterator[Topic]:
        """Yield the topics, with names that may be invalid in ROS."""
        flight = self._flight
        everywhere = range(len(self._stamps))
        rows = [range(count) for count in count_flown_rows(flight)]
        imu = flight.get("reading/imu")
        # Results of a decision are stamped at its end
        stamped_results = {
            name: np.concatenate([values[:1], values])
            for name, values in decision_results(flight).items()
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
            for result, values in stamped_results.items():
                row = self._number(values[:, i])
                yield Topic(f"{name}/{result}", "std_msgs/msg/Float64", own[1:], row)

    def _make(self, kind: str, *fields: Any) -> Any:
        """Make a message from its fields in order."""
        return self._types[kind](*fields)

    def _header(self, k: int, frame: str) -> Any:
        time = self._make("builtin_interfaces/msg/Time", *divmod(self._stamps[k], NANOSECONDS))
        return self._make("std_msgs/msg/Header", time, frame)

    def _vector(self, values: Iterable[float]) -> Any:
        return self._make("geometry_msgs/msg/Vector3", *values)

    def _point(self, values: Iterable[float]) -> Any:
        return self._make("geometry_msgs/msg/Point", *values)

    def _quaternion(self, values: Iterable[float]) -> Any:
        """Make a quaternion from (x, y, z, w), the order of both this package and ROS."""
        return self._make("geometry_msgs/msg/Quaternion", *values)

    def _number(self, values: np.ndarray) -> Row:
        listed = values.tolist()
        return lambda k: self._make("std_msgs/msg/Float64", listed[k])

    def _transforms(self, rows: list[range]) -> Row:
        """Return a function that makes the transforms of the active drones."""
        position, quaternion = self._flight["position"], self._flight["quaternion"]

        def one(k: int, i: int) -> Any:
            move = self._make(
                "geometry_msgs/msg/Transform",
                self._vector(position[k, i].tolist()),
                self._quaternion(quaternion[k, i].tolist()),
            )
            header = self._header(k, MAP)
            return self._make("geometry_msgs/msg/TransformStamped", header, _body(i), move)

        def message(k: int) -> Any:
            flying = [one(k, i) for i, own in enumerate(rows) if k in own]
            return self._make("tf2_msgs/msg/TFMessage", flying)

        return message

    def _odometry(self, i: int) -> Row:
        """Return a function that makes the odometry of a drone, with the twist in body axes."""
        # Lists of Python floats need no conversion for each message
        columns = (self._flight[name] for name in ("position", "quaternion", "velocity", "rates"))
        position, quaternion, velocity, rates = (column[:, i].tolist() for column in columns)

        def message(k: int) -> Any:
            pose = self._make(
                "geometry_msgs/msg/Pose", self._point(position[k]), self._quaternion(quaternion[k])
            )
            # Recorded velocities are in world axes, and rates already in body axes
            linear = to_body(tuple(quaternion[k]), tuple(velocity[k]))
            twist = self._make(
                "geometry_msgs/msg/Twist", self._vector(linear), self._vector(rates[k])
            )
            return self._make(
                "nav_msgs/msg/Odometry",
                self._header(k, MAP),
                _body(i),
                self._make("geometry_msgs/msg/PoseWithCovariance", pose, ZERO_COVARIANCE),
                self._make("geometry_msgs/msg/TwistWithCovariance", twist, ZERO_COVARIANCE),
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
        """Return a function that makes IMU messages of specific force and angular velocity."""
        force, rates = reading[:, :3].tolist(), reading[:, 3:6].tolist()
        zero_covariance = np.zeros(9)
        no_attitude = np.array(
            [-1.0, *zero_covariance[1:]]
        )  # ROS convention: there is no attitude estimate
        still = self._quaternion((0.0, 0.0, 0.0, 1.0))
        return lambda k: self._make(
            "sensor_msgs/msg/Imu",
            self._header(k, _body(i)),
            *(still, no_attitude),
            *(self._vector(rates[k]), zero_covariance),
            *(self._vector(force[k]), zero_covariance),
        )


def _body(i: int) -> str:
    """Return the name of the body frame of a drone."""
    return f"drone_{i}/base_link"
