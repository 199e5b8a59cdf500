"""Trains of drones that fly into a wall, each pushing the one before it."""

from typing import NamedTuple

import numpy as np
from contact.rig import Rig, random_attitudes

from bulletuav.geometry.obstacle import Obstacle
from bulletuav.vehicle.swarm import FIRST_OBSTACLE

DEEPEST = 5e-4
"""Greatest overlap, m"""


class Train(NamedTuple):
    """What came of W trains of N drones.

    Attributes:
        beyond: (W, N) bool, drones whose centre got behind the wall.
        recorded: (W,) bool, whether the first drone's contact with the wall was recorded.
        depth: (W,) greatest overlap of any two, or with the wall, m.
        gained: (W,) greatest gain of energy in a substep over that of the beginning.
    """

    beyond: np.ndarray
    recorded: np.ndarray
    depth: np.ndarray
    gained: np.ndarray

    def missed(self) -> dict[str, np.ndarray]:
        """Return the worlds in which each bound was missed."""
        found = {
            "beyond": self.beyond.any(axis=1),
            "not recorded": ~self.recorded,
            "depth": self.depth > DEEPEST,
            "energy": self.gained > 1e-5,
        }
        return {name: np.flatnonzero(where) for name, where in found.items() if where.any()}


def push(
    airframe: str,
    *,
    hz: int = 240,
    worlds: int = 20,
    drones: int = 5,
    thick: float = 0.02,
    speed: tuple[float, float] = (2.0, 60.0),
    substeps: int = 12,
    seed: int = 0,
) -> Train:
    """Let trains fly into a wall across x.

    Args:
        airframe: Of all drones.
        hz: Substeps a second.
        worlds: W.
        drones: N.
        thick: Thickness of the wall, m.
        speed: Least and greatest speed, m/s.
        substeps: To follow at least; slow trains are followed until they must have met the wall.
        seed: Of attitudes, places and speeds.
    """
    rng = np.random.default_rng(seed)
    wall = Obstacle("box", (thick, 40.0, 40.0))
    with Rig([airframe] * drones, worlds=worlds, hz=hz, gravity=0.0, obstacles=[wall]) as rig:
        swarm = rig.swarm
        rig.obstacle[:, 0] = (0, 0, 100)
        radius = rig.airframes[0].collision_radius
        fast = np.exp(rng.uniform(*np.log(speed), worlds))
        place = (1 + 2.02 * np.arange(drones)) * radius + 0.5 * thick + 2e-4
        swarm.position[:] = 0.2 * radius * rng.uniform(-1, 1, (worlds, drones, 3))
        swarm.position[..., 0] = -place - rng.uniform(0, 1, (worlds, 1)) * fast[:, None] / hz
        swarm.position[..., 2] += 100
        swarm.velocity[..., 0] = fast[:, None]
        swarm.quaternion[:] = random_attitudes(rng, worlds, drones)
        rig.place()
        beyond = np.zeros((worlds, drones), dtype=bool)
        recorded = np.zeros(worlds, dtype=bool)
        depth, gained = np.zeros((2, worlds))
        energy = rig.energy().sum(axis=1)
        full = energy
        slowest = float(fast.min()) / hz
        for _ in range(max(substeps, int(2 * radius / slowest) + 2)):
            contacts = rig.fly()
            recorded[contacts.world[contacts.other == FIRST_OBSTACLE]] = True
            beyond |= swarm.position[..., 0] > 0
            now = rig.energy().sum(axis=1)
            gained = np.maximum(gained, (now - energy) / full)
            energy = now
            for i in range(drones):
                depth = np.maximum(depth, -rig.gaps(i, rig.engine.scenery.first_body))
                for j in range(i):
                    depth = np.maximum(depth, -rig.gaps(i, j))
    return Train(beyond, recorded, depth, gained)
