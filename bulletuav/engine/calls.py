"""Calls of Bullet in every substep, body by body through pybullet.

No other module imports pybullet, which is optional: where it cannot be imported, any use of
`bullet` raises one ImportError. Worlds never use it unless their dynamics, rays, contacts or
pictures are Bullet's.

`CExtension` implements the same calls in C, with equal bits. Arrays are float64 and contiguous, and
their first axis is that of drones or bodies. Positions are in Bullet's frame.
"""

import sys
from typing import Any

import numpy as np

from bulletuav.engine.silence import silenced
from bulletuav.errors import install


class _MissingBullet:
    """Replacement for pybullet where it cannot be imported; any use raises ImportError."""

    def __init__(self, reason: str) -> None:
        self.reason = reason

    def __getattr__(self, name: str) -> Any:
        # Tools that inspect modules look for such names
        if name.startswith("__"):
            raise AttributeError(name)
        raise _make_error("dynamics, rays, contacts and the renderer of Bullet", self.reason)


def _make_error(what: str, reason: str) -> ImportError:
    """Return the error for a feature that needs PyBullet."""
    return ImportError(
        f"PyBullet is needed for {what}, but cannot be imported ({reason}): use dynamics "
        f"'rigid_body' and camera 'compiled' instead, or install it by "
        f"{install('bullet')}; it has wheels for Python 3.11 on Linux x86-64 only, elsewhere pip "
        f"compiles it for 10 to 40 minutes, which needs a C++ compiler"
    )


bullet: Any
try:
    with silenced():
        import pybullet
    bullet = pybullet
except ImportError as error:
    bullet = _MissingBullet(str(error))
HAS_BULLET = not isinstance(bullet, _MissingBullet)
"""Whether PyBullet is installed"""


def require_bullet(what: str) -> None:
    """Check that PyBullet is installed, before its first use.

    Args:
        what: The feature that needs PyBullet, such as "dynamics 'bullet'".

    Raises:
        ImportError: If PyBullet cannot be imported. The message contains the reason and the remedy.
    """
    if isinstance(bullet, _MissingBullet):
        raise _make_error(what, bullet.reason)


# Collision groups. Bullet's rays belong to the first group; ground and obstacles are surfaces. A
# city has bodies that only drones collide with, and bodies that only rays hit.
RAYS = 1
DRONE_GROUP = 2
SURFACE_GROUP = 4
CITY_GROUP = 8
SIGHT_GROUP = 16
SOLID = SURFACE_GROUP | CITY_GROUP
"""Groups that drones collide with, besides drones"""
VISIBLE = SURFACE_GROUP | SIGHT_GROUP
"""Groups that rays hit"""
MAX_RAYS = 4095 if sys.platform == "darwin" else 16383
"""Maximum number of rays in a call; for more, Bullet returns no results"""

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
    """Functions of Bullet for the drones of one client, through pybullet."""

    def __init__(self, client: int, body: np.ndarray) -> None:
        """Store the client and the bodies of its drones.

        Args:
            client: Id of the client in Bullet.
            body: (n,) ids of the drones' bodies in Bullet.
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
        """Read poses and velocities of drones into arrays.

        Args:
            mask: (n,) bool, drones to read.
            position: (n, 3) positions, m; written.
            quaternion: (n, 4) attitudes, body to world; written.
            velocity: (n, 3) velocities, world axes, m/s; written.
            omega: (n, 3) angular velocities, world axes, rad/s; written.
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
        """Set poses and velocities of drones.

        Args:
            mask: (n,) bool, drones to set.
            position: (n, 3) positions, m.
            quaternion: (n, 4) attitudes, body to world.
            velocity: (n, 3) velocities, world axes, m/s.
            omega: (n, 3) angular velocities, world axes, rad/s.
        """
        chosen = np.flatnonzero(mask)
        bodies = np.array(self._body, dtype=np.int32)[chosen]
        self.pose(bodies, position.reshape(-1, 3)[chosen], quaternion.reshape(-1, 4)[chosen])
        self.velocity(bodies, velocity.reshape(-1, 3)[chosen], omega.reshape(-1, 3)[chosen])

    def apply(
        self, mask: np.ndarray, position: np.ndarray, force: np.ndarray, torque: np.ndarray
    ) -> None:
        """Apply a force and a torque to each drone in the next step.

        Args:
            mask: (n,) bool, drones to apply them to.
            position: (n, 3) points at which the forces act, m.
            force: (n, 3) forces, world axes, N.
            torque: (n, 3) torques, body axes, N m.
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
        """Advance the simulation by one substep."""
        bullet.stepSimulation(self._client)

    def rays(self, start: np.ndarray, end: np.ndarray, groups: int) -> np.ndarray:
        """Cast rays.

        Args:
            start: (M, 3) starts, m.
            end: (M, 3) ends, m.
            groups: Collision groups that the rays hit.

        Returns:
            (M,) fraction of each ray before its hit, 1 without a hit.
        """
        # Cast the rays in batches of the maximum size.
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
        """Set poses of bodies, at rest.

        Args:
            body: (n,) ids of any bodies.
            position: (n, 3) positions, m.
            quaternion: (n, 4) attitudes, body to world.
        """
        for one, place, turn in zip(body, position, quaternion, strict=True):
            bullet.resetBasePositionAndOrientation(one, place, turn, self._client)

    def velocity(self, body: np.ndarray, velocity: np.ndarray, omega: np.ndarray) -> None:
        """Set velocities of bodies.

        Args:
            body: (n,) ids of any bodies.
            velocity: (n, 3) velocities, world axes, m/s.
            omega: (n, 3) angular velocities, world axes, rad/s.
        """
        for one, speed, spin in zip(body, velocity.tolist(), omega.tolist(), strict=True):
            bullet.resetBaseVelocity(one, speed, spin, self._client)

    def filter(self, body: np.ndarray, group: int, meets: int) -> None:
        """Set collision filters of bodies; this clears their cached contacts.

        Args:
            body: (n,) ids of any bodies.
            group: Collision group of these bodies.
            meets: Collision groups that they collide with.
        """
        for one in body:
            bullet.setCollisionFilterGroupMask(one, -1, group, meets, self._client)
