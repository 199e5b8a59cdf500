"""Recordings in AirSim's format: airsim_rec.txt with states, and a folder of images.

The columns are those of AirSim's multirotors: name, time (ms), position (north, east, down of the
start, m), attitude (w, x, y, z) and image files.
"""

import itertools
import re
import time
from pathlib import Path
from typing import IO, Any

import numpy as np

from bulletuav.bridges.airsim_images import ImageCall, ImageRequest, make_exposures
from bulletuav.bridges.airsim_pictures import PictureQueue
from bulletuav.bridges.airsim_settings import RecordedCamera
from bulletuav.bridges.airsim_states import kinematics
from bulletuav.bridges.airsim_world import AirsimWorld

COLUMNS = "VehicleName TimeStamp POS_X POS_Y POS_Z Q_W Q_X Q_Y Q_Z ImageFile"
MAX_ROWS = 1_000_000
"""Maximum number of rows of a recording, which then ends"""
MAX_RECORDINGS = 1000
"""Maximum number of recordings of a server"""
DEFAULT_REQUEST = {"camera_name": "0", "image_type": 0, "compress": True}
"""Image of each vehicle if the settings list none: the scene of the front camera, as PNG"""


class AirsimRecorder:
    """Recorder of the states and images of all vehicles.

    Rows follow the interval of the settings in simulated time; there are fewer if images take
    longer to render.
    """

    def __init__(self, world: AirsimWorld, folder: Path | None = None) -> None:
        """Create a recorder, which starts if the settings say so.

        Args:
            world: The vehicles.
            folder: Folder in which each recording gets a folder of its own; None if clients may not
                record.

        Raises:
            ValueError: If the settings start a recording and there is no folder, or a recorded
                camera does not exist.
        """
        self._world, self._parent = world, folder
        self._folder = Path()
        self._file: IO[str] | None = None
        self._due, self._num_rows, self._num_recordings = 0.0, 0, 0
        self._last: dict[str, Any] = {}
        # A default name of a vehicle is only valid until another vehicle is added
        cameras = world.settings.recording.cameras
        self._cameras = None if cameras is None else [self._resolve(one) for one in cameras]
        if world.settings.recording.enabled:
            self.start()

    def _resolve(self, camera: RecordedCamera) -> RecordedCamera:
        """Return a camera with the name of its vehicle; raise ValueError if it does not exist."""
        i, vehicle = self._world.vehicle(camera.vehicle)
        make_exposures(self._world, i, [ImageRequest(camera.request)])
        return camera._replace(vehicle=vehicle.name)

    @property
    def is_recording(self) -> bool:
        """Whether a recording is in progress."""
        return self._file is not None

    @property
    def is_due(self) -> bool:
        """Whether the next rows are due."""
        return self._file is not None and self._world.time >= self._due

    def start(self) -> None:
        """Start a recording in a new folder, unless one is in progress.

        Raises:
            ValueError: If there is no folder for recordings, it cannot be written, or there were
                `MAX_RECORDINGS` recordings.
        """
        if self._file is not None:
            return
        if self._parent is None:
            raise ValueError("there is no folder: start the server with --recordings FOLDER")
        if self._num_recordings >= MAX_RECORDINGS:
            raise ValueError(
                f"this server has started {MAX_RECORDINGS} recordings, which is the maximum: "
                f"restart it for more"
            )
        stem = time.strftime("%Y-%m-%d-%H-%M-%S")
        names = (stem if k == 0 else f"{stem}-{k}" for k in itertools.count())
        self._folder = next(
            path for path in (self._parent / name for name in names) if not path.exists()
        )
        try:
            (self._folder / "images").mkdir(parents=True)
            self._file = (self._folder / "airsim_rec.txt").open("w", encoding="utf-8")
        except OSError as error:
            raise ValueError(f"{self._folder} cannot be written: {error.strerror}") from None
        self._file.write("\t".join(COLUMNS.split()) + "\n")
        self._file.flush()
        self._due, self._num_rows, self._last = self._world.time, 0, {}
        self._num_recordings += 1

    def stop(self) -> None:
        """End the recording, if there is one."""
        file, self._file = self._file, None
        if file is not None:
            file.close()

    async def record(self, pictures: PictureQueue) -> None:
        """Write a row of each vehicle, with its images.

        Args:
            pictures: Queue that renders the images.

        Raises:
            DrawingError: If an image cannot be rendered.
            OSError: If a file cannot be written.
            ValueError: If a camera does not exist any more.
        """
        file, folder = self._file, self._folder / "images"
        if file is None:
            return
        settings = self._world.settings.recording
        self._due = self._world.time + settings.interval
        for name in list(self._world.vehicles):
            row = self._make_row(name)
            if settings.on_move and row[1:] == self._last.get(name):
                continue
            self._last[name] = row[1:]
            images = [
                await self._write_image(pictures, folder, name, k, camera)
                for k, camera in enumerate(self._list_cameras(name))
            ]
            # The recording may have been stopped meanwhile, and another one started
            if self._file is not file:
                return
            file.write("\t".join([name, *row, ";".join(images)]) + "\n")
            file.flush()
            self._num_rows += 1
        if self._num_rows >= MAX_ROWS:
            self.stop()

    def _list_cameras(self, name: str) -> list[RecordedCamera]:
        """Return the cameras of a vehicle that are recorded."""
        if self._cameras is None:
            return [RecordedCamera(name, DEFAULT_REQUEST)]
        return [camera for camera in self._cameras if camera.vehicle == name]

    def _make_row(self, name: str) -> list[str]:
        """Return time, position and attitude of a vehicle as texts."""
        state = kinematics(self._world, *self._world.vehicle(name))
        values = [state["position"][f"{axis}_val"] for axis in "xyz"]
        values += [state["orientation"][f"{axis}_val"] for axis in "wxyz"]
        return [str(round(self._world.time * 1000)), *(f"{value:.6g}" for value in values)]

    async def _write_image(
        self, pictures: PictureQueue, folder: Path, name: str, k: int, camera: RecordedCamera
    ) -> str:
        """Render the image of camera `k` of a vehicle and write it; return the name of its file."""
        import msgpack

        i, _ = self._world.vehicle(name)
        request = ImageRequest(camera.request)
        parts = await pictures.draw(ImageCall(i, [request], True))
        (image,) = msgpack.unpackb(b"".join(parts), max_array_len=2**26)
        suffix, content = encode_image(image)
        # Names may have any letters, so that only the numbers make the name of the file unique
        label = re.sub(r"[^\w.-]", "_", f"{name}_{request.camera}")
        file = f"img_{i}_{k}_{label}_{request.kind}_{image['time_stamp']}{suffix}"
        (folder / file).write_bytes(content)
        return file


def encode_image(image: dict[str, Any]) -> tuple[str, bytes]:
    """Return the suffix and the content of the file of an ImageResponse: PNG, PPM or PFM."""
    width, height = image["width"], image["height"]
    if image["pixels_as_float"]:
        # PFM stores rows from bottom to top; a negative scale means little-endian numbers
        rows = np.array(image["image_data_float"], dtype="<f4").reshape(height, width)[::-1]
        return ".pfm", f"Pf\n{width} {height}\n-1\n".encode() + rows.tobytes()
    if image["compress"]:
        return ".png", image["image_data_uint8"]
    pixels = np.frombuffer(image["image_data_uint8"], np.uint8).reshape(height, width, 3)
    return ".ppm", f"P6\n{width} {height}\n255\n".encode() + pixels[:, :, ::-1].tobytes()
