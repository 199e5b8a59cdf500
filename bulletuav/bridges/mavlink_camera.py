"""Camera of a MAVLink vehicle on its gimbal: pictures in files, by the camera protocol.

Source: https://mavlink.io/en/services/camera.html.
"""

import logging
import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from bulletuav.bridges.mavlink_protocol import (
    Command,
    CommandResult,
    Message,
    OutgoingMessage,
    RefusedError,
    Sender,
    text,
)
from bulletuav.bridges.sockets import LOG_NAME
from bulletuav.files import whole_file

LOG = logging.getLogger(LOG_NAME)

CAMERA_COMPONENT = 100
"""Component ID of the camera (MAV_COMP_ID_CAMERA)"""
PICTURE_SIZE, VERTICAL_FOV = (640, 480), 60.0
"""Width and height, pixels, and vertical field of view, degrees"""
SENSOR_WIDTH = 6.4
"""Width of the reported sensor, mm"""
MIN_INTERVAL, MAX_PICTURES = 0.5, 1000
"""Minimum interval of pictures, s, and maximum number of pictures of a vehicle since the start"""
PICTURE_NAME = re.compile(r"vehicle([0-9]+)_([0-9]+)\.png")
"""Name of a file: system ID of the vehicle, and number of the picture"""
PICTURE_MIB = PICTURE_SIZE[0] * PICTURE_SIZE[1] * 3 / 2**20
"""Maximum size of a picture, MiB"""
HEARTBEAT_STEPS = 100
"""Steps between heartbeats"""
CAMERA_TYPE, NO_AUTOPILOT, ACTIVE = 30, 8, 4
"""MAV_TYPE, MAV_AUTOPILOT and MAV_STATE of heartbeats"""
CAN_CAPTURE, HAS_MODES = 2, 4
"""Bits of CAMERA_CAP_FLAGS"""
IMAGE_MODE = 0
"""CAMERA_MODE_IMAGE"""
STORAGE_READY = 2
STEPS_PER_SECOND = 100
Location = tuple[float, ...]


class MavlinkCamera:
    """Camera of one vehicle, a component of its own.

    Attributes:
        count: Number of pictures since the start.
    """

    def __init__(
        self, folder: Path, system_id: int, take: Callable[[], tuple[np.ndarray, Location]]
    ) -> None:
        """Initialise without pictures.

        Args:
            folder: Folder of the files. Numbers of files continue those of earlier pictures there.
            system_id: System ID of the vehicle.
            take: Function that returns pixels (H, W, 3) uint8, and latitude (deg), longitude,
                altitude (m), height above home and the attitude w, x, y, z of the camera.
        """
        self._folder, self._system_id, self._take = folder, system_id, take
        self.count = 0
        names = (PICTURE_NAME.fullmatch(path.name) for path in folder.iterdir())
        numbers = [int(name[2]) for name in names if name and int(name[1]) == system_id]
        self._first_number = max(numbers, default=-1) + 1
        self._interval_steps, self._remaining, self._next_tick = 0, 0, 0
        self._captured: list[tuple[Any, ...]] = []
        self._time_ms = 0

    def answer(self, message: Message, sender: Sender) -> list[OutgoingMessage]:
        """Handle a message that is addressed to the camera."""
        if message.get_type() not in ("COMMAND_LONG", "COMMAND_INT"):
            return []
        # COMMAND_INT has the same first four parameters, which are all that are used
        params = [getattr(message, f"param{k}") for k in range(1, 5)]
        try:
            replies, result = self._run(message.command, params), CommandResult.ACCEPTED
        except RefusedError as error:
            reason = text(str(error))._replace(component=CAMERA_COMPONENT)
            replies, result = [reason], error.result
        ack = ("command_ack", (message.command, result, 0, 0, *sender[:2]), CAMERA_COMPONENT)
        return [OutgoingMessage(*ack), *replies]

    def _run(self, command: int, params: Sequence[float]) -> list[OutgoingMessage]:
        """Run a command; return further messages."""
        if command == Command.REQUEST_MESSAGE:
            return [self._make(params[0], params[1])]
        if command == Command.SET_CAMERA_MODE:
            if params[1] != IMAGE_MODE:
                raise RefusedError("the camera takes no video", CommandResult.UNSUPPORTED)
        elif command == Command.START_CAPTURE:
            self._start(*params[1:3])
        elif command == Command.STOP_CAPTURE:
            self._remaining = 0
        else:
            raise RefusedError(f"command {command} unknown", CommandResult.UNSUPPORTED)
        return []

    def _start(self, interval: float, count: float) -> None:
        """Take a number of pictures, 0 for no end, at an interval, s."""
        if not (0 <= count <= MAX_PICTURES and count == int(count)):
            raise RefusedError(f"pictures: a number from 0 to {MAX_PICTURES} is needed")
        if count != 1 and not MIN_INTERVAL <= interval < math.inf:
            raise RefusedError(f"interval of pictures: {MIN_INTERVAL:g} s or more is needed")
        if self.count >= MAX_PICTURES:
            raise RefusedError("storage is full", CommandResult.TEMPORARILY_REJECTED)
        self._remaining, self._next_tick = int(count) or MAX_PICTURES, 0
        self._interval_steps = 0 if count == 1 else round(min(interval, 1e6) * STEPS_PER_SECOND)

    def due(self, tick: int) -> list[OutgoingMessage]:
        """Take the picture that is due at a step; return the messages to all clients."""
        self._time_ms = tick * 1000 // STEPS_PER_SECOND
        messages = []
        if tick % HEARTBEAT_STEPS == self._system_id % HEARTBEAT_STEPS:
            beat = (CAMERA_TYPE, NO_AUTOPILOT, 0, 0, ACTIVE, 3)
            messages.append(OutgoingMessage("heartbeat", beat, CAMERA_COMPONENT))
        if self._remaining and tick >= self._next_tick and self.count < MAX_PICTURES:
            self._remaining -= 1
            self._next_tick = tick + self._interval_steps
            try:
                self._capture()
                messages.append(self._make(CAMERA_IMAGE_CAPTURED, self.count - 1))
            except OSError as error:
                self._remaining = 0
                LOG.warning("vehicle %d: %s", self._system_id, error)
                messages.append(text("picture cannot be written: see the log"))
        return messages

    def _capture(self) -> None:
        """Take a picture and write its file."""
        pixels, location = self._take()
        name = f"vehicle{self._system_id}_{self._first_number + self.count:04d}.png"
        with whole_file(self._folder / name) as file:
            Image.fromarray(pixels).save(file, "PNG")
        latitude, longitude, altitude, height, *attitude = location
        scaled = (round(latitude * 1e7), round(longitude * 1e7))
        heights = (round(altitude * 1000), round(height * 1000))
        place = (*scaled, *heights, attitude, self.count, 1, name.encode())
        self._captured.append((self._time_ms, 0, 0, *place))
        self.count += 1

    def _make(self, number: float, index: float) -> OutgoingMessage:
        """Return a message by its ID; of the pictures, that of an index."""
        if number == CAMERA_IMAGE_CAPTURED:
            if index not in range(self.count):
                raise RefusedError(f"no picture {index:g}")
            name, fields = "camera_image_captured", self._captured[int(index)]
        elif number in INFORMATION:
            name, make = INFORMATION[int(number)]
            fields = make(self)
        else:
            raise RefusedError(f"message {number:g} unknown", CommandResult.UNSUPPORTED)
        return OutgoingMessage(name, fields, CAMERA_COMPONENT)

    def _information(self) -> tuple[Any, ...]:
        width, height = PICTURE_SIZE
        sensor_height = SENSOR_WIDTH * height / width
        focal_length = sensor_height / 2 / math.tan(math.radians(VERTICAL_FOV / 2))
        names = [list(name.ljust(32, b"\0")) for name in (b"bulletuav", b"camera")]
        optics = (focal_length, SENSOR_WIDTH, sensor_height, width, height, 0)
        return (self._time_ms, *names, 0, *optics, CAN_CAPTURE | HAS_MODES, 0, b"")

    def _settings(self) -> tuple[Any, ...]:
        return (self._time_ms, IMAGE_MODE)

    def _storage(self) -> tuple[Any, ...]:
        total, used = PICTURE_MIB * MAX_PICTURES, PICTURE_MIB * self.count
        return (self._time_ms, 1, 1, STORAGE_READY, total, used, total - used, 0.0, 0.0)

    def _capture_status(self) -> tuple[Any, ...]:
        interval = self._interval_steps / STEPS_PER_SECOND
        status = (1 if self._remaining else 0) | (2 if interval and self._remaining else 0)
        available = PICTURE_MIB * (MAX_PICTURES - self.count)
        return (self._time_ms, status, 0, interval, 0, available, self.count)


CAMERA_IMAGE_CAPTURED = 263
INFORMATION: dict[int, tuple[str, Callable[[MavlinkCamera], tuple[Any, ...]]]] = {
    259: ("camera_information", MavlinkCamera._information),
    260: ("camera_settings", MavlinkCamera._settings),
    261: ("storage_information", MavlinkCamera._storage),
    262: ("camera_capture_status", MavlinkCamera._capture_status),
}
"""Messages of the camera by ID"""
