"""Shots at walls, wires, edges, corners and hulls, and what must have come of each."""

from typing import NamedTuple

import numpy as np
from contact.rig import Rig, measure_gaps, random_attitudes, random_directions
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from bulletuav.contact.time_of_impact import CONTACT_DISTANCE
from bulletuav.geometry.obstacle import Obstacle
from bulletuav.vehicle.swarm import FIRST_OBSTACLE

_CORNERS = np.random.default_rng(5).normal(size=(12, 3)) * 0.5

TARGETS = {
    "wall of 2 mm": Obstacle("box", (0.002, 4.0, 4.0)),
    "wall of 2 cm": Obstacle("box", (0.02, 4.0, 4.0)),
    "wall of 20 cm": Obstacle("box", (0.2, 4.0, 4.0)),
    "wire of 2 cm": Obstacle("cylinder", (0.01, 4.0)),
    "edge": Obstacle("box", (1.0, 1.0, 1.0)),
    "corner": Obstacle("box", (0.9, 0.9, 0.9)),
    "hull": Obstacle("hull", corners=tuple(map(tuple, _CORNERS.tolist()))),
}
"""What is shot at"""
HIGH = np.array([0.0, 0.0, 100.0])
"""Where the targets are, m"""
SEEN = 8
"""Substeps of a shot; it hits within the first half of them, or not at all"""
UNSURE = 5e-6
"""Distance from a touch within which a shot may count either way, m"""
DEEPEST = 5e-4
"""Greatest overlap, m"""
MOST_STEPS = 3000
"""Steps of conservative advancement"""


class Shots(NamedTuple):
    """What came of W shots at one target.

    Attributes:
        speed: (W,) of the drone against the target, m/s.
        hits: (W,) bool, shots that must touch.
        misses: (W,) bool, shots that must not.
        recorded: (W,) bool, shots of which a touch was recorded.
        strange: (W,) bool, shots of which something else was recorded.
        beyond: (W,) bool, shots whose drone's centre went through the target.
        depth: (W,) greatest overlap, m.
        gained: (W,) greatest gain of energy in a substep over that of the shot; of targets that
            stand still alone.
    """

    speed: np.ndarray
    hits: np.ndarray
    misses: np.ndarray
    recorded: np.ndarray
    strange: np.ndarray
    beyond: np.ndarray
    depth: np.ndarray
    gained: np.ndarray

    def missed(self) -> dict[str, np.ndarray]:
        """Return the worlds in which each bound was missed."""
        found = {
            "beyond": self.beyond,
            "not recorded": self.hits & ~self.recorded,
            "false": (self.misses & self.recorded) | self.strange,
            "depth": self.depth > DEEPEST,
            "energy": self.gained > 1e-5,
        }
        return {name: np.flatnonzero(where) for name, where in found.items() if where.any()}


def _planes(target: Obstacle) -> np.ndarray:
    """Return the planes (F, 4) of a polytope within a target: n x + d <= 0 inside."""
    half = np.array(target.shape.half)
    if target.kind == "cylinder":
        angle = np.linspace(0, 2 * np.pi, 33)[:-1]
        ring = np.stack([half[0] * np.cos(angle), half[0] * np.sin(angle)], axis=-1)
        corners = np.concatenate(
            [np.concatenate([ring, np.full((32, 1), z)], axis=1) for z in (-half[2], half[2])]
        )
    elif target.kind == "box":
        corners = np.stack(np.meshgrid(*[(-h, h) for h in half]), axis=-1).reshape(-1, 3)
    else:
        corners = np.array(target.corners)
    return ConvexHull(corners).equations


def _goes_through(planes: np.ndarray, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return (M,) which lines from begin to end (M, 3) enter the polytope of planes (F, 4)."""
    height = begin @ planes[:, :3].T + planes[:, 3]
    change = (end - begin) @ planes[:, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = -height / change
    enter = np.where(change < 0, cross, -np.inf).max(axis=1)
    leave = np.where(change > 0, cross, np.inf).min(axis=1)
    outside = ((change == 0) & (height > 0)).any(axis=1)
    return ~outside & (enter < leave) & (enter < 1) & (leave > 0)


class Range:
    """A rig of one airframe and dynamics, with all targets."""

    def __init__(
        self, airframe: str, *, dynamics: str = "rigid_body", hz: int = 240, shots: int = 100
    ) -> None:
        """Build a world for each shot."""
        self.rig = Rig(
            [airframe],
            dynamics=dynamics,
            worlds=shots,
            hz=hz,
            gravity=0.0,
            obstacles=list(TARGETS.values()),
        )
        self.level = self.rig.contacts == "stop"

    def shoot(
        self,
        name: str,
        *,
        speed: tuple[float, float] = (2.0, 60.0),
        drift: float = 0.0,
        spin: float = 0.0,
        seed: int = 0,
    ) -> Shots:
        """Shoot once in each world.

        Args:
            name: Of the target.
            speed: Least and greatest speed against the target, m/s.
            drift: Greatest speed of the target, m/s.
            spin: Greatest rate about a body axis, rad/s; of six degrees of freedom alone.
            seed: Of all that is drawn.
        """
        rig = self.rig
        rng = np.random.default_rng(seed)
        worlds = len(rig.alive)
        k = list(TARGETS).index(name)
        target = TARGETS[name]
        way, off, turn = self._aims(rng, name)
        fast = np.exp(rng.uniform(*np.log(speed), worlds))
        # All is drawn as seen from the target; a third of the shots are aimed beside it
        velocity = fast[:, None] * way
        attitude = random_attitudes(rng, worlds)
        rates = np.zeros((worlds, 3))
        if self.level:
            attitude[:] = (0, 0, 0, 1)
        else:
            axis = rng.integers(3, size=worlds)
            rates[np.arange(worlds), axis] = rng.uniform(-spin, spin, worlds)
        far = target.radius + rig.airframes[0].collision_radius + 0.01
        start = HIGH + off - way * (far + 1.0)
        # A shot at a far end would start within the other drone
        start -= np.where(np.linalg.norm(start - HIGH, axis=1) < far, 2.0 * far, 0.0)[:, None] * way
        # How the free flight would go, and when it is to begin for a touch within the shot
        time, least = self._flight(k, turn, start, velocity, attitude, rates)
        hits = least <= CONTACT_DISTANCE
        substeps = np.where(hits, rng.uniform(0.05, SEEN / 2, worlds), SEEN / 2)
        begin = time - substeps * rig.dt
        drifts = rng.uniform(0, drift, worlds)[:, None] * random_directions(rng, worlds)
        rig.obstacle[:] = HIGH + 50.0 * (1 + np.arange(len(TARGETS)))[None, :, None]
        rig.obstacle[:, k] = HIGH
        rig.turn[:] = (0, 0, 0, 1)
        rig.turn[:, k] = turn
        rig.drift[:] = 0
        rig.drift[:, k] = drifts
        swarm = rig.swarm
        swarm.position[:, 0] = start + begin[:, None] * velocity
        swarm.velocity[:, 0] = velocity + drifts
        swarm.quaternion[:, 0] = _turned(attitude, rates, begin)
        swarm.rates[:, 0] = rates
        rig.place()
        return self._follow(k, fast, hits, least > CONTACT_DISTANCE + UNSURE)

    def _aims(
        self, rng: np.random.Generator, name: str
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Draw directions (W, 3), offsets of the aim (W, 3) and turns of the target (W, 4)."""
        worlds = len(self.rig.alive)
        target = TARGETS[name]
        turn = random_attitudes(rng, worlds)
        way = random_directions(rng, worlds)
        turned = Rotation.from_quat(turn)
        half = np.array(target.shape.half)
        if name.startswith("wall"):
            # Within 70 degrees of the face, anywhere on it and a little beside
            local = way.copy()
            local[:, 0] = np.sign(local[:, 0]) * (0.4 + np.abs(local[:, 0]))
            way = turned.apply(local / np.linalg.norm(local, axis=1, keepdims=True))
            off = turned.apply(rng.uniform(-1.1, 1.1, (worlds, 3)) * half * (0, 1, 1))
        elif name in ("edge", "corner"):
            # Towards the middle of an edge, or a corner
            feature = np.sign(rng.normal(size=(worlds, 3))) * half
            if name == "edge":
                feature[np.arange(worlds), rng.integers(3, size=worlds)] *= 0.3
            inwards = -feature / np.linalg.norm(feature, axis=1, keepdims=True)
            way = inwards + 0.6 * way
            way = turned.apply(way / np.linalg.norm(way, axis=1, keepdims=True))
            off = turned.apply(feature)
        else:
            off = turned.apply(rng.uniform(-1, 1, (worlds, 3)) * half)
        beside = self.rig.airframes[0].collision_radius * random_directions(rng, worlds)
        return way, off + 1.2 * beside * rng.uniform(0, 1, (worlds, 1)), turn

    def _flight(
        self,
        k: int,
        turn: np.ndarray,
        start: np.ndarray,
        velocity: np.ndarray,
        attitude: np.ndarray,
        rates: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Find when free flights touch or are nearest, and how near they come.

        Conservative advancement, and a micrometre at least: times (W,) and distances (W,).
        """
        scenery = self.rig.engine.scenery
        radius = self.rig.airframes[0].collision_radius
        bound = np.linalg.norm(velocity, axis=1) + radius * np.linalg.norm(rates, axis=1)
        # By then they have left the sphere about the target, on whatever side they entered it
        reach = list(TARGETS.values())[k].radius + radius
        last = (np.linalg.norm(start - HIGH, axis=1) + reach) / np.linalg.norm(velocity, axis=1)
        time = np.zeros(len(start))
        least = np.full(len(start), np.inf)
        when = np.zeros(len(start))
        open_ = np.arange(len(start))
        for _ in range(MOST_STEPS):
            now = time[open_]
            gap = measure_gaps(
                scenery.table,
                0,
                scenery.first_body + k,
                start[open_] + now[:, None] * velocity[open_],
                _turned(attitude[open_], rates[open_], now),
                np.broadcast_to(HIGH, (len(open_), 3)),
                turn[open_],
            )
            nearer = gap < least[open_]
            least[open_[nearer]] = gap[nearer]
            when[open_[nearer]] = now[nearer]
            time[open_] += np.maximum(gap - CONTACT_DISTANCE, 1e-6) / bound[open_]
            open_ = open_[(gap > CONTACT_DISTANCE) & (time[open_] < last[open_])]
            if not len(open_):
                return when, least
        least[open_] = np.nan
        return when, least

    def _follow(self, k: int, fast: np.ndarray, hits: np.ndarray, misses: np.ndarray) -> Shots:
        """Fly the shots, and look where drones get."""
        rig = self.rig
        planes = _planes(list(TARGETS.values())[k])
        inverse = Rotation.from_quat(rig.turn[:, k]).inv()
        worlds = len(rig.alive)
        recorded = np.zeros(worlds, dtype=bool)
        strange = np.zeros(worlds, dtype=bool)
        beyond = np.zeros(worlds, dtype=bool)
        depth = np.zeros(worlds)
        gained = np.zeros(worlds)
        still = not rig.drift.any()
        full = rig.energy()[:, 0]
        energy = full
        for _ in range(SEEN):
            before = inverse.apply(rig.swarm.position[:, 0] - rig.obstacle[:, k])
            contacts = rig.fly()
            recorded[contacts.world] = True
            strange[contacts.world[contacts.other != FIRST_OBSTACLE - k]] = True
            after = inverse.apply(rig.swarm.position[:, 0] - rig.obstacle[:, k])
            beyond |= _goes_through(planes, before, after)
            depth = np.maximum(depth, -rig.gaps(0, rig.engine.scenery.first_body + k))
            now = rig.energy()[:, 0]
            gained = np.maximum(gained, still * (now - energy) / full)
            energy = now
        return Shots(fast, hits, misses, recorded, strange, beyond, depth, gained)


def _turned(attitude: np.ndarray, rates: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return attitudes (W, 4) after times (W,) of body rates (W, 3) about one axis each."""
    spun = Rotation.from_rotvec(rates * time[:, None])
    return (Rotation.from_quat(attitude) * spun).as_quat()
