"""AirSim's settings.json: vehicles, cameras, sensors, clock, origin, wind and recording.

Keys that have no effect here are collected, so that the server can list them once. Defaults are
those of AirSim's documentation: https://microsoft.github.io/AirSim/settings/ and, for sensors,
https://microsoft.github.io/AirSim/sensors/.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bulletuav.bridges.airsim_values import check_flag, check_text, rotation_from_degrees
from bulletuav.errors import as_int, as_sequence, finite, naming, shown, unknown
from bulletuav.geometry.rotation import Quat4
from bulletuav.parsing import read_json

MAX_BYTES = 2**20
"""Maximum size of a file, bytes"""
MAX_ENTRIES = 256
"""Maximum number of vehicles, and of cameras or sensors of a vehicle"""
MAX_DISTANCE = 1e5
"""Maximum magnitude of a coordinate, m"""
MAX_RANGE = 1000.0
"""Maximum range of a sensor, m"""
MAX_BEAMS = 20_000
"""Maximum number of beams of a lidar's reading"""
MAX_SIDE, MAX_PIXELS = 4096, 5_000_000
"""Maximum width and height, and number of pixels, of an image. A response of more than 16 MiB could
not wait for a client that reads slowly."""
IMAGE_SIZE, HORIZONTAL_FOV = (256, 144), math.radians(90)
"""Default width and height, pixels, and horizontal field of view, rad"""
VEHICLE_TYPES = ("simpleflight", "px4multirotor", "arducopter", "arducoptersolo")
"""Types of vehicles, in lower case. All are flown by the controller of this package."""
STATES = ("Armed", "Disarmed", "Inactive")
"""States of a vehicle at the start; by default the first one, as in AirSim"""
DISTANCE, LIDAR = 5, 6
"""AirSim's sensor types with beams; 1 to 4 are on every vehicle"""
FRAMES = ("SensorLocalFrame", "VehicleInertialFrame")
"""Frames of the points of a lidar: the sensor's, or north, east, down from the vehicle's start"""
EVERY_VEHICLE = (1, 2, 3, 4)
"""Sensor types that every vehicle has: barometer, IMU, GPS and magnetometer, without noise"""
SILENT = ("SeeDocsAt", "SettingsVersion")
"""Keys without any effect in AirSim, either"""
MAX_LISTED = 30
"""Maximum number of ignored keys in a message"""


class MountPose(NamedTuple):
    """Pose of a camera or sensor on a vehicle, or in the world.

    Attributes:
        position: (3,) position in body axes (FLU), or east, north, up of the origin, m.
        rotation: Quaternion x, y, z, w from the axes of the camera (FLU) to the body or the world.
    """

    position: np.ndarray
    rotation: Quat4


class Capture(NamedTuple):
    """Settings of one image type of a camera.

    Attributes:
        size: Width and height, pixels.
        field_of_view: Horizontal field of view, rad.
    """

    size: tuple[int, int] = IMAGE_SIZE
    field_of_view: float = HORIZONTAL_FOV


class CameraSettings(NamedTuple):
    """Settings of a camera.

    Attributes:
        position: (3,) forward, right, down of the vehicle, m; NaN for the default of the camera.
        angles: Roll, pitch, yaw, degrees; NaN for the default of the camera.
        captures: Settings by image type.
    """

    position: tuple[float, ...] = (math.nan,) * 3
    angles: tuple[float, ...] = (math.nan,) * 3
    captures: Mapping[int, Capture] = {}


class BeamSensor(NamedTuple):
    """Settings of a lidar or a distance sensor.

    Attributes:
        kind: `DISTANCE` or `LIDAR`.
        mount: Pose on the vehicle.
        min_range, max_range: Range, m.
        num_azimuths: Number of beams of a channel.
        elevations: Elevation of each channel, degrees.
        azimuths: First and last azimuth, degrees clockwise from forward.
        frame: One of `FRAMES`.
    """

    kind: int
    mount: MountPose
    min_range: float
    max_range: float
    num_azimuths: int = 1
    elevations: tuple[float, ...] = (0.0,)
    azimuths: tuple[float, float] = (0.0, 0.0)
    frame: str = FRAMES[1]


class VehicleSettings(NamedTuple):
    """Settings of a vehicle.

    Attributes:
        place: North, east, down of the origin, m.
        yaw: Heading, degrees clockwise from north.
        is_armed: Whether the vehicle is armed at the start and after a reset.
        cameras: Settings of cameras by name.
        sensors: Lidars and distance sensors by name.
    """

    place: tuple[float, ...] = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    is_armed: bool = True
    cameras: Mapping[str, CameraSettings] = {}
    sensors: Mapping[str, BeamSensor] = {}


class RecordedCamera(NamedTuple):
    """Camera whose images are recorded.

    Attributes:
        vehicle: Name of the vehicle; empty for the first.
        request: Request for the image, as clients send it.
    """

    vehicle: str
    request: dict[str, Any]


class RecordingSettings(NamedTuple):
    """Settings of recordings.

    Attributes:
        interval: Minimum time between two rows, s.
        on_move: Whether rows are only written if the vehicle has moved.
        enabled: Whether recording starts with the server.
        cameras: Cameras to record; None for the scene of camera 0 of each vehicle.
    """

    interval: float = 0.05
    on_move: bool = False
    enabled: bool = False
    cameras: tuple[RecordedCamera, ...] | None = None


class AirsimSettings(NamedTuple):
    """Contents of a settings file.

    Attributes:
        vehicles: Settings of vehicles by name; None for the server's default vehicles.
        cameras: Default settings of cameras.
        external_cameras: Cameras that stand in the world, by name.
        sensors: Lidars and distance sensors of vehicles that do not list sensors.
        clock_speed: Real-time factor, or None.
        port: Port of the server, or None.
        wind: North, east, down, m/s, or None.
        origin: Latitude, longitude (degrees) and altitude (m) of the origin, or None.
        recording: Settings of recordings.
        text: The file, for clients that ask for it.
        ignored: Keys that have no effect here.
    """

    vehicles: Mapping[str, VehicleSettings] | None = None
    cameras: CameraSettings = CameraSettings()
    external_cameras: Mapping[str, CameraSettings] = {}
    sensors: Mapping[str, BeamSensor] = {}
    clock_speed: float | None = None
    port: int | None = None
    wind: tuple[float, ...] | None = None
    origin: tuple[float, ...] | None = None
    recording: RecordingSettings = RecordingSettings()
    text: str = "{}"
    ignored: tuple[str, ...] = ()


class _Section:
    """Part of the file, which records the keys that are read."""

    def __init__(self, values: Any, where: str, ignored: list[str]) -> None:
        if not isinstance(values, Mapping):
            raise ValueError(f"{where or 'the file'} is {shown(values)}: an object is needed")
        self._values, self._where, self._ignored = dict(values), where, ignored

    def name(self, key: str) -> str:
        """Return the name of a key in messages, with control characters escaped."""
        escaped = shown(key)[1:-1]
        return f"{self._where}.{escaped}" if self._where else escaped

    def __contains__(self, key: str) -> bool:
        """Return whether the file has a key that is not read yet."""
        return key in self._values

    def pop(self, key: str, default: Any = None) -> Any:
        """Return a value, and record that its key is read."""
        return self._values.pop(key, default)

    def number(self, key: str, default: float, least: float, most: float) -> float:
        """Return a number; NaN, which AirSim writes for defaults, is the default."""
        value = self.pop(key, default)
        if isinstance(value, float) and math.isnan(value):
            return default
        return finite(self.name(key), value, least, most)

    def numbers(self, keys: tuple[str, ...], default: float, most: float) -> tuple[float, ...]:
        """Return numbers from -most to most."""
        return tuple(self.number(key, default, -most, most) for key in keys)

    def count(self, key: str, default: int, least: int, most: int) -> int:
        """Return an integer."""
        return as_int(self.name(key), self.pop(key, default), least, most)

    def flag(self, key: str, default: bool) -> bool:
        """Return a boolean."""
        return check_flag(self.name(key), self.pop(key, default))

    def text(self, key: str, default: str) -> str:
        """Return a string."""
        return check_text(self.name(key), self.pop(key, default))

    def section(self, key: str, default: Mapping[str, Any] | None = None) -> "_Section":
        """Return an object; by default an empty one."""
        return _Section(self.pop(key, default or {}), self.name(key), self._ignored)

    def sections(self, key: str) -> dict[str, "_Section"]:
        """Return the objects of an object by their names."""
        part = self.section(key)
        if len(part._values) > MAX_ENTRIES:
            raise ValueError(
                f"{self.name(key)} has {len(part._values)} entries: at most {MAX_ENTRIES} are "
                f"possible"
            )
        if "" in part._values:
            raise ValueError(f"{self.name(key)} has an entry without a name")
        return {name: part.section(name) for name in list(part._values)}

    def items(self, key: str) -> list["_Section"]:
        """Return the objects of a list."""
        values = as_sequence(self.name(key), self.pop(key, []), most=MAX_ENTRIES)
        return [
            _Section(value, f"{self.name(key)}[{k}]", self._ignored)
            for k, value in enumerate(values)
        ]

    def ignore(self, remark: str = "") -> None:
        """Record the whole object as ignored, with a remark."""
        self._ignored.append(f"{self._where}{remark}")

    def close(self, silent: tuple[str, ...] = ()) -> None:
        """Record the keys that were not read as ignored."""
        self._ignored += [self.name(key) for key in self._values if key not in silent]


def read_airsim_settings(path: str | Path) -> AirsimSettings:
    """Read a settings file.

    Args:
        path: The file.

    Returns:
        The settings.

    Raises:
        ValueError: If the file is not valid JSON, or a value that is used is invalid. The message
            contains the path and the key.
        OSError: If the file cannot be read.
    """
    file = Path(path)
    if file.is_file() and file.stat().st_size > MAX_BYTES:
        raise ValueError(f"{file} is larger than {MAX_BYTES} bytes: it is no settings file")
    values = read_json(file)
    with naming(file):
        return parse_settings(values, file.read_text(encoding="utf-8-sig"))


def parse_settings(values: Any, text: str = "{}") -> AirsimSettings:
    """Convert the value of a settings file.

    Args:
        values: Plain value of the JSON.
        text: The JSON.

    Returns:
        The settings.

    Raises:
        ValueError: If a value that is used is invalid.
    """
    ignored: list[str] = []
    root = _Section(values, "", ignored)
    mode = root.text("SimMode", "")
    if mode not in ("", "Multirotor"):
        raise ValueError(f"SimMode is {shown(mode)}: only 'Multirotor' is supported")
    cameras = _read_camera(root.section("CameraDefaults"), CameraSettings())
    sensors, external = _read_sensors(root, "DefaultSensors", {}), root.sections("ExternalCameras")
    vehicles: dict[str, VehicleSettings] = {}
    for name, part in root.sections("Vehicles").items():
        # Vehicles that are not created are read, too, for their errors
        is_created = part.flag("AutoCreate", True)
        vehicle = _read_vehicle(part, cameras, sensors)
        if is_created:
            vehicles[name] = vehicle
    settings = AirsimSettings(
        vehicles=vehicles or None,
        cameras=cameras,
        external_cameras={name: _read_camera(part, cameras) for name, part in external.items()},
        sensors=sensors,
        clock_speed=_optional(root, "ClockSpeed", 1e-3, 1e3),
        port=None if (port := root.pop("ApiServerPort")) is None else as_int(
            "ApiServerPort", port, 0, 65535
        ),
        wind=_read_wind(root),
        origin=_read_origin(root),
        recording=_read_recording(root.section("Recording")),
        text=text,
    )  # fmt: skip
    root.close(SILENT)
    return settings._replace(ignored=tuple(ignored))


def list_ignored(keys: Sequence[str]) -> str:
    """Return the ignored keys of a file, for a message."""
    names = list(dict.fromkeys(keys))
    more = len(names) - MAX_LISTED
    return ", ".join(names[:MAX_LISTED]) + (f" and {more} more" if more > 0 else "")


def _optional(part: _Section, key: str, least: float, most: float) -> float | None:
    """Return a number, or None if there is none."""
    value = part.number(key, math.nan, least, most) if key in part else None
    return None if value is None or math.isnan(value) else value


def _read_wind(root: _Section) -> tuple[float, ...] | None:
    if "Wind" not in root:
        return None
    part = root.section("Wind")
    wind = part.numbers(("X", "Y", "Z"), 0.0, 100.0)
    part.close()
    return wind


def _read_origin(root: _Section) -> tuple[float, ...] | None:
    if "OriginGeopoint" not in root:
        return None
    part = root.section("OriginGeopoint")
    bounds = {"Latitude": (-90, 90), "Longitude": (-180, 180), "Altitude": (-500, 10_000)}
    if missing := [key for key in bounds if key not in part]:
        raise ValueError(f"OriginGeopoint has no {', '.join(missing)}")
    origin = tuple(part.number(key, 0.0, *bounds[key]) for key in bounds)
    part.close()
    return origin


def _read_recorded_camera(part: _Section) -> RecordedCamera:
    camera = RecordedCamera(
        part.text("VehicleName", ""),
        {
            "camera_name": part.text("CameraName", "0"),
            "image_type": part.count("ImageType", 0, 0, 11),
            "pixels_as_float": part.flag("PixelsAsFloat", False),
            "compress": part.flag("Compress", True),
        },
    )
    part.close()
    return camera


def _read_recording(part: _Section) -> RecordingSettings:
    """Return the settings of recordings. The folder is an option of the server, not of the file."""
    defaults = RecordingSettings()
    cameras = None
    if "Cameras" in part:
        cameras = tuple(_read_recorded_camera(one) for one in part.items("Cameras"))
    settings = RecordingSettings(
        interval=part.number("RecordInterval", defaults.interval, 0.0, 1e6),
        on_move=part.flag("RecordOnMove", False),
        enabled=part.flag("Enabled", False),
        cameras=cameras,
    )
    part.close()
    return settings


def _read_vehicle(
    part: _Section, cameras: CameraSettings, sensors: Mapping[str, BeamSensor]
) -> VehicleSettings:
    kind = part.text("VehicleType", VEHICLE_TYPES[0])
    if kind.lower() not in VEHICLE_TYPES:
        raise unknown(part.name("VehicleType"), kind, ("SimpleFlight", "PX4Multirotor"))
    state = part.text("DefaultVehicleState", "") or STATES[0]
    if state not in STATES:
        raise unknown(part.name("DefaultVehicleState"), state, STATES)
    place = part.numbers(("X", "Y", "Z"), 0.0, MAX_DISTANCE)
    vehicle = VehicleSettings(
        place=place,
        yaw=part.number("Yaw", 0.0, -360.0, 360.0),
        is_armed=state == STATES[0],
        cameras={
            name: _read_camera(one, cameras) for name, one in part.sections("Cameras").items()
        },
        sensors=_read_sensors(part, "Sensors", sensors),
    )
    part.close()
    return vehicle


def _read_camera(part: _Section, defaults: CameraSettings) -> CameraSettings:
    """Return the settings of a camera, with the defaults for the values that it does not set."""
    position = tuple(
        part.number(key, default, -MAX_DISTANCE, MAX_DISTANCE)
        for key, default in zip(("X", "Y", "Z"), defaults.position, strict=True)
    )
    angles = tuple(
        part.number(key, default, -360.0, 360.0)
        for key, default in zip(("Roll", "Pitch", "Yaw"), defaults.angles, strict=True)
    )
    captures = dict(defaults.captures)
    for one in part.items("CaptureSettings"):
        kind = one.count("ImageType", 0, -1, 11)
        (width, height), view = captures.get(kind, Capture())
        width = one.count("Width", width, 8, MAX_SIDE)
        height = one.count("Height", height, 8, MAX_SIDE)
        if width * height > MAX_PIXELS:
            raise ValueError(
                f"{one.name('Width')} is {width} and Height {height}: at most {MAX_PIXELS} pixels "
                f"are possible"
            )
        view = math.radians(one.number("FOV_Degrees", math.degrees(view), 5.0, 170.0))
        # Type -1 is the window of AirSim's program, which this server does not have
        if kind >= 0:
            captures[kind] = Capture((width, height), view)
        one.close()
    part.close()
    return CameraSettings(position, angles, captures)


def _read_sensors(
    part: _Section, key: str, defaults: Mapping[str, BeamSensor]
) -> dict[str, BeamSensor]:
    """Return lidars and distance sensors by name; sensors of other types are recorded as ignored.

    Sensors of a vehicle override the default sensors of the same names.
    """
    sensors = dict(defaults)
    for name, one in part.sections(key).items():
        kind = one.count("SensorType", 0, 0, 100)
        is_enabled = one.flag("Enabled", True)
        sensors.pop(name, None)
        if kind in (DISTANCE, LIDAR):
            sensor = _read_distance(one) if kind == DISTANCE else _read_lidar(one)
            if is_enabled:
                sensors[name] = sensor
        elif kind not in EVERY_VEHICLE:
            one.ignore(f" (SensorType {kind})")
            continue
        elif not is_enabled:
            one.ignore(".Enabled")
        one.close()
    return sensors


def _read_mount(part: _Section) -> MountPose:
    forward, right, down = part.numbers(("X", "Y", "Z"), 0.0, 100.0)
    angles = part.numbers(("Roll", "Pitch", "Yaw"), 0.0, 360.0)
    return MountPose(np.array((forward, -right, -down)), rotation_from_degrees(*angles))


def _read_distance(part: _Section) -> BeamSensor:
    least = part.number("MinDistance", 0.2, 0.0, MAX_RANGE)
    most = part.number("MaxDistance", 40.0, least, MAX_RANGE)
    return BeamSensor(DISTANCE, _read_mount(part), least, most)


def _read_lidar(part: _Section) -> BeamSensor:
    """Return a lidar, whose reading is one rotation."""
    channels = part.count("NumberOfChannels", 16, 1, 1024)
    rotations = part.count("RotationsPerSecond", 10, 1, 1000)
    points = part.count("PointsPerSecond", 100_000, 1, 10**8) // rotations
    if points > MAX_BEAMS:
        raise ValueError(
            f"{part.name('PointsPerSecond')} gives {points} points in a rotation: at most "
            f"{MAX_BEAMS} are possible"
        )
    upper = part.number("VerticalFOVUpper", -15.0, -90.0, 90.0)
    lower = part.number("VerticalFOVLower", -45.0, -90.0, 90.0)
    first = part.number("HorizontalFOVStart", 0.0, -360.0, 360.0)
    last = part.number("HorizontalFOVEnd", 359.0, -360.0, 360.0)
    frame = part.text("DataFrame", FRAMES[1])
    if frame not in FRAMES:
        raise unknown(part.name("DataFrame"), frame, FRAMES)
    mount = _read_mount(part)
    elevations = tuple(np.linspace(upper, lower, channels).tolist())
    most = part.number("Range", 100.0, 0.1, MAX_RANGE)
    return BeamSensor(
        LIDAR, mount, 0.0, most, max(points // channels, 1), elevations, (first, last), frame
    )
