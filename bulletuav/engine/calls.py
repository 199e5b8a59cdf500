"""What the engine is asked in every substep, body by body through pybullet; `Batch` does the same, to the bit, in C.

Arrays are float64 and contiguous, first axes as many as there are drones (or bodies); positions are the engine's own.
"""

import sys

import numpy as np

from bulletuav.engine.silence import silenced

with silenced():
    import pybullet as bullet

RAYS, DRONE_GROUP, SURFACE_GROUP, CITY_GROUP, SIGHT_GROUP = 1, 2, 4, 8, 16
"""Collision groups: the engine counts its rays to the first; ground and obstacles are surfaces; of cities, drones meet one
kind of body, rays the other"""
SOLID = SURFACE_GROUP | CITY_GROUP
VISIBLE = SURFACE_GROUP | SIGHT_GROUP
MAX_RAYS = 4095 if sys.platform == "darwin" else 16383  # per call; one more and Bullet answers none

# Columns of a row of getContactPoints.
BODY_A, BODY_B, DISTANCE, NORMAL_FORCE = 1, 2, 8, 9


class EngineCalls:
    """One client and the bodies (n,) of its drones."""

    def __init__(self, client: int, body: np.ndarray):
        self._client, self._body = client, body.tolist()

    def read(
        self,
        mask: np.ndarray,
        position: np.ndarray,
        quaternion: np.ndarray,
        velocity: np.ndarray,
        omega: np.ndarray,
    ) -> None:
        """Write pose and velocity, world axes, of the drones of `mask`."""
        flat = (
            position.reshape(-1, 3),
            quaternion.reshape(-1, 4),
            velocity.reshape(-1, 3),
            omega.reshape(-1, 3),
        )
        for k in np.flatnonzero(mask):
            flat[0][k], flat[1][k] = bullet.getBasePositionAndOrientation(
                self._body[k], self._client
            )
            flat[2][k], flat[3][k] = bullet.getBaseVelocity(self._body[k], self._client)

    def apply(
        self, mask: np.ndarray, position: np.ndarray, force: np.ndarray, torque: np.ndarray
    ) -> None:
        """One force (world axes, at `position`) and one torque (body axes) on each drone of `mask`, for the next step."""
        client, body = self._client, self._body
        places, forces, torques = (
            array.reshape(-1, 3).tolist() for array in (position, force, torque)
        )
        for k in np.flatnonzero(mask):
            bullet.applyExternalForce(body[k], -1, forces[k], places[k], bullet.WORLD_FRAME, client)
            bullet.applyExternalTorque(body[k], -1, torques[k], bullet.LINK_FRAME, client)

    def step(self) -> None:
        """Advance everything by one substep."""
        bullet.stepSimulation(self._client)

    def contacts(self) -> tuple[np.ndarray, np.ndarray]:
        """Bodies (C, 2) and normal forces (C,) of the points at which bodies touch."""
        points = bullet.getContactPoints(physicsClientId=self._client)
        touching = [point for point in points if point[NORMAL_FORCE] > 0 or point[DISTANCE] < 0]
        bodies = np.array(
            [(point[BODY_A], point[BODY_B]) for point in touching], dtype=np.int32
        ).reshape(-1, 2)
        return bodies, np.array([point[NORMAL_FORCE] for point in touching])

    def rays(self, start: np.ndarray, end: np.ndarray, groups: int) -> np.ndarray:
        """(M,) fraction of each ray (M, 3) before it meets a body of `groups`, 1 where none."""
        fraction = np.empty(len(start))
        for first in range(0, len(start), MAX_RAYS):
            part = slice(first, first + MAX_RAYS)
            hits = bullet.rayTestBatch(
                start[part], end[part], collisionFilterMask=groups, physicsClientId=self._client
            )
            fraction[part] = [hit[2] for hit in hits]
        return fraction

    def pose(self, body: np.ndarray, position: np.ndarray, quaternion: np.ndarray) -> None:
        """Put any bodies (n,) somewhere, at rest."""
        for one, place, turn in zip(body, position, quaternion, strict=True):
            bullet.resetBasePositionAndOrientation(one, place, turn, self._client)

    def velocity(self, body: np.ndarray, velocity: np.ndarray, omega: np.ndarray) -> None:
        """Give any bodies (n,) velocities, world axes."""
        for one, speed, spin in zip(body, velocity.tolist(), omega.tolist(), strict=True):
            bullet.resetBaseVelocity(one, speed, spin, self._client)

    def filter(self, body: np.ndarray, group: int, meets: int) -> None:
        """Set the collision group of any bodies (n,), and the groups that they meet; drops their cached contacts."""
        for one in body:
            bullet.setCollisionFilterGroupMask(one, -1, group, meets, self._client)
