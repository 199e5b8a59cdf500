"""Scene of a recording for replays: appearance of drones and obstacles, links, and readings.

The parts of `Recording.scene`, with T decisions, N drones and K obstacles, the last of which are
the loads and the pieces of added bodies:

- `about`: JSON text with the task's name, d_safe (m), units, airframes, obstacles, charging pads,
  range finder, and labels of readings.
- `rotor_speed`: (T+1, N, R) rad/s, in the order of each airframe's rotors.
- `deflection`: (T+1, N, S) rad, of control surfaces; only if any drone has wings.
- `airspeed`: (T+1, N) speed through the air, m/s; only if any drone has wings.
- `obstacle_quaternion`: (T+1, K, 4) from the obstacle's axes to the world's.
- `link`: (L, 3) row of the states, drone, and target, for each drone that serves a target.
- `hull`: (V, 3) vertices of the city's pieces that are not boxes, m, one piece after the other.
- `hull_size`: (H,) number of vertices of each of these. They are the last H of `building`.

Recordings of servers may also have the markers of `analysis.markers`, in the world frame:

- `marker_point`, `marker_line`: (M, 3) points, and (M, 2, 3) ends of lines, m.
- `marker_point_style`, `marker_line_style`: (M, 4) uint8 red, green, blue and size, pixels.
- `marker_point_time`, `marker_line_time`: (M, 2) times between which they are shown, s.
- `marker_text`: JSON text with a list of texts, their positions, colours, sizes and times.
"""

import json
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from bulletuav.envs.cables import list_all_ends
from bulletuav.envs.options import EnvOptions
from bulletuav.geometry.convex import bounding_radius
from bulletuav.geometry.scenery import NOWHERE
from bulletuav.geometry.shapes import Shape
from bulletuav.geometry.solids import Solids
from bulletuav.sensors.base import Label
from bulletuav.tasks.frame import Scene
from bulletuav.tasks.parts.loads import POSITION, QUATERNION
from bulletuav.vehicle.airframe import Airframe
from bulletuav.vehicle.swarm import Contacts, Swarm
from bulletuav.vehicle.visuals import LOAD_COLOUR, read_visual_shapes

PARTS = ("about", "rotor_speed", "obstacle_quaternion", "link", "hull", "hull_size")
"""Names of the parts that every scene has"""
UNITS = {
    "time": "s",
    "position": "m",
    "velocity": "m/s",
    "rates": "rad/s",
    "separation": "m",
    "contact_impulse": "N s",
    "contact_point": "m",
    "contact_velocity": "m/s",
    "goal": "m",
    "obstacle": "m",
    "obstacle_radius": "m",
    "obstacle_axis": "m",
    "building": "m",
    "target": "m",
    "info/goal_distance": "m",
    "info/impulse": "N s",
    "info/power": "W",
    "scene/rotor_speed": "rad/s",
    "scene/deflection": "rad",
    "scene/airspeed": "m/s",
    "scene/hull": "m",
}
"""Units of a recording's arrays, by their names in files; readings have labels instead"""


class Recorded(Protocol):
    """What a recorder reads: an `Aviary`, or what looks like one. Arrays have W worlds."""

    @property
    def num_worlds(self) -> int:
        """Number of worlds W."""

    @property
    def options(self) -> EnvOptions:
        """Common options."""

    @property
    def task(self) -> Any:
        """The task."""

    @property
    def steps(self) -> np.ndarray:
        """Number of decisions, (W,)."""

    @property
    def swarm(self) -> Swarm:
        """State of the drones."""

    @property
    def alive(self) -> np.ndarray:
        """Drones in the airspace, (W, N) bool."""

    @property
    def scene(self) -> Scene:
        """Goals and obstacles."""

    @property
    def contacts(self) -> Contacts:
        """Contacts of the last decision."""

    @property
    def sight(self) -> np.ndarray:
        """Targets in sight, (W, N, U) bool."""

    @property
    def links(self) -> np.ndarray:
        """Targets that are served, (W, N, U) bool."""

    @property
    def readings(self) -> Mapping[str, np.ndarray]:
        """Sensor readings, (W, N, ...) by name."""

    @property
    def reading_labels(self) -> dict[str, tuple[Label, ...]]:
        """Labels of the numbers of readings, by name of the reading."""

    @property
    def worlds(self) -> Any:
        """Components of the worlds, with the engine."""

    def solids(self) -> Solids:
        """Return the buildings of world 0."""


class SceneLog:
    """Records, row by row, the scene and the sensor readings of world 0."""

    def __init__(self, aviary: Recorded) -> None:
        """Start with the first row, right after a reset."""
        self._aviary = aviary
        self._labels = aviary.reading_labels
        self._active = aviary.task.active_targets(aviary.scene)[0]
        pads = aviary.scene.memory.get("pad")
        loads = aviary.task.loads
        self._loads = [] if loads is None else [(one.shape, LOAD_COLOUR) for one in loads.loads]
        self._pads = [] if pads is None else pads[0].tolist()
        self._rotor_speed: list[np.ndarray] = []
        self._deflection: list[np.ndarray] = []
        self._airspeed: list[np.ndarray] = []
        self._turns: list[np.ndarray] = []
        self._bodies: list[tuple[np.ndarray, np.ndarray]] = []
        self._links: list[np.ndarray] = []
        self._cables: list[np.ndarray] = []
        self._readings: dict[str, list[np.ndarray]] = {}
        self.record()

    def record(self) -> None:
        """Record one row."""
        aviary = self._aviary
        self._rotor_speed.append(aviary.swarm.rotor_speed[0].copy())
        self._deflection.append(aviary.swarm.deflection[0].copy())
        if self._has_wings:
            time = aviary.steps[0] / aviary.options.decision_hz
            self._airspeed.append(measure_airspeed(aviary.worlds, aviary.swarm, time))
        self._turns.append(aviary.scene.obstacle_quaternion[0].copy())
        scenery = aviary.worlds.engine.scenery
        pieces = slice(scenery.place.shape[1] - len(scenery.bodies.owner), None)
        place, turn = scenery.place[0, pieces], scenery.quaternion[0, pieces]
        if self._loads:
            memory = aviary.scene.memory
            place = np.concatenate([memory[POSITION][0], place])
            turn = np.concatenate([memory[QUATERNION][0], turn])
        self._bodies.append((place.copy(), turn.copy()))
        self._links.append(aviary.links[0][:, self._active])
        worlds = aviary.worlds
        swarm, _ = worlds.shown(aviary.swarm, aviary.alive)
        self._cables.append(list_all_ends(worlds.dynamics.cables, swarm))
        for name, values in aviary.readings.items():
            if name in self._labels:
                self._readings.setdefault(name, []).append(values[0].copy())

    def discard_history(self) -> None:
        """Discard all rows but the last."""
        del self._bodies[:-1], self._cables[:-1]
        state = (self._rotor_speed, self._deflection, self._airspeed, self._turns, self._links)
        for kept in (*state, *self._readings.values()):
            del kept[:-1]

    @property
    def _has_wings(self) -> bool:
        """Whether any drone has wings."""
        return bool(self._aviary.swarm.deflection.shape[-1])

    @property
    def body_radius(self) -> np.ndarray:
        """Radii of the bounding spheres of loads and the pieces of bodies, (P,), m."""
        return np.array([bounding_radius(shape) for shape, _ in self._moving_shapes])

    @property
    def _moving_shapes(self) -> list[Any]:
        """Shapes and colours of the loads, and of the pieces of added bodies."""
        return [*self._loads, *self._aviary.worlds.engine.added_shapes]

    def body_poses(self) -> tuple[np.ndarray, np.ndarray]:
        """Stack the poses of the loads and the pieces of bodies, P in all, in all rows.

        Pieces that are not in the world are shown below the ground, below the drones.

        Returns:
            Positions (T+1, P, 3), m, and quaternions (T+1, P, 4).
        """
        radius = self.body_radius
        place = np.full((len(self._bodies), len(radius), 3), NOWHERE)
        turn = np.tile((0.0, 0.0, 0.0, 1.0), (*place.shape[:2], 1))
        for k, poses in enumerate(self._bodies):
            # Bodies may have been added since
            count = len(poses[0])
            place[k, :count], turn[k, :count] = poses
        hidden = np.zeros_like(place)
        hidden[..., :2] = self._aviary.swarm.position[0, :, :2].mean(axis=0)
        hidden[..., 2] = -2 * radius
        return np.where(place[..., 2:] == NOWHERE, hidden, place), turn

    def cable_ends(self) -> np.ndarray:
        """Stack the ends of cables of all rows, (R, E, 2, 3), m; NaN where there is no cable."""
        most = max(len(ends) for ends in self._cables)
        stacked = np.full((len(self._cables), most, 2, 3), np.nan)
        for k, ends in enumerate(self._cables):
            stacked[k, : len(ends)] = ends
        return stacked

    def readings(self) -> dict[str, np.ndarray]:
        """Stack the sensor readings of all rows, by name."""
        rows = len(self._turns)
        return {name: np.array(kept) for name, kept in self._readings.items() if len(kept) == rows}

    def scene(self) -> dict[str, np.ndarray]:
        """Return the parts of the scene."""
        solids, cables = self._aviary.solids(), self.cable_ends()
        hulls = solids.hulls
        # Only where there are some, so that recordings without them stay equal
        more = {"cable": cables} if cables.size else {}
        if self._has_wings:
            more["deflection"] = np.array(self._deflection)
            more["airspeed"] = np.array(self._airspeed)
        if solids.colours is not None:
            more["building_colour"] = solids.colours
        return {
            **more,
            # Options of users may contain NumPy numbers.
            "about": np.array(json.dumps(self._about(), default=float)),
            "rotor_speed": np.array(self._rotor_speed),
            "obstacle_quaternion": np.concatenate(
                [np.array(self._turns), self.body_poses()[1]], axis=1
            ),
            "link": np.argwhere(np.array(self._links)),
            "hull": np.concatenate([np.zeros((0, 3)), *hulls]),
            "hull_size": np.array([len(hull) for hull in hulls], dtype=np.int64),
        }

    def _about(self) -> dict[str, Any]:
        """Return the constant part of the scene."""
        task, options = self._aviary.task, self._aviary.options
        # Each airframe is stored once; drones refer to it by index
        airframes = list(dict.fromkeys(options.airframe))
        return {
            "task": task.name,
            # For the marks of conflicts and goals in pictures
            "d_safe": float(task.config.d_safe),
            "has_goals": task.has_goals,
            "shows": dict(task.shows),
            "units": UNITS,
            "airframes": [_airframe(one) for one in airframes],
            "airframe_of": [airframes.index(one) for one in options.airframe],
            # Obstacles and sensors
            "obstacles": [
                {**_shape(shape), "colour": colour}
                for shape, colour in (
                    *((one.shape, one.colour) for one in task.obstacles()),
                    *self._moving_shapes,
                )
            ],
            "pads": {"places": self._pads, "radius": getattr(task.config, "pad_radius", 0.0)},
            "lidar": {
                "beams": task.context.beams,
                "frame": options.lidar_frame,
                "max_range": task.context.max_range,
            },
            "readings": {
                name: [(label.name, label.unit) for label in self._labels[name]]
                for name in self.readings()
            },
        }


def measure_airspeed(worlds: Any, swarm: Swarm, time: float) -> np.ndarray:
    """Return the speed of the drones of world 0 through the air, (N,), m/s.

    Args:
        worlds: Components of the worlds, with the wind.
        swarm: State of the drones.
        time: Time of world 0, s.
    """
    wind = worlds.wind.sample(swarm.position[:1], np.array([time]))
    speed: np.ndarray = np.linalg.norm(swarm.velocity[0] - wind[0], axis=-1)
    return speed


def _airframe(airframe: Airframe) -> dict[str, Any]:
    """Describe the appearance of an airframe."""
    wings = {
        "forward": airframe.forward_rotors,
        "heights": airframe.rotor_heights,
        "surfaces": [surface.name for surface in airframe.surfaces],
    }
    return {
        "name": airframe.name,
        "radius": airframe.collision_radius,
        "rotors": airframe.rotors,
        # Only where there are some, so that recordings without them stay equal
        **(wings if airframe.wings else {}),
        "propeller_radius": airframe.propeller_radius,
        "parts": [
            {
                **_shape(part.shape),
                "position": part.position.tolist(),
                "quaternion": part.quaternion.tolist(),
                "colour": part.colour,
            }
            for part in read_visual_shapes(airframe)
        ],
    }


def _shape(shape: Shape) -> dict[str, Any]:
    """Describe a shape; its kind is the number in `geometry.shapes`."""
    return {"kind": shape.kind, "half": shape.half, "corners": shape.corners}
