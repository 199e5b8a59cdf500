"""AirSim's calls for cameras, objects, detections, added vehicles and remote controls."""

import math
from collections import Counter

import numpy as np
import pytest
from bridges.airsim_world_client import FREE, pose, request, vector

from bulletuav.bridges.airsim_segmentation import LABEL_COLOURS, make_label_colour
from bulletuav.engine.visual_scene import VisualScene
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.solids import Solids
from bulletuav.geometry.view import BUILDING, DRONE, LAND, OBSTACLE

BOX = Obstacle("box", (2.0, 2.0, 2.0))


@pytest.fixture
def client(make_client):
    """A vehicle in the air, whose obstacle is 10 m to the north; another one is not placed."""
    client = make_client(obstacles=(BOX, BOX))
    client.world.airspace.place_obstacle(0, (0.0, 10.0, 5.0))
    client.at((0, 0, -5))
    return client


def position(reported):
    return [reported["position"][axis] for axis in ("x_val", "y_val", "z_val")]


def rotated(axis, degrees):
    """A pose on the vehicle that is turned about an axis (0 to 2: forward, right, down)."""
    half = math.radians(degrees) / 2
    turn = [math.sin(half) * (k == axis) for k in range(3)]
    return {
        "position": vector(0.0, 0.0, 0.5 * (axis == 1)),
        "orientation": {"w_val": math.cos(half), **vector(*turn)},
    }


def depth(client, camera="0"):
    """Depth in the centre of a camera's image."""
    asked = [request(camera, 1, pixels_as_float=True)]
    (image,) = client("simGetImages", asked, "")
    return np.array(image["image_data_float"]).reshape(image["height"], -1)[72, 128]


def test_a_camera_turns_and_moves(client):
    assert depth(client) == pytest.approx(8.6, abs=0.1)
    client("simSetCameraPose", "0", rotated(1, -90), "", False)
    assert depth(client) == pytest.approx(4.5, abs=0.1)
    client("simSetCameraPose", "front_center", pose((5.0, 0.0, 0.0)), "", False)
    assert depth(client) == pytest.approx(4.0, abs=0.1)
    info = client("simGetCameraInfo", "0", "")
    assert position(info["pose"]) == pytest.approx([5, 0, -5], abs=0.02)


def test_the_field_of_view_and_the_projection_matrix_agree(client):
    client("simSetCameraFov", "0", 60.0, "", False)
    info = client("simGetCameraInfo", "0", "", False)
    assert info["fov"] == pytest.approx(60)
    matrix = np.array(info["proj_mat"]["matrix"])
    # A point at the right edge of the image has the coordinate 1, one at the lower edge -1
    x, _, _, w = matrix @ (1.0, math.tan(math.radians(30)), 0.0, 1.0)
    assert x / w == pytest.approx(1)
    _, y, _, w = matrix @ (1.0, 0.0, math.tan(math.radians(30)) * 144 / 256, 1.0)
    assert y / w == pytest.approx(-1)


def test_objects_are_listed_found_and_moved(make_client):
    layout = Solids(np.array([[(20.0, 20, 0), (30, 30, 9)]]))
    client = make_client(2, obstacles=(BOX, BOX), layout=layout)
    client.world.airspace.place_obstacle(1, (0.0, 10.0, 5.0))
    names = ["Drone1", "Drone2", "Obstacle1", "Ground", "Building"]
    assert client("simListSceneObjects", ".*") == names
    assert client("simListSceneObjects", "Drone[12]") == names[:2]
    assert client("simListSceneObjects", "drone1") == []
    assert position(client("simGetObjectPose", "Obstacle1")) == [10, 0, -5]
    assert math.isnan(position(client("simGetObjectPose", "Obstacle0"))[0])
    assert client("simSetObjectPose", "Obstacle1", pose((3, 4, -6), 90), True) is True
    assert position(client("simGetObjectPose", "Obstacle1", True)) == pytest.approx([3, 4, -6])
    assert client("simSetObjectPose", "Drone2", pose((7, 8, -9)), True) is True
    assert position(client("simGetObjectPose", "Drone2")) == pytest.approx([7, 8, -9])
    for name in ("Obstacle0", "Ground", "Building", "Nothing"):
        assert client("simSetObjectPose", name, pose((3, 4, -6)), True) is False
    with pytest.raises(ValueError, match="overlap"):
        client("simSetObjectPose", "Obstacle1", pose((7, 8, -9)), True)
    low, high = client("simGetWorldExtents")
    assert high["altitude"] - low["altitude"] == pytest.approx(9.3, abs=0.5)
    assert high["latitude"] > low["latitude"]


def test_added_bodies_are_objects(client):
    client.world.airspace.add_body(BOX, (5.0, 5.0, 1.0))
    assert position(client("simGetObjectPose", "Obstacle2")) == [5, 5, -1]
    assert client("simSetObjectPose", "Obstacle2", pose((9, 5, -1)), True)
    assert position(client("simGetObjectPose", "Obstacle2")) == [9, 5, -1]


def test_lines_of_sight_end_at_obstacles_and_vehicles(make_client):
    client = make_client(2, obstacles=(BOX,))
    client.world.airspace.place_obstacle(0, (0.0, 10.0, 5.0))
    client.at((0, 0, -5), "Drone1")
    client.at((4, 2, -5), "Drone2")
    home = client("getHomeGeoPoint", "Drone1")
    # 20 m to the north is behind the obstacle
    behind = home | {"latitude": home["latitude"] + 20 / 111_190, "altitude": 127.0}
    above = behind | {"altitude": 140.0}
    assert client("simTestLineOfSightToPoint", behind, "Drone1") is False
    assert client("simTestLineOfSightToPoint", above, "Drone1") is True
    assert client("simTestLineOfSightBetweenPoints", home | {"altitude": 140.0}, above) is True
    east = home | {"longitude": home["longitude"] + 20 / 75_100, "altitude": 127.0}
    assert client("simTestLineOfSightToPoint", east, "Drone1") is True
    client("simSetVehiclePose", pose((0, 2, -5)), True, "Drone2")
    assert client("simTestLineOfSightToPoint", east, "Drone1") is False


def segment(client):
    """Colours of the pixels of a segmentation image of the first vehicle."""
    (image,) = client("simGetImages", [request("0", 5)], "")
    return np.frombuffer(image["image_data_uint8"], np.uint8).reshape(144, 256, 3)[:, :, ::-1]


def test_images_share_a_scene_and_only_segmentation_finds_bodies(client, monkeypatch):
    count = Counter()

    def spy(name):
        method = getattr(VisualScene, name)

        def counted(*arguments):
            count[name] += 1
            return method(*arguments)

        monkeypatch.setattr(VisualScene, name, counted)

    spy("_build")
    spy("_find_bodies")
    for _ in range(2):
        client("simGetImages", [request("0", 0), request("0", 1, pixels_as_float=True)], "")
    assert count == {"_build": 1}
    for _ in range(2):
        segment(client)
    assert count == {"_build": 1, "_find_bodies": 2}


def test_each_object_has_its_own_segmentation_id(make_client):
    layout = Solids(np.array([[(-60.0, 60, 0), (60, 70, 30)]]))
    client = make_client(2, obstacles=(BOX, BOX), layout=layout)
    client.at((0, 0, -5), "Drone1")
    client.at((6, -2, -5), "Drone2")
    # Obstacles to the left and to the right of the second vehicle, and a body below them
    client.world.airspace.place_obstacle(0, (-4.0, 10.0, 5.0))
    client.world.airspace.place_obstacle(1, (4.0, 10.0, 5.0))
    client.world.airspace.add_body(BOX, (0.0, 10.0, 1.5))
    # Classes, before an id is set
    pixels = segment(client)
    is_drone = (pixels == LABEL_COLOURS[DRONE]).all(axis=2)
    rows, columns = map(
        list, zip((72, 77), (72, 179), (117, 128), (40, 10), (140, 10), strict=True)
    )
    classes = [OBSTACLE, OBSTACLE, OBSTACLE, BUILDING, LAND]
    assert pixels[rows, columns].tolist() == LABEL_COLOURS[classes].tolist()
    assert is_drone.sum() > 10
    names = ("Obstacle0", "Obstacle1", "Obstacle2", "Building", "Ground", "Drone2")
    assert [client("simGetSegmentationObjectID", name) for name in names] == [-1] * 6
    for number, name in enumerate(names, 20):
        assert client("simSetSegmentationObjectID", name, number, False) is True
        assert client("simGetSegmentationObjectID", name) == number
    wanted = [make_label_colour(number).tolist() for number in range(20, 26)]
    pixels = segment(client)
    assert pixels[rows, columns].tolist() == wanted[:5]
    assert (pixels[is_drone] == wanted[5]).all()
    assert wanted[0] == [0, 64, 128]
    assert len({tuple(make_label_colour(k)) for k in range(256)}) == 256


def test_a_pattern_sets_the_segmentation_ids_of_many_objects(client):
    client("simAddVehicle", "Other", "SimpleFlight", pose((0, 4, 0)), "")
    client.world.airspace.place_obstacle(1, (4.0, 10.0, 5.0))
    # The pattern of AirSim's documentation, which ignores case
    assert client("simSetSegmentationObjectID", "obst[\\w]*", 9, True) is True
    assert client("simSetSegmentationObjectID", "GROUND", 8) is True
    assert client("simSetSegmentationObjectID", "Cylinder", 7, False) is False
    assert client("simSetSegmentationObjectID", "cyl[\\w]*", 7, True) is False
    names = ("Obstacle0", "Obstacle1", "ground", "Other", "Cylinder")
    ids = [client("simGetSegmentationObjectID", name) for name in names]
    assert ids == [9, 9, 8, -1, -1]
    assert segment(client)[[72, 72], [128, 179]].tolist() == [make_label_colour(9).tolist()] * 2


def test_detections_are_those_of_the_filter(client):
    asked = ("0", 0)
    assert client("simGetDetections", *asked, "") == []
    client("simAddDetectionFilterMeshName", *asked, "Obst*", "")
    (found,) = client("simGetDetections", *asked, "")
    assert found["name"] == "Obstacle0"
    low, high = (found["box2D"][key] for key in ("min", "max"))
    # The front face of 2 m at 9 m, in an image of 256 pixels and 90 degrees
    assert high["x_val"] - low["x_val"] == pytest.approx(256 / 9, rel=0.05)
    assert (high["x_val"] + low["x_val"]) / 2 == pytest.approx(128, abs=1)
    assert (high["y_val"] + low["y_val"]) / 2 == pytest.approx(72, abs=1)
    assert position(found["relative_pose"])[0] == pytest.approx(9.8, abs=0.3)
    assert found["box3D"]["max"]["y_val"] == pytest.approx(1, abs=0.05)
    client("simSetDetectionFilterRadius", *asked, 500, "")
    assert client("simGetDetections", *asked, "") == []
    client("simClearDetectionMeshNames", *asked, "")
    client("simAddDetectionFilterMeshName", *asked, "Obstacle0", "")
    assert len(client("simGetDetections", *asked, "")) == 1
    # Behind the camera, and behind another object
    client("simSetVehiclePose", pose((0, 0, -5), 180), True, "")
    assert client("simGetDetections", *asked, "") == []
    client("simSetVehiclePose", pose((0, 0, -5)), True, "")
    client.world.airspace.place_obstacle(1, (0.0, 5.0, 5.0))
    assert client("simGetDetections", *asked, "") == []


def test_kinematics_are_set(client):
    state = pose((0, 0, -8)) | {
        "linear_velocity": vector(2.0, 1.0, 0.0),
        "angular_velocity": vector(0.0, 0.0, 1.0),
    }
    client("simSetKinematics", state, True, "")
    assert client.read("position", "linear_velocity", "angular_velocity") == pytest.approx(
        [0, 0, -8, 2, 1, 0, 0, 0, 1]
    )


def test_a_tilted_vehicle_on_the_ground_is_lifted(client):
    client("simSetVehiclePose", rotated(0, 30), True, "")
    height = client.world.airspace.swarm.position[0, 2]
    assert height == pytest.approx(client.world.airspace.airframes[0].collision_radius)
    with pytest.raises(ValueError, match="overlap the ground"):
        client("simSetVehiclePose", pose((0, 0, 1)), True, "")


def test_an_added_vehicle_flies_beside_the_others(client):
    client("simSetWind", vector(0.0, 1.0, 0.0))
    client.fly(0.5)
    before, time = client.read("position", "linear_velocity"), client.world.time
    assert client("simAddVehicle", "Ann", "simpleflight", pose((6, 6, 0), 90), "") is True
    assert client("listVehicles") == ["SimpleFlight", "Ann"]
    assert client.world.time == time
    assert client.read("position", "linear_velocity") == pytest.approx(before, abs=1e-12)
    assert client.world.airspace.world.wind.steady[0].tolist() == [1, 0, 0]
    assert position(client("simGetObjectPose", "Obstacle0")) == [10, 0, -5]
    assert client.yaw("Ann") == pytest.approx(90)
    client.ready("Ann")
    assert client.join("takeoff", 20.0, "Ann")[0] is True
    assert client.place("Ann") == pytest.approx([0, 0, -3], abs=0.4)
    assert client.place()[:2] == pytest.approx(before[:2], abs=0.1)


def test_an_added_vehicle_stands_at_the_next_free_place(make_client):
    client = make_client()
    client("simAddVehicle", "Ann", "SimpleFlight", pose((0, 0, 0)), "")
    client("simAddVehicle", "Bob", "PX4Multirotor", pose((0, 0, 0)), "")
    assert client.world.airspace.swarm.position[:, 0].tolist() == [0, 2, 4]
    client.fly(0.1)
    client.world.airspace.add_body(BOX, (5.0, 5.0, 1.0))
    with pytest.raises(ValueError, match="bodies of add_body"):
        client("simAddVehicle", "Cleo", "SimpleFlight", pose((0, 0, 0)), "")
    assert client("listVehicles") == ["SimpleFlight", "Ann", "Bob"]


def test_sticks_fly_a_vehicle_by_hand(client):
    begun = client.begin("moveByManual", 40.0, 40.0, -10.0, 3.0, *FREE, "")
    client.fly(0.5)
    assert client.place() == pytest.approx([0, 0, -5], abs=0.05)
    sticks = {"roll": 500.0, "pitch": 0.0, "throttle": 0.0, "yaw": 0.0, "is_valid": True}
    client("moveByRC", sticks, "")
    client.fly(1.5)
    assert client.velocity() == pytest.approx([0, 2, 0], abs=0.2)
    assert client("getMultirotorState", "")["rc_data"]["roll"] == 500
    client("moveByRC", sticks | {"roll": 0.0, "throttle": 10_000.0, "yaw": 2000.0}, "")
    client.fly(0.8)
    assert client.velocity()[2] < -1
    assert client.yaw() > 5
    client.fly(1.0)
    assert begun == [True]


def test_a_vehicle_flies_to_a_geodetic_position(client):
    home = client("getHomeGeoPoint", "")
    goal = (home["latitude"], home["longitude"] + 5 / 75_100, home["altitude"] + 5.0)
    assert client.join("moveToGPS", *goal, 3.0, 60.0, *FREE, -1, 1, "")[0] is True
    assert client.place() == pytest.approx([0, 5, -5], abs=0.4)
    with pytest.raises(ValueError, match="a place within 100 km"):
        client.begin("moveToGPS", 10.0, 10.0, 100.0, 3.0, 60.0, *FREE, -1, 1, "")


def test_plots_are_checked_without_a_replay(client):
    red, points = [1.0, 0.0, 0.0, 1.0], [vector(1.0, 2.0, 3.0)]
    assert client("simPlotStrings", ["a"], points, 5, red, 1.0) is None
    assert client("simPlotTransformsWithNames", [pose((0, 0, 0))], ["a"], 1, 1, 1, red, 1) is None
    for wrong in ([5.0], [vector(1.0, 2.0, math.nan)], points * 2001):
        with pytest.raises(ValueError, match="point"):
            client("simPlotPoints", wrong, red, 10.0, -1.0, False)
