"""Recorded flights as MCAP files of ROS 2 messages; needs the extra `mcap`, but no ROS.

Frames are those of REP 103 and REP 105, as in this package: `map` is ENU, and each drone's
`drone_0/base_link` is FLU. Stamps begin with 0 at the start of the flight.
"""

import re
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from bulletuav.adapters.flights import Flight, check, results, rows_flown
from bulletuav.errors import missing
from bulletuav.files import whole_file
from bulletuav.geometry.rotation import to_body

try:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore
except ImportError:
    raise missing("writing MCAP", "mcap") from None

MAP = "map"
"""Name of the world's frame"""
BAG_VERSION = 8
"""Version of the form of bags, that of ROS 2 Jazzy"""
NANOSECONDS = 10**9
"""Nanoseconds in a second"""
UNTOLD = np.zeros(36)
"""Covariance of poses and twists, of which nothing is told"""

Row = Callable[[int], Any]
"""Makes the message of a row of states"""
Topic = tuple[str, str, range, Row]
"""Name, type, rows of states that have a message, and what makes each"""


def write_mcap(flight: Flight, path: Path) -> None:
    """Write a recorded flight as one file.

    Args:
        flight: Arrays of the recording, as `Recording.everything()` returns them.
        path: The file; replaced if it is there.

    Raises:
        ValueError: An array is damaged.
        OSError: The file cannot be written.
    """
    check(flight)
    store = get_typestore(Stores.ROS2_JAZZY)
    stamps = [round(time * NANOSECONDS) for time in flight["time"].tolist()]
    topics = list(_Messages(flight, stamps, store.types).topics())
    # The writer makes a folder around the file.
    with whole_file(path) as part, tempfile.TemporaryDirectory(dir=path.parent) as folder:
        bag = Path(folder) / "bag"
        with _writer(bag) as writer:
            names = _ros_names(name for name, *_ in topics)
            connections = [
                writer.add_connection(name, kind, typestore=store)
                for name, (_, kind, *_) in zip(names, topics, strict=True)
            ]
            for k, stamp in enumerate(stamps):
                for connection, (_, kind, rows, message) in zip(connections, topics, strict=True):
                    if k in rows:
                        writer.write(connection, stamp, store.serialize_cdr(message(k), kind))
        (bag / "bag.mcap").replace(part)


def _writer(bag: Path) -> Writer:
    """Make a writer of a compressed bag."""
    writer = Writer(bag, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    return writer


def _ros_names(names: Iterable[str]) -> list[str]:
    """Make names that ROS takes: letters, digits and underscores, and none of them twice."""
    made: list[str] = []
    for name in names:
        words = re.sub(r"[^A-Za-z0-9/]+", "_", name).split("/")
        text = "".join(f"/_{word}" if word[0].isdigit() else f"/{word}" for word in words if word)
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
        """List the topics, in the order in which they are written."""
        flight = self._flight
        everywhere = range(len(self._stamps))
        rows = [range(count) for count in rows_flown(flight)]
        imu = flight.get("reading/imu")
        yield "time", "std_msgs/msg/Float64", everywhere, self._number(flight["time"])
        yield "tf", "tf2_msgs/msg/TFMessage", everywhere, self._transforms(rows)
        for i, own in enumerate(rows):
            name = f"drone_{i}"
            yield f"{name}/odometry", "nav_msgs/msg/Odometry", own, self._odometry(i)
            yield f"{name}/velocity", "geometry_msgs/msg/Vector3Stamped", own, self._velocity(i)
            if flight["goal"].shape[1]:
                yield f"{name}/goal", "geometry_msgs/msg/PointStamped", own, self._goal(i)
            if imu is not None:
                yield f"{name}/imu", "sensor_msgs/msg/Imu", own, self._imu(imu[:, i], i)
            for result, values in results(flight).items():
                # A decision is judged at its end.
                later = np.concatenate([values[:1, i], values[:, i]])
                row = self._number(later)
                yield f"{name}/{result}", "std_msgs/msg/Float64", own[1:], row

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
        columns = (self._flight[name] for name in ("position", "quaternion", "velocity", "rates"))
        position, quaternion, velocity, rates = (column[:, i].tolist() for column in columns)

        def message(k: int) -> Any:
            pose = self._make(
                "geometry_msgs/msg/Pose", self._point(position[k]), self._turn(quaternion[k])
            )
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
