"""Pairs of drones that meet in free fall, and what they keep."""

from typing import NamedTuple

import numpy as np
from contact.rig import Rig, random_attitudes, random_directions

KINDS = ("head-on", "oblique", "spinning")
HEIGHT = 300.0
"""So high that no drone reaches the ground meanwhile, m"""
DEEPEST = 5e-4
"""Greatest overlap, m"""


class Meetings(NamedTuple):
    """What W pairs kept, over the substeps in which they touched.

    Attributes:
        recorded: (W,) bool, whether the contact was recorded for both, if there was one.
        linear: (W,) greatest change of the linear momentum over the sum of m v of both.
        angular: (W,) the same of the angular momentum over the sum of m v r.
        gained: (W,) greatest gain of energy in a substep over the first.
        rebound: (W,) relative speed after the last touch over that before.
        stuck: (W,) bool, pairs that do not move as their velocities say.
        depth: (W,) greatest overlap, m.
    """

    recorded: np.ndarray
    linear: np.ndarray
    angular: np.ndarray
    gained: np.ndarray
    rebound: np.ndarray
    stuck: np.ndarray
    depth: np.ndarray

    def missed(self) -> dict[str, np.ndarray]:
        """Return the worlds in which each bound was missed."""
        found = {
            "recorded": ~self.recorded,
            "linear": self.linear > 1e-12,
            "angular": self.angular > 1e-3,
            "energy": self.gained > 1e-5,
            "stuck": self.stuck,
            "depth": self.depth > DEEPEST,
        }
        return {name: np.flatnonzero(where) for name, where in found.items() if where.any()}


def meet_in_pairs(
    kind: str,
    airframes: tuple[str, str] = ("cf2x", "cf2x"),
    *,
    hz: int = 240,
    worlds: int = 100,
    speed: tuple[float, float] = (1.0, 40.0),
    restitution: float = 0.0,
    friction: float = 0.5,
    dynamics: str = "rigid_body",
    seed: int = 0,
) -> Meetings:
    """Let two drones meet in each world.

    Args:
        kind: "head-on" (level, side on, at one height), "oblique" (any attitude, off centre) or
            "spinning" (the same, each turning at up to 30 rad/s).
        airframes: Of the two.
        hz: Substeps a second.
        worlds: W.
        speed: Least and greatest closing speed, m/s.
        restitution: Of all drones.
        friction: Of all drones.
        dynamics: "rigid_body" or "bullet".
        seed: Of all that is drawn.
    """
    rng = np.random.default_rng(seed)
    with Rig(
        airframes,
        dynamics=dynamics,
        worlds=worlds,
        hz=hz,
        gravity=0.0,
        friction=friction,
        restitution=restitution,
    ) as rig:
        swarm = rig.swarm
        fast = np.exp(rng.uniform(*np.log(speed), worlds))
        way = random_directions(rng, worlds)
        reach = sum(one.collision_radius for one in rig.airframes)
        aside = np.zeros((worlds, 3))
        if kind == "head-on":
            way[:, 2] = 0
            way /= np.linalg.norm(way, axis=1, keepdims=True)
        else:
            aside = np.cross(way, random_directions(rng, worlds)) * 0.3 * reach
            swarm.quaternion[:] = random_attitudes(rng, worlds, 2)
        if kind == "spinning":
            swarm.rates[:] = rng.uniform(-30, 30, (worlds, 2, 3)) / np.sqrt(3)
        apart = reach + fast * rng.uniform(0.1, 1.9, worlds) / hz
        share = rng.uniform(0, 1, (worlds, 1))
        swarm.position[:, 0] = (0, 0, HEIGHT)
        swarm.position[:, 1] = swarm.position[:, 0] + apart[:, None] * way + aside
        swarm.velocity[:, 0] = share * fast[:, None] * way
        swarm.velocity[:, 1] = (share - 1) * fast[:, None] * way
        rig.place()
        start = tuple(array.copy() for array in swarm)
        passes = np.zeros(worlds, dtype=bool) if kind == "spinning" else _passes(rig, fast, apart)
        met = _follow(rig, fast, way, max(16, int(4 * reach / (speed[0] / hz))))
        for world in np.flatnonzero(~(met.recorded | passes)):
            seconds = 2 * apart[world] / fast[world]
            passes[world] = _passes_slowly([array[world] for array in start], airframes, seconds)
        return met._replace(recorded=met.recorded | passes)


def _passes_slowly(start: list[np.ndarray], airframes: tuple[str, str], seconds: float) -> bool:
    """Check whether two drones pass each other within some seconds, in steps of at most 2 mm."""
    with Rig(airframes, hz=20_000, gravity=0.0) as rig:
        for array, values in zip(rig.swarm, start, strict=True):
            array[0] = values
        rig.place()
        while rig.time < seconds and rig.gaps(0, 1)[0] > 0.0:
            if len(rig.fly().world):
                return False
        return bool(rig.gaps(0, 1)[0] > 0.0)


def _passes(rig: Rig, fast: np.ndarray, apart: np.ndarray) -> np.ndarray:
    """Return in which worlds two drones that do not rotate pass each other, (W,) bool."""
    here = rig.swarm.position.copy()
    reach = sum(one.collision_radius for one in rig.airframes)
    least = np.full(len(fast), np.inf)
    for share in np.linspace(-1.5, 1.5, 301):
        time = (apart + share * reach) / fast
        rig.swarm.position[:] = here + time[:, None, None] * rig.swarm.velocity
        least = np.minimum(least, rig.gaps(0, 1))
    rig.swarm.position[:] = here
    return least > 0.0


def _follow(rig: Rig, fast: np.ndarray, way: np.ndarray, most: int) -> Meetings:
    """Fly until all must have met, and measure."""
    swarm = rig.swarm
    worlds = len(rig.alive)
    each = rig.rows["mass"] * np.linalg.norm(swarm.velocity, axis=-1)
    reach = np.array([one.collision_radius for one in rig.airframes])
    recorded = np.zeros((worlds, 2), dtype=bool)
    linear, angular, gained, depth = np.zeros((4, worlds))
    rebound = np.zeros(worlds)
    stuck = np.zeros(worlds, dtype=bool)
    shift = np.zeros((worlds, 3))
    turn = np.zeros((worlds, 3))
    energy = rig.energy().sum(axis=1)
    first = energy
    for _ in range(most):
        before, spun = rig.momentum().sum(axis=1), rig.spin_momentum().sum(axis=1)
        place = swarm.position.copy()
        contacts = rig.fly()
        touched = contacts.mask(rig.alive.shape)
        recorded |= touched
        met = touched.any(axis=1)
        shift += met[:, None] * (rig.momentum().sum(axis=1) - before)
        turn += met[:, None] * (rig.spin_momentum().sum(axis=1) - spun)
        linear = np.maximum(linear, np.linalg.norm(shift, axis=1) / each.sum(axis=1))
        angular = np.maximum(angular, np.linalg.norm(turn, axis=1) / (each * reach).sum(axis=1))
        now = rig.energy().sum(axis=1)
        gained = np.maximum(gained, (now - energy) / first)
        energy = now
        depth = np.maximum(depth, -rig.gaps(0, 1))
        closing = ((swarm.velocity[:, 1] - swarm.velocity[:, 0]) * way).sum(axis=1)
        rebound = np.where(met, closing / fast, rebound)
        moved = np.linalg.norm(swarm.position - place, axis=-1) / rig.dt
        gone = np.linalg.norm(swarm.velocity, axis=-1)
        stuck = (~touched & (np.abs(moved - gone) > 0.01 * fast[:, None])).any(axis=1)
        stuck |= (touched & (gone > 0.1) & (moved < 0.01 * gone)).any(axis=1)
    return Meetings(recorded.all(axis=1), linear, angular, gained, rebound, stuck, depth)
