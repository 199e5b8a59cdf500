"""Task `transport`: drones carry a load on cables to its place, and set it down."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from bulletuav.compiled.functions import atan2, cos, sin
from bulletuav.errors import find_choice
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.quaternions import rotate_vectors
from bulletuav.geometry.rotation import from_euler
from bulletuav.registry import register
from bulletuav.tasks.base import Task
from bulletuav.tasks.config import TaskConfig
from bulletuav.tasks.frame import Frame, Spawn, TaskContext
from bulletuav.tasks.ingredients import end, reward
from bulletuav.tasks.parts.base import Rngs
from bulletuav.tasks.parts.loads import (
    ATTACHED,
    GRAVITY,
    POSITION,
    QUATERNION,
    RATES,
    TAUT,
    TENSION,
    VELOCITY,
    LoadCable,
    Loads,
)
from bulletuav.tasks.parts.safety import Safety
from bulletuav.tasks.parts.waiting import decisions_waited
from bulletuav.vehicle.load import make_load

PARCEL = 0.25
"""Edge of a parcel, m"""
THICKNESS = 0.1
"""Height of beams and boxes, and width of beams, m"""
SPACING = 1.2
"""Distance of neighbouring cables along a beam, or along the edges of a box, m"""
MARGIN, CEILING = 5.0, 6.0
"""Distance of the arena's bounds from the farthest places to each side, and above cables, m"""
START_SLACK = 0.1
"""Fraction by which drones start closer to the load than their cables allow"""
BESIDE = 0.4
"""Distance from the load at which drones that take off stand, m"""
CONTACT_HEIGHT = 0.005
"""Height of a load's lowest point up to which it is on the ground, m"""
REST_SPEED, REST_SPIN = 0.05, 0.1
"""Speed, m/s, and body rate, rad/s, up to which a load is at rest"""
SLACK_SHARE = 0.1
"""Fraction of its weight that the cables of a load that is set down may carry"""
SET_DOWN_TIME = 0.5
"""Time that a load has to stand before it is released, s"""
MAX_IMPACT_SPEED = 1.0
"""Maximum speed at which a load may touch the ground, m/s"""
MAX_DRAG = 0.5
"""Maximum length of the path of a load along the ground, m"""
SHAPES = ("parcel", "beam", "box")
"""Shapes of loads"""


@dataclass(frozen=True)
class TransportConfig(TaskConfig):
    """Options of `transport`, in addition to those of every task.

    Attributes:
        d_safe: Separation below which two drones are in conflict, m.
        shape: Shape of the load: "parcel", a cube for one drone, "beam" or "box", on which the
            cables are 1.2 m apart. None for a parcel below one drone, a beam below two or three,
            else a box.
        load_mass: Mass of the load for each drone, kg.
        cable_length: Length of the cables, m.
        distance: Minimum and maximum distance from the start of the load to its place, m.
        place_radius: Maximum distance of a load that is set down from its place, m.
    """

    d_safe: float = 0.6
    shape: str | None = None
    load_mass: float = field(default=0.2, metadata={"most": 100.0})
    cable_length: float = field(default=1.0, metadata={"most": 100.0})
    distance: tuple[float, float] = (4.0, 6.0)
    place_radius: float = 0.2


@end
def is_delivered(delivered: float) -> bool:
    """Return True if the load was set down in its place and released."""
    return delivered > 0.0


@end
def has_failed(failed: float) -> bool:
    """Return True if a drone collided or left the arena, or the load fell or was dragged."""
    return failed > 0.0


@reward
def progress(progress: float) -> float:
    """Decrease of the distance of the load to its place, m."""
    return progress


@reward
def delivery(delivered: float, is_safe: bool) -> float:
    """1 when the load is released in its place, without conflict or collision of the drone."""
    return 1.0 if delivered > 0.0 and is_safe else 0.0


@reward
def early(delivered: float, is_safe: bool, time: float, duration: float) -> float:
    """Fraction of the time that is left when the load is released, as in `delivery`."""
    return 1.0 - time / duration if delivered > 0.0 and is_safe else 0.0


@reward
def swing(swing: float) -> float:
    """Angle of the own cable from the vertical while it pulls, rad."""
    return swing


@reward
def drag(drag: float) -> float:
    """Path of the load along the ground in the decision, m."""
    return drag


@reward
def waiting(
    delivered: float, failed: float, depleted: bool, time: float, duration: float, period: float
) -> float:
    """1 per decision until the load is released; on other ends 1 per remaining decision, too."""
    is_lost = failed > 0.0 or depleted
    return decisions_waited(delivered > 0.0, is_lost, time, duration, period)


@reward
def failure(failed: float) -> float:
    """1 when the episode fails: see `has_failed`."""
    return failed


@register("task")
class Transport(Task[TransportConfig]):
    """Drones carry a load on cables to its place, and set it down there.

    One load is on the ground, and each drone hovers above one end of it on a slack cable. The place
    is 4 to 6 m away in any direction. A load stands in its place once it is at rest on the ground
    within 0.2 m of it, with at most a tenth of its weight on the cables, for 0.5 s: it is then
    released. Cables only pull; range finders and cameras see the load, but no cables.

    Observation, Box(51) per drone with the defaults: attitude as a quaternion, body to world;
    velocity in world axes (east, north, up); rates in body axes; position of the load relative to
    the drone, its velocity, attitude and body rates; vector along the own cable to the load, and
    whether it pulls; offset from the load to its place; the nearest other drones.

    Action, by default `velocity`, Box(3) per drone in [-1, 1]: commanded velocity divided by
    max_speed = 3 m/s. There are 20 decisions a second. Controllers learn steady forces
    (integral=True), such as the weight of the load.

    Reward per decision, the weighted sum of these terms:

    - progress 1: decrease of the distance of the load to its place, m.
    - delivery 20: 1 on release, without conflict or collision of the drone before.
    - early 20: then the fraction of the time that is left.
    - swing -0.02: angle of the own cable from the vertical while it pulls, rad.
    - drag -5: path of the load along the ground, m.
    - waiting -0.02: 1 per decision until the release; on other ends also 1 per remaining decision.
    - failure -10: 1 when the episode fails.
    - conflict -2: number of drones whose separation falls below d_safe = 0.6 m.
    - collision -10: 1 on contact of the drone.

    End: for all drones on release, or when the episode fails: on contact of a drone, with the load,
    too; if a drone leaves the arena; if the load touches the ground faster than 1 m/s, or was
    dragged along it for 0.5 m. Truncated after 900 decisions.

    Success: the load was released in its place, and the drone had no conflict or collision.

    Difficulties: easy has 1 drone, medium 2, hard 4 and extreme 8, with wind from medium on. The
    noise of measured positions grows from 0.05 m or less at medium to 0.1 to 0.25 m at extreme.
    Hard has places of 0.15 m, and extreme of 0.1 m, with 0.5 kg for each drone on shorter cables.

    Infos: `load_distance`, of the load to its place, m; `max_swing`, rad, and `max_tension`, N, of
    the own cable so far.
    """

    name = "transport"
    baseline = "carrier"
    oracle = "carrier_oracle"
    needs_cables = True
    shirkers: ClassVar = (
        "transport_lift",
        "transport_above",
        "transport_drag",
        "transport_drop",
        "transport_beside",
        "transport_ram",
    )
    defaults: ClassVar = {
        "num_drones": 1,
        "airframe": "hummingbird",
        "dynamics": "rigid_body",
        "action": "velocity",
        "integral": True,
        "decision_hz": 20,
        "horizon": 900,
        "max_speed": 3.0,
    }
    difficulties: ClassVar = {
        "easy": {},
        "medium": {
            "num_drones": 2,
            "distance": (6.0, 9.0),
            "randomization": {"gps_noise": (0.0, 0.05), "wind": (-1.0, 1.0)},
        },
        "hard": {
            "num_drones": 4,
            "distance": (8.0, 12.0),
            "load_mass": 0.3,
            "place_radius": 0.15,
            "randomization": {"gps_noise": (0.0, 0.12), "wind": (-1.5, 1.5)},
        },
        "extreme": {
            "num_drones": 8,
            "num_neighbours": 7,
            "distance": (8.0, 12.0),
            "load_mass": 0.5,
            "cable_length": 0.8,
            "place_radius": 0.1,
            "turbulence": 4.0,
            "randomization": {"gps_noise": (0.1, 0.25), "wind": (-2.0, 2.0)},
        },
    }
    observation: ClassVar[tuple[Any, ...]] = (
        *("attitude", "velocity", "rates", "load", "cable", "load_goal_offset", "neighbours"),
    )
    reward: ClassVar = {
        "progress": (progress, 1.0),
        "delivery": (delivery, 20.0),
        "early": (early, 20.0),
        "swing": (swing, -0.02),
        "drag": (drag, -5.0),
        "waiting": (waiting, -0.02),
        "failure": (failure, -10.0),
        "conflict": -2.0,
        "collision": -10.0,
    }
    shows: ClassVar = {
        "success": "success",
        "load_distance": "load to place (m)",
        "max_tension": "tension (N)",
        "collision": "collisions",
    }
    ends = (is_delivered, has_failed)
    success = is_delivered
    loads: Loads

    def __init__(self, config: TransportConfig, context: TaskContext) -> None:
        """Make the load with its cables, and set the arena.

        Raises:
            ValueError: If the shape does not fit the number of drones, an option is out of bounds,
                or drones could start in conflict or too far from the load.
        """
        super().__init__(config, context)
        drones = context.num_drones
        usual = "parcel" if drones == 1 else "beam" if drones <= 3 else "box"
        shape = usual if config.shape is None else config.shape
        find_choice("shape", shape, dict.fromkeys(SHAPES))
        self._check(config, shape)
        self.safety = self.add(Safety(drones))
        size, points, self._beside = lay_out(shape, drones)
        self._half = np.array(size) / 2
        self.mass = config.load_mass * drones
        load = make_load(Obstacle("box", size), self.mass)
        cables = [
            LoadCable(i, 0, tuple(point), config.cable_length)
            for i, point in enumerate(points.tolist())
        ]
        self.loads = self.add(Loads([load], cables))
        self._points = points
        reach = config.distance[1] + float(np.linalg.norm(self._half)) + config.cable_length
        side = reach + MARGIN
        self.arena_low = np.array([-side, -side, 0.0])
        self.arena_high = np.array([side, side, config.cable_length + CEILING])

    def _check(self, config: TransportConfig, shape: str) -> None:
        """Check options that depend on each other."""
        if shape == "parcel" and self.context.num_drones > 1:
            raise ValueError(
                f"shape is 'parcel' and num_drones {self.context.num_drones}: a parcel hangs below "
                f"one drone; use 'beam' or 'box'"
            )
        if not config.load_mass > 0.0:
            raise ValueError("load_mass is 0 kg: a mass above 0 for each drone is needed")
        low, high = config.distance
        least = config.place_radius + MAX_DRAG
        if not least < low <= high <= 500.0:
            raise ValueError(
                f"distance is {(low, high)}: from low to high, above place_radius + {MAX_DRAG:g} = "
                f"{least:g} m and up to 500 m, is needed"
            )
        clear = 2 * self.context.collision_radius + THICKNESS
        if not config.cable_length >= clear:
            raise ValueError(
                f"cable_length is {config.cable_length:g} m: at least {clear:.3g} m is needed, so "
                f"that drones are clear of the load"
            )
        nearest = SPACING / np.sqrt(2.0)
        if not config.d_safe < nearest:
            raise ValueError(
                f"d_safe is {config.d_safe:g} m: below {nearest:.3g} m, the distance of cables, is "
                f"needed"
            )

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the memory of the parts and of the task.

        Returns:
            "place" (3,), of the load, m; "load_distance" () to it, m; "progress" () and "drag" (),
            see the reward terms; "dragged" (), sum of these, m; "grounded" (), 1 while the load
            touches the ground; "sink" (), its speed downwards, m/s; "standing" (), time for which
            it stands in its place, s; "delivered" () and "failed" (), 1 when it happened; "swing"
            (N,), angle of the own cable, rad; "max_swing" (N,), rad, and "max_tension" (N,), N, so
            far.
        """
        names = ("load_distance", "progress", "drag", "dragged", "grounded", "sink")
        scalars: dict[str, tuple[int, ...]] = dict.fromkeys(
            (*names, "standing", "delivered", "failed"), ()
        )
        drones = (self.context.num_drones,)
        own = dict.fromkeys(("swing", "max_swing", "max_tension"), drones)
        return {**super().memory(), "place": (3,), **scalars, **own}

    def spawn(self, rng: np.random.Generator) -> Spawn:
        """Draw the attitude of the load at the origin, and its place."""
        config, length = self.config, self.config.cable_length
        yaw, angle = rng.uniform(-np.pi, np.pi, 2)
        distance = rng.uniform(*config.distance)
        load = np.array((0.0, 0.0, self._half[2]))
        place = load + distance * np.array((cos(angle), sin(angle), 0.0))
        quaternion = np.array(from_euler(0.0, 0.0, yaw))
        turns = np.tile(quaternion, (len(self._points), 1))
        ends = load + rotate_vectors(turns, self._points)
        above = np.array((0.0, 0.0, (1.0 - START_SLACK) * length))
        start = ends + above
        if self.takes_off:
            start = ends + rotate_vectors(turns, self._beside)
        return Spawn(
            position=start,
            goal=ends + above + (place - load),
            memory={
                **self.loads.start(load[None], quaternion[None]),
                "place": place,
                "load_distance": np.array(distance),
                "grounded": np.array(1.0),
            },
        )

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Measure the load and the cables, and find out how the episode ends."""
        super().update_memory(frame, rngs)
        memory = frame.scene.memory
        flying = frame.alive.any(axis=1)
        position, velocity = memory[POSITION][:, 0], memory[VELOCITY][:, 0]
        speed = np.sqrt((velocity * velocity).sum(axis=-1))
        spin = np.sqrt((memory[RATES][:, 0] ** 2).sum(axis=-1))
        offset = memory["place"] - position
        distance = np.sqrt((offset * offset).sum(axis=-1))
        memory["progress"][:] = np.where(flying, memory["load_distance"] - distance, 0.0)
        memory["load_distance"][:] = distance
        # Lowest corner of the box
        x, y, z, w = np.moveaxis(memory[QUATERNION][:, 0], -1, 0)
        row = np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1)
        lowest = position[:, 2] - (np.abs(row) * self._half).sum(axis=-1)
        grounded = lowest <= CONTACT_HEIGHT
        was_grounded = memory["grounded"] > 0.0
        across = np.sqrt((velocity[:, :2] ** 2).sum(axis=-1)) * self.context.period
        drag = np.where(grounded & was_grounded & flying, across, 0.0)
        memory["drag"][:] = drag
        memory["dragged"][:] += drag
        fell = grounded & ~was_grounded & (memory["sink"] > MAX_IMPACT_SPEED)
        memory["grounded"][:], memory["sink"][:] = grounded, np.maximum(-velocity[:, 2], 0.0)
        carried = memory[TENSION].sum(axis=-1)
        stands = grounded & (distance <= self.config.place_radius) & (speed <= REST_SPEED)
        weight = self.mass * memory[GRAVITY][:, 0]
        stands &= (spin <= REST_SPIN) & (carried <= SLACK_SHARE * weight)
        standing = np.where(stands & flying, memory["standing"] + self.context.period, 0.0)
        memory["standing"][:] = standing
        lost = ((frame.collision | self.outside(frame)) & frame.alive).any(axis=1)
        failed = flying & (lost | fell | (memory["dragged"] > MAX_DRAG))
        delivered = flying & ~failed & (standing >= SET_DOWN_TIME - 1e-9)
        for name, happened in (("failed", failed), ("delivered", delivered)):
            memory[name][:] = np.where(flying, happened, memory[name])
        memory[ATTACHED][delivered] = 0.0
        self._measure_cables(frame)

    def _measure_cables(self, frame: Frame) -> None:
        """Update the angles and tensions of cables."""
        memory = frame.scene.memory
        along = self.loads.find_ends(memory) - frame.after.position
        across = np.sqrt((along[..., :2] ** 2).sum(axis=-1))
        pulls = (memory[TAUT] > 0.0) & frame.alive
        memory["swing"][:] = np.where(pulls, atan2(across, -along[..., 2]), 0.0)
        np.maximum(memory["max_swing"], memory["swing"], out=memory["max_swing"])
        np.maximum(memory["max_tension"], memory[TENSION], out=memory["max_tension"])

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return the distance of the load, and the largest angles and tensions of cables."""
        memory, shape = frame.scene.memory, frame.alive.shape
        return {
            **super().info(frame),
            "load_distance": np.broadcast_to(memory["load_distance"][:, None], shape),
            "max_swing": memory["max_swing"],
            "max_tension": memory["max_tension"],
        }


def lay_out(shape: str, drones: int) -> tuple[tuple[float, float, float], np.ndarray, np.ndarray]:
    """Return the size of a load and the ends of its cables.

    Args:
        shape: One of `SHAPES`.
        drones: Number N of drones.

    Returns:
        The size (3,) of the box, m; the ends (N, 3) on its top in its axes, m; and vectors (N, 3)
        from them to places beside the load, m.
    """
    points, beside = np.zeros((2, drones, 3))
    if shape == "parcel":
        size = (PARCEL, PARCEL, PARCEL)
        beside[:, 0] = PARCEL / 2 + BESIDE
    elif shape == "beam":
        size = ((drones - 1) * SPACING + 2 * THICKNESS, THICKNESS, THICKNESS)
        points[:, 0] = SPACING * (np.arange(drones) - (drones - 1) / 2)
        beside[:, 1] = (THICKNESS / 2 + BESIDE) * np.where(np.arange(drones) % 2, -1.0, 1.0)
    else:
        # From corner to corner along the edges
        side = max(drones / 4, 0.5) * SPACING
        size = (side, side, THICKNESS)
        corners = side * np.array(
            [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5)]
        )
        along = 4 * np.arange(drones) / drones
        for k in range(2):
            points[:, k] = np.interp(along, np.arange(5), corners[:, k])
        if drones == 1:
            points[:] = 0.0
            beside[:, 0] = side / 2 + BESIDE
        else:
            edge = np.abs(points[:, :2]) >= side / 2 - 1e-9
            beside[:, :2] = np.where(edge, BESIDE * np.sign(points[:, :2]), 0.0)
    points[:, 2] = size[2] / 2
    return size, points, beside
