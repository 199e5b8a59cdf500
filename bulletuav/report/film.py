"""Films: a recorded episode in 3-D, rendered by the engine without a screen."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import ImageDraw

from bulletuav.analysis.recorded import Recording
from bulletuav.engine.engine import Engine
from bulletuav.envs.marks import Lens, Marks, draw
from bulletuav.envs.renderer import Renderer, fit_camera, pixel_size
from bulletuav.errors import as_int, find_choice
from bulletuav.files import whole_file
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.quaternions import multiply_quaternions, rotate_vectors
from bulletuav.geometry.shapes import BOX, CYLINDER, SPHERE
from bulletuav.geometry.solids import Solids
from bulletuav.parsing import parse_json
from bulletuav.report.figures import (
    MAX_NUMBERED_DRONES,
    NO_PADS,
    PAD_COLOUR,
    PAD_THICKNESS,
    drone_colours,
)
from bulletuav.report.replay import SCENE_ERRORS, scene_error, unwrap_quaternions
from bulletuav.report.video import FPS, save_video
from bulletuav.tasks.frame import UPRIGHT
from bulletuav.vehicle.airframes import load_airframe

SIZE = (960, 540)
"""Width and height of pictures, pixels"""
CAMERAS = ("orbit", "follow", "still")
ELEVATION = {"orbit": 32.0, "follow": 30.0, "still": 28.0}
"""Elevation of each camera above the horizon, degrees"""
SOUTH_WEST = np.radians(234.0)
"""Initial azimuth of the camera, from the east, rad"""
TURN = np.radians(9.0)
"""Angular velocity of the camera "orbit", rad/s"""
FOLLOW_DISTANCE = 5.0
"""Distance of the camera "follow", in wing spans of its drone"""
FOLLOW_LAG = 1.0
"""Time constant of the camera "follow", s"""
TRAIL_TIME = 5.0
"""Length of trails, s"""
MIN_DRONE_PIXELS = 14
"""Minimum size of drones in views of the whole scene, pixels"""
TEXT_COLOUR = (40, 40, 40)
PLACEHOLDER_AIRFRAME = "cf2x"
"""Airframe of the one drone that the engine requires; it is outside of all pictures"""


class Film:
    """Renders pictures of a recording at any time."""

    def __init__(
        self,
        recording: Recording,
        title: str,
        camera: str = "orbit",
        drone: int = 0,
        size: tuple[int, int] = SIZE,
        source: str = "",
    ) -> None:
        """Create the scene in the engine.

        Args:
            recording: The episode, with its scene.
            title: Title of the pictures.
            camera: "orbit" circles the whole scene, "still" shows the whole scene from the
                south-west, "follow" flies behind a drone.
            drone: Number of that drone.
            size: Width and height, pixels.
            source: Path of the recording, for messages.

        Raises:
            ValueError: If the camera or drone does not exist, or the scene is damaged.
        """
        find_choice("camera", camera, dict.fromkeys(CAMERAS))
        count = recording.position.shape[1]
        self._drone = as_int("drone", drone, 0, count - 1)
        self._recording, self._title, self._camera = recording, title, camera
        self._size = size
        self._turns = unwrap_quaternions(recording.quaternion)
        self._colours = [
            tuple(round(255 * part) for part in colour[:3])
            for colour in drone_colours(count).tolist()
        ]
        # Cameras are computed from the whole flight, so that they move smoothly
        self._overview = self._fit_overview()
        self._camera_azimuth = self._follow_azimuths()
        # The scene of a file may be malformed
        try:
            self._about = parse_json(str(recording.scene["about"]), "its description")
            self._make_bodies()
        except SCENE_ERRORS as error:
            raise scene_error(error, source) from None
        self._renderer = Renderer(self._engine, size)

    def _make_bodies(self) -> None:
        """Create an engine whose obstacles are the obstacles and the parts of all drones."""
        recording, about = self._recording, self._about
        # Obstacles first, followed by the parts of drones, whose drones are in `_owner`
        bodies = [_obstacle(one) for one in about["obstacles"]]
        self._owner: list[int] = []
        places, turns = [], []
        for drone, kind in enumerate(about["airframe_of"]):
            airframe = about["airframes"][kind]
            scale = self._scale(airframe["radius"])
            for part in airframe["parts"]:
                # Rotors have the colour of the drone
                colour = [share / 255 for share in self._colours[drone]]
                own = part if not _is_disc(part) else {**part, "colour": [*colour, 1.0]}
                bodies.append(_obstacle(own, scale))
                self._owner.append(drone)
                places.append(scale * np.array(part["position"]))
                turns.append(part["quaternion"])
        pads = about.get("pads", NO_PADS)
        bodies += [
            Obstacle("cylinder", (pads["radius"], PAD_THICKNESS), (*PAD_COLOUR, 1.0))
            for _ in pads["places"]
        ]
        self._pads = np.array(pads["places"]).reshape(-1, 3)
        self._place = np.array(places)
        self._own_turn = np.array(turns)
        # The last buildings are hulls, whose vertices are concatenated
        sizes = recording.scene["hull_size"]
        hulls = np.split(recording.scene["hull"], np.cumsum(sizes)[:-1]) if len(sizes) else []
        boxes = recording.building[: len(recording.building) - len(sizes)]
        city = [Solids(boxes, tuple(hulls))] if len(recording.building) else []
        # The engine only renders; it does not simulate
        self._engine = Engine([load_airframe(PLACEHOLDER_AIRFRAME)], 1, 1.0, bodies, city)
        if city:
            self._engine.set_layouts(np.array([0]), np.array([True]))

    def _scale(self, radius: float) -> float:
        """Return the enlargement of a drone of a radius."""
        if self._camera == "follow":
            return 1.0
        return max(
            1.0, MIN_DRONE_PIXELS * pixel_size(self._overview[1], self._size[1]) / (2 * radius)
        )

    def _fit_overview(self) -> tuple[np.ndarray, float]:
        """Find the centre of the scene, and the camera distance from which all of it is visible."""
        recording = self._recording
        parts = (recording.position, recording.goal, recording.target)
        points = np.concatenate([part.reshape(-1, 3) for part in parts])
        around = SOUTH_WEST + np.linspace(0, 2 * np.pi, 16, endpoint=False)
        sides = around if self._camera == "orbit" else [SOUTH_WEST]
        fits = [fit_camera(points, self._direction(side), self._size) for side in sides]
        return fits[0][0], max(distance for _, distance in fits)

    def _direction(self, azimuth: float) -> np.ndarray:
        """Return the unit vector to the camera at an azimuth."""
        height = np.radians(ELEVATION[self._camera])
        level = np.cos(height)
        return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(height)])

    def _follow_azimuths(self) -> np.ndarray:
        """Return the azimuths (R,) behind the followed drone, rad, low-pass filtered."""
        recording = self._recording
        times = recording.time
        keep = np.exp(-(times[1] - times[0]) / FOLLOW_LAG)
        velocity = recording.velocity[:, self._drone, :2]
        smooth = np.zeros_like(velocity)
        smooth[0] = velocity[0]
        for row in range(1, len(velocity)):
            smooth[row] = keep * smooth[row - 1] + (1 - keep) * velocity[row]
        # While the drone hovers, the camera keeps its azimuth.
        moves = np.linalg.norm(smooth, axis=1) > 0.05
        angle = np.arctan2(-smooth[:, 1], -smooth[:, 0])
        last = np.maximum.accumulate(np.where(moves, np.arange(len(velocity)), -1))
        kept = np.where(last >= 0, angle[np.maximum(last, 0)], SOUTH_WEST)
        behind: np.ndarray = np.unwrap(kept)
        return behind

    def picture(self, time: float, reach: float = TRAIL_TIME) -> np.ndarray:
        """Render a picture.

        Args:
            time: Time since the start, s.
            reach: Length of trails, s.

        Returns:
            RGB picture, (height, width, 3) uint8.
        """
        recording = self._recording
        # Rows of the recording before and after, and the fraction between
        clock = np.clip(time, 0, recording.time[-1]) / (recording.time[1] - recording.time[0])
        row = min(int(clock + 1e-9), len(recording.time) - 2)
        fraction = clock - row

        def between(values: np.ndarray) -> np.ndarray:
            now: np.ndarray = (1 - fraction) * values[row] + fraction * values[row + 1]
            return now

        # Move the bodies and render
        position = between(recording.position)
        self._place_bodies(position, between(self._turns), between)
        flies = recording.alive[row]
        target, away = self._camera_position(time, position, float(between(self._camera_azimuth)))
        image, lens, depth = self._renderer.shot(0, target, away, position[flies])
        # Draw the 2-D overlay: trails, marks, numbers
        pen = ImageDraw.Draw(image)
        self._draw_trails(pen, lens, depth, row, position, reach)
        draw(self._make_marks(row, position, flies, between), lens, pen)
        self._draw_numbers(pen, lens, position)
        pen.text((10, 8), f"{self._title}   t = {time:.1f} s", TEXT_COLOUR)
        return np.asarray(image)

    def _draw_numbers(self, pen: ImageDraw.ImageDraw, lens: Lens, position: np.ndarray) -> None:
        """Write the numbers of drones next to them."""
        for drone, (place, is_before) in enumerate(zip(*lens.project(position), strict=True)):
            if is_before and len(position) <= MAX_NUMBERED_DRONES:
                pen.text((place[0] + 9, place[1] - 17), str(drone), TEXT_COLOUR)

    def _place_bodies(
        self,
        position: np.ndarray,
        quaternion: np.ndarray,
        between: Callable[[np.ndarray], np.ndarray],
    ) -> None:
        """Move obstacles and parts of drones to their poses."""
        turn = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
        turn = turn[self._owner]
        places = position[self._owner] + rotate_vectors(turn, self._place)
        turns = multiply_quaternions(turn, self._own_turn)
        recording = self._recording
        obstacle = between(recording.obstacle)
        own = between(unwrap_quaternions(recording.scene["obstacle_quaternion"]))
        level = np.tile(UPRIGHT, (len(self._pads), 1))
        places = np.concatenate([obstacle, places, self._pads])[None]
        turns = np.concatenate([own, turns, level])[None]
        self._engine.set_obstacles(places, turns, np.array([True]))

    def _camera_position(
        self, time: float, position: np.ndarray, behind: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the camera's target, and its position relative to the target."""
        if self._camera == "follow":
            kind = self._about["airframe_of"][self._drone]
            span = 2 * self._about["airframes"][kind]["radius"]
            return position[self._drone], FOLLOW_DISTANCE * span * self._direction(behind)
        target, distance = self._overview
        turned = TURN * time if self._camera == "orbit" else 0.0
        return target, distance * self._direction(SOUTH_WEST + turned)

    def _draw_trails(
        self,
        pen: ImageDraw.ImageDraw,
        lens: Lens,
        depth: np.ndarray,
        row: int,
        position: np.ndarray,
        reach: float,
    ) -> None:
        """Draw the trails; occluded sections are thin and pale."""
        recording = self._recording
        first = int(np.searchsorted(recording.time, recording.time[row] - reach))
        track = np.concatenate([recording.position[first : row + 1], position[None]])
        pieces = np.stack([track[:-1], track[1:]], axis=2)
        hidden = lens.hidden(pieces.mean(axis=2).reshape(-1, 3), depth).reshape(pieces.shape[:2])
        flew = recording.alive[first : row + 1]
        for drone, colour in enumerate(self._colours):
            pale = tuple((2 * part + 3 * 200) // 5 for part in colour)
            for those, ink, width in ((hidden, pale, 1), (~hidden, colour, 2)):
                chosen = those[:, drone] & flew[:, drone]
                for line in lens.lines(pieces[chosen, drone]):
                    pen.line(tuple(line), ink, width)

    def _make_marks(
        self,
        row: int,
        position: np.ndarray,
        flies: np.ndarray,
        between: Callable[[np.ndarray], np.ndarray],
    ) -> Marks:
        """Return the marks of a row: goals, courses, targets, links."""
        recording = self._recording
        drone = position[flies]
        motion = np.stack([drone, drone + recording.velocity[row][flies]], axis=1)
        marks = Marks(drone, motion)
        if recording.goal.shape[1]:
            goal = between(recording.goal)
            to_goal = np.stack([position, goal], axis=1)[flies]
            marks = marks._replace(goal=goal, to_goal=to_goal)
        target = between(recording.target)
        links = recording.scene["link"]
        _, drone_index, target_index = links[links[:, 0] == row].T
        link = np.stack([position[drone_index], target[target_index]], axis=1)
        return marks._replace(target=target, seen=recording.seen[row], link=link)

    def save(self, path: Path, progress: Callable[[], None] = lambda: None) -> None:
        """Write the film to a file.

        Args:
            path: A .mp4, which needs the extra `video`.
            progress: Callback after every picture.

        Raises:
            ImportError: If the extra is missing; the message names it.
            OSError: If the file cannot be written.
        """

        def pictures() -> Iterator[np.ndarray]:
            for k in range(len(self)):
                yield self.picture(k / FPS)
                progress()

        with whole_file(path) as part:
            save_video(part, pictures())

    def __len__(self) -> int:
        """Return the number of pictures."""
        return int(self._recording.time[-1] * FPS + 1e-6) + 1

    def close(self) -> None:
        """Close the engine; a second call does nothing."""
        self._engine.close()


def _is_disc(part: dict[str, Any]) -> bool:
    """Return True if a part represents a propeller, which has the colour of its drone."""
    half = part["half"]
    return bool(part["kind"] == CYLINDER and half[2] < 0.2 * half[0])


def _obstacle(shape: dict[str, Any], scale: float = 1.0) -> Obstacle:
    """Create an obstacle from a shape of the scene, scaled."""
    x, y, z = (scale * half for half in shape["half"])
    colour = tuple(shape["colour"])
    if shape["kind"] == BOX:
        return Obstacle("box", (2 * x, 2 * y, 2 * z), colour)
    if shape["kind"] == SPHERE:
        return Obstacle("sphere", (x,), colour)
    if shape["kind"] == CYLINDER:
        return Obstacle("cylinder", (x, 2 * z), colour)
    corners = (scale * np.array(shape["corners"])).tolist()
    return Obstacle("hull", (), colour, tuple(map(tuple, corners)))
