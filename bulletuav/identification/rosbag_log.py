"""Flight logs of ROS 1 and ROS 2, in ENU and FLU axes (REP 103)."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bulletuav.identification.logs import FORCE, POSITION, QUATERNION, RATES, ColumnSource, Log
from bulletuav.identification.series import (
    Converted,
    Series,
    convert_columns,
    convert_motors,
    merge_series,
)
from bulletuav.vehicle.airframe import MAX_ROTORS, Airframe

POSE, IMU, MOTORS, BATTERY = "pose", "imu", "motors", "battery"
"""Roles of topics"""
KINDS = {
    "nav_msgs/msg/Odometry": (POSE, "pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        POSE,
        "pose.pose.position",
        "pose.pose.orientation",
    ),
    "geometry_msgs/msg/PoseStamped": (POSE, "pose.position", "pose.orientation"),
    "geometry_msgs/msg/TransformStamped": (POSE, "transform.translation", "transform.rotation"),
    "sensor_msgs/msg/Imu": (IMU, "angular_velocity", "linear_acceleration"),
    "mav_msgs/msg/Actuators": (MOTORS, "angular_velocities", ""),
    "actuator_msgs/msg/Actuators": (MOTORS, "velocity", ""),
    "sensor_msgs/msg/BatteryState": (BATTERY, "voltage", ""),
}
"""Role and fields of the message types that are read"""
ROLE_NAMES = {POSE: "x", IMU: "p", MOTORS: "w1", BATTERY: "vbat"}
"""Name that selects a topic of a role by --map"""
ADVICE = (
    "record a pose (Odometry, PoseStamped, TransformStamped) and rotor speeds (mav_msgs or "
    "actuator_msgs Actuators), or map fields by --map NAME=TOPIC.FIELD, such as "
    "w1=/motors.data[0]"
)


def read_rosbag(path: Path, sources: Mapping[str, ColumnSource], airframe: Airframe) -> Log:
    """Read a bag of ROS 1 or ROS 2.

    Times are those of the headers if all topics in use have them, otherwise those of the recording.
    Rotor speeds are in the order of the airframe.

    Args:
        path: The file, or the folder of a bag of ROS 2.
        sources: Sources of --map, by names TOPIC.FIELD. If several topics have poses (or other
            quantities), a source of one of these topics selects this topic.
        airframe: Airframe of the log.

    Returns:
        The log.

    Raises:
        ValueError: If the bag is damaged, or lacks topics, or has several of one kind.
        ImportError: If the extra `mcap` is not installed.
    """
    from bulletuav.adapters.rosbag import read_topics  # which needs an extra

    mapped = {source.column.partition(".")[0] for source in sources.values()}
    tables, unread = read_topics(path, KINDS, mapped)
    roles: dict[str, list[str]] = {}
    for table in tables:
        if table.kind in KINDS:
            roles.setdefault(KINDS[table.kind][0], []).append(table.topic)
    chosen = {_choose(path, role, topics, mapped) for role, topics in roles.items()}
    in_use = [table for table in tables if table.topic in chosen | mapped]
    has_stamps = all(table.stamps is not None for table in in_use)
    all_series = []
    for table in tables:
        time = table.stamps if has_stamps and table.stamps is not None else table.received
        series = Series(table.topic, time, table.columns, {})
        if table.topic in chosen:
            series = series._replace(converted=_convert(series, table.kind, airframe))
        all_series.append(series)
    return merge_series(path, all_series, sources, airframe, ADVICE, unread)


def _choose(path: Path, role: str, topics: list[str], mapped: set[str]) -> str:
    """Return the topic of a role."""
    selected = [topic for topic in topics if topic in mapped] or topics
    if len(selected) > 1:
        raise ValueError(
            f"{path} has several topics for {role} ({', '.join(selected)}): choose one by --map "
            f"{ROLE_NAMES[role]}=TOPIC.FIELD"
        )
    return selected[0]


def _convert(series: Series, kind: str, airframe: Airframe) -> dict[str, Converted]:
    """Convert the quantities of a topic."""
    role, first, second = KINDS[kind]
    names = [f"{series.topic}.{field}" for field in (first, second)]
    if role == MOTORS:
        columns = [f"{names[0]}[{k}]" for k in range(MAX_ROTORS)]
        return convert_motors(series, "w", columns, range(len(airframe.rotors)))
    if role == BATTERY:
        return convert_columns(series, ("vbat",), names[:1], (1.0,))
    groups = (POSITION, QUATERNION) if role == POSE else (RATES, FORCE)
    found: dict[str, Converted] = {}
    for group, name in zip(groups, names, strict=True):
        columns = [f"{name}.{axis}" for axis in "xyzw"[: len(group)]]
        found |= convert_columns(series, group, columns, np.ones(len(group)).tolist())
    return found
