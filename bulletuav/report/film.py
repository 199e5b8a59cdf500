"""Films: a recorded episode in three dimensions, drawn by the engine without a screen."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import ImageDraw
from scipy.spatial.transform import Rotation

from bulletuav.analysis.recorded import Recording
from bulletuav.engine.engine import Engine
from bulletuav.envs.marks import Lens, Marks, draw
from bulletuav.envs.renderer import Renderer, fit_camera, pixel_size
from bulletuav.errors import as_int, choose
from bulletuav.files import whole_file
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.shapes import BOX, CYLINDER, SPHERE
from bulletuav.geometry.solids import Solids
from bulletuav.parsing import parse_json
from bulletuav.report.figures import MOST_NUMBERS, drone_colours
from bulletuav.report.replay import DAMAGE, continuous, damaged_scene
from bulletuav.report.video import FPS, save_video
from bulletuav.vehicle.airframes import load_airframe

SIZE = (960, 540)
"""Width and height of pictures, pixels"""
CAMERAS = ("orbit", "follow", "still")
ELEVATION = {"orbit": 32.0, "follow": 30.0, "still": 28.0}
"""Of each camera above the horizon, degrees"""
SOUTH_WEST = np.radians(234.0)
"""Direction in which the camera stands at first, from the east, rad"""
TURN = np.radians(9.0)
"""How fast the camera of "orbit" turns, rad/s"""
NEAR = 5.0
"""Distance of the camera of "follow", in wing spans of its drone"""
LAG = 1.0
"""Time within which that camera comes behind its drone, s"""
TRAIL = 5.0
"""Time that trails reach back, s"""
SMALLEST = 14
"""Pixels across, to which drones that all are looked at from afar are enlarged"""
SIDES = 12
"""Sides of cylinders"""
INK = (40, 40, 40)
STAND_IN = "cf2x"
"""Airframe of the one drone that the engine wants; it waits where no picture shows it"""


class Film:
    """Takes pictures of a recording at any time of it."""

    def __init__(
        self,
        recording: Recording,
        title: str,
        camera: str = "orbit",
        drone: int = 0,
        size: tuple[int, int] = SIZE,
        source: str = "",
    ) -> None:
        """Put up what there is to see.

        Args:
            recording: The episode, with its scene.
            title: Title of the pictures.
            camera: "orbit" turns about everything, "still" shows everything from the south-west,
                "follow" flies behind a drone.
            drone: Number of that drone.
            size: Width and height, pixels.
            source: Where the recording is from, for the message.

        Raises:
            ValueError: There is no such camera or drone, or the scene is damaged.
        """
        # What is shown, and by which camera
        choose("camera", camera, dict.fromkeys(CAMERAS))
        count = recording.position.shape[1]
        self._drone = as_int("drone", drone, 0, count - 1)
        self._recording, self._title, self._camera = recording, title, camera
        self._size = size
        self._turns = continuous(recording.quaternion)
        self._colours = [
            tuple(round(255 * part) for part in colour[:3])
            for colour in drone_colours(count).tolist()
        ]
        # Cameras are laid out from the whole flight, so that they move evenly
        self._whole = self._fit_whole()
        self._behind = self._headings()
        # Files of others may have any scene
        try:
            self._about = parse_json(str(recording.scene["about"]), "its description")
            self._make_bodies()
        except DAMAGE as error:
            raise damaged_scene(error, source) from None
        self._renderer = Renderer(self._engine, size)

    def _make_bodies(self) -> None:
        """Make an engine with the city, obstacles, and each part of each drone as an obstacle."""
        recording, about = self._recording, self._about
        # Obstacles first; parts of drones follow, and tell whose they are
        bodies = [_obstacle(one) for one in about["obstacles"]]
        self._owner: list[int] = []
        places, turns = [], []
        for drone, kind in enumerate(about["airframe_of"]):
            airframe = about["airframes"][kind]
            scale = self._scale(airframe["radius"])
            for part in airframe["parts"]:
                # Rotors take the drone's colour, which tells who is who
                colour = [share / 255 for share in self._colours[drone]]
                own = part if not _is_disc(part) else {**part, "colour": [*colour, 1.0]}
                bodies.append(_obstacle(own, scale))
                self._owner.append(drone)
                places.append(scale * np.array(part["position"]))
                turns.append(part["quaternion"])
        self._place = np.array(places)
        self._own_turn = Rotation.from_quat(np.array(turns))
        # The last buildings are hulls, whose corners stand one after the other
        sizes = recording.scene["hull_size"]
        hulls = np.split(recording.scene["hull"], np.cumsum(sizes)[:-1]) if len(sizes) else []
        boxes = recording.building[: len(recording.building) - len(sizes)]
        city = [Solids(boxes, tuple(hulls))] if len(recording.building) else []
        # The engine flies nobody here: it only takes pictures
        self._engine = Engine([load_airframe(STAND_IN)], 1, 1.0, bodies, city)
        if city:
            self._engine.set_layouts(np.array([0]), np.array([True]))

    def _scale(self, radius: float) -> float:
        """Tell how many times as large as it is a drone is drawn."""
        if self._camera == "follow":
            return 1.0
        return max(1.0, SMALLEST * pixel_size(self._whole[1], self._size[1]) / (2 * radius))

    def _fit_whole(self) -> tuple[np.ndarray, float]:
        """Find the middle of all that moves, and how far from it all is seen from any side."""
        recording = self._recording
        parts = (recording.position, recording.goal, recording.target)
        points = np.concatenate([part.reshape(-1, 3) for part in parts])
        around = SOUTH_WEST + np.linspace(0, 2 * np.pi, 16, endpoint=False)
        sides = around if self._camera == "orbit" else [SOUTH_WEST]
        fits = [fit_camera(points, self._direction(side), self._size) for side in sides]
        return fits[0][0], max(distance for _, distance in fits)

    def _direction(self, azimuth: float) -> np.ndarray:
        """Return the unit vector to the camera, which stands in a direction over ground."""
        height = np.radians(ELEVATION[self._camera])
        level = np.cos(height)
        return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(height)])

    def _headings(self) -> np.ndarray:
        """Find the direction (R,) behind the followed drone, rad, without sudden turns."""
        recording = self._recording
        times = recording.time
        keep = np.exp(-(times[1] - times[0]) / LAG)
        way = recording.velocity[:, self._drone, :2]
        smooth = np.zeros_like(way)
        smooth[0] = way[0]
        for row in range(1, len(way)):
            smooth[row] = keep * smooth[row - 1] + (1 - keep) * way[row]
        # What hovers is looked at from where the camera is.
        moves = np.linalg.norm(smooth, axis=1) > 0.05
        angle = np.arctan2(-smooth[:, 1], -smooth[:, 0])
        last = np.maximum.accumulate(np.where(moves, np.arange(len(way)), -1))
        kept = np.where(last >= 0, angle[np.maximum(last, 0)], SOUTH_WEST)
        behind: np.ndarray = np.unwrap(kept)
        return behind

    def picture(self, time: float, reach: float = TRAIL) -> np.ndarray:
        """Take a picture.

        Args:
            time: Since the start, s.
            reach: Time that trails reach back, s.

        Returns:
            (height, width, 3) uint8, red, green, blue.
        """
        recording = self._recording
        # Between which two rows of the recording, and how far
        clock = np.clip(time, 0, recording.time[-1]) / (recording.time[1] - recording.time[0])
        row = min(int(clock + 1e-9), len(recording.time) - 2)
        share = clock - row

        def between(values: np.ndarray) -> np.ndarray:
            now: np.ndarray = (1 - share) * values[row] + share * values[row + 1]
            return now

        # Move the bodies there, and take the picture
        position = between(recording.position)
        self._put(position, between(self._turns), between)
        flies = recording.alive[row]
        target, away = self._look(time, position, float(between(self._behind)))
        image, lens, depth = self._renderer.shot(0, target, away, position[flies])
        # Draw over it what has no body: trails, marks, numbers
        pen = ImageDraw.Draw(image)
        self._draw_trails(pen, lens, depth, row, position, reach)
        draw(self._marks(row, position, flies, between), lens, pen)
        self._number(pen, lens, position)
        pen.text((10, 8), f"{self._title}   t = {time:.1f} s", INK)
        return np.asarray(image)

    def _number(
        self,
        pen: ImageDraw.ImageDraw,
        lens: Lens,
        position: np.ndarray,
    ) -> None:
        """Write the numbers of drones beside them."""
        for drone, (place, is_before) in enumerate(zip(*lens.project(position), strict=True)):
            if is_before and len(position) <= MOST_NUMBERS:
                pen.text((place[0] + 9, place[1] - 17), str(drone), INK)

    def _put(
        self,
        position: np.ndarray,
        quaternion: np.ndarray,
        between: Callable[[np.ndarray], np.ndarray],
    ) -> None:
        """Put obstacles, and the parts of drones, where they are."""
        turn = Rotation.from_quat(quaternion[self._owner])
        places = position[self._owner] + turn.apply(self._place)
        turns = (turn * self._own_turn).as_quat()
        recording = self._recording
        obstacle = between(recording.obstacle)
        own = between(continuous(recording.scene["obstacle_quaternion"]))
        places = np.concatenate([obstacle, places])[None]
        turns = np.concatenate([own, turns])[None]
        self._engine.set_obstacles(places, turns, np.array([True]))

    def _look(
        self,
        time: float,
        position: np.ndarray,
        behind: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Tell what the camera looks at, and where it is from there."""
        if self._camera == "follow":
            kind = self._about["airframe_of"][self._drone]
            span = 2 * self._about["airframes"][kind]["radius"]
            return position[self._drone], NEAR * span * self._direction(behind)
        target, distance = self._whole
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
        """Draw where drones have been; what is behind something is thin and pale."""
        recording = self._recording
        first = int(np.searchsorted(recording.time, recording.time[row] - reach))
        way = np.concatenate([recording.position[first : row + 1], position[None]])
        pieces = np.stack([way[:-1], way[1:]], axis=2)
        hidden = lens.hidden(pieces.mean(axis=2).reshape(-1, 3), depth).reshape(pieces.shape[:2])
        flew = recording.alive[first : row + 1]
        for drone, colour in enumerate(self._colours):
            pale = tuple((2 * part + 3 * 200) // 5 for part in colour)
            for those, ink, width in ((hidden, pale, 1), (~hidden, colour, 2)):
                chosen = those[:, drone] & flew[:, drone]
                for line in lens.lines(pieces[chosen, drone]):
                    pen.line(tuple(line), ink, width)

    def _marks(
        self,
        row: int,
        position: np.ndarray,
        flies: np.ndarray,
        between: Callable[[np.ndarray], np.ndarray],
    ) -> Marks:
        """Find out what is marked."""
        recording = self._recording
        drone = position[flies]
        way = np.stack([drone, drone + recording.velocity[row][flies]], axis=1)
        marks = Marks(drone, way)
        if recording.goal.shape[1]:
            goal = between(recording.goal)
            to_goal = np.stack([position, goal], axis=1)[flies]
            marks = marks._replace(goal=goal, to_goal=to_goal)
        target = between(recording.target)
        links = recording.scene["link"]
        _, who, whom = links[links[:, 0] == row].T
        link = np.stack([position[who], target[whom]], axis=1)
        return marks._replace(target=target, seen=recording.seen[row], link=link)

    def save(self, path: Path, progress: Callable[[], None] = lambda: None) -> None:
        """Write the film.

        Args:
            path: A .mp4, which needs the extra `video`.
            progress: Called after every picture.

        Raises:
            ImportError: The extra is missing; the message names it.
            OSError: The file cannot be written.
        """

        def pictures() -> Iterator[np.ndarray]:
            for k in range(len(self)):
                yield self.picture(k / FPS)
                progress()

        with whole_file(path) as part:
            save_video(part, pictures())

    def __len__(self) -> int:
        """Count the pictures."""
        return int(self._recording.time[-1] * FPS + 1e-6) + 1

    def close(self) -> None:
        """Free the engine; a second call does nothing."""
        self._engine.close()


def _is_disc(part: dict[str, Any]) -> bool:
    """Tell whether a part stands for a propeller; it has the colour of its drone."""
    half = part["half"]
    return bool(part["kind"] == CYLINDER and half[2] < 0.2 * half[0])


def _obstacle(shape: dict[str, Any], scale: float = 1.0) -> Obstacle:
    """Make an obstacle of a shape that the scene tells, `scale` times as large."""
    x, y, z = (scale * half for half in shape["half"])
    colour = tuple(shape["colour"])
    if shape["kind"] == BOX:
        return Obstacle("box", (2 * x, 2 * y, 2 * z), colour)
    if shape["kind"] == SPHERE:
        return Obstacle("sphere", (x,), colour)
    corners = (scale * np.array(shape["corners"])).tolist()
    if shape["kind"] == CYLINDER:
        # Of few sides: films have many of them.
        turn = 2 * np.pi * np.arange(SIDES) / SIDES
        rim = [(x * np.cos(one), x * np.sin(one)) for one in turn]
        corners = [(*point, height) for height in (-z, z) for point in rim]
    return Obstacle("hull", (), colour, tuple(map(tuple, corners)))
