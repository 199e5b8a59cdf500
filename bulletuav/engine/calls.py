"""Calls to Bullet in every substep, body by body through pybullet.

`CExtension` does the same, to the bit, in C. Arrays are float64 and contiguous. Their first axes
are as many as there are drones (or bodies). Positions are in Bullet's own frame.
"""

import sys

import numpy as np

from bulletuav.engine.silence import silenced

with silenced():
    import pybullet

bullet = pybullet

# Collision groups. Bullet counts its rays to the first; ground and obstacles are surfaces. Of
# cities, drones meet one kind of body, and rays the other.
RAYS = 1
DRONE_GROUP = 2
SURFACE_GROUP = 4
CITY_GROUP = 8
SIGHT_GROUP = 16
SOLID = SURFACE_GROUP | CITY_GROUP
"""Groups that drones meet, beside each other"""
VISIBLE = SURFACE_GROUP | SIGHT_GROUP
"""Groups that rays meet"""
MAX_RAYS = 4095 if sys.platform == "darwin" else 16383
"""Rays a call takes; with one more Bullet answers none"""

# Columns of a row of getContactPoints.
BODY_A = 1
BODY_B = 2
ON_B = 6
NORMAL_ON_B = 7
DISTANCE = 8
NORMAL_FORCE = 9
# Column of a row of rayTestBatch.
HIT_FRACTION = 2


class EngineCalls:
    """Functions of Bullet for the drones of one client."""

    def __init__(self, client: int, body: np.ndarray) -> None:
        """Keep the client and the bodies of its drones.

        Args:
            client: Number that Bullet gave the client.
            body: (n,) numbers that Bullet gave the drones.
        """
        self._client = client
        self._body: list[int] = body.tolist()

    def read(
        self,
        mask: np.ndarray,
        position: np.ndarray,
        quaternion: np.ndarray,
        velocity: np.ndarray,
        omega: np.ndarray,
    ) -> None:
        """Write poses and velocities of the drones into arrays.

        Args:
            mask: (n,) bool, drones to read.
            position: (n, 3) m, written.
            quaternion: (n, 4) body to world, written.
            velocity: (n, 3) m/s, world axes, written.
            omega: (n, 3) angular velocity, rad/s, world axes, written.
        """
        positions = position.reshape(-1, 3)
        quaternions = quaternion.reshape(-1, 4)
        velocities = velocity.reshape(-1, 3)
        omegas = omega.reshape(-1, 3)
        for k in np.flatnonzero(mask):
            body = self._body[k]
            positions[k], quaternions[k] = bullet.getBasePositionAndOrientation(body, self._client)
            velocities[k], omegas[k] = bullet.getBaseVelocity(body, self._client)

    def write(
        self,
        mask: np.ndarray,
        position: np.ndarray,
        quaternion: np.ndarray,
        velocity: np.ndarray,
        omega: np.ndarray,
    ) -> None:
        """Give drones poses and velocities.

        Args:
            mask: (n,) bool, drones to set.
            position: (n, 3) m.
            quaternion: (n, 4) body to world.
            velocity: (n, 3) m/s, world axes.
            omega: (n, 3) angular velocity, rad/s, world axes.
        """
        chosen = np.flatnonzero(mask)
        bodies = np.array(self._body, dtype=np.int32)[chosen]
        self.pose(bodies, position.reshape(-1, 3)[chosen], quaternion.reshape(-1, 4)[chosen])
        self.velocity(bodies, velocity.reshape(-1, 3)[chosen], omega.reshape(-1, 3)[chosen])

    def apply(
        self, mask: np.ndarray, position: np.ndarray, force: np.ndarray, torque: np.ndarray
    ) -> None:
        """Give drones one force and one torque each for the next step.

        Args:
            mask: (n,) bool, drones to drive.
            position: (n, 3) where the force acts, m.
            force: (n, 3) N, world axes.
            torque: (n, 3) N m, body axes.
        """
        client = self._client
        positions = position.reshape(-1, 3).tolist()
        forces = force.reshape(-1, 3).tolist()
        torques = torque.reshape(-1, 3).tolist()
        for k in np.flatnonzero(mask):
            body = self._body[k]
            bullet.applyExternalForce(body, -1, forces[k], positions[k], bullet.WORLD_FRAME, client)
            bullet.applyExternalTorque(body, -1, torques[k], bullet.LINK_FRAME, client)

    def step(self) -> None:
        """Advance everything by one substep."""
        bullet.stepSimulation(self._client)

    def rays(self, start: np.ndarray, end: np.ndarray, groups: int) -> np.ndarray:
        """Cast rays.

        Args:
            start: (M, 3) starts, m.
            end: (M, 3) ends, m.
            groups: Collision groups that the rays meet.

        Returns:
            (M,) fraction of each ray before it meets a body, 1 where it meets none.
        """
        # As many at once as a call takes.
        fraction = np.empty(len(start))
        for first in range(0, len(start), MAX_RAYS):
            part = slice(first, first + MAX_RAYS)
            hits = bullet.rayTestBatch(
                start[part],
                end[part],
                collisionFilterMask=groups,
                physicsClientId=self._client,
            )
            fraction[part] = [hit[HIT_FRACTION] for hit in hits]
        return fraction

    def pose(self, body: np.ndarray, position: np.ndarray, quaternion: np.ndarray) -> None:
        """Put bodies somewhere, at rest.

        Args:
            body: (n,) any bodies.
            position: (n, 3) m.
            quaternion: (n, 4) body to world.
        """
        for one, place, turn in zip(body, position, quaternion, strict=True):
            bullet.resetBasePositionAndOrientation(one, place, turn, self._client)

    def velocity(self, body: np.ndarray, velocity: np.ndarray, omega: np.ndarray) -> None:
        """Give bodies velocities.

        Args:
            body: (n,) any bodies.
            velocity: (n, 3) m/s, world axes.
            omega: (n, 3) angular velocity, rad/s, world axes.
        """
        for one, speed, spin in zip(body, velocity.tolist(), omega.tolist(), strict=True):
            bullet.resetBaseVelocity(one, speed, spin, self._client)

    def filter(self, body: np.ndarray, group: int, meets: int) -> None:
        """Set which bodies meet; this drops their cached contacts.

        Args:
            body: (n,) any bodies.
            group: Collision group of these bodies.
            meets: Collision groups that they meet.
        """
        for one in body:
            bullet.setCollisionFilterGroupMask(one, -1, group, meets, self._client)
