"""AirSim's settings files: vehicles, cameras, sensors, and what has no effect."""

import json
import math

import numpy as np
import pytest

from bulletuav.bridges.airsim_calls import AirsimCalls
from bulletuav.bridges.airsim_settings import (
    AirsimSettings,
    VehicleSettings,
    list_ignored,
    parse_settings,
    read_airsim_settings,
)
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.cli import main
from bulletuav.geometry.obstacle import Obstacle

LIDAR = {
    "SensorType": 6,
    "NumberOfChannels": 2,
    "PointsPerSecond": 80,
    "RotationsPerSecond": 10,
    "Range": 20,
    "VerticalFOVUpper": 0,
    "VerticalFOVLower": -90,
    "HorizontalFOVStart": 0,
    "HorizontalFOVEnd": 270,
}
FILE = {
    "SettingsVersion": 1.2,
    "SimMode": "Multirotor",
    "ClockSpeed": 2,
    "ViewMode": "Fpv",
    "OriginGeopoint": {"Latitude": 47.4, "Longitude": 8.5, "Altitude": 500},
    "Wind": {"X": 3, "Y": 0, "Z": 0},
    "CameraDefaults": {"CaptureSettings": [{"ImageType": 0, "Width": 64, "Height": 48}]},
    "Vehicles": {
        "Drone_0": {
            "VehicleType": "SimpleFlight",
            "X": 4,
            "Y": 3,
            "Z": -2,
            "Yaw": 90,
            "EnableTrace": True,
            "Cameras": {
                "wide": {
                    "CaptureSettings": [{"ImageType": 1, "Width": 40, "FOV_Degrees": 120}],
                    "X": 0.5,
                    "Pitch": -90,
                    "Gimbal": {"Stabilization": 1},
                }
            },
            "Sensors": {
                "Down": {"SensorType": 5, "Pitch": -90, "MaxDistance": 10},
                "Imu": {"SensorType": 2, "AngularRandomWalk": 0.3},
                "Lidar": LIDAR,
                "Local": {**LIDAR, "DataFrame": "SensorLocalFrame", "Z": -1},
                "Off": {**LIDAR, "Enabled": False},
            },
        },
        "Later": {"VehicleType": "SimpleFlight", "AutoCreate": False},
    },
}


@pytest.fixture
def calls():
    """Calls a vehicle of the file, which stands in front of a wall in the east."""
    world = AirsimWorld(settings=parse_settings(FILE), obstacles=[Obstacle("box", (1, 9, 9))])
    world.airspace.place_obstacle(0, (9.5, 4.0, 4.0))
    made = AirsimCalls(world)

    def call(name, *arguments):
        return made.call(name, list(arguments))

    call.world = world
    yield call
    world.close()


def test_a_file_is_read_and_ignored_keys_are_listed(tmp_path):
    path = tmp_path / "settings.json"
    path.write_text(json.dumps(FILE), encoding="utf-8-sig")
    settings = read_airsim_settings(path)
    assert list(settings.vehicles) == ["Drone_0"]
    assert settings.clock_speed == 2
    assert settings.origin == (47.4, 8.5, 500)
    assert json.loads(settings.text) == FILE
    assert settings.ignored == (
        "Vehicles.Drone_0.Cameras.wide.Gimbal",
        "Vehicles.Drone_0.Sensors.Imu.AngularRandomWalk",
        "Vehicles.Drone_0.EnableTrace",
        "ViewMode",
    )


@pytest.mark.parametrize(("state", "is_armed"), [("", True), ("Armed", True), ("Disarmed", False)])
def test_vehicles_are_armed_at_the_start_and_after_a_reset(state, is_armed):
    settings = parse_settings({"Vehicles": {"Ann": {"DefaultVehicleState": state}}})
    world = AirsimWorld(settings=settings)
    vehicle = world.vehicle("")[1]
    assert vehicle.is_armed is is_armed
    vehicle.is_armed = not is_armed
    world.reset()
    assert vehicle.is_armed is is_armed
    world.close()


def test_ignored_keys_are_listed_without_control_characters():
    sensors = {"s\x1b": {"SensorType": 9}}
    settings = parse_settings({"DefaultSensors": sensors, "Vehicles": {"a": {"q\n": 1}}})
    assert list_ignored(settings.ignored) == (
        r"DefaultSensors.s\x1b (SensorType 9), Vehicles.a.q\n"
    )


def test_an_empty_file_changes_nothing():
    assert parse_settings({"SeeDocsAt": "x", "SettingsVersion": 1.2}) == AirsimSettings()


def test_vehicles_start_where_the_file_says(calls):
    world = calls.world
    assert calls("listVehicles") == ["Drone_0"]
    height = world.airspace.airframes[0].standing_height
    np.testing.assert_allclose(world.airspace.swarm.position[0], (3, 4, 2 + height))
    assert calls("getHomeGeoPoint", "")["latitude"] == pytest.approx(47.4, abs=1e-4)
    turn = calls("simGetVehiclePose", "Drone_0")["orientation"]
    assert 2 * math.atan2(turn["z_val"], turn["w_val"]) == pytest.approx(math.pi / 2)
    # Without motors it falls
    for _ in range(100):
        world.step()
    fallen = calls("getMultirotorState", "PX4")["kinematics_estimated"]["position"]
    assert fallen["z_val"] == pytest.approx(2.0, abs=0.05)
    assert world.airspace.world.wind.steady[0].tolist() == [0, 3, 0]


def test_a_single_vehicle_answers_to_the_default_names(calls):
    for name in ("", "Drone_0", "SimpleFlight", "PX4"):
        assert calls("isApiControlEnabled", name) is False
    with pytest.raises(ValueError, match="unknown vehicle 'Drone_1'"):
        calls("isApiControlEnabled", "Drone_1")


def test_cameras_have_the_sizes_and_poses_of_the_file(calls):
    scene, depth, front = calls(
        "simGetImages",
        [
            {"camera_name": "0", "image_type": 0},
            {"camera_name": "wide", "image_type": 1, "pixels_as_float": True},
            {"camera_name": "front_center", "image_type": 2, "pixels_as_float": True},
        ],
        "",
    )
    assert (scene["width"], scene["height"]) == (64, 48)
    assert (depth["width"], depth["height"]) == (40, 144)
    assert (front["width"], front["height"]) == (256, 144)
    # It looks down from 2 m, half a metre ahead
    centre = np.array(depth["image_data_float"]).reshape(144, 40)[72, 20]
    assert centre == pytest.approx(calls.world.airspace.swarm.position[0, 2], abs=0.03)
    assert depth["camera_position"]["y_val"] == pytest.approx(0.5)


def test_distance_sensors_and_lidars_measure_along_their_axes(calls):
    height = calls.world.airspace.swarm.position[0, 2]
    down = calls("getDistanceSensorData", "", "")
    assert down["distance"] == pytest.approx(height, abs=1e-3)
    assert (down["min_distance"], down["max_distance"]) == (0.2, 10)
    assert down["relative_pose"]["orientation"]["y_val"] == pytest.approx(-math.sqrt(0.5))
    # Four beams of each channel: ahead (east) is the wall, and four times the ground
    points = np.array(calls("getLidarData", "Lidar", "")["point_cloud"]).reshape(-1, 3)
    assert len(points) == 5
    np.testing.assert_allclose(points[0], (0, 6, 0), atol=1e-3)
    np.testing.assert_allclose(points[1:], [(0, 0, height)] * 4, atol=1e-3)
    local = calls("getLidarData", "Local", "")
    points = np.array(local["point_cloud"]).reshape(-1, 3)
    np.testing.assert_allclose(points[0], (6, 0, 0), atol=1e-3)
    np.testing.assert_allclose(points[1:], [(0, 0, height + 1)] * 4, atol=1e-3)
    assert local["pose"]["position"]["z_val"] == pytest.approx(-1)
    with pytest.raises(ValueError, match="unknown lidar 'Off'"):
        calls("getLidarData", "Off", "")


def test_cameras_in_the_world_see_the_vehicle():
    camera = {
        "X": 5,
        "Y": -3,
        "Z": -2,
        "Yaw": 90,
        "CaptureSettings": [{"ImageType": 1, "Width": 80}],
    }
    settings = parse_settings({"ExternalCameras": {"Watch": camera}})
    world = AirsimWorld(settings=settings, places=[(0, 5)])
    call = AirsimCalls(world).call
    world.place(0, np.array((0.0, 0.0, -2.0)), np.array((0.0, 0.0, 0.0, 1.0)))
    request = {"camera_name": "Watch", "image_type": 1, "pixels_as_float": True}
    (image,) = call("simGetImages", [[request], "", True])
    assert (image["width"], image["height"]) == (80, 144)
    centre = np.array(image["image_data_float"]).reshape(144, 80)[68:76, 36:44]
    assert centre.min() == pytest.approx(3.0, abs=0.3)
    assert image["camera_position"]["x_val"] == pytest.approx(5)
    with pytest.raises(ValueError, match="unknown camera 'Watch'"):
        call("simGetImage", ["Watch", 0, "", False])
    world.close()


def make_vehicle_with_cameras(*names):
    cameras = {name: {"X": k + 1} for k, name in enumerate(names)}
    return AirsimWorld(settings=parse_settings({"Vehicles": {"Ann": {"Cameras": cameras}}}))


def test_cameras_whose_names_differ_by_a_dash_are_different():
    names = ("a-b", "a_b", "front-center")
    world = make_vehicle_with_cameras(*names)
    call = AirsimCalls(world).call

    def forward(name):
        return call("simGetCameraInfo", [name, ""])["pose"]["position"]["x_val"]

    assert [forward(name) for name in names] == pytest.approx([1, 2, 3])
    # AirSim's own cameras have other names, too
    assert [forward(name) for name in ("front_center", "0")] == pytest.approx([3, 3])
    world.close()


@pytest.mark.parametrize("names", [("front-center", "front_center"), ("front_left", "2")])
def test_a_camera_that_is_listed_twice_is_an_error(names):
    with pytest.raises(ValueError, match="is listed twice, as it is 'front_.*': leave one out"):
        make_vehicle_with_cameras(*names)


def test_cameras_in_the_world_have_any_names():
    names = ["cam-1", "cam_2", "0", "front-center"]
    cameras = {name: {"X": k + 1} for k, name in enumerate(names)}
    world = AirsimWorld(settings=parse_settings({"ExternalCameras": cameras}))
    call = AirsimCalls(world).call

    def north(name):
        return call("simGetCameraInfo", [name, "", True])["pose"]["position"]["x_val"]

    assert [north(name) for name in names] == pytest.approx([1, 2, 3, 4])
    assert north("cam-2") == pytest.approx(2)
    with pytest.raises(ValueError, match="unknown camera '1'"):
        north("1")
    world.close()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("ev\til\n\x1b[31m", r"'ev\\til\\n\\x1b\[31m': a new name of 1 to 64 printable letters"),
        ("a" * 65, "a new name of 1 to 64 printable letters"),
        ("Ground", "'Ground', the name of another object"),
        ("Building", "'Building', the name of another object"),
        ("Obstacle0", "'Obstacle0', the name of another object"),
    ],
)
def test_names_of_vehicles_are_checked(name, message):
    with pytest.raises(ValueError, match=message):
        AirsimWorld(settings=parse_settings({"Vehicles": {name: {}}}))
    with pytest.raises(ValueError, match=message):
        AirsimWorld([name])
    world = AirsimWorld()
    with pytest.raises(ValueError, match=message):
        world.add_vehicle(name, VehicleSettings())
    world.close()


def test_options_override_the_settings():
    place = {"Latitude": 47.4, "Longitude": 8.5, "Altitude": 500}
    settings = parse_settings({"Wind": {"X": 1}, "OriginGeopoint": place})
    world = AirsimWorld(settings=settings)
    assert world.airspace.world.wind.steady[0] == pytest.approx((0, 1, 0))
    world.close()
    world = AirsimWorld(settings=settings, wind=(5, 0, 0), home=(1, 2, 3))
    assert world.airspace.world.wind.steady[0] == pytest.approx((5, 0, 0))
    assert world.origin.latitude == 1
    world.close()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"SimMode": "Car"}, "SimMode is 'Car': only 'Multirotor'"),
        ({"Vehicles": []}, "Vehicles is .*: an object is needed"),
        ({"Vehicles": {"a": {"VehicleType": "PhysXCar"}}}, "Vehicles.a.VehicleType 'PhysXCar'"),
        ({"Vehicles": {"a": {"X": "1"}}}, "Vehicles.a.X is '1'"),
        ({"Vehicles": {"a\x1b": {"X": "1"}}}, r"Vehicles.a\\x1b.X is '1'"),
        ({"Vehicles": {"a": {"X": 1e300}}}, "Vehicles.a.X is 1e.300"),
        ({"Vehicles": {"a": {"DefaultVehicleState": "x"}}}, "a.DefaultVehicleState 'x'"),
        ({"Vehicles": {"": {}}}, "Vehicles has an entry without a name"),
        ({"Vehicles": {str(k): {} for k in range(300)}}, "Vehicles has 300 entries: at most 256"),
        ({"ClockSpeed": 0}, "ClockSpeed is 0"),
        ({"ApiServerPort": 70000}, "ApiServerPort is 70000"),
        ({"OriginGeopoint": {"Latitude": 1}}, "OriginGeopoint has no Longitude, Altitude"),
        (
            {"CameraDefaults": {"CaptureSettings": [{"Width": 4096, "Height": 4096}]}},
            r"CaptureSettings\[0\].Width is 4096 and Height 4096: at most 5000000 pixels",
        ),
        ({"CameraDefaults": {"CaptureSettings": {}}}, "CameraDefaults.CaptureSettings"),
        ({"Recording": {"Cameras": [{"ImageType": 99}]}}, r"Recording.Cameras\[0\].ImageType"),
        (
            {"DefaultSensors": {"L": {"SensorType": 6, "PointsPerSecond": 10**8}}},
            "DefaultSensors.L.PointsPerSecond gives 10000000 points",
        ),
        ({"DefaultSensors": {"L": {**LIDAR, "DataFrame": "x"}}}, "DefaultSensors.L.DataFrame 'x'"),
    ],
)
def test_wrong_values_are_one_error_with_the_key(change, message, tmp_path):
    path = tmp_path / "settings.json"
    path.write_text(json.dumps(change))
    with pytest.raises(ValueError, match=message) as error:
        read_airsim_settings(path)
    assert "settings.json" in str(error.value)


@pytest.mark.parametrize("content", ["{", "[1]", '{"a": 1, "a": 2}', "\0", "[" * 9000])
def test_damaged_files_are_one_error(content, tmp_path):
    path = tmp_path / "settings.json"
    path.write_text(content)
    with pytest.raises(ValueError, match=r"settings\.json"):
        read_airsim_settings(path)


def test_large_files_are_not_read(tmp_path):
    path = tmp_path / "settings.json"
    path.write_text(" " * 2**21)
    with pytest.raises(ValueError, match="larger than 1048576 bytes"):
        read_airsim_settings(path)


def test_vehicles_are_those_of_the_file_or_of_the_options():
    with pytest.raises(ValueError, match="the settings list the vehicles Drone_0"):
        AirsimWorld(3, settings=parse_settings(FILE))


def test_the_command_serves_the_file_and_lists_ignored_keys(tmp_path, capsys):
    path = tmp_path / "settings.json"
    path.write_text(json.dumps({**FILE, "ApiServerPort": 0}))
    main(["serve", "airsim", "--settings", str(path), "--seconds", "0.1"])
    printed = capsys.readouterr().out
    assert "settings.json: these keys have no effect: Vehicles.Drone_0.Cameras.wide.G" in printed
    assert "Drone_0 at 127.0.0.1:" in printed


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["mavlink"], "--settings has no effect on mavlink"),
        (["airsim", "--wind", "1", "0", "0"], "--wind is given, and Wind in the settings file"),
    ],
)
def test_options_that_contradict_the_file_are_errors(words, message, tmp_path, capsys):
    path = tmp_path / "settings.json"
    path.write_text(json.dumps(FILE))
    with pytest.raises(SystemExit):
        main(["serve", *words, "--settings", str(path)])
    assert message in capsys.readouterr().err
