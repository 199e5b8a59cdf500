"""Logs of PX4, ROS, Crazyflies and AirSim are read as the CSV log of the same flight."""

import contextlib
import json
import struct

import flown
import numpy as np
import pytest
from identification import other_logs
from identification.other_logs import CLOCK, Ulog, usd_bytes
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from bulletuav import load_airframe
from bulletuav.cli import main
from bulletuav.errors import GIB
from bulletuav.identification import ulog
from bulletuav.identification.formats import read_flight_log
from bulletuav.identification.identify import identify
from bulletuav.identification.logs import parse_map

DRONE = load_airframe("cf2x")
SECONDS = 12
ORDER = [0, 3, 1, 2]
"""Motor (from 0) of PX4's quadrotor x for each rotor of cf2x, by hand: front right is 1, rear right
4, rear left 2, front left 3"""
FIT = ("thrust_coefficient", "drag_xy")
ACTUATORS = "std_msgs/Header header\nfloat64[] angles\nfloat64[] angular_velocities\n"
ROTORS = ["w1=M1", "w2=M2", "w3=M3", "w4=M4"]


@pytest.fixture(scope="module")
def rows():
    return flown.fly_example(DRONE, SECONDS, seed=5)


@pytest.fixture(scope="module")
def pwm(rows):
    """Motor commands of the speeds, by the airframe's map of 1/min."""
    return (rows[:, 11:] * 30 / np.pi - DRONE.pwm.intercept) / DRONE.pwm.slope


def write_bag(rows, folder, name, has_stamps=True, more=()):
    """Write poses, an IMU and rotor speeds as a bag of ROS 1 (.bag) or ROS 2 (.mcap, .db3)."""
    is_1 = name.endswith(".bag")
    store = get_typestore(Stores.ROS1_NOETIC if is_1 else Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(ACTUATORS, "mav_msgs/msg/Actuators"))
    types, path = store.types, folder / name
    if is_1:
        writer = Writer1(path)
    else:
        plugin = StoragePlugin.MCAP if name.endswith("mcap") else StoragePlugin.SQLITE3
        writer = Writer(path, version=9, storage_plugin=plugin)

    def make(kind, *values):
        return types[kind](*values)

    def header(time):
        seconds, fraction = divmod(round(1e9 * time), 10**9)
        stamp = make("builtin_interfaces/msg/Time", seconds if has_stamps else 0, fraction)
        stamp = stamp if has_stamps else make("builtin_interfaces/msg/Time", 0, 0)
        return make("std_msgs/msg/Header", *((0,) if is_1 else ()), stamp, "map")

    kinds = {
        "/drone/pose": "geometry_msgs/msg/PoseStamped",
        "/drone/imu": "sensor_msgs/msg/Imu",
        "/drone/motors": "mav_msgs/msg/Actuators",
        "/text": "std_msgs/msg/String",
        **dict.fromkeys(more, "geometry_msgs/msg/PoseStamped"),
    }
    with writer:
        links = {
            topic: writer.add_connection(topic, kind, typestore=store)
            for topic, kind in kinds.items()
        }
        for row in rows:
            time, turn = row[0] + 100, make("geometry_msgs/msg/Quaternion", *row[4:8])
            pose = make("geometry_msgs/msg/Pose", make("geometry_msgs/msg/Point", *row[1:4]), turn)
            still = make("geometry_msgs/msg/Vector3", 0.1, 0.2, 9.8)
            rates = make("geometry_msgs/msg/Vector3", *row[8:11])
            nine = np.zeros(9)
            messages = {
                "/drone/pose": (header(time), pose),
                "/drone/imu": (header(time), turn, nine, rates, nine, still, nine),
                "/drone/motors": (header(time), np.zeros(0), row[11:15]),
                "/text": ("a",),
                **{topic: (header(time), pose) for topic in more},
            }
            for topic, fields in messages.items():
                message = make(kinds[topic], *fields)
                write = store.serialize_ros1 if is_1 else store.serialize_cdr
                # Recorded 3 ms late, or on time without stamps
                late = round(1e9 * time) + (3_000_000 if has_stamps else 0)
                writer.write(links[topic], late, write(message, kinds[topic]))
    return path


@pytest.fixture(scope="module")
def logs(rows, pwm, tmp_path_factory):
    """The same flight in each format: path, and texts of --map."""
    folder = tmp_path_factory.mktemp("logs")
    for name, data in {
        "log.ulg": other_logs.ulog_of(rows, pwm, ORDER),
        "log00": other_logs.usd_of(rows, pwm),
        "log01": other_logs.usd_of(rows, pwm, version=1),
    }.items():
        (folder / name).write_bytes(data)
    (folder / "airsim_rec.txt").write_text(other_logs.airsim_of(rows))
    paths = {name: (folder / name, []) for name in ("log.ulg", "log00", "log01")}
    paths["csv"] = (flown.write_example_log(folder / "log.csv", rows), [])
    paths["airsim"] = (folder / "airsim_rec.txt", ROTORS)
    for name in ("one.bag", "two_mcap", "two_db3"):
        paths[name] = (write_bag(rows, folder, name), [])
    return paths


OTHERS = ("log.ulg", "log00", "log01", "airsim", "one.bag", "two_mcap", "two_db3")


def read(logs, name):
    path, maps = logs[name]
    return read_flight_log(path, parse_map(maps), DRONE)


@pytest.mark.parametrize("name", OTHERS)
def test_columns_are_those_of_the_csv_file(logs, name, rows, pwm):
    log, expected = read(logs, name), read(logs, "csv")
    np.testing.assert_allclose(log.time, expected.time, atol=1e-6)
    for column in ("x", "y", "z"):
        np.testing.assert_allclose(log.columns[column], expected.columns[column], atol=1e-6)
    quaternions = [one.stack(("qx", "qy", "qz", "qw")) for one in (log, expected)]
    np.testing.assert_allclose(np.abs(np.sum(quaternions[0] * quaternions[1], axis=1)), 1)
    np.testing.assert_allclose(quaternions[0], quaternions[1], atol=1e-6)
    for column in ("p", "q", "r"):
        if name != "airsim":
            np.testing.assert_allclose(log.columns[column], expected.columns[column], atol=1e-5)
    for k in range(4):
        if log.kind == "w":
            np.testing.assert_allclose(log.columns[f"w{k + 1}"], rows[:, 11 + k], rtol=1e-8)
        else:
            np.testing.assert_allclose(log.columns[f"pwm{k + 1}"], pwm[:, k], atol=0.51)


@pytest.mark.parametrize("name", ["log.ulg", "log00", "airsim", "two_mcap"])
def test_identified_constants_are_those_of_the_csv_file(logs, name):
    def fit(name):
        path, maps = logs[name]
        return identify([path], DRONE, fit=FIT, columns=maps).estimates

    for found, expected in zip(fit(name), fit("csv"), strict=True):
        # Speeds and times are rounded a little; without a gyroscope rates have other noise
        assert found.after == pytest.approx(expected.after, rel=2e-3 if name != "airsim" else 0.03)


def test_used_and_unused_columns_are_reported(logs):
    log = read(logs, "log.ulg")
    assert log.used["x"] == "vehicle_local_position.y"
    assert log.used["pwm2"] == "actuator_outputs.output[3]"
    assert log.unused[0] == "vehicle_local_position.xy_valid"
    assert "cpuload" in log.unused
    assert "actuator_outputs.output[4]" in log.unused
    assert read(logs, "log00").unused == ("estPosition",)
    assert read(logs, "airsim").unused == ("VehicleName", "ImageFile")
    bag = read(logs, "two_mcap").unused
    assert "/text" in bag
    assert "/drone/imu.orientation.x" in bag
    # An accelerometer that always returns the same was not measured
    assert "/drone/imu.linear_acceleration.x" in bag
    assert read(logs, "csv").unused == ()


def test_command_prints_what_is_not_used(logs, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["--airframe", "cf2x", "--fit", "drag_xy", "--out", str(out)]
    main(["identify", str(logs["log00"][0]), *words])
    printed = capsys.readouterr().out
    assert "x, y, z, qx, qy, qz, qw from stateEstimate" in " ".join(printed.split())
    assert "not used: estPosition" in printed
    (report,) = out.glob("*.json")
    assert json.loads(report.read_text())["logs"][0]["unused"] == ["estPosition"]


def test_unused_columns_of_csv_files_are_reported(rows, tmp_path):
    names = [*flown.COLUMNS, "temperature"]
    table = np.column_stack([rows, np.arange(len(rows))])
    path = flown.write_example_log(tmp_path / "log.csv", table, names)
    assert read_flight_log(path, {}, DRONE).unused == ("temperature",)


# Clocks, gaps and choices


def save(tmp_path, data):
    path = tmp_path / "log"
    path.write_bytes(data)
    return path


def test_topics_with_other_clocks_are_merged(tmp_path):
    """Attitude every 10 ms; position every 20 ms; motors at 0, 50 and 220 ms."""
    log, count = Ulog(), 30
    log.topic(0, "vehicle_attitude", [CLOCK, ("float[4]", "q")])
    log.topic(1, "vehicle_local_position", [CLOCK, ("float", "x"), ("float", "y"), ("float", "z")])
    log.topic(2, "actuator_motors", [CLOCK, ("float[12]", "control")])
    for k in range(count):
        log.write(0, "Q4f", 10_000 * k, 1, 0, 0, 0)
        if k % 2 == 0:
            log.write(1, "Q3f", 10_000 * k, k, 2 * k, -3 * k)
    for time, value in ((0, 0.1), (50_000, 0.2), (220_000, 0.3), (270_000, 0.4)):
        log.write(2, "Q12f", time, *[value] * 12)
    found = read_flight_log(save(tmp_path, log.data), {}, DRONE)
    np.testing.assert_allclose(found.time, 0.01 * np.arange(28))
    np.testing.assert_allclose(found.columns["x"], 2 * np.arange(28), atol=1e-6)
    np.testing.assert_allclose(found.columns["z"], 3 * np.arange(28), atol=1e-6)
    motor = found.columns["pwm1"]
    np.testing.assert_allclose(motor[:6], [0.1] * 5 + [0.2], rtol=1e-6)
    # 170 ms between two values are a gap
    assert np.isnan(motor[6:22]).all()
    np.testing.assert_allclose(motor[22:], [0.3] * 5 + [0.4], rtol=1e-6)
    # Level, and the nose to north: the half turn about east + north and that about forward
    np.testing.assert_allclose(found.columns["qz"], np.sqrt(0.5))
    np.testing.assert_allclose(found.columns["qw"], np.sqrt(0.5))


def px4(tmp_path, *topics):
    """A log with a pose of three rows, and other topics (name, fields, form, values)."""
    log = Ulog()
    log.topic(0, "vehicle_attitude", [CLOCK, ("float[4]", "q")])
    log.topic(1, "vehicle_local_position", [CLOCK, ("float", "x"), ("float", "y"), ("float", "z")])
    for number, (name, fields, _, _) in enumerate(topics, start=2):
        log.topic(number, name, [CLOCK, *fields])
    for k in range(3):
        log.write(0, "Q4f", 10_000 * k, 1, 0, 0, 0)
        log.write(1, "Q3f", 10_000 * k, k, k, k)
        for number, (_, _, form, values) in enumerate(topics, start=2):
            log.write(number, "Q" + form, 10_000 * k, *values)
    return save(tmp_path, log.data)


OUTPUTS = ("actuator_outputs", [("float[4]", "output")], "4f", (1100, 1200, 1300, 1400))


def test_measured_speeds_are_used_without_a_pwm_map(tmp_path):
    log = Ulog()
    log.add("F", b"esc_report:uint64_t timestamp;int32_t esc_rpm;uint8_t[3] _padding0;")
    log.topic(0, "vehicle_attitude", [CLOCK, ("float[4]", "q")])
    log.topic(1, "vehicle_local_position", [CLOCK, ("float", "x"), ("float", "y"), ("float", "z")])
    log.topic(2, "esc_status", [CLOCK, ("esc_report[4]", "esc")])
    log.topic(3, "actuator_outputs", [CLOCK, ("float[4]", "output")])
    log.subscribe(4, "actuator_outputs", instance=1)
    for k in range(3):
        log.write(0, "Q4f", 10_000 * k, 1, 0, 0, 0)
        log.write(1, "Q3f", 10_000 * k, k, k, k)
        reports = b"".join(struct.pack("<Qi3x", 0, 5000 + motor) for motor in range(1, 5))
        log.add("D", struct.pack("<HQ", 2, 10_000 * k) + reports)
        log.write(3, "Q4f", 10_000 * k, 1100, 1200, 1300, 1400)
        log.write(4, "Q4f", 10_000 * k, 1, 2, 3, 4)
    path = save(tmp_path, log.data)
    found = read_flight_log(path, {}, load_airframe("iris"))
    assert [found.columns[f"rpm{k}"][0] for k in range(1, 5)] == [5001, 5002, 5003, 5004]
    assert "actuator_outputs" in found.unused
    assert "actuator_outputs_1" in found.unused
    found = read_flight_log(path, {}, DRONE)
    assert [found.columns[f"pwm{k}"][0] for k in range(1, 5)] == [1100, 1400, 1200, 1300]
    maps = parse_map([f"w{k}=actuator_outputs_1.output[{k - 1}]*10+0.5" for k in range(1, 5)])
    found = read_flight_log(path, maps, DRONE)
    assert [found.columns[f"w{k}"][0] for k in range(1, 5)] == [10.5, 20.5, 30.5, 40.5]


def test_battery_without_a_current_and_slow_battery(tmp_path):
    battery = ("battery_status", [("float", "voltage_v"), ("float", "current_a")], "2f", (15.5, -1))
    found = read_flight_log(px4(tmp_path, OUTPUTS, battery), {}, DRONE)
    assert found.columns["vbat"][0] == 15.5
    assert "current" not in found
    assert "battery_status.current_a" in found.unused


def test_topics_that_are_not_read_and_equal_hints_are_named(tmp_path):
    """As bags of transforms alone."""
    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer1(tmp_path / "tf.bag") as writer:
        text = "std_msgs/msg/String"
        link = writer.add_connection("/note", text, typestore=store)
        writer.write(link, 0, store.serialize_ros1(store.types[text]("a"), text))
    with pytest.raises(ValueError, match=r"has no topics that are read: .*; not read: /note$"):
        read_flight_log(tmp_path / "tf.bag", {}, DRONE)
    names = ["fixedFrequency", ["acc.a(f)"]]
    path = save(tmp_path, usd_bytes(2, [(1, *names)], struct.pack("<HQf", 1, 0, 0)))
    with pytest.raises(ValueError, match=r"\(x, y, z, qx: choose from acc.a, t\)"):
        read_flight_log(path, {}, DRONE)


def test_missing_topics_are_named(tmp_path):
    path = px4(tmp_path)
    with pytest.raises(ValueError, match="lacks the columns w1, w2, w3, w4") as caught:
        read_flight_log(path, {}, DRONE)
    assert "SDLOG_PROFILE" in str(caught.value)
    assert "The log has vehicle_local_position, vehicle_attitude:" in str(caught.value)
    with pytest.raises(ValueError, match="--map w1=nothing: there is no such column"):
        read_flight_log(path, parse_map(["w1=nothing"]), DRONE)
    with pytest.raises(ValueError, match="has its own clock"):
        read_flight_log(path, parse_map(["t=nothing"]), DRONE)


def test_crazyflie_euler_angles_and_millimetres(tmp_path):
    """The firmware's pitch is positive when the nose is up, ours when it is down."""
    names = [f"stateEstimateZ.{axis}(h)" for axis in "xyz"]
    names += [f"stateEstimate.{name}(f)" for name in ("roll", "pitch", "yaw")]
    names += [f"rpm.m{k}(H)" for k in range(1, 5)]
    content = b"".join(
        struct.pack("<HI3h3f4H", 1, 10 * k, 1000, -2000, 500, 10, 20, 30, 1, 2, 3, 4)
        for k in range(3)
    )
    data = usd_bytes(1, [(1, "fixedFrequency", names)], content)
    found = read_flight_log(save(tmp_path, data), {}, DRONE)
    read = [found.columns[name][0] for name in ("x", "y", "z", "roll", "pitch", "yaw", "rpm4")]
    np.testing.assert_allclose(read, [1, -2, 0.5, *np.deg2rad([10, -20, 30]), 4], rtol=1e-6)


def test_bags_without_stamps_and_with_several_poses(rows, tmp_path):
    log = read_flight_log(write_bag(rows[:20], tmp_path, "a.bag", False), {}, DRONE)
    np.testing.assert_allclose(log.time, rows[:20, 0], atol=1e-6)
    path = write_bag(rows[:20], tmp_path, "b.bag", more=["/other"])
    with pytest.raises(ValueError, match="several topics for pose"):
        read_flight_log(path, {}, DRONE)
    log = read_flight_log(path, parse_map(["x=/other.pose.position.x*2"]), DRONE)
    np.testing.assert_allclose(log.columns["x"], 2 * rows[:20, 1])
    assert log.used["y"] == "/other.pose.position.y"
    assert "/drone/pose" in log.unused


# Damaged files


def damage():
    """Bytes of damaged files, and parts of the messages."""
    log = Ulog()
    log.topic(0, "a", [CLOCK, ("float", "x")])
    plain = log.data
    bomb = Ulog()
    for k in range(7):
        bomb.add("F", f"n{k}:n{k + 1}[4096] x;".encode())
    bomb.add("F", b"n7:uint8_t x;")
    bomb.topic(0, "a", [CLOCK, ("n0", "x")])
    bomb.write(0, "Q", 0)
    empty = Ulog()
    empty.add("F", b"e:")
    loop = Ulog()
    loop.topic(0, "a", [CLOCK, ("a", "x")])
    loop.write(0, "Q", 0)
    huge = Ulog()
    huge.topic(0, "a", [CLOCK, ("float[4000000000]", "x")])
    wide = Ulog()
    wide.topic(0, "a", [CLOCK, *[("uint8_t[65535]", f"_padding{k}") for k in range(2000)]])
    wide.write(0, "Q", 0)
    short = Ulog()
    short.topic(0, "a", [CLOCK, ("float", "x")])
    short.write(0, "I", 0)
    unknown = Ulog()
    unknown.write(5, "Q", 0)
    no_clock = Ulog()
    no_clock.topic(0, "a", [("float", "x")])
    no_clock.write(0, "f", 0)
    event = (1, "e", ["x(f)"])
    return {
        "ulog header": (plain[:10], "Header too short"),
        "ulog magic": (b"ULog\x09\x12\x35" + plain[7:], "Failed to parse header"),
        "ulog flags": (Ulog(flags=b"\x02" + bytes(7)).data, "Unknown incompatible flag"),
        "ulog offsets": (Ulog(b"\1" + bytes(7), (9**9, 0, 0)).data, "lacks the columns"),
        "ulog noise": (b"ULog" + np.random.default_rng(1).bytes(5000), "Failed to parse header"),
        "ulog noisy": (plain[:16] + np.random.default_rng(1).bytes(5000), "damaged"),
        "ulog cut": (plain[:-3], "not read: an incomplete message at its end"),
        "ulog bomb": (bomb.data, BOUNDED),
        "ulog empty": (empty.data, "lacks the columns"),
        "ulog loop": (loop.data, "maximum recursion depth"),
        "ulog huge": (huge.data, "not read: damaged messages"),
        "ulog wide": (wide.data, BOUNDED),
        "ulog short": (short.data, "not read: damaged messages"),
        "ulog unknown": (unknown.data, "lacks the columns"),
        "ulog clock": (no_clock.data, "a has no timestamp"),
        "usd empty": (b"\xbc", "damaged log of a micro-SD"),
        "usd version": (usd_bytes(3, [], b""), "version is 3"),
        "usd cut": (usd_bytes(2, [event], b"")[:-1], "checksum"),
        "usd names": (usd_bytes(2, [(1, "e" * 300, [])], b""), "damaged log"),
        "usd type": (usd_bytes(2, [(1, "e", ["x(z)"])], b""), "'x(z)' has no known type"),
        "usd event": (usd_bytes(2, [event], struct.pack("<HQf", 2, 0, 0)), "unknown event 2"),
        "usd part": (usd_bytes(2, [event], struct.pack("<HQ", 1, 0)), "incomplete"),
        "usd counts": (usd_bytes(2, [(1, "e", ["x(f)"] * 2000)], b""), "2000 variables"),
        "usd twice": (usd_bytes(2, [(1, "e", ["x(f)", "x(f)"])], b""), "damaged log"),
        "bag": (b"#ROSBAG V2.0\n" + bytes(100), "cannot be read as a ROS bag"),
        "mcap": (b"\x89MCAP0\r\n" + b"\xff" * 100, "cannot be read as a ROS bag"),
        "sqlite": (b"SQLite format 3\0" + bytes(100), "cannot be read as a ROS bag"),
        "airsim none": (b"TimeStamp\tPOS_X\n", "no rows below its header"),
        "airsim cut": (b"TimeStamp\tPOS_X\n1\n", "row 2 has 1"),
        "airsim text": (b"TimeStamp\tPOS_X\n1\ta\n", "POS_X is 'a'"),
        "airsim motors": (b"TimeStamp\tPOS_X\n1\t2\n", "getRecordFileLine"),
        "airsim two": (b"VehicleName\tTimeStamp\na\t1\nb\t2\n", "2 vehicles, ['a', 'b']"),
    }


BOUNDED = ("need too much memory", "takes pyulog more than")
"""Messages of the limits on memory and on time, of which a busy machine may reach either first"""
DAMAGED = damage()


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_logs_give_one_error(name, tmp_path, monkeypatch):
    data, message = DAMAGED[name]
    monkeypatch.setattr(ulog, "MIN_MEMORY", GIB // 4)
    path = save(tmp_path, data)
    with pytest.raises(ValueError, match=".") as caught:
        read_flight_log(path, {}, DRONE)
    assert str(path) in str(caught.value)
    messages = (message,) if isinstance(message, str) else message
    assert any(one in str(caught.value) for one in messages)


def test_a_log_that_takes_too_long_is_refused(logs, monkeypatch):
    monkeypatch.setattr(ulog, "MAX_SECONDS", 0.01)
    with pytest.raises(ValueError, match=r"log.ulg takes pyulog more than 0.01 s: cut the log"):
        read(logs, "log.ulg")


def test_a_killed_subprocess_gives_one_error(logs, monkeypatch, tmp_path):
    child = tmp_path / "child.py"
    child.write_text("import os; os.kill(os.getpid(), 9)")
    monkeypatch.setattr(ulog, "CHILD", child)
    with pytest.raises(ValueError, match=r"log.ulg is a damaged ULog file \(pyulog ended with -9"):
        read(logs, "log.ulg")


def test_logs_of_px4_need_an_extra(logs, monkeypatch):
    monkeypatch.setattr(ulog.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ImportError, match="reading logs of PX4 needs the extra 'ulog'"):
        read(logs, "log.ulg")


@pytest.mark.parametrize("name", ["log.ulg", "log00", "one.bag"])
def test_any_cut_or_changed_byte_gives_one_error_or_a_log(logs, name, tmp_path):
    """As fuzzing: a file that is cut anywhere, or with some bytes changed."""
    data, rng = logs[name][0].read_bytes(), np.random.default_rng(0)
    for k in range(40):
        changed = bytearray(data[: 3000 + 100 * k])
        if k % 2:
            for place in rng.integers(16, len(changed), 3):
                changed[place] = rng.integers(256)
        path = save(tmp_path, bytes(changed))
        reason = str(path)
        with contextlib.suppress(ValueError):
            try:
                read_flight_log(path, {}, DRONE)
            except ValueError as error:
                reason = str(error)
                raise
        assert str(path) in reason


def test_incomplete_end_of_a_ulog_is_reported(logs, tmp_path):
    path = save(tmp_path, logs["log.ulg"][0].read_bytes()[:-5])
    assert "incomplete message" in read_flight_log(path, {}, DRONE).unused[-1]
