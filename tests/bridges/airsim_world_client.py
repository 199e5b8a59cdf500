"""A client that calls a world of AirSim's vehicles directly, without a network."""

import math

from scipy.spatial.transform import Rotation

from bulletuav.bridges.airsim_calls import AirsimCalls

RATE = {"is_rate": True, "yaw_or_rate": 0.0}
FREE = (0, RATE)
"""Drivetrain and yaw mode"""
VECTOR = ("x_val", "y_val", "z_val")


def vector(*numbers):
    return dict(zip(VECTOR, numbers, strict=True))


def pose(place, yaw=0.0):
    """A pose north, east, down, with a yaw clockwise from north, degrees."""
    half = math.radians(yaw) / 2
    turn = {"w_val": math.cos(half), **vector(0.0, 0.0, math.sin(half))}
    return {"position": vector(*place), "orientation": turn}


class Client:
    """Calls a world, and waits for motions."""

    def __init__(self, world):
        self.world, self.calls = world, AirsimCalls(world)

    def __call__(self, name, *arguments):
        return self.calls.call(name, list(arguments))

    def begin(self, name, *arguments):
        """Begin a motion; returns the list that its outcome comes into."""
        reported = []
        self.calls.start_motion(name, list(arguments), reported.append)
        return reported

    def fly(self, seconds):
        for _ in range(self.calls.parse_steps("simContinueForTime", [seconds])):
            self.world.step()

    def join(self, name, *arguments, most=30.0):
        """Do a motion to its end; returns the outcome and how long it took."""
        begin, reported = self.world.time, self.begin(name, *arguments)
        while not reported and self.world.time - begin < most:
            self.world.step()
        return reported[0], self.world.time - begin

    def ready(self, vehicle=""):
        self("enableApiControl", True, vehicle)
        assert self("armDisarm", True, vehicle) is True

    def at(self, place, vehicle="", yaw=0.0):
        """Put a vehicle into the air, north, east, down, where it stays."""
        self.ready(vehicle)
        self.begin("hover", vehicle)
        self("simSetVehiclePose", pose(place, yaw), True, vehicle)

    def read(self, *keys, vehicle=""):
        reported = self("getMultirotorState", vehicle)["kinematics_estimated"]
        return [reported[key][axis] for key in keys for axis in VECTOR]

    def place(self, vehicle=""):
        return self.read("position", vehicle=vehicle)

    def velocity(self):
        return self.read("linear_velocity")

    def yaw(self, vehicle=""):
        turn = self("simGetVehiclePose", vehicle)["orientation"]
        axes = [turn[f"{axis}_val"] for axis in "xyzw"]
        return math.degrees(Rotation.from_quat(axes).as_euler("ZYX")[0])


def request(camera, kind, **more):
    return {"camera_name": camera, "image_type": kind, **more}
