"""AirSim's calls, without a network: what drones do, and what clients read."""

import io
import math
import re

import numpy as np
import pytest
from bridges.airsim_world_client import FREE, RATE, VECTOR, pose, request, vector
from PIL import Image
from scipy.spatial.transform import Rotation

from bulletuav.bridges import airsim_world
from bulletuav.bridges.airsim_calls import CONTINUE_CALLS, IMAGE_CALLS
from bulletuav.bridges.airsim_motions import MOTIONS
from bulletuav.bridges.airsim_settings import parse_settings
from bulletuav.bridges.airsim_values import (
    attitude_from_airsim,
    read_pose,
    write_pose,
    yaw_from_airsim,
    yaw_to_airsim,
)
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.bridges.motions import PATH_ACCELERATION, TrapezoidalProfile
from bulletuav.earth import enu_to_ned, pressure
from bulletuav.geometry.obstacle import Obstacle

STILL = {"w_val": 0.0, "x_val": 0.0, "y_val": 0.0, "z_val": 0.0}
"""A quaternion without length"""


@pytest.fixture
def client(make_client):
    return make_client()


# Numbers


def test_yaws_are_clockwise_from_north():
    assert yaw_from_airsim(0) == pytest.approx(math.pi / 2)  # north
    assert yaw_from_airsim(90) == pytest.approx(0)  # east
    assert yaw_from_airsim(-90) == pytest.approx(math.pi)
    for degrees in (-170, -20, 0, 45, 179):
        assert yaw_to_airsim(yaw_from_airsim(degrees)) == pytest.approx(degrees)


def test_poses_go_both_ways():
    for k in range(10):
        turn = Rotation.random(random_state=k).as_quat()
        place = np.random.default_rng(k).normal(size=3)
        reported = write_pose(place, turn)
        down, orientation = read_pose(reported)
        np.testing.assert_allclose(enu_to_ned(down), place)
        np.testing.assert_allclose(attitude_from_airsim(orientation), turn, atol=1e-12)


@pytest.mark.parametrize("length", [0.0, 0.5, 2.0, 40.0])
def test_a_ramp_is_its_own_integral(length):
    profile = TrapezoidalProfile(length, 3.0)
    times = np.linspace(0, profile.duration, 4001)
    far, speed, gain = np.array([profile.evaluate(time) for time in times]).T
    assert far[-1] == pytest.approx(length)
    assert speed.max(initial=0) <= 3.0
    assert np.abs(gain).max() <= PATH_ACCELERATION
    np.testing.assert_allclose(far, np.append(0, np.cumsum(np.diff(times) * speed[1:])), atol=0.02)
    # By hand: 40 m at 3 m/s, with 2 m/s^2: 40 / 3 + 3 / 2 s
    if length == 40.0:
        assert profile.duration == pytest.approx(40 / 3 + 1.5)


# Motions


def test_it_takes_off_moves_and_lands(client):
    client.ready()
    assert client("getMultirotorState", "")["landed_state"] == 0
    assert client.place() == pytest.approx([0, 0, 0], abs=1e-9)
    assert client.yaw() == pytest.approx(0, abs=1e-6)
    assert client.join("takeoff", 20.0, "")[0] is True
    assert client.place() == pytest.approx([0, 0, -3], abs=0.35)
    assert client("getMultirotorState", "")["landed_state"] == 1
    done, seconds = client.join("moveToPosition", 6.0, 2.0, -4.0, 3.0, 60.0, *FREE, -1, 1, "")
    assert done is True
    assert seconds == pytest.approx(6.4 / 3 + 1.5, abs=0.5)
    client.fly(1.0)
    assert client.place() == pytest.approx([6, 2, -4], abs=0.1)
    assert client.join("moveToZ", -1.0, 1.5, 60.0, RATE, -1, 1, "")[0] is True
    assert client.join("land", 60.0, "")[0] is True
    client.fly(0.5)
    assert client.place() == pytest.approx([6, 2, 0], abs=0.1)
    assert client("getMultirotorState", "")["landed_state"] == 0
    assert max(one["speed"] for one in client("getRotorStates", "")["rotors"]) < 50
    assert not client("simGetCollisionInfo", "")["has_collided"]


def test_it_flies_home_along_a_path_and_looks_ahead(client):
    client.at((0, 0, -4))
    path = [vector(4, 0, -4), vector(4, 4, -5)]
    reported = client.begin("moveOnPath", path, 2.0, 60.0, 1, RATE, -1, 1, "")
    client.fly(1.5)
    assert client.yaw() == pytest.approx(0, abs=5)
    client.fly(2.5)
    assert client.yaw() == pytest.approx(90, abs=25)
    client.fly(2.0)
    assert reported == [True]
    assert client.place() == pytest.approx([4, 4, -5], abs=0.35)
    assert client.join("goHome", 60.0, "")[0] is True
    assert client.place() == pytest.approx([0, 0, -5], abs=0.35)


def test_velocities_of_the_world_and_of_the_body(client):
    client.at((0, 0, -20))
    done, seconds = client.join("moveByVelocity", 2.0, 1.0, -0.5, 2.0, *FREE, "")
    assert done is True
    assert seconds == pytest.approx(2.0)
    assert client.velocity() == pytest.approx([2, 1, -0.5], abs=0.25)
    client.fly(3.0)  # afterwards it stays
    assert client.velocity() == pytest.approx([0, 0, 0], abs=0.1)
    client.at((0, 0, -20), yaw=90)
    client.join("moveByVelocityBodyFrame", 2.0, 0.0, 0.0, 3.0, *FREE, "")
    assert client.velocity() == pytest.approx([0, 2, 0], abs=0.25)
    client.at((0, 0, -20))
    client.join("moveByVelocityZ", 1.0, 0.0, -21.0, 4.0, 1, RATE, "")
    assert client.place()[2] == pytest.approx(-21, abs=0.15)
    client.at((0, 0, -20), yaw=180)
    client.join("moveByVelocityZBodyFrame", 1.0, 1.0, -20.0, 3.0, *FREE, "")
    assert client.velocity() == pytest.approx([-1, -1, 0], abs=0.2)


def test_it_turns(client):
    client.at((0, 0, -5))
    done, seconds = client.join("rotateToYaw", 90.0, 20.0, 5.0, "")
    assert done is True
    assert seconds < 5
    client.fly(1.0)
    assert client.yaw() == pytest.approx(90, abs=2)
    client.join("rotateByYawRate", -30.0, 2.0, "")
    client.fly(2.0)
    assert client.yaw() == pytest.approx(35, abs=12)
    assert client.join("rotateToYaw", -90.0, 0.1, 1.0, "")[0] is False
    client.join("moveByVelocity", 0.0, 0.0, 0.0, 3.0, 0, {"is_rate": False, "yaw_or_rate": 45}, "")
    assert client.yaw() == pytest.approx(45, abs=5)


@pytest.mark.parametrize("name", [one for one in MOTIONS if "Roll" in one])
def test_attitudes(client, name):
    """Rolls to the right, and keeps its height; at a hovering throttle nearly."""
    client.at((0, 0, -20))
    frame = client.world.airspace.airframes[0]
    height = name.endswith("Z")
    share = frame.mass * 9.80665 / frame.max_thrust
    client.join(name, 0.15, 0.0, 0.0, -20.0 if height else share, 1.0, "")
    _, east, down = client.velocity()
    assert east > 0.5
    assert abs(down) < (0.1 if height else 0.5)


@pytest.mark.parametrize("name", ["moveByAngleRatesZ", "moveByAngleRatesThrottle"])
def test_rates(client, name):
    client.at((0, 0, -20))
    client.join(name, 0.0, -0.5, 0.4, -20.0 if name.endswith("Z") else 0.6, 0.5, "")
    _, pitch, yaw = client.read("angular_velocity")
    assert pitch == pytest.approx(-0.5, abs=0.15)
    assert yaw == pytest.approx(0.4, abs=0.2)


def test_motors_by_themselves(client, make_client):
    client.at((0, 0, -20))
    client.join("moveByMotorPWMs", 1.0, 1.0, 1.0, 1.0, 0.5, "")
    assert client.velocity()[2] < -1
    client.at((0, 0, -20))
    client.join("moveByMotorPWMs", 0.5, 0.6, 0.6, 0.5, 0.3, "")  # more on the left: to the right
    assert client.read("angular_velocity")[0] > 0.5
    six = make_client(airframe="firefly")
    six.ready()
    with pytest.raises(ValueError, match="firefly has 6 rotors"):
        six.begin("moveByMotorPWMs", 1.0, 1.0, 1.0, 1.0, 0.5, "")


def test_a_newer_motion_ends_the_older_one(client):
    client.at((0, 0, -5))
    older = client.begin("moveByVelocity", 1.0, 0.0, 0.0, 60.0, *FREE, "")
    newer = client.begin("moveByVelocity", 0.0, 1.0, 0.0, 60.0, *FREE, "")
    assert (older, newer) == ([False], [])
    client("cancelLastTask", "")
    assert newer == [False]
    hovering = client.begin("hover", "")
    client.world.step()
    assert hovering == [True]
    last = client.begin("moveByVelocity", 0.0, 1.0, 0.0, 60.0, *FREE, "")
    client("reset")
    assert last == [False]
    assert not client("isApiControlEnabled", "")


def test_who_gives_control_back_stays_where_it_is(client):
    client.at((0, 0, -5))
    reported = client.begin("moveByVelocity", 1.0, 0.0, 0.0, 60.0, *FREE, "")
    client.fly(1.0)
    client("enableApiControl", False, "")
    assert reported == [False]
    client.fly(3.0)
    assert client.velocity() == pytest.approx([0, 0, 0], abs=0.05)


def test_who_is_placed_onto_the_ground_stands_on_it(client):
    client.ready()
    client("simSetVehiclePose", pose((2.0, 1.0, 1e-9), yaw=30), True, "")
    client.fly(0.3)
    assert client.place() == pytest.approx([2, 1, 0], abs=1e-3)
    assert client("getMultirotorState", "")["landed_state"] == 0


def test_a_motion_that_takes_too_long_fails(client):
    client.at((0, 0, -5))
    assert client.join("moveToPosition", 50.0, 0.0, -5.0, 1.0, 0.5, *FREE, -1, 1, "")[0] is False
    assert client.join("land", 0.5, "")[0] is False


# Time


def test_steps_add_up_to_the_time_that_is_asked_for(client):
    steps = [client.calls.parse_steps("simContinueForTime", [1 / 30]) for _ in range(30)]
    assert sum(steps) == 100
    assert set(steps) == {3, 4}
    assert client.calls.parse_steps("simContinueForFrames", [7]) == 7
    for wrong in (-1.0, math.nan, 601.0, "1"):
        with pytest.raises(ValueError, match="seconds is"):
            client.calls.parse_steps("simContinueForTime", [wrong])
    client("simPause", True)
    assert client("simIsPaused") is True


def flight(client):
    client("reset")
    client.ready()
    client.begin("takeoff", 20.0, "")
    client.fly(1.0)
    client.begin("moveByVelocity", 1.0, 0.5, -0.5, 5.0, *FREE, "")
    client.fly(1.0)
    return client.world.airspace.swarm.position.tolist(), client.read("linear_acceleration")


def test_flights_after_a_reset_are_the_same_to_the_last_bit(client, make_client):
    once = flight(client)
    client.begin("moveByVelocity", -3.0, 0.5, -0.5, 5.0, *FREE, "")
    client.fly(0.7)
    assert flight(client) == once
    assert flight(make_client()) == once


# Touches


def test_what_was_hit_is_told_until_it_is_read(make_client):
    client = make_client(obstacles=(Obstacle("box", (2.0, 0.5, 4.0)),))
    client.world.airspace.place_obstacle(0, (0.0, 3.0, 2.0))  # to the north
    client.at((0, 0, -2))
    client.begin("moveByVelocity", 3.0, 0.0, 0.0, 3.0, *FREE, "")
    client.fly(2.5)
    assert client("getMultirotorState", "")["collision"]["has_collided"]
    reported = client("simGetCollisionInfo", "")
    assert reported["has_collided"]
    assert reported["object_name"] == "Obstacle0"
    assert reported["normal"]["x_val"] < -0.9
    assert reported["impact_point"]["x_val"] == pytest.approx(2.75, abs=0.3)
    assert reported["time_stamp"] > 0
    client("simSetVehiclePose", pose((0, 0, -2)), True, "")
    assert not client("simGetCollisionInfo", "")["has_collided"]


def test_drones_hit_each_other_and_the_ground(make_client):
    client = make_client(["Ann", "Bob"])
    for name in ("Ann", "Bob"):
        client.at((0, 0, -5), name)
    assert client("listVehicles") == ["Ann", "Bob"]
    client.begin("moveByVelocity", 0.0, 2.0, 0.0, 3.0, *FREE, "Ann")
    client.fly(2.0)
    assert client("simGetCollisionInfo", "Ann")["object_name"] == "Bob"
    assert client("simGetCollisionInfo", "Bob")["object_name"] == "Ann"
    client("armDisarm", False, "Bob")
    client.fly(2.0)
    assert client("simGetCollisionInfo", "Bob")["object_name"] == "Ground"


# Reading


def test_poses_are_relative_to_each_vehicles_start(make_client):
    client = make_client(2, places=[(0.0, 0.0), (3.0, 1.0)])
    client.at((1, 2, -3), "Drone2", yaw=30)
    assert client.place("Drone2") == pytest.approx([1, 2, -3])
    assert client.yaw("Drone2") == pytest.approx(30)
    np.testing.assert_allclose(
        client.world.airspace.swarm.position[1, :2], (3.0 + 2.0, 1.0 + 1.0), atol=1e-12
    )
    reported = client("simGetVehiclePose", "Drone2")
    reported["position"]["z_val"] = math.nan
    client("simSetVehiclePose", reported, True, "Drone2")
    assert client.place("Drone2") == pytest.approx([1, 2, -3])
    with pytest.raises(ValueError, match="drone 0 at .* would overlap the ground"):
        client("simSetVehiclePose", pose((0, 0, 1)), True, "")


def test_sensors_tell_what_they_would_measure_on_the_ground(client):
    client.fly(0.2)
    feel = client("getImuData", "", "")["linear_acceleration"]
    assert [feel[axis] for axis in VECTOR] == pytest.approx([0, 0, -9.80665], abs=0.05)
    air = client("getBarometerData", "", "")
    assert air["pressure"] == pytest.approx(float(pressure(122.0)), abs=5)
    assert air["altitude"] == pytest.approx(122, abs=0.5)
    field = client("getMagnetometerData", "", "")["magnetic_field_body"]
    # Near Redmond: 53 uT, 69 degrees down, 15 degrees to the east
    total = math.sqrt(sum(field[axis] ** 2 for axis in VECTOR))
    assert total == pytest.approx(0.53, abs=0.01)
    assert math.degrees(math.asin(field["z_val"] / total)) == pytest.approx(68.7, abs=1)
    assert math.degrees(math.atan2(field["y_val"], field["x_val"])) == pytest.approx(15.2, abs=1)
    fix = client("getGpsData", "", "")["gnss"]
    assert fix["geo_point"]["latitude"] == pytest.approx(47.641468, abs=1e-6)
    assert client("getHomeGeoPoint", "")["longitude"] == pytest.approx(-122.140165, abs=1e-6)
    around = client("simGetGroundTruthEnvironment", "")
    assert around["air_density"] == pytest.approx(1.21, abs=0.01)
    assert around["gravity"] == vector(0.0, 0.0, 9.80665)
    with pytest.raises(ValueError, match="has no lidar: list it in .*--lidar"):
        client("getLidarData", "", "")


def test_beams_of_the_lidar_end_on_what_is_there(make_client):
    client = make_client(lidar=True, obstacles=(Obstacle("box", (0.5, 8.0, 8.0)),))
    client.world.airspace.place_obstacle(0, (5.25, 0.0, 3.0))  # to the east
    client.at((0, 0, -2), yaw=40)
    client.fly(0.2)
    points = np.array(client("getLidarData", "", "")["point_cloud"]).reshape(-1, 3)
    ground, wall = points[points[:, 2] > -0.2], points[points[:, 2] < -0.5]
    np.testing.assert_allclose(ground[:, 2], client.world.vehicle("")[1].start[2], atol=0.05)
    assert len(ground) > 50
    assert len(wall) > 3
    np.testing.assert_allclose(wall[:, 1], 5.0, atol=0.1)


def test_pictures(make_client):
    client = make_client(obstacles=(Obstacle("box", (2.0, 0.5, 2.0)),))
    client.world.airspace.place_obstacle(0, (0.0, 4.25, 3.0))
    client.at((0, 0, -3))
    raw, flat, far, grey = client(
        "simGetImages",
        [
            request("0", 0),
            request("front_center", 1, pixels_as_float=True),
            request("0", 2, pixels_as_float=True),
            request("3", 3, compress=True),
        ],
        "",
    )
    assert (raw["width"], raw["height"]) == (256, 144)
    assert len(raw["image_data_uint8"]) == 3 * 256 * 144
    depth = np.array(flat["image_data_float"]).reshape(144, 256)
    nose = client.world.airspace.airframes[0].collision_radius
    assert depth[72, 128] == pytest.approx(4 - nose, abs=0.05)
    slant = np.array(far["image_data_float"]).reshape(144, 256)
    assert slant[72, 128] == pytest.approx(depth[72, 128], rel=1e-3)
    assert slant[143, 255] > 1.3 * depth[143, 255]
    (share,) = client("simGetImages", [request("0", 3, pixels_as_float=True)], "")
    np.testing.assert_allclose(share["image_data_float"], np.minimum(depth.ravel() / 100, 1))
    reported = Image.open(io.BytesIO(grey["image_data_uint8"]))
    assert reported.getpixel((128, 72))[0] == pytest.approx(255 * 3 / 100, abs=1.0)
    labels = np.array(Image.open(io.BytesIO(client("simGetImage", "0", 5, ""))))
    assert labels[72, 128].tolist() == [220, 60, 50]
    assert labels[143, 128].tolist() == [80, 120, 60]
    place = raw["camera_position"]
    assert [place[axis] for axis in VECTOR] == pytest.approx([nose, 0, -3], abs=0.02)
    for wrong, said in (
        (request("0", 7), "image_type is 7"),
        (request("7", 0), "unknown camera '7'"),
        (request("0", 0, pixels_as_float=True), "pixels_as_float is for depths"),
        ("scene", "a map is needed"),
    ):
        with pytest.raises(ValueError, match=said):
            client("simGetImages", [wrong], "")


def test_wind_blows(client):
    client("simSetWind", vector(0.0, 8.0, 0.0))
    client.at((0, 0, -20))
    client("armDisarm", False, "")
    client.fly(1.0)
    assert client.velocity()[1] > 0.2
    with pytest.raises(ValueError, match="wind is"):
        client("simSetWind", vector(0.0, 800.0, 0.0))


# What cannot be


@pytest.mark.parametrize(
    ("name", "arguments", "said"),
    [
        ("getMultirotorStat", [""], "did you mean 'getMultirotorState'"),
        (7, [], "unknown call 7"),
        ("getMultirotorState", ["Drone9"], "unknown vehicle 'Drone9'"),
        ("getMultirotorState", [["x"]], "unknown vehicle"),
        ("getMultirotorState", ["", 1, 2], "too many positional arguments"),
        ("simSetVehiclePose", [1, True, ""], "a map of position and orientation"),
        ("simSetVehiclePose", [{"position": vector(0.0, 0.0, 1e9)}, True, ""], "position is"),
        ("simSetVehiclePose", [{"position": vector(0.0, 0.0, "1")}, True, ""], "position is"),
        ("simSetVehiclePose", [pose((0, 0, -1)) | {"orientation": STILL}, True, ""], "zero length"),
        ("simSetWind", [vector(0.0, math.nan, 0.0)], "finite numbers are needed"),
        ("simGetImages", [7, ""], "requests is 7"),
        ("armDisarm", [True, ""], "enableApiControl"),
        ("simSetCameraPose", ["9", pose((0, 0, 0)), "", False], "unknown camera '9'"),
        ("simGetCameraInfo", ["0", "", True], "does not stand in the world"),
        ("simGetCameraInfo", ["0", "", 1], "external is 1"),
        ("simSetCameraFov", ["0", 180, "", False], "fov_degrees is 180"),
        ("simListSceneObjects", ["(a+)+"], "name_regex is"),
        ("simListSceneObjects", ["[a"], "name_regex is"),
        ("simListSceneObjects", ["a*b*c*d*"], "name_regex is"),
        ("simAddVehicle", ["Ann", "PhysXCar", pose((0, 0, 0)), ""], "unknown vehicle_type"),
        ("simAddVehicle", ["SimpleFlight", "SimpleFlight", pose((0, 0, 0)), ""], "a new name"),
        ("simAddVehicle", ["A" * 65, "SimpleFlight", pose((0, 0, 0)), ""], "a new name"),
        ("startRecording", [], "start the server with --recordings FOLDER"),
        ("moveByRC", [{"roll": 0.0}, ""], "pitch is None"),
        ("simSetKinematics", [1, True, ""], "a map of a KinematicsState"),
        ("simTestLineOfSightToPoint", [{"latitude": 91.0}, ""], "latitude is 91"),
        ("simGetDetections", ["0", 12, "", False], "image_type is 12"),
        ("simAddDetectionFilterMeshName", ["0", 0, "****", "", False], "mesh_name is"),
    ],
)
def test_calls_that_cannot_be_are_told(client, name, arguments, said):
    with pytest.raises(ValueError, match=said):
        client.calls.call(name, arguments)


@pytest.mark.parametrize(
    ("name", "arguments", "said"),
    [
        ("takeoff", [20.0], "needs a vehicle's name"),
        ("takeoff", [], "needs a vehicle's name"),
        ("takeoff", ["x", ""], "timeout_sec is 'x'"),
        ("takeoff", [1.0, 2.0, ""], "too many"),
        ("moveToZ", [math.nan, 1.0, 9.0, RATE, -1, 1, ""], "z is nan"),
        ("moveToZ", [-1.0, 0.0, 9.0, RATE, -1, 1, ""], "velocity is 0 m/s"),
        ("moveByVelocity", [1.0, 0.0, 0.0, 1.0, 7, RATE, ""], "drivetrain is 7"),
        ("moveByVelocity", [1.0, 0.0, 0.0, 1.0, 0, 5, ""], "yaw_mode is 5"),
        ("moveOnPath", [[], 1.0, 9.0, *FREE, -1, 1, ""], "path is empty"),
        ("moveOnPath", [[1], 1.0, 9.0, *FREE, -1, 1, ""], "point is 1"),
    ],
)
def test_motions_that_cannot_be_leave_the_drone_as_it_was(client, name, arguments, said):
    client.at((0, 0, -5))
    with pytest.raises(ValueError, match=said):
        client.begin(name, *arguments)
    client.fly(0.5)
    assert client.place() == pytest.approx([0, 0, -5], abs=0.02)


BOOL, TEXT, NUMBER, TIME, WHOLE, VECTORS, POSE, PATH = range(8)
YAW_MODE, REQUESTS, CAMERA, VEHICLE, STATE, REMOTE, GEO, COLOUR, POINTS, TEXTS, POSES, ANGLE = (
    range(8, 20)
)
"""Kinds of arguments"""
GOOD = {
    BOOL: True,
    TEXT: "",
    NUMBER: 1.0,
    TIME: 1.0,
    WHOLE: 1,
    VECTORS: vector(1.0, 0.0, 0.0),
    POSE: pose((0, 0, -5)),
    PATH: [vector(1.0, 0.0, -5.0)],
    YAW_MODE: RATE,
    REQUESTS: [{"camera_name": "0", "image_type": 0, "pixels_as_float": False, "compress": True}],
    CAMERA: "0",
    VEHICLE: "",
    STATE: pose((0, 0, -5))
    | {"linear_velocity": vector(1.0, 0.0, 0.0), "angular_velocity": vector(0.0, 0.0, 1.0)},
    REMOTE: dict.fromkeys(("roll", "pitch", "throttle", "yaw"), 0.5) | {"is_valid": True},
    GEO: {"latitude": 47.64, "longitude": -122.14, "altitude": 150.0},
    POINTS: [vector(1.0, 0.0, 0.0)] * 2,
    COLOUR: [1.0, 0.0, 0.0, 1.0],
    TEXTS: ["a", "b"],
    ANGLE: 60.0,
    POSES: [pose((0, 0, -5))] * 2,
}
SEEN = (CAMERA, WHOLE)
PLOT = (COLOUR, NUMBER, NUMBER)
MOVE, LOOK = (NUMBER, TIME, WHOLE, YAW_MODE, NUMBER, NUMBER, VEHICLE), (TIME, WHOLE, YAW_MODE)
ARGUMENTS = {
    "ping": (),
    "getServerVersion": (),
    "getMinRequiredClientVersion": (),
    "reset": (),
    "simPause": (BOOL,),
    "simIsPaused": (),
    "listVehicles": (),
    "getSettingsString": (),
    "stopRecording": (),
    "isRecording": (),
    "simSetWind": (VECTORS,),
    "enableApiControl": (BOOL, VEHICLE),
    "isApiControlEnabled": (VEHICLE,),
    "armDisarm": (BOOL, VEHICLE),
    "cancelLastTask": (VEHICLE,),
    "simSetVehiclePose": (POSE, BOOL, VEHICLE),
    "simGetVehiclePose": (VEHICLE,),
    "getHomeGeoPoint": (VEHICLE,),
    "simGetCollisionInfo": (VEHICLE,),
    "simPrintLogMessage": (TEXT, TEXT, WHOLE),
    "getMultirotorState": (VEHICLE,),
    "simGetGroundTruthKinematics": (VEHICLE,),
    "simGetGroundTruthEnvironment": (VEHICLE,),
    "getRotorStates": (VEHICLE,),
    "getImuData": (TEXT, VEHICLE),
    "getBarometerData": (TEXT, VEHICLE),
    "getMagnetometerData": (TEXT, VEHICLE),
    "getGpsData": (TEXT, VEHICLE),
    "getLidarData": (TEXT, VEHICLE),
    "getDistanceSensorData": (TEXT, VEHICLE),
    "simSetKinematics": (STATE, BOOL, VEHICLE),
    "moveByRC": (REMOTE, VEHICLE),
    "simSetCameraPose": (CAMERA, POSE, VEHICLE),
    "simSetCameraFov": (CAMERA, ANGLE, VEHICLE),
    "simGetCameraInfo": (CAMERA, VEHICLE),
    "simAddDetectionFilterMeshName": (*SEEN, TEXT, VEHICLE),
    "simSetDetectionFilterRadius": (*SEEN, NUMBER, VEHICLE),
    "simClearDetectionMeshNames": (*SEEN, VEHICLE),
    "simGetDetections": (*SEEN, VEHICLE),
    "simListSceneObjects": (TEXT,),
    "simGetObjectPose": (TEXT,),
    "simSetObjectPose": (TEXT, POSE, BOOL),
    "simTestLineOfSightToPoint": (GEO, VEHICLE),
    "simTestLineOfSightBetweenPoints": (GEO, GEO),
    "simGetWorldExtents": (),
    "simSetSegmentationObjectID": (TEXT, WHOLE, BOOL),
    "simGetSegmentationObjectID": (TEXT,),
    "simPlotPoints": (POINTS, *PLOT, BOOL),
    "simPlotLineStrip": (POINTS, *PLOT, BOOL),
    "simPlotLineList": (POINTS, *PLOT, BOOL),
    "simPlotArrows": (POINTS, POINTS, COLOUR, NUMBER, NUMBER, NUMBER, BOOL),
    "simPlotStrings": (TEXTS, POINTS, NUMBER, COLOUR, NUMBER),
    "simPlotTransforms": (POSES, NUMBER, NUMBER, NUMBER, BOOL),
    "simPlotTransformsWithNames": (POSES, TEXTS, NUMBER, NUMBER, NUMBER, COLOUR, NUMBER),
    "simFlushPersistentMarkers": (),
    "simSetTraceLine": (COLOUR, NUMBER, VEHICLE),
    "simContinueForTime": (TIME,),
    "simContinueForFrames": (WHOLE,),
    "simGetImage": (CAMERA, WHOLE, VEHICLE),
    "simGetImages": (REQUESTS, VEHICLE),
    "takeoff": (TIME, VEHICLE),
    "land": (TIME, VEHICLE),
    "goHome": (TIME, VEHICLE),
    "hover": (VEHICLE,),
    "moveToPosition": (NUMBER, NUMBER, NUMBER, *MOVE),
    "moveOnPath": (PATH, *MOVE),
    "moveToGPS": (*(NUMBER,) * 3, *MOVE),
    "moveByManual": (*(NUMBER,) * 3, *LOOK, VEHICLE),
    "moveToZ": (NUMBER, NUMBER, TIME, YAW_MODE, NUMBER, NUMBER, VEHICLE),
    "rotateToYaw": (NUMBER, TIME, NUMBER, VEHICLE),
    "rotateByYawRate": (NUMBER, TIME, VEHICLE),
    "moveByMotorPWMs": (NUMBER,) * 4 + (TIME, VEHICLE),
    **{
        f"moveByVelocity{rest}": (NUMBER,) * 3 + (*LOOK, VEHICLE)
        for rest in ("", "Z", "BodyFrame", "ZBodyFrame")
    },
    **{
        f"moveBy{rest}": (NUMBER,) * 4 + (TIME, VEHICLE)
        for rest in (
            "RollPitchYawZ",
            "RollPitchYawThrottle",
            "RollPitchYawrateZ",
            "RollPitchYawrateThrottle",
            "AngleRatesZ",
            "AngleRatesThrottle",
        )
    },
}
"""Kinds of the arguments of all calls"""
NESTED = [[[[[[[["x"]]]]]]]]
ODD = (
    None,
    True,
    2.5,
    -1,
    10**30,
    1e300,
    math.nan,
    math.inf,
    "x",
    b"x",
    [],
    {},
    NESTED,
    {"x": NESTED},
)


def fits(kind, value):
    """Return True if a value of `ODD` can be an argument of a kind."""
    if kind == BOOL:
        return value is True
    if kind == TEXT:
        return isinstance(value, str)
    is_number = isinstance(value, int | float) and value is not True and math.isfinite(value)
    if kind in (NUMBER, TIME):  # long times are cut
        return is_number and (value >= 0 if kind == TIME else abs(value) < 1e5)
    return kind in (REQUESTS, POINTS, TEXTS, POSES) and value == []


def parts_of(kind):
    """Yield values of a kind of which one part is odd, with the part's own kind."""
    good = GOOD[kind]
    if kind == VECTORS:
        for key in good:
            yield from ((good | {key: odd}, NUMBER, odd) for odd in ODD)
    elif kind in (STATE, REMOTE, GEO):
        for key, value in good.items():
            wanted = BOOL if isinstance(value, bool) else NUMBER if kind != STATE else STATE
            yield from ((good | {key: odd}, wanted, odd) for odd in ODD)
    elif kind in (PATH, POINTS):
        yield from (([part], *rest) for part, *rest in parts_of(VECTORS))
    elif kind == POSE:
        # What is NaN stays as it is
        for part, wanted, odd in parts_of(VECTORS):
            if odd == odd:
                yield good | {"position": part}, wanted, odd
        yield from ((good | {key: odd}, POSE, odd) for key in good for odd in ODD)
    elif kind == YAW_MODE:
        yield from ((good | {"is_rate": odd}, BOOL, odd) for odd in ODD)
        yield from ((good | {"yaw_or_rate": odd}, NUMBER, odd) for odd in ODD)
    elif kind == REQUESTS:
        kinds = (CAMERA, WHOLE, BOOL, BOOL)
        for (key, _), wanted in zip(good[0].items(), kinds, strict=True):
            yield from (([good[0] | {key: odd}], wanted, odd) for odd in ODD)


def odd_arguments(kinds):
    """Yield arguments of which one is odd, and whether they are good all the same."""
    good = [GOOD[kind] for kind in kinds]
    for k, kind in enumerate(kinds):
        for value, wanted, odd in [*((odd, kind, odd) for odd in ODD), *parts_of(kind)]:
            yield [*good[:k], value, *good[k + 1 :]], fits(wanted, odd)
    yield [*good, 5], False
    if kinds:
        yield good[:-1], None  # some may be left out


def try_call(calls, name, arguments):
    """Make a call without network or pictures; return the message of its error, or None."""
    try:
        if name in MOTIONS:
            calls.start_motion(name, arguments, lambda done: None)
        elif name in IMAGE_CALLS:
            calls.parse_images(name, arguments)
        elif name in CONTINUE_CALLS:
            calls.parse_steps(name, arguments)
        else:
            calls.call(name, arguments)
    except ValueError as error:
        return str(error)
    return None


def test_all_calls_check_all_their_arguments(make_client):
    """Odd ones are one clear error, or values that were meant; never anything else."""
    sensors = {"Distance": {"SensorType": 5}}
    settings = parse_settings({"DefaultSensors": sensors})
    # The home is where `moveToGPS` with its good arguments flies
    client = make_client(lidar=True, settings=settings, home=(1.0, 1.0, 1.0))
    client.at((0, 0, -5))
    # Names of added vehicles can only be used once, and there is no folder for recordings
    assert sorted([*ARGUMENTS, "simAddVehicle", "startRecording"]) == client.calls.list_names()
    for name, kinds in ARGUMENTS.items():
        client.ready()
        assert try_call(client.calls, name, [GOOD[kind] for kind in kinds]) is None
        for arguments, is_good in odd_arguments(kinds):
            client.ready()
            reported = try_call(client.calls, name, arguments)
            if is_good is not None:
                # Bounds of their own may be narrower
                assert is_good or reported is not None, (name, arguments)
            assert reported is None or (reported.isprintable() and len(reported) < 1000)
            assert reported is None or not re.search(r"array\(|Error|<.* object", reported), (
                reported
            )
        client.calls.call("simPause", [False])


def test_who_has_no_control_does_not_move(client):
    with pytest.raises(ValueError, match="enableApiControl"):
        client.begin("takeoff", 20.0, "")
    client("enableApiControl", True, "")
    client("armDisarm", False, "")
    with pytest.raises(ValueError, match="not armed"):
        client.begin("takeoff", 20.0, "")
    assert client.place() == pytest.approx([0, 0, 0])


def test_worlds_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="names must be unique"):
        AirsimWorld(["a", "a"])
    with pytest.raises(ValueError, match="a number of vehicles, or their names"):
        AirsimWorld([])
    with pytest.raises(ValueError, match="places are 1: one for each of 2"):
        AirsimWorld(2, places=[(0, 0)])
    with pytest.raises(ValueError, match="decision_hz is fixed at 100"):
        AirsimWorld(1, decision_hz=50)


def test_the_old_name_of_the_world_warns():
    with pytest.warns(DeprecationWarning, match="World is now AirsimWorld; .* next release"):
        assert airsim_world.World is AirsimWorld
    with pytest.raises(AttributeError, match="no attribute 'Worlds'"):
        _ = airsim_world.Worlds
