"""Marks in pictures of a world: for objects that are too small to be seen, or have no body."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from bulletuav.sensors.base import Sensor
from bulletuav.sensors.imperfect import unwrapped
from bulletuav.sensors.lidar import Lidar
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Frame
from bulletuav.vehicle.swarm import Swarm

if TYPE_CHECKING:
    from PIL import ImageDraw

Colour = tuple[int, int, int]
NO_POINTS, NO_LINES, NONE = np.zeros((0, 3)), np.zeros((0, 2, 3)), np.zeros(0, dtype=bool)

DRONE: Colour = (216, 67, 21)
"""Colour of the rings around drones"""
VELOCITY: Colour = (40, 40, 40)
"""Colour of the arrows that show the motion of drones in one second"""
GOAL: Colour = (46, 125, 50)
"""Colour of the crosses on goals, and of the lines from drones to them"""
SEEN: Colour = (0, 150, 60)
"""Colour of targets that any drone sees"""
UNSEEN: Colour = (200, 0, 60)
"""Colour of the other targets"""
LINK: Colour = (40, 90, 200)
"""Colour of lines from drones to the targets that they serve"""
BEAM: Colour = (250, 150, 0)
"""Colour of range finder beams with a hit"""
CABLE: Colour = (90, 60, 30)
"""Colour of cables"""
MISS: Colour = (250, 215, 140)
"""Colour of beams without a hit"""
RING_RADIUS, CROSS_RADIUS, DOT_RADIUS, HIT_RADIUS = 7, 5, 2, 2
"""Radii of the marks of drones, goals, targets and hits, pixels"""
ARROWHEAD_LENGTH = 6.0
"""Length of the two strokes of an arrowhead, pixels"""
OCCLUSION_RATIO = 0.99
"""Fraction of a point's depth below which a rendered surface occludes the point"""
MIN_ARROW_LENGTH = 3.0
"""Minimum length of arrows, pixels"""
MIN_LEGEND_HEIGHT = 240
"""Minimum height of pictures with a legend, pixels"""
LINE_HEIGHT = 14
"""Height of a line of the legend, pixels"""


class Marks(NamedTuple):
    """Marks of one world with M flying drones; all positions in m.

    Attributes:
        drone: (M, 3) positions of drones.
        motion: (M, 2, 3) from each drone to its extrapolated position after one second.
        goal: (N, 3) goals of all drones, if any.
        to_goal: (M, 2, 3) from each drone to its goal, if any.
        target: (U, 3) targets.
        seen: (U,) bool, targets that any drone sees.
        link: (L, 2, 3) from drones to the targets that they serve.
        beam: (B, 2, 3) from drones to the ends of range finder beams.
        hit: (B,) bool, beams with a hit.
        cable: (C, 2, 3) ends of cables.
    """

    drone: np.ndarray
    motion: np.ndarray
    goal: np.ndarray = NO_POINTS
    to_goal: np.ndarray = NO_LINES
    target: np.ndarray = NO_POINTS
    seen: np.ndarray = NONE
    link: np.ndarray = NO_LINES
    beam: np.ndarray = NO_LINES
    hit: np.ndarray = NONE
    cable: np.ndarray = NO_LINES


def drone_marks(swarm: Swarm, flown: np.ndarray, world: int, sensors: Iterable[Sensor]) -> Marks:
    """Return the marks of the drones of a world.

    Args:
        swarm: State of all worlds.
        flown: (W, N) bool, drones that are shown.
        world: Index of the world.
        sensors: Sensors of the drones.
    """
    flies = flown[world]
    drone = swarm.position[world, flies]
    beam, hit = NO_LINES, NONE
    for sensor in map(unwrapped, sensors):
        if isinstance(sensor, Lidar):
            mask = np.zeros_like(flown)
            mask[world] = flies
            beam, hit = sensor.beams(swarm, mask)
    motion = np.stack([drone, drone + swarm.velocity[world, flies]], axis=1)
    return Marks(drone, motion, beam=beam, hit=hit)


def marks_of(task: Task[Any], frame: Frame, world: int, sensors: Iterable[Sensor]) -> Marks:
    """Return all marks of a world after a decision.

    Args:
        task: The task.
        frame: Frame of the decision.
        world: Index of the world.
        sensors: Sensors of the drones.
    """
    flies, position = frame.alive[world], frame.after.position[world]
    marks = drone_marks(frame.after, frame.alive, world, sensors)
    if task.has_goals:
        goal = frame.scene.goal[world]
        marks = marks._replace(goal=goal, to_goal=np.stack([position, goal], axis=1)[flies])
    # Inactive targets, and links to them, are not shown
    active = task.active_targets(frame.scene)[world]
    target = task.targets(frame.scene)[world]
    drone_rows, target_rows = np.nonzero(task.links(frame)[world] & flies[:, None] & active)
    return marks._replace(
        target=target[active],
        seen=np.any(frame.seen[world], axis=0)[active],
        link=np.stack([position[drone_rows], target[target_rows]], axis=1),
    )


class Lens(NamedTuple):
    """Projection of points of a world to a picture.

    Attributes:
        matrix: (4, 4) from the world to clip space.
        size: Width and height of the picture, pixels.
    """

    matrix: np.ndarray
    size: tuple[int, int]

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project points (M, 3) to the picture.

        Returns:
            (M, 2) x and y, pixels; and (M,) bool, points in front of the camera.
        """
        ones = np.ones((len(points), 1))
        clip = np.concatenate([points, ones], axis=1) @ self.matrix.T
        # Points in the plane of the lens have no projection
        distance = clip[:, 3]
        depth = np.where(np.abs(distance) > 1e-6, distance, 1e-6)
        width, height = self.size
        x = (1 + clip[:, 0] / depth) / 2 * width
        y = (1 - clip[:, 1] / depth) / 2 * height
        return np.stack([x, y], axis=1), distance > 0.1

    def hidden(self, points: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Return which points (M, 3) are occluded in the picture, (M,) bool.

        Args:
            points: (M, 3) m.
            depth: (height, width) along the view axis, m.
        """
        away = np.concatenate([points, np.ones((len(points), 1))], axis=1) @ self.matrix[3]
        places, _ = self.project(points)
        inside = np.all((places >= 0) & (places < self.size), axis=1)
        x, y = np.where(inside[:, None], places, 0).astype(int).T
        found: np.ndarray = inside & (depth[y, x] < OCCLUSION_RATIO * away)
        return found

    def lines(self, points: np.ndarray) -> np.ndarray:
        """Project those lines (L, 2, 3) that are in front of the camera to (K, 4) pixels."""
        ends, is_before = self.project(points.reshape(-1, 3))
        ends = ends.reshape(-1, 4)
        both_before = np.all(is_before.reshape(-1, 2), axis=1)
        # Coordinates far outside of the picture are too large to draw
        near = np.all(np.abs(ends) < 4 * max(self.size), axis=1)
        kept: np.ndarray = ends[both_before & near]
        return kept

    def draw_lines(self, pen: "ImageDraw.ImageDraw", points: np.ndarray, colour: Colour) -> None:
        """Draw those of the lines (L, 2, 3) that are in front of the camera."""
        for line in self.lines(points):
            pen.line(tuple(line), colour)


def draw(marks: Marks, lens: Lens, pen: "ImageDraw.ImageDraw") -> None:
    """Draw marks into a picture, with those of drones on top.

    Args:
        marks: Marks to draw.
        lens: Projection of the picture.
        pen: Drawing context of the picture.
    """
    # Lines first, below the marks at their ends
    lens.draw_lines(pen, marks.beam[~marks.hit], MISS)
    lens.draw_lines(pen, marks.beam[marks.hit], BEAM)
    lens.draw_lines(pen, marks.link, LINK)
    lens.draw_lines(pen, marks.cable, CABLE)
    lens.draw_lines(pen, marks.to_goal, GOAL)
    _draw_dots(pen, lens.project(marks.beam[marks.hit, 1])[0], HIT_RADIUS, BEAM)
    _draw_dots(pen, lens.project(marks.target[~marks.seen])[0], DOT_RADIUS, UNSEEN)
    _draw_dots(pen, lens.project(marks.target[marks.seen])[0], DOT_RADIUS, SEEN)
    r = CROSS_RADIUS
    for x, y in lens.project(marks.goal)[0]:
        pen.line((x - r, y - r, x + r, y + r), GOAL, 2)
        pen.line((x - r, y + r, x + r, y - r), GOAL, 2)
    for line in lens.lines(marks.motion):
        _draw_arrow(pen, line)
    r = RING_RADIUS
    for x, y in lens.project(marks.drone)[0]:
        pen.ellipse((x - r, y - r, x + r, y + r), outline=DRONE, width=2)
    if lens.size[1] >= MIN_LEGEND_HEIGHT:
        _draw_legend(pen, marks, lens.size[1])


def _draw_legend(pen: "ImageDraw.ImageDraw", marks: Marks, height: int) -> None:
    """Draw a legend of the colours in use into the lower left corner."""
    key = (
        (marks.drone, DRONE, "drone"),
        (marks.motion, VELOCITY, "motion in 1 s"),
        (marks.goal, GOAL, "goal"),
        (marks.target[marks.seen], SEEN, "target in sight"),
        (marks.target[~marks.seen], UNSEEN, "target out of sight"),
        (marks.link, LINK, "drone serves or sees target"),
        (marks.cable, CABLE, "cable"),
        (marks.beam[marks.hit], BEAM, "range measured"),
        (marks.beam[~marks.hit], MISS, "nothing in range"),
    )
    there = [(colour, text) for some, colour, text in key if len(some)]
    top = height - LINE_HEIGHT * len(there) - 6
    for k, (colour, text) in enumerate(there):
        y = top + LINE_HEIGHT * k
        pen.rectangle((8, y + 2, 16, y + 10), colour)
        pen.text((22, y), text, VELOCITY)


def _draw_dots(pen: "ImageDraw.ImageDraw", places: np.ndarray, radius: int, colour: Colour) -> None:
    for x, y in places:
        pen.ellipse((x - radius, y - radius, x + radius, y + radius), colour)


def _draw_arrow(pen: "ImageDraw.ImageDraw", line: np.ndarray) -> None:
    """Draw an arrow along a line (4,), pixels, unless it is too short."""
    start, end = line[:2], line[2:]
    length = float(np.linalg.norm(end - start))
    if length < MIN_ARROW_LENGTH:
        return
    pen.line(tuple(line), VELOCITY, 2)
    along = (end - start) / length
    across = np.array([-along[1], along[0]])
    for side in (-0.5, 0.5):
        pen.line((*end, *(end - ARROWHEAD_LENGTH * (along + side * across))), VELOCITY, 2)
