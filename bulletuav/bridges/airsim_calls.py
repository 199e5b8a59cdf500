"""The calls of AirSim that are there, over a world; `airsim.py` brings them to the network."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from bulletuav.bridges import airsim_states as states
from bulletuav.bridges.airsim_images import Request, expose, mount, response
from bulletuav.bridges.airsim_motions import MOTIONS
from bulletuav.bridges.airsim_values import duration, flag, pose_in, pose_of, vector_in, words
from bulletuav.bridges.airsim_world import Collision, Vehicle, World
from bulletuav.bridges.motions import Answer
from bulletuav.earth import ned_to_enu
from bulletuav.errors import as_int, as_sequence, shown, unknown

SERVER_VERSION = 4
"""What clients of Cosys-AirSim want at least; those of AirSim want 1"""
OLDEST_CLIENT = 1
MOST_IMAGES = 32
"""Most pictures of one call"""
LONGEST_CALL = 600.0
"""Longest time that one call flies, s"""


CONTINUES = ("simContinueForTime", "simContinueForFrames")
"""Calls that fly"""
PICTURES = ("simGetImage", "simGetImages")
"""Calls that take pictures: the server leaves drawing to another process"""


class Album(NamedTuple):
    """The pictures of one call.

    Attributes:
        drone: Index of the drone that carries the cameras.
        requests: What is asked for, in order.
        is_list: Whether the call is answered by a list of responses, or by the bytes of one alone.
    """

    drone: int
    requests: list[Request]
    is_list: bool


class Calls:
    """Calls of clients, by name.

    Attributes:
        world: The vehicles.
    """

    def __init__(self, world: World) -> None:
        """Take the world that clients fly."""
        self.world = world
        self._table: Mapping[str, Callable[..., Any]] = {
            # The connection and the clock
            "ping": lambda: True,
            "getServerVersion": lambda: SERVER_VERSION,
            "getMinRequiredClientVersion": lambda: OLDEST_CLIENT,
            "reset": world.reset,
            "simPause": self._pause,
            "simIsPaused": lambda: world.paused,
            # The world
            "listVehicles": lambda: list(world.vehicles),
            "getSettingsString": lambda: "{}",
            "simSetWind": self._set_wind,
            # Control of a vehicle
            "enableApiControl": self._enable,
            "isApiControlEnabled": lambda name: world.vehicle(name)[1].is_ours,
            "armDisarm": self._arm,
            "cancelLastTask": self._cancel,
            "simSetVehiclePose": self._place,
            "simGetVehiclePose": self._pose,
            "getHomeGeoPoint": self._home,
            # What it met
            "simGetCollisionInfo": self._collision,
            "simPrintLogMessage": self._print,
            # States, and readings of sensors
            "getMultirotorState": self._of(states.multirotor),
            "simGetGroundTruthKinematics": self._of(states.kinematics),
            "simGetGroundTruthEnvironment": self._of(states.environment),
            "getRotorStates": self._of(states.rotors),
            **{
                name: self._sensor(read)
                for name, read in (
                    ("getImuData", states.imu),
                    ("getBarometerData", states.barometer),
                    ("getMagnetometerData", states.magnetometer),
                    ("getGpsData", states.gps),
                    ("getLidarData", states.lidar),
                )
            },
        }

    def names(self) -> list[str]:
        """List all calls that are there."""
        return sorted({*self._table, *MOTIONS, *PICTURES, *CONTINUES})

    def call(self, name: Any, arguments: list[Any]) -> Any:
        """Answer a call that takes no time.

        Args:
            name: Of the call.
            arguments: What was sent with it.

        Returns:
            What is answered.

        Raises:
            ValueError: There is no such call, or it cannot be; the world is as it was.
        """
        if name in PICTURES:
            return self._draw(name, arguments)
        if not isinstance(name, str) or name not in self._table:
            raise unknown("call", name, self.names())
        function = self._table[name]
        _require_arguments(name, function, arguments)
        return function(*arguments)

    def steps(self, name: str, arguments: list[Any]) -> int:
        """Tell how many steps a call lets the world fly.

        Args:
            name: "simContinueForTime" or "simContinueForFrames".
            arguments: What was sent with it.

        Raises:
            ValueError: It cannot be.
        """
        (given,) = as_sequence("arguments", arguments, 1)
        if name == "simContinueForFrames":
            return as_int("frames", given, 0, round(LONGEST_CALL * 100))
        seconds = duration("seconds", given)
        if seconds > LONGEST_CALL:
            raise ValueError(f"seconds is {seconds:g}: at most {LONGEST_CALL:g} are possible")
        return self.world.advance(seconds)

    def move(self, name: str, arguments: list[Any], answer: Answer) -> None:
        """Begin a motion, in place of what the drone did.

        Args:
            name: One of `MOTIONS`.
            arguments: What was sent with it; the vehicle's name is last.
            answer: Function that is told when it ends.

        Raises:
            ValueError: It cannot be; the drone goes on with what it did.
        """
        if not arguments or not isinstance(arguments[-1], str):
            raise ValueError(f"{name} needs a vehicle's name, or an empty one, as last argument")
        i, vehicle = self.world.vehicle(arguments[-1])
        if not vehicle.is_ours:
            raise _needs_control(vehicle)
        if not vehicle.is_armed:
            raise ValueError(
                f"vehicle {vehicle.name!r} is not armed; call armDisarm(True, {vehicle.name!r}) "
                f"first"
            )
        given = (self.world, i, vehicle, *arguments[:-1])
        _require_arguments(name, MOTIONS[name], given)
        vehicle.begin(MOTIONS[name](*given), answer)

    def _of(self, read: Callable[..., Any]) -> Callable[[str], Any]:
        """Make a call that reads something of a vehicle."""

        def call(vehicle_name: str = "") -> Any:
            return read(self.world, *self.world.vehicle(vehicle_name))

        return call

    def _sensor(self, read: Callable[..., Any]) -> Callable[[str, str], Any]:
        """Make a call that reads a sensor of a vehicle; there is one of each kind."""

        def call(sensor_name: str = "", vehicle_name: str = "") -> Any:
            words("sensor_name", sensor_name)
            return read(self.world, *self.world.vehicle(vehicle_name))

        return call

    def _pause(self, is_paused: bool) -> None:
        """Let time stand still, or go on."""
        self.world.paused = flag("is_paused", is_paused)

    def _print(self, message: str, parameter: str = "", severity: int = 0) -> None:
        """Take a message for a screen, which is not there."""
        words("message", message)
        words("message_param", parameter)
        as_int("severity", severity, 0, 3)

    def _set_wind(self, wind: Any) -> None:
        """Change the steady wind, north, east, down."""
        self.world.airspace.set_wind(ned_to_enu(vector_in("wind", wind)).tolist())

    def _enable(self, is_enabled: bool, vehicle_name: str = "") -> None:
        """Ask for control of a vehicle, or give it back; then it stays where it is."""
        i, vehicle = self.world.vehicle(vehicle_name)
        vehicle.is_ours = flag("is_enabled", is_enabled)
        if not is_enabled:
            vehicle.stay(self.world.state(i))

    def _arm(self, arm: bool, vehicle_name: str = "") -> bool:
        """Let motors turn, or stop them."""
        _, vehicle = self.world.vehicle(vehicle_name)
        flag("arm", arm)
        if not vehicle.is_ours:
            raise _needs_control(vehicle)
        vehicle.is_armed = arm
        if not arm:
            vehicle.stop()
        return True

    def _cancel(self, vehicle_name: str = "") -> None:
        """End what a vehicle does; it stays where it is."""
        i, vehicle = self.world.vehicle(vehicle_name)
        vehicle.stay(self.world.state(i))

    def _place(self, pose: Any, ignore_collision: bool, vehicle_name: str = "") -> None:
        """Put a vehicle somewhere, at rest."""
        i, _ = self.world.vehicle(vehicle_name)
        flag("ignore_collision", ignore_collision)
        self.world.place(i, *pose_in(pose))

    def _pose(self, vehicle_name: str = "") -> dict[str, Any]:
        """Tell where a vehicle is."""
        i, vehicle = self.world.vehicle(vehicle_name)
        swarm = self.world.airspace.swarm
        return pose_of(swarm.position[i] - vehicle.start, swarm.quaternion[i])

    def _home(self, vehicle_name: str = "") -> dict[str, float]:
        """Tell where a vehicle starts, on the Earth."""
        return states.geo_point(self.world, self.world.vehicle(vehicle_name)[1].start)

    def _collision(self, vehicle_name: str = "") -> dict[str, Any]:
        """Tell what a vehicle has hit since it was asked last."""
        _, vehicle = self.world.vehicle(vehicle_name)
        told, vehicle.collision = vehicle.collision, Collision()
        return states.collision(vehicle, told)

    def album(self, name: str, arguments: list[Any]) -> Album:
        """Read a call that takes pictures.

        Args:
            name: One of `PICTURES`.
            arguments: What was sent with it.

        Raises:
            ValueError: A picture, a camera or the vehicle cannot be.
        """
        read = self._one_image if name == "simGetImage" else self._images
        _require_arguments(name, read, arguments)
        album: Album = read(*arguments)
        for camera in dict.fromkeys(one.camera for one in album.requests):
            mount(self.world, album.drone, camera)
        return album

    def _one_image(self, camera: Any, kind: Any, vehicle_name: str = "", more: Any = None) -> Album:
        """Read a call for one PNG.

        AirSim's clients send in `more` whether the camera belongs to no vehicle, those of
        Cosys-AirSim the name of an annotation; both are not there.
        """
        if not (more is None or more is False or more == ""):
            raise ValueError(
                f"external or annotation_name is {shown(more)}: cameras of vehicles alone are "
                f"there, without annotations; leave it out"
            )
        request = Request({"camera_name": camera, "image_type": kind, "compress": True})
        return Album(self.world.vehicle(vehicle_name)[0], [request], False)

    def _images(self, requests: Any, vehicle_name: str = "", external: Any = False) -> Album:
        """Read a call for pictures; cameras that belong to no vehicle are not there."""
        if flag("external", external):
            raise ValueError(
                "external is True: cameras that belong to no vehicle are not there; leave it out"
            )
        wanted = [Request(one) for one in as_sequence("requests", requests, most=MOST_IMAGES)]
        return Album(self.world.vehicle(vehicle_name)[0], wanted, True)

    def _draw(self, name: str, arguments: list[Any]) -> Any:
        """Draw the pictures of a call here and now."""
        album, airspace = self.album(name, arguments), self.world.airspace
        exposures = expose(self.world, album.drone, album.requests)
        drawn = [response(one, airspace.draw(one.sight.shot)) for one in exposures]
        return drawn if album.is_list else drawn[0]["image_data_uint8"]


def _needs_control(vehicle: Vehicle) -> ValueError:
    """Make the error for a vehicle that clients do not control."""
    return ValueError(
        f"vehicle {vehicle.name!r} is not under API control; call enableApiControl(True, "
        f"{vehicle.name!r}) first"
    )


def _require_arguments(name: str, function: Callable[..., Any], arguments: Any) -> None:
    """Raise ValueError unless a call has as many arguments as its function takes."""
    try:
        inspect.signature(function).bind(*arguments)
    except TypeError as error:
        told = [one for one in arguments if isinstance(one, int | float | str | list | dict)]
        raise ValueError(f"{name} with {shown(told)}: {error}") from None
