"""The supported calls of AirSim's API; `airsim.py` serves them over the network."""

import inspect
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from bulletuav.bridges import airsim_states as states
from bulletuav.bridges.airsim_camera_calls import CameraCalls
from bulletuav.bridges.airsim_images import (
    ImageCall,
    ImageRequest,
    make_exposures,
    make_response,
)
from bulletuav.bridges.airsim_motions import MOTIONS
from bulletuav.bridges.airsim_plots import PlotCalls
from bulletuav.bridges.airsim_recording import AirsimRecorder
from bulletuav.bridges.airsim_scene_calls import SceneCalls
from bulletuav.bridges.airsim_settings import VEHICLE_TYPES, VehicleSettings
from bulletuav.bridges.airsim_values import (
    attitude_from_airsim,
    check_duration,
    check_flag,
    check_number,
    check_text,
    read_pose,
    read_vector,
    write_pose,
    yaw_to_airsim,
)
from bulletuav.bridges.airsim_vehicle import AirsimVehicle, Collision, RemoteControl
from bulletuav.bridges.airsim_world import AirsimWorld
from bulletuav.bridges.motions import DoneCallback
from bulletuav.earth import frd_to_flu, ned_to_enu
from bulletuav.errors import as_int, as_sequence, shown, unknown
from bulletuav.geometry.rotation import heading

SERVER_VERSION = 4
"""Minimum server version of Cosys-AirSim's clients; AirSim's clients need 1"""
MIN_CLIENT_VERSION = 1
"""Minimum client version that the server reports"""
MAX_IMAGES = 32
"""Maximum number of images of one call"""
MAX_CALL_TIME = 600.0
"""Maximum simulated time of one call, s"""


CONTINUE_CALLS = ("simContinueForTime", "simContinueForFrames")
"""Calls that step a paused simulation"""
IMAGE_CALLS = ("simGetImage", "simGetImages")
"""Calls that render images; the server renders them in another process"""


class NotReadyError(ValueError):
    """Error for a vehicle that is not under API control, or not armed.

    AirSim answers False then; its clients cannot show an error of a motion.
    """


class AirsimCalls:
    """Dispatcher of AirSim's calls by name.

    Attributes:
        world: The vehicles.
    """

    def __init__(self, world: AirsimWorld, recorder: AirsimRecorder | None = None) -> None:
        """Build the table of calls for a world.

        Args:
            world: The vehicles.
            recorder: Recorder of the server; by default one that cannot record.
        """
        self.world = world
        recorder = recorder or AirsimRecorder(world)
        self._table: Mapping[str, Callable[..., Any]] = {
            # The connection and the clock
            "ping": lambda: True,
            "getServerVersion": lambda: SERVER_VERSION,
            "getMinRequiredClientVersion": lambda: MIN_CLIENT_VERSION,
            "reset": world.reset,
            "simPause": self._pause,
            "simIsPaused": lambda: world.paused,
            # The world
            "listVehicles": lambda: list(world.vehicles),
            "getSettingsString": lambda: world.settings.text,
            "simSetWind": self._set_wind,
            "startRecording": recorder.start,
            "stopRecording": recorder.stop,
            "isRecording": lambda: recorder.is_recording,
            # Control of a vehicle
            "enableApiControl": self._enable_api_control,
            "isApiControlEnabled": lambda name: world.vehicle(name)[1].is_api_controlled,
            "armDisarm": self._arm_disarm,
            "cancelLastTask": self._cancel_task,
            "simSetVehiclePose": self._set_pose,
            "simGetVehiclePose": self._get_pose,
            "getHomeGeoPoint": self._get_home,
            # Collisions and messages
            "simGetCollisionInfo": self._get_collision,
            "simPrintLogMessage": self._print_log_message,
            # States and sensor readings
            "getMultirotorState": self._make_state_call(states.multirotor),
            "simGetGroundTruthKinematics": self._make_state_call(states.kinematics),
            "simGetGroundTruthEnvironment": self._make_state_call(states.environment),
            "getRotorStates": self._make_state_call(states.rotors),
            **{
                name: self._make_sensor_call(read)
                for name, read in (
                    ("getImuData", states.imu),
                    ("getBarometerData", states.barometer),
                    ("getMagnetometerData", states.magnetometer),
                    ("getGpsData", states.gps),
                )
            },
            "simSetKinematics": self._set_kinematics,
            "simAddVehicle": self._add_vehicle,
            "moveByRC": self._set_remote,
            **CameraCalls(world).table,
            **SceneCalls(world).table,
            **PlotCalls(world).table,
            "getLidarData": self._make_range_call(states.lidar),
            "getDistanceSensorData": self._make_range_call(states.distance),
        }

    def list_names(self) -> list[str]:
        """Return the names of all supported calls."""
        return sorted({*self._table, *MOTIONS, *IMAGE_CALLS, *CONTINUE_CALLS})

    def call(self, name: Any, arguments: list[Any]) -> Any:
        """Execute a call that takes no simulated time.

        Args:
            name: Name of the call.
            arguments: Arguments of the call.

        Returns:
            Result of the call.

        Raises:
            ValueError: If the call is unknown or its arguments are invalid; the world is unchanged
                then.
            NotReadyError: If the vehicle is not under API control, which the call needs.
        """
        if name in IMAGE_CALLS:
            return self._draw_images(name, arguments)
        if not isinstance(name, str) or name not in self._table:
            raise unknown("call", name, self.list_names())
        function = self._table[name]
        _require_arguments(name, function, arguments)
        return function(*arguments)

    def parse_steps(self, name: str, arguments: list[Any]) -> int:
        """Return the number of simulation steps of a call that continues time.

        Args:
            name: "simContinueForTime" or "simContinueForFrames".
            arguments: Arguments of the call.

        Raises:
            ValueError: If the arguments are invalid.
        """
        (given,) = as_sequence("arguments", arguments, 1)
        if name == "simContinueForFrames":
            return as_int("frames", given, 0, round(MAX_CALL_TIME * 100))
        seconds = check_duration("seconds", given)
        if seconds > MAX_CALL_TIME:
            raise ValueError(f"seconds is {seconds:g}: at most {MAX_CALL_TIME:g} are possible")
        return self.world.count_steps(seconds)

    def start_motion(self, name: str, arguments: list[Any], done_callback: DoneCallback) -> None:
        """Start a motion, which replaces the present motion of the vehicle.

        Args:
            name: One of `MOTIONS`.
            arguments: Arguments of the call; the vehicle's name is last.
            done_callback: Function that is called with the outcome when the motion ends.

        Raises:
            ValueError: If the arguments are invalid. The vehicle continues its present motion then.
            NotReadyError: If the vehicle is not armed or not under API control.
        """
        if not arguments or not isinstance(arguments[-1], str):
            raise ValueError(f"{name} needs a vehicle's name, or an empty one, as last argument")
        i, vehicle = self.world.vehicle(arguments[-1])
        if not vehicle.is_api_controlled:
            raise _make_control_error(vehicle)
        if not vehicle.is_armed:
            raise NotReadyError(
                f"vehicle {vehicle.name!r} is not armed; call armDisarm(True, {vehicle.name!r}) "
                f"first"
            )
        given = (self.world, i, vehicle, *arguments[:-1])
        _require_arguments(name, MOTIONS[name], given)
        vehicle.start_motion(MOTIONS[name](*given), done_callback)

    def _make_state_call(self, read: Callable[..., Any]) -> Callable[[str], Any]:
        """Return a call that reads the state of a vehicle."""

        def call(vehicle_name: str = "") -> Any:
            return read(self.world, *self.world.vehicle(vehicle_name))

        return call

    def _make_sensor_call(self, read: Callable[..., Any]) -> Callable[[str, str], Any]:
        """Return a call that reads a sensor of a vehicle; a vehicle has one sensor of each type."""

        def call(sensor_name: str = "", vehicle_name: str = "") -> Any:
            check_text("sensor_name", sensor_name)
            return read(self.world, *self.world.vehicle(vehicle_name))

        return call

    def _make_range_call(self, read: Callable[..., Any]) -> Callable[[str, str], Any]:
        """Return a call that reads a range finder of a vehicle by its name."""

        def call(sensor_name: str = "", vehicle_name: str = "") -> Any:
            check_text("sensor_name", sensor_name)
            return read(self.world, *self.world.vehicle(vehicle_name), sensor_name)

        return call

    def _pause(self, is_paused: bool) -> None:
        self.world.paused = check_flag("is_paused", is_paused)

    def _print_log_message(self, message: str, parameter: str = "", severity: int = 0) -> None:
        """Validate a message and drop it, because there is no screen."""
        check_text("message", message)
        check_text("message_param", parameter)
        as_int("severity", severity, 0, 3)

    def _set_wind(self, wind: Any) -> None:
        """Set the steady wind, north, east, down, m/s."""
        self.world.airspace.set_wind(ned_to_enu(read_vector("wind", wind)).tolist())

    def _enable_api_control(self, is_enabled: bool, vehicle_name: str = "") -> None:
        """Acquire or release API control; after a release the vehicle holds its position."""
        i, vehicle = self.world.vehicle(vehicle_name)
        vehicle.is_api_controlled = check_flag("is_enabled", is_enabled)
        if not is_enabled:
            vehicle.hold_position(self.world.state(i))

    def _arm_disarm(self, arm: bool, vehicle_name: str = "") -> bool:
        """Arm the motors, or disarm and stop them."""
        _, vehicle = self.world.vehicle(vehicle_name)
        check_flag("arm", arm)
        if not vehicle.is_api_controlled:
            raise _make_control_error(vehicle)
        vehicle.is_armed = arm
        if not arm:
            vehicle.stop_motors()
        return True

    def _cancel_task(self, vehicle_name: str = "") -> None:
        """End the motion of a vehicle, which then holds its position."""
        i, vehicle = self.world.vehicle(vehicle_name)
        vehicle.hold_position(self.world.state(i))

    def _set_pose(self, pose: Any, ignore_collision: bool, vehicle_name: str = "") -> None:
        """Place a vehicle at rest.

        Args:
            pose: Pose relative to the vehicle's start, NED; see `read_pose`.
            ignore_collision: Only checked to be a bool: an overlap is always an error.
            vehicle_name: Name of the vehicle; the first one if empty.
        """
        i, _ = self.world.vehicle(vehicle_name)
        check_flag("ignore_collision", ignore_collision)
        self.world.place(i, *read_pose(pose))

    def _set_kinematics(self, state: Any, ignore_collision: bool, vehicle_name: str = "") -> None:
        """Set pose and velocities of a vehicle; accelerations are those of its motors and the air.

        Arguments are those of `_set_pose`, with a KinematicsState.
        """
        i, _ = self.world.vehicle(vehicle_name)
        check_flag("ignore_collision", ignore_collision)
        if not isinstance(state, Mapping):
            raise ValueError(f"state is {shown(state)}: a map of a KinematicsState is needed")
        velocity = ned_to_enu(read_vector("linear_velocity", state.get("linear_velocity")))
        rates = frd_to_flu(read_vector("angular_velocity", state.get("angular_velocity")))
        self.world.place(i, *read_pose(state), velocity.tolist(), rates.tolist())

    def _add_vehicle(
        self, vehicle_name: str, vehicle_type: str, pose: Any, pawn_path: str = ""
    ) -> bool:
        """Add a vehicle at a pose, north, east, down of the origin; only its yaw is used."""
        check_text("pawn_path", pawn_path)
        if check_text("vehicle_type", vehicle_type).lower() not in VEHICLE_TYPES:
            raise unknown("vehicle_type", vehicle_type, ("SimpleFlight", "PX4Multirotor"))
        position, orientation = read_pose(pose)
        place = tuple(np.nan_to_num(position).tolist())
        yaw = 0.0
        if np.isfinite(orientation).all():
            yaw = yaw_to_airsim(heading(attitude_from_airsim(orientation)))
        settings = VehicleSettings(place, yaw, sensors=self.world.settings.sensors)
        self.world.add_vehicle(check_text("vehicle_name", vehicle_name), settings)
        return True

    def _set_remote(self, rcdata: Any, vehicle_name: str = "") -> None:
        """Set the sticks of a vehicle, by which `moveByManual` flies."""
        _, vehicle = self.world.vehicle(vehicle_name)
        if not isinstance(rcdata, Mapping):
            raise ValueError(f"rcdata is {shown(rcdata)}: a map of RCData is needed")
        vehicle.remote = RemoteControl(
            check_number("roll", rcdata.get("roll")),
            check_number("pitch", rcdata.get("pitch")),
            check_number("throttle", rcdata.get("throttle")),
            check_number("yaw", rcdata.get("yaw")),
            check_flag("is_valid", rcdata.get("is_valid")),
        )

    def _get_pose(self, vehicle_name: str = "") -> dict[str, Any]:
        """Return the pose of a vehicle relative to its start, NED."""
        i, vehicle = self.world.vehicle(vehicle_name)
        swarm = self.world.airspace.swarm
        return write_pose(swarm.position[i] - vehicle.start, swarm.quaternion[i])

    def _get_home(self, vehicle_name: str = "") -> dict[str, float]:
        """Return the start position of a vehicle as a GeoPoint."""
        return states.geo_point(self.world, self.world.vehicle(vehicle_name)[1].start)

    def _get_collision(self, vehicle_name: str = "") -> dict[str, Any]:
        """Return the last collision of a vehicle since the previous call, and clear it."""
        _, vehicle = self.world.vehicle(vehicle_name)
        collision, vehicle.collision = vehicle.collision, Collision()
        return states.make_collision_info(vehicle, collision)

    def parse_images(self, name: str, arguments: list[Any]) -> ImageCall:
        """Parse a call that renders images.

        Args:
            name: One of `IMAGE_CALLS`.
            arguments: Arguments of the call.

        Raises:
            ValueError: If an image request, a camera or the vehicle is invalid.
        """
        read = self._parse_one if name == "simGetImage" else self._parse_many
        _require_arguments(name, read, arguments)
        call: ImageCall = read(*arguments)
        # For the errors of the requests
        make_exposures(self.world, call.drone, call.requests)
        return call

    def _parse_one(
        self, camera: Any, image_type: Any, vehicle_name: str = "", extra: Any = None
    ) -> ImageCall:
        """Parse a call for one PNG.

        In `extra`, AirSim's clients send whether the camera stands in the world, and Cosys-AirSim's
        clients the name of an annotation, which is not supported.
        """
        if not (extra is None or isinstance(extra, bool) or extra == ""):
            raise ValueError(f"annotation_name is {shown(extra)}: leave it out")
        request = ImageRequest({"camera_name": camera, "image_type": image_type, "compress": True})
        return ImageCall(self._carrier(vehicle_name, extra is True), [request], False)

    def _parse_many(
        self, requests: Any, vehicle_name: str = "", external: Any = False
    ) -> ImageCall:
        """Parse a call for several images."""
        image_requests = [
            ImageRequest(request) for request in as_sequence("requests", requests, most=MAX_IMAGES)
        ]
        return ImageCall(self._carrier(vehicle_name, external), image_requests, True)

    def _carrier(self, vehicle_name: Any, external: Any) -> int | None:
        """Return the index of the vehicle that carries a camera; None for a camera in the world."""
        if check_flag("external", external):
            return None
        return self.world.vehicle(vehicle_name)[0]

    def _draw_images(self, name: str, arguments: list[Any]) -> Any:
        """Render the images of a call in this process."""
        call, airspace = self.parse_images(name, arguments), self.world.airspace
        exposures = make_exposures(self.world, call.drone, call.requests)
        responses = [
            make_response(exposure, *airspace.draw(exposure.view.shot, exposure.needs_bodies))
            for exposure in exposures
        ]
        return responses if call.is_list else responses[0]["image_data_uint8"]


def _make_control_error(vehicle: AirsimVehicle) -> NotReadyError:
    return NotReadyError(
        f"vehicle {vehicle.name!r} is not under API control; call enableApiControl(True, "
        f"{vehicle.name!r}) first"
    )


def _require_arguments(name: str, function: Callable[..., Any], arguments: Any) -> None:
    """Raise ValueError unless the number of arguments fits the signature of a function."""
    try:
        inspect.signature(function).bind(*arguments)
    except TypeError as error:
        values = [
            value for value in arguments if isinstance(value, int | float | str | list | dict)
        ]
        raise ValueError(f"{name} with {shown(values)}: {error}") from None
