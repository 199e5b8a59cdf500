"""MCAP files of recorded flights: read again by another library, they give the same numbers."""

import re

import numpy as np
import pytest
from exported import DECISIONS, DRONES, ROWS, made_flight
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from bulletuav.adapters.mcap import write_mcap

FLIGHT = made_flight()


def read(path):
    """Messages of each topic, as (log time in ns, message), by what the file tells of its types."""
    store, topics, types = get_typestore(Stores.EMPTY), {}, {}
    with path.open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        for schema, channel, message in reader.iter_messages():
            if schema.name not in types:
                assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
                told = get_types_from_msg(schema.data.decode(), schema.name)
                store.register({k: v for k, v in told.items() if k not in store.types})
            types[schema.name] = types.get(schema.name, set()) | {channel.topic}
            made = store.deserialize_cdr(message.data, schema.name)
            topics.setdefault(channel.topic, []).append((message.log_time, made))
    return topics, types


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("mcap") / "flight.mcap"
    write_mcap(FLIGHT, path)
    return path


@pytest.fixture(scope="module")
def topics(path):
    return read(path)[0]


def xyz(vector):
    return [vector.x, vector.y, vector.z]


def xyzw(turn):
    return [turn.x, turn.y, turn.z, turn.w]


def same(told, wanted):
    """Compare to the last bit, signs of zeros included."""
    assert np.array(told, dtype=np.float64).tobytes() == np.ascontiguousarray(wanted).tobytes()


def stamp(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def test_states_come_back_to_the_bit(topics):
    for i, rows in enumerate(ROWS):
        flown = np.s_[:rows, i]
        told = [message for _, message in topics[f"/drone_{i}/odometry"]]
        same([xyz(one.pose.pose.position) for one in told], FLIGHT["position"][flown])
        same([xyzw(one.pose.pose.orientation) for one in told], FLIGHT["quaternion"][flown])
        same([xyz(one.twist.twist.angular) for one in told], FLIGHT["rates"][flown])
        assert {one.header.frame_id for one in told} == {"map"}
        assert {one.child_frame_id for one in told} == {f"drone_{i}/base_link"}
        velocities = [message for _, message in topics[f"/drone_{i}/velocity"]]
        same([xyz(one.vector) for one in velocities], FLIGHT["velocity"][flown])
        assert {one.header.frame_id for one in velocities} == {"map"}
        goals = [message for _, message in topics[f"/drone_{i}/goal"]]
        same([xyz(one.point) for one in goals], FLIGHT["goal"][flown])


def test_times_come_back(topics):
    same([message.data for _, message in topics["/time"]], FLIGHT["time"])
    # 1/48 s is 20833333.33 ns: stamps are the nearest ones.
    wanted = [0, 20833333, 41666667, 62500000, 83333333, 104166667, 125000000, 145833333]
    assert [time for time, _ in topics["/time"]] == wanted
    for name, of_one in topics.items():
        times = [time for time, _ in of_one]
        assert times == sorted(times)
        if hasattr(of_one[0][1], "header"):
            assert [stamp(message) for _, message in of_one] == times, name


def test_twists_are_in_axes_of_the_body(topics):
    """As scipy turns them, which has quaternions in the same order."""
    for i, rows in enumerate(ROWS):
        told = [xyz(one.twist.twist.linear) for _, one in topics[f"/drone_{i}/odometry"]]
        turn = Rotation.from_quat(FLIGHT["quaternion"][:rows, i])
        wanted = turn.apply(FLIGHT["velocity"][:rows, i], inverse=True)
        np.testing.assert_allclose(told, wanted, rtol=0, atol=1e-14)


def test_transforms_are_of_the_drones_that_fly(topics):
    for k, (_, message) in enumerate(topics["/tf"]):
        flying = [i for i, rows in enumerate(ROWS) if k < rows]
        told = message.transforms
        assert [one.child_frame_id for one in told] == [f"drone_{i}/base_link" for i in flying]
        assert {one.header.frame_id for one in told} == {"map"}
        same([xyz(one.transform.translation) for one in told], FLIGHT["position"][k, flying])
        same([xyzw(one.transform.rotation) for one in told], FLIGHT["quaternion"][k, flying])
    assert len(topics["/tf"]) == DECISIONS + 1


def test_imus_tell_forces_and_rates_and_no_attitude(topics):
    reading = FLIGHT["reading/imu"]
    for i, rows in enumerate(ROWS):
        told = [message for _, message in topics[f"/drone_{i}/imu"]]
        same([xyz(one.linear_acceleration) for one in told], reading[:rows, i, :3])
        same([xyz(one.angular_velocity) for one in told], reading[:rows, i, 3:])
        assert {one.header.frame_id for one in told} == {f"drone_{i}/base_link"}
        assert {one.orientation_covariance[0] for one in told} == {-1.0}


def test_what_decisions_gave_is_told_at_their_ends(topics):
    names = {
        "reward": "reward",
        "separation": "separation",
        "conflicts": "conflicts",
        "collision": "collision",
        "success": "success",
        "info/reward/progress": "info/reward/progress",
        "info/odd_name": "info/odd name",
        "info/odd_name_": "info/odd_name",
        "info/_2nd": "info/2nd",
    }
    stamps = [time for time, _ in topics["/time"]]
    for i, rows in enumerate(ROWS):
        for name, entry in names.items():
            told = topics[f"/drone_{i}/{name}"]
            wanted = FLIGHT[entry][: rows - 1, i].astype(float)
            same([message.data for _, message in told], wanted)
            assert [time for time, _ in told] == stamps[1:rows], name


def test_topics_have_names_and_types_of_ros(path):
    topics, types = read(path)
    assert all(re.fullmatch(r"(/[A-Za-z_][A-Za-z0-9_]*)+", name) for name in topics)
    assert sum(map(len, types.values())) == len(topics) == 2 + DRONES * (4 + 9)
    assert set(types) == {
        "std_msgs/msg/Float64",
        "tf2_msgs/msg/TFMessage",
        "nav_msgs/msg/Odometry",
        "geometry_msgs/msg/Vector3Stamped",
        "geometry_msgs/msg/PointStamped",
        "sensor_msgs/msg/Imu",
    }


def test_without_goals_and_imu_there_is_nothing_of_them(tmp_path):
    flight = {**FLIGHT, "goal": FLIGHT["goal"][:, :0]}
    del flight["reading/imu"]
    write_mcap(flight, tmp_path / "flight.mcap")
    topics, _ = read(tmp_path / "flight.mcap")
    assert not [name for name in topics if name.endswith(("/goal", "/imu"))]


def test_the_same_flight_gives_the_same_file_and_nothing_beside_it(path, tmp_path):
    write_mcap(FLIGHT, tmp_path / "again.mcap")
    write_mcap(FLIGHT, tmp_path / "again.mcap")
    assert (tmp_path / "again.mcap").read_bytes() == path.read_bytes()
    assert [one.name for one in tmp_path.iterdir()] == ["again.mcap"]
