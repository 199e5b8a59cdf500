"""Fly a server of AirSim's calls with a client of AirSim or Cosys-AirSim, unmodified.

    python airsim_client.py cosysairsim 41451

Needs a server of two vehicles with a range finder. Prints what it saw, and last a hash of the
states of a flight in lockstep, which is the same each time.
"""

import hashlib
import importlib
import json
import math
import sys

name, port = sys.argv[1], int(sys.argv[2])
airsim = importlib.import_module(name)
client = airsim.MultirotorClient(port=port)
client.confirmConnection()
client.reset()
client.simPause(False)
first, second = client.listVehicles()
print("vehicles", first, second)
for vehicle in (first, second):
    client.enableApiControl(True, vehicle)
    client.armDisarm(True, vehicle)
assert client.isApiControlEnabled(first)


def where(vehicle=first):
    place = client.getMultirotorState(vehicle).kinematics_estimated.position
    return place.x_val, place.y_val, place.z_val


def near(found, wanted, tolerance):
    assert max(abs(a - b) for a, b in zip(found, wanted, strict=True)) < tolerance, (found, wanted)


assert client.getMultirotorState(first).landed_state == airsim.LandedState.Landed
both = [client.takeoffAsync(vehicle_name=vehicle) for vehicle in (first, second)]
for one in both:
    one.join()
near(where(), (0, 0, -3), 0.4)
assert client.getMultirotorState(first).landed_state == airsim.LandedState.Flying
client.moveToPositionAsync(4, 3, -5, 3, vehicle_name=first).join()
near(where(), (4, 3, -5), 0.4)
print("moved to", [round(one, 1) for one in where()])
old = client.moveByVelocityAsync(1, 0, 0, 60, vehicle_name=first)
client.rotateToYawAsync(90, vehicle_name=first).join()
turn = client.simGetVehiclePose(first).orientation
assert abs(2 * math.atan2(turn.z_val, turn.w_val) - math.pi / 2) < 0.15
path = [airsim.Vector3r(4, 0, -5), airsim.Vector3r(0, 0, -4)]
client.moveOnPathAsync(path, 3, vehicle_name=first).join()
near(where(), (0, 0, -4), 0.4)

imu, gps = client.getImuData(vehicle_name=first), client.getGpsData(vehicle_name=first)
assert -13 < imu.linear_acceleration.z_val < -7
assert abs(gps.gnss.geo_point.latitude - client.getHomeGeoPoint(first).latitude) < 1e-4
assert client.getBarometerData(vehicle_name=first).pressure < 101325
field = client.getMagnetometerData(vehicle_name=first).magnetic_field_body
assert 0.2 < math.sqrt(field.x_val**2 + field.y_val**2 + field.z_val**2) < 0.7
points = client.getLidarData(vehicle_name=first).point_cloud
assert len(points) > 30
assert len(points) % 3 == 0
print("lidar points", len(points) // 3)

kinds = airsim.ImageType
scene, depth, labels = client.simGetImages(
    [
        airsim.ImageRequest("0", kinds.Scene, False, False),
        airsim.ImageRequest("bottom_center", kinds.DepthPlanar, True, False),
        airsim.ImageRequest("0", kinds.Segmentation),
    ],
    first,
)
assert len(scene.image_data_uint8) == 3 * scene.width * scene.height
below = sorted(depth.image_data_float)[len(depth.image_data_float) // 2]
assert abs(below - 4) < 0.5, below
assert bytes(labels.image_data_uint8).startswith(b"\x89PNG")
assert bytes(client.simGetImage("0", kinds.Scene, first)).startswith(b"\x89PNG")
print("pictures", scene.width, "x", scene.height, "ground", round(below, 1), "m below")

client.landAsync(vehicle_name=second).join()
assert client.getMultirotorState(second).landed_state == airsim.LandedState.Landed
assert not client.simGetCollisionInfo(second).has_collided
client.simSetVehiclePose(airsim.Pose(airsim.Vector3r(0, 0, -8)), True, second)
said = ""
try:
    client.moveToZAsync(float("nan"), 1, vehicle_name=first).get()
except Exception as error:
    said = str(error)
assert "finite" in said, said


def lockstep():
    """Fly for 2 s in steps; hash the states."""
    client.simPause(True)
    client.reset()
    states = hashlib.sha256()
    for vehicle in (first, second):
        client.enableApiControl(True, vehicle)
        client.armDisarm(True, vehicle)
        client.takeoffAsync(vehicle_name=vehicle)
    for k in range(40):
        if k == 20:
            client.moveByVelocityAsync(1.0, -0.5, -0.2, 5.0, vehicle_name=first)
        client.simContinueForTime(0.05)
        for vehicle in (first, second):
            told = client.simGetGroundTruthKinematics(vehicle)
            rows = [vars(one) for one in (told.position, told.orientation, told.linear_velocity)]
            states.update(json.dumps(rows, sort_keys=True).encode())
    return states.hexdigest()


flights = {lockstep() for _ in range(2)}
assert len(flights) == 1
client.simPause(False)
print("lockstep", *flights)
