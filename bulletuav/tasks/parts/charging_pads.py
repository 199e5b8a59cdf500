"""Charging pads on the ground of a city, at which drones charge their batteries."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from bulletuav.compiled.kernel import kernel
from bulletuav.errors import as_int, as_sequence, numbers_of, shown
from bulletuav.sensors.base import Label
from bulletuav.tasks.base import Task
from bulletuav.tasks.frame import Frame, Scene, Spawn
from bulletuav.tasks.observations.base import Block
from bulletuav.tasks.parts.base import Part, Rngs

MAX_PADS = 1000
"""Maximum number of pads"""
MAX_TRIES = 200
"""Maximum number of draws of a pad until it is clear of the others"""
Outdoors = Callable[[np.random.Generator, int, int], np.ndarray]
"""Draws positions outdoors (count, 2), m, with a random generator in a layout"""


class ChargingPads(Part):
    """Pads on the ground that charge one drone each.

    A pad charges a drone whose centre is within `pad_radius` of it horizontally and at most
    `pad_height` above the ground, whether the drone hovers or stands there. The drone that is being
    charged keeps the pad until it leaves; a free pad takes the nearest drone. The pad then delivers
    `pad_power` in the next decision, in addition to which the drone consumes the power of its
    flight. Batteries are charged up to full.

    Drones may touch the ground, as with `take_off`; see `Frame.landed`. A standing drone consumes
    less power only with energy="actuator", as the formula "zeng" does not depend on thrust.

    The info "charging" is 1 for drones on pads, which are charged in the next decision. Positions
    of the pads, and whether they are taken, are in the global state.

    Attributes:
        count: Number of pads.
    """

    def __init__(self, task: Task[Any], outdoors: Outdoors) -> None:
        """Check the options of the pads, and allow the drones to land.

        Args:
            task: The task, with options of cities.
            outdoors: Draws positions outdoors.

        Raises:
            ValueError: If an option is invalid.
        """
        config = task.config
        self._task, self._outdoors = task, outdoors
        self._given = _given_places(config.charging_pads)
        self.count = (
            as_int("charging_pads", config.charging_pads, 1, MAX_PADS)
            if self._given is None
            else len(self._given)
        )
        for name in ("pad_power", "pad_radius", "pad_height"):
            if not getattr(config, name) > 0:
                raise ValueError(f"{name} is {getattr(config, name):g}: it must be above 0")
        lowest = max(task.context.standing_height)
        if config.pad_height <= lowest:
            raise ValueError(
                f"pad_height is {config.pad_height:g} m: more than {lowest:.3g} m is needed, the "
                f"height of a standing drone"
            )
        self._apart = 2 * config.pad_radius + config.d_safe
        self._power = float(config.pad_power)
        self._zone = (float(config.pad_radius), float(config.pad_height))
        self._check_given()
        task.lands = True

    def _check_given(self) -> None:
        """Raise ValueError for given pads that overlap or are outside of the city."""
        if self._given is None:
            return
        task, places = self._task, self._given
        inside = (places >= task.arena_low[:2]) & (places <= task.arena_high[:2])
        if not inside.all():
            raise ValueError(
                f"charging_pads: {shown(places[~inside.all(axis=1)][0].tolist())} is outside of "
                f"the city"
            )
        gaps = np.linalg.norm(places[:, None] - places, axis=-1)
        np.fill_diagonal(gaps, np.inf)
        if gaps.min() < self._apart:
            raise ValueError(
                f"charging_pads: two of them are {gaps.min():.3g} m apart, and "
                f"{self._apart:g} m are needed, 2 pad_radius + d_safe"
            )
        radius = task.context.collision_radius
        for layout in range(len(task.layouts())):
            for place in places:
                if not task.is_free(np.array([*place, radius]), radius, layout):
                    raise ValueError(
                        f"charging_pads: {shown(place.tolist())} is in or near a building of "
                        f"layout {layout}; give other places, or a number of pads"
                    )

    def finish(self, spawn: Spawn, is_given: bool, rng: np.random.Generator) -> Spawn:
        """Draw the positions of the pads, unless they are given.

        Raises:
            ValueError: If there is no space for so many pads.
        """
        pads = np.zeros((self.count, 3))
        pads[:, :2] = self._draw(rng, spawn.layout) if self._given is None else self._given
        return spawn._replace(memory={**spawn.memory, "pad": pads})

    def _draw(self, rng: np.random.Generator, layout: int) -> np.ndarray:
        places = np.empty((self.count, 2))
        for k in range(self.count):
            for _ in range(MAX_TRIES):
                places[k] = self._outdoors(rng, layout, 1)[0]
                gaps = np.linalg.norm(places[:k] - places[k], axis=1)
                if gaps.min(initial=np.inf) >= self._apart:
                    break
            else:
                raise ValueError(
                    f"charging_pads is {self.count}: no place is left for pad {k}, "
                    f"{self._apart:g} m from the others; lower it, or pad_radius"
                )
        return places

    def memory(self) -> Mapping[str, tuple[int, ...]]:
        """Return the shapes of the positions of the pads, m, and of the drones that they charge.

        "pad_drone" has the index of the drone plus 1, and 0 for a free pad.
        """
        return {"pad": (self.count, 3), "pad_drone": (self.count,)}

    def memory_bounds(self) -> Mapping[str, tuple[Any, Any]]:
        """Return the bounds of the indices of drones."""
        return {"pad_drone": (0, self._task.context.num_drones)}

    def update_memory(self, frame: Frame, rngs: Rngs) -> None:
        """Assign drones to the pads at which they are."""
        memory = frame.scene.memory
        places = (frame.after.position, frame.alive, memory["pad"])
        assign_pads(*places, *self._zone, memory["pad_drone"])

    def charging_power(self, scene: Scene) -> np.ndarray:
        """Return the power that pads deliver to the drones, (W, N) W."""
        return self._power * self.is_charging(scene)

    def is_charging(self, scene: Scene) -> np.ndarray:
        """Return which drones are being charged, (W, N) bool."""
        charging = np.zeros(scene.goal.shape[:2], dtype=bool)
        drone = scene.memory["pad_drone"].astype(int)
        w, k = np.nonzero(drone)
        charging[w, drone[w, k] - 1] = True
        return charging

    def info(self, frame: Frame) -> dict[str, np.ndarray]:
        """Return which drones are being charged, as "charging"."""
        return {"charging": self.is_charging(frame.scene)}

    def observation_blocks(self) -> tuple[str, ...]:
        """Return the block `pads`."""
        return ("pads",)

    def world_state(self) -> Mapping[str, Block]:
        """Return position and state of each pad."""
        low, high = self._task.arena_low, self._task.arena_high
        labels = [
            label
            for k in range(self.count)
            for label in (
                Label(f"pad {k + 1} x", "m", float(low[0]), float(high[0])),
                Label(f"pad {k + 1} y", "m", float(low[1]), float(high[1])),
                Label(f"pad {k + 1} taken", "1", 0.0, 1.0),
            )
        ]

        def compute(frame: Frame, present: np.ndarray) -> np.ndarray:
            memory = frame.scene.memory
            taken = (memory["pad_drone"] > 0)[..., None]
            return np.concatenate([memory["pad"][..., :2], taken], axis=-1).reshape(
                len(taken), len(labels)
            )

        return {"pads": Block(tuple(labels), compute)}


def has_pads(config: Any) -> bool:
    """Return True if the options of a task in a city contain charging pads.

    Raises:
        ValueError: If the option `charging_pads` is neither a number nor a list of places.
    """
    places = _given_places(config.charging_pads)
    if places is not None:
        return bool(len(places))
    return as_int("charging_pads", config.charging_pads, 0, MAX_PADS) > 0


def _given_places(value: Any) -> np.ndarray | None:
    """Return the given places (K, 2), m, or None for a number of pads."""
    if not isinstance(value, list | tuple | np.ndarray):
        return None
    rows = as_sequence("charging_pads", value, most=MAX_PADS)
    places = [numbers_of("charging_pads are", as_sequence("charging_pads", row, 2)) for row in rows]
    return np.array(places)


@kernel
def assign_pads(
    position: np.ndarray,
    alive: np.ndarray,
    pad: np.ndarray,
    radius: float,
    height: float,
    pad_drone: np.ndarray,
) -> None:
    """Assign each pad to a drone in its zone: the one that it charges, or else the nearest.

    Args:
        position: (W, N, 3) positions of the drones, m.
        alive: (W, N) bool, which drones fly.
        pad: (W, K, 3) positions of the pads, m.
        radius: Horizontal radius of the zone, m.
        height: Height of the zone above the pad, m.
        pad_drone: (W, K) index of the drone at each pad plus 1, 0 for none; updated.
    """
    for w in range(pad.shape[0]):
        for k in range(pad.shape[1]):
            nearest, chosen = radius * radius, 0
            for i in range(position.shape[1]):
                east = position[w, i, 0] - pad[w, k, 0]
                north = position[w, i, 1] - pad[w, k, 1]
                squared = east * east + north * north
                is_low = position[w, i, 2] - pad[w, k, 2] <= height
                if not (alive[w, i] and is_low and squared <= radius * radius):
                    continue
                # The drone that is being charged keeps the pad
                if pad_drone[w, k] == i + 1:
                    nearest, chosen = -1.0, i + 1
                elif squared < nearest or chosen == 0:
                    nearest, chosen = squared, i + 1
            pad_drone[w, k] = chosen
