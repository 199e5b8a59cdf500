"""Drops of drones onto what they can land on, and how they came to rest."""

from typing import NamedTuple

import numpy as np
from contact.rig import CLIMB, Rig, random_attitudes

from bulletuav.control.setpoint import SetpointLevel
from bulletuav.geometry.obstacle import Obstacle

SLOW, CALM = 0.01, 0.1
"""Speed and spin of a drone at rest, m/s and rad/s"""
PATIENCE = 2.0
"""Time from the first touch within which drones come to rest, s"""
DEEPEST = 5e-4
"""Greatest overlap, m"""
MOST_GAIN = 1e-4
"""Greatest gain of energy, as a height, m: that by which gaps at rest are held"""
GAIN_OF_FALL = 0.1
"""Greatest further gain, as a share of g dt^2: steps of dt follow a fall no better"""
PLACES = ("ground", "roof", "platform")
HEIGHT = {"ground": 0.0, "roof": 20.0, "platform": 5.0}
"""Of the surface, m"""
EDGE = 60.0
"""Half the width of roof and platform, m"""
DRIFT = (2.0, 1.0, 0.5)
"""Velocity of the platform, m/s"""


class Landing(NamedTuple):
    """How W drops ended.

    Attributes:
        touched: (W,) bool, whether a touch was recorded.
        rest: (W,) time from the first touch to lasting rest, s; inf for none.
        speed: (W,) speed against the surface at the end, m/s.
        spin: (W,) rad/s at the end.
        depth: (W,) greatest overlap at the end of a substep, m.
        gained: (W,) greatest gain of energy over its least so far, as a height: over m g, m.
        fall: Double the height that a drone falls in a substep from rest, m.
        left: (W,) bool, whether the drone took off again; upright ones alone should.
        upright: (W,) bool, whether the drone lies upright.
        quaternion: (W, 4) attitudes at the beginning.
        drop: (W,) m.
    """

    touched: np.ndarray
    rest: np.ndarray
    speed: np.ndarray
    spin: np.ndarray
    depth: np.ndarray
    gained: np.ndarray
    fall: float
    left: np.ndarray
    upright: np.ndarray
    quaternion: np.ndarray
    drop: np.ndarray

    def missed(self) -> dict[str, np.ndarray]:
        """Return the worlds in which each bound was missed."""
        found = {
            "touch": ~self.touched,
            "rest": self.rest > PATIENCE,
            "depth": self.depth > DEEPEST,
            "energy": self.gained > MOST_GAIN + GAIN_OF_FALL * self.fall,
            "take-off": self.upright & ~self.left,
        }
        return {name: np.flatnonzero(where) for name, where in found.items() if where.any()}


def land(
    airframe: str,
    *,
    hz: int = 240,
    place: str = "ground",
    flat: bool = False,
    sideways: float = 0.0,
    worlds: int = 100,
    dynamics: str = "rigid_body",
    seed: int = 0,
    drops: tuple[float, float] = (0.05, 10.0),
    flown: float | None = None,
) -> Landing:
    """Drop one drone in each world, wait for rest, take off.

    Args:
        airframe: Its name.
        hz: Substeps a second.
        place: One of `PLACES`.
        flat: Whether all fall level.
        sideways: Greatest speed along x and y, m/s.
        worlds: W; drops grow geometrically over them.
        dynamics: "rigid_body" or "bullet".
        seed: Of attitudes and speeds.
        drops: The least and the greatest, m.
        flown: Time of the flight before the take-off, s; None for fall and patience.
    """
    rng = np.random.default_rng(seed)
    drop = np.geomspace(*drops, worlds)
    moving = place == "platform"
    platform = [Obstacle("box", (2 * EDGE, 2 * EDGE, 1.0))] if moving else []
    roof = [((-EDGE, -EDGE, 0), (EDGE, EDGE, HEIGHT["roof"]))] if place == "roof" else []
    with Rig(
        [airframe], dynamics=dynamics, worlds=worlds, hz=hz, obstacles=platform, boxes=roof
    ) as rig:
        swarm = rig.swarm
        if moving:
            rig.obstacle[:, 0] = (0.0, 0.0, HEIGHT[place] - 0.5)
            rig.drift[:, 0] = DRIFT
        carried = np.array(DRIFT) if moving else np.zeros(3)
        if not flat:
            swarm.quaternion[:, 0] = random_attitudes(rng, worlds)
        start = swarm.quaternion[:, 0].copy()
        swarm.position[:, 0] = 0
        swarm.position[:, 0, 2] = 0
        swarm.position[:, 0, 2] = HEIGHT[place] + drop - rig.lowest()
        swarm.velocity[:, 0] = carried
        swarm.velocity[:, 0, :2] += rng.uniform(-sideways, sideways, (worlds, 2))
        rig.place()
        surface = rig.engine.scenery.first_body if moving or roof else rig.ground
        seconds = flown or np.sqrt(2 * drops[1] / rig.gravity) + PATIENCE + 0.5
        weight = rig.rows["mass"][:, 0] * rig.gravity
        first = np.full(worlds, np.inf)
        rest = np.full(worlds, np.inf)
        depth = np.zeros(worlds)
        gained = np.zeros(worlds)
        least = _energy_on(rig, carried)
        for _ in range(int(seconds * hz)):
            contacts = rig.fly()
            first[contacts.world] = np.minimum(first[contacts.world], rig.time)
            met = np.isfinite(first)
            now = _energy_on(rig, carried)
            gained = np.maximum(gained, (now - least) / weight)
            least = np.minimum(least, now)
            speed = np.linalg.norm(swarm.velocity[:, 0] - carried, axis=-1)
            spin = np.linalg.norm(swarm.rates[:, 0], axis=-1)
            still = (speed < SLOW) & (spin < CALM) & met
            rest = np.where(still, np.minimum(rest, rig.time), np.inf)
            depth = np.maximum(depth, -_height(rig, moving, surface))
        up = 1 - 2 * (swarm.quaternion[:, 0, :2] ** 2).sum(axis=-1)
        height = swarm.position[:, 0, 2] - HEIGHT[place] - rig.time * carried[2]
        climb = np.array(CLIMB) + np.array([*carried, 0.0])
        for _ in range(int(0.8 * hz)):
            rig.fly(SetpointLevel.VELOCITY, climb)
        rise = swarm.position[:, 0, 2] - HEIGHT[place] - rig.time * carried[2] - height
    return Landing(
        touched=met,
        rest=rest - first,
        speed=speed,
        spin=spin,
        depth=depth,
        gained=gained,
        fall=rig.gravity / hz**2,
        left=rise > 0.2,
        upright=up > 0.999,
        quaternion=start,
        drop=drop,
    )


def _energy_on(rig: Rig, carried: np.ndarray) -> np.ndarray:
    """Return the energy of the first drones (W,) as seen from a surface that moves, J."""
    relative = rig.swarm.velocity[:, 0] - carried
    fixed = rig.energy()[:, 0] - 0.5 * rig.rows["mass"][:, 0] * (rig.swarm.velocity[:, 0] ** 2).sum(
        axis=-1
    )
    sunk = rig.rows["mass"][:, 0] * rig.gravity * carried[2] * rig.time
    return fixed + 0.5 * rig.rows["mass"][:, 0] * (relative**2).sum(axis=-1) - sunk


def _height(rig: Rig, moving: bool, surface: int) -> np.ndarray:
    """Return the distance of the first drones from the level surface below them (W,), m."""
    if moving:
        return rig.lowest() - rig.obstacle[:, 0, 2] - 0.5
    if surface == rig.ground:
        return rig.lowest()
    return rig.lowest() - HEIGHT["roof"]
