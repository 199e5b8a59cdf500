"""Bodies of the option `bodies` in the worlds of a task: drawn at resets, moved in decisions."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from bulletuav.contact.contact_state import ContactState
from bulletuav.engine.body_source import BodySource
from bulletuav.engine.engine import Engine
from bulletuav.envs.bodies import (
    BodiesOption,
    Body,
    DrawnBodies,
    Motion,
    draw_bodies,
    follow_motion,
    park_body,
    set_body,
)
from bulletuav.errors import shown
from bulletuav.geometry.clearance import find_overlapping
from bulletuav.geometry.gjk import make_scratch
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.geometry.scenery import place_body

MAX_TRIES = 100
"""Maximum number of draws of starts and bodies until the starts are clear of the bodies"""
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
Slots = Mapping[int, Body]
"""Bodies of a world in an episode, by their indices in `Scenery.bodies`"""


class WorldBodies:
    """The bodies of W worlds in the present episodes.

    Attributes:
        count: Maximum number of bodies in a world.
        motions: Functions of time that bodies follow, by index of the body, in each world.
    """

    def __init__(self, option: BodiesOption, engine: Engine) -> None:
        """Add all bodies that an episode may have to the engine, in no world.

        Args:
            option: The option `bodies`.
            engine: The engine, to which no bodies were added before.

        Raises:
            ValueError: If a source is invalid.
            FileNotFoundError: If the file of a source does not exist.
        """
        self._option, self._engine = option, engine
        if isinstance(option, DrawnBodies):
            self._pool = list(option.pool)
        else:
            self._pool = [one.source for one in option]
        self.count, worlds = len(self._pool), range(engine.shape[0])
        self.motions: list[dict[int, Motion]] = [{} for _ in worlds]
        for source in self._pool:
            engine.add_body(source, (0.0, 0.0, 0.0), is_static=False)
        for w in worlds:
            for b in range(self.count):
                park_body(engine, w, b)
        self._scratch = make_scratch()

    def require_saveable(self) -> None:
        """Raise ValueError if a drawn body follows a function, which no snapshot can hold."""
        if isinstance(self._option, DrawnBodies) and any(self.motions):
            raise ValueError(
                "bodies: a drawn body follows a function of time, which a snapshot cannot hold: "
                "draw velocity and angular_velocity, or list bodies with a motion instead"
            )

    def draw(self, rng: np.random.Generator) -> Slots:
        """Draw the bodies of an episode.

        Raises:
            ValueError: If a drawn body is invalid, or not in the pool.
        """
        if not isinstance(self._option, DrawnBodies):
            return dict(enumerate(self._option))
        slots: dict[int, Body] = {}
        for body in draw_bodies(self._option.draw, rng):
            free = (b for b in range(self.count) if b not in slots)
            b = next((b for b in free if _is_same(self._pool[b], body.source)), None)
            if b is None:
                raise ValueError(
                    f"bodies: {shown(body.source)} was drawn more often than it is in the pool: "
                    f"use DrawnBodies(draw, pool), and list it in the pool as often as it can be "
                    f"in a world"
                )
            slots[b] = body
        return slots

    def find_blocked(
        self,
        slots: Slots,
        position: np.ndarray,
        quaternion: np.ndarray,
        num_drones: int,
        goal: np.ndarray | None,
    ) -> str:
        """Describe the first start in a body, or goal in a body that stands still, if any.

        Args:
            slots: Bodies of the world.
            position: (N + L, 3) starts of drones and loads, m.
            quaternion: (N + L, 4) attitudes at the starts.
            num_drones: N.
            goal: (N, 3) goals, m; None without goals.

        Returns:
            The description, or "".
        """
        i = self._find(slots, position, quaternion)
        if i >= 0:
            what = f"drone {i}" if i < num_drones else f"load {i - num_drones}"
            return f"the start of {what} at {position[i]} m"
        if goal is not None:
            still = {
                b: body
                for b, body in slots.items()
                if body.motion is None
                and not np.any(body.velocity)
                and not np.any(body.angular_velocity)
            }
            i = self._find(still, goal, np.tile(UPRIGHT, (len(goal), 1)))
            if i >= 0:
                return f"the goal of drone {i} at {goal[i]} m"
        return ""

    def _find(self, slots: Slots, position: np.ndarray, quaternion: np.ndarray) -> int:
        """Return the first drone or load that would overlap a body, or -1."""
        # Its own arrays of one world, so that the worlds do not change
        scenery, count = self._engine.scenery, self._engine.scenery.place.shape[1]
        bodies = scenery.bodies._replace(
            position=np.zeros((1, self.count, 3)), quaternion=np.zeros((1, self.count, 4))
        )
        trial = scenery._replace(
            place=np.zeros((1, count, 3)),
            quaternion=np.zeros((1, count, 4)),
            velocity=np.zeros((1, count, 3)),
            spin=np.zeros((1, count, 3)),
            bodies=bodies,
        )
        for b, body in slots.items():
            (bodies.position[0, b], bodies.quaternion[0, b]), _ = body.start(0.0)
            place_body(trial, 0, b)
        pieces = np.zeros(count, dtype=bool)
        pieces[count - len(bodies.owner) :] = np.isin(bodies.owner, list(slots))
        found: int = find_overlapping(trial, pieces, position, quaternion, self._scratch)
        return found

    def place(self, w: int, slots: Slots, contact: ContactState) -> None:
        """Place the bodies of an episode in world w, and remove all others."""
        self.motions[w] = {b: one.motion for b, one in slots.items() if one.motion is not None}
        for b in range(self.count):
            if b in slots:
                set_body(self._engine, w, b, *slots[b].start(0.0))
            else:
                park_body(self._engine, w, b)
        # They may be close to any drone
        contact.budget[w], contact.asleep[w] = -1.0, False

    def follow_motions(self, flying: np.ndarray, steps: np.ndarray, hz: float) -> None:
        """Set the velocities of bodies that follow functions, up to the end of the decision.

        Args:
            flying: (W,) bool, worlds that fly the decision.
            steps: (W,) decisions before it.
            hz: Decisions per second.
        """
        for w in np.flatnonzero(flying).tolist():
            for b, motion in self.motions[w].items():
                follow_motion(self._engine, w, b, motion, (int(steps[w]) + 1) / hz, 1 / hz)

    def restore(self, worlds: Sequence[int]) -> None:
        """Move the bodies of worlds to the poses that a snapshot wrote to `scenery.bodies`."""
        self._engine.place_bodies(worlds)
        for w in worlds if isinstance(self._option, DrawnBodies) else ():
            self.motions[w] = {}


def _is_same(one: BodySource, two: BodySource) -> bool:
    """Return True if two sources of bodies are equal."""
    if one is two:
        return True
    if isinstance(one, Obstacle | str | Path) or isinstance(two, Obstacle | str | Path):
        return type(one) is type(two) and one == two
    return np.array_equal(one, two)
